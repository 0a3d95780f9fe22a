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
        .map(|(row, _, seen)| {
            let mean_m = Vector3::from(map.means[*row].map(f64::from));
            seen.node(mean_m, map.label[*row])
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
    use Label::{Dynamic, Static};
    use garad_core::{Camera, KeyframeId, NewGaussian, Par, Real, Rng};
    use garad_crf::Cues;
    use nalgebra::Vector2;

    use super::*;
    use crate::config::Config;

    fn context(config: Config, par: Par) -> Context {
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        Context::new(camera, config, 0, par).expect("valid")
    }

    fn map(means: &[[f32; 3]], tags: &[Option<u32>]) -> GaussianMap {
        let mut map = GaussianMap::new(0);
        for (mean, tag) in means.iter().zip(tags) {
            map.push(&NewGaussian {
                mean: *mean,
                sigma_m: 0.02,
                opacity: 0.9,
                color: [0.5; 3],
                landmark: tag.map(LandmarkId),
                born: KeyframeId(0),
            });
        }
        map
    }

    /// All landmarks are seen at one pixel: only the positions tell nodes apart.
    fn cues(id: u32, depth_residual: Option<f64>) -> LandmarkCues {
        LandmarkCues {
            id: LandmarkId(id),
            uv_px: Vector2::new(31.5, 23.5),
            cues: Cues {
                depth_residual,
                ..Cues::default()
            },
        }
    }

    fn labelled(map: &GaussianMap, cues: &[LandmarkCues], par: Par) -> Vec<LabelledGaussian> {
        let config = Config::default();
        let crf = Crf::new(config.crf.clone()).expect("valid");
        let context = context(config, par);
        label_tagged(&context, &crf, map, cues, &mut Recorder::default())
    }

    /// Landmark 0 is 30 sigma in front of what was seen there, 1 is on it. 2 and 3 have no evidence of their own and
    /// follow the nearer of the two; 4 has no cues, and one Gaussian has no landmark.
    #[test]
    fn a_node_is_at_the_mean_of_its_gaussian_and_has_the_cues_of_its_landmark() {
        let means = [
            [3.0, 0.0, 2.0],
            [0.05, 0.0, 2.0],
            [0.0, 0.0, 2.0],
            [3.05, 0.0, 2.0],
            [0.0, 0.05, 2.0],
            [3.0, 0.05, 2.0],
        ];
        let map = map(&means, &[Some(1), Some(2), Some(0), Some(3), Some(4), None]);
        let cues = [
            cues(0, Some(30.0)),
            cues(1, Some(0.0)),
            cues(2, None),
            cues(3, None),
        ];
        let found = labelled(&map, &cues, Par::Seq);
        let rows: Vec<_> = found.iter().map(|g| (g.row, g.label)).collect();
        let expected = [(0, Static), (1, Dynamic), (2, Dynamic), (3, Static)];
        assert_eq!(rows, expected, "rows of the map, in its order");
        for gaussian in &found {
            let mean = means[gaussian.row].map(f64::from).map(f64::to_bits);
            let found = gaussian.mean_m.map(f64::to_bits);
            assert_eq!(found, mean, "row {}", gaussian.row);
        }
        assert_eq!(labelled(&map, &[], Par::Seq), [], "no cues, no node");
    }

    /// With too few observations the label stays what it was: that of the Gaussian.
    #[test]
    fn a_thin_node_keeps_the_label_of_its_gaussian() {
        let mut map = map(&[[0.0, 0.0, 2.0], [3.0, 0.0, 2.0]], &[Some(0), Some(1)]);
        map.label[1] = Dynamic;
        let thin = [0, 1].map(|id| {
            let mut cues = cues(id, None);
            cues.cues.observations = Some(1);
            cues
        });
        let labels: Vec<_> = (labelled(&map, &thin, Par::Seq).iter())
            .map(|g| g.label)
            .collect();
        assert_eq!(labels, [Static, Dynamic]);
    }

    /// The vote on a Gaussian at the origin by voters at these places of the x axis.
    fn vote(voters: &[(f64, Label)], neighbours: usize) -> Option<Label> {
        let map = map(&[[9.0; 3], [0.0; 3]], &[None, None]);
        let voters: Vec<LabelledGaussian> = (voters.iter().enumerate())
            .map(|(row, (x, label))| LabelledGaussian {
                row,
                mean_m: [*x, 0.0, 0.0],
                label: *label,
            })
            .collect();
        let config = SpreadConfig {
            neighbours,
            radius_m: 0.2,
            ..SpreadConfig::default()
        };
        let context = context(Config::default(), Par::Seq);
        let labels = labels_by_vote(&context, &map, 1..2, &voters, &config);
        assert_eq!(labels.len(), 1, "one row");
        labels[0]
    }

    #[test]
    fn a_vote_weighs_one_less_the_distance_over_the_radius() {
        let far = [(0.15, Static), (-0.15, Static), (0.02, Dynamic)];
        assert_eq!(vote(&far, 5), Some(Dynamic), "0.25 + 0.25 against 0.9");
        let near = [(0.05, Static), (-0.05, Static), (0.02, Dynamic)];
        assert_eq!(vote(&near, 5), Some(Static), "0.75 + 0.75 against 0.9");
        let one = [(0.05, Static), (0.02, Dynamic)];
        assert_eq!(vote(&one, 5), Some(Dynamic), "0.75 against 0.9");
    }

    #[test]
    fn a_tie_is_static() {
        let tie = [(0.1, Dynamic), (-0.1, Static)];
        assert_eq!(vote(&tie, 5), Some(Static), "0.5 against 0.5");
    }

    #[test]
    fn nobody_votes_beyond_the_radius() {
        assert_eq!(vote(&[], 5), None, "nobody");
        assert_eq!(vote(&[(0.2001, Dynamic)], 5), None, "beyond it");
        assert_eq!(vote(&[(0.1999, Dynamic)], 5), Some(Dynamic), "within it");
        // Without a lower bound of 0 the two far ones would weigh -1.5 each.
        let far = [(0.5, Static), (-0.5, Static), (0.1, Static)];
        assert_eq!(vote(&far, 5), Some(Static), "0.5, and nothing of the far");
        let far = [(0.5, Static), (-0.5, Static), (0.1, Dynamic)];
        assert_eq!(vote(&far, 5), Some(Dynamic), "0.5, and nothing of the far");
    }

    #[test]
    fn as_many_vote_as_are_set_the_nearest_first() {
        let voters = [(0.05, Static), (-0.06, Static), (0.02, Dynamic)];
        let labels = [1, 2, 3].map(|neighbours| vote(&voters, neighbours));
        let expected = [Some(Dynamic), Some(Dynamic), Some(Static)];
        assert_eq!(labels, expected, "0.9; 0.75 against it; 0.75 + 0.7");
        assert_eq!(vote(&voters, 0), None, "none may");
    }

    /// A flat wall has many means with one coordinate in common.
    #[test]
    fn a_plane_of_voters_can_vote() {
        let voters = [(0.1, Dynamic); 200];
        assert_eq!(vote(&voters, 5), Some(Dynamic), "all at one place");
    }

    #[test]
    fn any_number_of_threads_gives_the_same_labels() {
        let mut rng = Rng::new(3);
        let means: Vec<_> = (0..3000)
            .map(|_| [0; 3].map(|_| rng.range(0.0, 2.0).to_f32()))
            .collect();
        let tags: Vec<_> = (0..3000u32).map(|i| (i % 6 == 0).then_some(i)).collect();
        let map = map(&means, &tags);
        let cues: Vec<_> = (0..500)
            .map(|i| cues(6 * i, Some(rng.range(0.0, 6.0))))
            .collect();
        let run = |par| {
            let voters = labelled(&map, &cues, par);
            let context = context(Config::default(), par);
            let config = SpreadConfig::default();
            let votes = labels_by_vote(&context, &map, 0..map.len(), &voters, &config);
            (voters, votes)
        };
        let one = run(Par::Seq);
        for label in [Some(Static), Some(Dynamic), None] {
            let n = one.1.iter().filter(|l| **l == label).count();
            assert!(n > 20, "{label:?}: {n}");
        }
        assert!(run(Par::Threads(3)) == one, "3 threads and 1");
    }
}
