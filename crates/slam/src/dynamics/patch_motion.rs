//! Patch motion: what has moved sideways since an older image (decision 012).
//!
//! Free space ([`super::free_space`]) shows who has come nearer or has left their outline. Who sways
//! on the spot does neither: where there was a shirt there still is one, only another part of it. The
//! image shows that. A sample's patch is searched for in images ten to thirty frames old that saw its
//! surface, starting from the position it had there if it has been static since:
//!
//! eᵢ = ‖foundᵢ - predictedᵢ‖ / √(1 + (sᵢ / σ)²),   sᵢ = f b σ_z(zᵢ) / zᵢ²
//!
//! with the baseline b between the two cameras: sᵢ is the error of the prediction due to that of the
//! sample's depth. In units of max(σ, spread), where the spread is the robust standard deviation of the
//! displacements of samples that pass for static, eᵢ is a residual like that of free space. A patch that
//! is nowhere near, by its correlation, has changed: something else was there. A single image may be
//! wrong, so the second largest of three counts.
//!
//! This is the paper's flow check (sec. III-B, [`super::flow_check`]) in the opposite direction: that check
//! restores suspects that rest, this one suspects what does not.

use garad_core::DepthImage;
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use super::evidence::DepthEvidence;
use super::past::ReferenceImage;
use super::samples::{FrameView, Sample};
use crate::config::PatchMotionConfig;
use crate::context::Context;
use crate::images::lk_point;

/// Half the side of a Lucas-Kanade window, px.
const HALF_WINDOW_PX: f64 = 10.0;
/// Samples that pass for static from which the spread is read at most.
const MAX_SUPPORT: usize = 200;
/// Fewer samples than this give no spread.
const MIN_SPREAD_SAMPLES: usize = 20;
/// Residual of free space up to which a sample passes for static, standard deviations.
const STATIC_SIGMAS: f64 = 2.0;
/// Residual of free space from which a sample needs no second cue, standard deviations.
const DECIDED_SIGMAS: f64 = 6.0;
/// Residual of a sample whose patch is nowhere near, standard deviations.
const CHANGED_SIGMAS: f64 = 12.0;

/// Steps per level, and the length in pixels below which they end: a fifth of a pixel is enough.
const ITERATIONS: usize = 8;
const EPSILON_PX: f64 = 0.05;

/// Raises the residuals of those samples whose patches have moved since the reference images.
pub(crate) fn add_patch_motion(
    context: &Context,
    view: FrameView<'_>,
    pyramid: &LkPyramid,
    references: &[ReferenceImage<'_>],
    samples: &[Sample],
    evidence: &mut [DepthEvidence],
) {
    let config = &context.config.labels.patch_motion;
    if !config.enabled {
        return;
    }
    let passes: Vec<bool> = evidence
        .iter()
        .map(|e| e.residual.is_some_and(|r| r < STATIC_SIGMAS))
        .collect();
    let open = |i: &usize| {
        let decided = evidence[*i].residual.is_some_and(|r| r > DECIDED_SIGMAS);
        !decided && is_whole(&samples[*i], view.depth, config.edge_m)
    };
    let searched: Vec<usize> = (0..samples.len()).filter(open).collect();
    let mut residuals = vec![Vec::new(); samples.len()];
    for reference in references {
        let comparison = Comparison {
            context,
            pyramid,
            reference: *reference,
            baseline_m: (reference.center() - view.frame.center()).norm(),
        };
        let tasks = comparison.tasks(samples, &searched);
        let Some(spread_px) = comparison.spread_px(tasks.iter().filter(|t| passes[t.sample]))
        else {
            continue;
        };
        let unit_px = spread_px.max(config.sigma_px);
        for (i, answer) in comparison.answers(tasks, samples, unit_px) {
            residuals[i].push(match answer {
                Answer::Displaced(px) => px / unit_px,
                Answer::Changed => CHANGED_SIGMAS,
            });
        }
    }
    for (evidence, mut residuals) in evidence.iter_mut().zip(residuals) {
        residuals.sort_by(|a, b| b.total_cmp(a));
        if let Some(second) = residuals.get(1).or(residuals.first()) {
            evidence.residual = Some(evidence.residual.unwrap_or(0.0).max(*second));
        }
    }
}

/// Whether no much nearer surface reaches into the sample's window: it would be tracked instead.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "negative positions are left out before the cast; `get` refuses what lies outside"
)]
fn is_whole(sample: &Sample, depth: &DepthImage, edge_m: f64) -> bool {
    let steps = [-1.0, -0.5, 0.0, 0.5, 1.0].map(|s| s * HALF_WINDOW_PX);
    let positions = steps.iter().flat_map(|dy| steps.map(|dx| (dx, *dy)));
    let nearer = |(dx, dy): (f64, f64)| {
        let (x, y) = (sample.px.x + dx, sample.px.y + dy);
        let z = (x >= 0.0 && y >= 0.0).then(|| depth.get((x + 0.5) as usize, (y + 0.5) as usize));
        z.flatten()
            .is_some_and(|z| *z > 0.0 && f64::from(*z) < sample.depth_m - edge_m)
    };
    !positions.into_iter().any(nearer)
}

/// What a reference image says of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Answer {
    /// Its patch is this far from the static prediction, px.
    Displaced(f64),
    /// Its patch is nowhere near.
    Changed,
}

/// A sample to be searched for.
#[derive(Debug, Clone, Copy)]
struct Task {
    /// Its index.
    sample: usize,
    /// Its position in the frame, px, ...
    at: [f32; 2],
    /// ... its static prediction in the reference image, px, ...
    predicted: [f32; 2],
    /// ... and the correlation of the two patches.
    correlation: f64,
}

