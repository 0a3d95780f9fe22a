//! PNG and JPEG to images: kind, size and completeness checked, always within [`crate::limits`].
//!
//! PNG is lossless: its pixels are the same everywhere. JPEG decoders differ by about one unit, so results
//! on JPEG recordings depend on the decoder of this build.

use std::io::Cursor;
use std::path::Path;

use garad_core::{DepthImage, MaskImage, RgbImage};
use image::{ColorType, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::errors::DatasetError;
use crate::limits;

const COLOUR: &str = "an 8-bit PNG or JPEG";
const DEPTH: &str = "a 16-bit grey PNG";
const MASK: &str = "an 8-bit grey PNG of 0 (static), 128 (unknown) and 255 (moving)";

const WHOLE: &str = "a decoder returns every pixel of the size in its header";

/// The file an image comes from, and the frame it belongs to, for messages.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Origin<'a> {
    pub(crate) frame: Option<usize>,
    pub(crate) path: &'a Path,
}

impl Origin<'_> {
    fn error(self, problem: impl ToString, expected: &'static str) -> DatasetError {
        DatasetError::Image {
            frame: self.frame,
            path: self.path.to_path_buf(),
            problem: problem.to_string().replace('\n', " "),
            expected,
        }
    }

    /// An image has the size of its reference, or the error.
    pub(crate) fn check_size(
        self,
        found: (usize, usize),
        expected: (usize, usize),
        reference: &str,
    ) -> Result<(), DatasetError> {
        if found == expected {
            return Ok(());
        }
        Err(DatasetError::ImageSize {
            frame: self.frame,
            path: self.path.to_path_buf(),
            found,
            expected,
            reference: reference.to_owned(),
        })
    }
}

/// The header of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Kind {
    pub(crate) size: (usize, usize),
    pub(crate) format: ImageFormat,
    pub(crate) color: ColorType,
}

/// A decoder whose header has been read and found small enough.
fn decoder<'a>(
    bytes: &'a [u8],
    origin: Origin<'_>,
    expected: &'static str,
) -> Result<(Kind, impl ImageDecoder + 'a), DatasetError> {
    if bytes.is_empty() {
        return Err(origin.error("an empty file", expected));
    }
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| origin.error(e, expected))?;
    let format = match reader.format() {
        Some(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
        _ => return Err(origin.error("neither PNG nor JPEG", expected)),
    };
    let mut caps = Limits::default();
    caps.max_alloc = Some(limits::IMAGE_DECODED_BYTES);
    reader.limits(caps);
    // A truncated JPEG decodes into an image with a grey end; only the end marker is missing.
    if format == ImageFormat::Jpeg && !bytes.windows(2).rev().any(|pair| pair == [0xFF, 0xD9]) {
        return Err(origin.error("it ends early", expected));
    }
    let decoder = reader
        .into_decoder()
        .map_err(|e| origin.error(e, expected))?;
    let (width, height) = decoder.dimensions();
    let side = u64::from(limits::IMAGE_SIDE_PX);
    for (what, value, limit) in [
        ("width in pixels", u64::from(width), side),
        ("height in pixels", u64::from(height), side),
        (
            "decoded size in bytes",
            decoder.total_bytes(),
            limits::IMAGE_DECODED_BYTES,
        ),
    ] {
        if value > limit {
            return Err(DatasetError::TooLarge {
                path: origin.path.to_path_buf(),
                what,
                value,
                limit,
            });
        }
    }
    let kind = Kind {
        size: (width as usize, height as usize),
        format,
        color: decoder.color_type(),
    };
    Ok((kind, decoder))
}

/// Reads the header alone.
pub(crate) fn probe_colour(bytes: &[u8], origin: Origin<'_>) -> Result<Kind, DatasetError> {
    decoder(bytes, origin, COLOUR).map(|(kind, _)| kind)
}

