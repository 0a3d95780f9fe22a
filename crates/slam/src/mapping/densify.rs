//! Adaptive density control: clone, split and prune (Kerbl et al. 2023, section 5.2).
//!
//! A large mean gradient at a splat's centre says that it covers too much or too little of the image. If
//! it is small, a second one beside it is missing: it is cloned. If it is large, it covers more than
//! one thing: it is split in two.

use garad_core::{Camera, GaussianMap, KeyframeId, Label, Real, Rng, So3};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::config::DensifyConfig;

/// Accumulated gradients at the splats' centres since the last densification.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Densifier {
    /// Σ |∂L/∂(NDC x, y)|.
    gradient: Vec<f32>,
    /// Iterations in which it was rendered.
    seen: Vec<u32>,
}

impl Densifier {
    /// Adds one iteration. A gradient per pixel becomes one per unit of normalised device
    /// coordinates, 2/W and 2/H of which are a pixel, so that all levels of the pyramid count alike.
    ///
    /// # Panics
    /// Unless there is a radius for every gradient.
    pub fn add(&mut self, by_mean_px: &[[f32; 2]], radii: &[i32], camera: &Camera) {
        self.gradient.resize(by_mean_px.len(), 0.0);
        self.seen.resize(by_mean_px.len(), 0);
        #[allow(clippy::cast_precision_loss, reason = "sizes of images")]
        let half = [camera.width as f32 / 2.0, camera.height as f32 / 2.0];
        for (i, g) in by_mean_px.iter().enumerate() {
            if radii[i] > 0 {
                self.gradient[i] += Vector2::new(g[0] * half[0], g[1] * half[1]).norm();
                self.seen[i] += 1;
            }
        }
    }

    pub(crate) fn retain(&mut self, keep: &[bool]) {
        let mut kept = keep.iter();
        self.gradient
            .retain(|_| kept.next().copied().unwrap_or(true));
        let mut kept = keep.iter();
        self.seen.retain(|_| kept.next().copied().unwrap_or(true));
    }

    /// Σ |∂L/∂(NDC x, y)| and the number of iterations, since the last densification.
    pub(super) fn sums(&self) -> (&[f32], &[u32]) {
        (&self.gradient, &self.seen)
    }

    /// Mean gradient; 0 if it was not rendered.
    #[must_use]
    pub fn mean(&self, i: usize) -> f64 {
        match self.seen.get(i) {
            Some(&seen) if seen > 0 => f64::from(self.gradient[i]) / f64::from(seen),
            _ => 0.0,
        }
    }
}

/// Children of a split, and what their parent's standard deviations are divided by.
const CHILDREN: usize = 2;
const SHRINK: f64 = 1.6;

/// Appends clones and children to the map; the result marks the Gaussians that were split and
/// are to be removed. Dynamic Gaussians are left alone, and so are those born before
/// `young_from`; clones and children are as old as their parents. `max_gaussians` is never exceeded.
///
/// Clones have their parent's position and move apart by their own gradients. Children are
/// drawn from the parent's distribution, N(μ, R S² Rᵀ).
pub(crate) fn densify(
    map: &mut GaussianMap,
    accumulated: &Densifier,
    extent_m: f64,
    young_from: KeyframeId,
    config: &DensifyConfig,
    rng: &mut Rng,
) -> Vec<bool> {
    let normal = || rng.normal();
    densify_with(map, accumulated, extent_m, young_from, config, normal)
}

/// Cloning and splitting with standard normal numbers given: three a child, along its parent's axes x, y, z. Golden:
/// `densify/*`.
pub fn densify_with(
    map: &mut GaussianMap,
    accumulated: &Densifier,
    extent_m: f64,
    young_from: KeyframeId,
    config: &DensifyConfig,
    mut normal: impl FnMut() -> f64,
) -> Vec<bool> {
    let before = map.len();
    let large = config.split_extent * extent_m;
    let mut split = vec![false; before];
    for i in 0..before {
        let left_alone = map.label[i] == Label::Dynamic || map.born[i] < young_from;
        if left_alone || accumulated.mean(i) < config.grad_threshold {
            continue;
        }
        if map.len() + CHILDREN > config.max_gaussians {
            break;
        }
        let sigma = map.log_scales[i].map(|s| f64::from(Real::exp(s)));
        if sigma.iter().all(|s| *s <= large) {
            map.push_copy(i);
            continue;
        }
        let [w, x, y, z] = map.quaternions[i].map(f64::from);
        let Some(rotation) = So3::from_quaternion(w, x, y, z) else {
            continue; // no direction, so nothing to draw from
        };
        split[i] = true;
        for _ in 0..CHILDREN {
            let child = map.push_copy(i);
            let local = Vector3::from(sigma.map(|s| s * normal()));
            let offset = rotation * local;
            for axis in 0..3 {
                map.means[child][axis] += offset[axis].to_f32();
                map.log_scales[child][axis] -= Real::ln(SHRINK).to_f32();
            }
        }
    }
    split
}

/// Standard deviation from which a Gaussian is too large, as a share of the path's extent.
const LARGE_EXTENT: f64 = 0.1;

