//! Keyframes: when a frame is kept, what follows from it, which landmarks it makes, which are thrown
//! out.

use std::sync::Arc;

use garad_core::chi_square::{CHI2_2DOF_95, CHI2_3DOF_95};
use garad_core::{Camera, KeyframeId, LandmarkId, MaskImage};
use garad_features::LkPyramid;

use crate::frame::Frame;
use crate::labels::frame::full_size;
use crate::labels::witness::Witness;
use crate::map::{Map, by_count};
use crate::mapper::{MappingJob, NewLandmark};
use crate::observer::{Observer, Stage};
use crate::recover::still_descriptors;
use crate::system::{FrameInput, Slam, SlamError};

impl Slam {
    /// Should this frame be kept? ORB-SLAM's RGB-D rules, with mapping always ready (the schedule
    /// is fixed by frame numbers, so there is no queue to ask).
    pub(crate) fn needs_keyframe(&self, frame: &Frame, inliers: usize) -> bool {
        let config = &self.config.keyframes;
        let since_last = frame.id.0 - self.last_keyframe_frame.0;
        let gap = usize::try_from(since_last).unwrap_or(usize::MAX);
        if gap < config.min_gap.max(1) || inliers < config.min_inliers {
            return false;
        }
        let close = |i: &usize| frame.depth_m[*i].is_some_and(|d| d < config.close_m);
        let (tracked, untracked): (Vec<_>, Vec<_>) = (0..frame.len())
            .filter(close)
            .filter(|&i| frame.in_use[i])
            .partition(|&i| frame.landmark[i].is_some());
        let need_close = tracked.len() < config.close_tracked_min
            && untracked.len() > config.close_untracked_min;
        let few = (inliers as f64) < config.ref_ratio * self.reference_landmarks() as f64;
        few || need_close || gap >= config.max_gap
    }

    /// Landmarks of the reference keyframe that at least two keyframes see (one, while there are
    /// no more than two keyframes).
    fn reference_landmarks(&self) -> usize {
        let needed = if self.map.keyframes().len() <= 2 {
            1
        } else {
            2
        };
        self.map
            .keyframe(self.reference)
            .landmark
            .iter()
            .flatten()
            .filter_map(|l| self.map.landmark(*l))
            .filter(|l| l.observations.len() >= needed)
            .count()
    }

    /// Keeps a keyframe's picture and forgets those beyond the limit that nobody looks into any more.
    pub(crate) fn remember_picture(
        &mut self,
        keyframe: KeyframeId,
        pyramid: Option<Arc<LkPyramid>>,
    ) {
        if let Some(pyramid) = pyramid {
            self.pyramids.insert(keyframe, pyramid);
        }
        let oldest = self.oldest_picture(self.map.keyframe(keyframe).id);
        while self.pyramids.len() > self.config.refine.keyframes {
            let first = self.pyramids.first_entry();
            match first.filter(|first| self.map.keyframe(*first.key()).id >= oldest) {
                Some(_) => break,
                None => self.pyramids.pop_first(),
            };
        }
    }

