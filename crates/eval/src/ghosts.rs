//! Ghosts: surfaces in a map of the static scene where there is none, left behind by moving objects.

use garad_core::{DepthImage, MaskImage};

use crate::EvalError;
use crate::image_metrics::{check_sizes, judged, no_pixels};

/// Smallest distance of a ghost to the background, metres: more than depth noise and the roughness of a
/// map, less than the thickness of a limb.
pub const GHOST_GAP_M: f64 = 0.10;

/// Ghosts in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ghosts {
    /// Share of the judged pixels that show a ghost, in [0, 1].
    pub fraction: f64,
    /// Pixels with a ghost.
    pub ghosts: usize,
    /// Pixels judged: outside the mask, with a known background.
    pub pixels: usize,
    /// Share of the judged pixels with rendered depth, in [0, 1]: an empty map has no ghosts.
    pub coverage: f64,
}

/// Share of pixels where the rendered surface is in front of the true background:
///
/// ghost ⇔ z_render < z_background - `min_gap_m`
///
/// The render is of the static Gaussians from the true pose of a frame; the background is the depth
/// of that view without moving objects. A synthetic scene has it exactly: its background or, if nothing
/// stops, its static twin; then no mask is needed, and pixels hidden behind a person are judged too. A
/// recording has only the measured depth of the frame; then pixels whose mask is not 0 are excluded.
/// Pixels without background depth (0 or NaN) are not judged; pixels without rendered depth are judged
/// and are not ghosts.
///
/// # Shapes and units
/// `rendered`, `background` in metres, of one size · `min_gap_m` as [`GHOST_GAP_M`]
/// # Errors
/// [`EvalError::SizeMismatch`]; [`EvalError::Option`] for a gap that is not a positive finite number;
/// [`EvalError::TooFew`] when no pixel is judged.
/// # Example
/// ```
/// use garad_core::Image;
/// use garad_eval::{GHOST_GAP_M, ghosts};
/// // A wall at 3 m; the map has the wall, a ghost at 1.5 m, noise, and a hole.
/// let wall = Image::new(4, 1, 3.0f32);
/// let rendered = Image::from_vec(4, 1, vec![3.0f32, 1.5, 2.95, 0.0]).expect("four pixels");
/// let found = ghosts(&rendered, &wall, None, GHOST_GAP_M)?;
/// assert_eq!((found.ghosts, found.pixels), (1, 4));
/// assert_eq!((found.fraction, found.coverage), (0.25, 0.75));
/// # Ok::<(), garad_eval::EvalError>(())
/// ```
pub fn ghosts(
    rendered: &DepthImage,
    background: &DepthImage,
    excluded: Option<&MaskImage>,
    min_gap_m: f64,
) -> Result<Ghosts, EvalError> {
    check_sizes(rendered, background, excluded)?;
    if !(min_gap_m > 0.0 && min_gap_m.is_finite()) {
        return Err(EvalError::Option {
            name: "min_gap_m",
            value: min_gap_m,
        });
    }
    let known = |z: f32| z.is_finite() && z > 0.0;
    let (mut in_front, mut pixels, mut covered) = (0usize, 0usize, 0usize);
    for i in judged(background.data().len(), excluded) {
        let (z, z_background) = (rendered.data()[i], background.data()[i]);
        if known(z_background) {
            pixels += 1;
            covered += usize::from(known(z));
            let ghost = known(z) && f64::from(z) < f64::from(z_background) - min_gap_m;
            in_front += usize::from(ghost);
        }
    }
    if pixels == 0 {
        return Err(no_pixels());
    }
    Ok(Ghosts {
        fraction: in_front as f64 / pixels as f64,
        ghosts: in_front,
        pixels,
        coverage: covered as f64 / pixels as f64,
    })
}

#[cfg(test)]
mod tests {
    use garad_core::Image;

    use super::*;

    fn row(values: &[f32]) -> DepthImage {
        Image::from_vec(values.len(), 1, values.to_vec()).expect("one row")
    }

    #[test]
    fn both_sides_of_the_gap() {
        // 2.5 and 0.5 are exact, so 2.0 is exactly on the threshold, which is not a ghost.
        let background = row(&[2.5; 4]);
        let rendered = row(&[2.0, 1.999_999_9, 2.6, 9.0]);
        let found = ghosts(&rendered, &background, None, 0.5).expect("four pixels");
        assert_eq!((found.ghosts, found.pixels), (1, 4), "{found:?}");
        let found = ghosts(&rendered, &background, None, 0.499_999).expect("four pixels");
        assert_eq!(found.ghosts, 2, "a smaller gap");
    }

    #[test]
    fn unknown_pixels_are_not_judged() {
        let background = row(&[0.0, f32::NAN, f32::INFINITY, 3.0, 3.0, 3.0]);
        let rendered = row(&[1.0, 1.0, 1.0, f32::NAN, 0.0, 1.0]);
        let found = ghosts(&rendered, &background, None, 0.1).expect("three pixels");
        assert_eq!((found.ghosts, found.pixels), (1, 3), "{found:?}");
        assert!((found.coverage - 1.0 / 3.0).abs() < 1e-15, "{found:?}");
        let mask = Image::from_vec(6, 1, vec![0, 0, 0, 0, 128, 255]).expect("6 pixels");
        let found = ghosts(&rendered, &background, Some(&mask), 0.1).expect("one pixel");
        assert_eq!((found.ghosts, found.pixels), (0, 1), "moving and unknown");
        let all = Image::new(6, 1, 255);
        let nothing = ghosts(&rendered, &background, Some(&all), 0.1);
        assert_eq!(nothing, Err(no_pixels()), "nothing left");
    }

    #[test]
    fn bad_input_is_reported() {
        let image = row(&[1.0; 3]);
        for gap in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            let error = ghosts(&image, &image, None, gap).expect_err("gap");
            assert!(error.to_string().starts_with("min_gap_m"), "{error}");
        }
        assert!(ghosts(&image, &row(&[1.0; 2]), None, 0.1).is_err(), "size");
        let mask = Image::new(2, 1, 0);
        assert!(ghosts(&image, &image, Some(&mask), 0.1).is_err(), "mask");
    }

    /// Whatever the render has in a hole is no ghost and no coverage.
    #[test]
    fn holes_of_the_render_are_judged_and_empty() {
        let background = row(&[4.0; 7]);
        let rendered = row(&[
            0.0,
            -0.0,
            -2.0,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            3.6,
        ]);
        let found = ghosts(&rendered, &background, None, 0.3).expect("seven pixels");
        assert_eq!((found.ghosts, found.pixels), (1, 7), "{found:?}");
        assert!((found.coverage - 1.0 / 7.0).abs() < 1e-15, "{found:?}");
        assert!((found.fraction - 1.0 / 7.0).abs() < 1e-15, "{found:?}");
        let holes = row(&[-1.0, 4.0, f32::NAN, 4.0, 4.0, f32::NEG_INFINITY, 0.0]);
        let found = ghosts(&row(&[3.0; 7]), &holes, None, 0.3).expect("three pixels");
        assert_eq!(
            (found.ghosts, found.pixels),
            (3, 3),
            "holes of the background"
        );
        let mask = Image::from_vec(7, 1, vec![0, 1, 0, 0, 255, 0, 0]).expect("7 pixels");
        let found = ghosts(&row(&[3.0; 7]), &holes, Some(&mask), 0.3).expect("one pixel");
        assert_eq!(
            (found.ghosts, found.pixels),
            (1, 1),
            "any value but 0 is excluded"
        );
    }
}
