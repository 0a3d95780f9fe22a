//! Saving a run and resuming it, and tracking in a finished map (decision 008).
//!
//! A session is the whole state of a [`Slam`]: everything that the rest of the run depends on, and
//! nothing that follows from it. A run that is saved after any frame, and resumed, gives the bits of
//! one that was never interrupted; the session itself has the same bits for every number of threads.
//!
//! Mapping jobs under way are finished before the state is written, and their answers are kept until
//! the frame at which they are due, so they are handed over no sooner than they would have been.
//!
//! Each owner writes and reads its own sections. Every function that writes takes its struct apart
//! without `..`: a new field does not compile until somebody has decided whether it belongs in a
//! session.

pub mod error;
pub mod sections;

use std::io::{self, Read, Write};

use garad_core::{Camera, FrameId, Par};
use serde::Serialize;
use serde_json::Value;

use crate::config::Config;
use crate::context::Context;
use crate::dynamics::Dynamics;
use crate::images::ImageStore;
use crate::io::SlamError;
use crate::mapping::Mapping;
use crate::pipeline::Slam;
use crate::tracking::Tracker;
use crate::trajectory::Trajectory;

pub use self::error::{FORMAT, PROGRAM, SessionError};
pub use self::sections::{SectionReader, SectionWriter};

impl Slam {
    /// Writes the state after the last frame. Waits for mapping jobs under way; the run may continue
    /// afterwards, with the bits it would have had without.
    ///
    /// # Errors
    /// [`SessionError::Io`]; [`SessionError::Slam`] if the mapping thread panicked.
    pub fn save(&mut self, out: &mut impl Write) -> Result<(), SessionError> {
        self.mapping.settle()?;
        let Self {
            context,
            extractor: _, // from the configuration
            straight: _,  // from the camera
            tracker,
            dynamics,
            map,
            keyframing,
            mapping,
            places,
            images,
            trajectory,
            labelled,
            replayed: _, // taken after the frame
            next_frame,
            localising,
            recorder: _, // changes no result
        } = self;
        let Context {
            camera,
            config,
            scales: _, // from the configuration
            rng_seed,
            par: _, // changes no result
        } = context;
        let mut to = SectionWriter::new(out)?;
        to.put("camera", camera)?;
        to.put("configuration", config)?;
        to.put("rng_seed", rng_seed)?;
        to.put("map", map)?;
        tracker.save(&mut to)?;
        dynamics.save(&mut to)?;
        to.put("keyframing", keyframing)?;
        to.put("places", places)?;
        to.put("images", &images.to_saved())?;
        to.put("trajectory", trajectory)?;
        to.put("labelled", labelled)?;
        to.put("next_frame", next_frame)?;
        to.put("localising", localising)?;
        mapping.save(&mut to)
    }

    /// Reads a state that [`Slam::save`] wrote. `par` may be another than then.
    ///
    /// # Errors
    /// [`SessionError`]; see there.
    pub fn load(input: &mut impl Read, par: Par) -> Result<Self, SessionError> {
        let mut from = SectionReader::new(input)?;
        let camera: Camera = from.take("camera")?;
        let config: Config = from.take("configuration")?;
        let fresh = Self::new(camera, config, from.take("rng_seed")?, par)?;
        let context = &fresh.context;
        Ok(Self {
            map: from.take("map")?,
            tracker: Tracker::load(&mut from)?,
            dynamics: Dynamics::load(&mut from, context)?,
            keyframing: from.take("keyframing")?,
            places: from.take("places")?,
            images: ImageStore::from_saved(from.take("images")?),
            trajectory: from.take("trajectory")?,
            labelled: from.take("labelled")?,
            next_frame: from.take("next_frame")?,
            localising: from.take("localising")?,
            mapping: Mapping::load(&mut from, context)?,
            ..fresh
        })
    }

    /// Checks that a loaded run has the settings of one that is to be resumed, and takes over the number
    /// of final iterations, which may differ.
    ///
    /// # Errors
    /// [`SessionError::Differs`] with the first field that does.
    pub fn resume_with(
        &mut self,
        camera: &Camera,
        config: &Config,
        rng_seed: u64,
    ) -> Result<(), SessionError> {
        self.same_camera(camera)?;
        same("seed", &self.context.rng_seed, &rng_seed)?;
        let mut expected = self.context.config.clone();
        if expected.train.keeps_views() == config.train.keeps_views() {
            expected.train.final_iterations = config.train.final_iterations;
        }
        same("configuration", &expected, config)?;
        self.context.config = expected;
        Ok(())
    }

    /// Checks that the run was made with this camera.
    ///
    /// # Errors
    /// [`SessionError::Differs`] with the first field that is another.
    pub fn same_camera(&self, camera: &Camera) -> Result<(), SessionError> {
        same("camera", &self.context.camera, camera)
    }

    /// From here on frames are tracked in the map as it is: nothing is added to it, nothing in it
    /// changes, no frame becomes a keyframe. The next frame counts as the first of a new recording, in which
    /// the camera is lost until it sees a place of the map. [`Slam::trajectory`] starts anew.
    ///
    /// Frames are not labelled: what has come into the room since has no landmark.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub fn localise_only(&mut self) -> Result<(), SlamError> {
        self.finish()?;
        self.localising = true;
        self.tracker.reset_to_lost();
        self.dynamics.clear();
        self.mapping.clear_done();
        self.labelled = None;
        self.next_frame = FrameId(0);
        self.trajectory = Trajectory::default();
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
mod tests;
