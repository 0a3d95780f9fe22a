//! [`Levels`]: where the pixels of each ORB level lie in the full image.

use garad_core::pyramid::{level_scales, level_sizes};
use garad_features::Keypoint;
use nalgebra::Vector2;

/// Where the pixels of each ORB level lie in the image.
///
/// A resized image keeps its outer edges, so pixel x of a level W_l wide has its centre at
/// (x + ½) W/W_l - ½ of the full one. ORB-SLAM multiplies by 1.2^l instead, which is off by up to
/// 1.3 px at the coarsest level and moves points that are seen at changing levels (decision 003).
#[derive(Debug, Clone)]
pub struct Levels {
    /// 1.2^l as the extractor multiplies it into keypoints.
    pub(crate) scale: Vec<f64>,
    /// (W/W_l, H/H_l).
    ratio: Vec<(f64, f64)>,
    exact: bool,
}

impl Levels {
    /// For images of this size.
    #[must_use]
    pub fn new((width, height): (usize, usize), factor: f32, count: usize, exact: bool) -> Self {
        let ratio = level_sizes((width, height), factor, count)
            .iter()
            .map(|(w, h)| (width as f64 / *w as f64, height as f64 / *h as f64))
            .collect();
        let scale = level_scales(factor, count)
            .iter()
            .map(|s| f64::from(*s))
            .collect();
        Self {
            scale,
            ratio,
            exact,
        }
    }

    /// The keypoint's place in the full image, px.
    #[must_use]
    pub fn center(&self, keypoint: &Keypoint) -> Vector2<f64> {
        let (x, y) = (f64::from(keypoint.x), f64::from(keypoint.y));
        let level = usize::from(keypoint.level);
        if !self.exact {
            return Vector2::new(x, y);
        }
        let (rx, ry) = self.ratio[level];
        let at = |c: f64, ratio: f64| (c / self.scale[level] + 0.5) * ratio - 0.5;
        Vector2::new(at(x, rx), at(y, ry))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Level 3 of 160 x 90 pixels is 93 x 52: 160 / 1.728 = 92.6, 90 / 1.728 = 52.1.
    #[test]
    fn a_pixel_of_a_level_lies_at_the_centre_of_what_it_covers() {
        let centre = [10.5 * 160.0 / 93.0 - 0.5, 7.5 * 90.0 / 52.0 - 0.5];
        for (exact, level, [x, y], expected) in [
            (true, 0, [17.0, 12.0], [17.0, 12.0]),
            (true, 3, [17.28, 12.096], centre), // 1.728 times (10, 7)
            (false, 3, [17.28, 12.096], [17.28, 12.096]),
        ] {
            let keypoint = Keypoint {
                x,
                y,
                level,
                angle_deg: 0.0,
                response: 1.0,
            };
            let levels = Levels::new((160, 90), 1.2, 4, exact);
            let off = (levels.center(&keypoint) - Vector2::from(expected)).norm();
            assert!(off < 1e-5, "level {level}, exact {exact}: off by {off} px");
            assert!((levels.scale[3] - 1.728).abs() < 1e-6, "σ of level 3");
        }
    }
}
