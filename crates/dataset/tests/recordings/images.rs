//! Kinds of images that are read, and kinds that are refused.

use std::fs;

use garad_dataset::{DatasetError, MASK_FOLDER};
use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb, Rgba};

use crate::fixture::{Recording, SIZE, colour, raw_depth};

const RGB0: &str = "rgb/1.00.png";
const DEPTH0: &str = "depth/1.005.png";

#[test]
fn other_kinds_of_colour_are_converted_with_a_warning() {
    let (w, h) = SIZE;
    let cases: [(DynamicImage, [u8; 3], &str); 3] = [
        (
            ImageBuffer::from_pixel(w, h, Rgba([1u8, 2, 3, 99])).into(),
            [1, 2, 3],
            "alpha",
        ),
        (
            ImageBuffer::from_pixel(w, h, Luma([7u8])).into(),
            [7; 3],
            "grey is used for",
        ),
        (
            ImageBuffer::from_pixel(w, h, LumaA([9u8, 99])).into(),
            [9; 3],
            "alpha",
        ),
    ];
    for (image, pixel, words) in cases {
        let recording = Recording::new(2);
        recording.save(RGB0, image);
        let dataset = recording.open().expect("opens");
        assert_eq!(
            dataset.read(0).expect("converted").rgb[(3, 3)],
            pixel,
            "{words}"
        );
        assert!(
            dataset.warnings()[0].contains(words),
            "{:?}",
            dataset.warnings()
        );
    }
}

#[test]
fn jpeg_is_recognised_by_its_content() {
    let recording = Recording::new(1);
    let (w, h) = SIZE;
    recording.save(
        "a.jpg",
        ImageBuffer::from_pixel(w, h, Rgb([200u8, 100, 50])),
    );
    fs::rename(recording.at("a.jpg"), recording.at(RGB0)).expect("renamed");
    let frame = recording.open().and_then(|d| d.read(0)).expect("a JPEG");
    for (channel, value) in frame.rgb[(4, 3)].into_iter().zip([200u8, 100, 50]) {
        assert!(channel.abs_diff(value) <= 3, "{:?}", frame.rgb[(4, 3)]);
    }
    // A cut JPEG would decode without an error, with a grey end.
    let whole = fs::read(recording.at(RGB0)).expect("there");
    recording.write(RGB0, &whole[..whole.len() - 2]);
    assert!(
        recording.error_of(0).contains("ends early"),
        "no end marker"
    );
}

#[test]
fn bad_images_are_reported_with_frame_and_file() {
    let (w, h) = SIZE;
    let png = |bytes: &[u8], n: usize| bytes[..n].to_vec();
    let whole = fs::read(Recording::new(1).at(RGB0)).expect("there");
    let whole_depth = fs::read(Recording::new(1).at(DEPTH0)).expect("there");
    let mut flipped = whole.clone();
    let middle = whole.len() - 20; // inside the pixels' chunk
    flipped[middle] ^= 0x10;
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        (RGB0, Vec::new(), "an empty file"),
        (
            RGB0,
            b"not an image at all".to_vec(),
            "neither PNG nor JPEG",
        ),
        (RGB0, png(&whole, 10), RGB0),
        (RGB0, png(&whole, whole.len() - 20), RGB0),
        (RGB0, flipped, RGB0),
        (
            RGB0,
            whole_depth.clone(),
            "16-bit grey PNG; expected an 8-bit",
        ),
        (DEPTH0, Vec::new(), "an empty file"),
        (DEPTH0, png(&whole_depth, whole_depth.len() - 20), DEPTH0),
        (DEPTH0, whole, "8-bit RGB PNG; expected a 16-bit grey PNG"),
    ];
    for (file, bytes, expected) in cases {
        let recording = Recording::new(2);
        recording.write(file, bytes);
        let message = recording.error_of(0);
        assert!(
            message.starts_with("frame 0: ")
                && message.contains(file)
                && message.contains(expected),
            "{expected}: {message}"
        );
        recording
            .open()
            .and_then(|d| d.read(1))
            .expect("its neighbour is fine");
    }
    let images: [(&str, DynamicImage, &str); 5] = [
        (
            DEPTH0,
            ImageBuffer::<Luma<u8>, _>::new(w, h).into(),
            "8-bit grey PNG; expected a 16-bit",
        ),
        (
            DEPTH0,
            ImageBuffer::<Rgb<u16>, _>::new(w, h).into(),
            "16-bit RGB PNG",
        ),
        (
            RGB0,
            ImageBuffer::<Rgb<u16>, _>::new(w, h).into(),
            "16-bit RGB PNG; expected an 8-bit",
        ),
        (
            DEPTH0,
            ImageBuffer::<Luma<u16>, _>::new(w, h + 1).into(),
            "8x7 pixels; expected 8x6 as in the colour image",
        ),
        (
            RGB0,
            ImageBuffer::<Rgb<u8>, _>::new(1, 1).into(),
            "1x1 pixels; expected 8x6 as in the calibration",
        ),
    ];
    for (file, image, expected) in images {
        let recording = Recording::new(1);
        recording.save(file, image);
        let message = recording.error_of(0);
        assert!(
            message.contains(file) && message.contains(expected),
            "{expected}: {message}"
        );
    }
}

