//! Sums of the position kernel, 16 x 16 pairs at a time.
//!
//! Two groups of nodes whose bounding boxes are so far apart that every kernel value between them
//! is below `tail` are left out; |A| times the largest value possible is what each node of B may
//! have lost, and these losses are added up: `left_out`. All other pairs of groups are computed in
//! full. A block serves both directions, k(i, j) = k(j, i).
//!
//! The kernel does not change from one iteration to the next, so blocks are kept as long as memory
//! allows and computed anew beyond that; the bits are the same.

use std::array::from_fn;

use garad_core::Par;
use wide::f64x4;

use crate::config::KernelConfig;
use crate::cues::Node;
use crate::fast::exp::exp_nonpositive;
use crate::fast::tree::{DIMENSIONS, GROUP, Group, Metric, groups};
use crate::readings::Distance;

/// Vectors per row of a block.
const VECTORS: usize = GROUP / 4;
/// One number per node of a group.
type Row = [f64x4; VECTORS];
/// Kernel values; a row per node of the first group.
type Block = [Row; GROUP];

/// Blocks kept in memory, 2 KiB each: 512 MiB. 5 000 nodes need at most 49 141.
const MAX_KEPT: usize = 262_144;
/// Pieces into which the pairs of groups are cut, whatever the number of threads.
const PIECES: usize = 48;
/// Exponents below this give 0, see [`exp_nonpositive`].
const UNDERFLOW: f64 = -708.0;

/// The position kernel between all pairs that matter.
pub(crate) struct PositionSums {
    n: usize,
    metric: Metric,
    self_message: bool,
    groups: Vec<Group>,
    /// Pairs (a, b), a ≤ b, of groups that are near each other.
    near: Vec<(usize, usize)>,
    /// The blocks of the first of them, piece by piece.
    kept: Vec<Vec<Block>>,
    /// Per node.
    left_out: Vec<f64>,
}

impl PositionSums {
    pub(crate) fn new(
        nodes: &[Node],
        config: &KernelConfig,
        self_message: bool,
        tail: f64,
        par: Par,
    ) -> Self {
        let metric = Metric::new(config);
        let groups = groups(nodes, config.terms, &metric);
        let smallest = libm::log(tail).max(UNDERFLOW);
        let mut near = Vec::new();
        let mut lost = vec![0.0; groups.len()];
        for a in 0..groups.len() {
            for b in a..groups.len() {
                let exponent = groups[a].largest_exponent(&groups[b], &metric);
                if exponent >= smallest {
                    near.push((a, b));
                } else {
                    let largest = libm::exp(exponent);
                    lost[a] += largest * groups[b].members.len() as f64;
                    lost[b] += largest * groups[a].members.len() as f64;
                }
            }
        }
        let mut left_out = vec![0.0; nodes.len()];
        for (group, lost) in groups.iter().zip(lost) {
            for &member in &group.members {
                left_out[member] = lost;
            }
        }
        let mut sums = Self {
            n: nodes.len(),
            metric,
            self_message,
            groups,
            near,
            kept: Vec::new(),
            left_out,
        };
        let limit = sums.near.len().min(MAX_KEPT);
        sums.kept = par.map_chunks(sums.near.len(), sums.piece(), |range| {
            let kept = range.start..range.end.min(limit);
            let mut blocks = Vec::with_capacity(kept.len());
            blocks.extend(kept.map(|pair| sums.block(pair)));
            blocks
        });
        sums
    }

    /// Pairs of groups per piece.
    fn piece(&self) -> usize {
        self.near.len().div_ceil(PIECES).max(1)
    }

    /// Bound on what is missing from each node's sum.
    pub(crate) fn left_out(&self) -> &[f64] {
        &self.left_out
    }

    /// The kernel between the groups of a pair.
    fn block(&self, pair: usize) -> Block {
        let (a, b) = self.near[pair];
        let (first, second) = (&self.groups[a], &self.groups[b]);
        let columns: [Row; DIMENSIONS] = from_fn(|d| row_of(&second.coordinates[d]));
        let with_pixel = first.has_pixel && second.has_pixel;
        let mut block: Block = from_fn(|i| {
            let own: [f64x4; DIMENSIONS] = from_fn(|d| f64x4::splat(first.coordinates[d][i]));
            from_fn(|c| {
                let squared = |d: usize| {
                    let delta = own[d] - columns[d][c];
                    delta * delta
                };
                let mut space = squared(0) + squared(1) + squared(2);
                let mut pixel = f64x4::ZERO;
                if with_pixel {
                    pixel = squared(3) + squared(4);
                }
                if self.metric.distance == Distance::Linear {
                    (space, pixel) = (space.sqrt(), pixel.sqrt());
                }
                let per_space = f64x4::splat(self.metric.per_space);
                let per_pixel = f64x4::splat(self.metric.per_pixel);
                exp_nonpositive(-(space * per_space) - pixel * per_pixel)
            })
        });
        if a == b && !self.self_message {
            for i in 0..GROUP {
                let mut lanes = block[i][i / 4].to_array();
                lanes[i % 4] = 0.0;
                block[i][i / 4] = f64x4::new(lanes);
            }
        }
        block
    }

