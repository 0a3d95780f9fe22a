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

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels and their depth.
    type Changed<'a> = &'a [((usize, usize), f32)];

    /// Depth at (2, 1) of 5 x 4 pixels of 2 m, with some changed; at most 5 m, spread at most an eighth.
    #[test]
    fn depth_of_a_keypoint() {
        let config = FeatureConfig {
            max_depth_m: 5.0,
            edge_ratio: 0.125,
            ..FeatureConfig::default()
        };
        let nan = f32::NAN;
        let cases: [(&str, Changed, Option<f64>); 14] = [
            ("flat", &[], Some(2.0)),
            ("farther by an eighth", &[((3, 2), 2.25)], Some(2.0)),
            ("by more", &[((3, 2), 2.26)], None),
            ("nearer by an eighth", &[((1, 0), 1.75)], Some(2.0)),
            ("by more", &[((1, 0), 1.74)], None),
            (
                "a sixteenth each way",
                &[((1, 2), 1.875), ((3, 0), 2.125)],
                Some(2.0),
            ),
            ("more, together", &[((1, 2), 1.875), ((3, 0), 2.25)], None),
            (
                "two pixels away",
                &[((4, 1), 4.0), ((2, 3), 4.0), ((0, 1), 1.0)],
                Some(2.0),
            ),
            ("a share of its own depth", &[((2, 1), 2.25)], Some(2.25)),
            (
                "missing around",
                &[((2, 0), 0.0), ((1, 1), nan), ((3, 1), -1.0)],
                Some(2.0),
            ),
            ("too far around", &[((2, 2), 5.1)], Some(2.0)),
            ("missing itself", &[((2, 1), 0.0)], None),
            ("not a number itself", &[((2, 1), nan)], None),
            ("too far itself", &[((2, 1), 5.1)], None),
        ];
        for (what, changed, expected) in cases {
            let mut depth = DepthImage::new(5, 4, 2.0);
            for (at, z) in changed {
                depth[*at] = *z;
            }
            let found = depth_at(&depth, &Vector2::new(2.4, 0.6), &config);
            assert_eq!(found, expected, "{what}");
        }
        let farthest = depth_at(
            &DepthImage::new(5, 4, 5.0),
            &Vector2::new(4.4, 3.4),
            &config,
        );
        assert_eq!(farthest, Some(5.0), "the limit itself, in the last corner");
    }

    #[test]
    fn pixels_are_half_open_squares_around_their_centres() {
        for (x, y, expected) in [
            (1.5, 0.49, Some((2, 0))),
            (1.49, 1.5, Some((1, 2))),
            (-0.5, -0.5, Some((0, 0))),
            (-0.51, 1.0, None),
            (1.0, -0.51, None),
            (4.49, 3.49, Some((4, 3))),
            (4.5, 1.0, None),
            (1.0, 3.5, None),
            (f64::NAN, 1.0, None),
        ] {
            let found = nearest_pixel(&Vector2::new(x, y), (5, 4));
            assert_eq!(found, expected, "({x}, {y})");
        }
    }

    /// Around (20, 14) of 40 x 30 pixels of 2 m, with one changed.
    #[test]
    fn one_surface_within_ten_pixels() {
        let cases = [
            ("farther by an eighth", (30, 24), 2.25, true),
            ("by more", (30, 24), 2.26, false),
            ("nearer by an eighth", (10, 4), 1.75, true),
            ("by more", (10, 4), 1.74, false),
            ("five columns left", (15, 14), 3.0, false),
            ("five rows down", (20, 19), 3.0, false),
            ("off the lattice", (29, 24), 3.0, true),
            ("beyond it", (31, 14), 3.0, true),
            ("missing", (30, 24), 0.0, true),
            ("itself missing", (20, 14), 0.0, false),
            (
                "itself farther, by less than its eighth",
                (20, 14),
                2.25,
                true,
            ),
            (
                "itself nearer, by more than its eighth",
                (20, 14),
                1.75,
                false,
            ),
        ];
        for (what, at, z, expected) in cases {
            let mut depth = DepthImage::new(40, 30, 2.0);
            depth[at] = z;
            let found = one_surface(&depth, &Vector2::new(20.4, 13.5), 0.125);
            assert_eq!(found, expected, "{what}");
        }
        let wall = DepthImage::new(40, 30, 2.0);
        for (x, y, expected) in [(3.0, 2.0, true), (39.0, 29.0, true), (40.0, 2.0, false)] {
            let found = one_surface(&wall, &Vector2::new(x, y), 0.125);
            assert_eq!(
                found, expected,
                "({x}, {y}): what lies outside is not compared"
            );
        }
    }
}
