//! A lost camera found again: the frame against the keyframes that look most like it.
//!
//! ```text
//! descriptors ─→ place index ─→ candidates ─→ matches ─→ rigid motion, or PnP ─→ pose (eq. 11)
//!                                                                                 │
//!                         enough inliers? ←─ pose (eq. 11) ←─ landmarks around the candidate
//! ```
//!
//! Matches are pairs of a landmark in the world and a keypoint in the camera. Where keypoints have
//! depth, three pairs give a rigid motion in closed form; a seeded RANSAC keeps the motion most pairs
//! agree with. Without enough depth the same is done with directions alone
//! ([`solve_pnp_ransac`]).

use garad_core::{KeyframeId, LandmarkId, Rng, Se3, So3};
use garad_features::Descriptor;
use garad_optim::{PnpConfig, PoseConfig, solve_pnp_ransac};
use nalgebra::{Matrix3, Vector3};

use crate::frame::Frame;
use crate::map::by_count;
use crate::system::Slam;

/// Keyframes tried for each frame, so that a large map costs no more than a small one.
const CANDIDATES: usize = 10;
/// Neighbours of a candidate whose landmarks are looked for, too.
const NEIGHBOURS: usize = 10;

/// Draws of three pairs: with half the pairs wrong, 100 draws miss all good triples once in 6e5.
const DRAWS: usize = 100;
/// Pairs within this distance agree with a motion, as a share of the depth plus a floor, metres.
const AGREE_RATIO: f64 = 0.03;
const AGREE_FLOOR_M: f64 = 0.02;

