//! ORB: keypoints with scale and orientation, and their 256-bit descriptors.
//!
//! One frame: [`pyramid`](garad_core::pyramid) of 8 levels → [`detect`] (FAST in cells) →
//! [`octree`] (spread, the best of each cell) → [`orientation`] → [`blur`] → [`brief`].
//! Source: Rublee et al. 2011, in the form of ORB-SLAM3 (Campos et al. 2021), with which it
//! agrees bit by bit.

pub mod blur;
pub mod brief;
pub mod detect;
pub mod octree;
pub mod orientation;
pub mod pattern;

use garad_core::pyramid::{level_scales, level_sizes, resize_linear_into};
use garad_core::{GrayImage, Image, Par};
use serde::{Deserialize, Serialize};

use crate::descriptor::Descriptor;
use crate::error::{FeatureError, setting};

/// A point of the image that can be matched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Keypoint {
    /// Column in level-0 pixels, as the sensor sees it (distorted).
    pub x: f32,
    /// Row in level-0 pixels.
    pub y: f32,
    /// Pyramid level it was found on.
    pub level: u8,
    /// Direction of the intensity centroid, degrees in [0, 360], clockwise on the screen.
    pub angle_deg: f32,
    /// FAST score.
    pub response: f32,
}

/// Keypoints and their descriptors, one each.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// Ordered by level, then row, then column.
    pub keypoints: Vec<Keypoint>,
    /// Their descriptors, in the same order.
    pub descriptors: Vec<Descriptor>,
}

/// Settings of the extractor. The defaults are ORB-SLAM3's for 640x480.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrbConfig {
    /// Keypoints wanted in all; a few more may come.
    pub features: usize,
    /// Ratio of neighbouring levels, above 1.
    pub scale: f32,
    /// Pyramid levels.
    pub levels: usize,
    /// FAST threshold, grey levels.
    pub threshold: u8,
    /// Threshold for cells in which the first finds nothing.
    pub min_threshold: u8,
    /// Side of a detection cell, pixels of the level. ORB-SLAM2 uses 30.
    pub cell_px: usize,
}

impl Default for OrbConfig {
    fn default() -> Self {
        Self {
            features: 1000,
            scale: 1.2,
            levels: 8,
            threshold: 20,
            min_threshold: 7,
            cell_px: 35,
        }
    }
}

/// Finds and describes keypoints; holds the memory one frame needs so that the next can use it.
///
/// # Example
/// ```
/// use garad_core::{GrayImage, Par};
/// use garad_features::{OrbConfig, OrbExtractor};
/// let mut image = GrayImage::new(80, 80, 50);
/// image[(40, 40)] = 200;
/// let mut orb = OrbExtractor::new(OrbConfig::default())?;
/// let features = orb.extract(&image, Par::Seq)?;
/// assert_eq!((features.keypoints[0].x, features.keypoints[0].y), (40.0, 40.0));
/// # Ok::<(), garad_features::FeatureError>(())
/// ```
#[derive(Debug, Clone)]
pub struct OrbExtractor {
    config: OrbConfig,
    scales: Vec<f32>,
    wanted: Vec<usize>,
    levels: Vec<Level>,
}

/// Memory of one level: input, scratch, result.
#[derive(Debug, Clone, Default)]
struct Level {
    image: GrayImage,
    scores: GrayImage,
    blur_rows: Image<u16>,
    blurred: GrayImage,
    features: Features,
}

