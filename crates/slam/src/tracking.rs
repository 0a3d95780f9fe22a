//! Tracking: from a predicted pose to the final pose of a frame (paper eq. 11; decision 009).
//!
//! | step | from | result |
//! |---|---|---|
//! | `motion` | constant velocity and the last frame's landmarks, or the reference keyframe's descriptors | first pose |
//! | `by_rendering` | colour and depth of the rendered map, instead of all other steps | final pose |
//! | `relocalise` | the keyframes that look most like the frame, if the camera is lost | first pose |
//! | `local_map` | everything the neighbourhood's keyframes observe | links |
//! | `shutter` | links, by the rows they lie in | turn during read-out, keypoints at the middle row |
//! | `pose`, `depth_pose`, `subpixel` | links, depth planes, image patches | final pose |

pub(crate) mod by_rendering;
pub(crate) mod depth_pose;
pub(crate) mod local_map;
pub(crate) mod matching;
pub(crate) mod motion;
pub(crate) mod observation;
pub(crate) mod pose;
pub(crate) mod relocalise;
pub(crate) mod rigid;
pub(crate) mod shutter;
pub(crate) mod subpixel;

use std::io::{Read, Write};
use std::sync::Arc;

use garad_core::{DepthImage, FrameId, GaussianMap, KeyframeId, Se3};
use garad_features::{LkPyramid, PlaceIndex};

use self::by_rendering::{pixels_with_depth, pose_by_rendering};
use self::depth_pose::{MIN_SHARE_LABELLED, refine_pose_with_depth};
use self::local_map::local_map;
use self::motion::{track_motion, track_reference};
use self::pose::pose_from_links;
use self::relocalise::relocalise;
use self::shutter::{ShutterModel, estimate_shutter};
use self::subpixel::refine_matches;
use crate::config::TrackingMethod;
use crate::context::Context;
use crate::frame::Frame;
use crate::images::ImageStore;
use crate::io::TrackingState;
use crate::map::Map;
use crate::mapping::view::Target;
use crate::observer::{Observer, Stage};
use crate::session::sections::{SectionReader, SectionWriter, SessionError};
use crate::trace::Recorder;

/// Frames after a relocalisation that need more inliers: about a second.
const CAREFUL_FRAMES: u32 = 30;

/// A frame with fewer inliers than this share of the usual number is weak.
const WEAK_SHARE: f64 = 0.5;
/// The usual number of inliers is a running mean over so many frames: what was sudden is usual after a
/// third of a second.
const USUAL_FRAMES: f64 = 10.0;

/// The state of tracking.
#[derive(Debug)]
pub struct Tracker {
    state: TrackingState,
    /// The last tracked frame.
    last: Option<Frame>,
    /// Motion from the frame before the last one to the last.
    velocity: Option<Se3>,
    /// The keyframe that shares most landmarks with the last frame.
    reference: KeyframeId,
    relocalised_at: Option<FrameId>,
    /// Inliers of a usual frame; none before the first one and after a loss.
    usual_inliers: Option<f64>,
    /// The last frame has far fewer.
    weak: bool,
    /// Global or rolling.
    shutter: ShutterModel,
    /// The map at the last hand-over, if frames are tracked by rendering.
    gaussians: Option<Arc<GaussianMap>>,
}

impl Default for Tracker {
    /// Before the first frame.
    fn default() -> Self {
        Self {
            state: TrackingState::NotInitialised,
            last: None,
            velocity: None,
            reference: KeyframeId(0),
            relocalised_at: None,
            usual_inliers: None,
            weak: false,
            shutter: ShutterModel::new(),
            gaussians: None,
        }
    }
}

impl Tracker {
    /// The state after the last frame.
    #[must_use]
    pub fn state(&self) -> TrackingState {
        self.state
    }

    /// Whether the last frame was tracked by far fewer landmarks than is usual.
    #[must_use]
    pub fn is_weak(&self) -> bool {
        self.weak
    }

    /// The last tracked frame, with the landmarks its keypoints were linked to.
    #[must_use]
    pub fn last(&self) -> Option<&Frame> {
        self.last.as_ref()
    }

    /// The keyframe that shares most landmarks with the last frame.
    #[must_use]
    pub fn reference(&self) -> KeyframeId {
        self.reference
    }

