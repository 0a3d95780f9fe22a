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
mod tests {
    use std::sync::Arc;

    use garad_core::{FrameId, GrayImage, Se3};
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::dynamics::bootstrap::FutureView;
    use crate::dynamics::free_space::FreeSpace;
    use crate::dynamics::past::reference_images;
    use crate::testing::{World, is_in, texture, wall, wall_behind};

    /// What has moved sideways, and how far in ten frames, px.
    const SHIRT_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
    const SWAY_PX: usize = 3;
    /// Samples whose windows lie within the shirt, before and after.
    const WITHIN_PX: [[usize; 2]; 2] = [[70, 98], [46, 82]];

    fn config() -> Config {
        let mut config = Config::default();
        config.labels.patch_motion.enabled = true;
        config
    }

    /// The texture with the shirt moved to the left by this much.
    fn swayed(by_px: usize) -> LkPyramid {
        let texture = texture();
        let image = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
            true => texture[(x + by_px, y)],
            false => texture[(x, y)],
        });
        LkPyramid::new(&image, 3).expect("an image")
    }

    /// A camera at rest before a wall, whose depth does not depend on what is painted on it: images of
    /// these frames, with the shirt this far to the left.
    fn world_that_saw(images: &[(u32, usize)], config: Config) -> World {
        let mut world = World::new(config);
        for (id, by_px) in images {
            let seen = world.frame(*id, &wall());
            world.keep(seen, &wall());
            let view = world.dynamics.past.back_mut().expect("just added");
            view.image = Some(Arc::new(swayed(*by_px)));
        }
        world
    }

    /// Residuals of every fourth pixel of frame 40, in units of σ, where free space finds everything
    /// static: those of the shirt, and those whose windows do not touch it.
    fn residuals(world: &World, depth: &DepthImage, pyramid: &LkPyramid) -> [Vec<f64>; 2] {
        let World {
            context,
            map,
            dynamics,
            ..
        } = world;
        let now = world.frame(40, depth);
        let columns = (4..156usize).step_by(4);
        let places = columns.flat_map(|x| (4..116usize).step_by(4).map(move |y| (x, y)));
        let places: Vec<(usize, usize)> = places.collect();
        let samples: Vec<Sample> = places
            .iter()
            .map(|&(x, y)| {
                let px = Vector2::new(x as f64, y as f64);
                let depth_m = f64::from(depth[(x, y)]);
                let p_world: Vector3<f64> = context.camera.unproject(&px, depth_m);
                Sample {
                    px,
                    depth_m,
                    p_world,
                }
            })
            .collect();
        let on_surface = DepthEvidence {
            residual: Some(0.0),
            agreed_frames: 40,
        };
        let mut evidence = vec![on_surface; samples.len()];
        let references = reference_images(context, map, &dynamics.past, &dynamics.future, now.id);
        let view = FrameView {
            frame: &now,
            depth,
            pyramid: Some(pyramid),
        };
        add_patch_motion(context, view, pyramid, &references, &samples, &mut evidence);
        let of = |is: &dyn Fn(usize, usize) -> bool| {
            let both = places.iter().zip(&evidence);
            both.filter(|((x, y), _)| is(*x, *y))
                .filter_map(|(_, e)| e.residual)
                .collect::<Vec<_>>()
        };
        let near = [[34, 126], [18, 110]];
        [
            of(&|x, y| is_in(WITHIN_PX, x, y)),
            of(&|x, y| !is_in(near, x, y)),
        ]
    }

    fn largest(residuals: &[f64]) -> f64 {
        residuals.iter().copied().fold(0.0, f64::max)
    }

    #[test]
    fn a_swaying_shirt_is_found_though_depth_agrees() {
        let world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
        let [shirt, wall_around] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(shirt.len() >= 49 && wall_around.len() > 300, "samples");
        // 3 px are 10 units of 0.3 px.
        for residual in shirt {
            assert!((residual - 10.0).abs() < 0.5, "{residual}");
        }
        assert!(largest(&wall_around) <= 0.0, "the wall is at rest");
    }

    /// Where the shirt was, something with another texture is now.
    #[test]
    fn a_patch_that_is_nowhere_near_has_changed() {
        let world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
        let texture = texture();
        let other = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
            true => texture[(159 - x, 119 - y)],
            false => texture[(x, y)],
        });
        let now = LkPyramid::new(&other, 3).expect("an image");
        let [shirt, wall_around] = residuals(&world, &wall(), &now);
        let changed = shirt.iter().filter(|r| **r >= CHANGED_SIGMAS).count();
        assert!(
            10 * changed >= 9 * shirt.len(),
            "{changed} of {}",
            shirt.len()
        );
        assert!(largest(&wall_around) <= 0.0, "the wall is at rest");
    }

    /// In the older images something stood before the shirt: they do not say where it was.
    #[test]
    fn images_in_which_a_sample_was_hidden_have_no_answer() {
        let mut world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
        for view in &mut world.dynamics.past {
            view.free_space = FreeSpace::new(&wall_behind(SHIRT_PX), 8.0);
        }
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "hidden");
        for view in &mut world.dynamics.past {
            view.free_space = FreeSpace::new(&DepthImage::new(160, 120, 0.0), 8.0);
        }
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "no depth");
    }

    #[test]
    fn one_image_against_two_does_not_count() {
        let shirt_of = |images: [(u32, usize); 3]| {
            let world = world_that_saw(&images, config());
            let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
            largest(&shirt)
        };
        assert!(shirt_of([(10, 0), (20, 3), (30, 3)]) <= 0.0, "one of three");
        assert!(shirt_of([(10, 0), (20, 0), (30, 3)]) > 5.0, "two of three");
    }

    #[test]
    fn images_too_young_or_too_old_are_not_compared() {
        let world = world_that_saw(&[(4, 0), (36, 0)], config());
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "36 and 4 frames old");
        let world = world_that_saw(&[(5, 0)], config());
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) > 5.0, "35 frames: within half a step of 30");
    }

    /// A future view is one more reference.
    #[test]
    fn future_views_are_references() {
        let mut world = world_that_saw(&[], config());
        world.dynamics.future.push(FutureView {
            frame: FrameId(49),
            free_space: FreeSpace::new(&wall(), 8.0),
            pyramid: Some(swayed(0)),
            camera_from_world: Se3::identity(),
        });
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) > 5.0, "9 frames ahead");
        world.dynamics.future[0].frame = FrameId(42);
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "2 frames ahead is too near");
    }

    /// The camera has moved 5 cm to the right: with fx = 120 px, a wall at 3 m moves 2 px to the left.
    #[test]
    fn camera_motion_is_no_displacement() {
        let mut world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
        let now_from_then = Se3::exp(&[-0.05, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        for k in world.dynamics.past.iter().map(|view| view.reference) {
            world.map.keyframe_mut(k).camera_from_world = now_from_then.inverse();
        }
        let all = residuals(&world, &wall(), &passed(2)).concat();
        assert!(largest(&all) <= 0.0, "as predicted");
        let [shirt, around] = residuals(&world, &wall(), &passed(0));
        let least = shirt.into_iter().fold(f64::INFINITY, f64::min);
        assert!(least > 3.5, "what moved with the camera: {least}");
        assert!(largest(&around) <= 0.0, "the wall has not");
    }

    /// The texture moved to the left by 2 px, the shirt by this much.
    fn passed(shirt_px: usize) -> LkPyramid {
        let texture = texture();
        let image = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
            true => texture[(x + shirt_px, y)],
            false => texture[((x + 2).min(159), y)],
        });
        LkPyramid::new(&image, 3).expect("an image")
    }

    #[test]
    fn no_residual_on_plain_cloth_beside_edges_or_if_switched_off() {
        let images = [(10, 0), (20, 0), (30, 0)];
        let world = world_that_saw(&images, config());
        let plain = LkPyramid::new(&GrayImage::new(160, 120, 90), 3).expect("an image");
        let [shirt, _] = residuals(&world, &wall(), &plain);
        assert!(largest(&shirt) <= 0.0, "plain");
        // Something half as far in the middle of the shirt reaches into all its windows.
        let before = wall_behind([[80, 88], [60, 68]]);
        let [beside, _] = residuals(&world, &before, &swayed(SWAY_PX));
        let found = beside.iter().filter(|r| **r > 0.0).count();
        let [all, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        assert!(
            2 * found < all.len(),
            "{found} of {} beside an edge",
            all.len()
        );
        let mut config = config();
        config.labels.patch_motion.enabled = false;
        let off = world_that_saw(&images, config);
        let [shirt, _] = residuals(&off, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "off");
    }
}
