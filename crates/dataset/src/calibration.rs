//! [`Calibration`]: the camera and the unit of its depth images.
//!
//! # `camera.txt`
//! Comments start with `#`. Either one row of numbers,
//! ```text
//! # width height fx fy cx cy depth_factor fps [k1 k2 p1 p2 k3]
//! 640 480 535.4 539.2 320.1 247.6 5000 30
//! ```
//! or `key = value` lines with those names, which is TOML as well (`calibration.toml`), or a row
//! followed by lines for `depth_max_raw` and `depth_delay_s`. Pixel centres are at integer coordinates, distortion
//! is OpenCV's, depth in metres is raw / `depth_factor`.
//!
//! # Missing depth
//! Raw 0 and 65535 are always missing. `depth_max_raw = N` makes all raw values from N on
//! missing; without it N is 60000 where `depth_factor` is 1000 (7-Scenes and Kinect recordings
//! in millimetres mark holes by such values, and no such sensor measures 60 m).

use std::path::Path;
use std::str::FromStr;

use garad_core::Camera;
use garad_core::camera::Distortion;

use crate::errors::{DatasetError, excerpt};
use crate::files::read_file;
use crate::text::{Place, for_each_line, number};

/// Names of the presets, for messages.
pub(crate) const PRESETS: &str = "freiburg1, freiburg2, freiburg3, bonn";

/// The camera of a recording and the meaning of its depth images.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Size, pinhole and distortion.
    pub camera: Camera,
    /// Raw depth per metre.
    pub depth_factor: f64,
    /// Frames per second.
    pub fps: f64,
    /// Raw depth values from this one on are missing; 65535 always is.
    pub depth_max_raw: Option<u16>,
    /// How much later than it was taken a depth image is stamped, seconds; by the clock of colour images.
    pub depth_delay_s: f64,
    /// Where it came from, for messages.
    pub source: String,
}

/// A camera whose calibration is known.
///
/// Values: ORB-SLAM2's TUM1.yaml, TUM2.yaml, TUM3.yaml; for BONN those of the recording's own
/// distribution. BONN depth is not rescaled here: see [`crate::bonn`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// TUM RGB-D, freiburg1 (strong distortion).
    Freiburg1,
    /// TUM RGB-D, freiburg2 (strong distortion; depth factor 5208).
    Freiburg2,
    /// TUM RGB-D, freiburg3 (rectified).
    Freiburg3,
    /// BONN RGB-D Dynamic.
    Bonn,
}

impl Preset {
    /// Its name, as [`Preset::from_str`] takes it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Freiburg1 => "freiburg1",
            Self::Freiburg2 => "freiburg2",
            Self::Freiburg3 => "freiburg3",
            Self::Bonn => "bonn",
        }
    }

    /// The calibration; all four cameras have 640x480 pixels at 30 frames per second.
    #[must_use]
    #[rustfmt::skip]
    pub fn calibration(self) -> Calibration {
        let ([fx, fy, cx, cy], [k1, k2, p1, p2, k3], depth_factor) = match self {
            Self::Freiburg1 => (
                [517.306_408, 516.469_215, 318.643_040, 255.313_989],
                [0.262_383, -0.953_104, -0.005_358, 0.002_628, 1.163_314], 5000.0),
            Self::Freiburg2 => (
                [520.908_620, 521.007_327, 325.141_442, 249.701_764],
                [0.231_222, -0.784_899, -0.003_257, -0.000_105, 0.917_205], 5208.0),
            Self::Freiburg3 => (
                [535.4, 539.2, 320.1, 247.6],
                [0.0; 5], 5000.0),
            Self::Bonn => (
                [542.822_841, 542.576_870, 315.593_520, 237.756_098],
                [0.039_903, -0.099_343, -0.000_730, -0.000_144, 0.0], 5000.0),
        };
        Calibration {
            camera: Camera {
                width: 640, height: 480, fx, fy, cx, cy,
                distortion: Distortion { k1, k2, p1, p2, k3 },
            },
            depth_factor,
            fps: 30.0,
            depth_max_raw: None,
            depth_delay_s: match self {
                Self::Freiburg1 => 0.015, // decision 019
                Self::Freiburg2 | Self::Freiburg3 | Self::Bonn => 0.0,
            },
            source: format!("preset {}", self.name()),
        }
    }

    /// The preset named in the name of a recording: `rgbd_dataset_freiburg3_walking_xyz`,
    /// `rgbd_bonn_crowd`, `fr1_desk`. Only whole words count.
    #[must_use]
    pub fn from_recording_name(name: &str) -> Option<Self> {
        name.split(|c: char| !c.is_ascii_alphanumeric())
            .find_map(|word| word.to_ascii_lowercase().parse().ok())
    }
}

