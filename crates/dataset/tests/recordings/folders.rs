//! Lists, pairs, calibration, ground truth.

use std::path::Path;

use garad_dataset::{Dataset, DatasetError, LeftOut, OpenOptions, Preset};

use crate::fixture::{Recording, colour, raw_depth};

/// The committed part of a TUM recording, which the golden stage `decode` reads.
#[test]
fn the_sample_is_whole() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/tum_fr1_desk_9");
    let dataset = Dataset::open(&sample, &OpenOptions::default()).expect("the sample");
    assert_eq!(dataset.len(), 9, "frames");
    assert_eq!(dataset.warnings(), [] as [String; 0], "nothing odd");
    assert_eq!(dataset.ground_truth().map(<[_]>::len), Some(226), "poses");
}

#[test]
fn a_good_recording_is_read() {
    let recording = Recording::new(3);
    let dataset = recording.open().expect("good");
    assert_eq!(dataset.len(), 3, "frames");
    assert_eq!(dataset.warnings(), [] as [String; 0], "nothing odd");
    assert!(
        dataset.calibration().source.contains("camera.txt"),
        "says so"
    );
    assert_eq!(dataset.ground_truth().map(<[_]>::len), Some(2), "poses");
    assert_eq!(dataset.timestamp(1), Some(1.1), "the colour image's time");
    assert_eq!(dataset.timestamp(3), None, "past the end");
    let frame = dataset.read(1).expect("good");
    assert_eq!(frame.id.index(), 1, "id");
    assert!((frame.t_s - 1.1).abs() < 1e-15, "the colour image's time");
    assert_eq!(frame.rgb[(5, 2)], colour(1, 5, 2), "colour");
    let metres = f32::from(raw_depth(1, 5, 2)) / 5000.0;
    assert!((frame.depth[(5, 2)] - metres).abs() < 1e-7, "depth");
    assert!(
        matches!(
            dataset.read(3),
            Err(DatasetError::NoSuchFrame {
                frame: 3,
                len: 3,
                ..
            })
        ),
        "end"
    );
}

#[test]
fn text_from_other_systems_is_accepted() {
    let recording = Recording::new(2);
    recording.write(
        "rgb.txt",
        b"\xEF\xBB\xBF# c\r\n1.00\trgb/1.00.png\r\n1.10  ./rgb/1.10.png \r\n",
    );
    let dataset = recording.open().expect("BOM, CRLF, tabs, spaces");
    assert_eq!(dataset.len(), 2, "frames");
    dataset.read(1).expect("the cleaned name leads to the file");
}

#[test]
fn bad_lists_are_reported() {
    let cases: [(&str, &[u8], &str); 11] = [
        ("rgb.txt", b"", "lists no image"),
        ("depth.txt", b"# nothing\n", "lists no image"),
        ("rgb.txt", b"1.0 a.png\n1.1\n", "rgb.txt:2:"),
        ("rgb.txt", b"nan a.png\n", "rgb.txt:1:"),
        ("rgb.txt", b"1.0 a.png\ninf b.png\n", "rgb.txt:2:"),
        ("depth.txt", b"-1 a.png\n", "depth.txt:1:"),
        ("depth.txt", b"1305031453359684000 a.png\n", "seconds"),
        ("rgb.txt", b"1.0 \xFF\xFE.png\n", "UTF-8"),
        ("rgb.txt", b"1.0 ../../etc/passwd\n", "`..`"),
        ("rgb.txt", b"1.0 /etc/passwd\n", "a relative path"),
        (
            "depth.txt",
            b"1.045 a.png\n1.155 b.png\n",
            "0.045000 s apart",
        ),
    ];
    for (file, bytes, expected) in cases {
        let recording = Recording::new(2);
        recording.write(file, bytes);
        let message = recording.error_of(0);
        assert!(message.contains(expected), "{expected}: {message}");
    }
}