impl OrbExtractor {
    /// An extractor with these settings.
    ///
    /// # Errors
    /// [`FeatureError::BadSetting`]: no levels or more than 255, a scale that is not above 1, a
    /// cell or threshold of 0, or `min_threshold` above `threshold`.
    pub fn new(config: OrbConfig) -> Result<Self, FeatureError> {
        let (levels, scale, least) = (config.levels, config.scale, config.min_threshold);
        let valid = (1..=255).contains(&levels);
        setting("levels", levels as f64, "1 to 255", valid)?;
        let valid = scale > 1.0 && scale.is_finite();
        setting("scale", f64::from(scale), "a finite number above 1", valid)?;
        setting("cell_px", 0.0, "at least 1", config.cell_px > 0)?;
        let expected = "at least 1 and at most threshold";
        let valid = (1..=config.threshold).contains(&least);
        setting("min_threshold", f64::from(least), expected, valid)?;
        Ok(Self {
            config,
            scales: level_scales(config.scale, config.levels),
            wanted: features_per_level(&config),
            levels: vec![Level::default(); config.levels],
        })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &OrbConfig {
        &self.config
    }

    /// Sets the number of keypoints wanted from the next image on.
    pub fn look_for(&mut self, features: usize) {
        if features != self.config.features {
            self.config.features = features;
            self.wanted = features_per_level(&self.config);
        }
    }

    /// Pixels of level 0 that one pixel of `level` spans: 1.2^level. A keypoint's standard
    /// deviation grows with it.
    ///
    /// # Panics
    /// If there is no such level.
    #[must_use]
    pub fn level_scale(&self, level: u8) -> f32 {
        self.scales[usize::from(level)]
    }

    /// Finds and describes about [`OrbConfig::features`] keypoints.
    ///
    /// Their order is level, then row, then column. The same bits for every `par`; levels run
    /// side by side. Levels too small for a keypoint (below 39 pixels) have none.
    /// Golden: `orb/*`.
    ///
    /// # Errors
    /// [`FeatureError::EmptyImage`].
    pub fn extract(&mut self, image: &GrayImage, par: Par) -> Result<Features, FeatureError> {
        if image.data().is_empty() {
            let (width, height) = image.size();
            return Err(FeatureError::EmptyImage { width, height });
        }
        self.build_pyramid(image);
        let Self {
            config,
            scales,
            wanted,
            levels,
        } = self;
        par.for_each_chunk_mut(levels, 1, |l, level| {
            for level in level {
                level.extract(config, wanted[l], l, scales[l]);
            }
        });
        let mut all = Features::default();
        for level in levels {
            all.keypoints.extend_from_slice(&level.features.keypoints);
            all.descriptors
                .extend_from_slice(&level.features.descriptors);
        }
        Ok(all)
    }

    fn build_pyramid(&mut self, image: &GrayImage) {
        let base = &mut self.levels[0].image;
        if base.size() == image.size() {
            base.data_mut().copy_from_slice(image.data());
        } else {
            base.clone_from(image);
        }
        let sizes = level_sizes(image.size(), self.config.scale, self.config.levels);
        for l in 1..self.levels.len() {
            let (below, above) = self.levels.split_at_mut(l);
            resize_linear_into(&below[l - 1].image, sizes[l], &mut above[0].image);
        }
    }
}

impl Level {
    fn extract(&mut self, config: &OrbConfig, wanted: usize, level: usize, scale: f32) {
        self.features.keypoints.clear();
        self.features.descriptors.clear();
        let Some(area) = detect::searched_size(&self.image) else {
            return;
        };
        let corners = detect::cell_corners(&self.image, config, &mut self.scores);
        let chosen = octree::distribute(&corners, area, wanted);
        if chosen.is_empty() {
            return;
        }
        blur::blur_into(&self.image, &mut self.blur_rows, &mut self.blurred);
        for corner in chosen {
            let (x, y) = (corner.x + detect::MARGIN, corner.y + detect::MARGIN);
            let angle_deg = orientation::angle_deg(&self.image, x, y);
            self.features.keypoints.push(Keypoint {
                x: x as f32 * scale,
                y: y as f32 * scale,
                level: u8::try_from(level).expect("at most 255 levels, checked by new"),
                angle_deg,
                response: f32::from(corner.score),
            });
            let descriptor = brief::describe(&self.blurred, x, y, angle_deg);
            self.features.descriptors.push(descriptor);
        }
    }
}

/// How many of the wanted features each level gets: proportional to 1/scaleˡ, rounded half to
/// even in f32, the last level taking the rest.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "ORB-SLAM's f32 roundings; a part of `features`, which is a usize"
)]
fn features_per_level(config: &OrbConfig) -> Vec<usize> {
    let ratio = (1.0 / f64::from(config.scale)) as f32;
    let power = libm::pow(f64::from(ratio), config.levels as f64) as f32;
    let mut share = config.features as f32 * (1.0 - ratio) / (1.0 - power);
    let mut left = config.features;
    let mut wanted = Vec::with_capacity(config.levels);
    for _ in 1..config.levels {
        let count = (share.round_ties_even() as usize).min(left);
        wanted.push(count);
        left -= count;
        share *= ratio;
    }
    wanted.push(left);
    wanted
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;

    /// Grey boxes of random place, size and shade.
    fn boxes(width: usize, height: usize, seed: u64) -> GrayImage {
        let mut rng = Rng::new(seed);
        let mut image = GrayImage::new(width, height, 90);
        for _ in 0..width * height / 400 {
            let (x0, y0) = (rng.below(width), rng.below(height));
            let (w, h) = (4 + rng.below(20), 4 + rng.below(20));
            let shade = u8::try_from(rng.below(256)).expect("byte");
            for y in y0..(y0 + h).min(height) {
                image.row_mut(y)[x0..(x0 + w).min(width)].fill(shade);
            }
        }
        // A little noise: on clean steps, neighbouring scores are equal and remove each other.
        image.map(|&v| v.saturating_add(u8::try_from(rng.below(8)).expect("byte")))
    }

    fn extract(image: &GrayImage, par: Par) -> Features {
        let mut orb = OrbExtractor::new(OrbConfig::default()).expect("defaults are valid");
        orb.extract(image, par).expect("an image")
    }

    #[test]
    fn what_is_looked_for_may_change() {
        let image = boxes(200, 150, 9);
        let with = |features| {
            let config = OrbConfig {
                features,
                ..OrbConfig::default()
            };
            OrbExtractor::new(config).expect("valid")
        };
        let expected = [60, 120].map(|n| with(n).extract(&image, Par::Seq).expect("an image"));
        assert!(
            expected[1].keypoints.len() > expected[0].keypoints.len() + 30,
            "more"
        );
        let mut changing = with(60);
        for (n, which) in [(120, 1), (60, 0)] {
            changing.look_for(n);
            let found = changing.extract(&image, Par::Seq).expect("an image");
            assert!(found == expected[which], "{n} keypoints");
        }
    }

    #[test]
    fn levels_share_the_features() {
        let wanted = features_per_level(&OrbConfig::default());
        assert_eq!(
            wanted,
            [217, 181, 151, 126, 105, 87, 73, 60],
            "1000 over 8 levels"
        );
        let one = OrbConfig {
            levels: 1,
            ..OrbConfig::default()
        };
        assert_eq!(features_per_level(&one), [1000], "a single level takes all");
    }

    #[test]
    fn same_bits_for_any_number_of_threads_and_for_used_memory() {
        let image = boxes(200, 150, 3);
        let expected = extract(&image, Par::Seq);
        assert!(
            expected.keypoints.len() > 200,
            "{} keypoints",
            expected.keypoints.len()
        );
        for threads in [1, 2, 3] {
            assert_eq!(
                extract(&image, Par::new(threads)),
                expected,
                "{threads} threads"
            );
        }
        let mut orb = OrbExtractor::new(OrbConfig::default()).expect("valid");
        for other in [
            boxes(200, 150, 4),
            boxes(90, 300, 5),
            GrayImage::new(5, 5, 0),
        ] {
            orb.extract(&other, Par::Seq).expect("an image");
        }
        assert_eq!(
            orb.extract(&image, Par::Seq).expect("an image"),
            expected,
            "used memory"
        );
    }

    #[test]
    fn a_shift_moves_keypoints_and_keeps_descriptors() {
        let large = boxes(340, 280, 7);
        let crop =
            |x0: usize, y0: usize| GrayImage::from_fn(300, 250, |x, y| large[(x + x0, y + y0)]);
        let base_level_only = OrbConfig {
            levels: 1,
            features: 10_000,
            ..OrbConfig::default()
        };
        let mut orb = OrbExtractor::new(base_level_only).expect("valid");
        let here = orb.extract(&crop(0, 0), Par::Seq).expect("an image");
        let there = orb.extract(&crop(7, 5), Par::Seq).expect("an image");
        let mut common = 0;
        for (a, da) in here.keypoints.iter().zip(&here.descriptors) {
            for (b, db) in there.keypoints.iter().zip(&there.descriptors) {
                let same_place = (a.x - b.x - 7.0).abs() + (a.y - b.y - 5.0).abs() < 0.5;
                // The reflected border reaches 3 pixels into the blur of patches near the edge.
                let far_from_edge = b.x > 25.0 && b.y > 25.0 && a.x < 275.0 && a.y < 225.0;
                if same_place && far_from_edge {
                    assert!((a.angle_deg - b.angle_deg).abs() < 1e-6, "angle at {a:?}");
                    assert_eq!(da, db, "descriptor at {a:?}");
                    common += 1;
                }
            }
        }
        assert!(common > 100, "{common} keypoints in common");
    }

    #[test]
    fn order_is_level_row_column() {
        let features = extract(&boxes(200, 150, 9), Par::Seq);
        let keys: Vec<_> = features
            .keypoints
            .iter()
            .map(|k| (k.level, k.y, k.x))
            .collect();
        assert!(keys.windows(2).all(|p| p[0] < p[1]), "strictly ascending");
        assert_eq!(
            features.keypoints.len(),
            features.descriptors.len(),
            "one each"
        );
    }

    #[test]
    fn bad_settings_and_empty_images_are_named() {
        let good = OrbConfig::default();
        type Break = fn(&mut OrbConfig);
        let breaks: [(&str, Break); 7] = [
            ("levels", |c| c.levels = 0),
            ("levels", |c| c.levels = 256),
            ("scale", |c| c.scale = 1.0),
            ("scale", |c| c.scale = f32::NAN),
            ("cell_px", |c| c.cell_px = 0),
            ("min_threshold", |c| c.min_threshold = 0),
            ("min_threshold", |c| c.min_threshold = 21),
        ];
        for (name, spoil) in breaks {
            let mut config = good;
            spoil(&mut config);
            match OrbExtractor::new(config) {
                Err(FeatureError::BadSetting { setting, .. }) => assert_eq!(setting, name),
                other => panic!("{name}: {other:?}"),
            }
        }
        let mut orb = OrbExtractor::new(good).expect("valid");
        let empty = orb.extract(&GrayImage::default(), Par::Seq);
        assert_eq!(
            empty,
            Err(FeatureError::EmptyImage {
                width: 0,
                height: 0
            }),
            "no pixels"
        );
        for size in [(1, 1), (38, 38), (39, 39), (40, 500), (500, 40)] {
            let flat = orb.extract(&GrayImage::new(size.0, size.1, 9), Par::Seq);
            assert_eq!(flat, Ok(Features::default()), "{size:?}");
        }
    }

    /// 1/1.5 = ⅔ from level to level: 70 over three levels is 33.2, 22.1 and the rest; a keypoint of level l is l times
    /// as coarse.
    #[test]
    fn scale_and_levels_are_those_of_the_configuration() {
        let config = OrbConfig {
            features: 70,
            scale: 1.5,
            levels: 3,
            ..OrbConfig::default()
        };
        assert_eq!(features_per_level(&config), [33, 22, 15], "shares");
        let mut orb = OrbExtractor::new(config).expect("valid");
        assert_eq!(
            [0, 1, 2].map(|l| orb.level_scale(l).to_bits()),
            [1.0f32, 1.5, 2.25].map(f32::to_bits),
            "scales"
        );
        let found = orb
            .extract(&boxes(240, 180, 4), Par::Seq)
            .expect("an image");
        let mut levels = [0; 3];
        for k in &found.keypoints {
            levels[usize::from(k.level)] += 1;
            let x = k.x / [1.0, 1.5, 2.25][usize::from(k.level)];
            assert!((x - x.round()).abs() < 1e-4, "a pixel of its level: {k:?}");
        }
        let about = |got: usize, wanted: usize| (wanted..wanted + 8).contains(&got);
        assert!(
            about(levels[0], 33) && about(levels[1], 22) && about(levels[2], 15),
            "{levels:?}"
        );
    }
}
