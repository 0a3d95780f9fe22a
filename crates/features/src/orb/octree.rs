//! Spreading keypoints over an image with a quad-tree, the best of each leaf.
//!
//! ORB-SLAM's scheme (Mur-Artal & Tardós 2017): start with about square cells, split every cell
//! with more than one corner into four until there are as many cells as wanted features, then
//! keep the strongest corner of each. In the last round cells are split largest first and
//! splitting stops as soon as the count is reached.

use std::ops::Range;

use crate::fast9::Corner;

/// A cell: pixels [x0, x1) x [y0, y1) and the corners inside, a range of the order list.
#[derive(Debug, Clone)]
struct Node {
    x0: usize,
    x1: usize,
    y0: usize,
    y1: usize,
    members: Range<usize>,
}

impl Node {
    fn is_leaf(&self) -> bool {
        self.members.len() <= 1
    }
}

/// Picks about `wanted` corners, spread over [0, width) x [0, height), which holds all of
/// `corners`. Up to three more may come, and fewer where a whole round of splits separates
/// nothing (all corners of every open cell in one quarter), which ends ORB-SLAM's search too.
///
/// Ties: cells of equal count are split from the right to the left, and among equal left edges
/// the one made last first (a stable sort where ORB-SLAM's is unstable); in a leaf the first
/// corner of the strongest wins. The result is in raster order.
#[must_use]
pub fn distribute(
    corners: &[Corner],
    (width, height): (usize, usize),
    wanted: usize,
) -> Vec<Corner> {
    if corners.is_empty() || wanted == 0 || width == 0 || height == 0 {
        return Vec::new();
    }
    let mut tree = Tree {
        corners,
        order: (0..corners.len()).collect(),
        scratch: Vec::with_capacity(corners.len()),
    };
    let mut best: Vec<Corner> = tree
        .split_until(width, height, wanted)
        .into_iter()
        .filter_map(|node| tree.strongest(&node))
        .collect();
    best.sort_unstable_by_key(|c| (c.y, c.x));
    best
}

struct Tree<'a> {
    corners: &'a [Corner],
    /// Indices into `corners`; each node owns a range.
    order: Vec<usize>,
    scratch: Vec<usize>,
}