    /// The camera's motion in the time `offset_s` after a frame at `t_s`, if it goes on as before: a part of that
    /// from the frame before the last to the last. None if that is not known, or nothing is to be moved.
    pub(crate) fn expected_motion(&self, t_s: f64, offset_s: f64) -> Option<Se3> {
        let interval_s = t_s - self.last.as_ref()?.t_s;
        let share = offset_s / interval_s;
        let moves = share.is_finite() && share != 0.0 && share.abs() <= 1.0;
        moves.then_some(Se3::exp(&(self.velocity?.log() * share)))
    }

    /// A new keyframe is the reference of the next frames.
    pub(crate) fn set_reference(&mut self, keyframe: KeyframeId) {
        self.reference = keyframe;
    }

    /// The map that the next frames are compared with.
    pub(crate) fn set_gaussians(&mut self, map: Arc<GaussianMap>) {
        self.gaussians = Some(map);
    }

    /// The first frame with enough depth is the world. Returns its usable keypoints (pixels, if frames
    /// are tracked by rendering), or 0.
    pub(crate) fn initialise(
        &mut self,
        context: &Context,
        frame: &mut Frame,
        depth: &DepthImage,
    ) -> usize {
        let config = &context.config;
        let with_depth = |i: &usize| frame.depth_m[*i].is_some() && frame.in_use[*i];
        let (usable, enough) = match config.tracking.method {
            TrackingMethod::Features => {
                let usable = (0..frame.len()).filter(with_depth).count();
                (usable, usable >= config.keyframes.first_min_keypoints)
            }
            TrackingMethod::Render => pixels_with_depth(depth, &config.render_tracking),
        };
        if !enough {
            return 0;
        }
        frame.camera_from_world = Se3::identity();
        self.state = TrackingState::Tracking;
        usable
    }

    /// Final pose by rendering, from where constant velocity leads; after a loss, from the last pose.
    /// Before the first map is handed over it stays there. Returns the number of pixels compared; with
    /// too few the camera is lost.
    pub(crate) fn track_by_rendering(
        &mut self,
        context: &Context,
        frame: &mut Frame,
        target: &Target,
    ) -> usize {
        let velocity = self.velocity.unwrap_or_default();
        let start = (self.last.as_ref()).map(|last| velocity * last.camera_from_world);
        let found = start.and_then(|start| match &self.gaussians {
            Some(map) => pose_by_rendering(context, map, target, &start),
            None => Some((start, 0)),
        });
        if let Some((pose, pixels)) = found {
            frame.camera_from_world = pose;
            self.state = TrackingState::Tracking;
            return pixels;
        }
        self.state = TrackingState::Lost;
        self.velocity = None;
        0
    }

    /// First pose: from the last frame; if that fails or the camera is lost, from the keyframes that look
    /// most like the frame.
    pub(crate) fn first_pose(
        &mut self,
        context: &Context,
        map: &Map,
        places: &PlaceIndex,
        frame: &mut Frame,
        observer: &mut dyn Observer,
        recorder: &mut Recorder,
    ) -> bool {
        if self.state == TrackingState::Tracking {
            observer.begin(Stage::TrackMotion);
            let found = self.pose_from_last(context, map, frame, recorder);
            observer.end(Stage::TrackMotion);
            if found {
                return true;
            }
            // Given up where it was expected: the rules of a lost camera hold from here on.
            self.state = TrackingState::Lost;
            frame.expected = None;
        }
        observer.begin(Stage::Relocalise);
        let found = relocalise(context, map, places, frame, recorder);
        observer.end(Stage::Relocalise);
        found
    }

    /// First pose from the last frame: motion model, then reference keyframe.
    fn pose_from_last(
        &self,
        context: &Context,
        map: &Map,
        frame: &mut Frame,
        recorder: &mut Recorder,
    ) -> bool {
        let Some(last) = &self.last else {
            return false;
        };
        let shutter = &self.shutter;
        let by_motion = self.velocity.is_some_and(|velocity| {
            track_motion(context, map, last, &velocity, frame, shutter, recorder)
        });
        let reference = map.keyframe(self.reference);
        by_motion || track_reference(context, map, last, reference, frame, shutter, recorder)
    }

