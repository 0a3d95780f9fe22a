//! Initial scale of a Gaussian from the distances to its neighbours.

use std::num::NonZero;
use std::ops::Range;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

/// Neighbours whose distances are averaged, as `distCUDA2` of 3D Gaussian Splatting has it.
pub const NEIGHBOURS: usize = 3;

/// Least scale, in footprints. Insertion puts no Gaussian nearer than half a footprint to another of
/// its surface: a smaller distance is that between two surfaces, or noise of the depth, and a
/// smaller scale leaves holes.
pub const MIN_FOOTPRINTS: f64 = 0.5;

/// Greatest scale, in footprints. A surface at 60 degrees to the image plane has its samples two
/// footprints apart along the slope; farther neighbours are on another surface, across a depth edge, and
/// so wide a Gaussian would cover it.
pub const MAX_FOOTPRINTS: f64 = 2.0;

/// Initial scales (standard deviations, metres) of the points from index `first` on, whose neighbours
/// are all of the points, those before `first` included:
///
/// ```text
/// σ_i = clamp(√((d₁² + d₂² + d₃²) / 3), 0.5 f_i, 2 f_i)
/// ```
///
/// d₁, d₂, d₃: distances, metres, to the three nearest other points; f_i: footprint, metres, the distance
/// stride · z / f between neighbouring samples at the point's depth. A point at the same place is
/// another point, at distance 0. With fewer than three others the mean is infinite, so σ = 2 f. Without
/// the clamp this is the rule of 3D Gaussian Splatting (Kerbl et al. 2023; `distCUDA2` of its
/// `simple-knn`).
///
/// Distances are computed in f64 and are all that is used of the neighbours, so which of several equally
/// far ones is found makes no difference. One thread.
///
/// # Panics
/// If `footprints_m` is not one number per point from `first` on, or there are 2³² points.
#[must_use]
pub fn knn_scales_m(points_m: &[[f64; 3]], first: usize, footprints_m: &[f64]) -> Vec<f64> {
    let of = first..points_m.len();
    assert_eq!(footprints_m.len(), of.len(), "one footprint per point");
    let clamped = |(rms_m, f): (f64, &f64)| rms_m.clamp(MIN_FOOTPRINTS * f, MAX_FOOTPRINTS * f);
    let distances = rms_neighbour_distances_m(points_m, of);
    distances
        .into_iter()
        .zip(footprints_m)
        .map(clamped)
        .collect()
}

/// √((d₁² + d₂² + d₃²) / 3) of some of the points, metres; infinite with fewer than three other points.
///
/// # Panics
/// As [`knn_scales_m`].
#[must_use]
pub fn rms_neighbour_distances_m(points_m: &[[f64; 3]], of: Range<usize>) -> Vec<f64> {
    if points_m.len() <= NEIGHBOURS {
        return vec![f64::INFINITY; of.len()];
    }
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(points_m).expect("fewer than 2^32 points");
    let with_itself = NonZero::new(NEIGHBOURS + 1).expect("not zero");
    let rms = |point: &[f64; 3]| {
        let nearest = tree.query(point);
        let nearest = nearest.nearest_n::<SquaredEuclidean<f64>>(with_itself);
        // In ascending order: the first is the point itself, or one at the same place.
        let others = nearest.execute().into_iter().skip(1);
        let sum = others.fold(0.0, |sum, other| sum + other.distance);
        (sum / NEIGHBOURS as f64).sqrt()
    };
    points_m[of].iter().map(rms).collect()
}

#[cfg(test)]
mod tests {
    use garad_core::Rng;
    use proptest::prelude::*;

    use super::*;

    fn all(points: &[[f64; 3]]) -> Vec<f64> {
        rms_neighbour_distances_m(points, 0..points.len())
    }

    fn brute_force(points: &[[f64; 3]]) -> Vec<f64> {
        let square = |a: &[f64; 3], b: &[f64; 3]| {
            let [x, y, z] = std::array::from_fn(|k| (a[k] - b[k]) * (a[k] - b[k]));
            x + y + z
        };
        let rms = |(i, p): (usize, &[f64; 3])| {
            let others = points.iter().enumerate().filter(|(j, _)| *j != i);
            let mut squares: Vec<f64> = others.map(|(_, q)| square(p, q)).collect();
            squares.sort_by(f64::total_cmp);
            match squares[..] {
                [a, b, c, ..] => ((a + b + c) / 3.0).sqrt(),
                _ => f64::INFINITY,
            }
        };
        points.iter().enumerate().map(rms).collect()
    }

