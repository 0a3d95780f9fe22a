//! Nodes in groups of 16 neighbours, so that far groups can be left out as a whole.
//!
//! The nodes are split at the median of their widest extent until 16 are left (a k-d tree of which
//! only the leaves are kept). Extents are measured in widths of the kernel, metres and pixels alike.
//! Groups are full but for the last of each tree; its empty places hold the group's first node, and
//! whatever they add is dropped. Nodes without a pixel form a tree of their own.

use std::ops::Range;

use nalgebra::Vector3;

use crate::config::KernelConfig;
use crate::cues::Node;
use crate::readings::{Distance, PositionTerms};

/// Nodes per group. Larger groups leave less out, smaller ones cost more per pair: 8 and 16 take the
/// same time on a room of 5 000 nodes, 32 a third more.
pub(crate) const GROUP: usize = 16;
/// Coordinates of a node: x, y, z in metres, u, v in px.
pub(crate) const DIMENSIONS: usize = 5;

/// Where something is, unscaled.
type Place = [f64; DIMENSIONS];

/// Up to [`GROUP`] nodes that are close to each other.
pub(crate) struct Group {
    /// Coordinate by coordinate.
    pub(crate) coordinates: [[f64; GROUP]; DIMENSIONS],
    /// Index of each node in the caller's list.
    pub(crate) members: Vec<usize>,
    /// Whether pixels may be compared.
    pub(crate) has_pixel: bool,
    low: Place,
    high: Place,
}

/// eq. 6 as numbers: k = exp(-distance(Σ Δ²) c_m - distance(Σ Δ²) c_px).
#[derive(Clone, Copy)]
pub(crate) struct Metric {
    /// c_m = 1 / 2σ_P², 0 if metres do not enter.
    pub(crate) per_space: f64,
    /// c_px = 1 / 2σ_p², 0 if pixels do not enter.
    pub(crate) per_pixel: f64,
    /// Squared or not.
    pub(crate) distance: Distance,
}

impl Metric {
    pub(crate) fn new(config: &KernelConfig) -> Self {
        let half_precision = |sigma: f64| 1.0 / (2.0 * (sigma * sigma));
        let space = half_precision(config.sigma_m);
        let pixel = half_precision(config.sigma_px);
        let (per_space, per_pixel) = match config.terms {
            PositionTerms::Both => (space, pixel),
            PositionTerms::Space => (space, 0.0),
            PositionTerms::Pixel => (0.0, pixel),
        };
        Self {
            per_space,
            per_pixel,
            distance: config.distance,
        }
    }

    /// Exponent of the kernel at two squared distances, ≤ 0.
    pub(crate) fn exponent(&self, space: f64, pixel: f64) -> f64 {
        let (space, pixel) = match self.distance {
            Distance::Squared => (space, pixel),
            Distance::Linear => (space.sqrt(), pixel.sqrt()),
        };
        -(space * self.per_space) - pixel * self.per_pixel
    }

    /// How much a step of 1 in this dimension counts when extents are compared.
    fn scale(&self, dimension: usize) -> f64 {
        if dimension < 3 {
            self.per_space
        } else {
            self.per_pixel
        }
        .sqrt()
    }
}

impl Group {
    fn new(places: &[Place], members: &[usize], has_pixel: bool) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; DIMENSIONS], [f64::NEG_INFINITY; DIMENSIONS]);
        let mut coordinates = [[0.0; GROUP]; DIMENSIONS];
        for d in 0..DIMENSIONS {
            for lane in 0..GROUP {
                let member = members.get(lane).unwrap_or(&members[0]);
                let value = places[*member][d];
                coordinates[d][lane] = value;
                low[d] = low[d].min(value);
                high[d] = high[d].max(value);
            }
        }
        Self {
            coordinates,
            members: members.to_vec(),
            has_pixel,
            low,
            high,
        }
    }

    /// Largest exponent that any pair of the two groups can have: that of the gap between their
    /// bounding boxes.
    pub(crate) fn largest_exponent(&self, other: &Self, metric: &Metric) -> f64 {
        let gap = |d: usize| {
            let gap = (self.low[d] - other.high[d])
                .max(other.low[d] - self.high[d])
                .max(0.0);
            gap * gap
        };
        let pixel = if self.has_pixel && other.has_pixel {
            gap(3) + gap(4)
        } else {
            0.0
        };
        metric.exponent(gap(0) + gap(1) + gap(2), pixel)
    }
}

