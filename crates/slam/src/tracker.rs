//! Tracking: from a predicted pose to an optimised one (paper eq. 11; decision 009).
//!
//! | step | input | output |
//! |---|---|---|
//! | `track_motion` | constant velocity, the last frame's landmarks | first pose |
//! | `track_reference` | the reference keyframe's descriptors, if that failed | first pose |
//! | `track_local_map` | everything the neighbourhood's keyframes see | final pose |

use garad_core::{DepthImage, LandmarkId, MaskImage, Se3};
use garad_features::LkPyramid;
use garad_optim::{DepthObservation, PoseConfig, PoseObservation, optimise_pose};
use serde::{Deserialize, Serialize};

use crate::agreement::{LEAST_AT_FIRST, LEAST_OF_STATIC};
use crate::config::DepthResidual;
use crate::frame::Frame;
use crate::map::by_count;
use crate::matching::Matcher;
use crate::observer::{Observer, Stage};
use crate::system::{FrameInput, Slam};

/// What the tracker knows about where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum TrackingState {
    /// No frame with enough depth yet.
    NotInitialised,
    /// The pose is good.
    Tracking,
    /// No pose: the camera is looked for among the keyframes.
    Lost,
}

impl TrackingState {
    /// The word in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NotInitialised => "not initialised",
            Self::Tracking => "tracking",
            Self::Lost => "lost",
        }
    }
}

/// Frames after a recovery that need more inliers: about a second.
const CAREFUL_FRAMES: u32 = 30;

impl Slam {
    /// The first frame with enough depth is the world.
    pub(crate) fn initialise(&mut self, frame: &mut Frame) -> usize {
        let usable = (0..frame.len())
            .filter(|&i| frame.depth_m[i].is_some() && frame.in_use[i])
            .count();
        if usable < self.config.keyframes.first_min_keypoints {
            return 0;
        }
        frame.camera_from_world = Se3::identity();
        self.state = TrackingState::Tracking;
        usable
    }

    /// Motion model, then reference keyframe (or, when lost, all keyframes), then local map.
    pub(crate) fn track(
        &mut self,
        frame: &mut Frame,
        pyramid: Option<&LkPyramid>,
        input: &FrameInput<'_>,
        cells: &mut Option<MaskImage>,
        observer: &mut dyn Observer,
    ) -> usize {
        let was_lost = self.state == TrackingState::Lost;
        let first_pose = if was_lost {
            observer.begin(Stage::Recover);
            let found = self.recover(frame);
            observer.end(Stage::Recover);
            found
        } else {
            observer.begin(Stage::TrackMotion);
            let found = self.track_motion(frame) || self.track_reference(frame);
            observer.end(Stage::TrackMotion);
            found
        };
        let config = &self.config.tracking;
        let careful = was_lost
            || self
                .recovered_at
                .is_some_and(|at| frame.id.0 - at.0 < CAREFUL_FRAMES);
        let needed = if careful {
            config.min_inliers_after_recovery
        } else {
            config.min_inliers
        };
        let mut inliers = 0;
        if first_pose {
            if self.config.labels.enabled && input.mask.is_none() {
                observer.begin(Stage::Label);
                *cells = self.label_frame(frame, input.depth, pyramid);
                if let Some(pyramid) = pyramid {
                    self.recover_by_flow(frame, pyramid);
                }
                observer.end(Stage::Label);
            }
            observer.begin(Stage::TrackLocalMap);
            // The flow check has use for the pyramid, too.
            let to_refine = pyramid.filter(|_| self.config.refine.enabled);
            inliers = self.track_local_map(frame, to_refine, input.depth);
            observer.end(Stage::TrackLocalMap);
        }
        if inliers >= needed {
            if was_lost {
                self.recovered_at = Some(frame.id);
                tracing::info!(frame = frame.id.0, inliers, "recovered");
            }
            self.state = TrackingState::Tracking;
        } else {
            if !was_lost {
                tracing::info!(frame = frame.id.0, inliers, "lost");
            }
            self.state = TrackingState::Lost;
            self.velocity = None;
        }
        inliers
    }

