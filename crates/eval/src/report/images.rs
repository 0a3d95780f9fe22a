//! Input, render and labels side by side.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use garad_core::RgbImage;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use maud::{Markup, html};

use super::data::Strip;

/// Good enough to judge sharpness; an image of 640x480 takes some 60 kB.
const JPEG_QUALITY: u8 = 85;

pub(super) fn strips(strips: &[Strip<'_>]) -> Markup {
    html! {
        @if !strips.is_empty() {
            section {
                h2 { "Frames" }
                @for one in strips { (strip(one)) }
            }
        }
    }
}

fn strip(strip: &Strip<'_>) -> Markup {
    let mut caption = format!("frame {} · {:.2} s", strip.frame, strip.t_s);
    if let Some(quality) = strip.quality {
        let (psnr, ssim) = (quality.psnr_db, quality.ssim);
        caption += &format!(" · {psnr:.1} dB · SSIM {ssim:.3}");
        if strip.outside_mask {
            caption += " outside the mask";
        }
    }
    let images = [
        ("input", Some(strip.input)),
        ("render", strip.render),
        ("labels", strip.labels),
    ];
    html! {
        p.caption { (caption) }
        div.strip {
            @for (name, image) in images {
                @if let Some(image) = image { (figure(name, &caption, image)) }
            }
        }
    }
}

pub(super) fn figure(name: &str, caption: &str, image: &RgbImage) -> Markup {
    let (width, height) = image.size();
    html! {
        figure {
            @match jpeg(image) {
                Ok(bytes) => {
                    img width=(width) height=(height) alt={ (name) ", " (caption) }
                        src={ "data:image/jpeg;base64," (STANDARD.encode(bytes)) };
                }
                Err(reason) => { p.note { "No image: " (reason) "." } }
            }
            figcaption { (name) }
        }
    }
}

fn jpeg(image: &RgbImage) -> Result<Vec<u8>, String> {
    let side = |n: usize| u16::try_from(n).ok().filter(|&n| n > 0);
    let (Some(width), Some(height)) = (side(image.width()), side(image.height())) else {
        return Err(format!("{} x {} pixels", image.width(), image.height()));
    };
    let bytes = image.data().as_flattened();
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY)
        .encode(bytes, width.into(), height.into(), ExtendedColorType::Rgb8)
        .map_err(|error| error.to_string())?;
    Ok(out)
}
