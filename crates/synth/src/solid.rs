//! [`Solid`]: a shape with material and pose; [`Builder`] collects them.

use garad_core::{Se3, So3};
use nalgebra::{Matrix3, Vector3};

use crate::clothes::Cloth;
use crate::material::Material;
use crate::pattern::Rgb;
use crate::shape::Shape;

/// A shape with material and pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Solid {
    pub(crate) shape: Shape,
    pub(crate) material: Material,
    pub(crate) world_from_solid: Se3,
    /// 0 for the room; moving objects count from 1.
    pub(crate) object: u8,
}

/// A rotation that takes z to `z` and x as close to `x_hint` as that allows.
pub(crate) fn rotation_along(z: &Vector3<f64>, x_hint: &Vector3<f64>) -> So3 {
    let z = z.normalize();
    let y = z.cross(x_hint);
    // for a hint along z any other direction is good
    let y = if y.norm() > 1e-6 {
        y
    } else {
        z.cross(&Vector3::new(0.36, 0.48, 0.8))
    };
    let y = y.normalize();
    So3::from_matrix(&Matrix3::from_columns(&[y.cross(&z), y, z]))
}

/// A rotation about the vertical.
pub(crate) fn yaw(angle_rad: f64) -> So3 {
    So3::exp(&Vector3::new(0.0, 0.0, angle_rad))
}

/// Collects solids of a piece of furniture in its own frame: x right, y back, z up from the floor.
#[derive(Debug)]
pub(crate) struct Builder {
    pub(crate) solids: Vec<Solid>,
    world_from_piece: Se3,
    seed: u32,
}

impl Builder {
    pub(crate) fn new(seed: u32) -> Self {
        Self {
            solids: Vec::new(),
            world_from_piece: Se3::identity(),
            seed,
        }
    }

    /// Sets the place of the following solids, rotated by `angle_rad` about the vertical.
    pub(crate) fn at(&mut self, x: f64, y: f64, z: f64, angle_rad: f64) -> &mut Self {
        self.world_from_piece = Se3::new(yaw(angle_rad), Vector3::new(x, y, z));
        self
    }

    /// A new seed, so that things of one kind differ.
    pub(crate) fn seed(&mut self) -> u32 {
        self.seed = self
            .seed
            .wrapping_mul(0x9E37_79B1)
            .wrapping_add(0x7F4A_7C15);
        self.seed >> 3
    }

    pub(crate) fn wood(&mut self, tone: Rgb) -> Material {
        let seed = self.seed();
        Material::Wood { tone, seed }
    }

    pub(crate) fn paint(&mut self, tone: Rgb) -> Material {
        let seed = self.seed();
        Material::Painted { tone, seed }
    }

    pub(crate) fn fabric(&mut self, cloth: Cloth) -> Material {
        let seed = self.seed();
        Material::Fabric { cloth, seed }
    }

    pub(crate) fn solid(&mut self, shape: Shape, piece_from_solid: Se3, material: Material) {
        self.solids.push(Solid {
            shape,
            material,
            world_from_solid: self.world_from_piece * piece_from_solid,
            object: 0,
        });
    }

    /// A box by its centre and half extents.
    pub(crate) fn block(&mut self, centre: [f64; 3], half: [f64; 3], material: Material) {
        self.turned_block(centre, half, 0.0, material);
    }

    /// The same, turned about the vertical through its centre.
    pub(crate) fn turned_block(
        &mut self,
        centre: [f64; 3],
        half: [f64; 3],
        angle_rad: f64,
        material: Material,
    ) {
        let shape = Shape::Block { half: half.into() };
        self.solid(shape, Se3::new(yaw(angle_rad), centre.into()), material);
    }

    /// An upright cylinder.
    pub(crate) fn drum(
        &mut self,
        centre: [f64; 3],
        radius: f64,
        half_height: f64,
        material: Material,
    ) {
        let shape = Shape::Drum {
            radius,
            half_height,
        };
        self.solid(shape, Se3::new(So3::identity(), centre.into()), material);
    }

    pub(crate) fn ellipsoid(&mut self, centre: [f64; 3], radii: [f64; 3], material: Material) {
        let shape = Shape::Ellipsoid {
            radii: radii.into(),
        };
        self.solid(shape, Se3::new(So3::identity(), centre.into()), material);
    }

    /// A round rod between two points.
    pub(crate) fn rod(
        &mut self,
        from: [f64; 3],
        to: [f64; 3],
        r0: f64,
        r1: f64,
        material: Material,
    ) {
        let (from, to): (Vector3<f64>, Vector3<f64>) = (from.into(), to.into());
        let shape = Shape::Limb {
            r0,
            r1,
            length: (to - from).norm(),
        };
        let rotation = rotation_along(&(to - from), &Vector3::x());
        self.solid(shape, Se3::new(rotation, from), material);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_along_maps_z_and_is_a_rotation() {
        let x = Vector3::x();
        for z in [
            Vector3::new(0.0, 0.0, -2.0),
            Vector3::new(0.3, -0.4, 0.1),
            x,
            -x,
        ] {
            let r = rotation_along(&z, &x);
            assert!((r * Vector3::z() - z.normalize()).norm() < 1e-14, "{z:?}");
            assert!((r.matrix().determinant() - 1.0).abs() < 1e-14, "{z:?}");
        }
        let upright = rotation_along(&Vector3::z(), &x);
        assert!(upright.angle_rad() < 1e-14, "the identity");
    }

    #[test]
    fn pieces_are_rotated_and_moved() {
        let mut b = Builder::new(1);
        b.at(1.0, 2.0, 0.0, std::f64::consts::FRAC_PI_2);
        b.rod(
            [1.0, 0.0, 0.0],
            [1.0, 0.0, 0.5],
            0.1,
            0.1,
            Material::Shade { tone: [0.5; 3] },
        );
        // x of the piece is y of the world
        let foot = b.solids[0].world_from_solid * Vector3::zeros();
        assert!(
            (foot - Vector3::new(1.0, 3.0, 0.0)).norm() < 1e-14,
            "{foot}"
        );
    }
}