/// The motion a_from_b nearest to the pairs (a, b) in least squares (Kabsch 1976):
/// H = Σ (b - b̄)(a - ā)ᵀ = U S Vᵀ, R = V diag(1, 1, det(V Uᵀ)) Uᵀ, t = ā - R b̄ (E16).
///
/// `None` for fewer than three pairs or numbers that are not finite. Collinear pairs leave the turn
/// about their line open: one of the many motions is returned.
#[must_use]
pub fn rigid_from_pairs(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Se3> {
    if pairs.len() < 3 {
        return None;
    }
    let n = pairs.len() as f64;
    let mut mean_a = Vector3::zeros();
    let mut mean_b = Vector3::zeros();
    for (a, b) in pairs {
        mean_a += a / n;
        mean_b += b / n;
    }
    let mut h = Matrix3::zeros();
    for (a, b) in pairs {
        h += (b - mean_b) * (a - mean_a).transpose();
    }
    if !h.iter().all(|v| v.is_finite()) {
        return None;
    }
    let svd = h.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    let sign = if (v * u.transpose()).determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    let r = v * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * u.transpose();
    let rotation = So3::from_matrix(&r);
    Some(Se3::new(rotation, mean_a - rotation * mean_b))
}

/// Descriptors of what stands still in a frame: what a place is known by.
pub(crate) fn still_descriptors(frame: &Frame) -> Vec<Descriptor> {
    let still = frame.descriptors.iter().zip(&frame.in_use);
    still
        .filter(|(_, in_use)| **in_use)
        .map(|(d, _)| *d)
        .collect()
}

impl Slam {
    /// Looks for the frame among the keyframes; true when enough of one's landmarks agree.
    ///
    /// The first candidate around which the local map will be found is taken, else the one with most
    /// inliers: tracking decides.
    pub(crate) fn recover(&self, frame: &mut Frame) -> bool {
        let config = &self.config.tracking;
        let candidates = self
            .places
            .query(&still_descriptors(frame), CANDIDATES, |_| false);
        let mut best: Option<(usize, Frame)> = None;
        for candidate in candidates {
            let mut tried = frame.clone();
            let inliers = self.locate(&mut tried, candidate.id);
            if inliers >= config.reference_min_matches
                && best.as_ref().is_none_or(|(most, _)| inliers > *most)
            {
                best = Some((inliers, tried));
            }
            if inliers >= config.min_inliers_after_recovery {
                break;
            }
        }
        match best {
            Some((_, found)) => {
                *frame = found;
                true
            }
            None => {
                frame.landmark.fill(None);
                false
            }
        }
    }

    /// Finds a frame's pose from nothing but the landmarks of a keyframe and its neighbours, and
    /// links them. Returns the number of inliers; 0: not there.
    pub(crate) fn locate(&self, frame: &mut Frame, candidate: KeyframeId) -> usize {
        let needed = self.config.tracking.reference_min_matches;
        frame.landmark.fill(None);
        let keyframe = self.map.keyframe(candidate);
        if self.matcher().from_keyframe(&self.map, keyframe, frame) < needed {
            return 0;
        }
        let Some(pose) = self
            .ransac(frame, needed)
            .or_else(|| self.pnp(frame, candidate, needed))
        else {
            return 0;
        };
        frame.camera_from_world = pose;
        if self.optimise(frame) < needed {
            return 0;
        }
        let around = self.landmarks_around(candidate);
        let linked: Vec<_> = frame.landmark.iter().flatten().copied().collect();
        let visible: Vec<_> = around
            .into_iter()
            .filter(|id| !linked.contains(id))
            .filter_map(|id| {
                let landmark = self.map.static_landmark(id)?;
                let (camera, scales) = (&self.camera, &self.scales);
                Some((id, self.map.appearance(landmark, frame, camera, scales)?))
            })
            .collect();
        self.matcher().from_local_map(&self.map, &visible, frame);
        self.optimise(frame)
    }

    /// What a keyframe and its nearest neighbours see, by id.
    pub(crate) fn landmarks_around(&self, keyframe: KeyframeId) -> Vec<LandmarkId> {
        let neighbours = by_count(&self.map.covisible(keyframe));
        let mut ids: Vec<LandmarkId> = neighbours
            .into_iter()
            .take(NEIGHBOURS)
            .chain([keyframe])
            .flat_map(|k| self.map.keyframe(k).landmark.iter().flatten().copied())
            .collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// camera_from_world from all linked keypoints, whether they have depth or not.
    fn pnp(&self, frame: &Frame, candidate: KeyframeId, needed: usize) -> Option<Se3> {
        let observations: Vec<_> = (0..frame.len())
            .filter_map(|i| {
                let p_world = self.map.static_landmark(frame.landmark[i]?)?.p_world;
                Some(self.observation(frame, i, p_world))
            })
            .collect();
        let key = [u64::from(frame.id.0), u64::from(candidate.0)];
        let config = PnpConfig {
            min_inliers: needed,
            seed: Rng::keyed(self.seed, &key).next_u64(),
            pose: PoseConfig {
                bf: self.config.tracking.bf,
                ..PoseConfig::default()
            },
            ..PnpConfig::default()
        };
        let found = solve_pnp_ransac(&self.camera, &observations, &config, self.par);
        // The observations come from a valid frame and map, so the answer is never an error.
        Some(found.ok()??.camera_from_world)
    }

    /// camera_from_world that most linked keypoints with depth agree with, if at least `needed` do.
    fn ransac(&self, frame: &Frame, needed: usize) -> Option<Se3> {
        let pairs: Vec<_> = (0..frame.len())
            .filter_map(|i| {
                let p_world = self.map.landmark(frame.landmark[i]?)?.p_world;
                Some((
                    self.camera.unproject(&frame.uv_px[i], frame.depth_m[i]?),
                    p_world,
                ))
            })
            .collect();
        if pairs.len() < needed {
            return None;
        }
        let agreeing = |pose: &Se3| -> Vec<_> {
            pairs
                .iter()
                .filter(|(p_cam, p_world)| {
                    (*pose * *p_world - p_cam).norm() < AGREE_FLOOR_M + AGREE_RATIO * p_cam.z
                })
                .copied()
                .collect()
        };
        let mut rng = Rng::keyed(self.seed, &[u64::from(frame.id.0)]);
        let mut best: Vec<_> = Vec::new();
        for _ in 0..DRAWS {
            let draw = [0; 3].map(|_| pairs[rng.below(pairs.len())]);
            let Some(pose) = rigid_from_pairs(&draw) else {
                continue;
            };
            let inliers = agreeing(&pose);
            if inliers.len() > best.len() {
                best = inliers;
            }
        }
        if best.len() < needed {
            return None;
        }
        rigid_from_pairs(&best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn closed_form_gives_the_motion_back() {
        let a_from_b = Se3::exp(&Vector6::new(0.3, -0.2, 1.0, 0.4, -1.1, 2.0));
        let points = [
            [0.0, 0.0, 1.0],
            [1.0, 0.2, 2.0],
            [-0.4, 0.9, 1.5],
            [0.1, -0.7, 3.0],
        ];
        let pairs: Vec<_> = points
            .iter()
            .map(|p| Vector3::from(*p))
            .map(|b| (a_from_b * b, b))
            .collect();
        for n in [3, 4] {
            let found = rigid_from_pairs(&pairs[..n]).expect("enough pairs");
            assert!(
                (found * a_from_b.inverse()).log().norm() < 1e-13,
                "{n} pairs"
            );
        }
        assert!(
            rigid_from_pairs(&pairs[..2]).is_none(),
            "two do not fix a rotation"
        );
        let nan = [(Vector3::repeat(f64::NAN), Vector3::x()); 3];
        assert!(rigid_from_pairs(&nan).is_none(), "NaN");
    }
}
