//! How far a rendered image is from the recorded one, and the gradient of that by the image (O1 to
//! O5).
//!
//! Reading order: [`l1()`] → [`ssim()`] → [`photometric()`], their mix → [`depth_l1`] →
//! [`opacity_penalty`]. The gradients are what [`crate::Upstream`] is filled with. SSIM is computed
//! in two ways: plainly in [`mod@reference`], and in one sweep over the rows, which is what runs.
//!
//! Pixels that are not 0 in `excluded` (moving or unknown) do not count. If none is left, value
//! and gradient are 0. Values are summed in f64 in an order that is fixed, whatever `T` is.

mod depth;
mod image_loss;
mod l1;
mod opacity;
mod photometric;
pub mod reference;
mod ssim;
mod sweep;

pub use depth::{DepthLoss, depth_l1};
pub use image_loss::ImageLoss;
pub use l1::l1;
pub use opacity::{OpacityPenalty, opacity_penalty};
pub use photometric::photometric;
pub use ssim::ssim;
