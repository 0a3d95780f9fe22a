//! The pose refined with depth: one that keypoints and depth planes agree on (decision 009).
//!
//! Huber's kernel (eq. 11) yields to the majority of matches. When people walk beside the
//! camera, there can be a pose that is slightly wrong for the room and slightly wrong for the
//! people, with nearly every match inside the gate. From that pose nothing is seen to move. So the
//! pose of eq. 11 is only the start of this search:
//!
//! F(R, t) = ½ Σᵢ ρ₁(‖rᵢ‖²) + ½ Σⱼ ρ₂((dⱼ / σⱼ)²)
//!
//! rᵢ are the links' reprojection errors, dⱼ the offsets of the depth image's planes from those of the
//! last keyframes ([`crate::frame::depth_planes`]). Both kernels are redescending (Geman and McClure
//! 1987); they start wide and become narrow. Links that do not fit the result are removed, and eq. 11
//! is solved for the rest: depth chooses the minimum, keypoints give the accuracy (decision 004 says
//! why).

use garad_core::chi_square::CHI2_2DOF_95;
use garad_core::{KeyframeId, LandmarkId, Se3};
use garad_optim::dense::{Dense, Problem, Visitor};
use garad_optim::lm::{Model, minimise};
use garad_optim::pose::PoseProblem;
use garad_optim::{LmConfig, PoseObservation, RobustKernel};
use nalgebra::{Matrix1x6, SVector, Vector6};

use super::observation::link_observation;
use super::pose::{centre_prior, pose_from_links};
use super::shutter::{ShutterModel, estimate_shutter};
use crate::context::Context;
use crate::frame::Frame;
use crate::frame::depth_planes::DepthPlanes;
use crate::map::Map;
use crate::trace::Recorder;

/// Widths of the kernels, as multiples of the final one.
const WIDTHS: [f64; 3] = [3.0, 2.0, 1.0];

/// Trials of Levenberg-Marquardt at each width.
const TRIALS: usize = 5;

/// Share of the inliers of eq. 11 that must be left, before labels are known: half of them may move.
pub(crate) const MIN_SHARE_UNLABELLED: f64 = 0.5;
/// The same once labels are known.
pub(crate) const MIN_SHARE_LABELLED: f64 = 0.85;

/// The pose that the frame's links and depth agree on, near that of eq. 11. Removes links that do
/// not fit and returns the number of inliers; 0 leaves the pose as it was.
///
/// The pose of eq. 11 stays if less than the share `min_share` of its inliers is left.
pub(crate) fn refine_pose_with_depth(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    min_share: f64,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> usize {
    estimate_shutter(context, map, frame, shutter);
    let links = frame.landmark.clone();
    let inliers = pose_from_links(context, map, frame, recorder);
    if inliers == 0 {
        return 0;
    }
    let Some(pose) = pose_with_depth(context, map, frame, &links, recorder) else {
        return inliers;
    };
    let by_keypoints = (frame.camera_from_world, frame.landmark.clone());
    frame.camera_from_world = pose;
    frame.landmark = links;
    unlink_misfits(context, map, frame);
    let refined = pose_from_links(context, map, frame, recorder);
    if refined as f64 >= min_share * inliers as f64 {
        return refined;
    }
    (frame.camera_from_world, frame.landmark) = by_keypoints;
    inliers
}

/// The minimum of F next to the frame's pose. `None` without a depth image to compare with.
fn pose_with_depth(
    context: &Context,
    map: &Map,
    frame: &Frame,
    links: &[Option<LandmarkId>],
    recorder: &mut Recorder,
) -> Option<Se3> {
    let planes = frame.depth_planes.as_ref()?;
    let references = recent_depth_planes(map, context.config.depth_planes.keyframes);
    if references.is_empty() {
        return None;
    }
    let observations = (0..frame.len()).filter_map(|i| {
        let landmark = map.static_landmark(links[i]?)?;
        context
            .camera
            .project(&(frame.camera_from_world * landmark.p_world))?;
        Some(PoseObservation {
            depth: None,
            ..link_observation(context, frame, i, landmark)
        })
    });
    let observations: Vec<_> = observations.collect();
    let mut problem = DepthPoseProblem::new(context, planes, &references, observations.clone());
    let prior = centre_prior(frame);
    problem.links.set_prior(prior);
    let before = frame.camera_from_world;
    let (pose, cost) = problem.minimise(before);
    recorder.record("depth_pose", |record| {
        let before = (prior.as_ref(), &before);
        record.depth_pose(&observations, planes, &references, before, (&pose, cost));
    });
    pose.is_finite().then_some(pose)
}

/// The depth planes of the last `keyframes` keyframes that still have them, and their poses.
fn recent_depth_planes(map: &Map, keyframes: usize) -> Vec<(&DepthPlanes, &Se3)> {
    let youngest = map.keyframes().iter().rev().take(keyframes);
    youngest
        .filter_map(|k| Some((k.depth_planes.as_ref()?, &k.camera_from_world)))
        .collect()
}

/// Frees the depth planes of the keyframe that has just become too old to be compared with.
pub(crate) fn drop_old_depth_planes(map: &mut Map, newest: KeyframeId, keyframes: usize) {
    let kept = u32::try_from(keyframes).unwrap_or(u32::MAX);
    if let Some(old) = newest.0.checked_sub(kept) {
        map.keyframe_mut(KeyframeId(old)).depth_planes = None;
    }
}

/// Unlinks keypoints beyond the gate of the frame's pose.
fn unlink_misfits(context: &Context, map: &Map, frame: &mut Frame) {
    for i in 0..frame.len() {
        let landmark = frame.landmark[i].and_then(|l| map.static_landmark(l));
        let fits = landmark.is_some_and(|landmark| {
            let p_cam = frame.camera_from_world * landmark.p_world;
            let uv_px = context.camera.project(&p_cam);
            uv_px.is_some_and(|uv_px| {
                let error = (uv_px - frame.uv_px[i]) / frame.sigma_px[i];
                error.norm_squared() <= CHI2_2DOF_95
            })
        });
        if !fits {
            frame.landmark[i] = None;
        }
    }
}

/// F.
pub(crate) struct DepthPoseProblem<'a> {
    context: &'a Context,
    planes: &'a DepthPlanes,
    references: &'a [(&'a DepthPlanes, &'a Se3)],
    links: PoseProblem,
    offset_kernel: RobustKernel,
}