/// The groups of all nodes that have neighbours at all, in an order that depends on the nodes alone.
pub(crate) fn groups(nodes: &[Node], terms: PositionTerms, metric: &Metric) -> Vec<Group> {
    let places: Vec<Place> = nodes
        .iter()
        .map(|node| {
            // What does not enter the metric is the same everywhere.
            let p = if terms == PositionTerms::Pixel {
                Vector3::zeros()
            } else {
                node.p_world
            };
            let uv = node
                .uv_px
                .filter(|_| terms != PositionTerms::Space)
                .unwrap_or_default();
            [p.x, p.y, p.z, uv.x, uv.y]
        })
        .collect();
    let (mut seen, mut unseen): (Vec<usize>, Vec<usize>) =
        (0..nodes.len()).partition(|&i| nodes[i].uv_px.is_some() && terms != PositionTerms::Space);
    if terms == PositionTerms::Pixel {
        unseen.clear();
    }
    let mut groups = Vec::with_capacity(nodes.len().div_ceil(GROUP) + 1);
    for (members, has_pixel) in [(&mut seen, true), (&mut unseen, false)] {
        for range in leaves(&places, members, metric) {
            groups.push(Group::new(&places, &members[range], has_pixel));
        }
    }
    groups
}

/// Sorts `members` so that each range of the answer is one leaf.
fn leaves(places: &[Place], members: &mut [usize], metric: &Metric) -> Vec<Range<usize>> {
    let mut leaves = Vec::new();
    let whole = 0..members.len();
    let mut open = Vec::from([whole]);
    while let Some(range) = open.pop() {
        if range.len() <= GROUP {
            if !range.is_empty() {
                leaves.push(range);
            }
            continue;
        }
        let part = &mut members[range.clone()];
        let extent = |d: usize| {
            let values = || part.iter().map(|&i| places[i][d]);
            let low = values().fold(f64::INFINITY, f64::min);
            let high = values().fold(f64::NEG_INFINITY, f64::max);
            (high - low) * metric.scale(d)
        };
        let widest =
            (1..DIMENSIONS).fold(0, |best, d| if extent(d) > extent(best) { d } else { best });
        // A whole number of full groups goes to the left.
        let left = part.len().div_ceil(GROUP).div_ceil(2) * GROUP;
        part.select_nth_unstable_by(left - 1, |&a, &b| {
            places[a][widest]
                .total_cmp(&places[b][widest])
                .then(a.cmp(&b))
        });
        let middle = range.start + left;
        open.push(middle..range.end);
        open.push(range.start..middle);
    }
    // The order inside a leaf is the caller's, whatever the selection left behind.
    for leaf in &leaves {
        members[leaf.clone()].sort_unstable();
    }
    leaves
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;
    use nalgebra::{Vector2, Vector3};

    fn cloud(n: usize, without_pixel: usize) -> Vec<Node> {
        let mut rng = Rng::new(5);
        (0..n)
            .map(|i| Node {
                p_world: Vector3::from_fn(|_, _| rng.range(-3.0, 3.0)),
                uv_px: (i >= without_pixel)
                    .then(|| Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0))),
                ..Node::default()
            })
            .collect()
    }

    #[test]
    fn each_node_is_in_one_group_and_groups_are_full() {
        for (n, unseen) in [
            (0, 0),
            (1, 0),
            (16, 0),
            (17, 0),
            (333, 0),
            (333, 41),
            (70, 70),
        ] {
            let nodes = cloud(n, unseen);
            let config = KernelConfig::default();
            let groups = groups(&nodes, PositionTerms::Both, &Metric::new(&config));
            let mut members: Vec<usize> = groups.iter().flat_map(|g| g.members.clone()).collect();
            members.sort_unstable();
            assert!(members.into_iter().eq(0..n), "{n} nodes, each once");
            let full = (n - unseen).div_ceil(GROUP) + unseen.div_ceil(GROUP);
            assert_eq!(groups.len(), full, "{n} nodes, {unseen} without a pixel");
        }
    }

    #[test]
    fn a_thousand_nodes_in_one_place() {
        let nodes = vec![Node::default(); 1000];
        let metric = Metric::new(&KernelConfig::default());
        let groups = groups(&nodes, PositionTerms::Both, &metric);
        assert_eq!(groups.len(), 63, "equal coordinates split as well");
        assert!(
            groups[0].largest_exponent(&groups[62], &metric) == 0.0,
            "no gap"
        );
    }

    #[test]
    fn no_pair_exceeds_the_bound_of_its_groups() {
        for distance in [Distance::Squared, Distance::Linear] {
            let config = KernelConfig {
                distance,
                ..KernelConfig::default()
            };
            let nodes = cloud(400, 30);
            let metric = Metric::new(&config);
            let groups = groups(&nodes, PositionTerms::Both, &metric);
            for a in &groups {
                for b in &groups {
                    let bound = a.largest_exponent(b, &metric);
                    let pairs = a
                        .members
                        .iter()
                        .flat_map(|&i| b.members.iter().map(move |&j| (i, j)));
                    for (i, j) in pairs {
                        let k = crate::kernel::position(&nodes[i], &nodes[j], &config);
                        assert!(
                            k <= libm::exp(bound) * (1.0 + 1e-12),
                            "{i} {j}: {k}, {bound}"
                        );
                    }
                }
            }
        }
    }
}
