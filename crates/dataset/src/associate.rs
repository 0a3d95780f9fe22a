//! Pairs of colour and depth images by time.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Pairs two ascending lists of times one to one, closest pairs first.
///
/// Greedy: of all pairs not more than `max_dt_s` apart the closest is taken (ties: the earlier
/// `a`), both times are removed, and so on. This is what the TUM benchmark's `associate.py`
/// computes; it excludes |dt| = `max_dt_s`, which is included here. Returned are index pairs, ascending
/// in `a`.
///
/// The closest remaining pair always consists of neighbours in the merged list, since a time between
/// two others would be closer to one of them. So a heap holds pairs of neighbours, and when a pair is
/// removed, the times beside it become neighbours: O(n log n), however many times lie in the window.
///
/// # Shapes and units
/// `a`, `b` seconds, strictly ascending.
///
/// # Example
/// ```
/// // 0.03 is closest to 0.04, so 0.00 has to take -0.02.
/// let pairs = garad_dataset::associate(&[0.0, 0.03], &[-0.02, 0.04], 0.021);
/// assert_eq!(pairs, [(0, 0), (1, 1)]);
/// ```
#[must_use]
pub fn associate(a: &[f64], b: &[f64], max_dt_s: f64) -> Vec<(usize, usize)> {
    let mut merged = Merged::new(a, b);
    let mut heap = BinaryHeap::new();
    for left in 0..merged.nodes.len() {
        heap.extend(merged.pair(left, max_dt_s).map(Reverse));
    }
    let mut pairs = Vec::new();
    while let Some(Reverse(closest)) = heap.pop() {
        let (left, right) = (closest.left, closest.right);
        if merged.gone[left] || merged.gone[right] {
            continue;
        }
        pairs.push((closest.a, closest.b));
        if let Some(bridge) = merged.remove(left, right) {
            heap.extend(merged.pair(bridge, max_dt_s).map(Reverse));
        }
    }
    pairs.sort_unstable();
    pairs
}

/// Both lists in one, ascending in time, doubly linked so that pairs can be removed.
struct Merged {
    nodes: Vec<Node>,
    next: Vec<usize>,
    previous: Vec<usize>,
    gone: Vec<bool>,
}

#[derive(Clone, Copy)]
struct Node {
    t_s: f64,
    index: usize,
    is_a: bool,
}

const END: usize = usize::MAX;

/// Two neighbours of different lists, ordered by distance, then by index.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    dt_bits: u64, // of a non-negative number: ordered as the number
    a: usize,
    b: usize,
    left: usize,
    right: usize,
}

impl Merged {
    fn new(a: &[f64], b: &[f64]) -> Self {
        let node = |is_a| move |(index, &t_s): (usize, &f64)| Node { t_s, index, is_a };
        let mut nodes: Vec<Node> = a.iter().enumerate().map(node(true)).collect();
        nodes.extend(b.iter().enumerate().map(node(false)));
        nodes.sort_by(|x, y| x.t_s.total_cmp(&y.t_s));
        let n = nodes.len();
        Self {
            next: (1..=n).map(|i| if i < n { i } else { END }).collect(),
            previous: (0..n).map(|i| i.checked_sub(1).unwrap_or(END)).collect(),
            gone: vec![false; n],
            nodes,
        }
    }

    /// The node with its right neighbour, if they can be a pair.
    fn pair(&self, left: usize, max_dt_s: f64) -> Option<Pair> {
        let right = self.next[left];
        if right == END {
            return None;
        }
        let (l, r) = (self.nodes[left], self.nodes[right]);
        let dt_s = (r.t_s - l.t_s).abs();
        (l.is_a != r.is_a && dt_s <= max_dt_s).then(|| {
            let (a, b) = if l.is_a { (l, r) } else { (r, l) };
            Pair {
                dt_bits: dt_s.to_bits(),
                a: a.index,
                b: b.index,
                left,
                right,
            }
        })
    }

