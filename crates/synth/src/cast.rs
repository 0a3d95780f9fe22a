//! The moving objects and the furniture of each scene.

use std::f64::consts::PI;

use garad_core::Rng;

use crate::actor::{Actor, Role};
use crate::camera_path::IN_STEP;
use crate::clothes::Cloth;
use crate::config::SceneName;
use crate::course::{Course, Schedule};
use crate::figure::{Arms, Figure};
use crate::room::Furnishing;

/// Direction across the view of the scenes seen from the corner, radians.
const ACROSS_RAD: f64 = 2.2;

/// (person, metres away, metres to the left, amplitude in metres, rate, phase) of the people of
/// [`SceneName::Throng`].
const THRONG: [(usize, f64, f64, f64, f64, f64); 5] = [
    (0, 1.00, 0.46, 0.12, 1.6, 0.0),
    (2, 1.05, -0.44, 0.14, 1.5, 2.1),
    (1, 1.35, 0.02, 0.16, 1.4, 4.0),
    (3, 1.90, 0.45, 0.30, 1.2, 1.0),
    (0, 2.00, -0.45, 0.30, 1.2, 3.0),
];

/// Moves from before the recording until `stop_s`.
fn until(stop_s: f64) -> Schedule {
    Schedule::Once {
        start_s: -1.0,
        stop_s,
    }
}

/// Stands until `first_s`, then takes a few steps across the view in 1.6 s, stands for 1.2 s and goes back.
fn to_and_fro(centre: [f64; 2], phase_rad: f64, first_s: f64) -> Course {
    // half a lap in the 1.2 s that a motion has without its ramps
    Course::ellipse(centre, [0.36, 0.06], ACROSS_RAD, PI / 1.2, phase_rad).with_schedule(
        Schedule::StopAndGo {
            first_s,
            go_s: 1.6,
            stop_s: 1.2,
        },
    )
}

/// Stands until `start_s`, then moves for ever.
fn from(start_s: f64) -> Schedule {
    Schedule::Once {
        start_s,
        stop_s: f64::INFINITY,
    }
}

/// The furniture of a scene.
pub(crate) fn furnishing(name: SceneName) -> Furnishing {
    if name == SceneName::Hall {
        return Furnishing::Hall;
    }
    Furnishing::Room {
        plain_walls: matches!(
            name,
            SceneName::Crowd | SceneName::Throng | SceneName::Huddle
        ),
        middle_table: matches!(name, SceneName::QuietDesk | SceneName::Loop),
    }
}

/// The moving objects of a scene. Ids are 1, 2, ... in this order.
pub(crate) fn actors(name: SceneName, seed: u64) -> Vec<Actor> {
    let mut rng = Rng::keyed(seed, &[0xAC]);
    let mut cast = Cast {
        roles: Vec::new(),
        rng: &mut rng,
    };
    match name {
        SceneName::QuietDesk | SceneName::Loop => {}
        SceneName::Walking | SceneName::Tripod | SceneName::LightsOut => {
            cast.carrier(
                0,
                Course::ellipse([0.05, 0.02], [1.10, 0.22], ACROSS_RAD, 0.80, 2.3),
            );
            cast.person(
                1,
                Arms::Swing,
                Course::ellipse([0.98, 0.08], [0.72, 0.22], ACROSS_RAD, 1.05, 5.6),
            );
        }
        SceneName::Crowd | SceneName::Huddle => {
            let (nearest, on_the_left, on_the_right) = match name {
                SceneName::Huddle => {
                    let walks = Course::ellipse([-0.88, -0.64], [0.38, 0.08], ACROSS_RAD, 1.2, 1.0);
                    (
                        walks,
                        Course::spot([-0.80, 0.02], -1.5),
                        Course::spot([-0.18, -0.80], 2.9),
                    )
                }
                _ => {
                    let walks =
                        Course::ellipse([-0.88, -0.64], [0.50, 0.08], ACROSS_RAD, 1.3, 4.14);
                    (
                        walks,
                        to_and_fro([-0.72, -0.08], 0.0, 0.4),
                        to_and_fro([-0.26, -0.70], PI, 0.9),
                    )
                }
            };
            cast.person(2, Arms::Swing, nearest);
            cast.person(
                0,
                Arms::Swing,
                Course::ellipse([0.10, 0.06], [0.62, 0.12], ACROSS_RAD, 0.95, 3.4),
            );
            cast.person(1, Arms::Gesture, on_the_left);
            cast.person(3, Arms::Gesture, on_the_right);
        }
        SceneName::StopAndGo => {
            let turn = ACROSS_RAD + 0.25;
            let schedule = |first_s, go_s, stop_s| Schedule::StopAndGo {
                first_s,
                go_s,
                stop_s,
            };
            let course = Course::ellipse([0.25, -0.10], [0.85, 0.0], turn, 0.75, 2.9);
            cast.roles.push(Role::Trolley {
                course: course.with_schedule(schedule(1.2, 2.2, 1.6)),
                heading_rad: turn,
                seed: 71,
            });
            let course = Course::ellipse([0.28, 0.58], [0.25, 0.0], turn, 1.6, 0.2);
            cast.roles.push(Role::Ball {
                course: course.with_schedule(schedule(2.4, 1.8, 2.0)),
                heading_rad: turn,
                radius: 0.12,
                seed: 72,
            });
            let course = Course::ellipse([1.20, 0.20], [0.62, 0.20], ACROSS_RAD, 1.2, 4.4);
            cast.person(
                1,
                Arms::Swing,
                course.with_schedule(schedule(0.5, 2.6, 1.4)),
            );
        }
        SceneName::InStep => {
            let (reach, rate) = IN_STEP;
            let beside = |dx: f64, y: f64| {
                Course::ellipse(
                    [dx, y],
                    [reach, 0.10],
                    0.0,
                    rate,
                    -std::f64::consts::FRAC_PI_2,
                )
            };
            cast.person(0, Arms::Swing, beside(-0.36, 0.10));
            cast.person(3, Arms::Swing, beside(0.42, 0.38));
        }
        SceneName::ComesToRest => {
            let turn = ACROSS_RAD + 0.25;
            let course = Course::ellipse([0.25, -0.10], [0.85, 0.0], turn, 0.75, 4.1);
            cast.roles.push(Role::Trolley {
                course: course.with_schedule(until(1.5)),
                heading_rad: turn,
                seed: 71,
            });
            let course = Course::ellipse([1.20, 0.20], [0.62, 0.20], ACROSS_RAD, 1.2, 4.4);
            cast.person(1, Arms::Swing, course.with_schedule(until(2.0)));
        }
        SceneName::SetsOff => {
            let course = Course::ellipse([0.20, -0.15], [0.60, 0.0], ACROSS_RAD, 1.0, 0.6);
            cast.roles.push(Role::Chair {
                course: course.with_schedule(from(1.5)),
                heading_rad: 2.0,
                seed: 73,
            });
            let course = Course::ellipse([1.10, 0.30], [0.70, 0.22], ACROSS_RAD, 1.1, 2.4);
            cast.person(2, Arms::Swing, course.with_schedule(from(2.2)));
        }
        SceneName::Hall => cast.person(
            0,
            Arms::Swing,
            Course::ellipse([3.4, -1.9], [2.6, 1.7], 0.0, -0.42, 0.0),
        ),
        SceneName::Throng => {
            for (who, away_m, aside_m, sweep_m, rate, phase) in THRONG {
                let (sin, cos) = libm::sincos(ACROSS_RAD);
                // from the camera: away along the view, aside across it
                let at = [
                    -1.80 + away_m * sin + aside_m * cos,
                    -1.34 - away_m * cos + aside_m * sin,
                ];
                let course = Course::ellipse(at, [sweep_m, 0.06], ACROSS_RAD, rate, phase);
                cast.person(who, Arms::Swing, course);
            }
        }
    }
    let number = |(k, role): (usize, Role)| Actor {
        object: u8::try_from(k + 1).unwrap_or(u8::MAX),
        role,
    };
    cast.roles.into_iter().enumerate().map(number).collect()
}

