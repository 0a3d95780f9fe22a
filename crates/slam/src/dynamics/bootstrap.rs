//! Bootstrap: the first frames, checked against the frames that follow them (decision 011).
//!
//! What moves is found by comparing a frame with earlier ones, and the first frames have none. If
//! people walk there, they distort the first poses, the first keyframes put them into the map, and
//! everything after is compared with that. So the first frames are buffered, and after the last of
//! them they are checked:
//!
//! 1. Where did later frames stand, relative to the first? By then people have moved a step while the
//!    room has not, so one motion fits the room's keypoints and depth, and any other fits less. It is
//!    searched for independently of how the frames were tracked ([`register`]).
//! 2. From there, which part of the first frame is free space in the later depth images? Something
//!    stood there and has moved ([`super::free_space`], applied in both directions of time).
//! 3. If something did, the run restarts with the first frame, and the later frames serve as future
//!    views: what moves is known from the start. If not, nothing happens.

use garad_core::{DepthImage, FrameId, RgbImage, Rng, Se3};
use garad_features::matching::match_descriptors;
use garad_features::{LkPyramid, MatchConfig};
use garad_optim::PoseObservation;
use serde::{Deserialize, Serialize};

use super::free_space::FreeSpace;
use crate::context::Context;
use crate::frame::Frame;
use crate::images::lk_pyramid;
use crate::io::FrameInput;
use crate::tracking::depth_pose::DepthPoseProblem;
use crate::tracking::observation::observation;
use crate::tracking::rigid::rigid_from_pairs;

/// Draws of three pairs. If a quarter of the pairs is of the room, 400 draws miss all triples of the
/// room once in 500.
const DRAWS: usize = 400;
/// The best draws from which the minimum is searched.
const STARTS: usize = 12;

/// A frame as it came, its depth at the time of its colour image.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct BufferedFrame {
    t_s: f64,
    rgb: RgbImage,
    depth: DepthImage,
    /// Its features, not linked to landmarks.
    pub(crate) frame: Frame,
}

impl BufferedFrame {
    /// The input it was made from.
    pub(crate) fn input(&self) -> FrameInput<'_> {
        FrameInput {
            t_s: self.t_s,
            depth_t_s: self.t_s,
            rgb: &self.rgb,
            depth: &self.depth,
            mask: None,
        }
    }
}

/// The first frames of a run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct BootstrapBuffer {
    pub(crate) frames: Vec<BufferedFrame>,
}

impl BootstrapBuffer {
    pub(crate) fn push(&mut self, input: &FrameInput<'_>, frame: &Frame) {
        self.frames.push(BufferedFrame {
            t_s: input.t_s,
            rgb: input.rgb.clone(),
            depth: input.depth.clone(),
            frame: frame.clone(),
        });
    }
}

/// A later frame, and where it stood relative to the first.
#[derive(Debug, Clone)]
pub(crate) struct FutureView {
    pub(crate) frame: FrameId,
    pub(crate) free_space: FreeSpace,
    /// For patch motion ([`super::patch_motion`]), if it is enabled.
    pub(crate) pyramid: Option<LkPyramid>,
    pub(crate) camera_from_world: Se3,
}

/// The middle and the last buffered frame as future views of the first.
pub(crate) fn future_views(context: &Context, buffer: &BootstrapBuffer) -> Vec<FutureView> {
    let n = buffer.frames.len();
    let Some(first) = buffer.frames.first() else {
        return Vec::new();
    };
    let later = [n / 2, n - 1].into_iter().filter(|k| *k > 0);
    later
        .filter_map(|k| {
            let later = &buffer.frames[k];
            Some(FutureView {
                frame: later.frame.id,
                free_space: FreeSpace::new(&later.depth, context.config.features.max_depth_m),
                pyramid: patch_motion_pyramid(context, &later.rgb),
                camera_from_world: register(context, &first.frame, &later.frame)?,
            })
        })
        .collect()
}

/// The pyramid for patch motion, if that is enabled.
pub(crate) fn patch_motion_pyramid(context: &Context, rgb: &RgbImage) -> Option<LkPyramid> {
    let enabled = context.config.labels.patch_motion.enabled;
    enabled.then(|| lk_pyramid(&rgb.to_gray(), &context.config))?
}

/// Pose of `last` relative to `first`: the minimum of F (decision 009) over keypoints matched by
/// descriptor alone and both depth images, started from the best of many motions, each that of three
/// matches, and from rest. `None` without depth.
fn register(context: &Context, first: &Frame, last: &Frame) -> Option<Se3> {
    let at_rest = Se3::identity();
    let reference = [(first.depth_planes.as_ref()?, &at_rest)];
    let planes = last.depth_planes.as_ref()?;
    let matches = match_descriptors(
        &first.descriptors,
        &last.descriptors,
        &MatchConfig::default(),
        context.par,
    );
    let points = matches.iter().filter_map(|m| {
        let before = first.depth_m[m.query]?;
        let now = last.depth_m[m.train]?;
        let p_first = context.camera.unproject(&first.uv_px[m.query], before);
        let p_last = context.camera.unproject(&last.uv_px[m.train], now);
        let observation = PoseObservation {
            depth: None,
            ..observation(&context.config.tracking, last, m.train, p_first)
        };
        Some(((p_last, p_first), observation))
    });
    let (pairs, observations): (Vec<_>, Vec<_>) = points.unzip();
    if pairs.is_empty() {
        return None;
    }
    let problem = || DepthPoseProblem::new(context, planes, &reference, observations.clone());
    let judge = problem();
    let cost = |pose: &Se3| judge.cost(pose) + judge.overlap_penalty(pose);
    let key = [u64::from(first.id.0), u64::from(last.id.0)];
    let mut rng = Rng::keyed(context.rng_seed, &key);
    let drawn = (0..DRAWS).filter_map(|_| {
        let draw = [0; 3].map(|_| pairs[rng.below(pairs.len())]);
        rigid_from_pairs(&draw)
    });
    let mut found: Vec<(f64, Se3)> = drawn
        .chain([at_rest])
        .map(|pose| (cost(&pose), pose))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0)); // stable
    let minima = found.iter().take(STARTS).map(|(_, start)| {
        let (pose, _) = problem().minimise(*start);
        (cost(&pose), pose)
    });
    let best = minima.min_by(|a, b| a.0.total_cmp(&b.0))?;
    best.1.is_finite().then_some(best.1)
}

