//! [`Figure`]: a person made of round solids.
//!
//! Frame of a figure: x forward, y left, z up, the origin on the floor between the feet. Every part is
//! rigid; the walk is in [`crate::gait`].

use std::f64::consts::TAU;

use garad_core::{Se3, So3};
use nalgebra::Vector3;

use crate::clothes::Cloth;
use crate::gait::{ANKLE_M, BONE_M, HIP_M, STRIDE_M, ankle, knee, lift};
use crate::material::Material;
use crate::pattern::Rgb;
use crate::shape::Shape;
use crate::solid::rotation_along;

const UPPER_ARM_M: f64 = 0.28;
const FOREARM_M: f64 = 0.25;

/// Sway of a talking person: the weight shifts between the feet and the trunk turns with the arms. In
/// unconstrained standing people shift by several centimetres every few seconds (Duarte and Zatsiorsky
/// 1999). (amplitude, metres or radians; rate, rad/s; share of the phase of the figure) forward, to the
/// left, and about the vertical axis.
const SWAY: [(f64, f64, f64); 3] = [(0.030, 0.7, 1.7), (0.045, 1.1, 1.0), (0.14, 0.9, 0.6)];
/// Lowering of the hips of a swaying person, metres: straight knees do not allow sway.
const SWAY_BEND_M: f64 = 0.035;

/// Motion of the arms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Arms {
    /// Swing against the legs.
    Swing,
    /// Hold a box in front of the chest.
    Carry,
    /// Gestures of a talking person.
    Gesture,
}

/// Appearance of a person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Figure {
    pub(crate) height_m: f64,
    pub(crate) shirt: Cloth,
    pub(crate) trousers: Cloth,
    pub(crate) skin: Rgb,
    pub(crate) hair: Rgb,
    pub(crate) long_hair: bool,
    pub(crate) short_sleeves: bool,
    pub(crate) skirt: bool,
    pub(crate) backpack: bool,
    pub(crate) arms: Arms,
    pub(crate) seed: u32,
}

/// One rigid part.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) shape: Shape,
    pub(crate) material: Material,
    pub(crate) figure_from_part: Se3,
}

/// Phase of the motion of a figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Step {
    /// Distance walked, metres.
    pub(crate) gone_m: f64,
    /// Clock of motions on the spot, seconds.
    pub(crate) t_s: f64,
    /// 0: arms and hips at rest. 1: full swing.
    pub(crate) pace: f64,
}

/// The box held by [`Arms::Carry`]: centre and half extents.
pub(crate) const LOAD: ([f64; 3], [f64; 3]) = ([0.36, 0.0, 1.10], [0.13, 0.19, 0.14]);

/// Collects parts in units of a figure 1.75 m tall.
struct Body {
    k: f64,
    /// Displacement of the upper body by sway, if any.
    sway: Option<Se3>,
    parts: Vec<Part>,
}

impl Body {
    fn ellipsoid(&mut self, at: Vector3<f64>, rotation: So3, radii: [f64; 3], material: Material) {
        let shape = Shape::Ellipsoid {
            radii: Vector3::from(radii) * self.k,
        };
        self.push(shape, Se3::new(rotation, at), material);
    }

    /// From `at` in the direction of `to`; `length` is given so that it is constant.
    fn limb(
        &mut self,
        at: Vector3<f64>,
        to: Vector3<f64>,
        length: f64,
        [r0, r1]: [f64; 2],
        material: Material,
    ) {
        let k = self.k;
        let shape = Shape::Limb {
            r0: r0 * k,
            r1: r1 * k,
            length: length * k,
        };
        let rotation = rotation_along(&(to - at), &Vector3::x());
        self.push(shape, Se3::new(rotation, at), material);
    }

    fn push(&mut self, shape: Shape, pose: Se3, material: Material) {
        let pose = self.sway.map_or(pose, |sway| sway * pose);
        let figure_from_part = Se3::new(pose.rotation, pose.translation * self.k);
        self.parts.push(Part {
            shape,
            material,
            figure_from_part,
        });
    }
}

impl Figure {
    /// Every part at a time, always the same shapes in the same order.
    pub(crate) fn parts(&self, step: &Step) -> Vec<Part> {
        let k = self.height_m / 1.75;
        let mut body = Body {
            k,
            sway: None,
            parts: Vec::with_capacity(26),
        };
        let cycle = step.gone_m / (STRIDE_M * k);
        let swing = libm::sin(TAU * (cycle + 0.10));
        let lift = lift(cycle);
        let sway = self.sway(step.t_s);
        self.legs(&mut body, cycle, sway.as_ref());
        body.sway = sway;
        self.torso(&mut body, swing * step.pace, lift, step.t_s);
        self.arms(&mut body, swing * step.pace, lift, step.t_s);
        body.parts
    }

