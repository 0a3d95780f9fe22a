//! The same three frames and poses in every layout, in folders and archives.

use std::fs::{self, File};
use std::io::Write;
use std::path::PathBuf;

use garad_dataset::{Calibration, Dataset, DatasetError, OpenOptions};
use image::{ImageBuffer, ImageFormat, Luma, Rgb};
use nalgebra::Vector3;
use tempfile::TempDir;
use zip::write::SimpleFileOptions;

use crate::fixture::{SIZE, colour, raw_depth};

const CAMERA_TXT: &str = "8 6 10 11 3.5 2.5 1000 30\n";

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("temporary folder"))
    }

    /// The recording; its parent belongs to it, too.
    fn rec(&self) -> PathBuf {
        self.0.path().join("rec")
    }

    fn file(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.rec().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, bytes).expect("written");
    }

    fn png(&self, name: &str, image: impl Into<image::DynamicImage>) {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let image: image::DynamicImage = image.into();
        image
            .write_to(&mut bytes, ImageFormat::Png)
            .expect("encoded");
        self.file(name, bytes.into_inner());
    }

    /// Colour of frame i, each pixel `scale` times in x and y.
    fn rgb(&self, name: &str, i: u32, scale: u32) {
        let pixel = |x, y| Rgb(colour(i, x / scale, y / scale));
        self.png(
            name,
            ImageBuffer::from_fn(scale * SIZE.0, scale * SIZE.1, pixel),
        );
    }

    fn depth(&self, name: &str, i: u32) {
        let pixel = |x, y| Luma([raw_depth(i, x, y)]);
        self.png(name, ImageBuffer::from_fn(SIZE.0, SIZE.1, pixel));
    }

    /// Frames i = 0, 1, 2 by names of colour and depth.
    fn frames(&self, scale: u32, names: impl Fn(u32) -> [String; 2]) {
        for i in 0..3 {
            let [rgb, depth] = names(i);
            self.rgb(&rgb, i, scale);
            self.depth(&depth, i);
        }
    }

    fn open(&self) -> Result<Dataset, DatasetError> {
        Dataset::open(&self.rec(), &OpenOptions::default())
    }

    fn error(&self) -> String {
        let answer = self.open().and_then(|dataset| dataset.read(0));
        let message = answer.expect_err("refused").to_string();
        assert!(!message.contains('\n'), "one line: {message}");
        message
    }

    /// All files, with names relative to the parent of the recording.
    fn all(&self) -> Vec<(String, Vec<u8>)> {
        let (mut files, mut folders) = (Vec::new(), vec![self.0.path().to_path_buf()]);
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(self.0.path()).expect("inside");
                    let name = name.to_string_lossy().into_owned();
                    files.push((name, fs::read(path).expect("there")));
                }
            }
        }
        files
    }
}

/// A quarter turn about z, then (1.5 + i, -2.5, 3.5): rows of `world_from_camera`.
fn matrix(i: u32) -> String {
    let x = 1.5 + f64::from(i);
    format!("0 -1 0 {x}\n1 0 0 -2.5\n0 0 1 3.5\n0 0 0 1\n")
}

fn icl(folder: &Folder) {
    // Neither folder is named by what it holds.
    folder.frames(1, |i| {
        [format!("b/{}.png", i + 4), format!("a/{}.png", i + 4)]
    });
    folder.file(
        "associations.txt",
        "4 a/4.png 4 b/4.png\n5 a/5.png 5 b/5.png\n6 a/6.png 6 b/6.png\n",
    );
    let half = 0.5f64.sqrt();
    let pose = |i: u32| {
        format!(
            "{} {} 2.5 3.5 0 0 {} {half}\n",
            i + 4,
            1.5 + f64::from(i),
            -half
        )
    };
    folder.file(
        "livingRoom0.gt.freiburg",
        (0..3).map(pose).collect::<String>(),
    );
    folder.file("camera.txt", CAMERA_TXT);
}

