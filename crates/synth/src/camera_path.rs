//! The path of the camera: slow arcs, and the tremor of the hand that holds it.

use garad_core::{Rng, Se3, So3};
use nalgebra::{Matrix3, Vector3};

use crate::config::SceneName;

/// A smooth motion with six degrees of freedom, defined for every time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CameraPath {
    name: SceneName,
    /// Phases of the tremor.
    phases: [f64; 12],
}

/// Amplitude of the motion of [`SceneName::InStep`], metres, and its rate, rad/s.
pub(crate) const IN_STEP: (f64, f64) = (1.2, 0.35);

impl CameraPath {
    pub(crate) fn new(name: SceneName, seed: u64) -> Self {
        let mut rng = Rng::keyed(seed, &[0xCA]);
        Self {
            name,
            phases: std::array::from_fn(|_| rng.range(0.0, std::f64::consts::TAU)),
        }
    }

    /// Exact pose at a time.
    pub(crate) fn world_from_camera(&self, t_s: f64) -> Se3 {
        // Neither motion nor tremor on a tripod.
        if self.name == SceneName::Tripod {
            let (position, target) = self.arc(0.0);
            return look_at(position, target);
        }
        let (position, target) = self.arc(t_s);
        let [dx, dy, dz, rx, ry, rz] = self.tremor(t_s);
        let world_from_arc = look_at(position, target);
        let shake = Se3::new(
            So3::exp(&Vector3::new(rx, ry, rz)),
            Vector3::new(dx, dy, dz),
        );
        world_from_arc * shake
    }

    /// (position, the point looked at), metres.
    fn arc(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let v = Vector3::new;
        let s = |rate: f64, phase: f64| libm::sin(rate * t + phase);
        match self.name {
            SceneName::QuietDesk => {
                let desk = v(0.35, 1.50, 0.88);
                let (sin, cos) = libm::sincos(0.65 * s(0.5, 0.0));
                let r = 1.30 + 0.20 * s(0.45, 0.5);
                let eye = v(
                    desk.x + r * sin,
                    desk.y - r * cos,
                    1.38 + 0.16 * s(0.8, 1.0),
                );
                (eye, desk + v(0.20 * s(0.6, 0.3), 0.0, 0.08 * s(0.7, 0.0)))
            }
            SceneName::Walking
            | SceneName::StopAndGo
            | SceneName::ComesToRest
            | SceneName::SetsOff
            | SceneName::Tripod
            | SceneName::LightsOut => (
                v(
                    -1.72 + 0.34 * s(0.8, 0.0),
                    -1.28 + 0.26 * s(0.63, 1.0),
                    1.45 + 0.10 * s(0.9, 0.4),
                ),
                v(
                    0.75 + 0.40 * s(0.5, 0.2),
                    0.55 + 0.35 * s(0.6, 2.0),
                    0.95 + 0.12 * s(0.7, 0.0),
                ),
            ),
            SceneName::Crowd | SceneName::Huddle => (
                v(
                    -1.72 + 0.26 * s(0.9, 0.0),
                    -1.28 + 0.24 * s(0.7, 1.0),
                    1.55 + 0.08 * s(0.9, 0.4),
                ),
                v(
                    0.65 + 0.30 * s(0.5, 0.2),
                    0.50 + 0.30 * s(0.6, 2.0),
                    1.12 + 0.10 * s(0.7, 0.0),
                ),
            ),
            // Among many people the camera moves little.
            SceneName::Throng => (
                v(
                    -1.80 + 0.14 * s(1.3, 0.0),
                    -1.34 + 0.12 * s(1.1, 1.0),
                    1.55 + 0.06 * s(0.9, 0.4),
                ),
                v(
                    0.65 + 0.25 * s(0.5, 0.2),
                    0.50 + 0.25 * s(0.6, 2.0),
                    1.15 + 0.08 * s(0.7, 0.0),
                ),
            ),
            SceneName::InStep => {
                let (reach, rate) = IN_STEP;
                let x = reach * s(rate, 0.0);
                (
                    v(x, -1.45, 1.42 + 0.05 * s(0.9, 0.0)),
                    v(x + 0.42 * s(0.7, 0.0), 2.0, 1.05 + 0.08 * s(0.7, 0.4)),
                )
            }
            // Counter-clockwise, looking ahead and inwards; 44 m and 45 s a lap.
            SceneName::Hall => {
                let (sin, cos) = libm::sincos(0.14 * t - 1.9);
                let eye = v(8.0 * cos, 6.0 * sin, 1.55 + 0.012 * s(11.0, 0.0));
                let heading = libm::atan2(6.0 * cos, -8.0 * sin);
                let (sin, cos) = libm::sincos(heading + 0.40 + 0.33 * s(0.9, 0.0));
                (
                    eye,
                    eye + v(10.0 * cos, 10.0 * sin, -0.6 + 0.5 * s(0.7, 0.4)),
                )
            }
            SceneName::Loop => {
                let (sin, cos) = libm::sincos(0.25 * t);
                (
                    v(1.75 * cos, 1.30 * sin, 1.52 + 0.08 * s(0.6, 0.0)),
                    v(-0.6 * cos, -0.5 * sin, 0.98 + 0.12 * s(0.41, 0.0)),
                )
            }
        }
    }

