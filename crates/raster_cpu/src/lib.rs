//! Gaussian splat rasterizer on the CPU: the readable reference.
//!
//! ```text
//! GaussianMap ─ project ─→ Projected ─ sort, Tiles ─→ list per tile ─ composite ─→ Rendered
//!   + View      R1 to R7    per splat    bin, R8       of positions    R9 to R12
//!                                                                                     │ loss
//! Gradients ←─ project_one_backward ─ sums per splat ←─ composite_tile_backward ─ Upstream
//!                  R15 to R20                                R13, R14
//! ```
//!
//! Reading order: `render` → `view` → `covariance`, `color`, `project` → `bin` → `composite`, then
//! `backward`, [`losses`]. Each step's way back stands below it in the same file.
//! Formulas are numbered R1, R2, ... and derived in `docs/math.md`. Constants and
//! cuts are those of the CUDA rasterizer of 3D Gaussian Splatting, so that trained maps look
//! here as they do elsewhere; what differs is the principal point, which is free, and that
//! formulas are arranged not to cancel.
//!
//! Everything is generic over [`garad_core::Real`]: f32 is what a GPU is compared with, f64 is
//! what proves gradients.

mod backward;
mod bin;
mod color;
mod composite;
mod covariance;
mod error;
pub mod fast;
pub mod losses;
mod project;
mod render;
mod view;

pub use backward::{ClampGradient, Gradients, Upstream, backward};
pub use composite::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};
pub use covariance::BLUR_PX2;
pub use error::RasterError;
pub use project::{FOOTPRINT_CELL_PX, NEAR_M, PixelRect, Projected};
pub use render::{Include, MAX_SIDE_PX, RenderOptions, Rendered, render};
pub use view::JACOBIAN_CLAMP;