    /// Displacement of the trunk by sway. `None` for a person who does not sway.
    fn sway(&self, t_s: f64) -> Option<Se3> {
        let phase = f64::from(self.seed % 628) * 0.01;
        let of =
            |(half, rate, share): (f64, f64, f64)| half * libm::sin(rate * t_s + share * phase);
        let [x, y, yaw] = SWAY.map(of);
        (self.arms == Arms::Gesture).then(|| {
            let turn = So3::exp(&Vector3::new(0.0, 0.0, yaw));
            Se3::new(turn, Vector3::new(x, y, -SWAY_BEND_M))
        })
    }

    fn shirt(&self) -> Material {
        Material::Fabric {
            cloth: self.shirt,
            seed: self.seed,
        }
    }

    fn bare(&self) -> Material {
        Material::Skin {
            tone: self.skin,
            seed: self.seed,
        }
    }

    fn legs(&self, body: &mut Body, cycle: f64, sway: Option<&Se3>) {
        let swayed = |p: Vector3<f64>| sway.map_or(p, |sway| *sway * p);
        let cloth = Material::Fabric {
            cloth: self.trousers,
            seed: self.seed ^ 1,
        };
        let tights = Material::Fabric {
            cloth: Cloth::Plain([0.30, 0.24, 0.26]),
            seed: self.seed ^ 4,
        };
        let leather = Material::Painted {
            tone: [0.20, 0.15, 0.13],
            seed: self.seed ^ 2,
        };
        for (side, shift) in [(1.0, 0.0), (-1.0, 0.5)] {
            let p = cycle + shift - (cycle + shift).floor();
            let (x, up) = ankle(p);
            let hip = swayed(Vector3::new(0.0, 0.09 * side, HIP_M + lift(cycle)));
            let foot = Vector3::new(x, 0.085 * side, ANKLE_M + up);
            let knee = knee(&hip, &foot);
            let leg = if self.skirt { tights } else { cloth };
            body.limb(hip, knee, BONE_M, [0.090, 0.062], leg);
            body.limb(knee, foot, BONE_M, [0.061, 0.043], leg);
            // toes point down while the foot is in the air
            let toe = foot + Vector3::new(0.19, 0.02 * side, -0.045 - 1.2 * up * (1.0 - p));
            let heel = foot + Vector3::new(-0.04, 0.0, -0.035);
            body.limb(heel, toe, 0.21, [0.045, 0.034], leather);
        }
        let hips = swayed(Vector3::new(0.0, 0.0, HIP_M + lift(cycle) + 0.02));
        if self.skirt {
            let waist = hips + Vector3::z() * 0.05;
            body.limb(waist, waist - Vector3::z(), 0.26, [0.150, 0.225], cloth);
        } else {
            body.ellipsoid(hips, So3::identity(), [0.118, 0.165, 0.13], cloth);
        }
    }

    fn torso(&self, body: &mut Body, swing: f64, lift: f64, t_s: f64) {
        let twist = So3::exp(&Vector3::new(0.0, 0.0, 0.10 * swing));
        let up = |z: f64| Vector3::new(0.04 * (z - HIP_M), 0.0, z + lift);
        body.limb(up(0.98), up(1.40), 0.28, [0.128, 0.138], self.shirt());
        body.ellipsoid(up(1.22), twist, [0.128, 0.185, 0.21], self.shirt());
        let across = twist * Vector3::y();
        body.limb(
            up(1.385) - across * 0.135,
            up(1.385) + across,
            0.27,
            [0.068, 0.068],
            self.shirt(),
        );
        body.limb(up(1.40), up(1.60), 0.14, [0.058, 0.052], self.bare());
        let phase = f64::from(self.seed % 628) * 0.01;
        let look = So3::exp(&Vector3::new(0.0, 0.0, 0.35 * libm::sin(0.9 * t_s + phase)));
        let head = up(1.63) + Vector3::new(0.01, 0.0, 0.0);
        let face = Material::Face {
            tone: self.skin,
            seed: self.seed,
        };
        body.ellipsoid(head, look, [0.100, 0.078, 0.122], face);
        body.ellipsoid(
            head + look * Vector3::new(0.098, 0.0, -0.01),
            look,
            [0.018, 0.013, 0.022],
            self.bare(),
        );
        for side in [-1.0, 1.0] {
            let ear = head + look * Vector3::new(-0.01, 0.077 * side, 0.0);
            body.ellipsoid(ear, look, [0.018, 0.008, 0.028], self.bare());
        }
        let hair = Material::Hair {
            tone: self.hair,
            seed: self.seed,
        };
        body.ellipsoid(
            head + look * Vector3::new(-0.022, 0.0, 0.034),
            look,
            [0.105, 0.088, 0.105],
            hair,
        );
        if self.long_hair {
            body.ellipsoid(
                head + look * Vector3::new(-0.062, 0.0, -0.10),
                look,
                [0.055, 0.082, 0.16],
                hair,
            );
        }
        if self.backpack {
            let pack = Material::Fabric {
                cloth: Cloth::Printed([0.22, 0.30, 0.24], [0.85, 0.55, 0.15]),
                seed: self.seed ^ 3,
            };
            let shape = Shape::Block {
                half: Vector3::new(0.075, 0.14, 0.20) * body.k,
            };
            body.push(
                shape,
                Se3::new(twist, up(1.18) - twist * Vector3::x() * 0.20),
                pack,
            );
        }
    }