fn orb_slam(folder: &Folder) {
    folder.frames(1, |i| [format!("rgb/{i}.png"), format!("depth/{i}.png")]);
    let line = |i: u32| format!("1.{i}0 rgb/{i}.png 1.{i}05 depth/{i}.png\n");
    folder.file("associate.txt", (0..3).map(line).collect::<String>());
    let half = 0.5f64.sqrt();
    let pose = |i: u32| format!("1.{i} {} -2.5 3.5 0 0 {half} {half}\n", 1.5 + f64::from(i));
    folder.file("groundtruth.txt", (0..3).map(pose).collect::<String>());
    folder.file("camera.txt", CAMERA_TXT);
}

fn replica(folder: &Folder) {
    folder.frames(1, |i| {
        [
            format!("results/frame00000{i}.jpg"),
            format!("results/depth00000{i}.png"),
        ]
    });
    let line = |i: u32| matrix(i).replace('\n', " ") + "\n";
    folder.file("traj.txt", (0..3).map(line).collect::<String>());
    folder.file(
        "../cam_params.json",
        r#"{"camera": {"w": 8, "h": 6, "fx": 10.0, "fy": 11.0, "cx": 3.5, "cy": 2.5, "scale": 6553.5}}"#,
    );
}

/// Every tenth frame; colour of twice the size; the second pose is lost.
fn scannet(folder: &Folder) {
    folder.frames(2, |i| {
        [
            format!("color/{}.jpg", 10 * i),
            format!("depth/{}.png", 10 * i),
        ]
    });
    for i in 0..3 {
        let lost = "-inf -inf -inf -inf\n".repeat(4);
        let pose = if i == 1 { lost } else { matrix(i) };
        folder.file(&format!("pose/{}.txt", 10 * i), pose);
    }
    folder.file(
        "intrinsic/intrinsic_depth.txt",
        "10.0 0.0 3.5 0.0\n0.0 11.0 2.5 0.0\n0.0 0.0 1.0 0.0\n0.0 0.0 0.0 1.0\n",
    );
}

fn seven_scenes(folder: &Folder) {
    let name = |i: u32, kind: &str| format!("frame-00000{i}.{kind}");
    folder.frames(1, |i| [name(i, "color.png"), name(i, "depth.png")]);
    for i in 0..3 {
        folder.file(&name(i, "pose.txt"), matrix(i).replace(' ', "\t "));
    }
    folder.file("camera.txt", CAMERA_TXT);
}

/// Out of order, one frame without depth, colour of twice the size; OpenGL's axes, pixel centres at halves.
fn nerfstudio(folder: &Folder) {
    let names = |i: u32| {
        [
            format!("images/{}.png", i + 8),
            format!("depth/{}.png", i + 8),
        ]
    };
    folder.frames(2, names);
    let frame = |i: u32| {
        let [rgb, depth] = names(i);
        let x = 1.5 + f64::from(i);
        format!(
            "{{\"file_path\": \"./{rgb}\", \"depth_file_path\": \"{depth}\",\n\"transform_matrix\": \
             [[0, 1, 0, {x}], [1, 0, 0, -2.5], [0, 0, -1, 3.5], [0, 0, 0, 1]]}}"
        )
    };
    let without = "{\"file_path\": \"images/20.png\", \"transform_matrix\": []}";
    let frames = [frame(2), frame(0), without.to_owned(), frame(1)].join(",\n");
    folder.file(
        "transforms.json",
        format!(
            "{{\"fl_x\": 20, \"fl_y\": 22, \"cx\": 8, \"cy\": 6, \"w\": 16, \"h\": 12,\n\"frames\": [\n{frames}]}}"
        ),
    );
}

fn open3d(folder: &Folder) {
    folder.frames(1, |i| {
        [format!("color/00000{i}.jpg"), format!("depth/00000{i}.png")]
    });
    let block = |i: u32| format!("{i} {i} {}\n{}", i + 1, matrix(i));
    folder.file("trajectory.log", (0..3).map(block).collect::<String>());
    folder.file(
        "camera_intrinsic.json",
        "{\"width\": 8, \"height\": 6, \"intrinsic_matrix\": [10, 0, 0, 0, 11, 0, 3.5, 2.5, 1]}",
    );
}

