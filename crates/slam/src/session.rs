//! A run put aside and taken up again, and tracking in a map that is finished (decision 008).
//!
//! A session is the whole state of a [`Slam`]: everything that the future of the run depends on, and
//! nothing that follows from the rest. A run that is saved after any frame, and resumed, gives the bits of
//! one that was never interrupted; the session itself has the same bits for every number of threads.
//!
//! Mapping jobs under way are finished before the state is written, and their answers are kept until
//! the frame at which they are due, so tracking hears of them no sooner than it would have.
//!
//! | section | what | kept by |
//! |---|---|---|
//! | `camera`, `configuration`, `seed` | what the run was made with | here |
//! | `map` ... `localising` | tracking | here |
//! | `due`, `answers` | mapping jobs not yet handed over | [`schedule`](crate::schedule) |
//! | `gaussians`, `poses` | the map of Gaussians | [`mapper`](crate::mapper) |
//! | `views` ... `densifier` | training | [`mapper::train`](crate::mapper::train) |
//!
//! Every function that writes or reads takes its struct apart without `..`: a new field does not
//! compile until somebody has decided whether it belongs into a session.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::sync::Arc;

use garad_core::{Camera, FrameId, KeyframeId, Par};
use garad_features::LkPyramid;
use serde::Serialize;
use serde_json::Value;
use thiserror::Error;

use crate::config::Config;
use crate::system::{Slam, SlamError};
use crate::tracker::TrackingState;

mod sections;

pub use sections::{FORMAT, PROGRAM, SectionReader, SectionWriter};

/// Why a session cannot be written or taken up.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SessionError {
    /// From reading or writing.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Not the beginning of a session.
    #[error("not a session of garad; expected it to begin with `garad session`")]
    Foreign,
    /// A format of before or after.
    #[error("a session of format {saved}; expected format {FORMAT}, which garad {PROGRAM} writes")]
    Format {
        /// Its number.
        saved: u32,
    },
    /// Written by another version: the rest of the run would not have the bits of the first part.
    #[error("saved by garad {saved}; expected garad {PROGRAM}, which is running")]
    Program {
        /// The version that wrote it.
        saved: String,
    },
    /// The end of the data came too soon.
    #[error("the session ends in section `{section}`; expected more, the file was cut off")]
    Truncated {
        /// Where.
        section: &'static str,
    },
    /// A checksum or a name that is not the one expected.
    #[error("section `{section}` is damaged; expected other bytes by its checksum or its name")]
    Damaged {
        /// Which.
        section: &'static str,
    },
    /// A value that has no form, or a form that is no value.
    #[error("section `{section}`: {source}")]
    Value {
        /// Which.
        section: &'static str,
        /// What is wrong.
        source: postcard::Error,
    },
    /// The run to go on with is made with something else.
    #[error("{what}: the session has {saved}, this run {given}; expected the same")]
    Differs {
        /// The field.
        what: String,
        /// Its value in the session.
        saved: String,
        /// Its value now.
        given: String,
    },
    /// The state cannot be.
    #[error(transparent)]
    Slam(#[from] SlamError),
}

impl Slam {
    /// Writes the state after the last frame. Waits for mapping jobs under way; the run may go on
    /// afterwards, with the bits it would have had without.
    ///
    /// # Errors
    /// [`SessionError::Io`]; [`SessionError::Slam`] if the mapping thread broke down.
    pub fn save(&mut self, out: &mut impl Write) -> Result<(), SessionError> {
        self.schedule.settle()?;
        let Self {
            camera,
            config,
            scales: _, // from the configuration
            seed,
            map,
            last,
            velocity,
            reference,
            last_keyframe_frame,
            recent,
            places,
            loops,
            extractor: _, // from the configuration
            levels: _,    // from the configuration
            pyramids,
            last_pyramid,
            witnesses,
            lattice: _, // from the camera
            crf: _,     // from the configuration
            frame_labels,
            opening,
            foresight: _,    // within one frame
            second_sight: _, // taken after the frame
            schedule,
            mapped,
            state,
            recovered_at,
            next_frame,
            records,
            localising,
            tape: _, // only listens
            par: _,  // changes no result
        } = self;
        let mut to = SectionWriter::new(out)?;
        to.put("camera", camera)?;
        to.put("configuration", config)?;
        to.put("seed", seed)?;
        to.put("map", map)?;
        to.put("last", last)?;
        to.put("velocity", velocity)?;
        to.put("reference", reference)?;
        to.put("last_keyframe_frame", last_keyframe_frame)?;
        to.put("recent", recent)?;
        to.put("places", places)?;
        to.put("loops", loops)?;
        let pictures: Vec<(KeyframeId, &LkPyramid)> =
            pyramids.iter().map(|(k, p)| (*k, &**p)).collect();
        to.put("pyramids", &pictures)?;
        to.put("last_pyramid", &last_pyramid.as_deref())?;
        to.put("witnesses", witnesses)?;
        to.put("frame_labels", frame_labels)?;
        to.put("opening", opening)?;
        to.put("mapped", mapped)?;
        to.put("state", state)?;
        to.put("recovered_at", recovered_at)?;
        to.put("next_frame", next_frame)?;
        to.put("records", records)?;
        to.put("localising", localising)?;
        schedule.save(&mut to)
    }

