//! [`Actor`]: a moving object, as solids at a given time.

use garad_core::{Se3, So3};
use nalgebra::Vector3;

use crate::course::Course;
use crate::figure::{Arms, Figure, LOAD, Step};
use crate::furniture::chair;
use crate::material::Material;
use crate::shape::Shape;
use crate::solid::{Builder, Solid, yaw};

/// Below this speed of its fastest point an object counts as static, metres per second: a person who stands
/// and turns the head moves.
const STANDS_BELOW_M_S: f64 = 0.015;

/// A moving object with its id.
#[derive(Debug, Clone)]
pub(crate) struct Actor {
    pub(crate) object: u8,
    pub(crate) role: Role,
}

/// Kind of moving object.
#[derive(Debug, Clone)]
pub(crate) enum Role {
    /// A person on a course.
    Person { figure: Figure, course: Course },
    /// The box carried by a person.
    Load {
        figure: Figure,
        course: Course,
        seed: u32,
    },
    /// A trolley with boxes, with constant heading.
    Trolley {
        course: Course,
        heading_rad: f64,
        seed: u32,
    },
    /// A chair that is dragged, with constant heading.
    Chair {
        course: Course,
        heading_rad: f64,
        seed: u32,
    },
    /// A rolling ball.
    Ball {
        course: Course,
        heading_rad: f64,
        radius: f64,
        seed: u32,
    },
}

impl Actor {
    /// Its solids at a time: always the same shapes in the same order.
    pub(crate) fn solids(&self, t_s: f64) -> Vec<Solid> {
        match &self.role {
            Role::Person { figure, course } => {
                let (world_from_figure, step) = person(figure, course, t_s);
                let parts = figure.parts(&step);
                let place = |part: &crate::figure::Part| Solid {
                    shape: part.shape,
                    material: part.material,
                    world_from_solid: world_from_figure * part.figure_from_part,
                    object: self.object,
                };
                parts.iter().map(place).collect()
            }
            Role::Load {
                figure,
                course,
                seed,
            } => {
                let (world_from_figure, step) = person(figure, course, t_s);
                let k = figure.height_m / 1.75;
                let (middle, half) = LOAD;
                let bob = 0.008 * libm::sin(4.0 * std::f64::consts::PI * step.gone_m);
                let middle = Vector3::from(middle) * k + Vector3::new(0.0, 0.0, bob);
                vec![Solid {
                    shape: Shape::Block { half: half.into() },
                    material: Material::Cardboard { seed: *seed },
                    world_from_solid: world_from_figure * Se3::new(So3::identity(), middle),
                    object: self.object,
                }]
            }
            Role::Trolley {
                course,
                heading_rad,
                seed,
            } => self.on_course(course, t_s, *heading_rad, *seed, trolley),
            Role::Chair {
                course,
                heading_rad,
                seed,
            } => self.on_course(course, t_s, *heading_rad, *seed, chair),
            Role::Ball {
                course,
                heading_rad,
                radius,
                seed,
            } => {
                let at = course.place(t_s).at;
                let (sin, cos) = libm::sincos(*heading_rad);
                // rolling without slipping: rotated by way / radius about the axis to the left
                let way = at.x * cos + at.y * sin;
                let roll = So3::exp(&(Vector3::new(-sin, cos, 0.0) * (way / radius)));
                vec![Solid {
                    shape: Shape::Ellipsoid {
                        radii: Vector3::repeat(*radius),
                    },
                    material: Material::Ball { seed: *seed },
                    world_from_solid: Se3::new(roll, Vector3::new(at.x, at.y, *radius)),
                    object: self.object,
                }]
            }
        }
    }

    /// Whether any corner of its parts is faster than [`STANDS_BELOW_M_S`] between two times.
    pub(crate) fn moves_between(&self, t0_s: f64, t1_s: f64) -> bool {
        let limit = STANDS_BELOW_M_S * (t1_s - t0_s).abs();
        let (before, after) = (self.solids(t0_s), self.solids(t1_s));
        before.iter().zip(&after).any(|(a, b)| {
            let travel =
                |p: &Vector3<f64>| (a.world_from_solid * *p - b.world_from_solid * *p).norm();
            a.shape.corners().iter().any(|p| travel(p) > limit)
        })
    }

