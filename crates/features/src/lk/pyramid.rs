//! [`LkPyramid`]: a picture made ready for tracking, once per frame.

use garad_core::pyramid::{halve, reflect_101};
use garad_core::{GrayImage, Image};

use super::WINDOW;
use crate::error::FeatureError;

/// Pixels kept around each level. A window may start 21 pixels before the first column or on the
/// last one; 25 leaves room for whole groups of 8 columns behind it.
const PAD: usize = 25;

/// A picture at several sizes with its derivatives, each with a border around it.
///
/// # Example
/// ```
/// use garad_core::GrayImage;
/// use garad_features::LkPyramid;
/// let pyramid = LkPyramid::new(&GrayImage::new(100, 60, 8), 3)?;
/// assert_eq!(pyramid.levels(), 2); // a third, 25 x 15, would be smaller than the window
/// # Ok::<(), garad_features::FeatureError>(())
/// ```
#[derive(Debug, Clone)]
pub struct LkPyramid {
    levels: Vec<LkLevel>,
}

/// One level: intensity, ∂/∂x, ∂/∂y.
#[derive(Debug, Clone)]
pub(super) struct LkLevel {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) intensity: Plane,
    pub(super) dx: Plane,
    pub(super) dy: Plane,
}

/// Pixels with [`PAD`] more on every side, each together with its right neighbour: a bilinear
/// sample is then two products of pairs, for which processors have an instruction.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    stride: usize,
    pairs: Vec<[i16; 2]>,
}

impl Plane {
    /// The pairs from (x, y) on to the right, into the border; coordinates down to -PAD.
    #[inline]
    pub(super) fn from(&self, x: isize, y: isize) -> &[[i16; 2]] {
        let pad = PAD.cast_signed();
        let start = (y + pad).unsigned_abs() * self.stride + (x + pad).unsigned_abs();
        &self.pairs[start..]
    }

    /// With a border of zeros.
    fn zero_padded(image: &Image<i16>) -> Self {
        let (w, h) = image.size();
        Self::from_rows(w, h, |y, padded| {
            if (PAD..PAD + h).contains(&y) {
                padded[PAD..PAD + w].copy_from_slice(image.row(y - PAD));
            } else {
                padded.fill(0);
            }
        })
    }

    /// With a mirrored border (reflect-101).
    fn mirrored(image: &GrayImage) -> Self {
        let (w, h) = image.size();
        let mirror = |i: usize, n: usize| reflect_101(i.cast_signed() - PAD.cast_signed(), n);
        Self::from_rows(w, h, |y, padded| {
            let row = image.row(mirror(y, h));
            for (out, &v) in padded[PAD..PAD + w].iter_mut().zip(row) {
                *out = i16::from(v);
            }
            for x in (0..PAD).chain(PAD + w..padded.len()) {
                padded[x] = i16::from(row[mirror(x, w)]);
            }
        })
    }

    /// `fill` writes the padded row y; the last pair of a row lacks its neighbour and has one
    /// column more to take it from.
    fn from_rows(w: usize, h: usize, mut fill: impl FnMut(usize, &mut [i16])) -> Self {
        let stride = w + 2 * PAD;
        let mut padded = vec![0; stride + 1];
        let mut pairs = vec![[0; 2]; stride * (h + 2 * PAD)];
        for (y, out) in pairs.chunks_exact_mut(stride).enumerate() {
            fill(y, &mut padded);
            for (pair, neighbours) in out.iter_mut().zip(padded.windows(2)) {
                *pair = [neighbours[0], neighbours[1]];
            }
        }
        Self { stride, pairs }
    }
}

impl LkPyramid {
    /// The picture and up to `above` levels, each half the size of the one before, as long as
    /// they are larger than the window of 21 pixels in both directions.
    ///
    /// # Errors
    /// [`FeatureError::EmptyImage`].
    pub fn new(image: &GrayImage, above: usize) -> Result<Self, FeatureError> {
        let (width, height) = image.size();
        if width == 0 || height == 0 {
            return Err(FeatureError::EmptyImage { width, height });
        }
        let mut levels = vec![LkLevel::new(image)];
        let mut image = image.clone();
        for _ in 0..above {
            if image.width().div_ceil(2) <= WINDOW || image.height().div_ceil(2) <= WINDOW {
                break;
            }
            image = halve(&image);
            levels.push(LkLevel::new(&image));
        }
        Ok(Self { levels })
    }

    /// How many levels there are, the full picture included.
    #[must_use]
    pub fn levels(&self) -> usize {
        self.levels.len()
    }

    /// Columns and rows of the full picture.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.levels[0].width, self.levels[0].height)
    }

    pub(super) fn level(&self, level: usize) -> &LkLevel {
        &self.levels[level]
    }
}