/// What only judges does not stop the work, unless it shall.
#[test]
fn a_bad_ground_truth_is_a_warning() {
    let cases: [(&[u8], usize, &str); 4] = [
        (
            b"1 0 0 0 0 0 0 2\n2 0 0 0 0 0 0 1\n",
            1,
            "groundtruth.txt:1:",
        ),
        (
            b"1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
            1,
            "groundtruth.txt:2:",
        ),
        (b"time tx ty tz\n", 0, "groundtruth.txt:1:"),
        (b"1 \xFF\n", 0, "the path is not judged"),
    ];
    let strict = OpenOptions {
        strict: true,
        ..OpenOptions::default()
    };
    for (bytes, poses, expected) in cases {
        let recording = Recording::new(2);
        recording.write("groundtruth.txt", bytes);
        let dataset = recording.open().expect("runs");
        let found = dataset.ground_truth().map_or(0, <[_]>::len);
        assert_eq!(found, poses, "{expected}");
        let warning = &dataset.warnings()[0];
        assert!(warning.contains(expected), "{expected}: {warning}");
        let error = Dataset::open(recording.path(), &strict).expect_err("strict");
        assert!(error.to_string().contains("groundtruth.txt:"), "{error}");
    }
}

#[test]
fn missing_files_are_reported() {
    for (file, expected) in [
        ("rgb.txt", "without rgb.txt"),
        ("depth.txt", "without depth.txt"),
    ] {
        let recording = Recording::new(1);
        recording.remove(file);
        assert!(recording.error_of(0).contains(expected), "{expected}");
    }
    let nowhere = Dataset::open(Path::new("/nowhere/at/all"), &OpenOptions::default());
    assert!(
        matches!(nowhere, Err(DatasetError::NotFound { .. })),
        "{nowhere:?}"
    );

    let recording = Recording::new(2);
    recording.remove("groundtruth.txt");
    assert!(
        recording.open().expect("no error").ground_truth().is_none(),
        "no truth"
    );
    recording.write("groundtruth.txt", "# nothing\n");
    let dataset = recording.open().expect("no error");
    assert!(
        dataset.ground_truth().is_none() && dataset.warnings().len() == 1,
        "a warning"
    );
}

#[test]
fn times_out_of_order_are_sorted_or_refused() {
    let recording = Recording::new(2);
    recording.write(
        "rgb.txt",
        "1.10 rgb/1.10.png\n1.00 rgb/1.00.png\n1.00 rgb/1.10.png\n",
    );
    let dataset = recording.open().expect("sorted");
    assert_eq!(dataset.len(), 2, "the repeated time is left out");
    assert_eq!(
        dataset.read(0).expect("good").rgb[(0, 0)],
        colour(0, 0, 0),
        "earlier first"
    );
    assert!(
        dataset.warnings()[0].contains("rgb.txt:2:"),
        "{:?}",
        dataset.warnings()
    );
    assert!(
        dataset.warnings()[1].contains("rgb.txt:3:"),
        "{:?}",
        dataset.warnings()
    );
    let strict = OpenOptions {
        strict: true,
        ..OpenOptions::default()
    };
    let message = Dataset::open(recording.path(), &strict)
        .expect_err("strict")
        .to_string();
    assert!(message.contains("rgb.txt:2:"), "{message}");
}

#[test]
fn images_without_partner_are_counted() {
    let recording = Recording::new(3);
    recording.write(
        "depth.txt",
        "1.005 depth/1.005.png\n1.205 depth/1.205.png\n9.0 x.png\n",
    );
    let dataset = recording.open().expect("two pairs");
    let left_out = LeftOut {
        frames: 1,
        why: "without a depth image within 20 ms".to_owned(),
    };
    assert_eq!(dataset.left_out(), Some(&left_out), "at 1.1 s");
    assert_eq!(dataset.listed(), 3, "and two frames");
    assert_eq!(
        (dataset.timestamp(0), dataset.timestamp(1)),
        (Some(1.0), Some(1.2)),
        "pairs"
    );
    assert_eq!(
        dataset.warnings(),
        [
            "1 of 3 colour images have no depth image of their own within 20 ms",
            "1 of 3 depth images have no colour image of their own within 20 ms"
        ],
        "counted"
    );
}

