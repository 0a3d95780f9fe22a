//! `garad render`: images of a map, and a check that poses, camera and map agree on conventions.

use std::fs;
use std::path::{Path, PathBuf};

use garad_core::Real;
use image::RgbImage;

use crate::support::{Answer, Bench, arg, files, garad, long, run_into};

/// The map of [`long`], and the poses it was made with.
pub(crate) fn mapped() -> Bench {
    let bench = Bench::empty();
    run_into(long(), &bench.out(), &[]).succeeds();
    bench
}

pub(crate) fn render(map: &Path, to: &Path, options: &[&str]) -> Answer {
    let calibration = long().join("camera.txt");
    let command = ["render", arg(map), "-o", arg(to), "--quiet"];
    let camera = ["--calibration", arg(&calibration)];
    garad(command.iter().chain(&camera).chain(options))
}

fn read_image(path: PathBuf) -> RgbImage {
    image::open(path).expect("an image").to_rgb8()
}

/// Peak signal-to-noise ratio in dB over all three colours.
fn psnr_db(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions(), "size");
    let squares = a
        .iter()
        .zip(b.iter())
        .map(|(x, y)| f64::from(x.abs_diff(*y)));
    let mean = squares.map(|d| d * d).sum::<f64>() / a.len() as f64;
    10.0 * Real::ln(255.0 * 255.0 / mean) / std::f64::consts::LN_10
}

/// The poses of a trajectory as written: time, and the rest of the line.
fn poses(path: &Path) -> Vec<(String, String)> {
    let text = fs::read_to_string(path).expect("a trajectory");
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let pair = lines.map(|line| line.split_once(' ').expect("time and pose"));
    pair.map(|(time, pose)| (time.to_owned(), pose.to_owned()))
        .collect()
}

#[test]
fn images_along_a_trajectory_and_from_a_pose() {
    let bench = mapped();
    let (map, path) = (
        bench.out().join("map.ply"),
        bench.out().join("trajectory.txt"),
    );
    let all = bench.path("all");
    let what = ["--what", "color", "--what", "depth", "--what", "opacity"];
    let trajectory = ["--trajectory", arg(&path), "--every", "13"];
    render(&map, &all, &[&what[..], &trajectory].concat()).succeeds();
    let mut names: Vec<_> = files(&all).into_iter().collect();
    assert_eq!(
        names.pop().as_deref(),
        Some("garad_files.txt"),
        "their list"
    );
    let expected: Vec<String> = (0..4)
        .flat_map(|i| ["color", "depth", "opacity"].map(|what| format!("{i:06}_{what}.png")))
        .collect();
    assert_eq!(names, expected, "every 13th of 40 poses, three of each");
    for name in &names {
        let size = read_image(all.join(name)).dimensions();
        assert_eq!(size, (160, 120), "{name}");
    }
    // The same pose by hand, on other numbers of threads: the same bytes.
    let (_, pose) = &poses(&path)[13];
    for threads in ["1", "3"] {
        let one = bench.path("one");
        render(&map, &one, &["--pose", pose, "--threads", threads]).succeeds();
        let bytes = |path: PathBuf| fs::read(path).expect("an image");
        let same = bytes(one.join("000000_color.png")) == bytes(all.join("000001_color.png"));
        assert!(same, "{threads} thread(s)");
    }
}

/// From the pose of the first keyframe the map looks like its image. Later, the estimated pose explains
/// the image better than no motion at all, and far better than its inverse: this distinguishes
/// `world_from_camera` from `camera_from_world` in every file in between.
#[test]
fn the_map_looks_like_the_recorded_images() {
    let bench = mapped();
    let map = bench.out().join("map.ply");
    let input = |time: &str| read_image(long().join(format!("rgb/{time}.png")));
    let seen_from = |pose: &str| {
        let to = bench.path("view");
        render(&map, &to, &["--pose", pose]).succeeds();
        read_image(to.join("000000_color.png"))
    };
    let (time, pose) = &poses(&bench.out().join("keyframes.txt"))[0];
    let first = psnr_db(&seen_from(pose), &input(time));
    assert!(first > 15.0, "first keyframe: {first} dB");

    let (time, pose) = &poses(&bench.out().join("trajectory.txt"))[25];
    let truth = input(time);
    let number: Vec<f64> = pose
        .split(' ')
        .map(|v| v.parse().expect("a number"))
        .collect();
    let quaternion: [f64; 4] = number[3..].try_into().expect("four");
    let position: [f64; 3] = number[..3].try_into().expect("three");
    let right = psnr_db(&seen_from(pose), &truth);
    let still = psnr_db(&seen_from("0 0 0 0 0 0 1"), &truth);
    let inverse = psnr_db(&seen_from(&inverse(position, quaternion)), &truth);
    assert!(right > 15.0, "frame 25: {right} dB");
    assert!(right > still + 1.0, "{right} dB, without motion {still} dB");
    assert!(
        right > inverse + 2.0,
        "{right} dB, inverse pose {inverse} dB"
    );
}

