//! Sums of the feature kernel (eq. 5) in O(N), by Chebyshev interpolation.
//!
//! k¹ = exp(-(x - y)² / 2) G(γ, γ'), x = α / σ_α. Observations γ are small integers, so the nodes
//! fall into few rows; within a row only the real number x is left. Its axis is cut into cells of one
//! σ with p = 16 Chebyshev points each. Inside a cell the kernel is given by its values at the points,
//!
//! exp(-(x - y)² / 2) = Σ_a Σ_b L_a(x) exp(-(t_a - t_b)² / 2) L_b(y),   L: Lagrange polynomials
//!
//! up to an error below 5e-16 (C4 in docs/math_crf.md). So the terms of all nodes are first summed at
//! the points (N p operations), carried from points to points (a few thousand), and interpolated at the
//! nodes (N p).

use std::f64::consts::PI;

use crate::config::KernelConfig;
use crate::cues::Node;
use crate::kernel::features;

/// Points per cell.
const P: usize = 16;
/// Cells further apart than this are left out: e^(-9² / 2) = 2.6e-18.
const REACH: i64 = 9;
/// Interpolation error of one kernel value, twice over (source and target); see C4.
const INTERPOLATION: f64 = 5e-16;
/// Rounding of one interpolated kernel value: about 60 operations on sums whose absolute values
/// are up to 2.8² times the value.
const ROUNDING: f64 = 500.0 * f64::EPSILON;

/// With more boxes (row, cell) than this, and 64 per node on top, the nodes are so scattered that a sum
/// over pairs is no slower and needs no memory.
const MAX_BOXES: usize = 65_536;

/// One number per point of a cell.
type Points = [f64; P];

/// A node that has both features.
struct Member {
    node: usize,
    row: usize,
    cell: usize,
    /// L_a(x).
    lagrange: Points,
    /// |x|.
    size: f64,
}

/// The feature kernel between all nodes.
pub(crate) struct Grid {
    n: usize,
    self_message: bool,
    members: Vec<Member>,
    /// Numbers of the cells that are not empty, ascending.
    cells: Vec<i64>,
    /// G between rows.
    between_rows: Vec<Vec<f64>>,
    /// Nodes per (row, cell).
    population: Vec<usize>,
    /// exp(-(Δ + t_a - t_b)² / 2) for Δ in -REACH..=REACH, then b, then a.
    carry: Vec<[Points; P]>,
}

impl Grid {
    /// `None` where the nodes are too scattered for a grid.
    pub(crate) fn new(nodes: &[Node], config: &KernelConfig, self_message: bool) -> Option<Self> {
        let known: Vec<(usize, f64, u32)> = nodes
            .iter()
            .enumerate()
            .filter_map(|(node, of)| {
                let (alpha, gamma) = features(of)?;
                Some((node, alpha / config.sigma_reproj_px, gamma))
            })
            .collect();
        let mut rows: Vec<u32> = known.iter().map(|&(_, _, gamma)| gamma).collect();
        rows.sort_unstable();
        rows.dedup();
        let mut cells: Vec<i64> = known.iter().map(|&(_, x, _)| cell_of(x).0).collect();
        cells.sort_unstable();
        cells.dedup();
        if rows.len().saturating_mul(cells.len()) > MAX_BOXES + 64 * known.len() {
            return None;
        }
        let polynomials = Lagrange::new();
        let mut population = vec![0; rows.len() * cells.len()];
        let members = known.iter().map(|&(node, x, gamma)| {
            let (number, y) = cell_of(x);
            let row = rows.binary_search(&gamma).expect("made of these rows");
            let cell = cells.binary_search(&number).expect("made of these cells");
            population[row * cells.len() + cell] += 1;
            Member {
                node,
                row,
                cell,
                lagrange: polynomials.at(y),
                size: x.abs(),
            }
        });
        let members = members.collect();
        let gaussian = |delta: f64| libm::exp(-0.5 * (delta * delta));
        let g =
            |a: u32, b: u32| gaussian((f64::from(a) - f64::from(b)) / config.sigma_observations);
        let t = points();
        Some(Self {
            n: nodes.len(),
            self_message,
            members,
            between_rows: rows
                .iter()
                .map(|&a| rows.iter().map(|&b| g(a, b)).collect())
                .collect(),
            population,
            carry: (-REACH..=REACH)
                .map(|step| t.map(|t_b| t.map(|t_a| gaussian(step as f64 + t_a - t_b))))
                .collect(),
            cells,
        })
    }

