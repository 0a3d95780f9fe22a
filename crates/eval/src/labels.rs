//! Moving or static: precision, recall, F1 and IoU.

use garad_core::MaskImage;

use crate::EvalError;

/// Counts of decisions; *positive* means moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confusion {
    /// Called moving, and is.
    pub true_positives: u64,
    /// Called moving, but is static.
    pub false_positives: u64,
    /// Called static, but is moving.
    pub false_negatives: u64,
    /// Called static, and is.
    pub true_negatives: u64,
}

impl Confusion {
    /// Counts one decision.
    pub fn add(&mut self, called_moving: bool, is_moving: bool) {
        let count = match (called_moving, is_moving) {
            (true, true) => &mut self.true_positives,
            (true, false) => &mut self.false_positives,
            (false, true) => &mut self.false_negatives,
            (false, false) => &mut self.true_negatives,
        };
        *count += 1;
    }

    /// Counts two masks pixel by pixel. 255 means moving, 0 static; pixels whose truth is
    /// anything else (unknown) are left out; a prediction other than 255 says static.
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

    /// Decisions counted.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.true_positives + self.false_positives + self.false_negatives + self.true_negatives
    }

    /// TP / (TP + FP): how much of what was called moving is. `None` when nothing was called so.
    #[must_use]
    pub fn precision(&self) -> Option<f64> {
        ratio(
            self.true_positives,
            self.true_positives + self.false_positives,
        )
    }

    /// TP / (TP + FN): how much of what moves was found. `None` when nothing moves.
    #[must_use]
    pub fn recall(&self) -> Option<f64> {
        ratio(
            self.true_positives,
            self.true_positives + self.false_negatives,
        )
    }

    /// 2 TP / (2 TP + FP + FN), the harmonic mean of the two. `None` when nothing moves and
    /// nothing was called moving.
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

fn ratio(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
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
            false_negatives: 3, // an undecided prediction is no find
            true_negatives: 1,  // the pixel of unknown truth is nowhere
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
    fn what_cannot_be_judged_is_none() {
        let mut calm = Confusion::default();
        calm.add(false, false);
        let figures = [calm.precision(), calm.recall(), calm.f1(), calm.iou()];
        assert_eq!(figures, [None; 4], "nothing moves, nothing called");
        calm.add(true, false);
        assert!(calm.recall().is_none(), "nothing moves");
        assert!(
            is(calm.precision(), 0.0) && is(calm.f1(), 0.0),
            "a false alarm"
        );
        let uneven = Confusion::of_masks(&Image::new(2, 2, 0), &Image::new(2, 3, 0));
        assert!(uneven.is_err(), "sizes");
    }
}