    fn arms(&self, body: &mut Body, swing: f64, lift: f64, t_s: f64) {
        let phase = f64::from(self.seed % 97);
        let sleeve = if self.short_sleeves {
            self.bare()
        } else {
            self.shirt()
        };
        for side in [1.0, -1.0] {
            let shoulder = Vector3::new(0.02 - 0.02 * swing * side, 0.195 * side, 1.385 + lift);
            // angles from hanging down: raised forward, spread outward; then the bend of the elbow
            let (raise, spread, bend) = match self.arms {
                Arms::Swing => (-0.50 * swing * side, 0.10, 0.30 - 0.20 * swing * side),
                Arms::Carry => (0.38, 0.06, 1.15),
                Arms::Gesture => {
                    let w = libm::sin(2.3 * t_s + phase + 1.3 * side);
                    let slow = libm::sin(0.7 * t_s + phase + side);
                    (0.35 + 0.35 * slow, 0.22 + 0.10 * w, 1.30 + 0.45 * w)
                }
            };
            let direction = |angle: f64, spread: f64| {
                let (sin, cos) = libm::sincos(angle);
                Vector3::new(sin, side * spread, -cos)
            };
            let upper = direction(raise, spread).normalize();
            let inward = if self.arms == Arms::Swing {
                0.05
            } else {
                -0.12
            };
            let lower = direction(raise + bend, inward).normalize();
            let elbow = shoulder + upper * UPPER_ARM_M;
            let wrist = elbow + lower * FOREARM_M;
            body.limb(shoulder, elbow, UPPER_ARM_M, [0.058, 0.046], self.shirt());
            body.limb(elbow, wrist, FOREARM_M, [0.043, 0.033], sleeve);
            let hand = rotation_along(&lower, &Vector3::y());
            body.ellipsoid(
                wrist + lower * 0.07,
                hand,
                [0.035, 0.022, 0.085],
                self.bare(),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure(height_m: f64, arms: Arms) -> Figure {
        Figure {
            height_m,
            shirt: Cloth::Denim,
            trousers: Cloth::Denim,
            skin: [0.7, 0.5, 0.4],
            hair: [0.2; 3],
            long_hair: true,
            short_sleeves: true,
            skirt: false,
            backpack: true,
            arms,
            seed: 5,
        }
    }

    fn step(gone_m: f64) -> Step {
        Step {
            gone_m,
            t_s: 0.3 * gone_m,
            pace: 1.0,
        }
    }

    /// Parts are rigid: their shapes are constant.
    #[test]
    fn shapes_do_not_change() {
        for arms in [Arms::Swing, Arms::Carry, Arms::Gesture] {
            let figure = figure(1.9, arms);
            let first = figure.parts(&step(0.0));
            for k in 1..50 {
                let parts = figure.parts(&step(0.037 * f64::from(k)));
                assert_eq!(parts.len(), first.len(), "count");
                for (a, b) in parts.iter().zip(&first) {
                    assert_eq!(a.shape, b.shape, "rigid");
                }
            }
        }
    }

    /// A talking person sways by centimetres, within the reach of the legs; a walking person does not.
    #[test]
    fn talking_people_sway_over_standing_feet() {
        let talks = figure(1.75, Arms::Gesture);
        let (mut low, mut high) = (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        );
        for k in 0..400 {
            let sway = talks.sway(0.1 * f64::from(k)).expect("sways");
            low = low.inf(&sway.translation);
            high = high.sup(&sway.translation);
            for (side, p) in [(1.0, 0.0), (-1.0, 0.5)] {
                let (x, up) = ankle(p);
                let hip = sway * Vector3::new(0.0, 0.09 * side, HIP_M + lift(p));
                let foot = Vector3::new(x, 0.085 * side, ANKLE_M + up);
                assert!((foot - hip).norm() < 2.0 * BONE_M, "knee bends at {k}");
            }
        }
        let reach = high - low;
        assert!((0.058..0.0601).contains(&reach.x), "forward {}", reach.x);
        assert!((0.088..0.0901).contains(&reach.y), "aside {}", reach.y);
        for arms in [Arms::Swing, Arms::Carry] {
            assert!(figure(1.75, arms).sway(1.0).is_none(), "{arms:?}");
        }
    }

    #[test]
    fn figures_have_their_height() {
        for height in [1.55, 1.75, 1.9] {
            let top =
                figure(height, Arms::Swing)
                    .parts(&step(0.0))
                    .iter()
                    .fold(0.0f64, |top, p| {
                        let [_, high] = p.shape.bounds();
                        let upright = matches!(p.shape, Shape::Ellipsoid { .. });
                        if upright {
                            top.max(p.figure_from_part.translation.z + high.z)
                        } else {
                            top
                        }
                    });
            assert!((top / height - 1.0).abs() < 0.03, "{top} of {height}");
        }
    }
}