    pub(crate) fn matcher(&self) -> Matcher<'_> {
        Matcher {
            camera: &self.camera,
            config: &self.config.tracking,
            scales: &self.scales,
            par: self.par,
        }
    }

    /// First pose from the last frame's landmarks, searched where constant velocity puts them.
    pub(crate) fn track_motion(&self, frame: &mut Frame) -> bool {
        let (Some(last), Some(velocity)) = (&self.last, self.velocity) else {
            return false;
        };
        let config = &self.config.tracking;
        let predicted = velocity * last.camera_from_world;
        self.tape.put("predict", |page| {
            page.predict(&last.camera_from_world, &velocity, &predicted);
        });
        for factor in [1.0, 2.0] {
            frame.camera_from_world = predicted;
            frame.landmark.fill(None);
            let radius = factor * config.motion_radius_px;
            let matches = self
                .matcher()
                .from_last_frame(&self.map, last, frame, radius);
            self.tape.put("match_motion", |page| page.links(frame));
            if matches >= config.motion_min_matches {
                return self.agree(frame, LEAST_AT_FIRST) >= config.motion_min_inliers;
            }
        }
        false
    }

    /// First pose from the reference keyframe's landmarks, found by descriptor, starting at the
    /// last pose.
    pub(crate) fn track_reference(&self, frame: &mut Frame) -> bool {
        let Some(last) = &self.last else { return false };
        let config = &self.config.tracking;
        frame.camera_from_world = last.camera_from_world;
        frame.landmark.fill(None);
        let reference = self.map.keyframe(self.reference);
        let matches = self.matcher().from_keyframe(&self.map, reference, frame);
        self.tape.put("match_reference", |page| page.links(frame));
        matches >= config.reference_min_matches
            && self.agree(frame, LEAST_AT_FIRST) >= config.motion_min_inliers
    }

    /// Final pose: links every landmark of the local map that can be found in the frame, optimises
    /// over all of them, sharpens the links ([`Slam::refine`], given the frame's pyramid) and
    /// optimises again. Returns the number of inliers.
    ///
    /// The local map is what these keyframes see: those that observe the frame's landmarks, and for
    /// each of them its most covisible neighbour not yet among them (of ten), up to
    /// `max_local_keyframes`.
    pub(crate) fn track_local_map(
        &mut self,
        frame: &mut Frame,
        pyramid: Option<&LkPyramid>,
        depth: &DepthImage,
    ) -> usize {
        let mut linked: Vec<_> = frame.landmark.iter().flatten().copied().collect();
        linked.sort_unstable();
        let votes = self.map.observers(linked.iter().copied());
        let mut local = by_count(&votes);
        if let Some(most) = local.first() {
            self.reference = *most;
        }
        local.truncate(self.config.tracking.max_local_keyframes);
        for keyframe in local.clone() {
            if local.len() >= self.config.tracking.max_local_keyframes {
                break;
            }
            let neighbours = by_count(&self.map.covisible(keyframe));
            if let Some(next) = neighbours.iter().take(10).find(|k| !local.contains(k)) {
                local.push(*next);
            }
        }
        let mut ids: Vec<LandmarkId> = local
            .iter()
            .flat_map(|k| self.map.keyframe(*k).landmark.iter().flatten().copied())
            .collect();
        ids.sort_unstable();
        ids.dedup();

        let mut visible = Vec::new();
        for id in ids {
            let already_linked = linked.binary_search(&id).is_ok();
            let Some(landmark) = self.map.landmark(id) else {
                continue;
            };
            let seen = self
                .map
                .appearance(landmark, frame, &self.camera, &self.scales);
            if !self.localising
                && (already_linked || seen.is_some())
                && let Some(landmark) = self.map.landmark_mut(id)
            {
                landmark.visible += 1;
            }
            if let Some(seen) = seen.filter(|_| !already_linked) {
                visible.push((id, seen));
            }
        }
        self.matcher().from_local_map(&self.map, &visible, frame);
        self.tape.put("match_local_map", |page| {
            page.local_map(&visible);
            page.links(frame);
        });
        let mut inliers = self.agree(frame, LEAST_OF_STATIC);
        if let Some(pyramid) = pyramid
            && inliers > 0
        {
            self.refine(frame, pyramid, depth);
            inliers = self.optimise(frame);
        }
        for id in frame.landmark.iter().flatten() {
            if !self.localising
                && let Some(landmark) = self.map.landmark_mut(*id)
            {
                landmark.found += 1;
            }
        }
        inliers
    }

    /// Optimises the frame's pose over its links (eq. 11) and unlinks the outliers. Returns the
    /// number of inliers; 0 leaves the pose as it was.
    pub(crate) fn optimise(&self, frame: &mut Frame) -> usize {
        let mut keypoints = Vec::new();
        let mut observations = Vec::new();
        for i in 0..frame.len() {
            let Some(landmark) = frame.landmark[i].and_then(|l| self.map.static_landmark(l)) else {
                frame.landmark[i] = None;
                continue;
            };
            debug_assert!(frame.in_use[i], "only keypoints in use are linked");
            keypoints.push(i);
            observations.push(self.observation(frame, i, landmark.p_world));
        }
        let config = PoseConfig {
            bf: self.config.tracking.bf,
            ..PoseConfig::default()
        };
        let solution = optimise_pose(
            &self.camera,
            &observations,
            &frame.camera_from_world,
            &config,
        );
        match solution {
            Ok(solution) if solution.camera_from_world.is_finite() => {
                self.tape.put("pose", |page| {
                    let before = &frame.camera_from_world;
                    page.pose_lm(&keypoints, &observations, before, &solution);
                });
                frame.camera_from_world = solution.camera_from_world;
                for (&i, inlier) in keypoints.iter().zip(&solution.inlier) {
                    if !inlier {
                        frame.landmark[i] = None;
                    }
                }
                solution.n_inliers
            }
            _ => 0,
        }
    }

    /// Keypoint i of a frame as an observation of a point: its place with its σ, and the depth reading
    /// as a disparity of its own σ (decision 004).
    pub(crate) fn observation(
        &self,
        frame: &Frame,
        i: usize,
        p_world: nalgebra::Vector3<f64>,
    ) -> PoseObservation {
        let sigma_px = frame.sigma_px[i];
        let config = &self.config.tracking;
        let depth = frame.depth_m[i].map(|depth_m| {
            let disparity_px = config.bf / depth_m;
            match config.depth_residual {
                DepthResidual::Disparity => DepthObservation::Disparity {
                    disparity_px,
                    sigma_px: config.disparity_sigma_px,
                },
                DepthResidual::Right => DepthObservation::Right {
                    u_px: frame.uv_px[i].x - disparity_px,
                    sigma_px,
                },
            }
        });
        PoseObservation {
            p_world,
            uv_px: frame.uv_px[i],
            sigma_px,
            depth,
        }
    }

    /// The motion from the last frame to this one, which the next is expected to repeat. `None`
    /// across a gap.
    pub(crate) fn velocity_to(&self, frame: &Frame) -> Option<Se3> {
        let last = self.last.as_ref().filter(|l| l.id.0 + 1 == frame.id.0)?;
        Some(frame.camera_from_world * last.camera_from_world.inverse())
    }
}
