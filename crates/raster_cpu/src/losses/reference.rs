//! [`ssim`] and [`photometric`] as plain sequences of images, in the order of the formulas: what
//! the functions of the same names one level up are compared with.
//!
//! Formulas, shapes, units and errors are written there.

use garad_core::{Image, MaskImage, Par, Real};

use super::image_loss::{ImageLoss, check_lambda, check_sizes, count_included, included};
use super::l1::l1;
use crate::error::RasterError;

pub(super) const RADIUS: usize = 5;
pub(super) const TAPS: usize = 2 * RADIUS + 1;
const SIGMA_PX: f64 = 1.5;
/// (0.01 · 1)²: keeps the quotient of means away from 0/0 in the dark.
pub(super) const C1: f64 = 1e-4;
/// (0.03 · 1)²: the same for the variances, where nothing varies.
pub(super) const C2: f64 = 9e-4;

/// As [`super::ssim()`], one channel after the other, one image per term.
///
/// # Numerics
/// Separable, in `T`: rows, then columns, taps in their order. Same bits for every `par`.
/// # Errors
/// [`RasterError::SizeMismatch`].
pub fn ssim<T: Real>(
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<ImageLoss<T>, RasterError> {
    check_sizes(rendered.size(), &[("target", target.size())], excluded)?;
    let pixels = count_included(excluded, rendered.data().len());
    let terms = 3.0 * pixels.max(1) as f64;
    let channels = par.map(3, |channel| {
        one_channel(
            channel,
            rendered,
            target,
            excluded,
            T::from_f64(1.0 / terms),
        )
    });
    let (width, height) = rendered.size();
    Ok(ImageLoss {
        value: T::from_f64(channels.iter().fold(0.0, |sum, c| sum + c.0) / terms),
        gradient: Image::from_fn(width, height, |x, y| {
            [0, 1, 2].map(|channel| channels[channel].1[(x, y)])
        }),
        pixels,
    })
}

/// Σ S over included pixels, and `share` times its gradient.
fn one_channel<T: Real>(
    channel: usize,
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    excluded: Option<&MaskImage>,
    share: T,
) -> (f64, Image<T>) {
    let (width, height) = target.size();
    let two = T::from_f64(2.0);
    let pair = |i: usize| {
        let y = target.data()[i][channel];
        let x = if included(excluded, i) {
            rendered.data()[i][channel]
        } else {
            y
        };
        (x, y)
    };
    // The two variances are only ever added: one sum of squares carries both.
    let moments = Image::from_fn(width, height, |u, v| {
        let (x, y) = pair(v * width + u);
        [x, y, x * x + y * y, x * y]
    });
    let (mut sum, mut i) = (0.0, 0);
    let slopes = blurred(&moments).map(|moments| {
        i += 1;
        if !included(excluded, i - 1) {
            return [T::ZERO; 3];
        }
        let (s, slopes) = similarity(*moments);
        sum += s.to_f64();
        slopes.map(|slope| share * slope)
    });
    let slopes = blurred(&slopes);
    let gradient = Image::from_fn(width, height, |u, v| {
        let i = v * width + u;
        if !included(excluded, i) {
            return T::ZERO;
        }
        let (x, y) = pair(i);
        let [by_mean, by_square, by_product] = slopes.data()[i];
        by_mean + two * x * by_square + y * by_product
    });
    (sum, gradient)
}

/// As [`super::photometric()`] (Eq. 13), from [`l1()`] and [`ssim`].
///
/// # Errors
/// [`RasterError::SizeMismatch`]; [`RasterError::Lambda`].
pub fn photometric<T: Real>(
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    lambda: f64,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<ImageLoss<T>, RasterError> {
    check_lambda(lambda)?;
    let absolute = l1(rendered, target, excluded)?;
    let structure = ssim(rendered, target, excluded, par)?;
    let pixels = absolute.pixels;
    let (rest, lambda) = (T::from_f64(1.0 - lambda), T::from_f64(lambda));
    // Without pixels the loss is 0.
    let similarity = if pixels == 0 { T::ONE } else { structure.value };
    let (width, height) = rendered.size();
    Ok(ImageLoss {
        value: rest * absolute.value + lambda * (T::ONE - similarity),
        gradient: Image::from_fn(width, height, |x, y| {
            let (a, s) = (absolute.gradient[(x, y)], structure.gradient[(x, y)]);
            [0, 1, 2].map(|channel| rest * a[channel] - lambda * s[channel])
        }),
        pixels,
    })
}

/// S of (μₓ, μᵧ, g∗(x² + y²), g∗(xy)), and its derivatives by μₓ, g∗x² and g∗(xy):
///
/// ∂S/∂(g∗xy) = 2 A₁/(B₁ B₂),   ∂S/∂(g∗x²) = -S/B₂,
/// ∂S/∂μₓ = 2 (μᵧ A₂/B₂ - μₓ S)/B₁ - μᵧ ∂S/∂(g∗xy) - 2 μₓ ∂S/∂(g∗x²)
fn similarity<T: Real>([mx, my, squares, product]: [T; 4]) -> (T, [T; 3]) {
    let two = T::from_f64(2.0);
    let (c1, c2) = (T::from_f64(C1), T::from_f64(C2));
    let means = mx * mx + my * my;
    let (a1, a2) = (two * mx * my + c1, two * (product - mx * my) + c2);
    let (b1, b2) = (means + c1, (squares - means) + c2);
    let s = (a1 / b1) * (a2 / b2);
    let by_product = two * (a1 / b1) / b2;
    let by_square = -s / b2;
    let by_mean = two * (my * (a2 / b2) - mx * s) / b1 - my * by_product - two * mx * by_square;
    (s, [by_mean, by_square, by_product])
}

/// exp(-d²/2σ²), divided by its sum.
pub(super) fn taps<T: Real>() -> [T; TAPS] {
    let taps: [f64; TAPS] = std::array::from_fn(|k| {
        let d = k as f64 - RADIUS as f64;
        Real::exp(-d * d / (2.0 * SIGMA_PX * SIGMA_PX))
    });
    let sum = taps.iter().fold(0.0, |sum, tap| sum + tap);
    taps.map(|tap| T::from_f64(tap / sum))
}

/// g∗field, component by component, zeros outside: rows, then columns.
///
/// Taps are the outer loop and numbers side by side the inner one, which vectorises; every sum
/// still runs over the taps in their order.
fn blurred<T: Real, const N: usize>(field: &Image<[T; N]>) -> Image<[T; N]> {
    let (width, height) = field.size();
    let taps = taps::<T>();
    let mut along = Image::new(width, height, [T::ZERO; N]);
    let mut padded = vec![T::ZERO; (width + 2 * RADIUS) * N];
    for y in 0..height {
        padded[RADIUS * N..][..width * N].copy_from_slice(field.row(y).as_flattened());
        let row = along.row_mut(y).as_flattened_mut();
        for (k, tap) in taps.iter().enumerate() {
            add_scaled(row, *tap, &padded[k * N..]);
        }
    }
    let mut both = Image::new(width, height, [T::ZERO; N]);
    for y in 0..height {
        let row = both.row_mut(y).as_flattened_mut();
        for (k, tap) in taps.iter().enumerate() {
            // Row y + k - 5, where there is one.
            if let Some(from) = (y + k).checked_sub(RADIUS).filter(|&row| row < height) {
                add_scaled(row, *tap, along.row(from).as_flattened());
            }
        }
    }
    both
}

#[inline]
fn add_scaled<T: Real>(sums: &mut [T], weight: T, values: &[T]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += weight * *value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn taps_add_to_one_and_a_point_becomes_the_window() {
        let taps = taps::<f64>();
        assert!((taps.iter().sum::<f64>() - 1.0).abs() < 1e-15, "sum");
        assert!(
            (taps[0] - taps[10]).abs() < 1e-18 && taps[4] < taps[5],
            "{taps:?}"
        );
        let mut point = Image::new(15, 9, [0.0f64]);
        point[(7, 1)] = [1.0];
        let window = blurred(&point);
        assert!(
            (window[(9, 4)][0] - taps[7] * taps[8]).abs() < 1e-17,
            "two right, three down"
        );
        assert!(window[(1, 1)][0].abs() < 1e-300, "six to the left");
    }

    #[test]
    fn similarity_by_hand() {
        // Means 0.5 and 0.3, both variances 0.01, covariance 0.005.
        let (s, _) = similarity([0.5, 0.3, 0.25 + 0.09 + 0.02, 0.15 + 0.005]);
        let by_hand = (0.3001 / 0.3401) * (0.0109 / 0.0209);
        assert!((s - by_hand).abs() < 1e-14, "{s} against {by_hand}");
    }
}
