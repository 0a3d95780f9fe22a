//! What the fast form in f32 loses against the reference in f64, both ways, on scenes as a map has
//! them: within a few times what f32 costs a plain rewrite of the same formulas.

mod common;

use common::{GRADIENT_COST, column, flat, narrow, tensors};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, NewGaussian, Par, Real, Rng, Se3, So3};
use garad_raster::{Gradients, RenderOptions, Rendered, Upstream, backward, fast, render};
use nalgebra::{Vector2, Vector3};

/// What may be lost, in units of the cost: 8 would still be as good as f32 gets, here it is 1.7.
const TIMES: f64 = 4.0;

/// Degree 3, centimetres to decimetres at 1 to 5 m, turned at random.
fn scene(seed: u64, n: usize, camera: &Camera, pose: &Se3) -> GaussianMap<f32> {
    let mut rng = Rng::keyed(seed, &[4]);
    let mut map = GaussianMap::new(3);
    for i in 0..n {
        let z = rng.range(1.0, 5.0);
        let (w, h) = (camera.width as f64, camera.height as f64);
        let uv = Vector2::new(rng.range(-0.05, 1.05) * w, rng.range(-0.05, 1.05) * h);
        let mean = pose.inverse() * camera.unproject(&uv, z);
        map.push(&NewGaussian {
            mean: [mean.x, mean.y, mean.z].map(Real::to_f32),
            sigma_m: (0.03 * z).to_f32(),
            opacity: rng.range(0.1, 0.95).to_f32(),
            color: [0; 3].map(|_| rng.uniform().to_f32()),
            landmark: None,
            born: KeyframeId(0),
        });
        map.quaternions[i] = [0; 4].map(|_| rng.normal().to_f32());
        for scale in &mut map.log_scales[i] {
            *scale += (0.5 * rng.normal()).to_f32();
        }
        for triple in &mut map.sh[16 * i + 1..16 * (i + 1)] {
            *triple = [0; 3].map(|_| (0.05 * rng.normal()).to_f32());
        }
    }
    map
}

/// Normal numbers where both images blend the same splats, 0 elsewhere; and which these are.
fn upstream(seed: u64, a: &Rendered<f32>, b: &Rendered<f64>) -> (Upstream<f64>, Vec<bool>) {
    let mut rng = Rng::keyed(seed, &[5]);
    let (w, h) = a.color.size();
    let mut kept = Vec::new();
    let mut up = Upstream {
        color: Image::new(w, h, [0.0; 3]),
        depth: Some(Image::new(w, h, 0.0)),
        opacity: Some(Image::new(w, h, 0.0)),
    };
    for at in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        let same = a.contributors[at] == b.contributors[at] && a.last[at] == b.last[at];
        kept.push(same);
        if !same {
            continue;
        }
        // Rounded first: both are asked for the same.
        let mut normal = || f64::from(rng.normal().to_f32());
        up.color[at] = [normal(), normal(), normal()];
        for image in [&mut up.depth, &mut up.opacity] {
            image.as_mut().expect("given")[at] = normal();
        }
    }
    (up, kept)
}

/// A tensor, what f32 costs it as largest difference by largest value, its numbers.
type Row = (&'static str, f64, Vec<f64>);

/// Images and splats. `kept` marks the pixels that are compared.
fn forward<T: Real>(p: &Rendered<T>, kept: &[bool]) -> Vec<Row> {
    let only = |values: Vec<f64>| -> Vec<f64> {
        let per_pixel = values.len() / kept.len();
        let mut values = values;
        for (value, i) in values.iter_mut().zip(0..) {
            if !kept[i / per_pixel] {
                *value = 0.0;
            }
        }
        values
    };
    let s = &p.projected;
    let of = |f: fn(&garad_raster::Projected<T>) -> [T; 3]| -> Vec<f64> {
        s.iter().flat_map(f).map(T::to_f64).collect()
    };
    vec![
        ("color", 6.8e-6, only(flat(p.color.data()))),
        ("depth", 6.6e-6, only(column(p.depth.data()))),
        (
            "transmittance",
            7.0e-6,
            only(column(p.transmittance.data())),
        ),
        (
            "mean_px",
            2.6e-7,
            s.iter().flat_map(|s| s.mean_px).map(T::to_f64).collect(),
        ),
        (
            "depth_m",
            1.3e-7,
            s.iter().map(|s| s.depth_m.to_f64()).collect(),
        ),
        ("conic", 5.7e-7, of(|s| s.conic)),
    ]
}

fn gradients<T: Real>(g: &Gradients<T>) -> Vec<Row> {
    let rows = tensors(g).into_iter().zip(GRADIENT_COST);
    rows.map(|((name, values), cost)| (name, cost, values))
        .collect()
}

/// 1 - cos of the angle between two tensors costs f32 1e-10.
const COSINE: f64 = 9.8e-11;

fn assert_within(seed: u64, got: Vec<Row>, want: Vec<Row>) {
    for ((name, cost, a), (_, _, b)) in got.into_iter().zip(want) {
        let largest = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let pairs = || a.iter().zip(&b);
        let worst = pairs().fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / largest;
        let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        // |a - b|² of unit vectors is twice 1 - cos, without its cancellation.
        let (na, nb) = (dot(&a, &a).sqrt(), dot(&b, &b).sqrt());
        let turn: f64 = pairs()
            .map(|(a, b)| (a / na - b / nb) * (a / na - b / nb))
            .sum();
        assert!(worst > 0.0, "scene {seed}, {name}: f32 is not f64");
        assert!(
            worst < TIMES * cost,
            "scene {seed}, {name}: off by {worst:e} of the largest, {:.1} times the cost",
            worst / cost
        );
        assert!(
            turn < 2.0 * TIMES * COSINE,
            "scene {seed}, {name}: turned by {turn:e}"
        );
    }
}

#[test]
fn fast_f32_against_the_reference_in_f64() {
    let camera = Camera::pinhole((128, 96), [140.0, 138.0, 61.3, 50.2]).expect("valid");
    let turn = So3::exp(&Vector3::new(0.2, -0.3, 0.1));
    let pose = Se3::new(turn, Vector3::new(0.1, -0.2, 0.3));
    let options = RenderOptions {
        background: [0.1, 0.2, 0.3],
        ..RenderOptions::default()
    };
    for seed in 0..4 {
        let map = scene(seed, 800, &camera, &pose);
        let wide_map = map.cast::<f64>();
        let ours = fast::render(&map, &camera, &pose, &options, Par::Threads(2)).expect("drawn");
        let exact = render(&wide_map, &camera, &pose, &options, Par::Threads(2)).expect("drawn");
        assert_eq!(ours.radii, exact.radii, "scene {seed}: radii");
        let (up, kept) = upstream(seed, &ours, &exact);
        let lost = kept.iter().filter(|kept| !**kept).count();
        assert!(
            lost * 200 < kept.len(),
            "scene {seed}: {lost} pixels at a cut"
        );
        assert_within(seed, forward(&ours, &kept), forward(&exact, &kept));

        let par = Par::Threads(2);
        let ours = fast::backward(&map, &camera, &pose, &options, &ours, &narrow(&up), par)
            .expect("gradients");
        let exact =
            backward(&wide_map, &camera, &pose, &options, &exact, &up, par).expect("gradients");
        assert_within(seed, gradients(&ours), gradients(&exact));
    }
}
