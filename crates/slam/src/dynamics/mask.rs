//! The mask of a frame: the beliefs of its samples carried to every cell, and back to keypoints.

use garad_core::{DepthImage, Image, Label, MaskImage, Real};
use nalgebra::Vector2;

use super::samples::{Lattice, Sample};
use crate::mask::CELL_PX;
use crate::mask::MOVING;

/// The mask in cells: the mean belief of the lattice samples around, weighted by their distance in
/// the image (linear over one step) and in depth, of which samples of another surface differ by more than the share
/// `edge_ratio`; moving where it is above the threshold. Cells without depth use the image alone.
pub(crate) fn mask_from_beliefs(
    lattice: &Lattice,
    samples: &[Option<Sample>],
    beliefs: &[f64],
    depth: &DepthImage,
    edge_ratio: f64,
    threshold: f64,
) -> MaskImage {
    let mut of_sample = vec![None; samples.len()];
    let mut next = beliefs.iter();
    for (slot, sample) in of_sample.iter_mut().zip(samples) {
        if let Some(sample) = sample {
            *slot = next.next().map(|belief| (*sample, *belief));
        }
    }
    let (width, height) = depth.size();
    let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
    let step = lattice.step_px as f64;
    let half = CELL_PX as f64 / 2.0 - 0.5;
    Image::from_fn(columns, rows, |cx, cy| {
        let center = [cx, cy].map(|c| (c * CELL_PX) as f64 + half);
        let at = |c: usize, n: usize| (c * CELL_PX + CELL_PX / 2).min(n - 1);
        let z = f64::from(depth[(at(cx, width), at(cy, height))]);
        let block = [cx, cy].map(|c| c * CELL_PX / lattice.step_px);
        let (mut sum, mut weights) = (0.0, 0.0);
        for y in block[1].saturating_sub(1)..(block[1] + 2).min(lattice.rows) {
            for x in block[0].saturating_sub(1)..(block[0] + 2).min(lattice.columns) {
                let Some((sample, belief)) = &of_sample[y * lattice.columns + x] else {
                    continue;
                };
                let dx = (sample.px.x - center[0]).abs() / (1.5 * step);
                let dy = (sample.px.y - center[1]).abs() / (1.5 * step);
                let mut weight = (1.0 - dx).max(0.0) * (1.0 - dy).max(0.0);
                if z > 0.0 {
                    let d = (sample.depth_m - z) / (edge_ratio * z);
                    weight *= Real::exp(-0.5 * d * d) + 1e-6;
                }
                sum += weight * belief;
                weights += weight;
            }
        }
        let moves = weights > 0.0 && sum > threshold * weights;
        if moves { MOVING } else { 0 }
    })
}

/// The label of the cell that a pixel lies in.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; `get` refuses what lies outside"
)]
pub(crate) fn label_at(cells: &MaskImage, px: &Vector2<f64>) -> Label {
    let cell = |c: f64| (c + 0.5).max(0.0) as usize / CELL_PX;
    match cells.get(cell(px.x), cell(px.y)) {
        Some(&MOVING) => Label::Dynamic,
        _ => Label::Static,
    }
}

#[cfg(test)]
mod tests {
    use Label::{Dynamic, Static};
    use garad_core::Camera;

    use super::*;

    const WIDTH: usize = 64;
    const HEIGHT: usize = 48;

    /// 4 x 3 blocks of 16 px, with the samples at 8, 24, 40 and 56 px.
    fn lattice() -> Lattice {
        let camera = Camera::pinhole((WIDTH, HEIGHT), [60.0, 50.0, 31.5, 23.5]).expect("valid");
        Lattice::new(&camera, 16)
    }

    /// Depth (none: no sample) and belief of the samples of the three rows of blocks.
    type Rows = [[Option<(f64, f64)>; 4]; 3];

    fn mask(rows: &Rows, depth: &DepthImage, edge_ratio: f64, threshold: f64) -> MaskImage {
        let sample = |(i, sample): (usize, &Option<(f64, f64)>)| {
            let px = Vector2::new((i % 4 * 16 + 8) as f64, (i / 4 * 16 + 8) as f64);
            sample.map(|(depth_m, _)| Sample {
                px,
                depth_m,
                p_world: px.push(depth_m),
            })
        };
        let given = rows.as_flattened();
        let samples: Vec<_> = given.iter().enumerate().map(sample).collect();
        let beliefs: Vec<f64> = given.iter().flatten().map(|(_, belief)| *belief).collect();
        mask_from_beliefs(&lattice(), &samples, &beliefs, depth, edge_ratio, threshold)
    }

    /// The cells of a row or column that move.
    fn moving(cells: impl Iterator<Item = u8>) -> Vec<usize> {
        let cells = cells.enumerate().filter(|(_, cell)| *cell == MOVING);
        cells.map(|(i, _)| i).collect()
    }