    /// Σⱼ k(i, j) sⱼ for each node i.
    pub(crate) fn sums(&self, s: &[f64], par: Par) -> Vec<f64> {
        // Empty places of a group have weight 0.
        let s: Vec<[f64; GROUP]> = self
            .groups
            .iter()
            .map(|g| from_fn(|lane| g.members.get(lane).map_or(0.0, |&i| s[i])))
            .collect();
        let piece = self.piece();
        let pieces = par.map_chunks(self.near.len(), piece, |range| {
            let kept = &self.kept[range.start / piece];
            let mut sums = vec![[f64x4::ZERO; VECTORS]; self.groups.len()];
            for pair in range.clone() {
                let (a, b) = self.near[pair];
                let computed;
                let block = match kept.get(pair - range.start) {
                    Some(block) => block,
                    None => {
                        computed = self.block(pair);
                        &computed
                    }
                };
                if a == b {
                    let by_row = accumulate::<false>(block, &s[a], &s[a], &mut sums[a]);
                    add(&mut sums[a], &by_row);
                } else {
                    let by_row = accumulate::<true>(block, &s[a], &s[b], &mut sums[b]);
                    add(&mut sums[a], &by_row);
                }
            }
            sums
        });
        let mut total = vec![[f64x4::ZERO; VECTORS]; self.groups.len()];
        for piece in &pieces {
            for (sum, part) in total.iter_mut().zip(piece) {
                add(sum, part);
            }
        }
        let mut answer = vec![0.0; self.n];
        for (group, sum) in self.groups.iter().zip(&total) {
            for (lane, &member) in group.members.iter().enumerate() {
                answer[member] = sum[lane / 4].as_array()[lane % 4];
            }
        }
        answer
    }
}

fn row_of(values: &[f64; GROUP]) -> Row {
    from_fn(|c| f64x4::new(from_fn(|lane| values[4 * c + lane])))
}

fn add(sum: &mut Row, part: &Row) {
    for c in 0..VECTORS {
        sum[c] += part[c];
    }
}

/// Block times the values of the second group, returned; with `BOTH`, also the transposed block times
/// the values of the first group, added to `columns`. Four rows at a time, so that a column's sum is
/// touched once for four of them.
#[inline(always)]
fn accumulate<const BOTH: bool>(
    block: &Block,
    first: &[f64; GROUP],
    second: &[f64; GROUP],
    columns: &mut Row,
) -> Row {
    let second = row_of(second);
    let mut rows = [f64x4::ZERO; VECTORS];
    for quad in 0..VECTORS {
        let [k0, k1, k2, k3] = [0, 1, 2, 3].map(|r| &block[4 * quad + r]);
        let s = [0, 1, 2, 3].map(|r| f64x4::splat(first[4 * quad + r]));
        let mut sums = [f64x4::ZERO; 4];
        for c in 0..VECTORS {
            sums[0] += k0[c] * second[c];
            sums[1] += k1[c] * second[c];
            sums[2] += k2[c] * second[c];
            sums[3] += k3[c] * second[c];
            if BOTH {
                columns[c] += (k0[c] * s[0] + k1[c] * s[1]) + (k2[c] * s[2] + k3[c] * s[3]);
            }
        }
        rows[quad] = f64x4::new(sums.map(|sum| {
            let [l0, l1, l2, l3] = sum.to_array();
            (l0 + l1) + (l2 + l3)
        }));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel;
    use crate::readings::PositionTerms;
    use nalgebra::Vector3;

    #[test]
    fn both_sides_of_a_pair_know_what_was_left_out() {
        // Sixteen nodes here, a few millimetres apart, and sixteen a few widths away: a group each.
        let config = KernelConfig {
            terms: PositionTerms::Space,
            ..KernelConfig::default()
        };
        let nodes: Vec<Node> = (0..2 * GROUP)
            .map(|i| Node {
                p_world: Vector3::new(
                    1e-3 * (i % GROUP) as f64 + if i < GROUP { 0.0 } else { 6.0 * config.sigma_m },
                    0.0,
                    0.0,
                ),
                ..Node::default()
            })
            .collect();
        let all_of = |tail: f64| PositionSums::new(&nodes, &config, false, tail, Par::Seq);
        assert!(
            all_of(1e-300).left_out().iter().all(|lost| *lost <= 0.0),
            "nothing is left out"
        );
        let fast = all_of(1e-3);
        for (i, lost) in fast.left_out().iter().enumerate() {
            let other = if i < GROUP {
                GROUP..2 * GROUP
            } else {
                0..GROUP
            };
            let truth: f64 = other
                .map(|j| kernel::position(&nodes[i], &nodes[j], &config))
                .sum();
            assert!(truth > 0.0, "far, not infinitely far");
            assert!(*lost >= truth, "node {i}: {lost} of {truth}");
        }
    }
}
