//! Images for people: renders, depth in colours, keypoints over the input; and PNG files.

use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, Result};
use garad_core::{Image, RgbImage};
use garad_dataset::write_bytes_atomically;
use garad_raster::Rendered;
use image::{ColorType, ImageEncoder, codecs::png::PngEncoder};

use crate::run::snapshot::{KeypointRole, Snapshot};

/// Colours of keypoints, distinguishable for colour-blind readers (Okabe & Ito 2008): blue-green, yellow,
/// vermilion.
const TRACKED: [u8; 3] = [0, 158, 115];
const FREE: [u8; 3] = [240, 228, 66];
const DYNAMIC: [u8; 3] = [213, 94, 0];

/// Rendered colour in 8 bits.
#[must_use]
pub fn color_image(rendered: &Rendered<f32>) -> RgbImage {
    rendered.color.map(|c| c.map(to_u8))
}

/// Rendered opacity as grey.
#[must_use]
pub fn opacity_image(rendered: &Rendered<f32>) -> RgbImage {
    rendered.opacity.map(|o| [to_u8(*o); 3])
}

/// Depth from near (warm) to far (cool) over `range_m`; missing depth is black.
#[must_use]
pub fn depth_image(depth_m: &Image<f32>, range_m: (f32, f32)) -> RgbImage {
    let (near, far) = range_m;
    depth_m.map(|&z| {
        if z > 0.0 && z.is_finite() {
            warm_to_cool((z - near) / (far - near))
        } else {
            [0; 3]
        }
    })
}

/// Nearest and farthest depth, leaving out the outermost 1 % at each end; (0, 1) if there is none.
#[must_use]
pub fn depth_range(depth_m: &Image<f32>) -> (f32, f32) {
    let mut valid: Vec<f32> = depth_m
        .data()
        .iter()
        .copied()
        .filter(|z| *z > 0.0 && z.is_finite())
        .collect();
    valid.sort_unstable_by(f32::total_cmp);
    let skip = valid.len() / 100;
    match (valid.get(skip), valid.iter().rev().nth(skip)) {
        (Some(near), Some(far)) if near < far => (*near, *far),
        _ => (0.0, 1.0),
    }
}

/// Keypoints over the input, masked pixels tinted.
#[must_use]
pub fn keypoint_image(snapshot: &Snapshot) -> RgbImage {
    let mut image = snapshot.rgb.clone();
    if let Some(mask) = &snapshot.mask {
        for (pixel, mask) in image.data_mut().iter_mut().zip(mask.data()) {
            if *mask == 255 {
                *pixel = mix(*pixel, DYNAMIC);
            }
        }
    }
    for &(x, y, role) in &snapshot.keypoints {
        let color = match role {
            KeypointRole::Tracked => TRACKED,
            KeypointRole::Free => FREE,
            KeypointRole::Dynamic => DYNAMIC,
        };
        square(&mut image, x, y, color);
    }
    image
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "keypoints lie inside the image; float to integer saturates"
)]
fn square(image: &mut RgbImage, x: f32, y: f32, color: [u8; 3]) {
    const HALF: usize = 2;
    let (x, y) = ((x + 0.5) as usize, (y + 0.5) as usize);
    let (width, height) = image.size();
    for ny in y.saturating_sub(HALF)..=(y + HALF).min(height - 1) {
        for nx in x.saturating_sub(HALF)..=(x + HALF).min(width - 1) {
            let rim = nx.abs_diff(x) == HALF || ny.abs_diff(y) == HALF;
            if rim {
                image[(nx, ny)] = color;
            }
        }
    }
}

/// Encodes a colour image.
///
/// # Errors
/// If the encoder refuses it (an image without pixels).
pub fn png(image: &RgbImage) -> Result<Vec<u8>> {
    encode(image.size(), image.data().as_flattened(), ColorType::Rgb8)
}

/// Encodes 8-bit grey.
///
/// # Errors
/// If the encoder refuses it.
pub fn png_gray(image: &Image<u8>) -> Result<Vec<u8>> {
    encode(image.size(), image.data(), ColorType::L8)
}

/// Encodes 16-bit grey.
///
/// # Errors
/// If the encoder refuses it.
pub fn png_gray16(image: &Image<u16>) -> Result<Vec<u8>> {
    // The encoder takes native-endian bytes and swaps them itself.
    let bytes: Vec<u8> = (image.data().iter())
        .flat_map(|v| v.to_ne_bytes())
        .collect();
    encode(image.size(), &bytes, ColorType::L16)
}

fn encode((width, height): (usize, usize), bytes: &[u8], color: ColorType) -> Result<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    PngEncoder::new(&mut out)
        .write_image(
            bytes,
            u32::try_from(width)?,
            u32::try_from(height)?,
            color.into(),
        )
        .context("cannot encode the image as PNG")?;
    Ok(out.into_inner())
}

/// Writes a colour image as PNG, whole or not at all.
///
/// # Errors
/// A path that cannot be written.
pub fn save_png(path: &Path, image: &RgbImage) -> Result<()> {
    Ok(write_bytes_atomically(path, &png(image)?)?)
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0..255; NaN becomes 0"
)]
fn to_u8(v: f32) -> u8 {
    (v * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

fn mix(a: [u8; 3], b: [u8; 3]) -> [u8; 3] {
    [0, 1, 2].map(|c| a[c] / 2 + b[c] / 2)
}

/// A colour map from yellow to violet, linear between six anchors of perceptually ordered colours.
fn warm_to_cool(t: f32) -> [u8; 3] {
    const ANCHORS: [[f32; 3]; 6] = [
        [240.0, 249.0, 33.0],
        [252.0, 166.0, 54.0],
        [225.0, 100.0, 98.0],
        [177.0, 42.0, 144.0],
        [106.0, 0.0, 168.0],
        [13.0, 8.0, 135.0],
    ];
    let s = t.clamp(0.0, 1.0) * 5.0;
    let i = [1.0, 2.0, 3.0, 4.0].iter().filter(|k| s >= **k).count();
    let w = s - i as f32;
    [0, 1, 2].map(|c| to_u8((ANCHORS[i][c] * (1.0 - w) + ANCHORS[i + 1][c] * w) / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_colours_run_from_warm_to_cool() {
        let depth = Image::from_vec(3, 1, vec![1.0f32, 3.0, 0.0]).expect("3 pixels");
        let image = depth_image(&depth, (1.0, 3.0));
        assert_eq!(
            image.data(),
            [[240, 249, 33], [13, 8, 135], [0, 0, 0]],
            "near, far, none"
        );
        assert_eq!(depth_range(&depth), (1.0, 3.0), "range");
    }

    #[test]
    fn png_bytes_decode_to_the_same_image() {
        let gray = Image::from_vec(2, 1, vec![1u16, 65535]).expect("2 pixels");
        let decoded = image::load_from_memory(&png_gray16(&gray).expect("PNG")).expect("reads");
        assert_eq!(decoded.into_luma16().into_raw(), [1, 65535], "16 bit");
        let rgb = Image::from_vec(1, 1, vec![[9u8, 8, 7]]).expect("1 pixel");
        let decoded = image::load_from_memory(&png(&rgb).expect("PNG")).expect("reads");
        assert_eq!(decoded.into_rgb8().into_raw(), [9, 8, 7], "colour");
    }
}
