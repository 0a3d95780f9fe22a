//! From the sums of each row of tiles to the gradients of each Gaussian.

use std::slice::ChunksMut;

use garad_core::{GaussianMap, Par};

use super::backward::Sums;
use super::bin::Bands;
use super::splat::Splat;
use crate::backward::Gradients;
use crate::covariance::rotation;
use crate::error::RasterError;
use crate::options::ClampGradient;
use crate::project::project_one_backward;
use crate::splat::Projected;
use crate::splat_gradient::SplatGradient;
use crate::view::View;

/// Splats or Gaussians of one task.
const CHUNK: usize = 512;
/// Splats fetched together.
const BATCH: usize = 64;

/// Adds up each splat's sums over the bands, upper band first. `sums` run beside the entries of
/// `bands`.
pub(crate) fn over_bands(splats: &[Splat], bands: &Bands, sums: &[Sums], par: Par) -> Vec<Sums> {
    let mut total = vec![Sums::default(); splats.len()];
    par.for_each_chunk_mut(&mut total, CHUNK, |chunk, total| {
        let first = chunk * CHUNK;
        // Lists are ascending: a chunk's splats stand together in each.
        let mut next: Vec<usize> = (0..bands.rows())
            .map(|band| {
                let list = bands.list(band);
                bands.start(band) + list.partition_point(|entry| (entry.position as usize) < first)
            })
            .collect();
        for (total, splat) in total.iter_mut().zip(&splats[first..]) {
            for band in splat.cells[2]..splat.cells[3] {
                let next = &mut next[usize::from(band)];
                total.add(&sums[*next]);
                *next += 1;
            }
        }
    });
    total
}

/// A run of rows of every gradient.
struct Rows<'a> {
    /// Row in the map of the first.
    first: usize,
    means: &'a mut [[f32; 3]],
    log_scales: &'a mut [[f32; 3]],
    quaternions: &'a mut [[f32; 4]],
    opacity_logits: &'a mut [f32],
    sh: &'a mut [[f32; 3]],
    means2d: &'a mut [[f32; 2]],
    conics: &'a mut [[f32; 3]],
    opacities: &'a mut [f32],
    colors: &'a mut [[f32; 3]],
    depths: &'a mut [f32],
    /// Their term of the pose's gradient.
    pose: [f64; 6],
    /// First splat that the map cannot have made.
    bad: Option<usize>,
}

/// R15 to R20 for every splat, each result written to its row.
///
/// The pose's gradient is added over runs of 512 rows of the map, then over the runs, in f64.
///
/// # Errors
/// [`RasterError::NotThisMap`] with the first splat whose row cannot be drawn.
pub(crate) fn to_map(
    map: &GaussianMap<f32>,
    view: &View<f32>,
    projected: &[Projected<f32>],
    sums: &[Sums],
    clamp: ClampGradient,
    par: Par,
) -> Result<Gradients<f32>, RasterError> {
    const NONE: u32 = u32::MAX;
    let mut splat_of = vec![NONE; map.len()];
    for (splat, position) in projected.iter().zip(0u32..) {
        splat_of[splat.index as usize] = position;
    }
    let mut gradients = Gradients::zero(map.len(), map.coefficients());
    let mut runs = Rows::cut(&mut gradients, map.coefficients());
    par.for_each_chunk_mut(&mut runs, 1, |_, runs| {
        for run in runs {
            let mut batch = Vec::with_capacity(BATCH);
            for first in (0..run.means.len()).step_by(BATCH) {
                // Copied first, in a loop that waits for many splats at a time.
                let rows = first..(first + BATCH).min(run.means.len());
                batch.extend(rows.filter_map(|k| {
                    let at = splat_of[run.first + k];
                    (at != NONE).then(|| (k, at, projected[at as usize], sums[at as usize]))
                }));
                for (k, at, splat, sums) in batch.drain(..) {
                    run.write(k, map, view, (at as usize, &splat), &sums, clamp);
                }
            }
        }
    });
    let mut pose = [0.0f64; 6];
    let mut bad: Option<usize> = None;
    for run in &runs {
        for (sum, part) in pose.iter_mut().zip(run.pose) {
            *sum += part;
        }
        bad = [bad, run.bad].into_iter().flatten().min();
    }
    if let Some(splat) = bad {
        return Err(RasterError::NotThisMap { splat });
    }
    #[allow(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
    let pose = pose.map(|v| v as f32);
    gradients.pose = pose;
    Ok(gradients)
}

impl<'a> Rows<'a> {
    fn cut(gradients: &'a mut Gradients<f32>, coefficients: usize) -> Vec<Self> {
        fn next<'b, A>(rows: &mut ChunksMut<'b, A>) -> &'b mut [A] {
            rows.next().expect("as many rows as means")
        }
        let mut log_scales = gradients.log_scales.chunks_mut(CHUNK);
        let mut quaternions = gradients.quaternions.chunks_mut(CHUNK);
        let mut opacity_logits = gradients.opacity_logits.chunks_mut(CHUNK);
        let mut sh = gradients.sh.chunks_mut(CHUNK * coefficients);
        let mut means2d = gradients.means2d.chunks_mut(CHUNK);
        let mut conics = gradients.conics.chunks_mut(CHUNK);
        let mut opacities = gradients.opacities.chunks_mut(CHUNK);
        let mut colors = gradients.colors.chunks_mut(CHUNK);
        let mut depths = gradients.depths.chunks_mut(CHUNK);
        let means = gradients.means.chunks_mut(CHUNK).enumerate();
        let runs = means.map(|(i, means)| Self {
            first: i * CHUNK,
            means,
            log_scales: next(&mut log_scales),
            quaternions: next(&mut quaternions),
            opacity_logits: next(&mut opacity_logits),
            sh: next(&mut sh),
            means2d: next(&mut means2d),
            conics: next(&mut conics),
            opacities: next(&mut opacities),
            colors: next(&mut colors),
            depths: next(&mut depths),
            pose: [0.0; 6],
            bad: None,
        });
        runs.collect()
    }

    /// Backward pass of one splat, into row `k` of the run.
    fn write(
        &mut self,
        k: usize,
        map: &GaussianMap<f32>,
        view: &View<f32>,
        (position, splat): (usize, &Projected<f32>),
        sums: &Sums,
        clamp: ClampGradient,
    ) {
        let row = if sums.are_zero() {
            // Blended into no pixel: the row is zero already.
            rotation(map.quaternions[splat.index as usize]).map(|_| None)
        } else {
            let d = SplatGradient::new(splat, &sums.named());
            project_one_backward(map, view, splat, &d, clamp).map(|row| Some((d, row)))
        };
        let Some(row) = row else {
            self.bad = [self.bad, Some(position)].into_iter().flatten().min();
            return;
        };
        let Some((d, row)) = row else {
            return;
        };
        let n = self.sh.len() / self.means.len();
        self.means[k] = row.mean;
        self.log_scales[k] = row.log_scale;
        self.quaternions[k] = row.quaternion;
        self.opacity_logits[k] = row.opacity_logit;
        row.write_sh(&mut self.sh[k * n..(k + 1) * n]);
        self.means2d[k] = d.mean_px;
        self.conics[k] = d.conic;
        self.opacities[k] = d.opacity;
        self.colors[k] = d.color;
        self.depths[k] = d.depth_m;
        for (sum, part) in self.pose.iter_mut().zip(row.pose) {
            *sum += f64::from(part);
        }
    }
}