    /// Reads a state that [`Slam::save`] wrote. `par` may be another than then.
    ///
    /// # Errors
    /// [`SessionError`]; see there.
    pub fn load(input: &mut impl Read, par: Par) -> Result<Self, SessionError> {
        let mut from = SectionReader::new(input)?;
        let camera: Camera = from.take("camera")?;
        let config: Config = from.take("configuration")?;
        let mut slam = Self::new(camera, config, from.take("seed")?, par)?;
        let Self {
            camera: _,
            config: _,
            scales: _,
            seed: _,
            map,
            last,
            velocity,
            reference,
            last_keyframe_frame,
            recent,
            places,
            loops,
            extractor: _,
            levels: _,
            pyramids,
            last_pyramid,
            witnesses,
            lattice: _,
            crf: _,
            frame_labels,
            opening,
            foresight: _,
            second_sight: _,
            schedule,
            mapped,
            state,
            recovered_at,
            next_frame,
            records,
            localising,
            tape: _,
            par: _,
        } = &mut slam;
        *map = from.take("map")?;
        *last = from.take("last")?;
        *velocity = from.take("velocity")?;
        *reference = from.take("reference")?;
        *last_keyframe_frame = from.take("last_keyframe_frame")?;
        *recent = from.take("recent")?;
        *places = from.take("places")?;
        *loops = from.take("loops")?;
        let pictures: Vec<(KeyframeId, LkPyramid)> = from.take("pyramids")?;
        *pyramids = pictures
            .into_iter()
            .map(|(k, p)| (k, Arc::new(p)))
            .collect();
        *last_pyramid = from
            .take::<Option<LkPyramid>>("last_pyramid")?
            .map(Arc::new);
        *witnesses = from.take("witnesses")?;
        *frame_labels = from.take("frame_labels")?;
        *opening = from.take("opening")?;
        *mapped = from.take("mapped")?;
        *state = from.take("state")?;
        *recovered_at = from.take("recovered_at")?;
        *next_frame = from.take("next_frame")?;
        *records = from.take("records")?;
        *localising = from.take("localising")?;
        schedule.load(&mut from)?;
        Ok(slam)
    }

    /// Checks that a loaded run is made with the same as one that is to go on, and takes over how long it
    /// is to be refined at the end, which may differ.
    ///
    /// # Errors
    /// [`SessionError::Differs`] with the first field that does.
    pub fn go_on_with(
        &mut self,
        camera: &Camera,
        config: &Config,
        seed: u64,
    ) -> Result<(), SessionError> {
        self.same_camera(camera)?;
        same("seed", &self.seed, &seed)?;
        let mut expected = self.config.clone();
        if self.config.train.keeps_views() == config.train.keeps_views() {
            expected.train.refine = config.train.refine;
        }
        same("configuration", &expected, config)?;
        self.config = expected;
        Ok(())
    }

    /// Checks that the run was made with this camera.
    ///
    /// # Errors
    /// [`SessionError::Differs`] with the first field that is another.
    pub fn same_camera(&self, camera: &Camera) -> Result<(), SessionError> {
        same("camera", &self.camera, camera)
    }

    /// The seed of everything random.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// From here on frames are tracked in the map as it is: nothing is added to it, nothing in it
    /// changes, no frame becomes a keyframe. The next frame counts as the first of a new recording, in which
    /// the camera is lost until it sees a place of the map. [`Slam::trajectory`] starts anew.
    ///
    /// Labels are not asked for: what has come into the room since then has no landmark.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub fn localise_only(&mut self) -> Result<(), SlamError> {
        self.finish()?;
        self.localising = true;
        self.state = TrackingState::Lost;
        self.last = None;
        self.last_pyramid = None;
        self.velocity = None;
        self.recovered_at = None;
        self.frame_labels = None;
        self.witnesses = BTreeMap::new();
        self.next_frame = FrameId(0);
        self.records = Vec::new();
        self.mapped = Vec::new();
        Ok(())
    }
}

