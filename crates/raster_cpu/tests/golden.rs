//! Both passes against a dense renderer written independently (`tests/golden/gen/raster.py`), the
//! backward pass through its derivatives by complex steps (`raster_backward.py`).

mod common;

use common::{Back, Draw, column, flat, tensors};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, Label, Par, Real, Se3, So3};
use garad_golden::judge::{Answers, Outcome, judge};
use garad_golden::{Case, Dtype, Tensor};
use garad_raster::{
    ClampGradient, Gradients, RenderOptions, Rendered, Upstream, backward, fast, render,
};
use nalgebra::Vector3;

struct Scene {
    map: GaussianMap<f64>,
    camera: Camera,
    pose: Se3,
    options: RenderOptions,
}

fn triple(v: &[f64]) -> [f64; 3] {
    [v[0], v[1], v[2]]
}

fn scene(case: &Case) -> Scene {
    let rows = |name: &str, width: usize| -> Vec<Vec<f64>> {
        case.input(name)
            .f64()
            .chunks(width)
            .map(<[f64]>::to_vec)
            .collect()
    };
    let mut map = GaussianMap::new(case.param_usize("sh_degree"));
    map.means = rows("means", 3).iter().map(|r| triple(r)).collect();
    map.log_scales = rows("log_scales", 3).iter().map(|r| triple(r)).collect();
    map.quaternions = rows("quaternions", 4)
        .iter()
        .map(|r| [r[0], r[1], r[2], r[3]])
        .collect();
    map.opacity_logits = case.input("opacity_logits").f64();
    map.sh = rows("sh", 3).iter().map(|r| triple(r)).collect();
    let n = map.len();
    map.landmark = vec![None; n];
    map.parent = vec![None; n];
    map.born = vec![KeyframeId(0); n];
    map.label = vec![Label::Static; n];
    let k = case.input("intrinsics").f64();
    let q = case.input("camera_from_world_q").f64();
    let t = case.input("camera_from_world_t").f64();
    Scene {
        map,
        camera: Camera::pinhole(
            (case.param_usize("width"), case.param_usize("height")),
            [k[0], k[1], k[2], k[3]],
        )
        .expect("a camera"),
        pose: Se3::new(
            So3::from_quaternion(q[0], q[1], q[2], q[3]).expect("a rotation"),
            Vector3::new(t[0], t[1], t[2]),
        ),
        options: RenderOptions {
            background: triple(&case.input("background").f64()),
            clamp_gradient: match case
                .param("clamp_gradient")
                .map(|_| case.param_str("clamp_gradient"))
            {
                None | Some("true") => ClampGradient::True,
                Some("pass_through") => ClampGradient::PassThrough,
                Some(other) => panic!("clamp_gradient {other}"),
            },
            ..RenderOptions::default()
        },
    }
}

/// Both implementations of f32.
const NARROW: [(&str, Draw<f32>, Back<f32>); 2] = [
    ("reference", render, backward),
    ("fast", fast::render, fast::backward),
];

fn draw<T: Real>(scene: &Scene, render: Draw<T>) -> Rendered<T> {
    render(
        &scene.map.cast::<T>(),
        &scene.camera,
        &scene.pose,
        &scene.options,
        Par::Seq,
    )
    .expect("an image")
}

/// Every output under the name it has in `case.json`.
fn outputs<T: Real>(image: &Rendered<T>) -> Vec<(&'static str, Vec<f64>)> {
    let counts = |image: &Image<u32>| image.data().iter().map(|&v| f64::from(v)).collect();
    let splats = &image.projected;
    let triples = |f: fn(&garad_raster::Projected<T>) -> [T; 3]| {
        splats.iter().flat_map(f).map(T::to_f64).collect()
    };
    let centres: Vec<[T; 2]> = splats.iter().map(|s| s.mean_px).collect();
    let depths: Vec<T> = splats.iter().map(|s| s.depth_m).collect();
    vec![
        ("color", flat(image.color.data())),
        ("depth", column(image.depth.data())),
        ("transmittance", column(image.transmittance.data())),
        ("contributors", counts(&image.contributors)),
        ("last", counts(&image.last)),
        ("radii", image.radii.iter().map(|&r| f64::from(r)).collect()),
        ("order", splats.iter().map(|s| f64::from(s.index)).collect()),
        ("mean_px", flat(&centres)),
        ("depth_m", column(&depths)),
        ("conic", triples(|s| s.conic)),
        ("splat_color", triples(|s| s.color)),
    ]
}