impl FromStr for Preset {
    type Err = DatasetError;

    /// `freiburg1` or `fr1`, ..., `bonn`.
    fn from_str(name: &str) -> Result<Self, DatasetError> {
        match name {
            "freiburg1" | "fr1" => Ok(Self::Freiburg1),
            "freiburg2" | "fr2" => Ok(Self::Freiburg2),
            "freiburg3" | "fr3" => Ok(Self::Freiburg3),
            "bonn" => Ok(Self::Bonn),
            _ => Err(DatasetError::UnknownPreset {
                name: name.to_owned(),
                presets: PRESETS,
            }),
        }
    }
}

/// The keys, in the order of the row.
const KEYS: [&str; 15] = [
    "width",
    "height",
    "fx",
    "fy",
    "cx",
    "cy",
    "depth_factor",
    "fps",
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "depth_max_raw",
    "depth_delay_s",
];
/// Numbers of a row without distortion.
const ROW_SHORT: usize = 8;
/// Numbers of a row with distortion.
const ROW_LONG: usize = 13;

impl Calibration {
    /// A valid camera with depth in `depth_factor` a metre; what is missing follows the
    /// [module's rule](self).
    pub(crate) fn of_camera(
        camera: Camera,
        depth_factor: f64,
        fps: f64,
        source: String,
    ) -> Result<Self, DatasetError> {
        check_depth_factor(depth_factor)?;
        Ok(Self {
            camera,
            depth_factor,
            fps,
            depth_max_raw: missing_by_rule(depth_factor),
            depth_delay_s: 0.0,
            source,
        })
    }

    /// Raw depth values from this one on are missing.
    #[must_use]
    pub fn missing_from(&self) -> u16 {
        self.depth_max_raw.unwrap_or(u16::MAX)
    }

    /// The calibration with another number of raw depth per metre; what counts as missing follows the
    /// [module's rule](self), unless it was given.
    ///
    /// # Errors
    /// [`DatasetError::Option`] for a factor that is not positive and finite.
    pub fn with_depth_factor(mut self, depth_factor: f64) -> Result<Self, DatasetError> {
        check_depth_factor(depth_factor)?;
        let given = self
            .depth_max_raw
            .filter(|raw| Some(*raw) != missing_by_rule(self.depth_factor));
        self.depth_max_raw = given.or_else(|| missing_by_rule(depth_factor));
        self.depth_factor = depth_factor;
        self.source += &format!(", depth_factor {depth_factor} from the options");
        Ok(self)
    }