impl LkLevel {
    fn new(image: &GrayImage) -> Self {
        let (dx, dy) = scharr(image);
        Self {
            width: image.width(),
            height: image.height(),
            intensity: Plane::mirrored(image),
            dx: Plane::zero_padded(&dx),
            dy: Plane::zero_padded(&dy),
        }
    }
}

/// Derivatives by Scharr's filter, 32 times the grey levels per pixel:
///
/// dx = [3 10 3]ᵀ ⊗ [-1 0 1],  dy = [-1 0 1]ᵀ ⊗ [3 10 3]
///
/// with reflect-101 at the edge. |value| ≤ 255 · 16. Bit-equal to OpenCV's `Scharr`.
/// Golden: `pyramid/*` (`scharr_x`, `scharr_y`).
#[must_use]
pub fn scharr(image: &GrayImage) -> (Image<i16>, Image<i16>) {
    let (w, h) = image.size();
    let (mut dx, mut dy) = (Image::new(w, h, 0i16), Image::new(w, h, 0i16));
    // One row smoothed and one differentiated along y, each with a mirrored pixel at both ends.
    let (mut smooth, mut slope) = (vec![0i16; w + 2], vec![0i16; w + 2]);
    for y in 0..h {
        let row = |d: isize| image.row(reflect_101(y.cast_signed() + d, h));
        let rows = row(-1).iter().zip(row(0)).zip(row(1));
        let columns = smooth[1..].iter_mut().zip(&mut slope[1..]);
        for ((smooth, slope), ((&a, &b), &c)) in columns.zip(rows) {
            let [a, b, c] = [a, b, c].map(i16::from);
            *smooth = 3 * (a + c) + 10 * b;
            *slope = c - a;
        }
        for ends in [&mut smooth, &mut slope] {
            ends[0] = ends[1 + reflect_101(-1, w)];
            ends[w + 1] = ends[1 + reflect_101(w.cast_signed(), w)];
        }
        for (dx, s) in dx.row_mut(y).iter_mut().zip(smooth.windows(3)) {
            *dx = s[2] - s[0];
        }
        for (dy, s) in dy.row_mut(y).iter_mut().zip(slope.windows(3)) {
            *dy = 3 * (s[0] + s[2]) + 10 * s[1];
        }
    }
    (dx, dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_of_a_ramp() {
        // 2 grey levels per column, 3 per row: 32 times that, halved nowhere but at the mirrored edge.
        let ramp = GrayImage::from_fn(6, 5, |x, y| u8::try_from(2 * x + 3 * y).expect("byte"));
        let (dx, dy) = scharr(&ramp);
        assert_eq!([dx[(2, 2)], dy[(2, 2)]], [64, 96], "32 x slope");
        assert_eq!(
            [dx[(0, 2)], dx[(5, 2)], dy[(2, 0)], dy[(2, 4)]],
            [0; 4],
            "mirrored edge"
        );
        let (dx, dy) = scharr(&GrayImage::new(1, 1, 9));
        assert_eq!([dx[(0, 0)], dy[(0, 0)]], [0, 0], "a single pixel");
    }

    #[test]
    fn largest_derivative_is_16_times_white() {
        let step = GrayImage::from_fn(4, 3, |x, _| if x < 2 { 0 } else { 255 });
        assert_eq!(scharr(&step).0[(1, 1)], 255 * 16, "16 bits are enough");
    }

    #[test]
    fn borders_mirror_the_picture_and_silence_the_derivatives() {
        let image = GrayImage::from_fn(30, 28, |x, y| u8::try_from(7 * x + y).expect("byte"));
        let level = LkLevel::new(&image);
        assert_eq!(
            level.intensity.from(-2, 3)[..3],
            [[17, 10], [10, 3], [3, 10]],
            "left of the picture"
        );
        assert_eq!(
            level.intensity.from(28, -1)[..2],
            [[197, 204], [204, 197]],
            "right and above"
        );
        assert_eq!(
            level.dx.from(-1, 5)[0],
            [0, 0],
            "outside, and the mirrored first column"
        );
        assert_eq!(level.dx.from(1, 5)[0][0], 7 * 32, "inside");
    }

    #[test]
    fn levels_stop_above_the_window() {
        let levels = |w, h| LkPyramid::new(&GrayImage::new(w, h, 0), 3).map(|p| p.levels());
        assert_eq!(levels(640, 480), Ok(4), "three above the base");
        assert_eq!(levels(42, 100), Ok(1), "half of 42 is the window itself");
        assert_eq!(levels(43, 100), Ok(2), "half of 43 is one more");
        assert_eq!(
            levels(0, 5),
            Err(FeatureError::EmptyImage {
                width: 0,
                height: 5
            }),
            "empty"
        );
    }
}
