//! Matching by Hamming distance: nearest neighbours, the ratio and mutual tests, and the rotation
//! check.

use garad_core::Par;

use crate::descriptor::Descriptor;
use crate::error::FeatureError;

/// A query descriptor and the train descriptor it was matched to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Match {
    /// Index into the query list.
    pub query: usize,
    /// Index into the train list.
    pub train: usize,
    /// Bits that differ.
    pub distance: u32,
}

/// Which nearest neighbours are accepted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchConfig {
    /// Largest distance, bits. ORB-SLAM uses 50 (sure) and 100 (likely).
    pub max_distance: u32,
    /// The best must be below this times the second best; `None` for no such test.
    pub ratio: Option<f32>,
    /// The query must also be the nearest of the train descriptor.
    pub mutual: bool,
}

impl Default for MatchConfig {
    fn default() -> Self {
        Self {
            max_distance: 50,
            ratio: Some(0.9),
            mutual: true,
        }
    }
}

/// The nearest and second nearest train descriptor of one query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nearest {
    /// Index of the nearest; the lowest index among equals.
    pub train: usize,
    /// Its distance.
    pub distance: u32,
    /// Distance of the runner-up, equal to `distance` on a tie; more than 256 if there is none.
    pub second: u32,
}

/// Distance of a neighbour that does not exist, above any real one.
pub const NO_NEIGHBOUR: u32 = Descriptor::BITS + 1;

/// Queries handled as one piece of work.
const CHUNK: usize = 64;

/// The two nearest train descriptors of every query, by comparing with all of them.
///
/// `None` for every query if `train` is empty. O(N M); the same bits for every `par`.
/// Golden: `matching/*`.
#[must_use]
pub fn nearest(query: &[Descriptor], train: &[Descriptor], par: Par) -> Vec<Option<Nearest>> {
    let one = |q: &Descriptor| {
        let mut found: Option<Nearest> = None;
        for (i, t) in train.iter().enumerate() {
            let distance = q.distance(t);
            found = match found {
                Some(best) if distance >= best.distance => Some(Nearest {
                    second: best.second.min(distance),
                    ..best
                }),
                best => Some(Nearest {
                    train: i,
                    distance,
                    second: best.map_or(NO_NEIGHBOUR, |b| b.distance),
                }),
            };
        }
        found
    };
    let chunks = par.map_chunks(query.len(), CHUNK, |range| {
        query[range].iter().map(one).collect::<Vec<_>>()
    });
    chunks.concat()
}

/// Matches in the order of the queries, each query at most once.
///
/// A query keeps its nearest train descriptor (the lowest index among equals) if the distance is
/// at most `max_distance`, below `ratio` times the second distance, and, with `mutual`, if the
/// query is in turn the nearest (lowest index among equals) of that train descriptor.
#[must_use]
pub fn match_descriptors(
    query: &[Descriptor],
    train: &[Descriptor],
    config: &MatchConfig,
    par: Par,
) -> Vec<Match> {
    let forward = nearest(query, train, par);
    let backward = if config.mutual {
        nearest(train, query, par)
    } else {
        Vec::new()
    };
    let accepted = |q: usize, n: &Nearest| {
        let near = n.distance <= config.max_distance;
        let distinct = config
            .ratio
            .is_none_or(|ratio| (n.distance as f32) < ratio * n.second as f32);
        let returned = !config.mutual || backward[n.train].is_some_and(|back| back.train == q);
        near && distinct && returned
    };
    let matches = forward.iter().enumerate();
    matches
        .filter_map(|(q, n)| n.filter(|n| accepted(q, n)).map(|n| (q, n)))
        .map(|(query, n)| Match {
            query,
            train: n.train,
            distance: n.distance,
        })
        .collect()
}

/// How angle differences are sorted into bins for the rotation check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RotationBins {
    /// 30 bins of 12°: the whole circle.
    #[default]
    FullCircle,
    /// ORB-SLAM's bins, round(degrees / 30): a bin spans 30° and 17 of the 30 stay empty. Kept for
    /// comparison with it.
    OrbSlam,
}

/// Bins of the rotation histogram.
const BINS: usize = 30;
/// The second and third bin count only with at least this share of the first.
const MINOR_BIN_SHARE: f32 = 0.1;