impl<'a> DepthPoseProblem<'a> {
    /// F at its final width, for the depth planes of a frame, those of earlier ones with their
    /// poses, and observations without their depth.
    pub(crate) fn new(
        context: &'a Context,
        planes: &'a DepthPlanes,
        references: &'a [(&'a DepthPlanes, &'a Se3)],
        observations: Vec<PoseObservation>,
    ) -> Self {
        let bf = context.config.tracking.bf;
        let mut problem = Self {
            context,
            planes,
            references,
            links: PoseProblem::new(&context.camera, bf, None, observations),
            offset_kernel: RobustKernel::None,
        };
        problem.set_width(1.0);
        problem
    }

    /// F at a pose.
    pub(crate) fn cost(&self, pose: &Se3) -> f64 {
        Dense(self).cost(pose)
    }

    /// What to add to F where poses far from each other are compared: planes that project beside
    /// those of the references cost as much as the farthest outlier. Without it, a camera that
    /// looks away would cost nothing.
    pub(crate) fn overlap_penalty(&self, pose: &Se3) -> f64 {
        let beside = |(planes, reference_from_world): &(&DepthPlanes, &Se3)| {
            let camera = &self.context.camera;
            let offsets = (self.planes).offsets(pose, planes, reference_from_world, camera);
            self.planes.count() - offsets.count()
        };
        let beside: usize = self.references.iter().map(beside).sum();
        // sup ρ = c² of Geman and McClure's kernel
        let c = self.share() * self.context.config.depth_planes.outlier_sigmas;
        0.5 * c * c * beside as f64
    }

    /// The minimum next to a pose, and F there.
    pub(crate) fn minimise(mut self, start: Se3) -> (Se3, f64) {
        let lm = LmConfig {
            iterations: TRIALS,
            ..LmConfig::default()
        };
        let (mut pose, mut cost) = (start, f64::INFINITY);
        for width in WIDTHS {
            self.set_width(width);
            let report;
            (pose, report) = minimise(&Dense(&self), pose, &lm);
            cost = report.cost;
        }
        (pose, cost)
    }

    fn set_width(&mut self, width: f64) {
        let config = &self.context.config.depth_planes;
        let kernel = |c: f64| RobustKernel::GemanMcClure { c: width * c };
        self.links.set_kernels([kernel(config.outlier_px); 2]);
        self.offset_kernel = kernel(self.share() * config.outlier_sigmas);
    }

    /// References measure the same planes: together they count as one.
    fn share(&self) -> f64 {
        1.0 / (self.references.len() as f64).sqrt()
    }
}