    /// Final pose: links every landmark of the local map that can be found in the frame, optimises
    /// over all of them, refines the matches in the image and optimises again. Returns the number of
    /// inliers. Unless the map is `finished`, its landmarks count how often they should have been seen
    /// and how often they were.
    pub(crate) fn track_local_map(
        &mut self,
        context: &Context,
        map: &mut Map,
        images: &ImageStore,
        frame: &mut Frame,
        (pyramid, depth): (Option<&LkPyramid>, &DepthImage),
        finished: bool,
        recorder: &mut Recorder,
    ) -> usize {
        let local = local_map(context, map, frame);
        self.reference = local.reference.unwrap_or(self.reference);
        matching::from_local_map(context, map, &local.visible, frame);
        recorder.record("match_local_map", |record| {
            record.local_map(&local.visible);
            record.links(frame);
        });
        let mut inliers = refine_pose_with_depth(
            context,
            map,
            frame,
            MIN_SHARE_LABELLED,
            &self.shutter,
            recorder,
        );
        if inliers > 0 {
            if let Some(pyramid) = pyramid.filter(|_| context.config.subpixel.enabled) {
                refine_matches(context, map, images, frame, pyramid, depth, recorder);
            }
            let turn_rad = estimate_shutter(context, map, frame, &self.shutter);
            inliers = pose_from_links(context, map, frame, recorder);
            self.shutter
                .update(turn_rad, &frame.camera_from_world, self.follows(frame));
        }
        if !finished {
            let found = frame.landmark.iter().flatten().copied();
            map.count_sightings(&local.expected, found);
        }
        inliers
    }

    /// Tracking, weak or lost, by the number of inliers of a frame that was tracked.
    pub(crate) fn update_state(&mut self, context: &Context, frame: FrameId, inliers: usize) {
        let config = &context.config.tracking;
        let was_lost = self.state == TrackingState::Lost;
        let recently = |at: FrameId| frame.0 - at.0 < CAREFUL_FRAMES;
        let needed = match was_lost || self.relocalised_at.is_some_and(recently) {
            true => config.min_inliers_after_recovery,
            false => config.min_inliers,
        };
        if inliers >= needed {
            if was_lost {
                self.relocalised_at = Some(frame);
                tracing::info!(frame = frame.0, inliers, "relocalised");
            }
            self.state = TrackingState::Tracking;
            let usual = self.usual_inliers.get_or_insert(inliers as f64);
            self.weak = (inliers as f64) < WEAK_SHARE * *usual;
            *usual += (inliers as f64 - *usual) / USUAL_FRAMES;
        } else {
            if !was_lost {
                tracing::info!(frame = frame.0, inliers, "lost");
            }
            self.state = TrackingState::Lost;
            self.velocity = None;
            self.usual_inliers = None;
            self.weak = false;
        }
    }

    /// Whether the frame is the next one after the last tracked one.
    fn follows(&self, frame: &Frame) -> bool {
        (self.last.as_ref()).is_some_and(|last| last.id.0 + 1 == frame.id.0)
    }

    /// The motion from the last frame to this one, which the next is expected to repeat; none
    /// across a gap. To be called before any adjustment, while both poses are in the same map.
    pub(crate) fn update_velocity(&mut self, frame: &Frame) {
        let last = self.last.as_ref().filter(|_| self.follows(frame));
        self.velocity = last.map(|last| frame.camera_from_world * last.camera_from_world.inverse());
    }

    /// The frame from which the next one is tracked.
    pub(crate) fn set_last(&mut self, frame: Frame) {
        self.last = Some(frame);
    }

    /// Lost, as if no frame had been tracked, in a map that stays.
    pub(crate) fn reset_to_lost(&mut self) {
        *self = Self {
            state: TrackingState::Lost,
            reference: self.reference,
            ..Self::default()
        };
    }

    /// Writes what a session must keep.
    pub(crate) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            state,
            last,
            velocity,
            reference,
            relocalised_at,
            usual_inliers,
            weak,
            shutter,
            gaussians,
        } = self;
        to.put("state", state)?;
        to.put("last", last)?;
        to.put("velocity", velocity)?;
        to.put("reference", reference)?;
        to.put("relocalised_at", relocalised_at)?;
        to.put("usual_inliers", usual_inliers)?;
        to.put("weak", weak)?;
        to.put("shutter", shutter)?;
        to.put("tracking_map", gaussians)
    }

    /// Reads what [`Tracker::save`] wrote.
    pub(crate) fn load<R: Read>(from: &mut SectionReader<R>) -> Result<Self, SessionError> {
        Ok(Self {
            state: from.take("state")?,
            last: from.take("last")?,
            velocity: from.take("velocity")?,
            reference: from.take("reference")?,
            relocalised_at: from.take("relocalised_at")?,
            usual_inliers: from.take("usual_inliers")?,
            weak: from.take("weak")?,
            shutter: from.take("shutter")?,
            gaussians: from.take("tracking_map")?,
        })
    }
}

#[cfg(test)]
mod tests;
