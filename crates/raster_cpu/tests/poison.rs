//! Numbers no map should hold, in both passes, by the reference in f64 and f32 and by the fast form: a bad
//! Gaussian is left out, what is left is drawn as if it were not there, gradients are finite, and
//! nothing panics.

mod common;

use common::{Back, Draw, camera, map, pose, tensors};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, Label, NewGaussian, Par, Real, Rng, Se3};
use garad_raster::{Gradients, RenderOptions, Rendered, Upstream, backward, fast, render};
use nalgebra::Vector3;
use proptest::prelude::*;

/// A rasterizer and the view it is tried on.
struct Bench<T> {
    name: &'static str,
    draw: Draw<T>,
    back: Back<T>,
    camera: Camera,
    pose: Se3,
}

impl<T: Real> Bench<T> {
    fn image(&self, map: &GaussianMap<T>) -> Rendered<T> {
        let options = RenderOptions::default();
        let image =
            (self.draw)(map, &self.camera, &self.pose, &options, Par::Seq).expect("an image");
        image
            .validate()
            .unwrap_or_else(|e| panic!("{}: {e}", self.name));
        image
    }

    fn gradients(&self, map: &GaussianMap<T>, upstream: &Upstream<T>) -> Gradients<T> {
        let (image, options) = (self.image(map), RenderOptions::default());
        (self.back)(
            map,
            &self.camera,
            &self.pose,
            &options,
            &image,
            upstream,
            Par::Seq,
        )
        .expect("gradients")
    }

    /// Normal numbers everywhere.
    fn upstream(&self) -> Upstream<T> {
        let mut rng = Rng::new(11);
        let (w, h) = (self.camera.width, self.camera.height);
        let mut normal = || T::from_f64(rng.normal());
        Upstream {
            color: Image::from_fn(w, h, |_, _| [normal(), normal(), normal()]),
            depth: Some(Image::from_fn(w, h, |_, _| normal())),
            opacity: Some(Image::from_fn(w, h, |_, _| normal())),
        }
    }

    /// Both passes; the gradients are finite.
    fn both_passes(&self, map: &GaussianMap<T>, what: &str) -> (Rendered<T>, Gradients<T>) {
        let gradients = self.gradients(map, &self.upstream());
        for (tensor, values) in tensors(&gradients) {
            let bad = values.iter().position(|v| !v.is_finite());
            assert_eq!(bad, None, "{}, {what}: {tensor} is not finite", self.name);
        }
        (self.image(map), gradients)
    }
}

/// Calls a generic function with the two forms of f32 and the reference in f64.
macro_rules! for_each_form {
    ($test:ident, $camera:expr, $pose:expr $(, $arg:expr)*) => {{
        let (camera, pose) = ($camera, $pose);
        $test(&Bench::<f64> { name: "reference f64", draw: render, back: backward, camera, pose } $(, $arg)*);
        $test(&Bench::<f32> { name: "reference f32", draw: render, back: backward, camera, pose } $(, $arg)*);
        $test(&Bench::<f32> { name: "fast", draw: fast::render, back: fast::backward, camera, pose } $(, $arg)*);
    }};
}

/// Largest absolute number in row `i` of any array.
fn row_size<T: Real>(g: &Gradients<T>, i: usize) -> f64 {
    let n = g.means.len();
    let rows = tensors(g).into_iter().filter(|(name, _)| *name != "d_pose");
    rows.flat_map(|(_, values)| {
        let width = values.len() / n;
        values[i * width..(i + 1) * width].to_vec()
    })
    .fold(0.0, |m, v| m.max(v.abs()))
}

/// Row `n` of the map changes no pixel, no count and no other gradient.
fn assert_left_out<T: Real>(
    bench: &Bench<T>,
    clean: &(Rendered<T>, Gradients<T>),
    map: &GaussianMap<T>,
    what: &str,
) {
    let n = clean.1.means.len();
    let (image, gradients) = bench.both_passes(map, what);
    let name = bench.name;
    assert_eq!(image.radii[n], 0, "{name}, {what}: invisible");
    assert!(image.color == clean.0.color, "{name}, {what}: color");
    assert!(image.depth == clean.0.depth, "{name}, {what}: depth");
    assert!(image.last == clean.0.last, "{name}, {what}: last");
    assert!(
        row_size(&gradients, n) < 1e-300,
        "{name}, {what}: no gradient"
    );
    for ((tensor, with), (_, without)) in tensors(&gradients).iter().zip(tensors(&clean.1)) {
        let same = with[..without.len()] == without[..];
        assert!(same, "{name}, {what}: {tensor} of the others");
    }
}