impl Problem<6> for DepthPoseProblem<'_> {
    type State = Se3;

    fn blocks(&self, camera_from_world: &Se3, visitor: &mut impl Visitor<6>) {
        self.links.blocks(camera_from_world, visitor);
        let (camera, noise) = (
            &self.context.camera,
            &self.context.config.depth_planes.noise,
        );
        for (planes, reference_from_world) in self.references {
            let offsets =
                (self.planes).offsets(camera_from_world, planes, reference_from_world, camera);
            for offset in offsets {
                let scale = self.share() / noise.sigma_m(offset.depth_m);
                let residual = SVector::<f64, 1>::new(scale * offset.residual_m);
                visitor.block(self.offset_kernel, &residual, || {
                    scale * Matrix1x6::from(offset.jacobian)
                });
            }
        }
    }

    fn step(&self, camera_from_world: &Se3, xi: &Vector6<f64>) -> Se3 {
        Se3::exp(xi) * *camera_from_world
    }
}

#[cfg(test)]
mod tests {
    use garad_core::{Camera, DepthImage};
    use nalgebra::Vector2;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, keypoints};

    const SIZE: (usize, usize) = (640, 480);
    /// Distances of a wall and of a body in front of it, and the camera's step, metres.
    const WALL_M: f32 = 3.0;
    const BODY_M: f32 = 1.5;
    const STEP_M: f64 = 0.025;

    fn world(config: Config) -> World {
        let camera = Camera::pinhole(SIZE, [525.0, 525.0, 319.5, 239.5]).expect("valid");
        World::with_camera(camera, config)
    }

    /// Every 32nd pixel each way: 20 columns of 15 keypoints.
    fn frame(world: &World, id: u32, depth: &DepthImage) -> Frame {
        let places = (0..300).map(|i| [32 * (i % 20) + 16, 32 * (i / 20) + 16]);
        world.frame_of(id, &keypoints(places), depth)
    }

    fn is_body(x_px: f64) -> bool {
        (256.0..416.0).contains(&x_px)
    }

    /// A room as a keyframe saw it, and a frame whose camera has moved to the right. A body in front of
    /// the wall has moved with it and fills the same pixels as before: a quarter of the image.
    fn in_step(config: Config) -> (World, Frame, Se3) {
        let mut world = world(config);
        let depth = DepthImage::from_fn(SIZE.0, SIZE.1, |x, _| match is_body(x as f64) {
            true => BODY_M,
            false => WALL_M,
        });
        let keyframe = frame(&world, 0, &depth);
        let id = world.map.add_keyframe(keyframe.clone());
        let mut now = frame(&world, 1, &depth);
        for i in 0..now.len() {
            let Some(p_world) = keyframe.world_point(i, &world.context.camera) else {
                continue;
            };
            let landmark = world
                .map
                .add_landmark(p_world, id, i, &world.context.scales);
            now.landmark[i] = Some(landmark);
            if !is_body(now.px[i].x) {
                let shift_px = world.context.camera.fx * STEP_M / f64::from(WALL_M);
                now.uv_px[i] -= Vector2::new(shift_px, 0.0);
            }
        }
        let truth = Se3::exp(&[-STEP_M, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        (world, now, truth)
    }

    fn by_links(world: &World, frame: &mut Frame) -> usize {
        pose_from_links(&world.context, &world.map, frame, &mut Recorder::default())
    }

    fn refined(world: &World, frame: &mut Frame, min_share: f64) -> usize {
        let recorder = &mut Recorder::default();
        refine_pose_with_depth(
            &world.context,
            &world.map,
            frame,
            min_share,
            &ShutterModel::new(),
            recorder,
        )
    }

    fn error_m(pose: &Se3, truth: &Se3) -> f64 {
        (pose.inverse().translation - truth.inverse().translation).norm()
    }

    #[test]
    fn depth_separates_a_step_to_the_side_from_a_rotation() {
        let (world, start, truth) = in_step(Config::default());
        let mut by_keypoints = start.clone();
        by_links(&world, &mut by_keypoints);
        let misled = error_m(&by_keypoints.camera_from_world, &truth);
        let mut agreed = start.clone();
        let inliers = refined(&world, &mut agreed, MIN_SHARE_UNLABELLED);
        let right = error_m(&agreed.camera_from_world, &truth);
        assert!(misled > 0.02, "keypoints alone follow the body: {misled} m");
        assert!(right < 0.001, "with depth: {right} m, {inliers} inliers");
        let on_body = (0..agreed.len()).filter(|&i| is_body(agreed.px[i].x));
        let linked = on_body.filter(|&i| agreed.landmark[i].is_some()).count();
        assert_eq!(linked, 0, "links on the body");
    }

    /// Of 300 links 225 fit the right pose: three quarters.
    #[test]
    fn the_pose_of_keypoints_stays_if_too_few_links_are_left() {
        let (world, start, _) = in_step(Config::default());
        let (mut plain, mut refined_frame) = (start.clone(), start);
        assert_eq!(by_links(&world, &mut plain), 300, "all fit, more or less");
        assert_eq!(
            refined(&world, &mut refined_frame, 0.76),
            300,
            "225 are too few"
        );
        assert_eq!(
            plain.camera_from_world, refined_frame.camera_from_world,
            "pose"
        );
        assert_eq!(
            refined(&world, &mut refined_frame, 0.75),
            225,
            "225 are enough"
        );
    }

    #[test]
    fn without_depth_it_is_the_pose_of_keypoints() {
        let mut config = Config::default();
        config.depth_planes.enabled = false;
        let (world, start, _) = in_step(config);
        let (mut plain, mut refined_frame) = (start.clone(), start);
        let inliers = by_links(&world, &mut plain);
        assert_eq!(
            refined(&world, &mut refined_frame, MIN_SHARE_UNLABELLED),
            inliers,
            "inliers"
        );
        assert_eq!(
            plain.camera_from_world, refined_frame.camera_from_world,
            "pose"
        );
        assert_eq!(plain.landmark, refined_frame.landmark, "links");
    }

    #[test]
    fn only_the_youngest_keyframes_keep_their_depth() {
        let mut world = world(Config::default());
        let wall = DepthImage::new(SIZE.0, SIZE.1, WALL_M);
        for id in 0..5 {
            let seen = frame(&world, id, &wall);
            let id = world.map.add_keyframe(seen);
            drop_old_depth_planes(&mut world.map, id, 3);
        }
        let kept: Vec<bool> = (world.map.keyframes().iter())
            .map(|k| k.depth_planes.is_some())
            .collect();
        assert_eq!(
            kept,
            [false, false, true, true, true],
            "three are compared with"
        );
        assert_eq!(recent_depth_planes(&world.map, 3).len(), 3, "of five");
    }

    /// σ = 1.5 px: the gate is √5.991 · 1.5 = 3.67 px. A link to what moves does not fit.
    #[test]
    fn links_beyond_the_gate_are_misfits() {
        let (mut world, mut now, _) = in_step(Config::default());
        let made: Vec<_> = now.landmark.iter().flatten().copied().collect();
        now.landmark.fill(None);
        world.set_moving(&made[5..6]);
        now.sigma_px[..6].fill(1.5);
        for (i, off) in [
            [3.66, 0.0],
            [3.68, 0.0],
            [0.0, -3.66],
            [0.0, -3.68],
            [2.6, 2.6],
            [0.0, 0.0],
        ]
        .into_iter()
        .enumerate()
        {
            let landmark = world.map.landmark(made[i]).expect("made");
            let uv_px = world.context.camera.project(&landmark.p_world);
            now.uv_px[i] = uv_px.expect("in front") + Vector2::from(off);
            now.landmark[i] = Some(made[i]);
        }
        unlink_misfits(&world.context, &world.map, &mut now);
        let fit: Vec<_> = now.landmark[..6].iter().map(Option::is_some).collect();
        assert_eq!(fit, [true, false, true, false, false, false], "links");
    }

    #[test]
    fn the_youngest_depth_is_compared_with() {
        let mut world = world(Config::default());
        let wall = DepthImage::new(SIZE.0, SIZE.1, WALL_M);
        for id in 0..4u32 {
            let mut seen = frame(&world, id, &wall);
            seen.camera_from_world.translation.x = f64::from(id);
            world.map.add_keyframe(seen);
        }
        world.map.keyframe_mut(KeyframeId(2)).depth_planes = None;
        let of = |n| -> Vec<Option<f64>> {
            let found = recent_depth_planes(&world.map, n);
            found
                .iter()
                .map(|(_, pose)| Some(pose.translation.x))
                .collect()
        };
        assert_eq!(of(1), [Some(3.0)], "the last");
        assert_eq!(of(2), [Some(3.0)], "the one before has none");
        assert_eq!(of(3), [Some(3.0), Some(1.0)], "youngest first");
    }
}
