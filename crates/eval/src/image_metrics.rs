//! PSNR and SSIM of a rendered image against the recorded one.
//!
//! Everything is computed in f64 for any type of pixel. If a mask is given, pixels that are not 0 in it
//! (moving or unknown) have no influence: since SSIM's windows extend over the edge of the mask, the
//! render is first replaced by the recorded image inside it. A masked SSIM is therefore the mean over the
//! static pixels; the windows within 5 px of the mask are partly perfect by construction, so narrow gaps
//! between masks are rated too well.

use garad_core::{Image, MaskImage, Par, Real};

use crate::EvalError;

/// A pixel of one or more channels with values in [0, 1]; `u8` is divided by 255.
pub trait Pixel: Copy + Send + Sync {
    /// Number of channels.
    const CHANNELS: usize;
    /// Value of a channel.
    fn channel(self, c: usize) -> f64;
}

macro_rules! impl_pixel {
    ($($t:ty: $to_unit:expr),*) => { $(
        impl Pixel for $t {
            const CHANNELS: usize = 1;
            fn channel(self, _: usize) -> f64 {
                $to_unit(self)
            }
        }
        impl<const C: usize> Pixel for [$t; C] {
            const CHANNELS: usize = C;
            fn channel(self, c: usize) -> f64 {
                $to_unit(self[c])
            }
        }
    )* };
}
impl_pixel!(u8: |v| f64::from(v) / 255.0, f32: f64::from, f64: |v| v);

/// PSNR and SSIM of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageQuality {
    /// Decibels; infinite for equal images.
    pub psnr_db: f64,
    /// 1 for equal images.
    pub ssim: f64,
    /// Pixels judged.
    pub pixels: usize,
}

/// [`psnr_db`] and [`ssim`] of one pair of images.
///
/// # Errors
/// As [`psnr_db`].
pub fn compare_images<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<ImageQuality, EvalError> {
    let pixels = check(render, truth, excluded)?;
    Ok(ImageQuality {
        psnr_db: psnr_of_checked(render, truth, excluded, pixels),
        ssim: ssim_of_checked(render, truth, excluded, pixels, par),
        pixels,
    })
}

/// Peak signal-to-noise ratio for a peak of 1,
///
/// PSNR = -10 log₁₀( Σ (x - y)² / n ),   n = judged pixels times channels.
///
/// Infinite when the images are equal. Source: its definition. Golden: `image_metrics/*`.
///
/// # Errors
/// [`EvalError::SizeMismatch`]; [`EvalError::NonFinite`] with the index of the first bad judged
/// pixel; [`EvalError::TooFew`] when no pixel is left.
pub fn psnr_db<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
) -> Result<f64, EvalError> {
    let pixels = check(render, truth, excluded)?;
    Ok(psnr_of_checked(render, truth, excluded, pixels))
}

fn psnr_of_checked<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
    pixels: usize,
) -> f64 {
    let mut sum = 0.0;
    for i in judged(render.data().len(), excluded) {
        for c in 0..A::CHANNELS {
            let d = render.data()[i].channel(c) - truth.data()[i].channel(c);
            sum += d * d;
        }
    }
    let mse = sum / (pixels * A::CHANNELS) as f64;
    -10.0 * Real::ln(mse) / std::f64::consts::LN_10
}

/// Mean of [`ssim_map`] over the judged pixels and channels.
///
/// With a mask the render is replaced by the recorded image inside it before windows are taken, and the
/// mean is over the pixels outside.
///
/// # Errors
/// As [`psnr_db`].
pub fn ssim<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<f64, EvalError> {
    let pixels = check(render, truth, excluded)?;
    Ok(ssim_of_checked(render, truth, excluded, pixels, par))
}

fn ssim_of_checked<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
    pixels: usize,
    par: Par,
) -> f64 {
    let map = similarity(render, truth, excluded, par);
    let sum = judged(map.data().len(), excluded).fold(0.0, |sum, i| sum + map.data()[i]);
    sum / pixels as f64
}