    /// The cells within reach of cell `c`, and how many cells away each is.
    fn within_reach(&self, c: usize) -> impl Iterator<Item = (usize, i64)> {
        let own = self.cells[c];
        let first = self.cells.partition_point(|&cell| cell < own - REACH);
        self.cells[first..]
            .iter()
            .take_while(move |&&cell| cell <= own + REACH)
            .enumerate()
            .map(move |(k, &cell)| (first + k, own - cell))
    }

    /// Bound on the error of each node's sum for |s| ≤ 1, from what interpolation and rounding do
    /// to each pair.
    pub(crate) fn left_out(&self) -> Vec<f64> {
        let columns = self.cells.len();
        // Per (row, cell): the weights of all nodes, by G alone and by the largest value of the
        // kernel between the cells.
        let mut total = vec![[0.0f64; 2]; self.population.len()];
        for (row, g) in self.between_rows.iter().enumerate() {
            for c in (0..columns).filter(|c| self.population[row * columns + c] > 0) {
                for (other_row, g) in g.iter().enumerate() {
                    let in_row: usize = self.population[other_row * columns..][..columns]
                        .iter()
                        .sum();
                    total[row * columns + c][0] += g * in_row as f64;
                    for (other, step) in self.within_reach(c) {
                        let gap = (step.abs() - 1).max(0) as f64;
                        let nodes = self.population[other_row * columns + other] as f64;
                        total[row * columns + c][1] += nodes * g * libm::exp(-0.5 * (gap * gap));
                    }
                }
            }
        }
        let mut left_out = vec![0.0; self.n];
        for m in &self.members {
            let [all, near] = total[m.row * columns + m.cell];
            // x itself is rounded: the kernel's slope is at most 0.61.
            let rounding = ROUNDING + 4.0 * f64::EPSILON * (m.size + 10.0);
            left_out[m.node] = INTERPOLATION * all + rounding * near;
        }
        left_out
    }

    /// Σⱼ k(i, j) sⱼ for each node i.
    pub(crate) fn sums(&self, s: &[f64]) -> Vec<f64> {
        let columns = self.cells.len();
        let mut gathered = vec![[0.0; P]; self.population.len()];
        for m in &self.members {
            add(
                &mut gathered[m.row * columns + m.cell],
                s[m.node],
                &m.lagrange,
            );
        }
        // Along x within each row, to every cell.
        let mut carried = vec![[0.0; P]; self.population.len()];
        for row in 0..self.between_rows.len() {
            for c in 0..columns {
                let sum = &mut carried[row * columns + c];
                for (source, step) in self.within_reach(c) {
                    if self.population[row * columns + source] > 0 {
                        let table =
                            &self.carry[usize::try_from(step + REACH).expect("|step| ≤ REACH")];
                        for (value, column) in gathered[row * columns + source].iter().zip(table) {
                            add(sum, *value, column);
                        }
                    }
                }
            }
        }
        // Across rows, to cells that are not empty.
        let mut arrived = vec![[0.0; P]; self.population.len()];
        for (row, g) in self.between_rows.iter().enumerate() {
            for (source, &g) in g.iter().enumerate() {
                if g > 0.0 {
                    for c in (0..columns).filter(|c| self.population[row * columns + c] > 0) {
                        let from = carried[source * columns + c];
                        add(&mut arrived[row * columns + c], g, &from);
                    }
                }
            }
        }
        let mut sums = vec![0.0; self.n];
        for m in &self.members {
            let at_points = &arrived[m.row * columns + m.cell];
            let read = at_points
                .iter()
                .zip(&m.lagrange)
                .fold(0.0, |sum, (v, l)| sum + v * l);
            sums[m.node] = if self.self_message {
                read
            } else {
                read - s[m.node]
            };
        }
        sums
    }
}

