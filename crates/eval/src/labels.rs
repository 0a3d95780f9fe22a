//! Labels (moving or static) against the truth: precision, recall, F1 and IoU of frames and runs.

use garad_core::MaskImage;
use serde::{Deserialize, Serialize};

use crate::EvalError;

/// Counts of decisions; *positive* means moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Confusion {
    /// Labelled moving, and moving.
    pub true_positives: u64,
    /// Labelled moving, but static.
    pub false_positives: u64,
    /// Labelled static, but moving.
    pub false_negatives: u64,
    /// Labelled static, and static.
    pub true_negatives: u64,
}

impl Confusion {
    /// Counts one decision.
    pub fn add(&mut self, labelled_moving: bool, is_moving: bool) {
        let count = match (labelled_moving, is_moving) {
            (true, true) => &mut self.true_positives,
            (true, false) => &mut self.false_positives,
            (false, true) => &mut self.false_negatives,
            (false, false) => &mut self.true_negatives,
        };
        *count += 1;
    }

    /// Counts two masks pixel by pixel. 255 means moving, 0 static; pixels with any other true value
    /// (unknown) are not counted; a prediction other than 255 counts as static.
    ///
    /// # Errors
    /// [`EvalError::SizeMismatch`].
    pub fn of_masks(predicted: &MaskImage, truth: &MaskImage) -> Result<Self, EvalError> {
        if predicted.size() != truth.size() {
            return Err(EvalError::SizeMismatch {
                what: "predicted mask",
                expected: truth.size(),
                got: predicted.size(),
            });
        }
        let mut counts = Self::default();
        for (&p, &t) in predicted.data().iter().zip(truth.data()) {
            if t == 0 || t == 255 {
                counts.add(p == 255, t == 255);
            }
        }
        Ok(counts)
    }

    /// Counts labelled keypoints by the pixel of the true mask that each lies in.
    ///
    /// (x, y) lies in the pixel whose centre is nearest: pixel 3 spans [2.5, 3.5). Keypoints
    /// outside the image, not finite, or on a pixel of unknown truth are not counted. The mask belongs to
    /// the image of the keypoints: both distorted, or neither.
    ///
    /// # Example
    /// ```
    /// use garad_core::Image;
    /// use garad_eval::Confusion;
    /// let truth = Image::from_vec(3, 1, vec![0u8, 255, 128]).expect("three pixels");
    /// let keypoints = [([0.4, 0.0], true), ([0.6, 0.0], true), ([2.0, 0.0], false)];
    /// let counts = Confusion::of_keypoints(keypoints, &truth);
    /// assert_eq!((counts.false_positives, counts.true_positives, counts.total()), (1, 1, 2));
    /// ```
    #[must_use]
    pub fn of_keypoints(
        labelled_moving: impl IntoIterator<Item = ([f64; 2], bool)>,
        truth: &MaskImage,
    ) -> Self {
        let mut counts = Self::default();
        for ([x, y], moving) in labelled_moving {
            let at = pixel(x, truth.width()).zip(pixel(y, truth.height()));
            match at.map(|at| truth[at]) {
                Some(0) => counts.add(moving, false),
                Some(255) => counts.add(moving, true),
                _ => {}
            }
        }
        counts
    }

    /// Number of decisions.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.true_positives + self.false_positives + self.false_negatives + self.true_negatives
    }

    /// TP / (TP + FP): the share of moving among all labelled moving. `None` if there are none.
    #[must_use]
    pub fn precision(&self) -> Option<f64> {
        ratio(
            self.true_positives,
            self.true_positives + self.false_positives,
        )
    }

    /// TP / (TP + FN): the share of found among all moving. `None` if nothing moves.
    #[must_use]
    pub fn recall(&self) -> Option<f64> {
        ratio(
            self.true_positives,
            self.true_positives + self.false_negatives,
        )
    }

    /// 2 TP / (2 TP + FP + FN), the harmonic mean of the two. `None` if nothing moves and nothing was
    /// labelled moving.
    #[must_use]
    pub fn f1(&self) -> Option<f64> {
        let errors = self.false_positives + self.false_negatives;
        ratio(2 * self.true_positives, 2 * self.true_positives + errors)
    }

    /// TP / (TP + FP + FN), intersection over union. `None` as for [`Confusion::f1`].
    #[must_use]
    pub fn iou(&self) -> Option<f64> {
        let errors = self.false_positives + self.false_negatives;
        ratio(self.true_positives, self.true_positives + errors)
    }
}