struct Case {
    make: fn(&Folder),
    layout: &'static str,
    /// Part of where the camera came from.
    source: &'static str,
    depth_factor: f64,
    times_s: [f64; 3],
    /// Time of the depth image less that of the colour image.
    delay_s: f64,
    /// Frames with a true pose.
    truth: &'static [u32],
    warnings: &'static [&'static str],
    notes: &'static [&'static str],
}

const STEPS: [f64; 3] = [0.0, 1.0 / 30.0, 2.0 / 30.0];
const BY_NUMBER: &str =
    "no time stamps: frames are at their number / 30 s, the fps of the calibration";

#[rustfmt::skip]
const CASES: [Case; 7] = [
    Case { make: icl, layout: "ICL-NUIM or ORB-SLAM", source: "camera.txt", depth_factor: 1000.0, times_s: STEPS, delay_s: 0.0,
        truth: &[0, 1, 2], warnings: &[], notes: &[
            "associations.txt: depth is in its first column, colour in its second",
            "associations.txt: times are frame numbers: frames are at (number - 4) / 30 s, the fps of the calibration",
            "livingRoom0.gt.freiburg: poses are reflected about the xz plane, as ICL-NUIM needs"] },
    Case { make: orb_slam, layout: "ICL-NUIM or ORB-SLAM", source: "camera.txt", depth_factor: 1000.0, times_s: [1.0, 1.1, 1.2],
        delay_s: 0.005, truth: &[0, 1, 2], warnings: &[], notes: &[] },
    Case { make: replica, layout: "Replica, as NICE-SLAM ships it", source: "cam_params.json", depth_factor: 6553.5,
        times_s: STEPS, delay_s: 0.0, truth: &[0, 1, 2], warnings: &[], notes: &[BY_NUMBER] },
    Case { make: scannet, layout: "ScanNet export", source: "intrinsic_depth.txt", depth_factor: 1000.0,
        times_s: [0.0, 1.0 / 3.0, 2.0 / 3.0], delay_s: 0.0, truth: &[0, 2], warnings: &[],
        notes: &[BY_NUMBER, "1 of 3 frames are marked as lost: no true pose there"] },
    Case { make: seven_scenes, layout: "7-Scenes", source: "camera.txt", depth_factor: 1000.0, times_s: STEPS, delay_s: 0.0,
        truth: &[0, 1, 2], warnings: &[], notes: &[BY_NUMBER] },
    Case { make: nerfstudio, layout: "nerfstudio or Polycam", source: "transforms.json, scaled from 16x12 to 8x6",
        depth_factor: 1000.0, times_s: STEPS, delay_s: 0.0, truth: &[0, 1, 2],
        warnings: &["1 of 4 frames have no depth_file_path; left out"],
        notes: &["no time stamps: frames are at their index / 30 s, the fps of the calibration"] },
    Case { make: open3d, layout: "Open3D or RealSense recorder", source: "camera_intrinsic.json", depth_factor: 1000.0,
        times_s: STEPS, delay_s: 0.0, truth: &[0, 1, 2], warnings: &[], notes: &[BY_NUMBER] },
];

