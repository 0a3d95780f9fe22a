//! [`LkPyramid`]: an image made ready for tracking, once per frame.

use garad_core::GrayImage;
use garad_core::pyramid::{halve, reflect_101};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::WINDOW;
use crate::error::FeatureError;

/// Pixels kept around each level. A window may start 21 pixels before the first column or on the
/// last one; 25 leaves room for whole groups of 8 columns and for derivatives.
const PAD: usize = 25;

/// An image at several sizes, each with a mirrored border (reflect-101) around it.
///
/// Derivatives are not kept: they are needed in the windows of the first image alone, and taking
/// them there costs less than reading them from memory.
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

/// One level. Each pixel is kept together with its right neighbour: a bilinear sample is then two
/// products of pairs, for which processors have an instruction.
#[derive(Debug, Clone)]
pub(super) struct LkLevel {
    pub(super) width: usize,
    pub(super) height: usize,
    stride: usize,
    pairs: Vec<[i16; 2]>,
}

impl LkPyramid {
    /// The image and up to `above` levels, each half the size of the one before, as long as
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

    /// How many levels there are, the full image included.
    #[must_use]
    pub fn levels(&self) -> usize {
        self.levels.len()
    }

    /// Columns and rows of the full image.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.levels[0].width, self.levels[0].height)
    }

    /// The full image again.
    #[must_use]
    pub fn image(&self) -> GrayImage {
        let level = &self.levels[0];
        let at = |x: usize, y: usize| level.pairs[(y + PAD) * level.stride + x + PAD][0];
        GrayImage::from_fn(level.width, level.height, |x, y| {
            u8::try_from(at(x, y)).unwrap_or_default()
        })
    }

    /// Zero-mean normalised cross-correlation of the window of 21 x 21 pixels around a pixel and that around
    /// a pixel of another image, each position rounded; `None` beside the border, or if one window is flat.
    ///
    /// c = Σ (a - ā)(b - b̄) / √(Σ (a - ā)² Σ (b - b̄)²)
    ///
    /// # Numerics
    /// Sums in integers, hence exact.
    #[must_use]
    pub fn correlation(&self, at: [f32; 2], other: &Self, other_at: [f32; 2]) -> Option<f64> {
        let [a, b] = [(self, at), (other, other_at)].map(|(image, at)| image.levels[0].corner(at));
        let (a, b) = (a?, b?);
        let n = (WINDOW * WINDOW) as i64;
        let [mut sa, mut sb, mut aa, mut ab, mut bb] = [0i64; 5];
        for y in 0..WINDOW {
            let row = |level: &LkLevel, first: usize| first + y * level.stride;
            let (a, b) = (row(&self.levels[0], a), row(&other.levels[0], b));
            let a = &self.levels[0].pairs[a..a + WINDOW];
            let b = &other.levels[0].pairs[b..b + WINDOW];
            for (a, b) in a.iter().zip(b) {
                let (a, b) = (i64::from(a[0]), i64::from(b[0]));
                (sa, sb) = (sa + a, sb + b);
                (aa, ab, bb) = (aa + a * a, ab + a * b, bb + b * b);
            }
        }
        let [covariance, va, vb] = [n * ab - sa * sb, n * aa - sa * sa, n * bb - sb * sb];
        let scale = (va as f64).sqrt() * (vb as f64).sqrt();
        (scale > 0.0).then(|| covariance as f64 / scale)
    }

    pub(super) fn level(&self, level: usize) -> &LkLevel {
        &self.levels[level]
    }
}

/// Kept as the image and the number of levels above it: everything else follows, and takes five
/// times the room.
impl Serialize for LkPyramid {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.image(), self.levels.len() - 1).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for LkPyramid {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (image, above) = <(GrayImage, usize)>::deserialize(deserializer)?;
        Self::new(&image, above).map_err(de::Error::custom)
    }
}

impl LkLevel {
    /// Index of the first pixel of the window around a position, rounded; `None` beside the border.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within the image"
    )]
    fn corner(&self, [x, y]: [f32; 2]) -> Option<usize> {
        let half = (WINDOW / 2) as f32;
        let (left, top) = ((x + 0.5).floor() - half, (y + 0.5).floor() - half);
        let [right, bottom] = [left, top].map(|c| c + WINDOW as f32);
        let inside =
            left >= 0.0 && top >= 0.0 && right <= self.width as f32 && bottom <= self.height as f32;
        inside.then(|| (top as usize + PAD) * self.stride + left as usize + PAD)
    }

    pub(super) fn new(image: &GrayImage) -> Self {
        let (width, height) = image.size();
        let stride = width + 2 * PAD;
        let mirror = |i: usize, n: usize| reflect_101(i.cast_signed() - PAD.cast_signed(), n);
        let mut pairs = Vec::with_capacity(stride * (height + 2 * PAD));
        // One column more than the border: the last pair's neighbour.
        let mut padded = vec![0i16; stride + 1];
        for y in 0..height + 2 * PAD {
            let row = image.row(mirror(y, height));
            for (out, &v) in padded[PAD..].iter_mut().zip(row) {
                *out = i16::from(v);
            }
            for x in (0..PAD).chain(PAD + width..padded.len()) {
                padded[x] = i16::from(row[mirror(x, width)]);
            }
            pairs.extend(padded.windows(2).map(|w| [w[0], w[1]]));
        }
        Self {
            width,
            height,
            stride,
            pairs,
        }
    }

    /// The pairs from (x, y) on to the right, into the border; coordinates down to -PAD.
    #[inline]
    pub(super) fn pairs_from(&self, x: isize, y: isize) -> &[[i16; 2]] {
        let pad = PAD.cast_signed();
        let start = (y + pad).unsigned_abs() * self.stride + (x + pad).unsigned_abs();
        &self.pairs[start..]
    }

    /// Whether the pixel lies in the image, not in its border.
    #[inline]
    pub(super) fn contains(&self, x: isize, y: isize) -> bool {
        (0..self.width.cast_signed()).contains(&x) && (0..self.height.cast_signed()).contains(&y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_mirror_the_image() {
        let image = GrayImage::from_fn(30, 28, |x, y| u8::try_from(7 * x + y).expect("byte"));
        let level = LkLevel::new(&image);
        let pairs = |x, y| [level.pairs_from(x, y)[0], level.pairs_from(x, y)[1]];
        assert_eq!(pairs(-1, 3), [[10, 3], [3, 10]], "left of the image");
        assert_eq!(pairs(28, -1), [[197, 204], [204, 197]], "right and above");
        assert!(
            level.contains(0, 27) && !level.contains(-1, 0) && !level.contains(0, 28),
            "edge"
        );
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
