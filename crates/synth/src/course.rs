//! [`Course`]: the path of a moving object, and its schedule.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

/// When an object moves: a clock that can stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Schedule {
    /// Always.
    Steady,
    /// Moves from `start_s`, which may be before the recording, to `stop_s`, which may be infinite; at
    /// rest before and after.
    Once { start_s: f64, stop_s: f64 },
    /// At rest until `first_s`, then alternately `go_s` of motion and `stop_s` of rest. Starting and
    /// stopping take [`RAMP_S`] each and are part of `go_s`.
    StopAndGo {
        first_s: f64,
        go_s: f64,
        stop_s: f64,
    },
}

/// Time to reach full speed, seconds.
const RAMP_S: f64 = 0.4;

impl Schedule {
    /// (τ, dτ/dt): the time of the object and its rate, 0 at rest to 1 in motion.
    ///
    /// The pace rises as ½ - ½ cos(π x / RAMP_S), whose integral is ½ (x - RAMP_S/π sin(π x / RAMP_S)).
    pub(crate) fn own_time(&self, t_s: f64) -> (f64, f64) {
        match *self {
            Self::Steady => (t_s, 1.0),
            Self::Once { start_s, stop_s } => one_go(t_s - start_s, stop_s - start_s),
            Self::StopAndGo {
                first_s,
                go_s,
                stop_s,
            } => {
                let since = (t_s - first_s).max(0.0);
                let turns = (since / (go_s + stop_s)).floor();
                let (within, pace) = one_go(since - turns * (go_s + stop_s), go_s);
                // own time that passes in one motion
                let a_turn = go_s - RAMP_S;
                (turns * a_turn + within, pace)
            }
        }
    }
}

/// (τ, dτ/dt) at `x` seconds after the start of a motion that lasts `go_s`, ramps included.
fn one_go(x: f64, go_s: f64) -> (f64, f64) {
    let rise = |x: f64| 0.5 * (x - RAMP_S / PI * libm::sin(PI * x / RAMP_S));
    let pace = |x: f64| 0.5 - 0.5 * libm::cos(PI * x / RAMP_S);
    if x <= 0.0 {
        (0.0, 0.0)
    } else if x < RAMP_S {
        (rise(x), pace(x))
    } else if x < go_s - RAMP_S {
        (x - 0.5 * RAMP_S, 1.0)
    } else if x < go_s {
        (go_s - RAMP_S - rise(go_s - x), pace(go_s - x))
    } else {
        (go_s - RAMP_S, 0.0)
    }
}

/// An ellipse on the floor, or a point if both half axes are 0.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Course {
    centre: Vector2<f64>,
    half_axes: [f64; 2],
    turn_rad: f64,
    rate_rad_s: f64,
    phase_rad: f64,
    schedule: Schedule,
    /// Arc length from angle 0 to each of [`STEPS`] + 1 equal steps, metres.
    lengths: Vec<f64>,
}

const STEPS: usize = 256;

/// Place of an object at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Metres.
    pub(crate) at: Vector2<f64>,
    /// Direction of travel from +x towards +y, radians.
    pub(crate) heading_rad: f64,
    /// Arc length travelled, metres.
    pub(crate) gone_m: f64,
    /// 0 at rest to 1 in motion.
    pub(crate) pace: f64,
    /// Clock of motions on the spot, such as looking around, seconds. It stops for good with
    /// [`Schedule::Once`].
    pub(crate) idle_s: f64,
}

impl Course {
    /// An ellipse with half axes along and across `turn_rad`, at a constant rate.
    pub(crate) fn ellipse(
        centre: [f64; 2],
        half_axes: [f64; 2],
        turn_rad: f64,
        rate_rad_s: f64,
        phase_rad: f64,
    ) -> Self {
        let speed = |angle: f64| {
            let (sin, cos) = libm::sincos(angle);
            libm::hypot(half_axes[0] * sin, half_axes[1] * cos)
        };
        let h = TAU / STEPS as f64;
        let mut lengths = vec![0.0; STEPS + 1];
        for k in 0..STEPS {
            let a = h * k as f64;
            // Simpson's rule
            lengths[k + 1] =
                lengths[k] + h / 6.0 * (speed(a) + 4.0 * speed(a + 0.5 * h) + speed(a + h));
        }
        Self {
            centre: centre.into(),
            half_axes,
            turn_rad,
            rate_rad_s,
            phase_rad,
            schedule: Schedule::Steady,
            lengths,
        }
    }