#[track_caller]
fn check(dataset: &Dataset, case: &Case) {
    let what = case.layout;
    assert_eq!(dataset.layout(), case.layout, "layout");
    let Calibration {
        camera,
        depth_factor,
        fps,
        source,
        ..
    } = dataset.calibration();
    assert_eq!((camera.width, camera.height), (8, 6), "{what}: size");
    for (found, expected) in [
        (camera.fx, 10.0),
        (camera.fy, 11.0),
        (camera.cx, 3.5),
        (camera.cy, 2.5),
        (*depth_factor, case.depth_factor),
        (*fps, 30.0),
    ] {
        assert!(
            (found - expected).abs() < 1e-12,
            "{what}: {found}, expected {expected}"
        );
    }
    assert!(source.contains(case.source), "{what}: {source}");
    assert_eq!(dataset.warnings(), case.warnings, "{what}");
    assert_eq!(dataset.notes(), case.notes, "{what}");
    assert_eq!(dataset.len(), 3, "{what}: frames");
    let left_out = dataset.left_out().map(|out| (out.frames, out.why.as_str()));
    let alone =
        (case.layout == "nerfstudio or Polycam").then_some((1, "without a depth_file_path"));
    assert_eq!(
        (left_out, dataset.listed()),
        (alone, 3 + alone.map_or(0, |out| out.0)),
        "{what}"
    );
    for (i, t_s) in (0..).zip(case.times_s) {
        let frame = dataset.read(i as usize).expect("good");
        assert!((frame.t_s - t_s).abs() < 1e-12, "{what}: {}", frame.t_s);
        let delay_s = frame.depth_t_s - frame.t_s;
        assert!((delay_s - case.delay_s).abs() < 1e-9, "{what}: {delay_s}");
        assert_eq!(frame.rgb[(5, 2)], colour(i, 5, 2), "{what}: colour");
        let depth_m = f64::from(raw_depth(i, 5, 2)) / case.depth_factor;
        let found_m = f64::from(frame.depth[(5, 2)]);
        assert!((found_m - depth_m).abs() < 1e-6, "{what}: depth {found_m}");
    }
    let truth = dataset.ground_truth().expect("poses");
    assert_eq!(truth.len(), case.truth.len(), "{what}: poses");
    for (pose, &i) in truth.iter().zip(case.truth) {
        let t_s = dataset.timestamp(i as usize).expect("a frame");
        assert!((pose.t_s - t_s).abs() < 1e-12, "{what}: {}", pose.t_s);
        // The turn takes (1, 2, 3) to (-2, 1, 3).
        let p_world = pose.world_from_camera * Vector3::new(1.0, 2.0, 3.0);
        let expected = Vector3::new(f64::from(i) - 0.5, -1.5, 6.5);
        assert!((p_world - expected).amax() < 1e-9, "{what}: {p_world}");
    }
}

#[test]
fn every_layout_in_a_folder() {
    for case in &CASES {
        let folder = Folder::new();
        (case.make)(&folder);
        check(&folder.open().expect("good"), case);
    }
}

#[test]
fn every_layout_in_archives() {
    for case in &CASES {
        let folder = Folder::new();
        (case.make)(&folder);
        let outside = Folder::new();
        let [zip_path, tar_path] = ["a.zip", "a.tar"].map(|name| outside.0.path().join(name));
        let mut zip = zip::ZipWriter::new(File::create(&zip_path).expect("made"));
        let mut tar = tar::Builder::new(File::create(&tar_path).expect("made"));
        for (name, bytes) in folder.all() {
            let options = SimpleFileOptions::default();
            zip.start_file(name.as_str(), options).expect("started");
            zip.write_all(&bytes).expect("written");
            let mut header = tar::Header::new_ustar();
            header.set_size(bytes.len() as u64);
            header.set_mode(0o644);
            tar.append_data(&mut header, name.as_str(), &bytes[..])
                .expect("written");
        }
        zip.finish().expect("written");
        tar.finish().expect("written");
        for path in [zip_path, tar_path] {
            let dataset = Dataset::open(&path, &OpenOptions::default()).expect("good");
            assert_eq!(dataset.name(), "rec", "{}", path.display());
            check(&dataset, case);
        }
    }
}

/// The published cameras, of images of their size; 65535 is missing.
#[test]
fn cameras_of_data_sets() {
    let white = || ImageBuffer::from_pixel(640, 480, Rgb([255u8; 3]));
    let depth = || {
        ImageBuffer::from_fn(640, 480, |x, _| {
            Luma([if x == 0 { 65_535u16 } else { 2500 }])
        })
    };
    let folder = Folder::new();
    folder.png("frame-000007.color.png", white());
    folder.png("frame-000007.depth.png", depth());
    let dataset = folder.open().expect("good");
    let known = dataset.calibration();
    let camera = &known.camera;
    let numbers = [
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        known.depth_factor,
    ];
    assert_eq!(
        format!("{numbers:?}"),
        "[585.0, 585.0, 320.0, 240.0, 1000.0]",
        "7-Scenes"
    );
    assert_eq!(dataset.timestamp(0), Some(7.0 / 30.0), "its number");
    let frame = dataset.read(0).expect("good");
    assert_eq!(
        (frame.depth[(0, 9)], frame.depth[(1, 9)]),
        (0.0, 2.5),
        "millimetres"
    );
    assert!(dataset.ground_truth().is_none(), "no pose");

    let folder = Folder::new();
    folder.png("rgb/3.png", white());
    folder.png("depth/3.png", depth());
    folder.file("associations.txt", "3 depth/3.png 3 rgb/3.png\n");
    folder.file("traj1.gt.freiburg", "3 0 0 0 0 0 0 1\n");
    let dataset = folder.open().expect("good");
    let known = dataset.calibration();
    let camera = &known.camera;
    let numbers = [
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        known.depth_factor,
    ];
    assert_eq!(
        format!("{numbers:?}"),
        "[481.2, 480.0, 319.5, 239.5, 5000.0]",
        "ICL-NUIM"
    );
}

