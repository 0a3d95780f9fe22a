//! [`SceneConfig`], [`SceneName`] and their errors.

use std::fmt;
use std::str::FromStr;

use garad_core::CameraError;
use thiserror::Error;

/// The scenes. Each has one room, one camera path and its own moving objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum SceneName {
    /// Nothing moves; the camera moves around a cluttered desk.
    QuietDesk,
    /// Two people cross the room 2 to 3 m away, one of them carries a box.
    #[default]
    Walking,
    /// Four people 1 to 2 m away cover a third to 60 % of the image; the walls are plain. Two walk to
    /// and fro, two talk and change places meanwhile.
    Crowd,
    /// A trolley, a ball and a person stand still, start, stop and start again.
    StopAndGo,
    /// Two people walk beside the camera at its speed: in the image they stand still and the room
    /// moves.
    InStep,
    /// Nothing moves; the camera circles the room, 9.7 m and 25 s a lap.
    Loop,
    /// A trolley rolls and a person walks; the trolley stops for good at 1.5 s, the person at 2 s.
    ComesToRest,
    /// A chair and a person stand still; at 1.5 s the chair is dragged away, at 2.2 s the person walks
    /// off.
    SetsOff,
    /// The people of [`SceneName::Walking`] in front of a camera that does not move.
    Tripod,
    /// [`SceneName::Walking`], but the light is off twice: for 0.2 s at 1.2 s, for 0.5 s at 3 s. Depth is
    /// measured as usual.
    LightsOut,
    /// Five people 1 to 2 m away, all moving, cover half to two thirds of the image; the walls are plain.
    Throng,
    /// [`SceneName::Crowd`], but the two who talk stay in place, so that they hide a tenth of the visible
    /// room in every frame.
    Huddle,
    /// The camera walks at 1 m/s through a hall of 30 x 20 x 8 m. Depth ends at
    /// [`crate::noise::HALL_RANGE_M`], exact or with noise, and most corners are on the walls, 8 to 25 m
    /// away: at 640 x 480 about 85 % have no depth. One person comes from beyond that range and passes by.
    Hall,
}

impl SceneName {
    /// Every scene, in the order of the documentation.
    #[must_use]
    pub fn all() -> [Self; 13] {
        [
            Self::QuietDesk,
            Self::Walking,
            Self::Crowd,
            Self::StopAndGo,
            Self::InStep,
            Self::Loop,
            Self::ComesToRest,
            Self::SetsOff,
            Self::Tripod,
            Self::LightsOut,
            Self::Throng,
            Self::Huddle,
            Self::Hall,
        ]
    }

    /// The name on the command line.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::QuietDesk => "quiet_desk",
            Self::Walking => "walking",
            Self::Crowd => "crowd",
            Self::StopAndGo => "stop_and_go",
            Self::InStep => "in_step",
            Self::Loop => "loop",
            Self::ComesToRest => "comes_to_rest",
            Self::SetsOff => "sets_off",
            Self::Tripod => "tripod",
            Self::LightsOut => "lights_out",
            Self::Throng => "throng",
            Self::Huddle => "huddle",
            Self::Hall => "hall",
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for SceneName {
    type Err = SynthError;

    /// Accepts `-` for `_`.
    fn from_str(name: &str) -> Result<Self, SynthError> {
        let wanted = name.replace('-', "_");
        Self::all()
            .into_iter()
            .find(|scene| scene.as_str() == wanted)
            .ok_or_else(|| SynthError::UnknownScene {
                name: name.to_owned(),
            })
    }
}

/// A scene and its settings.
///
/// # Example
/// ```
/// use garad_synth::{SceneConfig, SceneName};
/// let config = SceneConfig { frames: 30, noise: true, ..SceneConfig::new(SceneName::Crowd) };
/// assert_eq!((config.width, config.height), (640, 480));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SceneConfig {
    /// Which scene.
    pub name: SceneName,
    /// Number of frames.
    pub frames: usize,
    /// Columns; the focal length is 525/640 of it.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames per second. Motion is a function of time: a higher rate means smaller steps.
    pub fps: f64,
    /// Seed of textures, clothes, phases of the hand tremor, sensor noise.
    pub seed: u64,
    /// Depth and colour with the noise of a Kinect instead of exact ones; see [`crate::noise`].
    pub noise: bool,
    /// The same recording without moving objects.
    pub static_twin: bool,
    /// 1: one colour sample a pixel. 2: five, at the centre and the corners, where the corners are
    /// shared with the neighbours (twice the work). Depth, mask and ids are always of the centre.
    pub supersample: usize,
}