#[test]
fn options_select_the_frames() {
    let recording = Recording::new(5);
    let open = |first_frame, max_frames| {
        let options = OpenOptions {
            first_frame,
            max_frames,
            ..OpenOptions::default()
        };
        Dataset::open(recording.path(), &options)
    };
    let dataset = open(1, Some(3)).expect("inside");
    assert_eq!(
        (dataset.len(), dataset.timestamp(0)),
        (3, Some(1.1)),
        "1, 2, 3"
    );
    assert_eq!(
        open(3, Some(9)).expect("fewer than asked for").len(),
        2,
        "3, 4"
    );
    assert!(
        matches!(open(5, None), Err(DatasetError::NoSuchFrame { .. })),
        "past the end"
    );
    assert!(
        matches!(open(0, Some(0)), Err(DatasetError::Option { .. })),
        "nothing asked for"
    );
    for max_dt_s in [f64::NAN, -1.0, f64::INFINITY] {
        let options = OpenOptions {
            max_dt_s,
            ..OpenOptions::default()
        };
        let answer = Dataset::open(recording.path(), &options);
        assert!(
            matches!(answer, Err(DatasetError::Option { .. })),
            "window {max_dt_s}"
        );
    }
}

/// Depth images are 5 ms after the colour images.
#[test]
fn the_window_of_pairs_is_that_of_the_options() {
    let recording = Recording::new(3);
    let open = |max_dt_s| {
        let options = OpenOptions {
            max_dt_s,
            ..OpenOptions::default()
        };
        Dataset::open(recording.path(), &options)
    };
    assert_eq!(open(0.006).expect("pairs").len(), 3, "6 ms");
    let none = open(0.004);
    assert!(
        matches!(
            none,
            Err(DatasetError::NoPairs {
                colour: 3,
                depth: 3,
                ..
            })
        ),
        "{none:?}"
    );
    recording.write(
        "depth.txt",
        "1.035 depth/1.005.png\n1.135 depth/1.105.png\n",
    );
    assert!(open(0.02).is_err(), "35 ms off");
    let dataset = open(0.04).expect("pairs");
    assert_eq!(dataset.len(), 2, "40 ms");
    let words = "1 of 3 colour images have no depth image of their own within 40 ms";
    assert_eq!(dataset.warnings(), [words], "the window in words");
}

#[test]
fn calibration_comes_from_the_first_source() {
    let mut options = OpenOptions::default();
    let parent = Recording::new(2);
    let file = parent.at("other.txt");
    parent.write(
        "other.txt",
        "8 6 77 77 3.5 2.5 1000 15 0.1 0.2 0.3 0.4 0.5\n",
    );
    let folder = parent.at("rgbd_dataset_freiburg2_x");
    std::fs::create_dir(&folder).expect("made");
    for list in ["rgb.txt", "depth.txt"] {
        std::fs::copy(parent.at(list), folder.join(list)).expect("copied");
    }
    let fx = |options: &OpenOptions| {
        let dataset = Dataset::open(&folder, options).expect("opens");
        let calibration = dataset.calibration();
        (calibration.camera.fx, calibration.source.clone())
    };
    let expect = |(fx, source): (f64, String), value: f64, words: &str| {
        assert!(
            (fx - value).abs() < 1e-12 && source.contains(words),
            "{fx}, {source}"
        );
    };
    expect(
        fx(&options),
        520.908_62,
        "freiburg2, from the recording's name",
    );
    std::fs::write(folder.join("calibration.toml"), TOML).expect("written");
    expect(fx(&options), 20.0, "calibration.toml");
    std::fs::write(folder.join("camera.txt"), "8 6 10 11 3.5 2.5 5000 30").expect("written");
    expect(fx(&options), 10.0, "camera.txt");
    options.preset = Some(Preset::Bonn);
    expect(fx(&options), 542.822_841, "preset bonn");
    options.calibration = Some(file);
    expect(fx(&options), 77.0, "other.txt");

    // Nothing at all: the choices are listed.
    let recording = Recording::new(1);
    recording.remove("camera.txt");
    let message = recording.error_of(0);
    assert!(
        message.contains("freiburg1, freiburg2, freiburg3, bonn"),
        "{message}"
    );
    options.calibration = Some(recording.at("camera.txt"));
    let answer = Dataset::open(recording.path(), &options);
    assert!(
        matches!(answer, Err(DatasetError::NotFound { .. })),
        "a file that is not there"
    );
}