    /// Standing, looking along `heading_rad`.
    pub(crate) fn spot(at: [f64; 2], heading_rad: f64) -> Self {
        Self::ellipse(at, [0.0; 2], heading_rad, 0.0, 0.0)
    }

    pub(crate) fn with_schedule(self, schedule: Schedule) -> Self {
        Self { schedule, ..self }
    }

    pub(crate) fn place(&self, t_s: f64) -> Place {
        let (own, pace) = self.schedule.own_time(t_s);
        let angle = self.phase_rad + self.rate_rad_s * own;
        let (sin, cos) = libm::sincos(angle);
        let (turn_sin, turn_cos) = libm::sincos(self.turn_rad);
        let along =
            |x: f64, y: f64| Vector2::new(turn_cos * x - turn_sin * y, turn_sin * x + turn_cos * y);
        let [a, b] = self.half_axes;
        let velocity = along(-a * sin, b * cos) * self.rate_rad_s;
        let stands = velocity.norm() <= 0.0;
        Place {
            at: self.centre + along(a * cos, b * sin),
            heading_rad: if stands {
                self.turn_rad
            } else {
                libm::atan2(velocity.y, velocity.x)
            },
            gone_m: self.length(angle).abs(),
            pace: if stands { 0.0 } else { pace },
            idle_s: match self.schedule {
                Schedule::Once { .. } => own,
                Schedule::Steady | Schedule::StopAndGo { .. } => t_s,
            },
        }
    }

    /// Arc length from angle 0; negative for negative angles.
    fn length(&self, angle: f64) -> f64 {
        let laps = (angle / TAU).floor();
        let x = (angle / TAU - laps) * STEPS as f64;
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0 <= x <= STEPS"
        )]
        let k = (x as usize).min(STEPS - 1);
        let within = self.lengths[k] + (self.lengths[k + 1] - self.lengths[k]) * (x - k as f64);
        laps * self.lengths[STEPS] + within
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_time_is_the_integral_of_the_pace() {
        let schedule = Schedule::StopAndGo {
            first_s: 1.0,
            go_s: 2.0,
            stop_s: 1.5,
        };
        let (mut integral, h) = (0.0, 1e-3);
        for k in 0..9000 {
            let t = h * f64::from(k);
            let (own, pace) = schedule.own_time(t);
            assert!(
                (own - integral).abs() < 1e-6,
                "at {t}: {own} against {integral}"
            );
            assert!((0.0..=1.0).contains(&pace), "pace {pace}");
            integral += h * schedule.own_time(t + 0.5 * h).1;
        }
        let once = Schedule::Once {
            start_s: 1.0,
            stop_s: 3.0,
        };
        for k in 0..250 {
            let t = 0.01 * f64::from(k);
            assert_eq!(
                once.own_time(t),
                schedule.own_time(t),
                "the first go, at {t}"
            );
        }
        assert_eq!(once.own_time(9.0), once.own_time(3.0), "and no other");
        let for_ever = Schedule::Once {
            start_s: -1.0,
            stop_s: f64::INFINITY,
        };
        let (own, pace) = for_ever.own_time(7.0);
        assert!((own - 7.8).abs() < 1e-12 && pace >= 1.0, "{own}, {pace}");
        assert!(schedule.own_time(0.99).1 <= 0.0, "still at first");
        assert!(schedule.own_time(3.2).1 <= 0.0, "still again");
        assert!(schedule.own_time(5.0).1 >= 1.0, "goes again");
    }

    #[test]
    fn circles_have_the_right_length_and_heading() {
        let course = Course::ellipse([1.0, 2.0], [0.5, 0.5], 0.3, 2.0, 0.0);
        for k in 1..20 {
            let t = 0.3 * f64::from(k);
            let place = course.place(t);
            assert!(
                (place.gone_m - t).abs() < 1e-9,
                "1 m/s for {t} s: {}",
                place.gone_m
            );
            let h = 1e-6;
            let step = (course.place(t + h).at - place.at) / h;
            let (sin, cos) = libm::sincos(place.heading_rad);
            assert!(
                (step - Vector2::new(cos, sin)).norm() < 1e-5,
                "heading at {t}"
            );
        }
        let spot = Course::spot([1.0, 2.0], 0.7).place(5.0);
        assert!(
            (spot.heading_rad - 0.7).abs() < 1e-15 && spot.pace <= 0.0,
            "{spot:?}"
        );
    }
}