/// Structural similarity around each pixel, mean over channels:
///
/// SSIM = (2 μₓ μᵧ + C₁)(2 σₓᵧ + C₂) / ((μₓ² + μᵧ² + C₁)(σₓ² + σᵧ² + C₂))
///
/// with μ = g∗x, σₓ² = g∗x² - μₓ², σₓᵧ = g∗(xy) - μₓ μᵧ; g an 11x11 Gaussian of sigma 1.5 px and
/// sum 1, zeros outside the image, C₁ = 0.01², C₂ = 0.03².
///
/// Source: Wang et al. 2004, with the padding of the 3DGS training code (others crop or reflect:
/// figures differ within 5 px of the border). Golden: `image_metrics/ssim_*`.
///
/// # Numerics
/// Separable, f64; the two variances are only ever added, so one sum g∗(x² + y²) carries both.
/// Same bits for every `par`.
/// # Errors
/// As [`psnr_db`].
pub fn ssim_map<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    par: Par,
) -> Result<Image<f64>, EvalError> {
    check(render, truth, None)?;
    Ok(similarity(render, truth, None, par))
}

const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
const SIGMA_PX: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Rows per piece of work: small enough to balance two threads.
const ROWS_PER_CHUNK: usize = 16;

/// exp(-d²/2σ²), divided by its sum.
fn gaussian_taps() -> [f64; TAPS] {
    let taps: [f64; TAPS] = std::array::from_fn(|k| {
        let d = k as f64 - RADIUS as f64;
        Real::exp(-d * d / (2.0 * SIGMA_PX * SIGMA_PX))
    });
    let sum = taps.iter().fold(0.0, |sum, tap| sum + tap);
    taps.map(|tap| tap / sum)
}

/// x, y, x² + y², xy.
type Moments = [f64; 4];

fn add_scaled(sum: &mut Moments, weight: f64, m: &Moments) {
    for i in 0..4 {
        sum[i] += weight * m[i];
    }
}

/// [`ssim_map`] of checked images.
fn similarity<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Image<f64> {
    let (width, height) = truth.size();
    let taps = gaussian_taps();
    let mut map = Image::new(width, height, 0.0);
    let mut filtered: Vec<Moments> = vec![[0.0; 4]; width * height];
    for c in 0..A::CHANNELS {
        let moments = |i: usize| {
            let y = truth.data()[i].channel(c);
            let x = match excluded {
                Some(mask) if mask.data()[i] != 0 => y,
                _ => render.data()[i].channel(c),
            };
            [x, y, x * x + y * y, x * y]
        };
        // Along rows: image → filtered.
        par.for_each_chunk_mut(&mut filtered, ROWS_PER_CHUNK * width, |chunk, rows| {
            let mut padded = vec![[0.0; 4]; width + 2 * RADIUS];
            for (r, row) in rows.chunks_mut(width).enumerate() {
                let first = (chunk * ROWS_PER_CHUNK + r) * width;
                for x in 0..width {
                    padded[RADIUS + x] = moments(first + x);
                }
                for (out, window) in row.iter_mut().zip(padded.windows(TAPS)) {
                    *out = [0.0; 4];
                    for (tap, m) in taps.iter().zip(window) {
                        add_scaled(out, *tap, m);
                    }
                }
            }
        });
        // Along columns: filtered → map.
        par.for_each_chunk_mut(map.data_mut(), ROWS_PER_CHUNK * width, |chunk, rows| {
            let mut sums = vec![[0.0; 4]; width];
            for (r, row) in rows.chunks_mut(width).enumerate() {
                let y = chunk * ROWS_PER_CHUNK + r;
                sums.fill([0.0; 4]);
                for (k, tap) in taps.iter().enumerate() {
                    let Some(source) = (y + k).checked_sub(RADIUS).filter(|&s| s < height) else {
                        continue;
                    };
                    let source = &filtered[source * width..(source + 1) * width];
                    for (sum, m) in sums.iter_mut().zip(source) {
                        add_scaled(sum, *tap, m);
                    }
                }
                for (out, sum) in row.iter_mut().zip(&sums) {
                    *out += similarity_of(sum) / A::CHANNELS as f64;
                }
            }
        });
    }
    map
}

