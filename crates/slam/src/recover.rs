//! A lost camera found again: the frame against keyframes, the youngest first.
//!
//! Descriptors give pairs (landmark in the world, keypoint with depth in the camera); three pairs
//! give a rigid motion in closed form; a seeded RANSAC keeps the motion most pairs agree with, and
//! the usual optimisation finishes it.

use garad_core::{Rng, Se3, So3};
use nalgebra::{Matrix3, Vector3};

use crate::frame::Frame;
use crate::system::Slam;

/// Keyframes tried for each frame: the youngest, and a window that moves on through all the others
/// from frame to frame, so that a large map costs no more than a small one.
const YOUNGEST: usize = 10;
const WINDOW: usize = 20;

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

/// Which of `n` keyframes to try at a frame, in order.
fn candidates(n: usize, frame: usize) -> Vec<usize> {
    let youngest = (n.saturating_sub(YOUNGEST)..n).rev();
    let others = n.saturating_sub(YOUNGEST);
    let window = (0..others.min(WINDOW)).map(|i| (frame * WINDOW + i) % others);
    youngest.chain(window).collect()
}

impl Slam {
    /// Looks for the frame among the keyframes; true when enough of one's landmarks agree.
    pub(crate) fn recover(&self, frame: &mut Frame) -> bool {
        let needed = self.config.tracking.reference_min_matches;
        let keyframes = self.map.keyframes();
        for k in candidates(keyframes.len(), frame.id.index()) {
            frame.landmark.fill(None);
            if self
                .matcher()
                .from_keyframe(&self.map, &keyframes[k], frame)
                < needed
            {
                continue;
            }
            let Some(pose) = self.ransac(frame, needed) else {
                continue;
            };
            frame.camera_from_world = pose;
            if self.optimise(frame) >= needed {
                return true;
            }
        }
        frame.landmark.fill(None);
        false
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
    fn every_keyframe_gets_its_turn() {
        assert_eq!(
            candidates(3, 7),
            [2, 1, 0],
            "few: all of them, youngest first"
        );
        assert!(candidates(0, 7).is_empty(), "none");
        let mut tried: Vec<_> = (5..10).flat_map(|frame| candidates(100, frame)).collect();
        tried.sort_unstable();
        tried.dedup();
        assert_eq!(
            tried,
            (0..100).collect::<Vec<_>>(),
            "five frames go through a hundred"
        );
        assert_eq!(
            candidates(100, 5).len(),
            YOUNGEST + WINDOW,
            "a frame tries no more"
        );
    }

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