/// Keeps the matches whose change of angle falls into one of the three fullest bins.
///
/// When the camera rolls, all keypoints turn by the same angle; a match that turns otherwise is
/// wrong. Of equally full bins the first counts. The second and third bin are dropped when they
/// hold less than a tenth of the first (ORB-SLAM's rule). Order is kept.
///
/// # Errors
/// [`FeatureError::SizeMismatch`] for a match that points past the end of an angle list.
pub fn consistent_rotation(
    matches: &[Match],
    query_angle_deg: &[f32],
    train_angle_deg: &[f32],
    bins: RotationBins,
) -> Result<Vec<Match>, FeatureError> {
    let bin_of = |m: &Match| -> Result<usize, FeatureError> {
        match (query_angle_deg.get(m.query), train_angle_deg.get(m.train)) {
            (Some(q), Some(t)) => Ok(rotation_bin(q - t, bins)),
            _ => Err(FeatureError::SizeMismatch {
                what: "indices of a match and lengths of the angle lists",
                left: (m.query, m.train),
                right: (query_angle_deg.len(), train_angle_deg.len()),
            }),
        }
    };
    let bin_of_match = matches.iter().map(bin_of).collect::<Result<Vec<_>, _>>()?;
    let mut count = [0usize; BINS];
    for &bin in &bin_of_match {
        count[bin] += 1;
    }
    let mut fullest: Vec<usize> = (0..BINS).collect();
    fullest.sort_by_key(|&bin| std::cmp::Reverse(count[bin])); // stable: the first of equals leads
    let enough = MINOR_BIN_SHARE * count[fullest[0]] as f32;
    let kept: Vec<usize> = fullest[..3]
        .iter()
        .copied()
        .filter(|&bin| count[bin] as f32 >= enough)
        .collect();
    let pairs = matches.iter().zip(&bin_of_match);
    Ok(pairs
        .filter(|(_, bin)| kept.contains(bin))
        .map(|(m, _)| *m)
        .collect())
}