impl std::ops::AddAssign for Confusion {
    fn add_assign(&mut self, other: Self) {
        self.true_positives += other.true_positives;
        self.false_positives += other.false_positives;
        self.false_negatives += other.false_negatives;
        self.true_negatives += other.true_negatives;
    }
}

/// The pixel of 0..n that contains a coordinate; `None` outside, and for NaN.
fn pixel(x: f64, n: usize) -> Option<usize> {
    let nearest = (x + 0.5).floor();
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "compared with the range of pixels first"
    )]
    (nearest >= 0.0 && nearest < n as f64).then_some(nearest as usize)
}

/// Counts of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameLabels {
    /// Time of the frame, seconds.
    pub t_s: f64,
    /// Labels of keypoints; `None` if the frame has none, for example if it was not tracked.
    pub keypoints: Option<Confusion>,
    /// The mask; `None` if there is none.
    pub pixels: Option<Confusion>,
}

/// Counts of every judged frame of a run, in order.
///
/// Figures of a run are computed from the summed counts, so that frames in which nothing moves count with
/// their false positives; a mean of the figures of the frames would have to skip them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RunLabels {
    /// One entry per frame.
    pub frames: Vec<FrameLabels>,
}

impl RunLabels {
    /// Keypoints of all frames.
    #[must_use]
    pub fn keypoints(&self) -> Confusion {
        sum(self.frames.iter().filter_map(|frame| frame.keypoints))
    }

    /// Pixels of all frames.
    #[must_use]
    pub fn pixels(&self) -> Confusion {
        sum(self.frames.iter().filter_map(|frame| frame.pixels))
    }
}

fn sum(counts: impl Iterator<Item = Confusion>) -> Confusion {
    let mut total = Confusion::default();
    counts.for_each(|frame| total += frame);
    total
}