#[cfg(test)]
mod tests {
    use garad_core::GrayImage;
    use nalgebra::Vector6;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, keypoints, places, uneven_camera, wall};

    /// Frames 3, 7, 8, 15 and 20 of a camera that goes to the right before the wall: with f = 120 px, what is at 3 m goes
    /// 2 px to the left for 5 cm.
    fn buffer(world: &World, lefts_px: &[(u32, usize)]) -> BootstrapBuffer {
        let mut rng = Rng::new(9);
        let descriptors: Vec<_> = (places().iter())
            .map(|_| garad_features::Descriptor([0; 4].map(|_| rng.next_u64())))
            .collect();
        let (rgb, depth) = (RgbImage::new(160, 120, [90; 3]), wall());
        let mut buffer = BootstrapBuffer::default();
        for (id, left_px) in lefts_px {
            let shifted = places().into_iter().map(|[x, y]| [x - left_px, y]);
            let mut frame = world.frame_of(*id, &keypoints(shifted), &depth);
            frame.descriptors.clone_from(&descriptors);
            let input = FrameInput {
                t_s: f64::from(*id),
                depth_t_s: 0.0,
                rgb: &rgb,
                depth: &depth,
                mask: None,
            };
            buffer.push(&input, &frame);
        }
        buffer
    }

    #[test]
    fn the_middle_and_the_last_frame_are_future_views_of_the_first() {
        let mut world = World::new(Config::default());
        world.context.config.labels.patch_motion.enabled = false;
        let mut five = buffer(&world, &[(3, 0), (7, 1), (8, 2), (15, 1), (20, 4)]);
        let future = future_views(&world.context, &five);
        let frames: Vec<u32> = future.iter().map(|view| view.frame.0).collect();
        assert_eq!(frames, [8, 20], "two of five");
        for (view, x) in future.iter().zip([-0.05, -0.1]) {
            let expected = Se3::exp(&Vector6::new(x, 0.0, 0.0, 0.0, 0.0, 0.0));
            let off = (view.camera_from_world * expected.inverse()).log().norm();
            assert!(off < 1e-3, "frame {:?}: {off}", view.frame);
            assert!(view.pyramid.is_none(), "no patch motion");
        }
        five.frames[2].frame.depth_planes = None;
        let frames = future_views(&world.context, &five);
        let frames: Vec<u32> = frames.iter().map(|view| view.frame.0).collect();
        assert_eq!(frames, [20], "one without depth");
        five.frames.truncate(1);
        assert!(future_views(&world.context, &five).is_empty(), "one alone");
        five.frames.clear();
        assert!(future_views(&world.context, &five).is_empty(), "none");
    }

    /// 24 px to the left at 3 m with fx = 110 px: 0.65 m, found from three matches.
    #[test]
    fn a_motion_far_from_rest_takes_the_first_frame_to_the_last() {
        let world = World::with_camera(uneven_camera(), Config::default());
        let mut rng = Rng::new(9);
        let seen: Vec<_> = places().into_iter().filter(|[x, _]| *x >= 30).collect();
        let descriptors: Vec<_> = (seen.iter())
            .map(|_| garad_features::Descriptor([0; 4].map(|_| rng.next_u64())))
            .collect();
        let [first, last] = [0, 24].map(|left_px| {
            let shifted = seen.iter().map(|[x, y]| [x - left_px, *y]);
            let mut frame = world.frame_of(3, &keypoints(shifted), &wall());
            frame.descriptors.clone_from(&descriptors);
            frame
        });
        let found = register(&world.context, &first, &last).expect("depth");
        let expected = Se3::exp(&Vector6::new(-72.0 / 110.0, 0.0, 0.0, 0.0, 0.0, 0.0));
        let off = (found * expected.inverse()).log().norm();
        assert!(off < 1e-2, "{found:?}");
    }

    #[test]
    fn a_pyramid_is_made_for_patch_motion_alone() {
        let rgb = RgbImage::new(16, 12, [90; 3]);
        for enabled in [true, false] {
            let mut world = World::new(Config::default());
            world.context.config.labels.patch_motion.enabled = enabled;
            let made = patch_motion_pyramid(&world.context, &rgb);
            let expected = enabled.then(|| GrayImage::new(16, 12, 90));
            assert_eq!(made.map(|pyramid| pyramid.image()), expected, "{enabled}");
        }
    }
}
