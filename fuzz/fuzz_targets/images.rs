//! PNG and JPEG as colour, as depth and as mask of a recording; what was decoded is the same when encoded
//! and decoded again.

#![no_main]

use garad::core::{DepthImage, MaskImage, RgbImage};
use garad::images::{png, png_gray, png_gray16};
use garad::dataset::{MASK_FOLDER, limits};
use garad_fuzz::{CAMERA, check_error, folder_of, open, within_mib};
use libfuzzer_sys::fuzz_target;

/// Two decoded copies of the largest image, and what its decoder needs.
const MIB: usize = 4 * (limits::IMAGE_DECODED_BYTES >> 20) as usize;

/// The colour, depth and mask of the one frame of a recording, and whether each could be decoded.
fn read(colour: &[u8], depth: &[u8], mask: &[u8]) -> (Option<(RgbImage, DepthImage)>, Option<MaskImage>) {
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
        let frame = dataset.read(0).inspect_err(|error| check_error(error, path));
        let mask = dataset.read_own_mask(MASK_FOLDER, 0);
        let mask = mask.inspect_err(|error| check_error(error, path));
        (
            frame.ok().map(|frame| (frame.rgb, frame.depth)),
            mask.ok().flatten(),
        )
    })
}

fuzz_target!(|data: &[u8]| {
    let colour = png(&RgbImage::new(8, 6, [1, 2, 3])).expect("pixels");
    let raw = |value| garad::core::Image::<u16>::new(8, 6, value);
    let depth = png_gray16(&raw(5000)).expect("pixels");

    if let (Some((rgb, _)), _) = read(data, &depth, data) {
        let again = read(&png(&rgb).expect("pixels"), &depth, data);
        assert_eq!(again.0.map(|frame| frame.0), Some(rgb), "colour");
    }
    let (frame, mask) = read(&colour, data, data);
    if let Some((_, metres)) = frame {
        assert!(metres.data().iter().all(|z| (0.0..=65535.0 / 5000.0).contains(z)), "{metres:?}");
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 65535")]
        let raw = metres.map(|z| (f64::from(*z) * 5000.0).round() as u16);
        let again = read(&colour, &png_gray16(&raw).expect("pixels"), data);
        assert_eq!(again.0.map(|frame| frame.1), Some(metres), "depth");
    }
    if let Some(mask) = mask {
        let again = read(&colour, &depth, &png_gray(&mask).expect("pixels"));
        assert_eq!(again.1, Some(mask), "mask");
    }
});
