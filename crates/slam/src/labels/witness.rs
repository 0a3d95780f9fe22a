//! [`Witness`]: what one depth picture says about a point of the world.
//!
//! A camera that measured 3 m along a ray saw through everything nearer. A point that is now found
//! in front of that surface was not there then: it has come. A point of the map that the present
//! picture sees through is not there now: it has gone. Both are one test, and unlike the opposite
//! (a point behind the surface may simply be hidden) it proves something.
//!
//! ```text
//! camera of the witness ────────── empty ──────────┃ surface ░░ hidden ░░
//!                            a point here moved      here it agrees   nothing to say
//! ```

use garad_core::{Camera, DepthImage, Image, MaskImage, Se3};
use garad_crf::DepthNoise;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::mask::MOVING;

/// Side of the cells the picture is summed up in, px.
pub(crate) const CELL_PX: usize = 4;

/// Depth that a moving thing may have within 12 pixels, metres.
const BODY_M: f64 = 0.2;

/// A depth picture in cells of 4 x 4 pixels.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Witness {
    /// Nearest and farthest depth in the 3 x 3 cells around, metres; 0 where there is none.
    near: Image<f32>,
    far: Image<f32>,
    /// What moved there, if it has been said.
    moving: Option<MaskImage>,
}

/// What a witness has to say about a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Testimony {
    /// Outside of the picture, or no depth there.
    Absent,
    /// Behind the surface.
    Hidden,
    /// On the surface, which was taken for static (`true`) or for moving.
    Agrees(bool),
    /// In front of the nearest surface around, by so many standard deviations of the sensor.
    SeenThrough(f64),
}

impl Witness {
    /// Depth in metres; 0 and NaN are missing, and so is what lies beyond `max_depth_m`.
    pub(crate) fn new(depth: &DepthImage, max_depth_m: f64) -> Self {
        let (width, height) = depth.size();
        let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let mut near = Image::new(columns, rows, f32::INFINITY);
        let mut far = Image::new(columns, rows, 0.0f32);
        for y in 0..height {
            let row = y / CELL_PX;
            for (x, &z) in depth.row(y).iter().enumerate() {
                if z > 0.0 && f64::from(z) <= max_depth_m {
                    let cell = (x / CELL_PX, row);
                    near[cell] = near[cell].min(z);
                    far[cell] = far[cell].max(z);
                }
            }
        }
        let least = around(&near, f32::INFINITY, f32::min);
        Self {
            near: least.map(|z| if z.is_finite() { *z } else { 0.0 }),
            far: around(&far, 0.0, f32::max),
            moving: None,
        }
    }

    /// The mask of what moves (255), in cells.
    pub(crate) fn set_moving(&mut self, cells: MaskImage) {
        self.moving = Some(cells);
    }

    /// What this picture, taken by `camera` from this pose, says about a point.
    pub(crate) fn testify(
        &self,
        p_world: &Vector3<f64>,
        camera: &Camera,
        camera_from_world: &Se3,
        noise: &DepthNoise,
    ) -> Testimony {
        let p_cam = *camera_from_world * *p_world;
        let Some((x, y)) = cell_of(&p_cam, camera) else {
            return Testimony::Absent;
        };
        let (Some(&near), Some(&far)) = (self.near.get(x, y), self.far.get(x, y)) else {
            return Testimony::Absent;
        };
        if near <= 0.0 {
            return Testimony::Absent;
        }
        let (z, near, far) = (p_cam.z, f64::from(near), f64::from(far));
        let sigma_m = noise.sigma_m(near);
        if z < near - sigma_m {
            Testimony::SeenThrough((near - z) / sigma_m)
        } else if z <= far + 3.0 * sigma_m {
            let moving = self.moving.as_ref().and_then(|m| m.get(x, y)) == Some(&MOVING);
            // Where something moves, what lies behind it is not part of it.
            match moving && z > near + BODY_M {
                true => Testimony::Hidden,
                false => Testimony::Agrees(!moving),
            }
        } else {
            Testimony::Hidden
        }
    }
}

/// A witness, where it stood and how long ago.
#[derive(Debug)]
pub(crate) struct Statement<'a> {
    pub(crate) witness: &'a Witness,
    pub(crate) camera_from_world: Se3,
    /// Frames between.
    pub(crate) age: u32,
}

/// All that are asked about a frame.
#[derive(Debug)]
pub(crate) struct Court<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) noise: &'a DepthNoise,
    pub(crate) statements: Vec<Statement<'a>>,
}

/// What all witnesses together say about a point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Verdict {
    /// How far it stands in front of what was seen behind it, in standard deviations of the sensor:
    /// the largest that any witness says, 0 if all that know of it agree, `None` if none does.
    pub(crate) residual: Option<f64>,
    /// Age of the oldest witness that agrees, frames.
    pub(crate) agreed_for: u32,
}