/// R^T and -R^T t, with the rotation written out as q* v q.
fn inverse(t: [f64; 3], [x, y, z, w]: [f64; 4]) -> String {
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let u = [-x, -y, -z];
    let once = cross(u, t);
    let twice = cross(u, once);
    let v: Vec<f64> = (0..3)
        .map(|i| -(t[i] + 2.0 * (w * once[i] + twice[i])))
        .collect();
    format!("{} {} {} {} {} {} {w}", v[0], v[1], v[2], -x, -y, -z)
}

/// Nothing is labelled dynamic in a map made without labels.
#[test]
fn a_selection_of_gaussians() {
    let bench = mapped();
    let map = bench.out().join("map.ply");
    let view = |include: &str| {
        let to = bench.path(include);
        let what = [
            "--what",
            "opacity",
            "--include",
            include,
            "--pose",
            "0 0 0 0 0 0 1",
        ];
        render(&map, &to, &what).succeeds();
        read_image(to.join("000000_opacity.png"))
    };
    assert!(view("dynamic").iter().all(|v| *v == 0), "nothing moves");
    assert!(view("all") == view("static"), "everything is static");
    assert!(view("all").iter().any(|v| *v > 200), "something is there");
}

#[test]
fn mistakes_are_reported() {
    let bench = mapped();
    let map = bench.out().join("map.ply");
    let camera = bench.path("camera.txt");
    let empty = bench.path("empty.txt");
    fs::write(&empty, "# nothing\n").expect("written");
    fs::write(&camera, "160 120 131 131 80\n").expect("written");
    let out = bench.path("images");
    let (map, out) = (arg(&map), arg(&out));
    let right = ["render", map, "-o", out];
    let pose = ["--pose", "0 0 0 0 0 0 1"];
    let cases: &[(&[&str], &[&str])] = &[
        (
            &["--preset", "fr1", "--pose", "0 0 0 0 0 0"],
            &["6 numbers", "qx qy qz qw"],
        ),
        (
            &["--preset", "fr1", "--pose", "0 0 0 0 0 0 0"],
            &["quaternion"],
        ),
        (
            &["--preset", "fr1", "--pose", "0 0 x 0 0 0 1"],
            &["`x` is not a number"],
        ),
        (
            &["--preset", "fr1", "--pose", "inf 0 0 0 0 0 1"],
            &["not finite"],
        ),
        (&["--preset", "fr1"], &["--pose", "--trajectory"]),
        (
            &["--preset", "fr1", "--trajectory", arg(&empty)],
            &["empty.txt: holds no pose"],
        ),
        (
            &["--preset", "fr1", "--trajectory", arg(&camera)],
            &["camera.txt:1: ", "5 columns"],
        ),
        (
            &["--calibration", arg(&camera), pose[0], pose[1]],
            &["camera.txt:1: ", "5 numbers"],
        ),
        (&pose, &["--preset", "--calibration"]),
        (
            &["--calibration", "none.txt", pose[0], pose[1]],
            &["none.txt: not found", "a calibration"],
        ),
        (
            &["--calibration", out, "--preset", "fr1"],
            &["cannot be used with"],
        ),
    ];
    for (options, words) in cases {
        garad(right.iter().chain(*options)).fails_with(words);
    }
    assert!(!Path::new(out).exists(), "nothing was drawn");
}
