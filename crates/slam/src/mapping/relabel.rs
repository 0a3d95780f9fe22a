//! The labels of Gaussians: from their landmarks, else from the keyframe's free space, kept in the window of
//! eq. 7. The only writer of Gaussian labels.
//!
//! Only tagged Gaussians have a landmark. All others were made from depth, clones and splits; for
//! them the question is that of a frame's samples: is there free space where the Gaussian is, or
//! something that moves?

use std::collections::BTreeMap;

use garad_core::{Camera, GaussianMap, Label, LandmarkId, Se3};
use garad_crf::LabelWindow;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::config::LabelConfig;
use crate::dynamics::free_space::{FreeSpace, Visibility};
use crate::dynamics::retention::push_label;

/// Number of labels a keyframe changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Relabelled {
    /// Static Gaussians that were found to move.
    pub to_dynamic: usize,
    /// Dynamic Gaussians that were found to be static.
    pub to_static: usize,
    /// Removed: dynamic in every run of the window.
    pub removed: usize,
}

/// Gives every Gaussian in view a label and adds it to its window. The second result marks those that
/// were dynamic for a whole window. A Gaussian whose landmark changed takes the landmark's label.
pub(crate) fn relabel(
    map: &mut GaussianMap,
    windows: &mut [LabelWindow],
    changed: &[(LandmarkId, Label)],
    free_space: &FreeSpace,
    camera: &Camera,
    camera_from_world: &Se3,
    config: &LabelConfig,
) -> (Relabelled, Vec<bool>) {
    let changed: BTreeMap<LandmarkId, Label> = changed.iter().copied().collect();
    let mut counts = Relabelled::default();
    let mut expired = vec![false; map.len()];
    for i in 0..map.len() {
        let mean = Vector3::from(map.means[i].map(f64::from));
        let of_landmark = map.landmark[i].and_then(|l| changed.get(&l).copied());
        let visibility = free_space.query(&mean, camera, camera_from_world, &config.noise);
        let label = of_landmark.or(match visibility {
            Visibility::InFront(sigmas) if sigmas > config.suspect_sigmas => Some(Label::Dynamic),
            Visibility::OnSurface(label) => Some(label),
            Visibility::InFront(_) | Visibility::Occluded | Visibility::Unknown => None,
        });
        let Some(label) = label else { continue };
        let window = &mut windows[i];
        let retention = push_label(&mut map.label[i], window, label, &config.window);
        expired[i] = retention.expired;
        match (retention.changed, label) {
            (true, Label::Dynamic) => counts.to_dynamic += 1,
            (true, Label::Static) => counts.to_static += 1,
            (false, _) => {}
        }
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

    fn run(
        map: &mut GaussianMap,
        windows: &mut [LabelWindow],
        free_space: &FreeSpace,
    ) -> Vec<bool> {
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        let config = LabelConfig::default();
        let pose = Se3::identity();
        relabel(map, windows, &[], free_space, &camera, &pose, &config).1
    }

    #[test]
    fn gaussians_in_free_space_are_dynamic_and_removed_after_ten_runs() {
        let mut map = map(&[1.0, 2.0, 3.0]);
        let mut windows = vec![LabelWindow::default(); 3];
        let free_space = FreeSpace::new(&DepthImage::new(64, 48, 2.0), 8.0);
        for k in 1..=10 {
            let expired = run(&mut map, &mut windows, &free_space);
            assert_eq!(expired, [k == 10, false, false], "run {k}");
        }
        let labels = [Label::Dynamic, Label::Static, Label::Static];
        assert_eq!(map.label, labels, "in front, on, behind");
        assert_eq!(windows[2].seen(), 0, "no label while occluded");
    }

    #[test]
    fn gaussians_in_the_mask_are_dynamic_until_found_static() {
        let mut map = map(&[2.0]);
        let mut windows = vec![LabelWindow::default()];
        let mut free_space = FreeSpace::new(&DepthImage::new(64, 48, 2.0), 8.0);
        free_space.set_moving(MaskImage::new(16, 12, 255));
        run(&mut map, &mut windows, &free_space);
        assert_eq!(map.label, [Label::Dynamic], "inside the mask");
        free_space.set_moving(MaskImage::new(16, 12, 0));
        run(&mut map, &mut windows, &free_space);
        assert_eq!(map.label, [Label::Static], "found static again");
    }
}
