//! [`Undistortion`]: images without their lens distortion, as of a pinhole camera.

use nalgebra::Vector2;

use crate::{Camera, Image, MaskImage, Par, RgbImage};

/// For every pixel of the pinhole's image, its distorted pixel. Made once per camera.
///
/// The ideal image has the size and the intrinsics of the recorded one; a pixel that
/// distortion moves out of the recorded image is missing.
///
/// # Example
/// A lens without distortion changes nothing but the type:
/// ```
/// use garad_core::{Camera, Par, RgbImage, undistort::Undistortion};
/// let camera = Camera::pinhole((4, 3), [4.0, 4.0, 1.5, 1.0])?;
/// let straight = Undistortion::new(&camera);
/// let color = straight.color(&RgbImage::new(4, 3, [51, 0, 255]), Par::Seq);
/// assert_eq!(color[(3, 2)], [0.2, 0.0, 1.0]);
/// # Ok::<(), garad_core::CameraError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Undistortion {
    size: (usize, usize),
    /// `None`: the camera is a pinhole already.
    taps: Option<Vec<Tap>>,
}

/// The recorded pixel above and left of a place, and how far the place lies beyond it.
#[derive(Debug, Clone, Copy)]
struct Tap {
    /// Index of the pixel; [`UNSEEN`] outside the image.
    index: u32,
    weight: [f32; 2],
}

const UNSEEN: u32 = u32::MAX;

impl Undistortion {
    /// Of this camera's images.
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width, camera.height);
        let taps = (!camera.distortion.is_none()).then(|| {
            let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            pixels
                .map(|(x, y)| {
                    let seen_at = camera.distort_pixel(&Vector2::new(x as f64, y as f64));
                    tap(&seen_at, (width, height))
                })
                .collect()
        });
        Self {
            size: (width, height),
            taps,
        }
    }

    /// The pinhole's image, in [0, 1], bilinear; 0 where nothing was seen.
    ///
    /// `rgb` has the camera's size; pixels of another size's image are taken at its rim.
    #[must_use]
    pub fn color(&self, rgb: &RgbImage, par: Par) -> Image<[f32; 3]> {
        let (width, height) = self.size;
        let mut out = Image::new(width, height, [0.0; 3]);
        par.for_each_chunk_mut(out.data_mut(), 8 * width, |chunk, pixels| {
            let first = chunk * 8 * width;
            for (i, pixel) in (first..).zip(pixels) {
                *pixel = match &self.taps {
                    None => rgb.data()[i].map(unit),
                    Some(taps) if taps[i].index != UNSEEN => {
                        interpolate(rgb, taps[i].index as usize, taps[i].weight)
                    }
                    Some(_) => [0.0; 3],
                };
            }
        });
        out
    }

    /// Another image of the recording (depth, a mask), straightened by taking the nearest pixel;
    /// `unseen` where the lens saw nothing.
    #[must_use]
    pub fn nearest<T: Copy>(&self, recorded: &Image<T>, unseen: T) -> Image<T> {
        let Some(taps) = &self.taps else {
            return recorded.clone();
        };
        let (width, height) = self.size;
        Image::from_fn(width, height, |x, y| {
            let tap = taps[y * width + x];
            let right = usize::from(tap.weight[0] >= 0.5);
            let below = usize::from(tap.weight[1] >= 0.5) * width;
            match tap.index {
                UNSEEN => unseen,
                index => {
                    let last = recorded.data().len() - 1;
                    recorded.data()[(index as usize + right + below).min(last)]
                }
            }
        })
    }

    /// 255 where nothing was seen, 0 elsewhere.
    #[must_use]
    pub fn unseen(&self) -> MaskImage {
        let (width, height) = self.size;
        self.nearest(&MaskImage::new(width, height, 0), 255)
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "inside the image by the test before; weights in [0, 1)"
)]
fn tap(at: &Vector2<f64>, (width, height): (usize, usize)) -> Tap {
    let inside =
        at.x >= 0.0 && at.y >= 0.0 && at.x <= width as f64 - 1.0 && at.y <= height as f64 - 1.0;
    if !inside {
        return Tap {
            index: UNSEEN,
            weight: [0.0; 2],
        };
    }
    let (x, y) = (at.x as usize, at.y as usize);
    Tap {
        index: u32::try_from(y * width + x).unwrap_or(UNSEEN),
        weight: [(at.x - x as f64) as f32, (at.y - y as f64) as f32],
    }
}