/// Whether an image is a depth image, by its header.
pub(crate) fn is_depth(bytes: &[u8], origin: Origin<'_>) -> Result<bool, DatasetError> {
    let kind = probe_colour(bytes, origin)?;
    Ok(kind.format == ImageFormat::Png && kind.color == ColorType::L16)
}

/// Ratios of width and height of two images that are the same view may differ by this part, of 1296x968 and 640x480 by 0.4 %.
const SAME_VIEW: f64 = 0.01;

/// Whether an image of size `from` can be scaled down to `to`: no side is larger and the proportions are the same.
pub(crate) fn can_shrink(from: (usize, usize), to: (usize, usize)) -> bool {
    let [sx, sy] = [(to.0, from.0), (to.1, from.1)].map(|(to, from)| to as f64 / from as f64);
    sx <= 1.0 && sy <= 1.0 && (sx / sy - 1.0).abs() <= SAME_VIEW
}

/// Colour scaled down to `size`, which [`can_shrink`] allows: each new pixel is the mean of the area it covers, in whole numbers.
pub(crate) fn shrink(image: &RgbImage, size: (usize, usize)) -> RgbImage {
    let (width, height) = image.size();
    // The pixels that overlap new pixel i of n, with the overlap in parts of 1/n of a pixel.
    let overlaps = |i: usize, new: usize, old: usize| {
        let (start, end) = (i * old, (i + 1) * old);
        (start / new..end.div_ceil(new))
            .map(move |j| (j, end.min((j + 1) * new) - start.max(j * new)))
    };
    let area = (width * height) as u64;
    RgbImage::from_fn(size.0, size.1, |x, y| {
        let mut sums = [area / 2; 3]; // rounds half up
        for (v, rows) in overlaps(y, size.1, height) {
            for (u, columns) in overlaps(x, size.0, width) {
                for (sum, value) in sums.iter_mut().zip(image[(u, v)]) {
                    *sum += (rows * columns) as u64 * u64::from(value);
                }
            }
        }
        sums.map(|sum| u8::try_from(sum / area).expect("a mean of bytes"))
    })
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "total_bytes is at most IMAGE_DECODED_BYTES"
)]
fn pixels(
    decoder: impl ImageDecoder,
    origin: Origin<'_>,
    expected: &'static str,
) -> Result<Vec<u8>, DatasetError> {
    let mut bytes = vec![0; decoder.total_bytes() as usize];
    decoder
        .read_image(&mut bytes)
        .map_err(|e| origin.error(e, expected))?;
    Ok(bytes)
}

/// Colour: 8-bit RGB as it is, RGBA without its alpha, grey three times.
///
/// # Errors
/// [`DatasetError::Image`] for another kind of file, 16-bit colour or cut data.
pub(crate) fn colour(bytes: &[u8], origin: Origin<'_>) -> Result<RgbImage, DatasetError> {
    let (kind, decoder) = decoder(bytes, origin, COLOUR)?;
    if !matches!(
        kind.color,
        ColorType::Rgb8 | ColorType::Rgba8 | ColorType::L8 | ColorType::La8
    ) {
        return Err(origin.error(describe(kind), COLOUR));
    }
    let bytes = pixels(decoder, origin, COLOUR)?;
    let data: Vec<[u8; 3]> = match kind.color {
        ColorType::Rgb8 => bytes.as_chunks().0.to_vec(),
        ColorType::Rgba8 => bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect(),
        ColorType::La8 => bytes.chunks_exact(2).map(|p| [p[0]; 3]).collect(),
        _ => bytes.iter().map(|&v| [v; 3]).collect(),
    };
    let (width, height) = kind.size;
    Ok(RgbImage::from_vec(width, height, data).expect(WHOLE))
}