/// Bin of an angle difference in degrees; NaN goes to bin 0.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "an angle in [0, 360) over the width of a bin"
)]
fn rotation_bin(difference_deg: f32, bins: RotationBins) -> usize {
    let turn = if difference_deg < 0.0 {
        difference_deg + 360.0
    } else {
        difference_deg
    };
    match bins {
        RotationBins::FullCircle => (turn * (BINS as f32 / 360.0)) as usize % BINS,
        RotationBins::OrbSlam => (turn * (1.0 / BINS as f32)).round() as usize % BINS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;
    use proptest::prelude::*;

    /// A descriptor with the lowest `n` bits set.
    fn bits(n: u32) -> Descriptor {
        let word = |w: u32| match n.saturating_sub(64 * w) {
            0 => 0,
            k if k >= 64 => u64::MAX,
            k => (1 << k) - 1,
        };
        Descriptor([word(0), word(1), word(2), word(3)])
    }

    fn random(n: usize, seed: u64) -> Vec<Descriptor> {
        let mut rng = Rng::new(seed);
        // Few distinct bits, so that ties happen.
        let mut word = || rng.next_u64() & 0x0101_0101;
        (0..n).map(|_| Descriptor([word(), word(), 0, 0])).collect()
    }

    const LOOSE: MatchConfig = MatchConfig {
        max_distance: 256,
        ratio: None,
        mutual: false,
    };

    #[test]
    fn ties_go_to_the_lowest_index_and_count_as_second() {
        let found = nearest(
            &[bits(10)],
            &[bits(14), bits(12), bits(8), bits(12)],
            Par::Seq,
        );
        let expected = Nearest {
            train: 1,
            distance: 2,
            second: 2,
        };
        assert_eq!(found, [Some(expected)], "three at distance 2 or more");
        let alone = nearest(&[bits(10)], &[bits(14)], Par::Seq);
        let expected = Nearest {
            train: 0,
            distance: 4,
            second: NO_NEIGHBOUR,
        };
        assert_eq!(alone, [Some(expected)], "no runner-up");
        assert_eq!(
            nearest(&[bits(10)], &[], Par::Seq),
            [None],
            "nothing to match"
        );
    }

    #[test]
    fn each_gate_on_both_sides() {
        let (query, train) = ([bits(0)], [bits(9), bits(10)]);
        let count =
            |config: MatchConfig| match_descriptors(&query, &train, &config, Par::Seq).len();
        assert_eq!(
            count(MatchConfig {
                max_distance: 9,
                ..LOOSE
            }),
            1,
            "at the limit"
        );
        assert_eq!(
            count(MatchConfig {
                max_distance: 8,
                ..LOOSE
            }),
            0,
            "above the limit"
        );
        // 9 < 0.91 * 10 but not below 0.9 * 10
        assert_eq!(
            count(MatchConfig {
                ratio: Some(0.91),
                ..LOOSE
            }),
            1,
            "distinct"
        );
        assert_eq!(
            count(MatchConfig {
                ratio: Some(0.9),
                ..LOOSE
            }),
            0,
            "ambiguous"
        );
        // Both queries want the train descriptor; it wants the nearer one.
        let mutual = MatchConfig {
            mutual: true,
            ..LOOSE
        };
        let kept = match_descriptors(&[bits(3), bits(1)], &[bits(0)], &mutual, Par::Seq);
        assert_eq!(
            kept,
            [Match {
                query: 1,
                train: 0,
                distance: 1
            }],
            "mutual"
        );
    }

    #[test]
    fn rotation_keeps_the_majority() {
        // Ten matches turn by 100°, two by 200°, one by 300°: 1 is not below a tenth of 10.
        let turns: Vec<f32> = [vec![100.0; 10], vec![200.0; 2], vec![300.0], vec![0.0]].concat();
        let matches: Vec<Match> = (0..turns.len())
            .map(|i| Match {
                query: i,
                train: i,
                distance: 0,
            })
            .collect();
        let zeros = vec![0.0; turns.len()];
        for bins in [RotationBins::FullCircle, RotationBins::OrbSlam] {
            let kept = consistent_rotation(&matches, &turns, &zeros, bins).expect("in range");
            let queries: Vec<usize> = kept.iter().map(|m| m.query).collect();
            // 0° and 300° tie for the third place; the lower bin, 0°, wins.
            let expected: Vec<usize> = (0..12).chain([13]).collect();
            assert_eq!(queries, expected, "{bins:?}");
        }
        let many = [vec![100.0; 11], vec![200.0]].concat();
        let kept = consistent_rotation(&matches[..12], &many, &zeros, RotationBins::FullCircle);
        assert_eq!(
            kept.expect("in range").len(),
            11,
            "1 is below a tenth of 11"
        );
        let past = Match {
            query: 99,
            train: 0,
            distance: 0,
        };
        let error = consistent_rotation(&[past], &turns, &zeros, RotationBins::FullCircle);
        assert!(
            matches!(error, Err(FeatureError::SizeMismatch { left: (99, 0), .. })),
            "{error:?}"
        );
    }

    #[test]
    fn bins_cover_the_circle() {
        let bin = |deg| rotation_bin(deg, RotationBins::FullCircle);
        assert_eq!(
            [bin(0.0), bin(11.9), bin(12.1), bin(359.0), bin(-1.0)],
            [0, 0, 1, 29, 29]
        );
        assert_eq!(
            [bin(360.0), bin(f32::NAN), bin(1e30)].map(|b| b < BINS),
            [true; 3]
        );
        let orb_slam: Vec<usize> = (0..36)
            .map(|i: u8| rotation_bin(f32::from(i) * 10.0, RotationBins::OrbSlam))
            .collect();
        assert_eq!(
            orb_slam.iter().max(),
            Some(&12),
            "only 13 of 30 bins are ever used"
        );
    }

    proptest! {
        #[test]
        fn nearest_is_the_minimum(n in 1usize..40, m in 1usize..40, seed: u64) {
            let (query, train) = (random(n, seed), random(m, seed ^ 1));
            let found = nearest(&query, &train, Par::Seq);
            prop_assert_eq!(&nearest(&query, &train, Par::Threads(2)), &found);
            for (q, found) in query.iter().zip(found) {
                let mut all: Vec<(u32, usize)> =
                    train.iter().enumerate().map(|(i, t)| (q.distance(t), i)).collect();
                all.sort_unstable();
                let found = found.expect("train is not empty");
                prop_assert_eq!((found.distance, found.train), all[0]);
                prop_assert_eq!(found.second, all.get(1).map_or(NO_NEIGHBOUR, |s| s.0));
            }
        }

        #[test]
        fn mutual_matches_are_symmetric(n in 1usize..40, m in 1usize..40, seed: u64) {
            let (a, b) = (random(n, seed), random(m, seed ^ 1));
            let mutual = MatchConfig { mutual: true, ..LOOSE };
            let forth = match_descriptors(&a, &b, &mutual, Par::Seq);
            let mut back = match_descriptors(&b, &a, &mutual, Par::Seq);
            back.sort_by_key(|m| m.train);
            let turned: Vec<Match> = back.iter()
                .map(|m| Match { query: m.train, train: m.query, distance: m.distance })
                .collect();
            prop_assert_eq!(forth, turned);
        }
    }

    /// round(degrees / 30) at both sides of each half.
    #[test]
    fn bins_of_orb_slam_by_hand() {
        for (deg, expected) in [
            (0.0, 0),
            (14.9, 0),
            (15.1, 1),
            (44.9, 1),
            (45.1, 2),
            (104.9, 3),
            (105.1, 4),
            (344.9, 11),
            (345.1, 12),
            (-14.9, 12),
            (-15.1, 11),
            (-180.1, 6),
        ] {
            assert_eq!(rotation_bin(deg, RotationBins::OrbSlam), expected, "{deg}");
        }
        for (deg, expected) in [
            (-12.1, 28),
            (-11.9, 29),
            (179.9, 14),
            (180.1, 15),
            (347.9, 28),
        ] {
            assert_eq!(
                rotation_bin(deg, RotationBins::FullCircle),
                expected,
                "{deg}"
            );
        }
    }
}
