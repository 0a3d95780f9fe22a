//! Patch motion: what has moved sideways since an older image (decision 012).
//!
//! Free space ([`super::free_space`]) shows who has come nearer or has left their outline. Who sways
//! on the spot does neither: where there was a shirt there still is one, only another part of it. The
//! image shows that. A sample's patch is searched for in images ten to thirty frames old, starting
//! from the position it had there if it has been static since:
//!
//! eᵢ = ‖foundᵢ - predictedᵢ‖ / √(1 + (sᵢ / σ)²),   sᵢ = f b σ_z(zᵢ) / zᵢ²
//!
//! with the baseline b between the two cameras: sᵢ is the error of the prediction due to that of the
//! sample's depth. In units of max(σ, spread), where the spread is read off the smaller two fifths of
//! the samples that pass for static, eᵢ is a residual like that of free space. A single image may be
//! wrong, so the second largest of three counts.
//!
//! This is the paper's flow check (sec. III-B) in the opposite direction and over a longer time. That
//! check restores suspects from one frame to the next, in which somebody who sways moves less than a
//! pixel.

use garad_core::{DepthImage, FrameId, KeyframeId, Real, Se3};
use garad_features::{LkConfig, LkPyramid, LkTrack, lk};
use nalgebra::Vector2;

use super::bootstrap::FutureView;
use super::evidence::DepthEvidence;
use super::samples::{FrameView, Sample};
use crate::config::PatchMotionConfig;
use crate::context::Context;
use crate::images::{ImageStore, lk_point};
use crate::map::Map;

/// Half the side of a Lucas-Kanade window, px.
const HALF_WINDOW_PX: f64 = 10.0;
/// Share of the samples that pass for static from which the spread is read.
const SPREAD_SHARE: f64 = 0.4;
/// Fewer samples than this give no spread.
const MIN_SPREAD_SAMPLES: usize = 20;
/// Residual of free space up to which a sample passes for static, standard deviations.
const STATIC_SIGMAS: f64 = 2.0;
/// Residual of free space from which a sample needs no second cue, standard deviations.
const DECIDED_SIGMAS: f64 = 6.0;
/// Least distance to a future view, frames.
const MIN_FUTURE_FRAMES: u32 = 3;

/// Steps per level, and the length in pixels below which they end: a fifth of a pixel is enough.
const ITERATIONS: usize = 8;
const EPSILON_PX: f64 = 0.05;

/// Sample, its position in the frame and its static prediction in the reference image, px.
type Task = (usize, [f32; 2], [f32; 2]);

/// An image of another time, and the pose it was taken from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReferenceImage<'a> {
    pyramid: &'a LkPyramid,
    camera_from_world: Se3,
}

