//! One recording in every layout that is read, run to the end.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use garad_core::{Se3, StampedPose};
use garad_dataset::read_trajectory;
use image::{ImageBuffer, Luma};

use crate::support::{Bench, arg, copy, garad, metrics, recording};

const FRAMES: usize = 8;
const CAMERA: [f64; 4] = [131.25, 131.25, 80.1875, 58.625];

/// The recording as TUM lists, in order of time.
struct Original {
    colour: Vec<std::path::PathBuf>,
    depth: Vec<std::path::PathBuf>,
    truth: Vec<StampedPose>,
}

impl Original {
    fn new() -> Self {
        let folder = recording("quiet_desk", FRAMES);
        let images = |sub: &str| {
            let entries = fs::read_dir(folder.join(sub)).expect("a folder");
            let mut files: Vec<_> = entries.map(|e| e.expect("an entry").path()).collect();
            files.sort();
            files
        };
        let camera = fs::read_to_string(folder.join("camera.txt")).expect("there");
        assert!(
            camera.contains("160 120 131.25 131.25 80.1875 58.625 5000 30"),
            "{camera}"
        );
        let (colour, depth) = (images("rgb"), images("depth"));
        let mut truth = read_trajectory(&folder.join("groundtruth.txt")).expect("poses");
        truth.truncate(FRAMES);
        assert_eq!(
            (colour.len(), depth.len(), truth.len()),
            (FRAMES, FRAMES, FRAMES),
            "as made"
        );
        Self {
            colour,
            depth,
            truth,
        }
    }

    /// Copies the images to `names(i)`, depth as it is (5000 a metre) or in millimetres.
    fn images(&self, rec: &Path, millimetres: bool, names: impl Fn(usize) -> [String; 2]) {
        for i in 0..FRAMES {
            let [colour, depth] = names(i).map(|name| rec.join(name));
            for file in [&colour, &depth] {
                fs::create_dir_all(file.parent().expect("a folder")).expect("made");
            }
            if colour.extension().is_some_and(|e| e == "jpg") {
                let image = image::open(&self.colour[i]).expect("a PNG").into_rgb8();
                let file = fs::File::create(&colour).expect("made");
                let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(file, 95);
                image.write_with_encoder(encoder).expect("written");
            } else {
                fs::copy(&self.colour[i], &colour).expect("copied");
            }
            let raw = image::open(&self.depth[i]).expect("a PNG").into_luma16();
            let divisor = if millimetres { 5 } else { 1 };
            let image: ImageBuffer<Luma<u16>, Vec<u16>> =
                ImageBuffer::from_fn(raw.width(), raw.height(), |x, y| {
                    Luma([raw.get_pixel(x, y)[0] / divisor])
                });
            image.save(&depth).expect("saved");
        }
    }

    /// Rows of the poses' matrices, numbers separated by `within`, rows by `between`.
    fn matrices(
        &self,
        within: &str,
        between: &str,
        of: impl Fn(&Se3) -> nalgebra::Matrix4<f64>,
    ) -> Vec<String> {
        let text = |pose: &StampedPose| {
            let m = of(&pose.world_from_camera);
            let row = |r: usize| {
                let numbers: Vec<String> = (0..4).map(|c| format!("{}", m[(r, c)])).collect();
                numbers.join(within)
            };
            (0..4).map(row).collect::<Vec<_>>().join(between)
        };
        self.truth.iter().map(text).collect()
    }
}

fn opencv(pose: &Se3) -> nalgebra::Matrix4<f64> {
    pose.matrix()
}

type Make = fn(&Original, &Path);