    /// Reads a calibration file.
    ///
    /// # Errors
    /// [`DatasetError::NotFound`], [`DatasetError::Io`], [`DatasetError::TooLarge`], and what
    /// [`Calibration::parse`] finds.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let bytes =
            read_file(path)?.ok_or_else(|| DatasetError::not_found(path, "a calibration file"))?;
        Self::parse(path, &bytes)
    }

    /// Reads a calibration from the bytes of its file; the format is in the
    /// [module's documentation](self).
    ///
    /// # Errors
    /// [`DatasetError::Line`] for an unknown or repeated key, a missing one (at the last line), or
    /// text that is not a number; [`DatasetError::Camera`] for an invalid number.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, DatasetError> {
        let mut values = [None; KEYS.len()];
        let mut last_line = 1;
        for_each_line(path, bytes, |place, text| {
            last_line = place.line;
            parse_line(place, text, &mut values)
        })?;
        let at = |key: usize| {
            let line = values[key].map_or(last_line, |(line, _)| line);
            Place { path, line }
        };
        let optional = |key: usize| values[key].map(|(_, value)| value);
        let required = |key: usize| {
            const EXPECTED: &str = "`width height fx fy cx cy depth_factor fps [k1 k2 p1 p2 k3]` or `key = value` lines";
            optional(key).ok_or_else(|| at(key).error(format!("no {}", KEYS[key]), EXPECTED))
        };
        let count = |key: usize| -> Result<usize, DatasetError> {
            whole(
                at(key),
                required(key)?,
                f64::from(crate::limits::IMAGE_SIDE_PX),
            )
        };
        let distortion = |key: usize| optional(key).unwrap_or(0.0);
        let camera = Camera {
            width: count(0)?,
            height: count(1)?,
            fx: required(2)?,
            fy: required(3)?,
            cx: required(4)?,
            cy: required(5)?,
            distortion: Distortion {
                k1: distortion(8),
                k2: distortion(9),
                p1: distortion(10),
                p2: distortion(11),
                k3: distortion(12),
            },
        };
        camera.validate().map_err(|source| {
            use garad_core::CameraError::{NotFinite, NotPositive};
            let line = match &source {
                NotFinite { field, .. } | NotPositive { field, .. } => KEYS
                    .iter()
                    .position(|key| key == field)
                    .map_or(last_line, |key| at(key).line),
                _ => last_line,
            };
            DatasetError::Camera {
                path: path.to_path_buf(),
                line,
                source,
            }
        })?;
        let positive = |key: usize| -> Result<f64, DatasetError> {
            let value = required(key)?;
            if value > 0.0 {
                Ok(value)
            } else {
                Err(at(key).error(format!("{} {value}", KEYS[key]), "a positive number"))
            }
        };
        let depth_factor = positive(6)?;
        let depth_max_raw = match optional(13) {
            Some(value) => {
                let whole = whole(at(13), value, f64::from(u16::MAX))?;
                u16::try_from(whole).ok()
            }
            None => missing_by_rule(depth_factor),
        };
        Ok(Self {
            camera,
            depth_factor,
            fps: positive(7)?,
            depth_max_raw,
            depth_delay_s: optional(14).unwrap_or(0.0),
            source: format!("file {}", path.display()),
        })
    }
}

fn check_depth_factor(depth_factor: f64) -> Result<(), DatasetError> {
    if depth_factor > 0.0 && depth_factor.is_finite() {
        return Ok(());
    }
    Err(DatasetError::Option {
        option: "depth_factor",
        value: depth_factor.to_string(),
        expected: "a positive number",
    })
}

/// Depth factor of recordings in millimetres.
const MILLIMETRES: f64 = 1000.0;
/// Raw depth from which their pixels are missing.
const MISSING_FROM_IN_MILLIMETRES: u16 = 60_000;

#[allow(clippy::float_cmp, reason = "exactly 1000")]
fn missing_by_rule(depth_factor: f64) -> Option<u16> {
    (depth_factor == MILLIMETRES).then_some(MISSING_FROM_IN_MILLIMETRES)
}

/// Line and value of each key.
type Values = [Option<(usize, f64)>; KEYS.len()];

fn parse_line(place: Place<'_>, text: &str, values: &mut Values) -> Result<(), DatasetError> {
    const NUMBER: &str = "a finite number";
    let text = text.split('#').next().unwrap_or_default().trim();
    if let Some((key, value)) = text.split_once('=') {
        let key = key.trim();
        let index = KEYS.iter().position(|known| *known == key).ok_or_else(|| {
            place.error(
                format!("key {}", excerpt(key)),
                "one of width height fx fy cx cy depth_factor fps k1 k2 p1 p2 k3 depth_max_raw depth_delay_s",
            )
        })?;
        let value = number(place, value.trim(), NUMBER)?;
        return set(place, values, index, value);
    }
    let fields: Vec<&str> = text.split_whitespace().collect();
    if ![ROW_SHORT, ROW_LONG].contains(&fields.len()) {
        return Err(place.error(
            format!("{} numbers", fields.len()),
            "8 numbers `width height fx fy cx cy depth_factor fps`, or 13 with `k1 k2 p1 p2 k3`",
        ));
    }
    for (index, field) in fields.into_iter().enumerate() {
        let value = number(place, field, NUMBER)?;
        set(place, values, index, value)?;
    }
    Ok(())
}