#[test]
fn absent_images_are_reported_with_their_line() {
    let recording = Recording::new(2);
    recording.remove("depth/1.105.png");
    let message = recording.error_of(1);
    assert!(
        message.starts_with("frame 1: ") && message.contains("depth.txt:3"),
        "{message}"
    );
    fs::create_dir(recording.at("depth/1.105.png")).expect("made");
    assert!(
        recording.error_of(1).contains("absent"),
        "a folder is no image"
    );
}

#[test]
fn a_size_that_changes_is_an_error_of_its_frame() {
    let recording = Recording::new(2);
    recording.save("rgb/1.10.png", ImageBuffer::<Rgb<u8>, _>::new(6, 8));
    let dataset = recording.open().expect("the first image is fine");
    assert!(dataset.read(0).is_ok(), "the first");
    let message = dataset.read(1).expect_err("another size").to_string();
    assert!(
        message.starts_with("frame 1: ") && message.contains("6x8"),
        "{message}"
    );
}

#[test]
fn an_image_above_the_limits_is_not_decoded() {
    let recording = Recording::new(1);
    let good = fs::read(recording.at(RGB0)).expect("there");
    // A header alone: 20000x20000 pixels would be 1.2 GB.
    for (width, height, words) in [
        (
            20_000,
            20_000,
            "width in pixels is 20000; expected at most 8192",
        ),
        (8, 8_193, "height in pixels is 8193; expected at most 8192"),
        (
            8_192,
            2_731,
            "decoded size in bytes is 67117056; expected at most 67108864",
        ),
        (8_192, 2_730, "8192x2730 pixels; expected 8x6"), // 67092480 bytes
    ] {
        let mut png = good.clone();
        for (at, side) in [(16, width), (20, height)] {
            png[at..at + 4].copy_from_slice(&u32::to_be_bytes(side));
        }
        let crc = png_crc(&png[12..29]);
        png[29..33].copy_from_slice(&crc.to_be_bytes());
        recording.write(RGB0, png);
        let message = recording.error_of(0);
        assert!(
            message.contains(RGB0) && message.contains(words),
            "{message}"
        );
    }
}

#[test]
fn a_file_above_the_limits_is_not_read() {
    let recording = Recording::new(1);
    let grow = |bytes: u64| {
        let file = fs::OpenOptions::new()
            .write(true)
            .open(recording.at(DEPTH0));
        file.and_then(|file| file.set_len(bytes)).expect("grown");
    };
    grow((64 << 20) + 1);
    assert!(
        recording.error_of(0).contains("at most 67108864"),
        "a byte too many"
    );
    grow(64 << 20);
    recording
        .open()
        .and_then(|d| d.read(0))
        .expect("bytes behind the image are ignored");
}

/// CRC-32 of PNG, bit by bit.
fn png_crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| {
            if c & 1 == 1 {
                0xEDB8_8320 ^ (c >> 1)
            } else {
                c >> 1
            }
        })
    })
}

