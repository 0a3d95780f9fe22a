//! [`Cloth`]: textiles of clothes and furniture; and the texture of faces.

use crate::pattern::{
    Rgb, band, bands, cell, disc, fade, fbm, hash, mix, noise, part, print, scale, spots,
};
use crate::shape::Surface;

/// A pattern in two colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Cloth {
    /// One colour, with creases.
    Plain(Rgb),
    /// Stripes around the body.
    Striped(Rgb, Rgb),
    /// Checks.
    Checked(Rgb, Rgb),
    /// Blue twill with pale wear.
    Denim,
    /// Flowers or flecks on a plain ground.
    Strewn(Rgb, Rgb),
    /// A print across the chest.
    Printed(Rgb, Rgb),
}

impl Cloth {
    /// The colour at a point of the surface.
    pub(crate) fn colour(self, s: &Surface, fp: f32, seed: u32) -> Rgb {
        let [u, v] = s.uv;
        let weave = noise(u, v, 0.004, fp, seed) + noise(u, v, 0.011, fp, seed ^ 1);
        let crease = fbm(u, v + 0.4 * u, 0.11, 3, fp, seed ^ 2);
        let dye = match self {
            Self::Plain(tone) => {
                let (fleck, _) = spots(u, v, 0.03, 0.35, fp, seed);
                scale(tone, 1.0 - 0.30 * fleck)
            }
            Self::Striped(a, b) => {
                let wide = bands(v, 0.075, 0.0, 0.45, fp);
                mix(
                    a,
                    b,
                    (wide + 0.5 * bands(v + 0.02, 0.15, 0.0, 0.08, fp)).min(1.0),
                )
            }
            Self::Checked(a, b) => {
                let warp = bands(u, 0.06, 0.0, 0.5, fp);
                let weft = bands(v, 0.06, 0.0, 0.5, fp);
                let line = bands(u + 0.012, 0.06, 0.0, 0.08, fp).max(bands(
                    v + 0.012,
                    0.06,
                    0.0,
                    0.08,
                    fp,
                ));
                mix(
                    mix(a, b, 0.5 * (warp + weft)),
                    [0.92, 0.88, 0.75],
                    0.6 * line,
                )
            }
            Self::Denim => {
                let wear = fbm(u, v, 0.22, 2, fp, seed ^ 5);
                let blue = mix(
                    [0.17, 0.23, 0.37],
                    [0.42, 0.50, 0.62],
                    (0.4 + 0.5 * wear).clamp(0.0, 1.0),
                );
                let seam = band(u.abs(), 0.0, 0.004, fp) * 0.6;
                mix(scale(blue, 1.0 + 0.15 * weave), [0.75, 0.55, 0.30], seam)
            }
            Self::Strewn(a, b) => {
                let (bloom, h) = spots(u, v, 0.055, 0.85, fp, seed);
                let (small, _) = spots(u + 0.02, v + 0.013, 0.024, 0.5, fp, seed ^ 6);
                let hue = mix(b, [0.95, 0.9, 0.8], part(h, 2));
                mix(mix(a, hue, bloom), scale(a, 0.5), 0.7 * small)
            }
            Self::Printed(a, b) => {
                // on the chest, around the angle 0, and on the back, half way round
                let behind = s.half[0] - u.abs();
                let plate = band(u, -0.14, 0.14, fp).max(band(behind, -0.01, 0.13, fp))
                    * band(v, -0.04, 0.14, fp);
                let a = mix(a, b, 0.8 * bands(v, 0.31, 0.02, 0.10, fp));
                let text = print(u, v, 0.05, fp, seed);
                let (i, _) = cell(u / 0.028);
                let (j, _) = cell(v / 0.05);
                let ink = mix(
                    b,
                    [0.95, 0.75, 0.25],
                    f32::from(u8::from(hash(i, j, seed).is_multiple_of(3))) * fade(0.03, fp),
                );
                mix(a, ink, plate * text)
            }
        };
        scale(dye, 1.0 + 0.07 * weave + 0.16 * crease)
    }
}

/// Eyes, brows, mouth and cheeks on an ellipsoid of a head's size; `u` = 0 looks forward.
pub(crate) fn face(u: f32, v: f32, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let skin = scale(tone, 1.0 + 0.06 * fbm(u, v, 0.03, 3, fp, seed));
    let cheek = disc(u.abs() - 0.045, v + 0.03, 0.02, 0.03);
    let skin = mix(skin, [0.80, 0.45, 0.40], 0.25 * cheek);
    let a = u.abs() - 0.035;
    let white = disc(a * 0.6, v - 0.015, 0.009, fp);
    let iris = disc(a, v - 0.015, 0.007, fp);
    let brow = band(a, -0.018, 0.02, fp) * band(v, 0.033, 0.041, fp);
    let mouth = band(u, -0.025, 0.025, fp) * band(v, -0.062, -0.053, fp);
    let colour = mix(skin, [0.93; 3], white);
    let colour = mix(colour, [0.12, 0.10, 0.10], iris);
    let colour = mix(colour, scale(tone, 0.3), brow);
    mix(colour, [0.60, 0.25, 0.24], mouth)
}
