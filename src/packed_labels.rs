//! [`PackedLabels`]: the labels of a frame, compact enough to be kept for every frame of a long run.
//!
//! At 640 x 480 the labels of a frame take 43 kB, packed about 5 kB: positions in tenths of a pixel, as
//! they are written, and the mask as runs of equal cells.

use garad_core::{FrameId, Label, MaskImage};
use garad_slam::LabelledFrame;
use serde::{Deserialize, Serialize};

/// The labels of a frame, as they will be written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PackedLabels {
    /// The frame.
    pub frame: FrameId,
    /// Position of every keypoint, tenths of a pixel.
    tenths: Vec<[i32; 2]>,
    /// Label of every keypoint.
    labels: Vec<Label>,
    /// Columns and rows of the mask.
    size: (usize, usize),
    /// Runs of equal cells, row by row: value and count.
    runs: Vec<(u8, u32)>,
}

impl PackedLabels {
    /// Rounds positions to a tenth of a pixel, as `{:.1}` does.
    #[must_use]
    pub fn new(labels: &LabelledFrame) -> Self {
        let mut runs: Vec<(u8, u32)> = Vec::new();
        for &value in labels.cells.data() {
            match runs.last_mut() {
                Some((last, n)) if *last == value => *n += 1,
                _ => runs.push((value, 1)),
            }
        }
        Self {
            frame: labels.frame,
            tenths: (labels.keypoints.iter())
                .map(|(px, _)| px.map(tenths))
                .collect(),
            labels: labels.keypoints.iter().map(|(_, label)| *label).collect(),
            size: labels.cells.size(),
            runs,
        }
    }

    /// Keypoints: (x, y), px, and label.
    pub fn keypoints(&self) -> impl Iterator<Item = ([f64; 2], Label)> {
        let places = self.tenths.iter().map(|t| t.map(|t| f64::from(t) / 10.0));
        places.zip(self.labels.iter().copied())
    }

    /// The mask: 255 on moving objects, one value per 4 x 4 pixels.
    ///
    /// # Panics
    /// Never: the runs cover the mask.
    #[must_use]
    pub fn cells(&self) -> MaskImage {
        let (columns, rows) = self.size;
        let mut values = (self.runs.iter()).flat_map(|&(value, n)| (0..n).map(move |_| value));
        MaskImage::from_fn(columns, rows, |_, _| {
            values.next().expect("as many values as the mask had cells")
        })
    }
}

/// The number as written with one decimal, without the point.
fn tenths(px: f64) -> i32 {
    let written = format!("{px:.1}").replace('.', "");
    written.parse().unwrap_or(i32::MAX) // far outside any image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_keeps_what_the_files_show() {
        let mut cells = MaskImage::new(5, 3, 0);
        cells[(4, 0)] = 255;
        cells[(0, 1)] = 255;
        cells[(2, 2)] = 255;
        let labels = LabelledFrame {
            frame: FrameId(7),
            keypoints: vec![
                ([0.0, 639.96], Label::Static),
                ([12.25, 12.35], Label::Dynamic), // halves, exact and not
            ],
            cells,
        };
        let packed = PackedLabels::new(&labels);
        assert_eq!(packed.cells(), labels.cells, "the mask");
        assert_eq!(
            packed.runs.len(),
            5,
            "0, then 255 across the end of a row, 0, 255, 0"
        );
        let text = |[x, y]: [f64; 2]| format!("{x:.1} {y:.1}");
        for ((px, label), (was, expected)) in packed.keypoints().zip(&labels.keypoints) {
            assert_eq!(text(px), text(*was), "the digits of the file");
            assert_eq!(label, *expected, "its label");
        }
    }
}
