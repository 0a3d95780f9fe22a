//! The labels of Gaussians, kept in the window of eq. 7. The only writer of Gaussian labels.
//!
//! A tagged Gaussian has a landmark, whose label it takes (`labels.tagged`). All others were made from
//! depth, clones and splits; for them the question is that of a frame's samples: is there free space
//! where the Gaussian is, or something that moves?

use std::collections::BTreeMap;

use garad_core::{Camera, GaussianMap, Label, LandmarkId, Se3};
use garad_crf::{LabelWindow, LabelWindowConfig};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::config::{LabelConfig, TaggedLabels};
use crate::dynamics::free_space::{FreeSpace, Visibility};
use crate::dynamics::landmarks::LandmarkLabel;
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

/// Gives the Gaussians that landmarks or the keyframe's free space speak of a label, and adds it to
/// their windows. The second result marks those that were dynamic for a whole window.
///
/// # Panics
/// Unless there is a window for every Gaussian.
pub fn relabel(
    map: &mut GaussianMap,
    windows: &mut [LabelWindow],
    labelled: &[LandmarkLabel],
    free_space: Option<&FreeSpace>,
    camera: &Camera,
    camera_from_world: &Se3,
    config: &LabelConfig,
) -> (Relabelled, Vec<bool>) {
    let labelled: BTreeMap<LandmarkId, LandmarkLabel> =
        labelled.iter().map(|l| (l.id, *l)).collect();
    let of_evidence = |mean: [f32; 3]| {
        let mean = Vector3::from(mean.map(f64::from));
        match free_space?.query(&mean, camera, camera_from_world, &config.noise) {
            Visibility::InFront(sigmas) if sigmas > config.suspect_sigmas => Some(Label::Dynamic),
            Visibility::OnSurface(label) => Some(label),
            Visibility::InFront(_) | Visibility::Occluded | Visibility::Unknown => None,
        }
    };
    let label = |map: &GaussianMap, i: usize| {
        let tag = map.landmark[i];
        let landmark = tag.and_then(|l| labelled.get(&l));
        match config.tagged {
            TaggedLabels::Landmark if tag.is_some() => landmark.map(|l| l.label),
            _ => (landmark.filter(|l| l.changed).map(|l| l.label))
                .or_else(|| of_evidence(map.means[i])),
        }
    };
    let labels: Vec<Option<Label>> = (0..map.len()).map(|i| label(map, i)).collect();
    push_labels(map, windows, &labels, &config.window)
}

