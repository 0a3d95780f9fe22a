//! Depth at keypoints: missing on depth edges (decision 002), and whether a patch shows one surface.

use garad_core::DepthImage;
use nalgebra::Vector2;

use crate::config::FeatureConfig;

/// Depth at a keypoint's nearest pixel; `None` if missing, too far, or on an edge: the valid
/// depths of the 3x3 pixels around it spread by more than `edge_ratio` of it.
pub(super) fn depth_at(
    depth: &DepthImage,
    px: &Vector2<f64>,
    config: &FeatureConfig,
) -> Option<f64> {
    let (x, y) = nearest_pixel(px, depth.size())?;
    let usable = |d: f32| d.is_finite() && d > 0.0 && f64::from(d) <= config.max_depth_m;
    let center = depth[(x, y)];
    if !usable(center) {
        return None;
    }
    let (mut low, mut high) = (center, center);
    for ny in y.saturating_sub(1)..=(y + 1).min(depth.height() - 1) {
        for nx in x.saturating_sub(1)..=(x + 1).min(depth.width() - 1) {
            let d = depth[(nx, ny)];
            if usable(d) {
                low = low.min(d);
                high = high.max(d);
            }
        }
    }
    let spread = f64::from(high - low);
    (spread <= config.edge_ratio * f64::from(center)).then(|| f64::from(center))
}

/// Do all valid depths on a 5x5 lattice over the 21x21 pixels around a position lie within `ratio` of
/// the depth at the position itself?
pub(super) fn one_surface(depth: &DepthImage, px: &Vector2<f64>, ratio: f64) -> bool {
    const OFFSETS: [isize; 5] = [-10, -5, 0, 5, 10];
    let Some((x, y)) = nearest_pixel(px, depth.size()) else {
        return false;
    };
    let center = f64::from(depth[(x, y)]);
    let near = |d: &f32| *d <= 0.0 || (f64::from(*d) - center).abs() <= ratio * center;
    center > 0.0
        && OFFSETS.iter().all(|dy| {
            OFFSETS.iter().all(|dx| {
                let at = (x.checked_add_signed(*dx), y.checked_add_signed(*dy));
                let (Some(x), Some(y)) = at else { return true };
                depth.get(x, y).is_none_or(near)
            })
        })
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "compared with the image's bounds before the cast"
)]
pub(crate) fn nearest_pixel(
    px: &Vector2<f64>,
    (width, height): (usize, usize),
) -> Option<(usize, usize)> {
    let (x, y) = ((px.x + 0.5).floor(), (px.y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
    inside.then_some((x as usize, y as usize))
}
