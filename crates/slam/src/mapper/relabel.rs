//! Which Gaussians move: the keyframe's depth as a witness, tags from their landmarks, and eq. 7.
//!
//! Only tagged Gaussians have a landmark to ask. All others were born of depth, clones and splits;
//! they are asked the same question as every sample of a frame: does the keyframe see through the
//! place where the Gaussian is, or something there that moves?

use std::collections::BTreeMap;

use garad_core::{Camera, GaussianMap, Label, LandmarkId, Se3};
use garad_crf::LabelWindow;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::config::LabelConfig;
use crate::labels::witness::{Testimony, Witness};

/// How many labels a keyframe changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Relabelled {
    /// Static Gaussians that were found to move.
    pub to_dynamic: usize,
    /// Dynamic Gaussians that were found to be at rest.
    pub to_static: usize,
    /// Dropped: dynamic in every one of the last runs.
    pub removed: usize,
}

/// Gives every Gaussian in view a label and a place for it in its window. The second answer says
/// which have been dynamic for a whole window.
pub(crate) fn relabel(
    map: &mut GaussianMap,
    windows: &mut [LabelWindow],
    changed: &[(LandmarkId, Label)],
    witness: &Witness,
    camera: &Camera,
    camera_from_world: &Se3,
    config: &LabelConfig,
) -> (Relabelled, Vec<bool>) {
    let changed: BTreeMap<LandmarkId, Label> = changed.iter().copied().collect();
    let mut counts = Relabelled::default();
    let mut expired = vec![false; map.len()];
    for i in 0..map.len() {
        let mean = Vector3::from(map.means[i].map(f64::from));
        let said_by_landmark = map.landmark[i].and_then(|l| changed.get(&l).copied());
        let seen = witness.testify(&mean, camera, camera_from_world, &config.noise);
        let label = said_by_landmark.or(match seen {
            Testimony::SeenThrough(sigmas) if sigmas > config.suspect_sigmas => {
                Some(Label::Dynamic)
            }
            Testimony::Agrees(true) => Some(Label::Static),
            Testimony::Agrees(false) => Some(Label::Dynamic),
            Testimony::SeenThrough(_) | Testimony::Hidden | Testimony::Absent => None,
        });
        let Some(label) = label else { continue };
        windows[i].push(label);
        expired[i] = windows[i].is_removed(&config.window);
        match (map.label[i], label) {
            (Label::Static, Label::Dynamic) => counts.to_dynamic += 1,
            (Label::Dynamic, Label::Static) => counts.to_static += 1,
            _ => {}
        }
        map.label[i] = label;
    }
    counts.removed = expired.iter().filter(|e| **e).count();
    (counts, expired)
}

#[cfg(test)]
mod tests {
    use garad_core::{DepthImage, KeyframeId, MaskImage, NewGaussian};

    use super::*;

    fn map(depths: &[f32]) -> GaussianMap {
        let mut map = GaussianMap::new(0);
        for &z in depths {
            map.push(&NewGaussian {
                mean: [0.0, 0.0, z],
                sigma_m: 0.02,
                opacity: 0.9,
                color: [0.5; 3],
                landmark: None,
                born: KeyframeId(0),
            });
        }
        map
    }

    fn run(map: &mut GaussianMap, windows: &mut [LabelWindow], witness: &Witness) -> Vec<bool> {
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        let config = LabelConfig::default();
        let pose = Se3::identity();
        relabel(map, windows, &[], witness, &camera, &pose, &config).1
    }

    #[test]
    fn what_a_keyframe_sees_through_moves_and_goes_after_ten_runs() {
        let mut map = map(&[1.0, 2.0, 3.0]);
        let mut windows = vec![LabelWindow::default(); 3];
        let witness = Witness::new(&DepthImage::new(64, 48, 2.0), 8.0);
        for k in 1..=10 {
            let expired = run(&mut map, &mut windows, &witness);
            assert_eq!(expired, [k == 10, false, false], "run {k}");
        }
        let labels = [Label::Dynamic, Label::Static, Label::Static];
        assert_eq!(map.label, labels, "in front, on, behind");
        assert_eq!(windows[2].seen(), 0, "what is hidden is not asked");
    }

    #[test]
    fn what_stands_where_something_moves_moves_until_it_rests() {
        let mut map = map(&[2.0]);
        let mut windows = vec![LabelWindow::default()];
        let mut witness = Witness::new(&DepthImage::new(64, 48, 2.0), 8.0);
        witness.set_moving(MaskImage::new(16, 12, 255));
        run(&mut map, &mut windows, &witness);
        assert_eq!(map.label, [Label::Dynamic], "inside the mask");
        witness.set_moving(MaskImage::new(16, 12, 0));
        run(&mut map, &mut windows, &witness);
        assert_eq!(map.label, [Label::Static], "found at rest again");
    }
}