/// A ball at a point of the camera's frame, in front of everything of [`map`].
fn ball<T: Real>(pose: &Se3, p_cam: [f64; 3]) -> NewGaussian<T> {
    let p = pose.inverse() * Vector3::from(p_cam);
    NewGaussian {
        mean: [p.x, p.y, p.z].map(T::from_f64),
        sigma_m: T::from_f64(0.2),
        opacity: T::from_f64(0.9),
        color: [1.0, 0.3, 0.6].map(T::from_f64),
        landmark: None,
        born: KeyframeId(0),
    }
}

/// Twenty Gaussians, and with them a last one in the middle of the view.
fn with_a_ball<T: Real>(bench: &Bench<T>) -> (GaussianMap<T>, GaussianMap<T>) {
    let clean = map(5, 20).cast::<T>();
    let mut more = clean.clone();
    more.push(&ball(&bench.pose, [0.0, 0.0, 1.0]));
    (clean, more)
}

/// NaN and both infinities in every number of every array.
fn bad_numbers<T: Real>(bench: &Bench<T>) {
    let (clean, more) = with_a_ball(bench);
    let clean = bench.both_passes(&clean, "clean");
    assert!(bench.image(&more).radii[20] > 0, "the ball is visible");
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let bad = T::from_f64(value);
        let mut tries: Vec<(String, GaussianMap<T>, bool)> = Vec::new();
        let mut attempt = |what: &str, k: usize, drawn: bool, set: &dyn Fn(&mut GaussianMap<T>)| {
            let mut map = more.clone();
            set(&mut map);
            tries.push((format!("{what}[{k}] = {value}"), map, drawn));
        };
        for k in 0..3 {
            attempt("mean", k, false, &|m| m.means[20][k] = bad);
            // e^-∞ = 0: a flat one.
            attempt("log_scale", k, value < 0.0, &|m| m.log_scales[20][k] = bad);
        }
        for k in 0..4 {
            attempt("quaternion", k, false, &|m| m.quaternions[20][k] = bad);
        }
        // sigmoid(±∞) is 1 or 0.
        attempt("logit", 0, !value.is_nan(), &|m| m.opacity_logits[20] = bad);
        for k in 0..12 {
            attempt("sh", k, false, &|m| m.sh[80 + k / 3][k % 3] = bad);
        }
        for (what, map, drawn) in tries {
            if drawn {
                let (image, _) = bench.both_passes(&map, &what);
                assert!(image.radii[20] > 0, "{}, {what}: drawn", bench.name);
            } else {
                assert_left_out(bench, &clean, &map, &what);
            }
        }
    }
}

#[test]
fn bad_numbers_are_left_out() {
    for_each_form!(bad_numbers, camera(), pose());
}

fn shapes<T: Real>(bench: &Bench<T>) {
    let (clean, more) = with_a_ball(bench);
    let clean = bench.both_passes(&clean, "clean");
    let mut zero = more.clone();
    zero.quaternions[20] = [T::ZERO; 4];
    assert_left_out(bench, &clean, &zero, "zero quaternion");

    let ln = |sigma: f64| T::from_f64(Real::ln(sigma));
    for axes in 1usize..8 {
        let scaled = |sigma: f64| {
            let mut map = more.clone();
            for k in (0..3).filter(|k| axes >> k & 1 == 1) {
                map.log_scales[20][k] = ln(sigma);
            }
            map
        };
        // A speck, a needle or a disk: as small as the blur allows.
        let (image, gradients) = bench.both_passes(&scaled(1e-30), "sigma 1e-30");
        assert!(image.radii[20] > 0, "{}: axes {axes:b}", bench.name);
        assert!(
            row_size(&gradients, 20) > 1e-3,
            "centre and colour have gradients"
        );
        // 1e60 px² fits into f64; 1e30 px² and its square not into f32.
        let fits = T::EPSILON < T::from_f64(1e-10);
        let huge = scaled(1e30);
        if fits {
            let (image, _) = bench.both_passes(&huge, "sigma 1e30");
            assert!(image.radii[20] > 0, "axes {axes:b}: visible");
        } else {
            assert_left_out(bench, &clean, &huge, "sigma 1e30");
        }
    }
}