/// The kept images whose ages are nearest to those configured, and those of future views.
pub(crate) fn reference_images<'a>(
    context: &Context,
    map: &Map,
    images: &'a ImageStore,
    future: &'a [FutureView],
    now: FrameId,
) -> Vec<ReferenceImage<'a>> {
    let config = &context.config.labels.patch_motion;
    if !config.enabled {
        return Vec::new();
    }
    // A replayed frame has keyframes that are younger.
    let age = |k: KeyframeId| now.0.checked_sub(map.keyframe(k).id.0);
    let kept = images.keyframes();
    let aged: Vec<(KeyframeId, u32)> = kept.filter_map(|k| Some((k, age(k)?))).collect();
    let mut chosen: Vec<KeyframeId> = config
        .ages_frames
        .iter()
        .filter_map(|wanted| {
            let off = |(_, age): &&(KeyframeId, u32)| age.abs_diff(*wanted);
            let nearest = aged.iter().min_by_key(off);
            nearest.filter(|k| off(k) <= config.slack_frames())
        })
        .map(|(k, _)| *k)
        .collect();
    chosen.sort_unstable();
    chosen.dedup();
    let kept = chosen.into_iter().filter_map(|k| {
        Some(ReferenceImage {
            pyramid: images.get(k)?,
            camera_from_world: map.keyframe(k).camera_from_world,
        })
    });
    let future = future.iter().filter_map(|view| {
        let far = now.0.abs_diff(view.frame.0) >= MIN_FUTURE_FRAMES;
        Some(ReferenceImage {
            pyramid: view.pyramid.as_ref().filter(|_| far)?,
            camera_from_world: view.camera_from_world,
        })
    });
    kept.chain(future).collect()
}

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
        !decided && is_whole(&samples[*i], view.depth, config)
    };
    let searched: Vec<usize> = (0..samples.len()).filter(open).collect();
    let mut residuals = vec![Vec::new(); samples.len()];
    for reference in references {
        let found = displacements(context, view, pyramid, *reference, samples, &searched);
        let of_static = found.iter().filter(|(i, _)| passes[*i]).map(|(_, e)| *e);
        let Some(spread) = spread(of_static.collect()) else {
            continue;
        };
        let unit = spread.max(config.sigma_px);
        for (i, e) in found {
            residuals[i].push(e / unit);
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
fn is_whole(sample: &Sample, depth: &DepthImage, config: &PatchMotionConfig) -> bool {
    let steps = [-1.0, -0.5, 0.0, 0.5, 1.0].map(|s| s * HALF_WINDOW_PX);
    let positions = steps.iter().flat_map(|dy| steps.map(|dx| (dx, *dy)));
    let nearer = |(dx, dy): (f64, f64)| {
        let (x, y) = (sample.px.x + dx, sample.px.y + dy);
        let z = (x >= 0.0 && y >= 0.0).then(|| depth.get((x + 0.5) as usize, (y + 0.5) as usize));
        z.flatten()
            .is_some_and(|z| *z > 0.0 && f64::from(*z) < sample.depth_m - config.edge_m)
    };
    !positions.into_iter().any(nearer)
}

/// eᵢ of the samples that a reference image has an answer for, px: 0 for those that are at their static
/// prediction.
///
/// A position that explains the patch no better than the prediction does is no displacement: on
/// plain cloth and along an edge the search ends anywhere. So samples whose residual at the
/// prediction is hardly larger than that of the best are not searched for at all.
fn displacements(
    context: &Context,
    view: FrameView<'_>,
    pyramid: &LkPyramid,
    reference: ReferenceImage<'_>,
    samples: &[Sample],
    searched: &[usize],
) -> Vec<(usize, f64)> {
    let camera = &context.camera;
    let config = &context.config.labels.patch_motion;
    let mut tasks: Vec<Task> = searched
        .iter()
        .filter_map(|&i| {
            let p_cam = reference.camera_from_world * samples[i].p_world;
            let uv = camera.project(&p_cam)?;
            let inside = camera.contains(&uv);
            let predicted = inside.then(|| camera.distort_pixel(&uv))?;
            Some((i, lk_point(&samples[i].px), lk_point(&predicted)))
        })
        .collect();
    let search = LkConfig {
        iterations: ITERATIONS,
        epsilon_px: EPSILON_PX,
        min_eigenvalue: config.min_eigenvalue,
        max_residual: Some(config.max_residual),
        ..LkConfig::default()
    };
    let one_step = LkConfig {
        iterations: 1,
        max_residual: None,
        coarsest_level: 0,
        ..search
    };
    let compare = LkConfig {
        iterations: 0,
        ..one_step
    };
    let track = |tasks: &[Task], config| {
        let points: Vec<_> = tasks.iter().map(|t| t.1).collect();
        let starts: Vec<_> = tasks.iter().map(|t| t.2).collect();
        let to = reference.pyramid;
        lk::track(pyramid, to, &points, Some(&starts), config, context.par)
            .expect("images of one camera have one size, and there is a start per point")
    };
    let compared = track(&tasks, &compare);
    let mut residuals: Vec<f64> = compared
        .iter()
        .filter(|at_prediction| at_prediction.is_tracked())
        .map(|at_prediction| f64::from(at_prediction.residual))
        .collect();
    residuals.sort_by(f64::total_cmp);
    let Some(least) = residuals.get(residuals.len() / 10) else {
        return Vec::new();
    };
    let explains_less = |at_prediction: f64, found: f64| {
        at_prediction >= config.min_residual_ratio * found + config.min_residual_gain
    };
    let mut answers = Vec::new();
    let mut doubtful = Vec::new();
    let mut compared = compared.into_iter();
    tasks.retain(|(i, _, _)| {
        let Some(at_prediction) = compared.next().filter(LkTrack::is_tracked) else {
            return false;
        };
        let is_doubtful = explains_less(f64::from(at_prediction.residual), *least);
        match is_doubtful {
            true => doubtful.push(at_prediction),
            false => answers.push((*i, 0.0)),
        }
        is_doubtful
    });
    // Where the patch is instead. One step on the full image is enough for those at rest, that are as well
    // explained less than σ beside their prediction; the others are searched for from the coarsest level down.
    let mut found = track(&tasks, &one_step);
    let rests = |(task, step): (&Task, &LkTrack)| {
        let off_px = Vector2::from([0, 1].map(|k| f64::from(step.xy[k] - task.2[k])));
        let explained = !explains_less(f64::from(step.residual), *least);
        step.is_tracked() && explained && off_px.norm() < config.sigma_px
    };
    let farther: Vec<usize> = (0..tasks.len())
        .filter(|&k| !rests((&tasks[k], &found[k])))
        .collect();
    let farther_tasks: Vec<Task> = farther.iter().map(|&k| tasks[k]).collect();
    for (k, track) in farther.into_iter().zip(track(&farther_tasks, &search)) {
        found[k] = track;
    }
    let reference_center = reference.camera_from_world.inverse().translation;
    let baseline_m = (reference_center - view.frame.center()).norm();
    let noise = &context.config.labels.noise;
    for (((i, _, start), found), at_prediction) in tasks.iter().zip(found).zip(doubtful) {
        if !found.is_tracked() {
            continue;
        }
        let [dx, dy] = [0, 1].map(|k| f64::from(found.xy[k] - start[k]));
        let z = samples[*i].depth_m;
        let by_depth_px = camera.fx * baseline_m * noise.sigma_m(z) / (z * z);
        let share = by_depth_px / config.sigma_px;
        let off_px = ((dx * dx + dy * dy) / (1.0 + share * share)).sqrt();
        let [at_prediction, found] = [at_prediction, found].map(|t| f64::from(t.residual));
        let better = explains_less(at_prediction, found);
        answers.push((*i, if better { off_px } else { 0.0 }));
    }
    answers
}

/// σ of displacements of which a part is not static: of two normal coordinates, the share
/// 1 - exp(-q² / (2 σ²)) has a length up to q. `None` for too few.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share of a length"
)]
fn spread(mut lengths: Vec<f64>) -> Option<f64> {
    if lengths.len() < MIN_SPREAD_SAMPLES {
        return None;
    }
    lengths.sort_by(f64::total_cmp);
    let quantile = lengths[(SPREAD_SHARE * lengths.len() as f64) as usize];
    Some(quantile / (-2.0 * Real::ln(1.0 - SPREAD_SHARE)).sqrt())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use garad_core::GrayImage;
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::dynamics::free_space::FreeSpace;
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
            let keyframe = world.keep(seen, &wall());
            let World {
                images,
                map,
                context,
                ..
            } = &mut world;
            images.insert(
                keyframe,
                Some(Arc::new(swayed(*by_px))),
                map,
                &context.config,
            );
        }
        world
    }

    /// Residuals of every fourth pixel of frame 40, in units of σ, where free space finds everything
    /// static: those of the shirt, and those whose windows do not touch it.
    fn residuals(world: &World, depth: &DepthImage, pyramid: &LkPyramid) -> [Vec<f64>; 2] {
        let World {
            context,
            map,
            images,
            dynamics,
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
        let references = reference_images(context, map, images, &dynamics.future, now.id);
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
        // 3 px are 6 units of 0.5 px.
        for residual in shirt {
            assert!((residual - 6.0).abs() < 0.3, "{residual}");
        }
        assert!(largest(&wall_around) <= 0.0, "the wall is at rest");
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
        for k in world.images.keyframes().collect::<Vec<_>>() {
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