impl Tree<'_> {
    /// All non-empty nodes when splitting is over.
    ///
    /// ORB-SLAM keeps a list, walks it from the front and pushes children to the front. Here the
    /// front is the end of a vector: same order of visits.
    fn split_until(&mut self, width: usize, height: usize, wanted: usize) -> Vec<Node> {
        let mut nodes = self.roots(width, height);
        nodes.reverse();
        loop {
            let before = nodes.len();
            let (mut next, open): (Vec<Node>, Vec<Node>) =
                nodes.into_iter().partition(Node::is_leaf);
            let leaves = next.len();
            for node in open.into_iter().rev() {
                next.extend(self.children(&node));
            }
            nodes = next;
            if nodes.len() >= wanted || nodes.len() == before {
                return nodes;
            }
            let splittable = nodes[leaves..].iter().filter(|n| !n.is_leaf()).count();
            if nodes.len() + 3 * splittable > wanted {
                return self.split_largest_first(nodes, wanted);
            }
        }
    }

    /// One more split of everything might overshoot: split one by one, the fullest first.
    fn split_largest_first(&mut self, nodes: Vec<Node>, wanted: usize) -> Vec<Node> {
        let (mut done, mut open): (Vec<Node>, Vec<Node>) =
            nodes.into_iter().partition(Node::is_leaf);
        loop {
            let before = done.len() + open.len();
            open.sort_by_key(|n| (n.members.len(), n.x0));
            let mut made: Vec<Node> = Vec::new();
            while let Some(node) = open.pop() {
                for child in self.children(&node) {
                    if child.is_leaf() {
                        done.push(child);
                    } else {
                        made.push(child);
                    }
                }
                if done.len() + open.len() + made.len() >= wanted {
                    break;
                }
            }
            let now = done.len() + open.len() + made.len();
            if now >= wanted || now == before {
                done.append(&mut open);
                done.append(&mut made);
                return done;
            }
            open = made;
        }
    }

    /// round(width / height) cells side by side, at least one; empty ones left out.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "cell edges in f32 as in ORB-SLAM, all inside the image"
    )]
    fn roots(&mut self, width: usize, height: usize) -> Vec<Node> {
        let count = ((width as f32 / height as f32).round() as usize).max(1);
        let cell = width as f32 / count as f32;
        let root_of = |c: &Corner| ((c.x as f32 / cell) as usize).min(count - 1);
        let corners = self.corners;
        self.order.sort_by_key(|&i| root_of(&corners[i]));
        let mut start = 0;
        let mut roots = Vec::with_capacity(count);
        for i in 0..count {
            let members = self.order[start..]
                .iter()
                .take_while(|&&k| root_of(&corners[k]) == i)
                .count();
            if members > 0 {
                roots.push(Node {
                    x0: (cell * i as f32) as usize,
                    x1: (cell * (i + 1) as f32) as usize,
                    y0: 0,
                    y1: height,
                    members: start..start + members,
                });
            }
            start += members;
        }
        roots
    }

    /// The non-empty quarters: upper left, upper right, lower left, lower right.
    fn children(&mut self, node: &Node) -> impl Iterator<Item = Node> + use<> {
        let middle_x = node.x0 + (node.x1 - node.x0).div_ceil(2);
        let middle_y = node.y0 + (node.y1 - node.y0).div_ceil(2);
        let corners = self.corners;
        let quarter_of = |i: usize| {
            usize::from(corners[i].x >= middle_x) + 2 * usize::from(corners[i].y >= middle_y)
        };
        // A stable partition: within a quarter the corners keep their order.
        self.scratch.clear();
        self.scratch
            .extend_from_slice(&self.order[node.members.clone()]);
        let mut end = node.members.start;
        let quarters = std::array::from_fn::<Node, 4, _>(|quarter| {
            let start = end;
            for &i in self.scratch.iter().filter(|&&i| quarter_of(i) == quarter) {
                self.order[end] = i;
                end += 1;
            }
            let (x0, x1) = if quarter % 2 == 0 {
                (node.x0, middle_x)
            } else {
                (middle_x, node.x1)
            };
            let (y0, y1) = if quarter < 2 {
                (node.y0, middle_y)
            } else {
                (middle_y, node.y1)
            };
            Node {
                x0,
                x1,
                y0,
                y1,
                members: start..end,
            }
        });
        quarters.into_iter().filter(|n| !n.members.is_empty())
    }

    fn strongest(&self, node: &Node) -> Option<Corner> {
        let members = self.order[node.members.clone()].iter();
        members
            .map(|&i| self.corners[i])
            .reduce(|best, c| if c.score > best.score { c } else { best })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;
    use proptest::prelude::*;

    fn corner(x: usize, y: usize, score: u8) -> Corner {
        Corner { x, y, score }
    }

    #[test]
    fn one_corner_and_the_best_of_many() {
        assert!(distribute(&[], (10, 10), 5).is_empty(), "nothing");
        assert_eq!(
            distribute(&[corner(3, 4, 9)], (10, 10), 5),
            [corner(3, 4, 9)],
            "one"
        );
        let crowd = [
            corner(1, 1, 5),
            corner(2, 1, 9),
            corner(1, 2, 9),
            corner(8, 8, 1),
        ];
        // Wanted 2: after one split there are two cells; the first of the two 9s wins.
        assert_eq!(
            distribute(&crowd, (10, 10), 2),
            [corner(2, 1, 9), corner(8, 8, 1)],
            "best"
        );
        assert!(distribute(&crowd, (10, 10), 0).is_empty(), "none wanted");
    }

    #[test]
    fn a_round_that_separates_nothing_is_the_last() {
        let huddle = [corner(1, 1, 5), corner(2, 2, 6)]; // one quarter of 100 x 100
        assert_eq!(
            distribute(&huddle, (100, 100), 2),
            [corner(2, 2, 6)],
            "as in ORB-SLAM"
        );
    }

    #[test]
    fn everything_survives_when_more_is_wanted_than_there_is() {
        let all: Vec<Corner> = (0..5)
            .flat_map(|y| (0..5).map(move |x| corner(x, y, 1)))
            .collect();
        assert_eq!(
            distribute(&all, (5, 5), 100),
            all,
            "raster order, nothing lost"
        );
    }

    proptest! {
        #[test]
        fn count_is_kept_and_corners_are_real(
            n in 1usize..400, wanted in 1usize..150, seed: u64, wide in 1usize..5
        ) {
            let mut rng = Rng::new(seed);
            let (w, h) = (100 * wide, 100);
            let mut all: Vec<Corner> = (0..n)
                .map(|_| corner(rng.below(w), rng.below(h), 7))
                .collect();
            all.sort_unstable_by_key(|c| (c.y, c.x));
            all.dedup();
            let kept = distribute(&all, (w, h), wanted);
            prop_assert!(kept.iter().all(|c| all.contains(c)));
            prop_assert!(kept.windows(2).all(|p| (p[0].y, p[0].x) < (p[1].y, p[1].x)));
            // A split adds at most 3; the first round splits every root.
            let limit = (wanted + 3).max(4 * wide);
            prop_assert!(kept.len() <= limit, "{} of {wanted}", kept.len());
            let by_rows = |c: &Corner| (c.y / 50, c.x / 50);
            let quarters = |list: &[Corner]| -> std::collections::BTreeSet<_> {
                list.iter().map(by_rows).collect()
            };
            // Every quarter of a root that holds a corner keeps one.
            prop_assert_eq!(quarters(&kept), quarters(&all));
        }
    }
}
