//! PNG and JPEG as colour, as depth and as mask of a recording; what was decoded is the same when encoded
//! and decoded again.

#![no_main]

use garad_core::{DepthImage, MaskImage, RgbImage};
use garad_dataset::{MASK_FOLDER, limits};
use garad_fuzz::{CAMERA, check_error, folder_of, open, within_mib};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use libfuzzer_sys::fuzz_target;

/// Two decoded copies of the largest image, and what its decoder needs.
const MIB: usize = 4 * (limits::IMAGE_DECODED_BYTES >> 20) as usize;

fn png(size: (usize, usize), bytes: &[u8], color: ExtendedColorType) -> Vec<u8> {
    let mut out = Vec::new();
    let (width, height) = (size.0 as u32, size.1 as u32);
    let encoder = PngEncoder::new(&mut out);
    encoder
        .write_image(bytes, width, height, color)
        .expect("an image with pixels");
    out
}

fn png_colour(image: &RgbImage) -> Vec<u8> {
    png(
        image.size(),
        image.data().as_flattened(),
        ExtendedColorType::Rgb8,
    )
}

fn png_depth(size: (usize, usize), raw: impl Iterator<Item = u16>) -> Vec<u8> {
    let bytes: Vec<u8> = raw.flat_map(u16::to_ne_bytes).collect();
    png(size, &bytes, ExtendedColorType::L16)
}

fn png_mask(image: &MaskImage) -> Vec<u8> {
    png(image.size(), image.data(), ExtendedColorType::L8)
}

/// The colour, depth and mask of the one frame of a recording, and whether each could be decoded.
fn read(
    colour: &[u8],
    depth: &[u8],
    mask: &[u8],
) -> (Option<(RgbImage, DepthImage)>, Option<MaskImage>) {
    let folder = folder_of(&[
        ("rgb.txt", b"1 rgb/1.png\n"),
        ("depth.txt", b"1 depth/1.png\n"),
        ("camera.txt", CAMERA.as_bytes()),
        ("rgb/1.png", colour),
        ("depth/1.png", depth),
        ("mask/1.png", mask),
    ]);
    let path = folder.path();
    within_mib(MIB, || {
        let Some(dataset) = open(path, true) else {
            return (None, None);
        };
        let frame = dataset
            .read(0)
            .inspect_err(|error| check_error(error, path));
        let mask = dataset.read_own_mask(MASK_FOLDER, 0);
        let mask = mask.inspect_err(|error| check_error(error, path));
        (
            frame.ok().map(|frame| (frame.rgb, frame.depth)),
            mask.ok().flatten(),
        )
    })
}

fuzz_target!(|data: &[u8]| {
    let colour = png_colour(&RgbImage::new(8, 6, [1, 2, 3]));
    let depth = png_depth((8, 6), (0..48).map(|i| 100 * i));

    if let (Some((rgb, _)), _) = read(data, &depth, data) {
        let again = read(&png_colour(&rgb), &depth, data);
        assert_eq!(again.0.map(|frame| frame.0), Some(rgb), "colour");
    }
    let (frame, mask) = read(&colour, data, data);
    if let Some((_, metres)) = frame {
        let range = 0.0..=65535.0 / 5000.0;
        assert!(
            metres.data().iter().all(|z| range.contains(z)),
            "{metres:?}"
        );
        // At most 65535.
        let raw = metres
            .data()
            .iter()
            .map(|z| (f64::from(*z) * 5000.0).round() as u16);
        let again = read(&colour, &png_depth(metres.size(), raw), data);
        assert_eq!(again.0.map(|frame| frame.1), Some(metres), "depth");
    }
    if let Some(mask) = mask {
        let again = read(&colour, &depth, &png_mask(&mask));
        assert_eq!(again.1, Some(mask), "mask");
    }
});