    /// A column of blocks moves. Without depth its sample at 24 px has the shares 0.42, 0.522, 0.573, 0.584, 0.536 and
    /// 0.43 of the weights in the cells 3 to 8, whose centres are 4 px apart from 13.5 px on. The same holds for rows.
    #[test]
    fn weights_are_linear_in_the_distance_over_a_step_and_a_half() {
        let none = DepthImage::new(WIDTH, HEIGHT, 0.0);
        let with = |moves: &dyn Fn(usize, usize) -> bool| -> Rows {
            std::array::from_fn(|y| {
                std::array::from_fn(|x| Some((2.0, f64::from(u8::from(moves(x, y))))))
            })
        };
        for (threshold, expected) in [
            (0.41, vec![3, 4, 5, 6, 7, 8]),
            (0.425, vec![4, 5, 6, 7, 8]),
            (0.5, vec![4, 5, 6, 7]),
            (0.53, vec![5, 6, 7]),
            (0.55, vec![5, 6]),
            (0.58, vec![6]),
            (0.6, vec![]),
        ] {
            let cells = mask(&with(&|x, _| x == 1), &none, 0.05, threshold);
            assert_eq!(cells.size(), (16, 12), "cells");
            for y in 0..12 {
                let row = cells.row(y).iter().copied();
                assert_eq!(moving(row), expected, "row {y} above {threshold}");
            }
            let cells = mask(&with(&|_, y| y == 1), &none, 0.05, threshold);
            for x in 0..16 {
                let column = (0..12).map(|y| cells[(x, y)]);
                assert_eq!(moving(column), expected, "column {x} above {threshold}");
            }
        }
    }

    /// Only the block in column 2 and row 1 has a sample: it alone decides within one and a half steps, in its block and the
    /// ones beside it. The others have nothing to go by, and are static.
    #[test]
    fn beliefs_belong_to_the_blocks_that_have_a_sample() {
        let none = DepthImage::new(WIDTH, HEIGHT, 0.0);
        let mut rows: Rows = [[None; 4]; 3];
        rows[1][2] = Some((2.0, 0.3));
        let cells = mask(&rows, &none, 0.05, 0.29);
        assert_eq!(moving(cells.row(6).iter().copied()), Vec::from_iter(4..16));
        assert_eq!(
            moving((0..12).map(|y| cells[(9, y)])),
            Vec::from_iter(0..12)
        );
        assert_eq!(
            moving(cells.row(6).iter().copied()).len() * 12,
            cells.data().iter().filter(|c| **c == MOVING).count()
        );
        let cells = mask(&rows, &none, 0.05, 0.3);
        assert_eq!(cells, MaskImage::new(16, 12, 0), "not above the threshold");

        // The second belief is that of the second sample, not of the second block.
        rows = [[None; 4]; 3];
        rows[0][0] = Some((2.0, 0.0));
        rows[2][3] = Some((2.0, 1.0));
        let cells = mask(&rows, &none, 0.05, 0.5);
        assert_eq!(cells[(1, 1)], 0, "the first");
        assert_eq!(cells[(14, 10)], MOVING, "the last");
    }

    /// In cell 3, at 13.5 px, the samples at 8 and 24 px weigh 0.771 and 0.5625 by position. The depth of the cell is that of
    /// its pixel 14; the second sample is 0.1 m off, which is one share of 0.05 at 2 m: exp(-1/2), and two of
    /// 0.025: exp(-2).
    #[test]
    fn samples_of_another_depth_weigh_less() {
        let mut depth = DepthImage::new(WIDTH, HEIGHT, 0.0);
        for y in (2..HEIGHT).step_by(4) {
            depth[(14, y)] = 2.0;
        }
        for depth_m in [2.1, 1.9] {
            let row = [Some((2.0, 0.0)), Some((depth_m, 1.0)), None, None];
            let is_moving = |edge_ratio: f64, threshold| {
                let cells = mask(&[row; 3], &depth, edge_ratio, threshold);
                cells[(3, 5)] == MOVING
            };
            for (edge_ratio, share) in [(0.05, 0.3068), (0.025, 0.0899)] {
                let sides = [-0.001, 0.001].map(|off| is_moving(edge_ratio, share + off));
                assert_eq!(sides, [true, false], "{depth_m} m, {edge_ratio}");
            }
        }
        // Another surface counts where no other sample is near.
        let row = [None, Some((3.0, 1.0)), None, None];
        let cells = mask(&[row; 3], &DepthImage::new(WIDTH, HEIGHT, 2.0), 0.05, 0.5);
        assert_eq!(cells[(3, 5)], MOVING, "alone");
    }

    #[test]
    fn a_pixel_has_the_label_of_the_cell_it_is_nearest_to() {
        let mut cells = MaskImage::new(5, 3, 128);
        cells[(1, 2)] = MOVING;
        cells[(0, 0)] = MOVING;
        for (x, y, expected) in [
            (3.4, 9.0, Static),
            (3.5, 9.0, Dynamic),
            (7.4, 9.0, Dynamic),
            (7.5, 9.0, Static),
            (5.0, 7.4, Static),
            (5.0, 7.5, Dynamic),
            (5.0, 11.4, Dynamic),
            (5.0, 11.6, Static),
            (9.0, 5.0, Static),
            (-0.4, -0.4, Dynamic),
            (f64::NAN, 90.0, Static),
        ] {
            assert_eq!(
                label_at(&cells, &Vector2::new(x, y)),
                expected,
                "({x}, {y})"
            );
        }
    }
}
