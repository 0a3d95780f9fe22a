//! Gaussian splat rasterizer on the CPU: the readable reference.
//!
//! ```text
//! GaussianMap ─ project ─→ Projected ─ sort, Tiles ─→ list per tile ─ composite ─→ Rendered
//!   + View      R1 to R7    per splat    bin, R8       of positions    R9 to R11
//!                                                                                     │ loss
//! Gradients ←─ project_one_backward ─ sums per splat ←─ composite_pixel_backward ─ Upstream
//!                  R15 to R20                                R13, R14
//! ```
//!
//! Reading order: `options`, `splat` → `render` → `view` → `covariance`, `color`, `project` → `bin`
//! → `composite`, `splat_gradient`, then `backward`, [`losses`]. The backward pass of each step
//! stands below it in the same file. Here are plain loops over pixels and sorted splats; what makes
//! them fast is in [`fast`]. `knn_scale` has the initial scales of new Gaussians.
//!
//! Formulas are numbered R1, R2, ... and derived in `docs/math.md`. Constants and
//! cuts are those of the CUDA rasterizer of 3D Gaussian Splatting, so that trained maps give the
//! same images here; what differs is the principal point, which is free, and that
//! formulas are arranged not to cancel.
//!
//! Everything is generic over [`garad_core::Real`]: f32 is what a GPU is compared with, f64
//! is what gradients are checked in.

mod backward;
mod bin;
mod color;
mod composite;
mod covariance;
mod error;
pub mod fast;
mod knn_scale;
pub mod losses;
mod options;
mod project;
mod render;
mod rendered;
mod scalar;
mod scales;
mod splat;
mod splat_gradient;
mod validate;
mod view;

pub use backward::{Gradients, backward};
pub use composite::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};
pub use covariance::BLUR_PX2;
pub use error::RasterError;
pub use knn_scale::{
    MAX_FOOTPRINTS, MIN_FOOTPRINTS, NEIGHBOURS, knn_scales_m, rms_neighbour_distances_m,
};
pub use options::{ClampGradient, Include, MAX_SIDE_PX, RenderOptions};
pub use project::{FOOTPRINT_CELL_PX, NEAR_M};
pub use render::{render, splats};
pub use rendered::{Rendered, Upstream};
pub use scales::{GradientScales, gradient_scales};
pub use splat::{PixelRect, Projected};
pub use view::JACOBIAN_CLAMP;