const LAYOUTS: [(&str, Make); 7] = [
    ("TUM or BONN", |_, rec| {
        copy(&recording("quiet_desk", FRAMES), rec)
    }),
    ("ICL-NUIM or ORB-SLAM", |original, rec| {
        original.images(rec, false, |i| {
            [format!("rgb/{i}.png"), format!("depth/{i}.png")]
        });
        let line = |i: usize| format!("{i} depth/{i}.png {i} rgb/{i}.png\n");
        write(
            rec,
            "associations.txt",
            (0..FRAMES).map(line).collect::<String>(),
        );
        let folder = recording("quiet_desk", FRAMES);
        for name in ["groundtruth.txt", "camera.txt"] {
            fs::copy(folder.join(name), rec.join(name)).expect("copied");
        }
    }),
    ("Replica, as NICE-SLAM ships it", |original, rec| {
        original.images(rec, false, |i| {
            [
                format!("results/frame{i:06}.jpg"),
                format!("results/depth{i:06}.png"),
            ]
        });
        write(
            rec,
            "traj.txt",
            original.matrices(" ", " ", opencv).join("\n"),
        );
        let [fx, fy, cx, cy] = CAMERA;
        let camera = format!(
            r#"{{"camera": {{"w": 160, "h": 120, "fx": {fx}, "fy": {fy}, "cx": {cx}, "cy": {cy}, "scale": 5000}}}}"#
        );
        write(rec, "../cam_params.json", camera);
    }),
    ("ScanNet export", |original, rec| {
        original.images(rec, true, |i| {
            [format!("color/{i}.jpg"), format!("depth/{i}.png")]
        });
        for (i, matrix) in original.matrices(" ", "\n", opencv).iter().enumerate() {
            write(rec, &format!("pose/{i}.txt"), matrix);
        }
        let [fx, fy, cx, cy] = CAMERA;
        let matrix = format!("{fx} 0 {cx} 0\n0 {fy} {cy} 0\n0 0 1 0\n0 0 0 1\n");
        write(rec, "intrinsic/intrinsic_depth.txt", matrix);
    }),
    ("7-Scenes", |original, rec| {
        original.images(rec, true, |i| {
            ["color", "depth"].map(|kind| format!("frame-{i:06}.{kind}.png"))
        });
        for (i, matrix) in original.matrices("\t ", "\n", opencv).iter().enumerate() {
            write(rec, &format!("frame-{i:06}.pose.txt"), matrix);
        }
        // The data set's own camera has 640x480 pixels.
        write(
            rec,
            "camera.txt",
            "160 120 131.25 131.25 80.1875 58.625 1000 30\n",
        );
    }),
    ("nerfstudio or Polycam", |original, rec| {
        let names = |i: usize| [format!("images/{i}.png"), format!("depth/{i}.png")];
        original.images(rec, true, names);
        let axes = nalgebra::Vector4::new(1.0, -1.0, -1.0, 1.0);
        let opengl = |pose: &Se3| pose.matrix() * nalgebra::Matrix4::from_diagonal(&axes);
        let frames: Vec<String> = original
            .matrices(", ", "], [", opengl)
            .iter()
            .enumerate()
            .map(|(i, matrix)| {
                let [colour, depth] = names(i);
                format!(
                    r#"{{"file_path": "{colour}", "depth_file_path": "{depth}", "transform_matrix": [[{matrix}]]}}"#
                )
            })
            .collect();
        let [fx, fy, cx, cy] = CAMERA;
        let (cx, cy) = (cx + 0.5, cy + 0.5);
        let text = format!(
            r#"{{"w": 160, "h": 120, "fl_x": {fx}, "fl_y": {fy}, "cx": {cx}, "cy": {cy}, "frames": [{}]}}"#,
            frames.join(",\n")
        );
        write(rec, "transforms.json", text);
    }),
    ("Open3D or RealSense recorder", |original, rec| {
        original.images(rec, true, |i| {
            [format!("color/{i:06}.jpg"), format!("depth/{i:06}.png")]
        });
        let mut log = String::new();
        for (i, matrix) in original.matrices(" ", "\n", opencv).iter().enumerate() {
            writeln!(log, "{i} {i} {}\n{matrix}", i + 1).expect("memory takes everything");
        }
        write(rec, "trajectory.log", log);
        let [fx, fy, cx, cy] = CAMERA;
        let camera = format!(
            r#"{{"width": 160, "height": 120, "intrinsic_matrix": [{fx}, 0, 0, 0, {fy}, 0, {cx}, {cy}, 1]}}"#
        );
        write(rec, "camera_intrinsic.json", camera);
    }),
];

fn write(rec: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = rec.join(name);
    fs::create_dir_all(path.parent().expect("a folder")).expect("made");
    fs::write(path, bytes).expect("written");
}

#[test]
fn every_layout_runs_to_the_end() {
    let original = Original::new();
    for (layout, make) in LAYOUTS {
        let bench = Bench::empty();
        make(&original, &bench.rec());
        let (rec, out) = (bench.rec(), bench.out());
        let answer = garad(["run", arg(&rec), "-o", arg(&out), "--without", "mapping"]).succeeds();
        let first = answer.out.lines().next().unwrap_or_default();
        let words = format!("rec: {FRAMES} frames, layout {layout}, camera from ");
        assert!(first.starts_with(&words), "{first}, expected {words}");
        assert!(!answer.err.contains("warning"), "{answer:?}");
        let metrics = metrics(&out);
        assert_eq!(metrics["tracked"], FRAMES, "{layout}: {metrics}");
        let rmse_m = metrics["ate"]["rmse_m"].as_f64().expect("a true path");
        assert!(rmse_m < 0.005, "{layout}: {rmse_m} m");
    }
}