#[test]
fn zero_quaternions_and_extreme_scales() {
    for_each_form!(shapes, camera(), pose());
}

fn places<T: Real>(bench: &Bench<T>) {
    let clean = map(5, 20).cast::<T>();
    let alone = bench.both_passes(&clean, "clean");
    for p_cam in [
        [0.0, 0.0, -1.0],
        [0.3, -0.2, -1e-30],
        [0.0, 0.0, 0.0], // the camera's centre
        [0.4, 0.1, 0.0], // its plane
        [0.0, 0.0, 0.199],
        [1e30, 0.0, 1.0],
        [0.0, 0.0, -1e30],
    ] {
        let mut more = clean.clone();
        more.push(&ball(&bench.pose, p_cam));
        assert_left_out(bench, &alone, &more, &format!("at {p_cam:?}"));
    }
}

#[test]
fn behind_beside_and_on_the_camera() {
    // With the camera at the world's origin, 0 is 0 to the bit.
    for_each_form!(places, camera(), pose());
    for_each_form!(places, camera(), Se3::default());
}

fn logits<T: Real>(bench: &Bench<T>) {
    let (clean, mut more) = with_a_ball(bench);
    let (clean, alone) = bench.both_passes(&clean, "clean");
    more.opacity_logits[20] = T::from_f64(-1e4);
    let (image, gradients) = bench.both_passes(&more, "logit -1e4");
    assert!(image.color == clean.color, "{}: transparent", bench.name);
    assert!(
        row_size(&gradients, 20) < 1e-300,
        "{}: and has no gradient",
        bench.name
    );
    assert!(
        gradients.means[..20] == alone.means,
        "{}: the others",
        bench.name
    );

    more.opacity_logits[20] = T::from_f64(1e4);
    let (image, gradients) = bench.both_passes(&more, "logit 1e4");
    let darkest = image
        .transmittance
        .data()
        .iter()
        .fold(1.0, |m, t| t.to_f64().min(m));
    assert!(darkest < 0.0101, "{}: opaque, {darkest}", bench.name);
    let by_logit = gradients.opacity_logits[20].to_f64();
    assert!(
        by_logit.abs() < 1e-300,
        "{}: saturated, {by_logit}",
        bench.name
    );
    assert!(
        row_size(&gradients, 20) > 1e-3,
        "{}: but of colour",
        bench.name
    );
}

#[test]
fn extreme_logits() {
    for_each_form!(logits, camera(), pose());
}

fn nothing_to_draw<T: Real>(bench: &Bench<T>) {
    let empty = GaussianMap::<T>::new(3);
    let (image, gradients) = bench.both_passes(&empty, "empty");
    assert!(image.projected.is_empty(), "no splat");
    assert!(
        gradients.means.is_empty() && gradients.sh.is_empty(),
        "no rows"
    );
    assert!(gradients.pose == [T::ZERO; 6], "pose");
    let light = image.transmittance.data().iter().all(|t| *t == T::ONE);
    assert!(light, "{}: all light passes", bench.name);
}

fn one_pixel<T: Real>(bench: &Bench<T>) {
    nothing_to_draw(bench);
    let mut map = GaussianMap::<T>::new(3);
    for z in [0.1, 0.3, 1.0, 5.0, -2.0] {
        map.push(&ball(&bench.pose, [0.001, -0.002, z]));
    }
    map.push(&ball(&bench.pose, [40.0, 0.0, 1.0]));
    map.label[2] = Label::Dynamic;
    let (image, gradients) = bench.both_passes(&map, "one pixel");
    assert!(image.contributors[(0, 0)] >= 1, "{}: drawn", bench.name);
    assert!(
        row_size(&gradients, 1) > 1e-6,
        "{}: the nearest is visible",
        bench.name
    );
    for i in [0, 4, 5] {
        assert!(row_size(&gradients, i) < 1e-300, "{}: row {i}", bench.name);
    }
}

#[test]
fn empty_maps_and_one_pixel() {
    let dot = Camera::pinhole((1, 1), [20.0, 20.0, 0.0, 0.0]).expect("valid");
    for_each_form!(nothing_to_draw, camera(), pose());
    for_each_form!(one_pixel, dot, pose());
}

