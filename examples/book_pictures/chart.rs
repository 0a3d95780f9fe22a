//! [`Chart`]: a frame with two axes, from numbers to pixels.

use crate::canvas::{BLACK, Canvas, Color, GRAY, PALE};

/// A frame on a canvas and the numbers along its edges.
pub(crate) struct Chart {
    /// Upper left and lower right corner, pixels.
    corners: [[f64; 2]; 2],
    /// Numbers at the left and right edge, and at the lower and upper one.
    ranges: [[f64; 2]; 2],
}

impl Chart {
    /// Draws the frame with a tick at each of `ticks`, numbers as `label` writes them.
    pub(crate) fn new(
        canvas: &mut Canvas,
        corners: [[f64; 2]; 2],
        ranges: [[f64; 2]; 2],
        [across, up]: [&[f64]; 2],
        label: impl Fn(f64) -> String,
    ) -> Self {
        let chart = Self { corners, ranges };
        let [[x0, y0], [x1, y1]] = corners;
        for &tick in across {
            let [x, _] = chart.at([tick, 0.0]);
            canvas.line([x, y0], [x, y1], 1.0, PALE);
            canvas.centered([x, y1 + 6.0], &label(tick), BLACK);
        }
        for &tick in up {
            let [_, y] = chart.at([0.0, tick]);
            canvas.line([x0, y], [x1, y], 1.0, PALE);
            let text = label(tick);
            let width = crate::canvas::ADVANCE * text.chars().count() as f64;
            canvas.text([x0 - width - 4.0, y - 7.0], &text, BLACK);
        }
        canvas.rect(corners[0], corners[1], 1.0, GRAY);
        chart
    }

    /// Where a point of the plane lies in the picture.
    pub(crate) fn at(&self, point: [f64; 2]) -> [f64; 2] {
        let [[x0, y0], [x1, y1]] = self.corners;
        let share =
            |k: usize| (point[k] - self.ranges[k][0]) / (self.ranges[k][1] - self.ranges[k][0]);
        [x0 + share(0) * (x1 - x0), y1 + share(1) * (y0 - y1)]
    }

    /// A line through points of the plane, cut at the frame.
    pub(crate) fn curve(&self, canvas: &mut Canvas, points: &[[f64; 2]], width: f64, color: Color) {
        for pair in points
            .windows(2)
            .filter(|pair| pair.iter().all(|p| self.holds(*p)))
        {
            canvas.line(self.at(pair[0]), self.at(pair[1]), width, color);
        }
    }

    /// Whether a point lies within the frame.
    pub(crate) fn holds(&self, point: [f64; 2]) -> bool {
        (0..2).all(|k| {
            let [a, b] = self.ranges[k];
            let slack = 1e-9 * (b - a).abs();
            point[k] >= a.min(b) - slack && point[k] <= a.max(b) + slack
        })
    }
}
