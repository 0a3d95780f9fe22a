//! The score as its formula reads, pixel by pixel.

use garad_core::GrayImage;

use super::{CIRCLE, Window};

/// Writes the score of each pixel of `window`, 0 where it is below `threshold` (at least 1).
///
/// `scores` is made as large as `image`; pixels outside `window` keep their value. The window
/// lies at least [`super::BORDER`] inside the image.
///
/// # Panics
/// If the window is nearer to the edge than that.
pub fn score_window(image: &GrayImage, threshold: u8, window: Window, scores: &mut GrayImage) {
    if scores.size() != image.size() {
        *scores = GrayImage::new(image.width(), image.height(), 0);
    }
    for y in window.y0..window.y1 {
        for x in window.x0..window.x1 {
            let score = score_at(image, x, y);
            scores[(x, y)] = match u8::try_from(score) {
                Ok(score) if score >= threshold => score,
                _ => 0,
            };
        }
    }
}

/// max over 16 arcs of max(min(I(p) - I(q)), min(I(q) - I(p))), less 1; -256 to 254.
fn score_at(image: &GrayImage, x: usize, y: usize) -> i16 {
    let centre = i16::from(image[(x, y)]);
    let brighter = CIRCLE.map(|(dx, dy)| {
        i16::from(image[(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy))]) - centre
    });
    let mut best = i16::MIN;
    for start in 0..16 {
        let arc = || (0..9).map(|k| brighter[(start + k) % 16]);
        let all_brighter_by = arc().min().expect("nine pixels");
        let all_darker_by = -arc().max().expect("nine pixels");
        best = best.max(all_brighter_by).max(all_darker_by);
    }
    best - 1
}