/// A bad upstream number at one pixel reaches the splats of that pixel and the pose, no other.
fn bad_upstream<T: Real>(bench: &Bench<T>) {
    let map = map(11, 60).cast::<T>();
    let clean = bench.upstream();
    let before = bench.gradients(&map, &clean);
    for value in [f64::NAN, f64::INFINITY] {
        let bad = T::from_f64(value);
        for which in ["color", "depth", "opacity"] {
            let mut up = clean.clone();
            let at = (33, 21);
            match which {
                "color" => up.color[at][1] = bad,
                "depth" => up.depth.as_mut().expect("given")[at] = bad,
                _ => up.opacity.as_mut().expect("given")[at] = bad,
            }
            let after = bench.gradients(&map, &up);
            let name = bench.name;
            assert!(after.pose.iter().all(|v| !v.is_finite()), "{name}: pose");
            let blended = bench.image(&map).contributors[at] as usize;
            let mut reached = 0;
            for i in 0..map.len() {
                if after.means[i] == before.means[i] && after.sh_row(i) == before.sh_row(i) {
                    continue;
                }
                reached += 1;
                let finite = after.means[i].iter().all(|v| v.is_finite());
                // A splat whose alpha is clamped has gradients by colour and depth only.
                assert!(
                    !finite || which != "opacity",
                    "{name}, {which} {value}: row {i}"
                );
            }
            assert!(
                reached > 0 && reached <= blended,
                "{name}, {which} {value}: {reached} rows of {blended} blended"
            );
        }
    }
}

trait ShRow<T> {
    fn sh_row(&self, i: usize) -> &[[T; 3]];
}
impl<T> ShRow<T> for Gradients<T> {
    fn sh_row(&self, i: usize) -> &[[T; 3]] {
        let k = self.sh.len() / self.means.len();
        &self.sh[i * k..(i + 1) * k]
    }
}

#[test]
fn bad_upstream_numbers_stay_with_their_pixel() {
    for_each_form!(bad_upstream, camera(), pose());
}

/// All at one depth, most of them at one place: rows decide the order, and turned round they
/// decide it the other way.
fn one_depth<T: Real>(bench: &Bench<T>) {
    let mut map = GaussianMap::<T>::new(1);
    let mut rng = Rng::new(2);
    for i in 0..90 {
        let aside = if i < 60 { 0.0 } else { rng.range(-0.5, 0.5) };
        let mut g = ball(&bench.pose, [aside, 0.5 * aside, 1.5]);
        g.opacity = T::from_f64(0.05);
        g.color = [0; 3].map(|_| T::from_f64(rng.uniform()));
        map.push(&g);
    }
    let (image, gradients) = bench.both_passes(&map, "one depth");
    let rows: Vec<u32> = image.projected.iter().map(|s| s.index).collect();
    assert!(rows.is_sorted(), "{}: {rows:?}", bench.name);
    assert_eq!(rows.len(), 90, "{}: all of them", bench.name);
    assert!(
        (0..60).all(|i| row_size(&gradients, i) > 0.0),
        "all of them have gradients"
    );
}

#[test]
fn equal_depths() {
    // Camera at the origin: depths are equal to the bit.
    for_each_form!(one_depth, camera(), Se3::default());
}

/// Numbers to try wherever a number stands.
const POISON: [f64; 20] = [
    0.0,
    -0.0,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    1e4,
    -1e4,
    1e-30,
    -1e-30,
    1e30,
    -1e30,
    1e-45,
    3.4e38,
    -3.4e38,
    1e300,
    1.0 / 255.0,
    0.2,
    69.0,
    -69.0,
    16.0,
];

/// Up to eight numbers of a map exchanged for poison, anywhere.
fn random_poison<T: Real>(bench: &Bench<T>, seed: u64) {
    let mut rng = Rng::keyed(seed, &[3]);
    let mut map = map(seed, 12).cast::<T>();
    for _ in 0..1 + rng.below(8) {
        let (i, bad) = (rng.below(12), T::from_f64(POISON[rng.below(POISON.len())]));
        match rng.below(5) {
            0 => map.means[i][rng.below(3)] = bad,
            1 => map.log_scales[i][rng.below(3)] = bad,
            2 => map.quaternions[i][rng.below(4)] = bad,
            3 => map.opacity_logits[i] = bad,
            _ => map.sh[4 * i + rng.below(4)][rng.below(3)] = bad,
        }
    }
    bench.both_passes(&map, &format!("seed {seed}"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_mixture_of_poisons_panics_or_spreads(seed in 0u64..1_000_000) {
        for_each_form!(random_poison, camera(), pose(), seed);
    }
}