    /// Keeps a frame: landmarks and bundle adjustment here, Gaussians in a mapping job.
    pub(crate) fn keep(
        &mut self,
        frame: Frame,
        input: &FrameInput<'_>,
        cells: Option<MaskImage>,
        observer: &mut dyn Observer,
    ) -> Result<KeyframeId, SlamError> {
        let frame_id = frame.id;
        let since_last = (frame_id.0 - self.last_keyframe_frame.0) as usize;
        observer.begin(Stage::Keyframe);
        let id = self.add_keyframe(frame);
        self.forget_surfaces(id);
        observer.end(Stage::Keyframe);
        let mask = match (&cells, input.mask) {
            (Some(cells), _) => Some(full_size(cells, input.rgb.size())),
            (None, given) => given.cloned(),
        };
        if let Some(mask) = &mask {
            let surface = &mut self.map.keyframe_mut(id).surface;
            *surface = surface.take().map(|s| s.without_moving(mask));
        }
        let mut labels = Vec::new();
        if self.config.labels.enabled && input.mask.is_none() {
            observer.begin(Stage::LabelMap);
            let mut witness = Witness::new(input.depth, self.config.features.max_depth_m);
            if let Some(cells) = &cells {
                witness.set_moving(cells.clone());
            }
            self.witnesses.insert(id, witness);
            self.forget_witnesses(frame_id);
            if self.knows_what_moves(frame_id) {
                labels = self.label_landmarks(id);
            }
            observer.end(Stage::LabelMap);
        }
        if self.config.local_ba.enabled {
            observer.begin(Stage::LocalBa);
            self.local_ba(id);
            observer.end(Stage::LocalBa);
        }
        let mut moved = Vec::new();
        if self.config.loops.enabled {
            observer.begin(Stage::Loop);
            moved = self.close_loop(id);
            observer.end(Stage::Loop);
        }
        self.places
            .add(id, &still_descriptors(self.map.keyframe(id)));
        if self.config.culling.enabled {
            self.cull_keyframes(id);
        }
        if self.config.seed.enabled {
            let train = &self.config.train;
            let job = MappingJob {
                keyframe: id,
                frame: frame_id,
                rgb: input.rgb.clone(),
                depth: input.depth.clone(),
                mask,
                cells,
                labels,
                poses: self.keyframe_poses(),
                moved,
                new_landmarks: self.landmarks_born_in(id),
                living: self.map.landmarks().map(|(l, _)| l).collect(),
                iterations: train.per_keyframe + train.per_frame * since_last,
            };
            self.schedule.submit(job)?;
        }
        Ok(id)
    }

    /// What the mapper is told of a keyframe's new landmarks.
    fn landmarks_born_in(&self, id: KeyframeId) -> Vec<NewLandmark> {
        let keyframe = self.map.keyframe(id);
        let linked = (0..keyframe.len()).filter_map(|i| Some((i, keyframe.landmark[i]?)));
        linked
            .filter_map(|(i, landmark)| {
                let found = self.map.landmark(landmark).filter(|l| l.born == id)?;
                Some(NewLandmark {
                    id: landmark,
                    p_world: found.p_world,
                    px: [pixel(keyframe.px[i].x), pixel(keyframe.px[i].y)],
                })
            })
            .collect()
    }

    /// Adds a keyframe: links become observations, depth becomes landmarks, neighbours' doubles
    /// become one, and landmarks that did not prove themselves go.
    pub(crate) fn add_keyframe(&mut self, frame: Frame) -> KeyframeId {
        self.last_keyframe_frame = frame.id;
        let id = self.map.add_keyframe(frame);
        self.reference = id;
        let linked: Vec<_> = self
            .map
            .keyframe(id)
            .landmark
            .iter()
            .flatten()
            .copied()
            .collect();
        for landmark in linked {
            self.map.refresh(landmark, &self.scales);
        }
        self.drop_weak_landmarks(id);
        let new = self.new_landmarks(id);
        self.recent.extend(new);
        fuse_with_neighbours(
            &mut self.map,
            id,
            &self.camera,
            &self.scales,
            self.config.tracking.bf,
        );
        id
    }

    /// Landmarks from the depth of keypoints that have none: all that are close, and at least the
    /// `min_new_landmarks` nearest keypoints in any case.
    fn new_landmarks(&mut self, id: KeyframeId) -> Vec<LandmarkId> {
        let config = &self.config.keyframes;
        let keyframe = self.map.keyframe(id);
        let mut by_depth: Vec<(f64, usize)> = (0..keyframe.len())
            .filter(|&i| keyframe.in_use[i])
            .filter_map(|i| Some((keyframe.depth_m[i]?, i)))
            .collect();
        by_depth.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let wanted: Vec<_> = by_depth
            .iter()
            .enumerate()
            .take_while(|(rank, (depth, _))| {
                *depth < config.close_m || *rank < config.min_new_landmarks
            })
            .filter(|(_, (_, i))| keyframe.landmark[*i].is_none())
            .filter_map(|(_, (_, i))| Some((*i, keyframe.world_point(*i, &self.camera)?)))
            .collect();
        wanted
            .into_iter()
            .map(|(i, p_world)| self.map.add_landmark(p_world, id, i, &self.scales))
            .collect()
    }