/// Frames that the options leave out keep the numbers of the others.
#[test]
fn a_part_keeps_its_times_and_poses() {
    for (make, t_s) in [
        (icl as fn(&Folder), 2.0 / 30.0),
        (scannet, 2.0 / 3.0),
        (nerfstudio, 2.0 / 30.0),
    ] {
        let folder = Folder::new();
        make(&folder);
        let options = OpenOptions {
            first_frame: 2,
            ..OpenOptions::default()
        };
        let dataset = Dataset::open(&folder.rec(), &options).expect("good");
        assert_eq!(
            (dataset.len(), dataset.timestamp(0)),
            (1, Some(t_s)),
            "the third"
        );
        let truth = dataset.ground_truth().expect("poses");
        let last = truth.last().expect("a pose");
        assert_eq!(last.t_s.to_bits(), t_s.to_bits(), "its pose");
        let x = last.world_from_camera.translation.x;
        assert!((x - 3.5).abs() < 1e-12, "{x}");
    }
}

/// The options come before the layout's camera, its fps and its depth factor.
#[test]
fn the_options_win_over_the_layout() {
    let folder = Folder::new();
    replica(&folder);
    folder.file("camera.txt", "8 6 20 21 3 2 2000 10\n");
    let dataset = folder.open().expect("good");
    assert_eq!(dataset.timestamp(2), Some(0.2), "10 frames a second");
    assert_eq!(
        dataset.calibration().camera.fy.to_bits(),
        21.0f64.to_bits(),
        "camera.txt"
    );
    let path = folder.0.path().join("other.txt");
    fs::write(&path, "8 6 30 31 3 2 4000 5\n").expect("written");
    let options = OpenOptions {
        calibration: Some(path),
        depth_factor: Some(500.0),
        ..OpenOptions::default()
    };
    let dataset = Dataset::open(&folder.rec(), &options).expect("good");
    assert_eq!(dataset.timestamp(2), Some(0.4), "5 frames a second");
    let frame = dataset.read(1).expect("good");
    assert!(
        (f64::from(frame.depth[(5, 2)]) - 2.41).abs() < 1e-6,
        "1205 / 500"
    );
}

type Damage = fn(&Folder);

