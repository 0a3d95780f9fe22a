//! Golden cases: what goes into a stage, what must come out, and how close is close enough.
//!
//! A case is a folder `tests/golden/STAGE/CASE/` with a `case.json` and little-endian, C-order
//! `.npy` files; numpy alone opens them. The expected values come from outside this project
//! (OpenCV, mpmath, scipy, ...) through the scripts in `tests/golden/gen/`.
//!
//! Reading order: [`tensor`] (typed arrays) → [`npy`] (their files) → [`inputs`] (what a stage is given) →
//! [`case`] (the folder) → [`tol`] (the one table of tolerances; [`table`] is its JSON) → [`compare`](mod@compare) (one tensor) →
//! [`answers`], [`judge`](mod@judge) and [`verdict`] (one case) → [`explain`](mod@explain) (which mistake it is) → [`stages`]
//! (which stage needs which) → [`report`]; [`trace`] (whole frames, stage by stage).
//!
//! # Example
//! ```
//! use garad_golden::{Tensor, compare, tol};
//! let expected = Tensor::from(vec![1.0, 2.0, 4.0]);
//! let verdict = compare::compare(&expected, &[1.0, 2.0, 4.5], tol::find("exact").unwrap()).unwrap();
//! assert_eq!((verdict.outside, verdict.worst_index.as_slice()), (1, &[2][..]));
//! ```

mod alternatives;
pub mod answers;
pub mod case;
pub mod compare;
pub mod error;
pub mod explain;
pub mod inputs;
pub mod judge;
mod manifest;
pub mod metrics;
pub mod npy;
pub mod report;
pub mod stages;
pub mod table;
pub mod tensor;
pub mod tol;
pub mod trace;
pub mod verdict;

pub use case::Case;
pub use compare::Comparison;
pub use error::GoldenError;
pub use inputs::{InputError, Inputs};
pub use npy::NpyError;
pub use tensor::{Dtype, Tensor};
pub use tol::{Class, Tolerance};
