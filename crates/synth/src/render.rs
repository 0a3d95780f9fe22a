//! [`render`]: colour, exact depth and object of every pixel of a view.

use garad_core::{DepthImage, Image, Par, RgbImage};

use crate::light::Lighting;
use crate::material::Material;
use crate::pattern::Rgb;
use crate::shape::length;
use crate::view::{Hit, View};

/// Rows of pixels per piece of work.
const ROWS: usize = 8;

/// The rendered images.
#[derive(Debug, Clone)]
pub(crate) struct Rendered {
    pub(crate) rgb: RgbImage,
    /// Depth of the surface at the centre of the pixel, metres.
    pub(crate) depth: DepthImage,
    /// Object at the centre of the pixel.
    pub(crate) object: Image<u8>,
    /// Cosine of the angle between ray and normal at the centre of the pixel.
    pub(crate) incidence: Image<f32>,
}

/// One pixel of [`Rendered`].
#[derive(Debug, Clone, Copy)]
struct Pixel {
    rgb: [u8; 3],
    depth: f32,
    object: u8,
    incidence: f32,
}

/// Renders a view.
///
/// The colour of a pixel is that of its centre (`supersample` 1) or ½ centre + ⅛ of each corner (2), in
/// linear light. Corners are computed once for the four pixels that share them. All light is scaled by
/// `brightness`.
pub(crate) fn render(
    view: &View,
    lighting: &Lighting,
    brightness: f32,
    supersample: usize,
    par: Par,
) -> Rendered {
    let (width, height) = (view.camera.width, view.camera.height);
    let spread = if supersample == 1 { 1.0 } else { 0.75 };
    let sample = |u: f64, v: f64| shade(view, lighting, view.cast(u, v), (u, v), spread).0;
    let corners: Vec<Rgb> = if supersample == 1 {
        Vec::new()
    } else {
        par.map_chunks(height + 1, ROWS, |rows| {
            rows.flat_map(|y| (0..=width).map(move |x| (x, y)))
                .map(|(x, y)| sample(x as f64 - 0.5, y as f64 - 0.5))
                .collect::<Vec<Rgb>>()
        })
        .concat()
    };
    let pixel = |x: usize, y: usize| {
        let (u, v) = (x as f64, y as f64);
        let hit = view.cast(u, v);
        let (mut colour, incidence) = shade(view, lighting, hit, (u, v), spread);
        if !corners.is_empty() {
            let at = y * (width + 1) + x;
            for c in 0..3 {
                let (a, b) = (corners[at][c], corners[at + 1][c]);
                let (d, e) = (corners[at + width + 1][c], corners[at + width + 2][c]);
                colour[c] = 0.5 * colour[c] + 0.125 * (a + b + d + e);
            }
        }
        Pixel {
            rgb: colour.map(|light| stored(brightness * light)),
            #[allow(clippy::cast_possible_truncation, reason = "depth images are f32")]
            depth: hit.map_or(0.0, |hit| hit.z as f32),
            object: hit.map_or(0, |hit| view.solids[hit.index].object),
            incidence,
        }
    };
    let pixels = par
        .map_chunks(height, ROWS, |rows| {
            rows.flat_map(|y| (0..width).map(move |x| (x, y)))
                .map(|(x, y)| pixel(x, y))
                .collect::<Vec<Pixel>>()
        })
        .concat();
    let at = |x: usize, y: usize| &pixels[y * width + x];
    Rendered {
        rgb: Image::from_fn(width, height, |x, y| at(x, y).rgb),
        depth: Image::from_fn(width, height, |x, y| at(x, y).depth),
        object: Image::from_fn(width, height, |x, y| at(x, y).object),
        incidence: Image::from_fn(width, height, |x, y| at(x, y).incidence),
    }
}

/// (light from the surface to the camera, cosine of incidence).
#[allow(clippy::cast_possible_truncation, reason = "colours are f32")]
fn shade(
    view: &View,
    lighting: &Lighting,
    hit: Option<Hit>,
    (u, v): (f64, f64),
    spread: f64,
) -> (Rgb, f32) {
    let Some(hit) = hit else {
        return ([0.0; 3], 0.0);
    };
    let solid = &view.solids[hit.index];
    let p = view.point_in_solid(&hit, u, v);
    let d = view.direction_in_solid(hit.index, u, v);
    let (surface, n) = solid.shape.surface(&p);
    let incidence = (-n.dot(&d) / length(&d)).max(0.0);
    // width of the pixel on the surface: longer along the slope, at most 5 times
    let footprint = spread * hit.z / view.camera.fx / incidence.max(0.2);
    let albedo = solid.material.albedo(&surface, footprint as f32);
    if let Material::Shade { .. } = solid.material {
        return (albedo.map(|a| a * a), incidence as f32);
    }
    let placed = || {
        (
            solid.world_from_solid * p,
            solid.world_from_solid.rotation * n,
        )
    };
    let light = lighting.at(hit.index, &surface, placed);
    let out = std::array::from_fn(|c| albedo[c] * albedo[c] * light[c]);
    (out, incidence as f32)
}

/// Linear light as a stored value of 8 bits, gamma 2.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "0 to 255 after the clamp"
)]
fn stored(linear: f32) -> u8 {
    (linear.max(0.0).sqrt() * 255.0 + 0.5).min(255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_values_are_rounded_and_clamped() {
        let expected = [(-1.0, 0), (0.0, 0), (0.25, 128), (1.0, 255), (4.0, 255)];
        for (linear, value) in expected {
            assert_eq!(stored(linear), value, "{linear}");
        }
    }
}