#[test]
fn errors_have_file_line_and_what_was_expected() {
    let cases: [(&str, Damage, Damage, &[&str]); 18] = [
        (
            "nothing",
            |f| f.file("x.txt", ""),
            |_| (),
            &[
                "rec: a folder without rgb.txt",
                "rgb.txt and depth.txt (TUM or BONN)",
                "associations.txt",
                "frame-000000.color.png and",
            ],
        ),
        (
            "column",
            orb_slam,
            |f| f.file("associate.txt", "# c\n1 a 2\n"),
            &["associate.txt:2: ", "filename timestamp"],
        ),
        (
            "outside",
            orb_slam,
            |f| f.file("associate.txt", "1 a 2 ../b\n"),
            &["associate.txt:1: ", "`..`"],
        ),
        (
            "empty list",
            orb_slam,
            |f| f.file("associate.txt", "# c\n"),
            &["associate.txt: lists no image"],
        ),
        (
            "absent",
            icl,
            |f| fs::remove_file(f.rec().join("b/4.png")).expect("there"),
            &["frame 0: ", "b/4.png is absent", "associations.txt:1"],
        ),
        (
            "no camera",
            replica,
            |f| fs::remove_file(f.0.path().join("cam_params.json")).expect("there"),
            &["camera unknown", "cam_params.json in or above it"],
        ),
        (
            "JSON",
            replica,
            |f| f.file("../cam_params.json", "{\"camera\":\n{\"w\": 8}}"),
            &[
                "cam_params.json:2: found missing field `h`",
                "fx, fy, cx, cy, scale",
            ],
        ),
        (
            "focal length",
            replica,
            |f| {
                f.file("cam_params.json",
            r#"{"camera": {"w": 8, "h": 6, "fx": -1, "fy": 1, "cx": 3.5, "cy": 2.5, "scale": 1}}"#)
            },
            &["cam_params.json:1: camera fx is -1"],
        ),
        (
            "unit of depth",
            replica,
            |f| {
                f.file("cam_params.json",
            r#"{"camera": {"w": 8, "h": 6, "fx": 1, "fy": 1, "cx": 3.5, "cy": 2.5, "scale": 0}}"#)
            },
            &["cam_params.json:1: found 0 for the raw depth of a metre"],
        ),
        (
            "numbers",
            replica,
            |f| {
                for i in 0..3 {
                    fs::remove_file(f.rec().join(format!("results/depth00000{i}.png")))
                        .expect("there");
                }
                f.depth("results/depth000009.png", 1);
            },
            &[
                "3 colour images results/frameN and 1 depth images results/depthN, none of the same number",
            ],
        ),
        (
            "matrix",
            scannet,
            |f| f.file("intrinsic/intrinsic_depth.txt", "10 0 3.5\n"),
            &["intrinsic_depth.txt:1: found 1 rows", "fx 0 cx"],
        ),
        (
            "other view",
            scannet,
            |f| f.png("depth/0.png", ImageBuffer::from_pixel(8, 5, Luma([9u16]))),
            &[
                "frame 0: ",
                "depth/0.png: 8x5 pixels; expected 16x12 as in the colour image",
                "export both at one size",
            ],
        ),
        (
            "depth is larger",
            open3d,
            |f| {
                f.png(
                    "depth/000000.png",
                    ImageBuffer::from_pixel(16, 12, Luma([9u16])),
                )
            },
            &[
                "frame 0: ",
                "16x12 pixels; expected 8x6 as in the colour image",
            ],
        ),
        (
            "no depth",
            nerfstudio,
            |f| {
                f.file("transforms.json",
            "{\"fl_x\": 9, \"w\": 8, \"h\": 6, \"frames\": [\n\n{\"file_path\": \"a.png\", \"transform_matrix\": []}]}")
            },
            &[
                "transforms.json:3: found none of 1 frames with a depth_file_path",
                "RGB-D",
            ],
        ),
        (
            "fisheye",
            nerfstudio,
            |f| {
                f.file(
                    "transforms.json",
                    "{\"camera_model\": \"OPENCV_FISHEYE\", \"fl_x\": 9, \"frames\": []}",
                )
            },
            &["OPENCV_FISHEYE", "a pinhole camera"],
        ),
        (
            "no frame",
            nerfstudio,
            |f| f.file("transforms.json", "{\"fl_x\": 9, \"frames\": []}"),
            &["found no frame"],
        ),
        (
            "outside",
            nerfstudio,
            |f| {
                f.file("transforms.json",
            "{\"fl_x\": 9, \"w\": 8, \"h\": 6, \"frames\": [\n{\"file_path\": \"a.png\", \"depth_file_path\": \"../d.png\", \
             \"transform_matrix\": []}]}")
            },
            &["transforms.json:2: found name \"../d.png\""],
        ),
        (
            "matrix",
            open3d,
            |f| {
                f.file(
                    "camera_intrinsic.json",
                    "{\"width\": 8, \"height\": 6, \"intrinsic_matrix\": [1]}",
                )
            },
            &["camera_intrinsic.json:1: ", "fx, 0, 0, 0, fy"],
        ),
    ];
    for (name, make, damage, words) in cases {
        let folder = Folder::new();
        make(&folder);
        damage(&folder);
        let message = folder.error();
        for word in words {
            assert!(
                message.contains(word),
                "{name}: `{word}` is not in: {message}"
            );
        }
    }
}

#[test]
fn bad_poses_are_warnings_unless_strict() {
    let cases: [(Damage, &str, &str, usize, &str); 5] = [
        (
            replica,
            "traj.txt",
            "1 2 3\n",
            0,
            "traj.txt:1: found 3 numbers",
        ),
        (
            scannet,
            "pose/20.txt",
            "1 0 0 0\n0 1 0 0\n0 0 2 0\n0 0 0 1\n",
            1,
            "pose/20.txt:4: found a matrix",
        ),
        (
            seven_scenes,
            "frame-000001.pose.txt",
            "",
            2,
            "pose.txt:1: found 0 numbers",
        ),
        (
            open3d,
            "trajectory.log",
            "0 0\n1 0 0 0\n",
            0,
            "trajectory.log:1: found 2 lines",
        ),
        (
            open3d,
            "trajectory.log",
            "1 1 2\n1 0 0 0\n0 1 0\n0 0 1 0\n0 0 0 1\n",
            0,
            "trajectory.log:3: found 3 numbers in a row",
        ),
    ];
    for (make, file, text, poses, words) in cases {
        let folder = Folder::new();
        make(&folder);
        folder.file(file, text);
        let dataset = folder.open().expect("runs");
        let found = dataset.ground_truth().map_or(0, <[_]>::len);
        assert_eq!(found, poses, "{words}");
        let warning = &dataset.warnings()[0];
        assert!(warning.contains(words), "{words}: {warning}");
        let options = OpenOptions {
            strict: true,
            ..OpenOptions::default()
        };
        let error = Dataset::open(&folder.rec(), &options).expect_err("strict");
        assert!(error.to_string().contains(words), "{error}");
    }
}

/// Images without a partner are counted, a folder above recordings is named, TUM's lists come first.
#[test]
fn what_is_taken_for_what() {
    let folder = Folder::new();
    open3d(&folder);
    folder.rgb("color/000008.jpg", 0, 1);
    folder.depth("depth/000009.png", 0);
    folder.file("color/notes.txt", "");
    let dataset = folder.open().expect("good");
    let words = [
        "1 of 4 colour images have no depth image of their number",
        "1 of 4 depth images have no colour image of their number",
    ];
    assert_eq!(dataset.warnings(), words, "counted");
    assert_eq!(dataset.listed(), 4, "colour images");
    fs::rename(folder.rec().join("color"), folder.rec().join("image")).expect("moved");
    assert_eq!(
        folder.open().expect("good").len(),
        3,
        "image/ as well as color/"
    );

    let above = Dataset::open(folder.0.path(), &OpenOptions::default()).expect_err("above");
    let words = "rec is a recording (Open3D or RealSense recorder)";
    assert!(above.to_string().contains(words), "{above}");

    let folder = Folder::new();
    orb_slam(&folder);
    folder.file("rgb.txt", "1.0 rgb/0.png\n");
    assert_eq!(
        folder.open().expect("good").layout(),
        "ICL-NUIM or ORB-SLAM",
        "half of TUM"
    );
    folder.file("depth.txt", "1.0 depth/0.png\n");
    let dataset = folder.open().expect("good");
    assert_eq!(
        (dataset.layout(), dataset.len()),
        ("TUM or BONN", 1),
        "both lists"
    );
}

/// Colour alone at another size than its intrinsics' file says: that of the colour images, scaled.
#[test]
fn scannet_by_its_colour_camera() {
    let folder = Folder::new();
    scannet(&folder);
    fs::remove_file(folder.rec().join("intrinsic/intrinsic_depth.txt")).expect("there");
    folder.file("intrinsic/intrinsic_color.txt", "20 0 7.5\n0 24 4\n0 0 1\n");
    let dataset = folder.open().expect("good");
    let camera = &dataset.calibration().camera;
    let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
    assert_eq!(
        format!("{numbers:?}"),
        "[10.0, 12.0, 3.5, 1.75]",
        "half of it"
    );
    assert_eq!((camera.width, camera.height), (8, 6), "of depth");
}