/// Names the first field that differs.
fn same<T: Serialize>(what: &str, saved: &T, given: &T) -> Result<(), SessionError> {
    let value = |v: &T| serde_json::to_value(v).map_err(io::Error::other);
    first_difference(what, &value(saved)?, &value(given)?)
}

fn first_difference(what: &str, saved: &Value, given: &Value) -> Result<(), SessionError> {
    if let (Value::Object(saved), Value::Object(given)) = (saved, given) {
        for (key, value) in saved {
            let other = given.get(key).unwrap_or(&Value::Null);
            first_difference(&format!("{what}.{key}"), value, other)?;
        }
        return Ok(());
    }
    if saved == given {
        return Ok(());
    }
    Err(SessionError::Differs {
        what: what.to_owned(),
        saved: saved.to_string(),
        given: given.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use garad_core::GrayImage;

    use super::*;

    fn slam() -> Slam {
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        Slam::new(camera, Config::default(), 3, Par::Seq).expect("valid")
    }

    #[test]
    fn the_field_that_differs_is_named() {
        let mut slam = slam();
        let (camera, config) = (slam.camera, slam.config.clone());
        slam.go_on_with(&camera, &config, 3).expect("the same");
        let mut lens = camera;
        lens.distortion.k2 = 0.25;
        let mut few = config.clone();
        few.features.count = 500;
        let mut untrained = config.clone();
        untrained.train.per_keyframe = 0;
        for (camera, config, seed, expected) in [
            (
                lens,
                &config,
                3,
                "camera.distortion.k2: the session has 0.0, this run 0.25",
            ),
            (
                camera,
                &few,
                3,
                "configuration.features.count: the session has 1000, this run 500",
            ),
            (camera, &config, 4, "seed: the session has 3, this run 4"),
            (camera, &untrained, 3, "configuration.train.per_keyframe"),
        ] {
            let error = slam.go_on_with(&camera, config, seed).expect_err("refused");
            assert!(error.to_string().starts_with(expected), "{error}");
        }
    }

    #[test]
    fn how_long_to_refine_may_differ_while_pictures_are_kept() {
        let mut slam = slam();
        let mut config = slam.config.clone();
        config.train.refine = 77;
        slam.go_on_with(&slam.camera.clone(), &config, 3)
            .expect("allowed");
        assert_eq!(slam.config.train.refine, 77, "taken over");
        let mut mute = slam.config.clone();
        (
            mute.train.per_keyframe,
            mute.train.per_frame,
            mute.train.refine,
        ) = (0, 0, 0);
        slam.config = mute.clone();
        mute.train.refine = 77;
        let error = slam
            .go_on_with(&slam.camera.clone(), &mute, 3)
            .expect_err("no picture was kept to refine on");
        assert!(error.to_string().contains("train.refine"), "{error}");
    }

    #[test]
    fn a_pyramid_is_made_again_from_its_picture() {
        let image = GrayImage::from_fn(70, 60, |x, y| [3, 250, 0, 99, 128][(x * x + 3 * y) % 5]);
        for above in [0, 1] {
            let pyramid = LkPyramid::new(&image, above).expect("a picture");
            let bytes = postcard::to_stdvec(&pyramid).expect("a form");
            let again: LkPyramid = postcard::from_bytes(&bytes).expect("a pyramid");
            assert_eq!(again.levels(), above + 1, "levels");
            assert_eq!(
                format!("{again:?}"),
                format!("{pyramid:?}"),
                "every pixel, borders too"
            );
        }
    }

    #[test]
    fn a_picture_without_all_its_pixels_is_refused() {
        let bytes = |pixels: usize| {
            postcard::to_stdvec(&(3usize, 2usize, vec![7u8; pixels])).expect("a form")
        };
        let image: GrayImage = postcard::from_bytes(&bytes(6)).expect("six pixels");
        assert_eq!(image, GrayImage::new(3, 2, 7), "3 x 2");
        for pixels in [0, 5, 7] {
            let image: Result<GrayImage, _> = postcard::from_bytes(&bytes(pixels));
            assert!(image.is_err(), "{pixels} pixels");
        }
    }

    #[test]
    fn an_empty_run_is_saved_too() {
        let mut bytes = Vec::new();
        slam().save(&mut bytes).expect("saved");
        let mut again = Vec::new();
        let mut loaded = Slam::load(&mut &bytes[..], Par::Threads(2)).expect("loaded");
        loaded.save(&mut again).expect("saved");
        assert!(bytes == again, "the same bits");
    }
}