fn set(
    place: Place<'_>,
    values: &mut Values,
    index: usize,
    value: f64,
) -> Result<(), DatasetError> {
    if values[index].is_some() {
        return Err(place.error(format!("{} again", KEYS[index]), "each number once"));
    }
    values[index] = Some((place.line, value));
    Ok(())
}

/// A whole number from 1 to `largest`.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::float_cmp,
    reason = "cast only after the range and the fraction were checked, exactly"
)]
fn whole(place: Place<'_>, value: f64, largest: f64) -> Result<usize, DatasetError> {
    if value >= 1.0 && value <= largest && value == value.trunc() {
        Ok(value as usize)
    } else {
        Err(place.error(format!("{value}"), "a whole number in range"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A damaged file gives a camera or an error, never a panic.
    #[test]
    fn damaged_files_do_not_panic() {
        let good: [&[u8]; 2] = [
            b"# c\n640 480 535.4 539.2 320.1 247.6 5000 30 0.1 0.2 0.3 0.4 0.5\n",
            b"width = 640\r\nheight = 480\r\nfx = 1\nfy=2\ncx=3\ncy=4\ndepth_factor=1e3\nfps=30\n",
        ];
        let mut refused = 0;
        for case in 0..4000u64 {
            let mut rng = garad_core::Rng::keyed(23, &[case]);
            let mut bytes = good[rng.below(2)].to_vec();
            crate::damage::damage(&mut bytes, &mut rng);
            match Calibration::parse(Path::new("camera.txt"), &bytes) {
                Ok(calibration) => {
                    calibration
                        .camera
                        .validate()
                        .expect("what is read is a camera");
                    assert!(calibration.depth_factor > 0.0, "metres are finite");
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().contains('\n'), "one line: {error}");
                }
            }
        }
        assert!(
            refused > 500,
            "damage is noticed, {refused} of 4000 refused"
        );
    }

    #[test]
    fn a_row_equals_its_keys() {
        let parse = |text: &str| {
            let mut calibration =
                Calibration::parse(Path::new("c"), text.as_bytes()).expect("good");
            calibration.source.clear();
            calibration
        };
        let row = parse("640 480 1 2 3 4 5000 30 0.1 0.2 0.3 0.4 0.5\ndepth_max_raw = 9\n");
        let d = row.camera.distortion;
        let read = [d.k1, d.k2, d.p1, d.p2, d.k3].map(|v| (v * 10.0).round());
        assert!(
            read.into_iter().eq([1.0, 2.0, 3.0, 4.0, 5.0]),
            "OpenCV's order: {d:?}"
        );
        let keys = "k3 = 0.5\nk2 = 0.2\nk1 = 0.1 # first\np1 = 0.3\np2 = 0.4\ndepth_max_raw = 9\n\
                    width = 640\nheight = 480\nfx = 1\nfy = 2\ncx = 3\ncy = 4\n\
                    depth_factor = 5000\nfps = 30\n";
        assert_eq!(row, parse(keys), "any order");
    }

    #[test]
    fn millimetres_are_missing_from_sixty_metres() {
        let parse = |factor: &str| {
            let text = format!("640 480 1 2 3 4 {factor} 30");
            Calibration::parse(Path::new("c"), text.as_bytes()).expect("good")
        };
        assert_eq!(parse("1000").missing_from(), 60_000, "millimetres");
        assert_eq!(parse("1000.5").missing_from(), 65_535, "others");
        assert_eq!(parse("5000").missing_from(), 65_535, "others");
    }
}
