//! Images: row-major, pixel centres at integer coordinates.
//!
//! The image spans [-0.5, W-0.5] x [-0.5, H-0.5]; pixel (0, 0) has its centre at (0.0, 0.0).

use serde::{Deserialize, Deserializer, Serialize, de};

/// A row-major image of `width * height` pixels of type `T`.
///
/// # Example
/// ```
/// use garad_core::Image;
/// let mut image = Image::new(3, 2, 0u8);
/// image[(2, 1)] = 7; // column 2, row 1
/// assert_eq!(image.data(), [0, 0, 0, 0, 0, 7]);
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Image<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Image<T> {
    /// An image whose number of pixels is not its width times its height is refused.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Parts<T> {
            width: usize,
            height: usize,
            data: Vec<T>,
        }
        let Parts {
            width,
            height,
            data,
        } = Parts::deserialize(deserializer)?;
        if width.checked_mul(height) != Some(data.len()) {
            let pixels = data.len();
            return Err(de::Error::custom(format_args!(
                "{pixels} pixels for an image of {width} x {height}"
            )));
        }
        Ok(Self {
            width,
            height,
            data,
        })
    }
}

/// 8-bit grey.
pub type GrayImage = Image<u8>;
/// 8-bit colour, red first.
pub type RgbImage = Image<[u8; 3]>;
/// Depth in metres; 0 and NaN mean missing.
pub type DepthImage = Image<f32>;
/// 255 moving, 0 static, 128 unknown.
pub type MaskImage = Image<u8>;

impl<T: Clone> Image<T> {
    /// An image filled with one value.
    #[must_use]
    pub fn new(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }
}

impl<T> Image<T> {
    /// Takes `data` over as rows; `None` unless it holds exactly `width * height` pixels.
    #[must_use]
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Option<Self> {
        (data.len() == width.checked_mul(height)?).then_some(Self {
            width,
            height,
            data,
        })
    }

    /// Computes each pixel from its (column, row).
    pub fn from_fn(width: usize, height: usize, mut pixel: impl FnMut(usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                data.push(pixel(x, y));
            }
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// Columns.
    #[inline]
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }
    /// Rows.
    #[inline]
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }
    /// (columns, rows).
    #[inline]
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }
    /// All pixels, row by row.
    #[inline]
    #[must_use]
    pub fn data(&self) -> &[T] {
        &self.data
    }
    /// All pixels, row by row.
    #[inline]
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }
    /// The pixels themselves.
    #[must_use]
    pub fn into_vec(self) -> Vec<T> {
        self.data
    }
    /// One row.
    #[inline]
    #[must_use]
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }
    /// One row.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.width..(y + 1) * self.width]
    }
    /// The pixel, or `None` outside.
    #[inline]
    #[must_use]
    pub fn get(&self, x: usize, y: usize) -> Option<&T> {
        (x < self.width && y < self.height).then(|| &self.data[y * self.width + x])
    }
    /// An image of the same size, each pixel through `f`.
    #[must_use]
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Image<U> {
        Image {
            width: self.width,
            height: self.height,
            data: self.data.iter().map(f).collect(),
        }
    }
}

impl<T> std::ops::Index<(usize, usize)> for Image<T> {
    type Output = T;
    #[inline]
    fn index(&self, (x, y): (usize, usize)) -> &T {
        debug_assert!(x < self.width, "column {x} of {}", self.width);
        &self.data[y * self.width + x]
    }
}

impl<T> std::ops::IndexMut<(usize, usize)> for Image<T> {
    #[inline]
    fn index_mut(&mut self, (x, y): (usize, usize)) -> &mut T {
        debug_assert!(x < self.width, "column {x} of {}", self.width);
        &mut self.data[y * self.width + x]
    }
}

impl RgbImage {
    /// Luma of BT.601 in 14-bit integers, as `COLOR_RGB2GRAY` was up to OpenCV 3:
    /// (4899 R + 9617 G + 1868 B + 8192) >> 14. Later ones have 15 bits and differ by one level in one
    /// pixel of a thousand.
    #[must_use]
    pub fn to_gray(&self) -> GrayImage {
        self.map(|&[r, g, b]| {
            let y = 4899 * u32::from(r) + 9617 * u32::from(g) + 1868 * u32::from(b) + 8192;
            #[allow(
                clippy::cast_possible_truncation,
                reason = "the weights sum to 2^14, so y >> 14 <= 255"
            )]
            let y = (y >> 14) as u8;
            y
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_vec_refuses_a_wrong_count() {
        assert!(Image::from_vec(2, 2, vec![1u8; 3]).is_none(), "too few");
        assert!(
            Image::<u8>::from_vec(usize::MAX, 2, vec![]).is_none(),
            "overflowing size"
        );
    }

    #[test]
    fn gray_keeps_gray_and_weighs_colours() {
        let gray = RgbImage::from_fn(256, 1, |x, _| [u8::try_from(x).expect("below 256"); 3]);
        for (x, &y) in gray.to_gray().data().iter().enumerate() {
            assert_eq!(usize::from(y), x, "grey stays what it was");
        }
        // 0.299, 0.587, 0.114 of 255
        let primary = RgbImage::from_vec(3, 1, vec![[255, 0, 0], [0, 255, 0], [0, 0, 255]]);
        assert_eq!(primary.expect("3 pixels").to_gray().data(), [76, 150, 29]);
    }
}