    /// A piece of furniture at its place on the course.
    fn on_course(
        &self,
        course: &Course,
        t_s: f64,
        heading_rad: f64,
        seed: u32,
        build: fn(&mut Builder),
    ) -> Vec<Solid> {
        let at = course.place(t_s).at;
        let mut b = Builder::new(seed);
        b.at(at.x, at.y, 0.0, heading_rad);
        build(&mut b);
        for solid in &mut b.solids {
            solid.object = self.object;
        }
        b.solids
    }
}

fn person(figure: &Figure, course: &Course, t_s: f64) -> (Se3, Step) {
    let place = course.place(t_s);
    // a talking person turns slightly
    let sway = if figure.arms == Arms::Gesture {
        0.25 * libm::sin(0.8 * place.idle_s)
    } else {
        0.0
    };
    let world_from_figure = Se3::new(
        yaw(place.heading_rad + sway),
        Vector3::new(place.at.x, place.at.y, 0.0),
    );
    let step = Step {
        gone_m: place.gone_m,
        t_s: place.idle_s,
        pace: place.pace,
    };
    (world_from_figure, step)
}

/// Platform, wheels, handle and three boxes; rolls along x.
fn trolley(b: &mut Builder) {
    let bed = b.wood([0.55, 0.40, 0.25]);
    b.block([0.0, 0.0, 0.17], [0.40, 0.25, 0.02], bed);
    for (x, y) in [(-0.32, -0.2), (0.32, -0.2), (-0.32, 0.2), (0.32, 0.2)] {
        let rubber = b.paint([0.12; 3]);
        b.ellipsoid([x, y, 0.075], [0.075, 0.03, 0.075], rubber);
    }
    for y in [-0.2, 0.2] {
        let tube = b.paint([0.75, 0.20, 0.15]);
        b.rod([-0.37, y, 0.19], [-0.45, y, 0.98], 0.016, 0.016, tube);
    }
    let grip = b.paint([0.15; 3]);
    b.rod([-0.45, -0.21, 0.98], [-0.45, 0.21, 0.98], 0.02, 0.02, grip);
    for (centre, half, turn) in [
        ([-0.05, 0.0, 0.36], [0.27, 0.22, 0.17], 0.0),
        ([-0.10, 0.02, 0.66], [0.19, 0.17, 0.13], 0.2),
        ([0.31, 0.0, 0.28], [0.07, 0.16, 0.09], -0.1),
    ] {
        let seed = b.seed();
        b.turned_block(centre, half, turn, Material::Cardboard { seed });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_does_not_slip() {
        let course = Course::ellipse([0.2, 0.1], [0.6, 0.0], 0.4, 0.8, 1.0);
        let ball = Actor {
            object: 3,
            role: Role::Ball {
                course,
                heading_rad: 0.4,
                radius: 0.12,
                seed: 1,
            },
        };
        let h = 1e-6;
        for k in 0..10 {
            let t = 0.37 * f64::from(k);
            let (a, b) = (ball.solids(t)[0], ball.solids(t + h)[0]);
            let contact = a.world_from_solid.translation - Vector3::z() * 0.12;
            let on_ball = a.world_from_solid.inverse() * contact;
            let slip = (b.world_from_solid * on_ball - contact) / h;
            assert!(slip.norm() < 1e-4, "slips at {} m/s", slip.norm());
        }
    }

    #[test]
    fn standing_and_moving_are_distinguished() {
        let course = Course::ellipse([0.0, 0.0], [1.0, 0.0], 0.0, 0.5, 1.5);
        let schedule = crate::course::Schedule::StopAndGo {
            first_s: 1.0,
            go_s: 2.0,
            stop_s: 1.0,
        };
        let trolley = Actor {
            object: 1,
            role: Role::Trolley {
                course: course.with_schedule(schedule),
                heading_rad: 0.0,
                seed: 1,
            },
        };
        assert!(!trolley.moves_between(0.5, 0.53), "not started");
        assert!(trolley.moves_between(2.0, 2.03), "rolls");
        assert!(!trolley.moves_between(3.3, 3.33), "stopped");
    }
}