fn similarity_of(&[mx, my, squares, product]: &Moments) -> f64 {
    let means2 = mx * mx + my * my;
    (2.0 * mx * my + C1) * (2.0 * (product - mx * my) + C2)
        / ((means2 + C1) * (squares - means2 + C2))
}

pub(crate) fn no_pixels() -> EvalError {
    EvalError::TooFew {
        what: "pixels to compare",
        got: 0,
        needed: 1,
    }
}

/// Indices of the judged pixels.
pub(crate) fn judged(n: usize, excluded: Option<&MaskImage>) -> impl Iterator<Item = usize> {
    (0..n).filter(move |&i| excluded.is_none_or(|mask| mask.data()[i] == 0))
}

pub(crate) fn check_sizes<A, B>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
) -> Result<(), EvalError> {
    let mask_size = excluded.map_or(truth.size(), Image::size);
    for (what, size) in [("render", render.size()), ("mask", mask_size)] {
        if size != truth.size() {
            return Err(EvalError::SizeMismatch {
                what,
                expected: truth.size(),
                got: size,
            });
        }
    }
    Ok(())
}

/// Number of judged pixels; all of them are finite.
fn check<A: Pixel, B: Pixel>(
    render: &Image<A>,
    truth: &Image<B>,
    excluded: Option<&MaskImage>,
) -> Result<usize, EvalError> {
    check_sizes(render, truth, excluded)?;
    if A::CHANNELS != B::CHANNELS {
        return Err(EvalError::SizeMismatch {
            what: "channels",
            expected: (B::CHANNELS, 1),
            got: (A::CHANNELS, 1),
        });
    }
    let mut pixels = 0;
    for index in 0..truth.data().len() {
        let counts = excluded.is_none_or(|mask| mask.data()[index] == 0);
        pixels += usize::from(counts);
        for c in 0..A::CHANNELS {
            // Inside the mask the true image still enters SSIM's windows.
            if counts && !render.data()[index].channel(c).is_finite() {
                let what = "pixel of the render";
                return Err(EvalError::NonFinite { what, index });
            }
            if !truth.data()[index].channel(c).is_finite() {
                let what = "pixel of the recorded image";
                return Err(EvalError::NonFinite { what, index });
            }
        }
    }
    if pixels == 0 {
        return Err(no_pixels());
    }
    Ok(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;

    fn noise(seed: u64, width: usize, height: usize) -> Image<[f32; 3]> {
        let mut rng = Rng::new(seed);
        #[allow(clippy::cast_possible_truncation, reason = "any colour will do")]
        Image::from_fn(width, height, |_, _| [0; 3].map(|_| rng.uniform() as f32))
    }

    #[test]
    fn psnr_by_hand() {
        let black = Image::new(4, 3, 0.0f64);
        let grey = Image::new(4, 3, 0.1f64);
        let psnr = psnr_db(&black, &grey, None).expect("same size");
        assert!((psnr - 20.0).abs() < 1e-12, "MSE 0.01: {psnr}");
        let equal = psnr_db(&grey, &grey, None).expect("same size");
        assert!(equal == f64::INFINITY, "no error: {equal}");
    }

    #[test]
    fn ssim_of_an_image_with_itself_is_one() {
        let x = noise(1, 23, 17);
        let map = ssim_map(&x, &x, Par::Seq).expect("same image");
        let worst = map
            .data()
            .iter()
            .fold(0.0, |w: f64, s| w.max((s - 1.0).abs()));
        assert!(worst < 1e-12, "{worst}");
    }

    /// The formula typed again with the full 11x11 window.
    #[test]
    fn spec_ssim() {
        let (x, y) = (noise(1, 14, 9), noise(2, 14, 9));
        let map = ssim_map(&x, &y, Par::Seq).expect("same size");
        let g = |d: i64| Real::exp(-(d * d) as f64 / 4.5);
        let norm: f64 = (-5..=5).map(g).sum();
        for (px, py) in [(0, 0), (7, 4), (13, 8), (2, 6)] {
            let mut expected = 0.0;
            for c in 0..3 {
                let e = |f: &dyn Fn(f64, f64) -> f64| {
                    let mut sum = 0.0;
                    for dy in -5i64..=5 {
                        for dx in -5i64..=5 {
                            let at = usize::try_from(px + dx)
                                .ok()
                                .zip(usize::try_from(py + dy).ok());
                            if let Some((u, v)) = at
                                && let (Some(a), Some(b)) = (x.get(u, v), y.get(u, v))
                            {
                                let w = g(dx) * g(dy) / (norm * norm);
                                sum += w * f(a[c].into(), b[c].into());
                            }
                        }
                    }
                    sum
                };
                let (mx, my) = (e(&|a, _| a), e(&|_, b| b));
                let (vx, vy) = (e(&|a, _| a * a) - mx * mx, e(&|_, b| b * b) - my * my);
                let cov = e(&|a, b| a * b) - mx * my;
                expected += (2.0 * mx * my + 1e-4) * (2.0 * cov + 9e-4)
                    / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4))
                    / 3.0;
            }
            let at = (
                usize::try_from(px).expect("≥ 0"),
                usize::try_from(py).expect("≥ 0"),
            );
            assert!(
                (map[at] - expected).abs() < 1e-13,
                "{at:?}: {} {expected}",
                map[at]
            );
        }
    }

    #[test]
    fn threads_change_no_bit() {
        let (x, y) = (noise(1, 50, 70), noise(2, 50, 70));
        let sequential = ssim_map(&x, &y, Par::Seq).expect("same size");
        for threads in [2, 3] {
            let map = ssim_map(&x, &y, Par::new(threads)).expect("same size");
            assert_eq!(map, sequential, "{threads} threads");
        }
    }

    /// Pixels inside the mask have no influence, pixels outside have.
    #[test]
    fn masked_pixels_neither_count_nor_leak() {
        let (x, y) = (noise(1, 30, 20), noise(2, 30, 20));
        let mask = Image::from_fn(30, 20, |u, v| match (u, v) {
            (5..12, 3..15) => 255,
            (12..14, _) => 128,
            _ => 0,
        });
        let judge = |x: &Image<[f32; 3]>| compare_images(x, &y, Some(&mask), Par::Seq);
        let before = judge(&x).expect("same size");
        assert_eq!(before.pixels, 600 - 7 * 12 - 2 * 20, "judged pixels");
        let mut hidden = x.clone();
        hidden[(6, 4)] = [9.0; 3];
        hidden[(12, 0)] = [f32::NAN; 3];
        assert_eq!(judge(&hidden), Ok(before), "inside the mask");
        let mut seen = x.clone();
        seen[(4, 4)] = [0.5; 3];
        assert_ne!(judge(&seen), Ok(before), "beside it");
        let nothing = compare_images(&x, &y, Some(&Image::new(30, 20, 255)), Par::Seq);
        assert_eq!(nothing, Err(no_pixels()), "nothing left");
    }

    #[test]
    fn bytes_are_divided_by_255() {
        let bytes = Image::new(12, 12, [51u8, 102, 255]);
        let floats = Image::new(12, 12, [0.2f64, 0.4, 1.0]);
        let psnr = psnr_db(&bytes, &floats, None).expect("same size");
        assert!(psnr > 300.0, "equal up to rounding: {psnr}");
    }

    #[test]
    fn bad_input_is_reported() {
        let x = noise(1, 8, 8);
        let error = psnr_db(&x, &noise(1, 8, 7), None).expect_err("size");
        let text = "render: expected (8, 7), got (8, 8)";
        assert_eq!(error.to_string(), text, "size");
        let mut bad = x.clone();
        bad[(3, 1)][2] = f32::NAN;
        for result in [psnr_db(&bad, &x, None), ssim(&x, &bad, None, Par::Seq)] {
            let error = result.expect_err("NaN");
            assert!(
                matches!(error, EvalError::NonFinite { index: 11, .. }),
                "{error}"
            );
        }
        let empty = Image::<f64>::new(0, 0, 0.0);
        assert_eq!(psnr_db(&empty, &empty, None), Err(no_pixels()), "empty");
        let grey = Image::new(8, 8, 0.0f64);
        assert!(psnr_db(&x, &grey, None).is_err(), "channels");
    }
}