struct Cast<'a> {
    roles: Vec<Role>,
    rng: &'a mut Rng,
}

impl Cast<'_> {
    fn person(&mut self, who: usize, arms: Arms, course: Course) {
        let figure = self.dress(who, arms);
        self.roles.push(Role::Person { figure, course });
    }

    fn carrier(&mut self, who: usize, course: Course) {
        let figure = self.dress(who, Arms::Carry);
        self.roles.push(Role::Person {
            figure,
            course: course.clone(),
        });
        self.roles.push(Role::Load {
            figure,
            course,
            seed: figure.seed ^ 0x10AD,
        });
    }

    /// One of four people; the seed changes the weave and the height by a few centimetres.
    fn dress(&mut self, who: usize, arms: Arms) -> Figure {
        let plain = Figure {
            height_m: 1.75 + self.rng.range(-0.04, 0.04),
            shirt: Cloth::Plain([0.3; 3]),
            trousers: Cloth::Denim,
            skin: [0.80, 0.60, 0.48],
            hair: [0.22, 0.15, 0.10],
            long_hair: false,
            short_sleeves: false,
            skirt: false,
            backpack: false,
            arms,
            seed: (self.rng.next_u64() >> 40) as u32,
        };
        match who {
            0 => Figure {
                shirt: Cloth::Checked([0.62, 0.16, 0.14], [0.16, 0.15, 0.20]),
                ..plain
            },
            1 => Figure {
                height_m: plain.height_m - 0.07,
                shirt: Cloth::Striped([0.86, 0.84, 0.78], [0.16, 0.26, 0.44]),
                trousers: Cloth::Strewn([0.20, 0.30, 0.28], [0.85, 0.55, 0.35]),
                skin: [0.86, 0.68, 0.56],
                hair: [0.52, 0.33, 0.16],
                long_hair: true,
                skirt: true,
                ..plain
            },
            2 => Figure {
                height_m: plain.height_m + 0.05,
                shirt: Cloth::Printed([0.25, 0.42, 0.32], [0.92, 0.90, 0.82]),
                skin: [0.48, 0.32, 0.24],
                hair: [0.10, 0.09, 0.08],
                short_sleeves: true,
                backpack: true,
                ..plain
            },
            _ => Figure {
                height_m: plain.height_m - 0.02,
                shirt: Cloth::Strewn([0.78, 0.66, 0.34], [0.55, 0.18, 0.30]),
                trousers: Cloth::Plain([0.26, 0.24, 0.24]),
                hair: [0.55, 0.53, 0.50],
                ..plain
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_count_from_one_and_static_scenes_are_empty() {
        for name in SceneName::all() {
            let actors = actors(name, 1);
            let quiet = matches!(name, SceneName::QuietDesk | SceneName::Loop);
            assert_eq!(actors.is_empty(), quiet, "{name}");
            for (k, actor) in actors.iter().enumerate() {
                assert_eq!(usize::from(actor.object), k + 1, "{name}");
            }
        }
    }
}
