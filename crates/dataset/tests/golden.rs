//! Golden cases: real pixels as OpenCV reads them, pairs by the benchmark's rule, BONN poses by
//! scipy, a 3DGS file as its Python authors write it.

use std::path::{Path, PathBuf};

use garad_core::{Se3, So3, StampedPose};
use garad_dataset::ply::{format_ply, parse_ply};
use garad_dataset::{Dataset, OpenOptions, PlyOptions, associate, bonn_camera_from_marker};
use garad_golden::Case;
use nalgebra::Vector3;

fn check(case: &Case, name: &str, got: &[f64]) {
    if let Err(report) = case.check(name, got) {
        panic!("{report}");
    }
}

fn floats(values: impl IntoIterator<Item = f32>) -> Vec<f64> {
    values.into_iter().map(f64::from).collect()
}

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/tum_fr1_desk_9")
}

#[test]
fn decode() {
    let dataset = Dataset::open(&sample(), &OpenOptions::default()).expect("the sample");
    assert_eq!(dataset.len(), 9, "frames");
    assert_eq!(dataset.warnings(), [] as [String; 0], "nothing odd");
    assert_eq!(dataset.ground_truth().map(<[_]>::len), Some(226), "poses");
    for case in Case::load_all("decode") {
        let frame = dataset.read(case.param_usize("frame")).expect("whole");
        let step = case.param_usize("step");
        let (width, height) = frame.rgb.size();
        let (mut rgb, mut depth) = (Vec::new(), Vec::new());
        for y in (0..height).step_by(step) {
            for x in (0..width).step_by(step) {
                rgb.extend(frame.rgb[(x, y)].map(f64::from));
                depth.push(f64::from(frame.depth[(x, y)]));
            }
        }
        check(&case, "rgb", &rgb);
        check(&case, "depth", &depth);
        let mut sum = [0.0; 3];
        for pixel in frame.rgb.data() {
            for (s, &v) in sum.iter_mut().zip(pixel) {
                *s += f64::from(v);
            }
        }
        check(&case, "rgb_sum", &sum);
        let known = frame.depth.data().iter().filter(|&&d| d > 0.0);
        let raw = known.clone().map(|&d| (f64::from(d) * 5000.0).round());
        check(&case, "depth_raw_sum", &[raw.sum()]);
        check(
            &case,
            "depth_known",
            &[f64::from(u32::try_from(known.count()).expect("few"))],
        );
    }
}

#[test]
fn pairs() {
    for case in Case::load_all("associate") {
        let pairs = associate(
            &case.input("a").f64(),
            &case.input("b").f64(),
            case.param_f64("max_dt"),
        );
        let flat: Vec<f64> = pairs
            .into_iter()
            .flat_map(|(i, j)| [i, j])
            .map(|i| f64::from(u32::try_from(i).expect("small")))
            .collect();
        check(&case, "pairs", &flat);
    }
}

#[test]
fn bonn() {
    for case in Case::load_all("bonn") {
        let quaternions = case.input("quaternion_xyzw").f64();
        let positions = case.input("position").f64();
        let marker: Vec<StampedPose> = quaternions
            .chunks(4)
            .zip(positions.chunks(3))
            .map(|(q, p)| StampedPose {
                t_s: 0.0,
                world_from_camera: Se3::new(
                    So3::from_quaternion(q[3], q[0], q[1], q[2]).expect("unit length"),
                    Vector3::from_column_slice(p),
                ),
            })
            .collect();
        let (mut rotations, mut translations) = (Vec::new(), Vec::new());
        for pose in bonn_camera_from_marker(&marker) {
            let rows = pose.world_from_camera.rotation.matrix().transpose();
            rotations.extend(rows.iter().copied());
            translations.extend(pose.world_from_camera.translation.iter().copied());
        }
        check(&case, "rotation", &rotations);
        check(&case, "translation", &translations);
    }
}

#[test]
fn ply() {
    for case in Case::load_all("ply") {
        let file = case.input("file").u8();
        let map = parse_ply(Path::new("case.ply"), &mut &file[..]).expect("an ordinary file");
        check(&case, "means", &floats(map.means.iter().copied().flatten()));
        check(&case, "sh", &floats(map.sh.iter().copied().flatten()));
        check(&case, "opacity_logits", &floats(map.opacity_logits.clone()));
        check(
            &case,
            "log_scales",
            &floats(map.log_scales.iter().copied().flatten()),
        );
        check(
            &case,
            "quaternions",
            &floats(map.quaternions.iter().copied().flatten()),
        );
        // And written again: the vertices are the same bytes.
        let mut written = Vec::new();
        format_ply(&mut written, &map, &PlyOptions::default()).expect("memory");
        let vertices = &written[written.len() - map.len() * 248..];
        let bytes: Vec<f64> = vertices.iter().map(|&b| f64::from(b)).collect();
        check(&case, "vertices", &bytes);
    }
}
