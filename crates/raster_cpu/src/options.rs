//! [`RenderOptions`]: how a map is drawn, and what passes back through a clamp.

/// Largest side of an image, pixels. Coordinates up to here are exact in f32 with room for
/// fractions.
pub const MAX_SIDE_PX: usize = garad_core::camera::MAX_SIDE_PX as usize;

/// Which Gaussians are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Include {
    /// Every one.
    #[default]
    All,
    /// Those labelled static: the paper's render (eq. 15).
    StaticOnly,
    /// Those labelled dynamic.
    DynamicOnly,
}

/// What passes back through a clamp that is active.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ClampGradient {
    /// Nothing: the derivative of the image as it is.
    #[default]
    True,
    /// As the CUDA rasterizer of 3D Gaussian Splatting: alpha = min(0.99, ·) passes as if it were
    /// not there, so that saturated splats still learn, and the clamp in the Jacobian holds
    /// s z instead of s while z moves. A clamped colour passes nothing there either.
    PassThrough,
}

/// How a map is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderOptions {
    /// Colour behind everything, (r, g, b).
    pub background: [f64; 3],
    /// Side of the squares that work is cut into, pixels. Of the image only
    /// [`crate::Rendered::last`] depends on it; of gradients, the last bits.
    pub tile_px: usize,
    /// Which Gaussians are drawn.
    pub include: Include,
    /// What [`crate::backward()`] passes through an active clamp; the image does not depend on it.
    pub clamp_gradient: ClampGradient,
}

impl Default for RenderOptions {
    /// Black background, 16-pixel tiles, every Gaussian, true derivatives.
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            tile_px: 16,
            include: Include::All,
            clamp_gradient: ClampGradient::True,
        }
    }
}