fn ratio(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::LabelMetrics;
    use garad_core::Image;

    fn is(actual: Option<f64>, expected: f64) -> bool {
        actual.is_some_and(|value| (value - expected).abs() < 1e-15)
    }

    #[test]
    fn hand_counts() {
        let predicted = Image::from_vec(4, 2, vec![255, 255, 255, 0, 0, 0, 128, 255]);
        let truth = Image::from_vec(4, 2, vec![255, 255, 0, 255, 255, 0, 255, 128]);
        let (predicted, truth) = (predicted.expect("8 pixels"), truth.expect("8 pixels"));
        let counts = Confusion::of_masks(&predicted, &truth).expect("same size");
        let expected = Confusion {
            true_positives: 2,
            false_positives: 1,
            false_negatives: 3, // an undecided prediction counts as static
            true_negatives: 1,  // the pixel of unknown truth is not counted
        };
        assert_eq!(counts, expected, "counts");
        assert!(
            is(counts.precision(), 2.0 / 3.0),
            "{:?}",
            counts.precision()
        );
        assert!(is(counts.recall(), 2.0 / 5.0), "{:?}", counts.recall());
        assert!(is(counts.f1(), 0.5), "{:?}", counts.f1());
        assert!(is(counts.iou(), 1.0 / 3.0), "{:?}", counts.iou());
        let mut twice = counts;
        twice += counts;
        assert_eq!(twice.total(), 14, "sums");
        assert_eq!(twice.f1(), counts.f1(), "ratios keep");
    }

    #[test]
    fn keypoints_take_the_nearest_pixel() {
        let truth = Image::from_vec(3, 2, vec![0, 255, 128, 255, 0, 255]).expect("6 pixels");
        let count = |x: f64, y: f64| Confusion::of_keypoints([([x, y], true)], &truth);
        let (moving, fixed) = ((1, 0), (0, 1));
        for (x, y, expected) in [
            (0.0, 0.0, fixed),
            (0.49, -0.5, fixed),
            (0.5, 0.0, moving),
            (0.0, 0.5, moving),
            (2.49, 1.49, moving),
            (1.2, 0.8, fixed),
        ] {
            let counts = count(x, y);
            let got = (counts.true_positives, counts.false_positives);
            assert_eq!(got, expected, "({x}, {y})");
        }
        for (x, y) in [
            (2.0, 0.0), // unknown
            (-0.51, 0.0),
            (2.5, 1.0),
            (0.0, 1.5),
            (f64::NAN, 0.0),
            (0.0, f64::INFINITY),
            (0.0, -1e300),
        ] {
            assert_eq!(count(x, y).total(), 0, "({x}, {y})");
        }
        let calm = Confusion::of_keypoints([([1.0, 0.0], false), ([0.0, 0.0], false)], &truth);
        assert_eq!((calm.false_negatives, calm.true_negatives), (1, 1), "calm");
        let nothing = Confusion::of_keypoints([([0.0, 0.0], true)], &Image::new(0, 0, 0));
        assert_eq!(nothing.total(), 0, "no image");
    }

    /// Counts are summed, not figures averaged.
    #[test]
    fn a_run_is_the_sum_of_its_frames() {
        let counts = |[tp, fp, fn_, tn]: [u64; 4]| Confusion {
            true_positives: tp,
            false_positives: fp,
            false_negatives: fn_,
            true_negatives: tn,
        };
        let run = RunLabels {
            frames: vec![
                FrameLabels {
                    t_s: 0.0,
                    keypoints: Some(counts([8, 2, 0, 90])),
                    pixels: Some(counts([10, 0, 10, 80])),
                },
                FrameLabels {
                    t_s: 0.1,
                    keypoints: Some(counts([0, 2, 0, 98])), // nothing moves, two false positives
                    pixels: None,
                },
                FrameLabels {
                    t_s: 0.2,
                    keypoints: None, // lost
                    pixels: Some(counts([0, 0, 10, 90])),
                },
            ],
        };
        assert_eq!(run.keypoints(), counts([8, 4, 0, 188]), "keypoints");
        assert_eq!(run.pixels(), counts([10, 0, 20, 170]), "pixels");
        let metrics = LabelMetrics::from(&run);
        assert!(is(metrics.keypoints.precision, 8.0 / 12.0), "{metrics:?}");
        assert!(is(metrics.keypoints.recall, 1.0), "{metrics:?}");
        assert!(is(metrics.pixels.iou, 1.0 / 3.0), "{metrics:?}");
        assert!(is(metrics.pixels.f1, 0.5), "{metrics:?}");
        let nothing = LabelMetrics::from(&RunLabels::default());
        assert_eq!(nothing, LabelMetrics::default(), "no frame, no figure");
    }

    #[test]
    fn undefined_figures_are_none() {
        let mut calm = Confusion::default();
        calm.add(false, false);
        let figures = [calm.precision(), calm.recall(), calm.f1(), calm.iou()];
        assert_eq!(figures, [None; 4], "nothing moves, nothing labelled");
        calm.add(true, false);
        assert!(calm.recall().is_none(), "nothing moves");
        assert!(
            is(calm.precision(), 0.0) && is(calm.f1(), 0.0),
            "a false positive"
        );
        let uneven = Confusion::of_masks(&Image::new(2, 2, 0), &Image::new(2, 3, 0));
        assert!(uneven.is_err(), "sizes");
    }
}
