//! The forward pass against a dense renderer written independently (`tests/golden/gen/raster.py`).

use garad_core::{Camera, GaussianMap, Image, KeyframeId, Label, Par, Real, Se3, So3};
use garad_golden::{Case, compare::compare, tol};
use garad_raster::{RenderOptions, Rendered, render};
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
            ..RenderOptions::default()
        },
    }
}

fn draw<T: Real>(scene: &Scene) -> Rendered<T> {
    render(
        &scene.map.cast::<T>(),
        &scene.camera,
        &scene.pose,
        &scene.options,
        Par::Seq,
    )
    .expect("a picture")
}

/// Every output under the name it has in `case.json`.
fn outputs<T: Real>(picture: &Rendered<T>) -> Vec<(&'static str, Vec<f64>)> {
    let reals = |image: &Image<T>| image.data().iter().map(|v| v.to_f64()).collect();
    let counts = |image: &Image<u32>| image.data().iter().map(|&v| f64::from(v)).collect();
    let splats = &picture.projected;
    let triples = |f: fn(&garad_raster::Projected<T>) -> [T; 3]| {
        splats.iter().flat_map(f).map(T::to_f64).collect()
    };
    vec![
        (
            "color",
            picture
                .color
                .data()
                .iter()
                .flatten()
                .map(|v| v.to_f64())
                .collect(),
        ),
        ("depth", reals(&picture.depth)),
        ("transmittance", reals(&picture.transmittance)),
        ("contributors", counts(&picture.contributors)),
        ("last", counts(&picture.last)),
        (
            "radii",
            picture.radii.iter().map(|&r| f64::from(r)).collect(),
        ),
        ("order", splats.iter().map(|s| f64::from(s.index)).collect()),
        (
            "mean_px",
            splats
                .iter()
                .flat_map(|s| s.mean_px)
                .map(T::to_f64)
                .collect(),
        ),
        (
            "depth_m",
            splats.iter().map(|s| s.depth_m.to_f64()).collect(),
        ),
        ("conic", triples(|s| s.conic)),
        ("splat_color", triples(|s| s.color)),
    ]
}

#[test]
fn forward_in_f64() {
    for case in Case::load_all("raster") {
        for (name, got) in outputs(&draw::<f64>(&scene(&case))) {
            case.check(name, &got)
                .unwrap_or_else(|report| panic!("{report}"));
        }
    }
}

/// Tight where no cut is near; elsewhere a splat may cross one.
#[test]
fn forward_in_f32() {
    for case in Case::load_all("raster") {
        let scene = scene(&case);
        let robust = case.input("robust").u8();
        for (name, mut got) in outputs(&draw::<f32>(&scene)) {
            let expected = case.output(name);
            let per_pixel = got.len() / robust.len();
            match name {
                "color" | "depth" | "transmittance" => {
                    let flips = tol::find("raster.f32.flips").expect("in the table");
                    let all = compare(expected, &got, flips).expect("same count");
                    assert!(all.passed, "{} '{name}', all pixels: {all}", case.name());
                    for (i, e) in expected.f64().into_iter().enumerate() {
                        if robust[i / per_pixel] == 0 {
                            got[i] = e;
                        }
                    }
                }
                // A count that differs where a cut is near is what the cut is for.
                "contributors" | "last" => {
                    for (i, e) in expected.f64().into_iter().enumerate() {
                        if robust[i] == 0 {
                            got[i] = e;
                        }
                    }
                }
                _ => {}
            }
            let tolerance = match name {
                "splat_color" => "raster.f32.color".to_owned(),
                "contributors" | "last" | "radii" | "order" => "exact".to_owned(),
                _ => format!("raster.f32.{name}"),
            };
            let tolerance = tol::find(&tolerance).expect("in the table");
            let verdict = compare(expected, &got, tolerance).expect("same count");
            assert!(verdict.passed, "{} '{name}': {verdict}", case.name());
        }
    }
}