impl SceneConfig {
    /// 150 frames of 640x480 at 30 Hz, exact, with moving objects.
    #[must_use]
    pub fn new(name: SceneName) -> Self {
        Self {
            name,
            frames: 150,
            width: 640,
            height: 480,
            fps: 30.0,
            seed: 1,
            noise: false,
            static_twin: false,
            supersample: 2,
        }
    }

    pub(crate) fn validate(&self) -> Result<(), SynthError> {
        let side = 8..=8192;
        if !side.contains(&self.width) || !side.contains(&self.height) {
            return Err(SynthError::Size {
                width: self.width,
                height: self.height,
            });
        }
        if self.frames == 0 {
            return Err(SynthError::NoFrames);
        }
        if !(self.fps > 0.0 && self.fps.is_finite()) {
            return Err(SynthError::Fps { fps: self.fps });
        }
        if !(1..=2).contains(&self.supersample) {
            return Err(SynthError::Supersample {
                supersample: self.supersample,
            });
        }
        Ok(())
    }
}

impl Default for SceneConfig {
    fn default() -> Self {
        Self::new(SceneName::default())
    }
}

/// An invalid [`SceneConfig`].
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum SynthError {
    /// An unknown scene.
    #[error("no scene is called '{name}'; there are {}", SceneName::all().map(SceneName::as_str).join(", "))]
    UnknownScene {
        /// The name.
        name: String,
    },
    /// An image too small or too large.
    #[error("image size {width}x{height}; expected 8 to 8192 pixels a side")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A recording without frames.
    #[error("0 frames; expected at least 1")]
    NoFrames,
    /// A frame rate that is not a positive number.
    #[error("{fps} frames per second; expected a positive number")]
    Fps {
        /// Its value.
        fps: f64,
    },
    /// Neither 1 nor 2.
    #[error("supersample {supersample}; expected 1 or 2")]
    Supersample {
        /// Its value.
        supersample: usize,
    },
    /// The size gives an invalid camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for name in SceneName::all() {
            assert_eq!(name.to_string().parse(), Ok(name), "{name}");
        }
        assert_eq!("stop-and-go".parse(), Ok(SceneName::StopAndGo), "hyphens");
        let error = "ballroom".parse::<SceneName>().expect_err("no such scene");
        let text = error.to_string();
        assert!(text.contains("'ballroom'"), "{text}");
        assert!(
            text.ends_with("comes_to_rest, sets_off, tripod, lights_out, throng, huddle, hall"),
            "{text}"
        );
    }

    #[test]
    fn each_bad_number_is_reported() {
        let good = SceneConfig::default();
        assert_eq!(good.validate(), Ok(()), "the default");
        let bad = [
            SceneConfig {
                width: 7,
                ..good.clone()
            },
            SceneConfig {
                height: 8193,
                ..good.clone()
            },
            SceneConfig {
                frames: 0,
                ..good.clone()
            },
            SceneConfig {
                fps: 0.0,
                ..good.clone()
            },
            SceneConfig {
                fps: f64::NAN,
                ..good.clone()
            },
            SceneConfig {
                supersample: 3,
                ..good.clone()
            },
            SceneConfig {
                supersample: 0,
                ..good
            },
        ];
        let words = [
            "7x480",
            "640x8193",
            "0 frames",
            "0 frames per",
            "NaN",
            "sample 3",
            "sample 0",
        ];
        for (config, word) in bad.iter().zip(words) {
            let error = config.validate().expect_err(word).to_string();
            assert!(error.contains(word), "{error}");
        }
        for (width, height, valid) in [
            (8, 8192, true),
            (8192, 8, true),
            (7, 8, false),
            (8, 7, false),
            (8193, 8, false),
            (8, 8193, false),
        ] {
            let config = SceneConfig {
                width,
                height,
                frames: 1,
                supersample: 1,
                fps: 0.5,
                ..SceneConfig::default()
            };
            assert_eq!(config.validate().is_ok(), valid, "{width}x{height}");
        }
        for fps in [-30.0, f64::INFINITY] {
            let config = SceneConfig {
                fps,
                ..SceneConfig::default()
            };
            assert_eq!(config.validate(), Err(SynthError::Fps { fps }), "{fps}");
        }
    }
}