fn interpolate(rgb: &RgbImage, index: usize, [wx, wy]: [f32; 2]) -> [f32; 3] {
    let (width, data) = (rgb.width(), rgb.data());
    // In the last column and row the weight beyond is 0: any pixel will do.
    let last = data.len() - 1;
    let [a, b, c, d] = [0, 1, width, width + 1].map(|step| data[(index + step).min(last)]);
    [0, 1, 2].map(|k| {
        let top = unit(a[k]) * (1.0 - wx) + unit(b[k]) * wx;
        let bottom = unit(c[k]) * (1.0 - wx) + unit(d[k]) * wx;
        top * (1.0 - wy) + bottom * wy
    })
}

fn unit(v: u8) -> f32 {
    f32::from(v) / 255.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image whose red is the column: undistorted, a pixel holds the column it was seen at.
    #[test]
    fn distortion_is_removed() {
        let mut camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
        camera.distortion.k1 = 0.2;
        let rgb = RgbImage::from_fn(32, 24, |x, _| [u8::try_from(8 * x).expect("small"); 3]);
        let straight = Undistortion::new(&camera);
        let color = straight.color(&rgb, Par::Seq);
        let seen_at = camera.distort_pixel(&Vector2::new(20.0, 6.0));
        let expected = 8.0 * seen_at.x / 255.0;
        let found = f64::from(color[(20, 6)][0]);
        assert!(
            (found - expected).abs() < 1e-5,
            "{found} against {expected}"
        );
        let corner = color[(0, 0)].map(f32::to_bits);
        assert_eq!(corner, [0; 3], "moved out of the image");
        let unseen = straight.unseen();
        assert_eq!((unseen[(0, 0)], unseen[(20, 6)]), (255, 0), "and said so");
        let columns = Image::from_fn(32, 24, |x, _| x);
        let nearest = straight.nearest(&columns, 99);
        assert!(
            (nearest[(20, 6)] as f64 - seen_at.x).abs() <= 0.5,
            "nearest column of {}",
            seen_at.x
        );
        assert_eq!(nearest[(0, 0)], 99, "unseen");
    }

    #[test]
    fn threads_change_nothing() {
        let mut camera = Camera::pinhole((50, 37), [40.0, 41.0, 24.0, 18.0]).expect("valid");
        camera.distortion.k1 = -0.1;
        let rgb = RgbImage::from_fn(50, 37, |x, y| {
            [x, y, x + y].map(|v| u8::try_from(v).expect("small"))
        });
        let straight = Undistortion::new(&camera);
        assert_eq!(
            straight.color(&rgb, Par::Seq),
            straight.color(&rgb, Par::Threads(3)),
            "same bits"
        );
    }

    /// 3 x + 5 y is bilinear, so that an undistorted pixel holds the value at the place where it was seen; the nearest
    /// pixel is that of the rounded place, along both axes and at the rim.
    #[test]
    fn both_axes_by_hand() {
        let mut camera = Camera::pinhole((30, 22), [26.0, 21.0, 13.0, 11.5]).expect("valid");
        camera.distortion.k1 = 0.1;
        camera.distortion.p1 = 0.02;
        let rgb = RgbImage::from_fn(30, 22, |x, y| {
            [x, y, 3 * x + 5 * y].map(|v| u8::try_from(v).expect("small"))
        });
        let straight = Undistortion::new(&camera);
        let color = straight.color(&rgb, Par::Seq);
        let places = Image::from_fn(30, 22, |x, y| (x, y));
        let nearest = straight.nearest(&places, (99, 99));
        let (mut seen, mut missing) = (0, 0);
        for y in 0..22 {
            for x in 0..30 {
                let at = camera.distort_pixel(&Vector2::new(x as f64, y as f64));
                let inside = at.x >= 0.0 && at.y >= 0.0 && at.x <= 29.0 && at.y <= 21.0;
                if !inside {
                    assert_eq!(nearest[(x, y)], (99, 99), "({x}, {y}) is unseen");
                    missing += 1;
                    continue;
                }
                seen += 1;
                let expected = [at.x, at.y, 3.0 * at.x + 5.0 * at.y];
                for (found, expected) in color[(x, y)].iter().zip(expected) {
                    let error = (f64::from(*found) * 255.0 - expected).abs();
                    assert!(error < 1e-4, "({x}, {y}): {error}");
                }
                let (nx, ny) = nearest[(x, y)];
                let off = (nx as f64 - at.x).abs().max((ny as f64 - at.y).abs());
                assert!(off < 0.500_01, "({x}, {y}): {nx}, {ny} for {at}");
            }
        }
        assert!(seen > 400 && missing > 3, "{seen} seen, {missing} not");
    }
}