/// Marks the static Gaussians that are too large (`densify.prune_large`).
#[must_use]
pub fn too_large(map: &GaussianMap, extent_m: f64) -> Vec<bool> {
    let most = Real::ln(LARGE_EXTENT * extent_m).to_f32();
    let scales = map.log_scales.iter().zip(&map.label);
    scales
        .map(|(log_scales, label)| *label == Label::Static && log_scales.iter().any(|s| *s > most))
        .collect()
}

/// Marks the static Gaussians less opaque than `min_opacity`. Dynamic ones fade by the penalty of
/// eq. 12 and are removed by eq. 7.
#[must_use]
pub fn faded(map: &GaussianMap, min_opacity: f64) -> Vec<bool> {
    let least = Real::ln(min_opacity / (1.0 - min_opacity)).to_f32();
    map.opacity_logits
        .iter()
        .zip(&map.label)
        .map(|(logit, label)| *logit < least && *label == Label::Static)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::NewGaussian;

    fn map(sigmas: &[f32]) -> GaussianMap {
        let mut map = GaussianMap::new(0);
        for &sigma_m in sigmas {
            map.push(&NewGaussian {
                mean: [0.0, 0.0, 2.0],
                sigma_m,
                opacity: 0.5,
                color: [0.5; 3],
                landmark: None,
                born: KeyframeId(3),
            });
        }
        map
    }

    fn with_gradient(n: usize, by_mean_px: [f32; 2]) -> Densifier {
        let camera = Camera::pinhole((200, 100), [100.0, 100.0, 99.5, 49.5]).expect("valid");
        let mut accumulated = Densifier::default();
        accumulated.add(&vec![by_mean_px; n], &vec![1; n], &camera);
        accumulated.add(&vec![[0.0; 2]; n], &vec![0; n], &camera);
        accumulated
    }

    #[test]
    fn gradient_is_a_mean_over_the_iterations_that_rendered_it() {
        // 3/100 and 8/50 px⁻¹ are 3 and 8 per unit of NDC's half width and height.
        let accumulated = with_gradient(1, [0.03, 0.08]);
        assert!(
            (accumulated.mean(0) - 5.0).abs() < 1e-6,
            "(3, 4): {}",
            accumulated.mean(0)
        );
        assert!(accumulated.mean(1).abs() < 1e-12, "never rendered");
    }

    #[test]
    fn small_ones_are_cloned_and_large_ones_split() {
        let mut map = map(&[0.005, 0.5, 0.5]);
        map.label[2] = Label::Dynamic;
        let config = DensifyConfig::default();
        let accumulated = with_gradient(3, [1.0, 0.0]);
        let split = densify(
            &mut map,
            &accumulated,
            1.0,
            KeyframeId(0),
            &config,
            &mut Rng::new(1),
        );
        assert_eq!(split, [false, true, false], "the large static one goes");
        assert_eq!(map.len(), 3 + 1 + 2, "a clone and two children");
        assert_eq!(
            map.parent[3..],
            [Some(0), Some(1), Some(1)],
            "of these parents"
        );
        let apart = |a: usize, b: usize| {
            let (a, b) = (map.means[a], map.means[b]);
            (Vector3::from(a) - Vector3::from(b)).norm()
        };
        assert!(apart(3, 0) < 1e-9, "a clone stays");
        assert!(apart(4, 1) > 1e-3 && apart(4, 5) > 1e-3, "children part");
        let ratio = Real::exp(map.log_scales[1][0] - map.log_scales[4][0]);
        assert!((ratio - 1.6).abs() < 1e-5, "smaller by {ratio}");
        map.validate().expect("consistent");
    }

    /// A path of 2 m: 0.2 m is the limit.
    #[test]
    fn large_static_ones_are_marked() {
        let mut map = map(&[0.19, 0.21, 0.21]);
        map.label[2] = Label::Dynamic;
        assert_eq!(too_large(&map, 2.0), [false, true, false]);
        map.log_scales[0][1] = Real::ln(0.3f32);
        assert!(too_large(&map, 2.0)[0], "one axis is enough");
    }

    /// With small static Gaussians: the mean gradient, room for so many more, and how many come.
    #[test]
    fn a_clone_needs_the_gradient_and_room_for_two() {
        for (gradient, room, clones) in [
            (0.5, 9, 2), // the threshold itself
            (0.499, 9, 0),
            (0.75, 9, 2),
            (0.75, 3, 2), // the first leaves room for two
            (0.75, 2, 1),
            (0.75, 1, 0),
        ] {
            let mut map = map(&[0.005; 2]);
            let config = DensifyConfig {
                grad_threshold: 0.5,
                max_gaussians: 2 + room,
                ..DensifyConfig::default()
            };
            let accumulated = with_gradient(2, [gradient / 100.0, 0.0]);
            let (young_from, mut rng) = (KeyframeId(0), Rng::new(1));
            densify(&mut map, &accumulated, 1.0, young_from, &config, &mut rng);
            assert_eq!(map.len(), 2 + clones, "{gradient} and {room}");
        }
    }

    /// Standard deviations of 1 m and half of it: a share of 0.25 of 4 m is the limit.
    #[test]
    fn one_standard_deviation_above_the_limit_is_enough_for_a_split() {
        for (extent_m, axis, is_split) in [(4.0, 0, false), (3.99, 0, true), (3.99, 2, true)] {
            let mut map = map(&[0.5]);
            map.log_scales[0][axis] = 0.0;
            let config = DensifyConfig {
                split_extent: 0.25,
                ..DensifyConfig::default()
            };
            let accumulated = with_gradient(1, [1.0, 0.0]);
            let (young_from, mut rng) = (KeyframeId(0), Rng::new(1));
            let split = densify(
                &mut map,
                &accumulated,
                extent_m,
                young_from,
                &config,
                &mut rng,
            );
            assert_eq!(split, [is_split], "{extent_m} m, axis {axis}");
            assert_eq!(map.len(), if is_split { 3 } else { 2 }, "clone or children");
        }
    }

    /// A quarter turn about z takes the own axes (x, y, z) to (y, -x, z).
    #[test]
    fn children_are_drawn_along_the_axes_of_their_parent() {
        let mut map = map(&[0.1]);
        map.log_scales[0] = [0.5f32, 0.25, 2.0].map(Real::ln);
        map.quaternions[0] = [1.0, 0.0, 0.0, 1.0];
        map.opacity_logits[0] = 0.7;
        let mut draws = Rng::new(5);
        let accumulated = with_gradient(1, [1.0, 0.0]);
        let (young_from, config) = (KeyframeId(0), DensifyConfig::default());
        let rng = &mut draws.clone();
        densify(&mut map, &accumulated, 1.0, young_from, &config, rng);
        for child in [1, 2] {
            let [a, b, c] = [0.5, 0.25, 2.0].map(|sigma| sigma * draws.normal());
            let expected = Vector3::new(-b, a, 2.0 + c);
            let mean = Vector3::from(map.means[child].map(f64::from));
            assert!((mean - expected).norm() < 1e-6, "{mean} and {expected}");
            for (log_scale, parent) in map.log_scales[child].iter().zip([0.5f32, 0.25, 2.0]) {
                let ratio = parent / Real::exp(*log_scale);
                assert!((ratio - 1.6).abs() < 1e-5, "each by {ratio}");
            }
            let turned = [child, 0].map(|i| map.quaternions[i].map(f32::to_bits));
            assert_eq!(turned[0], turned[1], "as it is turned");
            assert!((map.opacity_logits[child] - 0.7).abs() < 1e-6, "as opaque");
        }
    }

    #[test]
    fn sums_stay_with_their_gaussians_and_count_what_was_rendered() {
        let camera = Camera::pinhole((4, 2), [4.0, 3.0, 1.5, 0.5]).expect("valid");
        let mut accumulated = Densifier::default();
        accumulated.add(&[[1.0, 0.0], [0.0, 2.0]], &[1, 0], &camera);
        accumulated.add(&[[2.0, 0.0], [0.0, 3.0], [3.0, 4.0]], &[7, 1, 1], &camera);
        assert_eq!(
            accumulated.sums(),
            (&[6.0, 3.0, (36.0f32 + 16.0).sqrt()][..], &[2, 1, 1][..])
        );
        accumulated.retain(&[true, false, true]);
        assert!((accumulated.mean(0) - 3.0).abs() < 1e-12, "(2 + 4)/2");
        assert!(
            (accumulated.mean(1) - 52f64.sqrt()).abs() < 1e-6,
            "the third"
        );
        assert!(accumulated.mean(2).abs() < 1e-12, "unknown");
    }

    #[test]
    fn what_is_at_a_limit_stays() {
        let mut map = map(&[1.0; 2]);
        map.log_scales[1][2] = 1e-3;
        assert_eq!(too_large(&map, 10.0), [false, true], "a tenth of 10 m");
        map.opacity_logits = vec![0.0, -1e-3];
        assert_eq!(faded(&map, 0.5), [false, true], "opacity 0.5");
        map.opacity_logits = vec![-1.0, -1.2]; // 0.27, 0.23
        assert_eq!(faded(&map, 0.25), [false, true], "opacity 0.25");
    }

    #[test]
    fn old_gaussians_are_left_alone() {
        let mut map = map(&[0.005, 0.5, 0.5]);
        map.born = [4, 3, 4].map(KeyframeId).to_vec();
        let config = DensifyConfig::default();
        let accumulated = with_gradient(3, [1.0, 0.0]);
        let split = densify(
            &mut map,
            &accumulated,
            1.0,
            KeyframeId(4),
            &config,
            &mut Rng::new(1),
        );
        assert_eq!(split, [false, false, true], "the second is too old");
        let born: Vec<_> = map.born.iter().map(|k| k.0).collect();
        assert_eq!(born, [4, 3, 4, 4, 4, 4], "a clone and two children, as old");
    }

    #[test]
    fn only_static_ones_fade() {
        let mut map = map(&[0.1; 3]);
        map.opacity_logits = vec![-9.0, -9.0, 0.0];
        map.label[1] = Label::Dynamic;
        assert_eq!(faded(&map, 0.005), [true, false, false], "one");
    }
}
