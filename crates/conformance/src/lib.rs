//! Golden cases answered: by this project's own stages, or by a port that is a program.
//!
//! ```text
//! case ─→ inputs ─→ answer (our own stage)  ─→ outputs ┐
//! case ─→ port::run (a program)             ─→ .npy    ┼─→ golden::judge ─→ golden::report
//!                   a folder                ─→ .npy    ┘
//! ```
//!
//! A stage has one adapter here, which both `garad golden check --self` and the tests use. It is given [`Inputs`](garad_golden::Inputs),
//! which hold no expected output, and says itself which outputs it makes, of which type and shape. [`STAGES`] lists
//! every stage with its [`Form`]s: in f64 and f32, plain and fast.

mod bundle;
mod convert;
mod features;
mod field;
mod geometry;
mod judging;
mod losses;
pub mod make;
mod mapping;
mod moving;
mod outputs;
pub mod port;
mod poses;
mod raster;
mod recordings;
mod stages;
mod tracking;
mod train_run;
mod training;
mod two_views;

pub use outputs::{Answer, Element, Error, Outputs};
pub use stages::{Form, STAGES, Width, answer, forms};