    /// Drops recent landmarks that are rarely found where they should be, or that no second
    /// keyframe has seen two keyframes after their birth. Those three keyframes old have passed.
    fn drop_weak_landmarks(&mut self, now: KeyframeId) {
        let config = self.config.keyframes.clone();
        let recent = std::mem::take(&mut self.recent);
        for id in recent {
            let Some(landmark) = self.map.landmark(id) else {
                continue;
            };
            let age = now.0 - landmark.born.0;
            let rarely_found =
                f64::from(landmark.found) < config.found_ratio * f64::from(landmark.visible);
            let unconfirmed = age >= 2 && landmark.observations.len() < config.min_observations;
            if rarely_found || unconfirmed {
                self.map.drop_landmark(id);
            } else if age < 3 {
                self.recent.push(id);
            }
        }
    }
}

/// Index of the pixel a place lies in.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; keypoints lie inside the picture"
)]
fn pixel(c: f64) -> usize {
    (c + 0.5) as usize
}

/// Neighbours searched for doubles of a keyframe's landmarks.
const FUSE_NEIGHBOURS: usize = 10;
/// Search radius, px at level 0.
const FUSE_RADIUS_PX: f64 = 3.0;
/// Hamming distance of doubles.
const FUSE_DISTANCE: u32 = 50;

/// Projects the landmarks of a keyframe into its neighbours and theirs into it. Where the keypoint
/// found there has another landmark the two become one; where it has none it becomes an
/// observation.
fn fuse_with_neighbours(map: &mut Map, id: KeyframeId, camera: &Camera, scales: &[f64], bf: f64) {
    let neighbours: Vec<_> = by_count(&map.covisible(id))
        .into_iter()
        .take(FUSE_NEIGHBOURS)
        .collect();
    let own: Vec<_> = map
        .keyframe(id)
        .landmark
        .iter()
        .flatten()
        .copied()
        .collect();
    for neighbour in &neighbours {
        fuse_into(map, &own, *neighbour, camera, scales, bf);
    }
    let mut theirs: Vec<_> = neighbours
        .iter()
        .flat_map(|k| map.keyframe(*k).landmark.iter().flatten().copied())
        .collect();
    theirs.sort_unstable();
    theirs.dedup();
    fuse_into(map, &theirs, id, camera, scales, bf);
}

/// Fuses landmarks with what a keyframe sees where they should be, or links them there.
pub(crate) fn fuse_into(
    map: &mut Map,
    landmarks: &[LandmarkId],
    keyframe: KeyframeId,
    camera: &Camera,
    scales: &[f64],
    bf: f64,
) {
    for id in landmarks {
        let frame = map.keyframe(keyframe);
        let Some(landmark) = map.landmark(*id) else {
            continue;
        };
        if landmark.observations.iter().any(|(k, _)| *k == keyframe) {
            continue;
        }
        let Some(seen) = map.appearance(landmark, frame, camera, scales) else {
            continue;
        };
        let level = i32::try_from(seen.level).unwrap_or(i32::MAX);
        let radius = FUSE_RADIUS_PX * scales[seen.level];
        let best = frame
            .near(&seen.uv_px, radius, level - 1, level)
            .filter(|&k| {
                let sigma = scales[usize::from(frame.keypoints[k].level)];
                let error = (frame.uv_px[k] - seen.uv_px).norm_squared();
                match frame.depth_m[k] {
                    Some(depth) => {
                        let disparity = bf / depth - bf / seen.depth_m;
                        error + disparity * disparity <= CHI2_3DOF_95 * sigma * sigma
                    }
                    None => error <= CHI2_2DOF_95 * sigma * sigma,
                }
            })
            .map(|k| (frame.descriptors[k].distance(&landmark.descriptor), k))
            .min();
        let Some((distance, k)) = best else { continue };
        if distance > FUSE_DISTANCE {
            continue;
        }
        match frame.landmark[k] {
            Some(other) => {
                let count = |l: LandmarkId| map.landmark(l).map_or(0, |l| l.observations.len());
                if count(other) > count(*id) {
                    map.fuse(other, *id, scales);
                } else {
                    map.fuse(*id, other, scales);
                }
            }
            None => map.add_observation(*id, keyframe, k),
        }
    }
}
