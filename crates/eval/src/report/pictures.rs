//! Input, render and labels side by side.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use garad_core::RgbImage;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;

use super::{Strip, note, section};

/// Good enough to judge sharpness; a picture of 640x480 takes some 60 kB.
const JPEG_QUALITY: u8 = 85;

pub(super) fn strips(strips: &[Strip<'_>]) -> String {
    let rows: String = strips.iter().map(strip).collect();
    section("Frames", &rows)
}

fn strip(strip: &Strip<'_>) -> String {
    let mut caption = format!("frame {} · {:.2} s", strip.frame, strip.t_s);
    if let Some(quality) = strip.quality {
        let (psnr, ssim) = (quality.psnr_db, quality.ssim);
        caption += &format!(" · {psnr:.1} dB · SSIM {ssim:.3}");
    }
    let pictures: String = [
        ("input", Some(strip.input)),
        ("render", strip.render),
        ("labels", strip.labels),
    ]
    .into_iter()
    .filter_map(|(name, picture)| Some(figure(name, &caption, picture?)))
    .collect();
    format!("<p class=\"caption\">{caption}</p>\n<div class=\"strip\">{pictures}</div>\n")
}

fn figure(name: &str, caption: &str, picture: &RgbImage) -> String {
    let body = match jpeg(picture) {
        Ok(bytes) => {
            let (width, height) = picture.size();
            let data = STANDARD.encode(bytes);
            format!(
                "<img width=\"{width}\" height=\"{height}\" alt=\"{name}, {caption}\" \
                 src=\"data:image/jpeg;base64,{data}\">"
            )
        }
        Err(reason) => note(&format!("No picture: {reason}.")),
    };
    format!("<figure>{body}<figcaption>{name}</figcaption></figure>\n")
}

fn jpeg(picture: &RgbImage) -> Result<Vec<u8>, String> {
    let side = |n: usize| u16::try_from(n).ok().filter(|&n| n > 0);
    let (Some(width), Some(height)) = (side(picture.width()), side(picture.height())) else {
        return Err(format!("{} x {} pixels", picture.width(), picture.height()));
    };
    let bytes: Vec<u8> = picture.data().as_flattened().to_vec();
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY)
        .encode(&bytes, width.into(), height.into(), ExtendedColorType::Rgb8)
        .map_err(|error| error.to_string())?;
    Ok(out)
}