/// Judges numbers as those of a port that computes in `T`: in f32 tight where no cut is near, with a
/// budget of flips elsewhere.
fn check<T: Real>(
    case: &Case,
    by: &str,
    named: impl IntoIterator<Item = (&'static str, Vec<f64>)>,
) {
    let saved = |(name, values): (&str, Vec<f64>)| {
        let expected = case.output(name);
        let narrow = size_of::<T>() == 4 && expected.dtype() == Dtype::F64;
        let (dtype, bytes) = match narrow {
            true => {
                let single = values.iter().map(|v| v.to_f32().to_le_bytes());
                (Dtype::F32, single.flatten().collect())
            }
            false => {
                let double = values.iter().map(|v| v.to_le_bytes());
                (Dtype::F64, double.flatten().collect())
            }
        };
        let tensor = Tensor::from_bytes(dtype, expected.shape().to_vec(), bytes);
        (name.to_owned(), tensor.ok_or_else(|| "odd size".to_owned()))
    };
    let answers: Answers = named.into_iter().map(saved).collect();
    let verdict = judge(case, &answers, false);
    let worst = verdict.worst().map(|o| (&o.name, &o.comparison, &o.note));
    assert!(
        verdict.outcome == Outcome::Pass,
        "{} by {by}: {worst:?}",
        case.name()
    );
}

#[test]
fn forward_in_f64() {
    for case in Case::load_all("raster") {
        let image = draw::<f64>(&scene(&case), render);
        check::<f64>(&case, "reference", outputs(&image));
    }
}

#[test]
fn forward_in_f32() {
    let cases = Case::load_all("raster");
    for (case, (by, render, _)) in cases.iter().flat_map(|c| NARROW.map(|n| (c, n))) {
        check::<f32>(case, by, outputs(&draw(&scene(case), render)));
    }
}

fn gradients<T: Real>(case: &Case, render: Draw<T>, backward: Back<T>) -> Gradients<T> {
    let scene = scene(case);
    let (width, height) = (scene.camera.width, scene.camera.height);
    let image = |name: &str| {
        let values = case.input(name).f64();
        Image::from_fn(width, height, |x, y| T::from_f64(values[y * width + x]))
    };
    let d_color = case.input("upstream_color").f64();
    let upstream = Upstream {
        color: Image::from_fn(width, height, |x, y| {
            [0, 1, 2].map(|k| T::from_f64(d_color[3 * (y * width + x) + k]))
        }),
        depth: Some(image("upstream_depth")),
        opacity: Some(image("upstream_opacity")),
    };
    let (map, image) = (scene.map.cast::<T>(), draw(&scene, render));
    backward(
        &map,
        &scene.camera,
        &scene.pose,
        &scene.options,
        &image,
        &upstream,
        Par::Seq,
    )
    .expect("gradients")
}

#[test]
fn backward_in_f64() {
    for case in Case::load_all("raster_backward") {
        let found = gradients::<f64>(&case, render, backward);
        check::<f64>(&case, "reference", tensors(&found));
    }
}

#[test]
fn backward_in_f32() {
    let cases = Case::load_all("raster_backward");
    for (case, (by, render, backward)) in cases.iter().flat_map(|c| NARROW.map(|n| (c, n))) {
        check::<f32>(case, by, tensors(&gradients(case, render, backward)));
    }
}