/// Depth in metres: raw / `depth_factor`, computed in f64 and rounded once; 0 stays 0, raw
/// values from `missing_from` on become 0.
///
/// # Errors
/// [`DatasetError::Image`] for anything but a whole 16-bit grey PNG.
pub(crate) fn depth(
    bytes: &[u8],
    origin: Origin<'_>,
    depth_factor: f64,
    missing_from: u16,
) -> Result<DepthImage, DatasetError> {
    let (kind, decoder) = decoder(bytes, origin, DEPTH)?;
    if kind.format != ImageFormat::Png || kind.color != ColorType::L16 {
        return Err(origin.error(describe(kind), DEPTH));
    }
    let bytes = pixels(decoder, origin, DEPTH)?;
    #[allow(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
    let metres = |raw: u16| {
        if raw < missing_from {
            (f64::from(raw) / depth_factor) as f32
        } else {
            0.0
        }
    };
    // The decoder returns 16-bit numbers in native byte order.
    let data = bytes.as_chunks().0.iter();
    let data = data.map(|&pair| metres(u16::from_ne_bytes(pair))).collect();
    let (width, height) = kind.size;
    Ok(DepthImage::from_vec(width, height, data).expect(WHOLE))
}

/// A mask: 255 moving, 0 static, 128 unknown.
///
/// # Errors
/// [`DatasetError::Image`] for another kind of file or another value, named with its pixel.
pub(crate) fn mask(bytes: &[u8], origin: Origin<'_>) -> Result<MaskImage, DatasetError> {
    let (kind, decoder) = decoder(bytes, origin, MASK)?;
    if kind.format != ImageFormat::Png || kind.color != ColorType::L8 {
        return Err(origin.error(describe(kind), MASK));
    }
    let data = pixels(decoder, origin, MASK)?;
    let (width, height) = kind.size;
    if let Some(i) = data.iter().position(|v| ![0, 128, 255].contains(v)) {
        let problem = format!("value {} at pixel ({}, {})", data[i], i % width, i / width);
        return Err(origin.error(problem, MASK));
    }
    Ok(MaskImage::from_vec(width, height, data).expect(WHOLE))
}

/// `8-bit grey PNG`.
pub(crate) fn describe(kind: Kind) -> String {
    let bits = kind.color.bits_per_pixel() / u16::from(kind.color.channel_count());
    let channels = match kind.color.channel_count() {
        1 => "grey",
        2 => "grey with alpha",
        3 => "RGB",
        _ => "RGBA",
    };
    let format = match kind.format {
        ImageFormat::Jpeg => "JPEG",
        _ => "PNG",
    };
    format!("{bits}-bit {channels} {format}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five columns to two: 0 1 and half of 2; half of 2, 3 and 4. Three rows to two alike.
    #[test]
    fn means_of_areas() {
        let value = |x: usize, y: usize| u8::try_from(10 * x + 40 * y).expect("small");
        let image = RgbImage::from_fn(5, 3, |x, y| [value(x, y), 7, 255 - value(x, y)]);
        let small = shrink(&image, (2, 2));
        // Columns (0 + 10 + 20/2) / 2.5 = 8, 32; rows (0 + 40/2) / 1.5 = 13.33, 66.67.
        for ((x, y), mean) in [((0, 0), 21), ((1, 0), 45), ((0, 1), 75), ((1, 1), 99)] {
            assert_eq!(small[(x, y)], [mean, 7, 255 - mean], "({x}, {y})");
        }
        assert_eq!(shrink(&image, (5, 3)), image, "nothing to do");
    }

    #[test]
    fn what_can_be_scaled_down() {
        for (from, to, can) in [
            ((1296, 968), (640, 480), true),
            ((640, 480), (640, 480), true),
            ((640, 480), (639, 480), true),
            ((640, 480), (641, 480), false),
            ((640, 480), (640, 481), false),
            ((1920, 1080), (640, 480), false),
            ((480, 640), (320, 240), false),
        ] {
            assert_eq!(can_shrink(from, to), can, "{from:?} to {to:?}");
        }
    }
}
