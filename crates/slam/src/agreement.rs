//! A pose that keypoints and depth agree on (decision 009).
//!
//! Huber's kernel (eq. 11) gives way to whatever most matches like. When people walk beside the
//! camera, one pose can be found that is a little wrong for the room and a little wrong for the
//! people, with nearly every match inside the gate. From there nothing is seen to move. So the pose
//! of eq. 11 is only where this search starts:
//!
//! F(R, t) = ½ Σᵢ ρ₁(‖rᵢ‖²) + ½ Σⱼ ρ₂((dⱼ / σⱼ)²)
//!
//! rᵢ are the links' reprojection errors, dⱼ the offsets of the depth picture from those of the last
//! keyframes ([`crate::surface`]). Both kernels let go of what does not fit (Geman and McClure 1987);
//! they start wide and grow narrow. Links that do not fit the outcome are undone, and eq. 11 is
//! solved for the rest: depth chooses, keypoints measure (decision 004 says why).

use garad_core::chi_square::CHI2_2DOF_95;
use garad_core::{KeyframeId, LandmarkId, Se3};
use garad_optim::dense::{Dense, Problem, Visitor};
use garad_optim::lm::{Model, minimise};
use garad_optim::pose::PoseProblem;
use garad_optim::{LmConfig, PoseObservation, RobustKernel};
use nalgebra::{Matrix1x6, SVector, Vector6};

use crate::frame::Frame;
use crate::surface::Surface;
use crate::system::Slam;

/// Kernels are first so many times as wide as in the end.
const WIDTHS: [f64; 3] = [3.0, 2.0, 1.0];

/// Trials of Levenberg-Marquardt at each width.
const TRIALS: usize = 5;

/// Share of the inliers of eq. 11 that must agree, before it is known what moves: half of them may.
pub(crate) const LEAST_AT_FIRST: f64 = 0.5;
/// The same once that is known.
pub(crate) const LEAST_OF_STATIC: f64 = 0.85;

impl Slam {
    /// The pose that the frame's links and depth agree on, near that of eq. 11. Undoes links that do
    /// not fit and returns the number of inliers; 0 leaves the pose as it was.
    ///
    /// The pose of eq. 11 stays if less than the share `least` of its inliers agrees.
    pub(crate) fn agree(&self, frame: &mut Frame, least: f64) -> usize {
        let links = frame.landmark.clone();
        let inliers = self.optimise(frame);
        if inliers == 0 {
            return 0;
        }
        let Some(pose) = self.pose_with_depth(frame, &links) else {
            return inliers;
        };
        let by_keypoints = (frame.camera_from_world, frame.landmark.clone());
        frame.camera_from_world = pose;
        frame.landmark = links;
        self.unlink_misfits(frame);
        let agreed = self.optimise(frame);
        if agreed as f64 >= least * inliers as f64 {
            return agreed;
        }
        (frame.camera_from_world, frame.landmark) = by_keypoints;
        inliers
    }

    /// The minimum of F next to the frame's pose. `None` without a picture to compare with.
    fn pose_with_depth(&self, frame: &Frame, links: &[Option<LandmarkId>]) -> Option<Se3> {
        let surface = frame.surface.as_ref()?;
        let then: Vec<_> = self.recent_surfaces().collect();
        if then.is_empty() {
            return None;
        }
        let observations = (0..frame.len()).filter_map(|i| {
            let p_world = self.map.static_landmark(links[i]?)?.p_world;
            self.camera.project(&(frame.camera_from_world * p_world))?;
            Some(PoseObservation {
                depth: None,
                ..self.observation(frame, i, p_world)
            })
        });
        let observations: Vec<_> = observations.collect();
        let agreement = Agreement::new(self, surface, &then, observations.clone());
        let before = frame.camera_from_world;
        let (pose, cost) = agreement.minimise(before);
        self.tape.put("agreement", |page| {
            page.agreement(&observations, surface, &then, &before, (&pose, cost));
        });
        pose.is_finite().then_some(pose)
    }

    /// The depth pictures of the last keyframes that still have one, and where they were taken.
    fn recent_surfaces(&self) -> impl Iterator<Item = (&Surface, &Se3)> {
        let youngest = self.map.keyframes().iter().rev();
        youngest
            .take(self.config.surface.keyframes)
            .filter_map(|k| Some((k.surface.as_ref()?, &k.camera_from_world)))
    }