/// Adds a label to the window of each Gaussian that has one here; the second result marks those that were dynamic for
/// a whole window.
///
/// # Panics
/// If there are more labels than Gaussians or windows.
pub fn push_labels(
    map: &mut GaussianMap,
    windows: &mut [LabelWindow],
    labels: &[Option<Label>],
    config: &LabelWindowConfig,
) -> (Relabelled, Vec<bool>) {
    let mut counts = Relabelled::default();
    let mut expired = vec![false; map.len()];
    for (i, label) in labels.iter().enumerate() {
        let Some(label) = *label else { continue };
        let retention = push_label(&mut map.label[i], &mut windows[i], label, config);
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

/// The invariant of tagged Gaussians after a keyframe: with [`TaggedLabels::Landmark`] each has the label
/// of its landmark, with [`TaggedLabels::Evidence`] each whose landmark changed.
///
/// # Panics
/// If one has another label.
pub(crate) fn assert_labels_agree(
    map: &GaussianMap,
    labelled: &[LandmarkLabel],
    living: &[(LandmarkId, Label)],
    tagged: TaggedLabels,
) {
    let labels: BTreeMap<LandmarkId, Label> = match tagged {
        TaggedLabels::Landmark => living.iter().copied().collect(),
        TaggedLabels::Evidence => (labelled.iter().filter(|l| l.changed))
            .map(|l| (l.id, l.label))
            .collect(),
    };
    for i in 0..map.len() {
        let expected = map.landmark[i].and_then(|l| labels.get(&l));
        let agrees = expected.is_none_or(|label| *label == map.label[i]);
        assert!(
            agrees,
            "Gaussian {i} and landmark {:?} differ",
            map.landmark[i]
        );
    }
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
        relabel(map, windows, &[], Some(free_space), &camera, &pose, &config).1
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

    /// At 1 m in front of a wall at 2 m, so many standard deviations of depth in free space: 1 m / σ.
    #[test]
    fn free_space_counts_from_the_configured_number_of_standard_deviations() {
        let free_space = FreeSpace::new(&DepthImage::new(64, 48, 2.0), 8.0);
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        let mut config = LabelConfig::default();
        config.noise.per_m = 0.0;
        config.noise.floor_m = 0.125;
        for (suspect_sigmas, pose_z_m, expected) in [
            (7.5, 0.0, Some(Label::Dynamic)),
            (8.0, 0.0, None),                   // as many, not more
            (8.0, -0.25, Some(Label::Dynamic)), // the camera's z is 0.75 m
            (8.0, 0.25, None),
            (0.5, 0.9, Some(Label::Static)), // within a standard deviation of the surface
        ] {
            config.suspect_sigmas = suspect_sigmas;
            let (mut map, mut windows) = (map(&[1.0]), vec![LabelWindow::default()]);
            let pose = Se3::new(
                garad_core::So3::identity(),
                Vector3::new(0.0, 0.0, pose_z_m),
            );
            let (free_space, of) = (Some(&free_space), (&camera, &pose));
            relabel(&mut map, &mut windows, &[], free_space, of.0, of.1, &config);
            let case = format!("{suspect_sigmas} at {pose_z_m} m");
            assert_eq!(map.label[0], expected.unwrap_or(Label::Static), "{case}");
            assert_eq!(windows[0].seen(), u32::from(expected.is_some()), "{case}");
        }
    }

    /// Two runs make a window. Per row: its label and its last run, then what it is now given.
    #[test]
    fn labels_are_counted_stored_and_remembered() {
        use Label::{Dynamic, Static};
        let config = LabelWindowConfig {
            runs: 2,
            ..LabelWindowConfig::default()
        };
        let rows = [
            (Static, Some(Dynamic), true, false),
            (Static, Some(Static), false, false),
            (Dynamic, Some(Dynamic), false, true),
            (Dynamic, Some(Static), true, false),
            (Dynamic, None, false, false),
        ];
        let (mut map, mut windows) = (map(&[2.0; 5]), vec![LabelWindow::default(); 5]);
        for (i, row) in rows.iter().enumerate() {
            map.label[i] = row.0;
            windows[i].push(row.0);
        }
        let labels = rows.map(|row| row.1);
        let (counts, expired) = push_labels(&mut map, &mut windows, &labels, &config);
        assert_eq!(expired, rows.map(|row| row.3), "dynamic in both runs");
        let expected = Relabelled {
            to_dynamic: 1,
            to_static: 1,
            removed: 1,
        };
        assert_eq!(counts, expected);
        assert_eq!(map.label, rows.map(|row| row.1.unwrap_or(row.0)), "stored");
        let seen: Vec<_> = windows.iter().map(LabelWindow::seen).collect();
        assert_eq!(seen, [2, 2, 2, 2, 1], "remembered");
    }

    #[test]
    #[should_panic(expected = "Gaussian 0 and landmark Some(LandmarkId(4)) differ")]
    fn a_tagged_gaussian_that_differs_from_its_landmark_is_noticed() {
        let mut map = map(&[2.0]);
        map.landmark[0] = Some(LandmarkId(4));
        let living = [(LandmarkId(4), Label::Dynamic)];
        assert_labels_agree(&map, &[], &living, TaggedLabels::Evidence); // not named
        assert_labels_agree(&map, &[], &living, TaggedLabels::Landmark);
    }

    /// A tagged Gaussian in free space, whose landmark is labelled, changed or not named.
    #[test]
    fn a_tagged_gaussian_takes_the_label_of_its_landmark() {
        use Label::{Dynamic, Static};
        let named = |label, changed| {
            let id = LandmarkId(4);
            vec![LandmarkLabel { id, label, changed }]
        };
        let free_space = FreeSpace::new(&DepthImage::new(64, 48, 2.0), 8.0);
        for (tagged, labelled, expected) in [
            (TaggedLabels::Evidence, named(Static, true), Static),
            (TaggedLabels::Evidence, named(Static, false), Dynamic),
            (TaggedLabels::Evidence, Vec::new(), Dynamic),
            (TaggedLabels::Landmark, named(Static, true), Static),
            (TaggedLabels::Landmark, named(Static, false), Static),
            (TaggedLabels::Landmark, named(Dynamic, false), Dynamic),
            (TaggedLabels::Landmark, Vec::new(), Static),
        ] {
            let mut map = map(&[1.0]);
            map.landmark[0] = Some(LandmarkId(4));
            let mut windows = vec![LabelWindow::default()];
            let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
            let config = LabelConfig {
                tagged,
                ..LabelConfig::default()
            };
            let (free_space, pose) = (Some(&free_space), Se3::identity());
            relabel(
                &mut map,
                &mut windows,
                &labelled,
                free_space,
                &camera,
                &pose,
                &config,
            );
            assert_eq!(map.label, [expected], "{tagged:?} {labelled:?}");
            let living = [(LandmarkId(4), labelled.first().map_or(Static, |l| l.label))];
            assert_labels_agree(&map, &labelled, &living, tagged);
        }
    }
}
