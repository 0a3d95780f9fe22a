//! [`Context`]: what every stage may read and none may change.

use garad_core::{Camera, Par};

use crate::config::Config;
use crate::io::SlamError;

/// Camera, configuration and what follows from them. Shared by reference with every stage.
#[derive(Debug, Clone)]
pub struct Context {
    /// The calibrated camera.
    pub camera: Camera,
    /// Every setting of the pipeline.
    pub config: Config,
    /// Scale of each ORB level: 1, s, s², ...
    pub scales: Vec<f64>,
    /// Seed of every random draw.
    pub rng_seed: u64,
    /// Threads; never changes a result.
    pub par: Par,
}

impl Context {
    /// Checks camera and configuration.
    ///
    /// # Errors
    /// [`SlamError::Config`] or [`SlamError::Camera`] naming the first invalid value.
    pub fn new(camera: Camera, config: Config, rng_seed: u64, par: Par) -> Result<Self, SlamError> {
        config.validate()?;
        camera.validate()?;
        let mut scales = vec![1.0];
        for level in 1..config.features.levels {
            scales.push(scales[level - 1] * config.features.scale);
        }
        Ok(Self {
            camera,
            config,
            scales,
            rng_seed,
            par,
        })
    }
}