    /// Forgets the depth picture of the keyframe that has just become too old to be asked.
    pub(crate) fn forget_surfaces(&mut self, newest: KeyframeId) {
        let kept = u32::try_from(self.config.surface.keyframes).unwrap_or(u32::MAX);
        if let Some(old) = newest.0.checked_sub(kept) {
            self.map.keyframe_mut(KeyframeId(old)).surface = None;
        }
    }

    /// Unlinks keypoints beyond the gate of the frame's pose.
    fn unlink_misfits(&self, frame: &mut Frame) {
        for i in 0..frame.len() {
            let landmark = frame.landmark[i].and_then(|l| self.map.static_landmark(l));
            let fits = landmark.is_some_and(|landmark| {
                let p_cam = frame.camera_from_world * landmark.p_world;
                let uv_px = self.camera.project(&p_cam);
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
}

/// F.
pub(crate) struct Agreement<'a> {
    slam: &'a Slam,
    surface: &'a Surface,
    then: &'a [(&'a Surface, &'a Se3)],
    links: PoseProblem,
    offset_kernel: RobustKernel,
}

impl<'a> Agreement<'a> {
    /// F at its final width, for a depth picture, those of before and where they were taken, and
    /// observations without their depth.
    pub(crate) fn new(
        slam: &'a Slam,
        surface: &'a Surface,
        then: &'a [(&'a Surface, &'a Se3)],
        observations: Vec<PoseObservation>,
    ) -> Self {
        let bf = slam.config.tracking.bf;
        let mut agreement = Self {
            slam,
            surface,
            then,
            links: PoseProblem::new(&slam.camera, bf, None, observations),
            offset_kernel: RobustKernel::None,
        };
        agreement.set_width(1.0);
        agreement
    }

    /// F of a pose that may be far off: planes that fall beside those of before cost as much as the
    /// farthest outlier. Without that, to look the other way would cost nothing.
    pub(crate) fn price(&self, pose: &Se3) -> f64 {
        let beside = |(then, then_from_world): &(&Surface, &Se3)| {
            let camera = &self.slam.camera;
            let offsets = self.surface.offsets(pose, then, then_from_world, camera);
            self.surface.planes() - offsets.count()
        };
        let beside: usize = self.then.iter().map(beside).sum();
        // sup ρ = c² of Geman and McClure's kernel
        let c = self.share() * self.slam.config.surface.outlier_sigmas;
        Dense(self).cost(pose) + 0.5 * c * c * beside as f64
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
        let config = &self.slam.config.surface;
        let kernel = |c: f64| RobustKernel::GemanMcClure { c: width * c };
        self.links.set_kernels([kernel(config.outlier_px); 2]);
        self.offset_kernel = kernel(self.share() * config.outlier_sigmas);
    }

    /// Pictures share what a block has to say: together they count as one.
    fn share(&self) -> f64 {
        1.0 / (self.then.len() as f64).sqrt()
    }
}

impl Problem<6> for Agreement<'_> {
    type State = Se3;

    fn blocks(&self, camera_from_world: &Se3, visitor: &mut impl Visitor<6>) {
        self.links.blocks(camera_from_world, visitor);
        let (camera, noise) = (&self.slam.camera, &self.slam.config.surface.noise);
        for (then, then_from_world) in self.then {
            let offsets = self
                .surface
                .offsets(camera_from_world, then, then_from_world, camera);
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
    use garad_core::{Camera, DepthImage, FrameId, Par};
    use garad_features::{Descriptor, Keypoint};
    use nalgebra::Vector2;

    use super::*;
    use crate::config::Config;
    use crate::frame::Levels;

    const SIZE: (usize, usize) = (640, 480);
    /// Distances of a wall and of somebody before it, and the camera's step, metres.
    const WALL_M: f32 = 3.0;
    const BODY_M: f32 = 1.5;
    const STEP_M: f64 = 0.025;

    fn slam(config: Config) -> Slam {
        let camera = Camera::pinhole(SIZE, [525.0, 525.0, 319.5, 239.5]).expect("valid");
        Slam::new(camera, config, 0, Par::Seq).expect("valid")
    }

    /// Every 32nd pixel each way: 20 columns of 15 keypoints.
    fn frame(slam: &Slam, id: u32, depth: &DepthImage) -> Frame {
        let places = (0..300u16).map(|i| (32 * (i % 20) + 16, 32 * (i / 20) + 16));
        let keypoints: Vec<Keypoint> = places
            .map(|(x, y)| Keypoint {
                x: f32::from(x),
                y: f32::from(y),
                level: 0,
                angle_deg: 0.0,
                response: 1.0,
            })
            .collect();
        let descriptors = vec![Descriptor::default(); keypoints.len()];
        let levels = Levels::new(SIZE, 1.2, 8, true);
        let (camera, config) = (&slam.camera, &slam.config);
        let t_s = f64::from(id) / 30.0;
        let id = FrameId(id);
        Frame::new(
            id,
            t_s,
            keypoints,
            descriptors,
            depth,
            None,
            camera,
            &levels,
            config,
        )
    }

    fn is_body(x_px: f64) -> bool {
        (256.0..416.0).contains(&x_px)
    }

    /// A room as a keyframe saw it, and a frame whose camera has gone to the right. Somebody before
    /// the wall has gone with it and fills the same pixels as before: a quarter of the picture.
    fn in_step(config: Config) -> (Slam, Frame, Se3) {
        let mut slam = slam(config);
        let depth = DepthImage::from_fn(SIZE.0, SIZE.1, |x, _| match is_body(x as f64) {
            true => BODY_M,
            false => WALL_M,
        });
        let keyframe = frame(&slam, 0, &depth);
        let id = slam.map.add_keyframe(keyframe.clone());
        let mut now = frame(&slam, 1, &depth);
        for i in 0..now.len() {
            let Some(p_world) = keyframe.world_point(i, &slam.camera) else {
                continue;
            };
            let landmark = slam.map.add_landmark(p_world, id, i, &slam.scales);
            now.landmark[i] = Some(landmark);
            if !is_body(now.px[i].x) {
                let shift_px = slam.camera.fx * STEP_M / f64::from(WALL_M);
                now.uv_px[i] -= Vector2::new(shift_px, 0.0);
            }
        }
        let truth = Se3::exp(&[-STEP_M, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        (slam, now, truth)
    }

    fn error_m(pose: &Se3, truth: &Se3) -> f64 {
        (pose.inverse().translation - truth.inverse().translation).norm()
    }

    #[test]
    fn depth_tells_a_step_to_the_side_from_a_turn() {
        let (slam, start, truth) = in_step(Config::default());
        let mut by_keypoints = start.clone();
        slam.optimise(&mut by_keypoints);
        let misled = error_m(&by_keypoints.camera_from_world, &truth);
        let mut agreed = start.clone();
        let inliers = slam.agree(&mut agreed, LEAST_AT_FIRST);
        let right = error_m(&agreed.camera_from_world, &truth);
        assert!(misled > 0.02, "keypoints alone follow the body: {misled} m");
        assert!(right < 0.001, "with depth: {right} m, {inliers} inliers");
        let on_body = (0..agreed.len()).filter(|&i| is_body(agreed.px[i].x));
        let linked = on_body.filter(|&i| agreed.landmark[i].is_some()).count();
        assert_eq!(linked, 0, "links on the body");
    }

    /// Of 300 links 225 fit the right pose: three quarters.
    #[test]
    fn the_pose_of_keypoints_stays_if_too_few_agree() {
        let (slam, start, _) = in_step(Config::default());
        let (mut plain, mut asked) = (start.clone(), start);
        assert_eq!(slam.optimise(&mut plain), 300, "all fit, more or less");
        assert_eq!(slam.agree(&mut asked, 0.76), 300, "225 are too few");
        assert_eq!(plain.camera_from_world, asked.camera_from_world, "pose");
        assert_eq!(slam.agree(&mut asked, 0.75), 225, "225 are enough");
    }

    #[test]
    fn without_depth_it_is_the_pose_of_keypoints() {
        let mut config = Config::default();
        config.surface.enabled = false;
        let (slam, start, _) = in_step(config);
        let (mut plain, mut asked) = (start.clone(), start);
        let inliers = slam.optimise(&mut plain);
        assert_eq!(slam.agree(&mut asked, LEAST_AT_FIRST), inliers, "inliers");
        assert_eq!(plain.camera_from_world, asked.camera_from_world, "pose");
        assert_eq!(plain.landmark, asked.landmark, "links");
    }

    #[test]
    fn only_the_youngest_keyframes_keep_their_depth() {
        let mut slam = slam(Config::default());
        let wall = DepthImage::new(SIZE.0, SIZE.1, WALL_M);
        for id in 0..5 {
            let seen = frame(&slam, id, &wall);
            let id = slam.map.add_keyframe(seen);
            slam.forget_surfaces(id);
        }
        let kept: Vec<bool> = (slam.map.keyframes().iter())
            .map(|k| k.surface.is_some())
            .collect();
        assert_eq!(kept, [false, false, true, true, true], "three are asked");
        assert_eq!(slam.recent_surfaces().count(), 3, "of five");
    }
}
