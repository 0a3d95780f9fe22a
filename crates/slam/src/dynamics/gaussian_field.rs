//! The random field over tagged Gaussians (eq. 1 to 6), where the paper has it: in the mapping thread, with the
//! Gaussian's mean as the position of its node (decision 020).
//!
//! ```text
//! LandmarkCues of the keyframe ─→ nodes: tagged Gaussians ─→ field ─→ labels ─→ neighbours' vote: the others
//! ```

use std::collections::BTreeMap;
use std::num::NonZero;
use std::ops::Range;

use garad_core::{GaussianMap, Label, LandmarkId};
use garad_crf::{Crf, Node};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Vector3;

use super::landmarks::LandmarkCues;
use crate::config::SpreadConfig;
use crate::context::Context;
use crate::trace::Recorder;

/// A Gaussian that the field labelled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LabelledGaussian {
    /// Its row in the map.
    pub(crate) row: usize,
    /// Its mean, metres.
    pub(crate) mean_m: [f64; 3],
    /// Its label.
    pub(crate) label: Label,
}

/// Labels the Gaussians whose landmarks have cues, in the order of the map.
pub(crate) fn label_tagged(
    context: &Context,
    crf: &Crf,
    map: &GaussianMap,
    cues: &[LandmarkCues],
    recorder: &mut Recorder,
) -> Vec<LabelledGaussian> {
    let of_landmark: BTreeMap<LandmarkId, &LandmarkCues> = cues.iter().map(|c| (c.id, c)).collect();
    let tagged = (0..map.len()).filter_map(|row| {
        let landmark = map.landmark[row]?;
        Some((row, landmark, *of_landmark.get(&landmark)?))
    });
    let tagged: Vec<(usize, LandmarkId, &LandmarkCues)> = tagged.collect();
    let nodes: Vec<Node> = tagged
        .iter()
        .map(|(row, _, seen)| Node {
            p_world: Vector3::from(map.means[*row].map(f64::from)),
            uv_px: Some(seen.uv_px),
            cues: seen.cues,
            previous: Some(match map.label[*row] {
                Label::Static => 0.0,
                Label::Dynamic => 1.0,
            }),
        })
        .collect();
    let beliefs = crf
        .infer(&nodes, context.par)
        .expect("means and cues of tagged Gaussians are finite");
    recorder.record("label_map", |record| {
        let ids = tagged.iter().map(|(_, landmark, _)| *landmark);
        record.landmark_field(ids, &nodes, &beliefs);
    });
    let labelled = tagged.iter().zip(&nodes).zip(beliefs.labels);
    labelled
        .map(|(((row, _, _), node), label)| LabelledGaussian {
            row: *row,
            mean_m: node.p_world.into(),
            label,
        })
        .collect()
}

/// Labels of these rows of the map by a vote of the labelled Gaussians nearest to each: of up to `neighbours` within
/// the radius r, one at distance d has weight 1 - d / r, and the label with the larger sum is taken,
/// static if both are equal. `None` where none is within the radius.
pub(crate) fn labels_by_vote(
    context: &Context,
    map: &GaussianMap,
    rows: Range<usize>,
    voters: &[LabelledGaussian],
    config: &SpreadConfig,
) -> Vec<Option<Label>> {
    let Some(neighbours) = NonZero::new(config.neighbours.min(voters.len())) else {
        return vec![None; rows.len()];
    };
    let means: Vec<[f64; 3]> = voters.iter().map(|v| v.mean_m).collect();
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&means).expect("fewer than 2^32 points");
    let vote = |row: usize| {
        let mean = map.means[row].map(f64::from);
        let nearest = tree.query(&mean);
        let nearest = nearest.nearest_n::<SquaredEuclidean<f64>>(neighbours);
        let [mut for_static, mut for_dynamic] = [0.0, 0.0];
        for voter in nearest.execute() {
            let weight = 1.0 - voter.distance.sqrt() / config.radius_m;
            match voters[voter.item as usize].label {
                _ if weight <= 0.0 => {}
                Label::Static => for_static += weight,
                Label::Dynamic => for_dynamic += weight,
            }
        }
        (for_static + for_dynamic > 0.0).then_some(match for_dynamic > for_static {
            true => Label::Dynamic,
            false => Label::Static,
        })
    };
    let (first, count) = (rows.start, rows.len());
    let of_chunk =
        |chunk: Range<usize>| -> Vec<Option<Label>> { chunk.map(|i| vote(first + i)).collect() };
    context.par.map_chunks(count, 1024, of_chunk).concat()
}

#[cfg(test)]
mod tests {
    use garad_core::{KeyframeId, NewGaussian};

    use super::*;
    use crate::config::Config;
    use crate::testing::World;

    /// The example of the book: radius 0.3 m, weights 0.8 against 0.5 + 0.1, and one that is too far.
    #[test]
    fn a_vote_by_hand() {
        use Label::{Dynamic, Static};
        let context = World::new(Config::default()).context;
        let config = SpreadConfig {
            radius_m: 0.3,
            ..SpreadConfig::default()
        };
        let mut map = GaussianMap::new(0);
        map.push(&NewGaussian {
            mean: [0.0, 0.0, 2.0],
            sigma_m: 0.02,
            opacity: 0.9,
            color: [0.5; 3],
            landmark: None,
            born: KeyframeId(0),
        });
        let voters = |of: &[(f64, Label)]| -> Vec<LabelledGaussian> {
            let voter = |&(distance_m, label)| LabelledGaussian {
                row: 0,
                mean_m: [distance_m, 0.0, 2.0],
                label,
            };
            of.iter().map(voter).collect()
        };
        let three = [(0.06, Dynamic), (0.15, Static), (0.27, Static)];
        for (of, expected) in [
            (&three[..], Some(Dynamic)),
            (&[(0.33, Dynamic), (0.15, Static)], Some(Static)),
            (&[(0.33, Dynamic)], None),
            (&[(0.15, Dynamic), (-0.15, Static)], Some(Static)),
            (&[], None),
        ] {
            let labels = labels_by_vote(&context, &map, 0..1, &voters(of), &config);
            assert_eq!(labels, [expected], "{of:?}");
        }
    }
}