    /// A wall of n x n points at z = 2 m.
    fn wall(n: usize, spacing_m: f64) -> Vec<[f64; 3]> {
        let at = |i: usize| (i as f64) * spacing_m;
        let points = (0..n).flat_map(|y| (0..n).map(move |x| [at(x), at(y), 2.0]));
        points.collect()
    }

    #[test]
    fn on_a_grid_the_scale_is_the_spacing() {
        let points = wall(20, 0.25);
        let scales = all(&points);
        assert_eq!(scales[21..=21], [0.25], "inside");
        assert_eq!(scales[10..=10], [0.25], "at the rim: three neighbours");
        let corner = 0.25 * (4.0f64 / 3.0).sqrt();
        assert!((scales[0] - corner).abs() < 1e-15, "two, and the diagonal");
        assert_eq!(scales, brute_force(&points), "every point");
    }

    /// Distances 1, 2 and 2 m: √((1 + 4 + 4)/3) = √3 m.
    #[test]
    fn three_neighbours_by_hand() {
        let points = [
            [9.0, 0.0, 1.0],
            [2.0, 0.0, 1.0],
            [0.0, -2.0, 1.0],
            [0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
        ];
        assert_eq!(rms_neighbour_distances_m(&points, 4..5), [3.0f64.sqrt()]);
        assert_eq!(knn_scales_m(&points, 4, &[1.0]), [3.0f64.sqrt()], "within");
        assert_eq!(knn_scales_m(&points, 4, &[0.5]), [1.0], "two footprints");
        assert_eq!(knn_scales_m(&points, 4, &[4.0]), [2.0], "half a footprint");
    }

    #[test]
    fn a_point_without_three_neighbours_has_two_footprints() {
        assert_eq!(knn_scales_m(&[[0.0; 3]], 0, &[0.1]), [0.2], "alone");
        assert!(knn_scales_m(&[], 0, &[]).is_empty(), "none at all");
        let three = &wall(2, 0.1)[..3];
        assert_eq!(all(three), [f64::INFINITY; 3], "two neighbours each");
    }

    /// The tree has 32 points in a leaf.
    #[test]
    fn points_at_one_place_are_neighbours_at_distance_0() {
        assert_eq!(all(&[[1.0, 2.0, 3.0]; 100]), [0.0; 100], "all at one");
        let mut points = vec![[0.0; 3]; 2];
        points.extend([[3.0, 0.0, 0.0], [0.0, 0.0, 3.0], [5.0; 3]]);
        let expected = 6.0f64.sqrt();
        assert_eq!(all(&points)[..2], [expected; 2], "0, 3 and 3 m");
    }

    #[test]
    fn a_large_cloud_agrees_with_brute_force() {
        let mut rng = Rng::new(5);
        // On a raster of 5 mm, so that many distances are equal.
        let mut coordinate = |extent_m: f64| (rng.uniform() * extent_m * 200.0).floor() / 200.0;
        let points: Vec<_> = (0..3000)
            .map(|_| [coordinate(2.0), coordinate(1.0), 0.05 * coordinate(1.0)])
            .collect();
        assert_eq!(all(&points), brute_force(&points));
    }

    proptest! {
        #[test]
        fn the_tree_finds_what_brute_force_finds(
            points in proptest::collection::vec([-3..4i32, -3..4i32, -1..2i32], 0..150),
            jitter in 0.0..1.0f64,
        ) {
            let turned = |[x, y, z]: [i32; 3]| {
                let [x, y, z] = [x, y, z].map(f64::from);
                [x + jitter * z, y - jitter * x * y, z + jitter * jitter * x]
            };
            let points: Vec<[f64; 3]> = points.into_iter().map(turned).collect();
            prop_assert_eq!(all(&points), brute_force(&points));
        }

        #[test]
        fn the_order_of_the_points_makes_no_difference(
            points in proptest::collection::vec([-2..3i32, -2..3i32, -2..3i32], 4..90),
        ) {
            let points: Vec<[f64; 3]> = points.into_iter().map(|p| p.map(f64::from)).collect();
            let reversed: Vec<_> = points.iter().rev().copied().collect();
            let mut scales = all(&reversed);
            scales.reverse();
            prop_assert_eq!(all(&points), scales);
        }
    }
}
