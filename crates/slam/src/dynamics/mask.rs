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