impl Court<'_> {
    pub(crate) fn hear(&self, p_world: &Vector3<f64>) -> Verdict {
        let mut verdict = Verdict::default();
        for Statement {
            witness,
            camera_from_world,
            age,
        } in &self.statements
        {
            let before = verdict.residual.unwrap_or(0.0);
            match witness.testify(p_world, self.camera, camera_from_world, self.noise) {
                Testimony::SeenThrough(sigmas) => verdict.residual = Some(before.max(sigmas)),
                Testimony::Agrees(true) => {
                    verdict.residual = Some(before);
                    verdict.agreed_for = verdict.agreed_for.max(*age);
                }
                Testimony::Agrees(false) | Testimony::Hidden | Testimony::Absent => {}
            }
        }
        verdict
    }
}

/// The cell a point of the camera's frame falls into; `None` behind the camera or beside the picture.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "compared with the picture's bounds before the cast"
)]
fn cell_of(p_cam: &Vector3<f64>, camera: &Camera) -> Option<(usize, usize)> {
    let px: Vector2<f64> = camera.distort_pixel(&camera.project(p_cam)?);
    let (x, y) = ((px.x + 0.5).floor(), (px.y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64;
    inside.then_some((x as usize / CELL_PX, y as usize / CELL_PX))
}

/// `best` of the 3 x 3 cells around each.
fn around(cells: &Image<f32>, worst: f32, best: impl Fn(f32, f32) -> f32) -> Image<f32> {
    let (width, height) = cells.size();
    let of = |values: &mut dyn Iterator<Item = f32>| values.fold(worst, &best);
    let rows = Image::from_fn(width, height, |x, y| {
        let row = cells.row(y);
        of(&mut row[x.saturating_sub(1)..(x + 2).min(width)].iter().copied())
    });
    Image::from_fn(width, height, |x, y| {
        of(&mut (y.saturating_sub(1)..(y + 2).min(height)).map(|y| rows[(x, y)]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid")
    }

    fn testify(witness: &Witness, p: [f64; 3]) -> Testimony {
        let noise = DepthNoise {
            per_m: 0.0,
            floor_m: 0.1,
        };
        witness.testify(&Vector3::from(p), &camera(), &Se3::identity(), &noise)
    }

    #[test]
    fn a_point_belongs_to_the_cell_of_the_nearest_pixel() {
        // At z = 60 m, x and y are pixels from (31.5, 23.5); pixels 0 to 3 are the first cell.
        let cell = |u: f64, v: f64| cell_of(&Vector3::new(u - 31.5, v - 23.5, 60.0), &camera());
        assert_eq!(cell(3.4, 0.0), Some((0, 0)), "pixel 3");
        assert_eq!(cell(3.6, 0.0), Some((1, 0)), "pixel 4");
        assert_eq!(cell(0.0, 7.4), Some((0, 1)), "pixel 7");
        assert_eq!(cell(0.0, 7.6), Some((0, 2)), "pixel 8");
        assert_eq!(cell(-0.4, 47.4), Some((0, 11)), "the outermost pixels");
        assert_eq!(cell(-0.6, 0.0), None, "left of them");
        assert_eq!(cell(0.0, 47.6), None, "below them");
    }

    #[test]
    fn through_on_behind_beside() {
        let mut witness = Witness::new(&DepthImage::new(64, 48, 3.0), 8.0);
        assert_eq!(
            testify(&witness, [0.0, 0.0, 2.5]),
            Testimony::SeenThrough(5.0),
            "half a metre of empty space, σ 0.1 m"
        );
        assert_eq!(
            testify(&witness, [0.0, 0.0, 2.95]),
            Testimony::Agrees(true),
            "within a σ"
        );
        assert_eq!(
            testify(&witness, [0.0, 0.0, 3.5]),
            Testimony::Hidden,
            "behind"
        );
        assert_eq!(
            testify(&witness, [9.0, 0.0, 3.0]),
            Testimony::Absent,
            "beside"
        );
        assert_eq!(
            testify(&witness, [0.0, 0.0, -1.0]),
            Testimony::Absent,
            "behind the camera"
        );
        witness.set_moving(MaskImage::new(16, 12, MOVING));
        assert_eq!(
            testify(&witness, [0.0, 0.0, 3.0]),
            Testimony::Agrees(false),
            "on something that moved"
        );
    }

    #[test]
    fn an_edge_nearby_is_given_the_benefit_of_the_doubt() {
        let depth = DepthImage::from_fn(64, 48, |x, _| match x {
            0..=31 => 1.0,
            32..=47 => 3.0,
            _ => 0.0,
        });
        let witness = Witness::new(&depth, 8.0);
        // The ray of column 33 shows 3 m, but 1 m is a cell away.
        let beside_the_edge = [1.5 / 60.0 * 2.0, 0.0, 2.0];
        assert_eq!(
            testify(&witness, beside_the_edge),
            Testimony::Agrees(true),
            "between the two surfaces"
        );
        let away_from_it = [11.0 / 60.0 * 2.0, 0.0, 2.0];
        assert_eq!(
            testify(&witness, away_from_it),
            Testimony::SeenThrough(10.0),
            "only 3 m around"
        );
        let missing = [28.0 / 60.0 * 2.0, 0.0, 2.0];
        assert_eq!(testify(&witness, missing), Testimony::Absent, "no depth");
    }
}