/// sum += factor · of
#[inline(always)]
fn add(sum: &mut Points, factor: f64, of: &Points) {
    for a in 0..P {
        sum[a] += factor * of[a];
    }
}

/// Number of the cell and place in it, from -1/2 to 1/2 around its centre.
#[allow(clippy::cast_possible_truncation, reason = "clamped to what i64 holds")]
fn cell_of(x: f64) -> (i64, f64) {
    let floor = x.clamp(-4e15, 4e15).floor();
    (floor as i64, x.clamp(-4e15, 4e15) - floor - 0.5)
}

/// Chebyshev points of a cell: cos((a + 1/2) π / P) / 2.
fn points() -> Points {
    std::array::from_fn(|a| 0.5 * libm::cos((a as f64 + 0.5) * PI / P as f64))
}

/// The points with their barycentric weights (-1)^a sin((a + 1/2) π / P).
struct Lagrange {
    t: Points,
    weights: Points,
}

impl Lagrange {
    fn new() -> Self {
        let sine = |a: usize| libm::sin((a as f64 + 0.5) * PI / P as f64);
        Self {
            t: points(),
            weights: std::array::from_fn(|a| if a % 2 == 0 { sine(a) } else { -sine(a) }),
        }
    }

    /// L_a(y) at all points a: (w_a / (y - t_a)) / Σ_b w_b / (y - t_b).
    fn at(&self, y: f64) -> Points {
        if let Some(a) = self
            .t
            .iter()
            .position(|t| (y - t).abs() < f64::MIN_POSITIVE)
        {
            return std::array::from_fn(|b| if a == b { 1.0 } else { 0.0 });
        }
        let terms: Points = std::array::from_fn(|a| self.weights[a] / (y - self.t[a]));
        let sum = terms.iter().fold(0.0, |sum, term| sum + term);
        terms.map(|term| term / sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_of_degree_fifteen_are_reproduced() {
        let (t, polynomials) = (points(), Lagrange::new());
        for y in [-0.5, -0.3, 0.0, 0.123_456, t[3], t[3] + 1e-17, 0.5] {
            let l = polynomials.at(y);
            let power = |y: f64, degree| (0..degree).fold(1.0, |product, _| product * (2.0 * y));
            for degree in 0..P {
                let got: f64 = (0..P).map(|a| l[a] * power(t[a], degree)).sum();
                assert!(
                    (got - power(y, degree)).abs() < 1e-14,
                    "y^{degree} at {y}: {got}"
                );
            }
            let size: f64 = l.iter().map(|l| l.abs()).sum();
            assert!(size < 2.8, "Lebesgue function {size} at {y}");
        }
    }

    /// The bound of C4, on a grid of both arguments and all distances of cells.
    #[test]
    fn interpolated_kernel_is_within_its_bound() {
        let (t, polynomials) = (points(), Lagrange::new());
        let mut worst = 0.0f64;
        for step in -REACH..=REACH {
            for x in (0..=40).map(|k| f64::from(k) / 40.0 - 0.5) {
                for y in (0..=40).map(|k| f64::from(k) / 40.0 - 0.5) {
                    let (l_x, l_y) = (polynomials.at(x), polynomials.at(y));
                    let mut got = 0.0;
                    for a in 0..P {
                        for b in 0..P {
                            let delta = step as f64 + t[a] - t[b];
                            got += l_x[a] * libm::exp(-0.5 * (delta * delta)) * l_y[b];
                        }
                    }
                    let delta = step as f64 + x - y;
                    worst = worst.max((got - libm::exp(-0.5 * (delta * delta))).abs());
                }
            }
        }
        assert!(worst < 4e-15, "interpolation and rounding: {worst:e}");
    }
}