const TOML: &str = "\
# a camera
width = 8
height = 6 # rows
fx = 20.0
fy = 20.0
cx = 3.5
cy = 2.5
depth_factor = 5e3
fps = 30
depth_max_raw = 40000
";

#[test]
fn bad_calibrations_are_reported() {
    let cases = [
        ("8 6 nan 10 3.5 2.5 5000 30", "camera.txt:1:"),
        (
            "# c\n8 6 0 10 3.5 2.5 5000 30",
            "camera.txt:2: camera fx is 0",
        ),
        ("8 6 10 -1 3.5 2.5 5000 30", "camera.txt:1: camera fy is -1"),
        ("8 6 10 10 3.5 2.5 0 30", "depth_factor"),
        ("8 6 10 10 3.5 2.5 5000 0", "fps"),
        ("8.5 6 10 10 3.5 2.5 5000 30", "8.5"),
        ("8 99999 10 10 3.5 2.5 5000 30", "99999"),
        ("8 6 10 10 3.5 2.5", "6 numbers"),
        ("8 6 10 10 3.5 2.5 5000 30 1", "9 numbers"),
        (
            "8 6 10 10 3.5 2.5 5000 30\n8 6 10 10 3.5 2.5 5000 30",
            "camera.txt:2: found width again",
        ),
        ("8 6 10 10 3.5 2.5 5000 30\nfocal = 3", "\"focal\""),
        ("8 6 10 10 3.5 2.5 5000 30\ndepth_max_raw = 65536", "65536"),
        ("width = 8\nheight = 6\nfx = 1\n", "no fy"),
        ("", "no width"),
        ("4 6 10 10 3.5 2.5 5000 30", "8x6 pixels; expected 4x6"),
    ];
    for (text, expected) in cases {
        let recording = Recording::new(1);
        recording.write("camera.txt", text);
        let message = recording.error_of(0);
        assert!(message.contains(expected), "{text:?}: {message}");
    }
}

#[test]
fn presets_have_names() {
    for preset in [
        Preset::Freiburg1,
        Preset::Freiburg2,
        Preset::Freiburg3,
        Preset::Bonn,
    ] {
        assert_eq!(
            preset.name().parse::<Preset>().expect("its own name"),
            preset
        );
        preset.calibration().camera.validate().expect("a camera");
    }
    assert_eq!("fr2".parse::<Preset>().expect("short"), Preset::Freiburg2);
    let message = "freiburg4"
        .parse::<Preset>()
        .expect_err("unknown")
        .to_string();
    assert!(
        message.contains("freiburg4") && message.contains("bonn"),
        "{message}"
    );
    let spoken = [
        (
            "rgbd_dataset_freiburg3_walking_xyz",
            Some(Preset::Freiburg3),
        ),
        ("rgbd_bonn_crowd", Some(Preset::Bonn)),
        ("tum_fr1_desk", Some(Preset::Freiburg1)),
        ("Bonn-person", Some(Preset::Bonn)),
        ("carbonniere", None),
        ("desk", None),
    ];
    for (name, preset) in spoken {
        assert_eq!(Preset::from_recording_name(name), preset, "{name}");
    }
    // The values of this one differ most from what one would guess.
    let freiburg2 = Preset::Freiburg2.calibration();
    assert!(
        (freiburg2.depth_factor - 5208.0).abs() < 1e-9,
        "depth factor"
    );
}
