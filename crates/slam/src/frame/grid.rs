//! [`Grid`]: the keypoints of a frame by cell.

use garad_core::Camera;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Keypoints by cell, so that a search visits its neighbourhood only.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Grid {
    columns: usize,
    rows: usize,
    /// `start[cell]..start[cell + 1]` into `index`.
    start: Vec<usize>,
    index: Vec<usize>,
}

/// ORB-SLAM's 64 x 48 cells of a 640 x 480 image.
const CELL_PX: f64 = 10.0;

impl Grid {
    pub(super) fn new(camera: &Camera, uv_px: &[Vector2<f64>], in_use: &[bool]) -> Self {
        let columns = cell_of(camera.width as f64, usize::MAX) + 1;
        let rows = cell_of(camera.height as f64, usize::MAX) + 1;
        let cell = |i: usize| {
            let uv = &uv_px[i];
            (in_use[i] && camera.contains(uv))
                .then(|| cell_of(uv.y, rows - 1) * columns + cell_of(uv.x, columns - 1))
        };
        // Counting sort: stable, so indices ascend within a cell.
        let mut start = vec![0; columns * rows + 1];
        for c in (0..uv_px.len()).filter_map(cell) {
            start[c + 1] += 1;
        }
        for c in 0..columns * rows {
            start[c + 1] += start[c];
        }
        let mut next = start.clone();
        let mut index = vec![0; start[columns * rows]];
        for i in 0..uv_px.len() {
            if let Some(c) = cell(i) {
                index[next[c]] = i;
                next[c] += 1;
            }
        }
        Self {
            columns,
            rows,
            start,
            index,
        }
    }

    pub(super) fn cells(&self, uv: Vector2<f64>, radius: f64) -> impl Iterator<Item = usize> + '_ {
        // A frame that was dropped has no cell.
        let last = [self.columns, self.rows].map(|n| n.saturating_sub(1));
        let (x0, x1) = (
            cell_of(uv.x - radius, last[0]),
            cell_of(uv.x + radius, last[0]),
        );
        let (y0, y1) = (
            cell_of(uv.y - radius, last[1]),
            cell_of(uv.y + radius, last[1]),
        );
        (y0..self.rows.min(y1 + 1)).flat_map(move |y| {
            let row = y * self.columns;
            self.index[self.start[row + x0]..self.start[row + x1 + 1]]
                .iter()
                .copied()
        })
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates and maps NaN to 0, which is the clamp wanted here"
)]
fn cell_of(coordinate: f64, last: usize) -> usize {
    ((coordinate / CELL_PX) as usize).min(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells of an image of 35 x 25 pixels: 4 columns of 3.
    #[test]
    fn cells_row_by_row_and_keypoints_in_order() {
        let camera = Camera::pinhole((35, 25), [20.0, 21.0, 17.0, 12.0]).expect("valid");
        let places = [
            [31.0, 21.0],
            [2.0, 3.0],
            [12.0, 3.0],
            [3.0, 14.0],
            [4.0, 9.9],
            [12.0, 12.0], // not in use
            [f64::NAN, 3.0],
            [-0.6, 3.0],
            [3.0, 24.6],
            [-0.4, 24.4],
        ];
        let mut in_use = [true; 10];
        in_use[5] = false;
        let grid = Grid::new(&camera, &places.map(Vector2::from), &in_use);
        let found = |x, y, radius| grid.cells(Vector2::new(x, y), radius).collect::<Vec<_>>();
        let cases: [(f64, f64, f64, &[usize]); 7] = [
            (8.0, 8.0, 1.9, &[1, 4]),
            (8.0, 8.0, 2.0, &[1, 4, 2, 3]),
            (8.0, 5.0, 2.0, &[1, 4, 2]),
            (5.0, 12.0, 2.0, &[3]),
            (5.0, 12.0, 2.1, &[1, 4, 3]),
            (20.0, 15.0, 100.0, &[1, 4, 2, 3, 9, 0]),
            (60.0, 40.0, 1.0, &[0]), // outside: the nearest cell
        ];
        for (x, y, radius, expected) in cases {
            assert_eq!(
                found(x, y, radius),
                expected,
                "{radius} px around ({x}, {y})"
            );
        }
    }
}