impl Task {
    fn off_px(&self, xy: [f32; 2]) -> f64 {
        Vector2::from([0, 1].map(|k| f64::from(xy[k] - self.predicted[k]))).norm()
    }
}

/// A frame beside one reference image.
#[derive(Debug, Clone, Copy)]
struct Comparison<'a> {
    context: &'a Context,
    pyramid: &'a LkPyramid,
    reference: ReferenceImage<'a>,
    /// Distance between the two cameras.
    baseline_m: f64,
}

impl Comparison<'_> {
    fn config(&self) -> &PatchMotionConfig {
        &self.context.config.labels.patch_motion
    }

    /// The samples whose surface the reference image sees.
    fn tasks(&self, samples: &[Sample], searched: &[usize]) -> Vec<Task> {
        let (camera, reference) = (&self.context.camera, &self.reference);
        let task = |sample: usize| {
            let p_world = &samples[sample].p_world;
            let predicted = lk_point(&reference.predicted_pixel(camera, p_world)?);
            let at = lk_point(&samples[sample].px);
            let visible = reference.sees(camera, p_world, self.config().edge_m);
            let correlation = self.pyramid.correlation(at, reference.pyramid, predicted);
            visible.then_some(Task {
                sample,
                at,
                predicted,
                correlation: correlation?,
            })
        };
        searched.iter().filter_map(|&i| task(i)).collect()
    }

    /// Where the patches are found from this level down, and their correlations there; `None` without texture
    /// and outside the image.
    fn search(&self, tasks: &[Task], coarsest_level: usize) -> Vec<Option<(f64, [f32; 2])>> {
        let lk_config = LkConfig {
            iterations: ITERATIONS,
            epsilon_px: EPSILON_PX,
            min_eigenvalue: self.config().min_eigenvalue,
            coarsest_level,
            ..LkConfig::default()
        };
        let points: Vec<_> = tasks.iter().map(|t| t.at).collect();
        let starts: Vec<_> = tasks.iter().map(|t| t.predicted).collect();
        let [from, to] = [self.pyramid, self.reference.pyramid];
        let par = self.context.par;
        let tracks = lk::track(from, to, &points, Some(&starts), &lk_config, par)
            .expect("images of one camera have one size, and there is a start per point");
        let found = tasks.iter().zip(tracks).map(|(task, track)| {
            let correlation = from.correlation(task.at, to, track.xy);
            Some((correlation.filter(|_| track.is_tracked())?, track.xy))
        });
        found.collect()
    }

    /// σ of the displacements of samples that pass for static, from their median: of two normal coordinates one
    /// half has a length up to σ √(2 ln 2). `None` for too few.
    fn spread_px<'a>(&self, of_static: impl Iterator<Item = &'a Task>) -> Option<f64> {
        let of_static: Vec<Task> = of_static.copied().collect();
        let every = of_static.len().div_ceil(MAX_SUPPORT).max(1);
        let support: Vec<Task> = of_static.into_iter().step_by(every).collect();
        let found = self.search(&support, 0);
        let found = support.iter().zip(found);
        let mut lengths: Vec<f64> = found
            .filter_map(|(task, found)| Some(task.off_px(found?.1)))
            .collect();
        lengths.sort_by(f64::total_cmp);
        let median = lengths.get(lengths.len() / 2);
        let median = median.filter(|_| lengths.len() >= MIN_SPREAD_SAMPLES)?;
        Some(median / (2.0 * std::f64::consts::LN_2).sqrt())
    }

    /// The samples with their answers; none for those without texture.
    ///
    /// A position that explains the patch no better than the prediction does is no displacement: on
    /// plain cloth and along an edge the search ends anywhere.
    fn answers(&self, tasks: Vec<Task>, samples: &[Sample], unit_px: f64) -> Vec<(usize, Answer)> {
        let (camera, config) = (&self.context.camera, self.config());
        let noise = &self.context.config.labels.noise;
        let is_same = |task: &Task| task.correlation >= config.same_correlation;
        let (same, tasks): (Vec<Task>, Vec<Task>) = tasks.into_iter().partition(is_same);
        let at_rest = same.iter().map(|t| (t.sample, Answer::Displaced(0.0)));
        // On the full image those at rest are found, and those without texture are left out; the others
        // are searched for from the coarsest level down.
        let mut found = self.search(&tasks, 0);
        let moves = |k: &usize| {
            found[*k].is_some_and(|(c, xy)| {
                c < config.min_correlation || tasks[*k].off_px(xy) >= unit_px
            })
        };
        let others: Vec<usize> = (0..tasks.len()).filter(moves).collect();
        let other_tasks: Vec<Task> = others.iter().map(|&k| tasks[k]).collect();
        for (k, far) in others
            .into_iter()
            .zip(self.search(&other_tasks, usize::MAX))
        {
            let is_better = |(c, _): &(f64, _)| found[k].is_some_and(|(before, _)| *c > before);
            found[k] = far.filter(is_better).or(found[k]);
        }
        let answer = |task: &Task, (c, xy): (f64, [f32; 2])| {
            if c.max(task.correlation) < config.min_correlation {
                return Answer::Changed;
            }
            let worse = 1.0 - task.correlation;
            if worse < config.min_ratio * (1.0 - c) + config.min_gain {
                return Answer::Displaced(0.0);
            }
            let z = samples[task.sample].depth_m;
            let by_depth_px = camera.fx * self.baseline_m * noise.sigma_m(z) / (z * z);
            let share = by_depth_px / config.sigma_px;
            Answer::Displaced(task.off_px(xy) / (1.0 + share * share).sqrt())
        };
        let searched = tasks.iter().zip(found);
        let searched =
            searched.filter_map(|(task, found)| Some((task.sample, answer(task, found?))));
        at_rest.chain(searched).collect()
    }
}

#[cfg(test)]
mod tests;