#[test]
fn missing_depth_is_zero() {
    let (w, h) = SIZE;
    let raw = [0u16, 1, 39_999, 40_000, 59_999, 60_000, 65_534, 65_535];
    // In millimetres, in millimetres with a limit, and in fifths of a millimetre.
    let cases = [
        ("1000 30", [0, 1, 39_999, 40_000, 59_999, 0, 0, 0], 1000.0),
        (
            "1000 30\ndepth_max_raw = 40000",
            [0, 1, 39_999, 0, 0, 0, 0, 0],
            1000.0,
        ),
        (
            "5000 30",
            [0, 1, 39_999, 40_000, 59_999, 60_000, 65_534, 0],
            5000.0,
        ),
    ];
    for (factor, expected, per_metre) in cases {
        let recording = Recording::new(1);
        recording.write("camera.txt", format!("8 6 10 11 3.5 2.5 {factor}"));
        recording.save(
            DEPTH0,
            ImageBuffer::from_fn(w, h, |x, _| Luma([raw[x as usize]])),
        );
        let depth = recording
            .open()
            .and_then(|d| d.read(0))
            .expect("good")
            .depth;
        for (x, value) in expected.into_iter().enumerate() {
            let error_m = f64::from(depth[(x, 4)]) - f64::from(value) / per_metre;
            assert!(
                error_m.abs() < 4e-6,
                "{factor}: raw {}: {}",
                raw[x],
                depth[(x, 4)]
            );
        }
    }
}

#[test]
fn masks_are_named_by_the_timestamp() {
    let recording = Recording::new(2);
    let (w, h) = SIZE;
    fs::create_dir(recording.at("mask")).expect("made");
    let save = |name: &str, value: u8| {
        let image = ImageBuffer::from_fn(w, h, |x, _| Luma([if x == 2 { value } else { 0u8 }]));
        recording.save(&format!("mask/{name}.png"), image);
    };
    save("1.00", 255);
    let dataset = recording.open().expect("good");
    let dir = recording.at("mask");
    let mask = dataset.read_mask(&dir, 0).expect("there");
    assert_eq!((mask[(2, 1)], mask[(3, 1)]), (255, 0), "moving, static");
    assert!(
        matches!(
            dataset.read_mask(&dir, 1),
            Err(DatasetError::NotFound { .. })
        ),
        "no mask for frame 1"
    );
    save("1.10", 128);
    assert_eq!(
        dataset.read_mask(&dir, 1).expect("there")[(2, 0)],
        128,
        "unknown"
    );
    save("1.10", 7);
    let message = dataset.read_mask(&dir, 1).expect_err("7").to_string();
    assert!(message.contains("value 7 at pixel (2, 0)"), "{message}");
    recording.save("mask/1.10.png", ImageBuffer::<Luma<u8>, _>::new(w, h + 1));
    let message = dataset.read_mask(&dir, 1).expect_err("size").to_string();
    assert!(message.contains("8x7"), "{message}");
    recording.save(
        "mask/1.10.png",
        ImageBuffer::from_fn(w, h, |x, y| Rgb(colour(0, x, y))),
    );
    let message = dataset.read_mask(&dir, 1).expect_err("kind").to_string();
    assert!(message.contains("8-bit RGB PNG"), "{message}");
    assert!(
        raw_depth(0, 0, 0) == 0,
        "the fixture has a hole at the origin"
    );
    // Times and files may have different names; the file's own is tried second.
    recording.write("rgb.txt", "1.000 rgb/1.00.png\n");
    let dataset = recording.open().expect("good");
    assert_eq!(
        dataset.read_mask(&dir, 0).expect("by file name")[(2, 0)],
        255,
        "found"
    );
    save("1.000", 128);
    for mask in [
        dataset.read_mask(&dir, 0),
        dataset
            .read_own_mask(MASK_FOLDER, 0)
            .map(|mask| mask.expect("there")),
    ] {
        assert_eq!(mask.expect("both names")[(2, 0)], 128, "the stamp is first");
    }
}