    /// (metres x 3, radians x 3) in the camera's frame: two sines per axis.
    fn tremor(&self, t: f64) -> [f64; 6] {
        std::array::from_fn(|axis| {
            let (slow, fast) = if axis < 3 {
                (0.010, 0.0015)
            } else {
                (0.009, 0.0025)
            };
            let rate = 2.1 + 0.37 * axis as f64;
            slow * libm::sin(rate * t + self.phases[2 * axis])
                + fast * libm::sin(4.3 * rate * t + self.phases[2 * axis + 1])
        })
    }
}

/// The pose that looks from one point to another with a level horizon.
fn look_at(from: Vector3<f64>, to: Vector3<f64>) -> Se3 {
    let forward = (to - from).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let down = forward.cross(&right);
    let world_from_camera = Matrix3::from_columns(&[right, down, forward]);
    Se3::new(So3::from_matrix(&world_from_camera), from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{hall, room};

    /// Distance from the walls, metres; negative outside.
    fn clearance(name: SceneName, p: &Vector3<f64>) -> f64 {
        let [x, y, z] = match name {
            SceneName::Hall => hall::HALF,
            _ => room::HALF,
        };
        (x - p.x.abs()).min(y - p.y.abs()).min(z - (p.z - z).abs())
    }

    #[test]
    fn look_at_points_the_camera_and_keeps_up() {
        let pose = look_at(Vector3::new(1.0, 2.0, 1.5), Vector3::new(3.0, 2.0, 1.5));
        let p_cam = pose.inverse() * Vector3::new(3.0, 2.0, 2.0);
        assert!(
            (p_cam - Vector3::new(0.0, -0.5, 2.0)).norm() < 1e-14,
            "{p_cam}"
        );
        let left = pose.inverse() * Vector3::new(3.0, 3.0, 1.5);
        assert!(left.x < 0.0, "+y is to the left of +x");
    }

    /// Speeds of a hand-held camera, 0.1 to 0.6 m/s, in the hall of a walk, 0.8 to 1.2 m/s; below 45°/s, and
    /// never through a wall.
    #[test]
    fn speeds_are_those_of_a_hand_held_camera() {
        let by_hand = SceneName::all().into_iter();
        for name in by_hand.filter(|&name| name != SceneName::Tripod) {
            let path = CameraPath::new(name, 1);
            let (mut way, mut turn, mut fastest, mut sharpest) = (0.0, 0.0, 0.0f64, 0.0f64);
            let h = 1.0 / 30.0;
            for k in 0..900 {
                let a = path.world_from_camera(h * f64::from(k));
                let b = path.world_from_camera(h * f64::from(k + 1));
                assert!(clearance(name, &a.translation) > 0.4, "{name} at frame {k}");
                let step = (b.translation - a.translation).norm();
                let angle = (a.inverse() * b).rotation.angle_rad().to_degrees();
                way += step;
                turn += angle;
                fastest = fastest.max(step / h);
                sharpest = sharpest.max(angle / h);
            }
            let (means, limit) = match name {
                SceneName::Hall => (0.8..1.2, 1.4),
                _ => (0.12..0.6, 0.7),
            };
            let mean = way / 30.0;
            assert!(means.contains(&mean), "{name}: {mean} m/s");
            assert!(fastest < limit, "{name}: {fastest} m/s");
            assert!(
                sharpest < 45.0 && turn / 30.0 > 4.0,
                "{name}: {sharpest}, {} deg/s",
                turn / 30.0
            );
        }
    }

    #[test]
    fn a_lap_of_the_loop_is_ten_metres() {
        let path = CameraPath::new(SceneName::Loop, 1);
        let lap_s = std::f64::consts::TAU / 0.25;
        let place = |k: i32| path.arc(lap_s * f64::from(k) / 2000.0).0;
        let length: f64 = (0..2000).map(|k| (place(k + 1) - place(k)).norm()).sum();
        assert!((length - 9.7).abs() < 0.1, "{length} m");
    }
}