    /// Removes two neighbours; returns the node on their left, if it has a new neighbour.
    fn remove(&mut self, left: usize, right: usize) -> Option<usize> {
        self.gone[left] = true;
        self.gone[right] = true;
        let (before, after) = (self.previous[left], self.next[right]);
        if before != END {
            self.next[before] = after;
        }
        if after != END {
            self.previous[after] = before;
        }
        (before != END).then_some(before)
    }
}

/// The smallest difference between a time of `a` and one of `b`; infinite if one is empty.
pub(crate) fn closest_s(a: &[f64], b: &[f64]) -> f64 {
    a.iter().fold(f64::INFINITY, |closest, &t| {
        let after = b.partition_point(|&u| u < t);
        let near = b[after.saturating_sub(1)..].iter().take(2);
        near.fold(closest, |closest, &u| closest.min((u - t).abs()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The rule as stated: all pairs in the window, sorted, taken while both are free.
    fn spec(a: &[f64], b: &[f64], max_dt_s: f64) -> Vec<(usize, usize)> {
        let mut all = Vec::new();
        for (i, t) in a.iter().enumerate() {
            for (j, u) in b.iter().enumerate() {
                if (t - u).abs() <= max_dt_s {
                    all.push(((t - u).abs(), i, j));
                }
            }
        }
        all.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        let (mut free_a, mut free_b) = (vec![true; a.len()], vec![true; b.len()]);
        let mut pairs = Vec::new();
        for (_, i, j) in all {
            if free_a[i] && free_b[j] {
                free_a[i] = false;
                free_b[j] = false;
                pairs.push((i, j));
            }
        }
        pairs.sort_unstable();
        pairs
    }

    #[test]
    fn window_is_inclusive_and_pairs_are_one_to_one() {
        assert_eq!(associate(&[1.0], &[1.5], 0.5), [(0, 0)], "at the window");
        assert_eq!(associate(&[1.0], &[1.5], 0.499), [], "beyond it");
        assert_eq!(
            associate(&[1.0, 1.25], &[1.25], 0.5),
            [(1, 0)],
            "two colour images for one depth image: the closer one has it"
        );
        assert_eq!(associate(&[1.0], &[1.0], 0.0), [(0, 0)], "equal times");
        assert_eq!(associate(&[], &[1.0], 1.0), [], "nothing to pair");
        assert_eq!(associate(&[1.0], &[1.0], f64::NAN), [], "NaN is no window");
    }

    #[test]
    fn closest_difference() {
        let bits = |a: &[f64], b: &[f64]| closest_s(a, b).to_bits();
        assert_eq!(
            bits(&[1.0, 5.0], &[0.0, 5.25, 9.0]),
            0.25f64.to_bits(),
            "amid"
        );
        assert_eq!(bits(&[10.0], &[1.0, 2.0]), 8.0f64.to_bits(), "all earlier");
        assert_eq!(bits(&[1.0], &[]), f64::INFINITY.to_bits(), "none");
    }

    /// All 1e10 pairs lie in the window.
    #[test]
    fn dense_lists_are_fast() {
        let a: Vec<f64> = (0..100_000).map(|i| f64::from(i) * 1e-8).collect();
        let b: Vec<f64> = a.iter().map(|t| t + 3e-9).collect();
        let pairs = associate(&a, &b, 1.0);
        assert!(pairs.iter().all(|(i, j)| i == j), "each with its neighbour");
        assert_eq!(pairs.len(), a.len(), "all");
    }

    proptest! {
        #[test]
        fn equals_the_greedy_rule(
            a in proptest::collection::btree_set(0u32..200, 0..30),
            b in proptest::collection::btree_set(0u32..200, 0..30),
            window in 0u32..20,
        ) {
            // Sixteenths are exact, so ties in |dt| are real ties.
            let seconds = |s: std::collections::BTreeSet<u32>| -> Vec<f64> {
                s.into_iter().map(|t| f64::from(t) / 16.0).collect()
            };
            let (a, b) = (seconds(a), seconds(b));
            let max_dt_s = f64::from(window) / 16.0;
            prop_assert_eq!(associate(&a, &b, max_dt_s), spec(&a, &b, max_dt_s));
        }
    }
}
