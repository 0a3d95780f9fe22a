//! [`iterate`]: what one training iteration computes of a map and a view, before the step.
//!
//! ```text
//! render static Gaussians (eq. 15) ─→ loss (eq. 12) ─→ backward, and the penalty's gradient
//! ```

use garad_core::{Camera, GaussianMap, Par, Real, Se3};
use garad_raster::{Gradients, Include, RasterError, RenderOptions, Rendered, Upstream, fast};

use super::loss::{TargetImages, training_loss};
use crate::config::TrainConfig;

type Draw<T> =
    fn(&GaussianMap<T>, &Camera, &Se3, &RenderOptions, Par) -> Result<Rendered<T>, RasterError>;
type Back<T> = fn(
    &GaussianMap<T>,
    &Camera,
    &Se3,
    &RenderOptions,
    &Rendered<T>,
    &Upstream<T>,
    Par,
) -> Result<Gradients<T>, RasterError>;

/// Both passes of one implementation of the renderer.
#[derive(Debug, Clone, Copy)]
pub struct Engine<T> {
    /// Forward.
    pub draw: Draw<T>,
    /// Backward.
    pub back: Back<T>,
}

impl<T: Real> Engine<T> {
    /// The plain loops.
    pub const REFERENCE: Self = Self {
        draw: garad_raster::render,
        back: garad_raster::backward,
    };
}

impl Engine<f32> {
    /// What the mapper trains with.
    pub const FAST: Self = Self {
        draw: fast::render,
        back: fast::backward,
    };
}

/// A map compared with a view.
#[derive(Debug)]
pub struct Iteration<T> {
    /// Eq. 12.
    pub loss: T,
    /// Its gradient, that of the penalty on dynamic Gaussians included.
    pub gradients: Gradients<T>,
    /// The static Gaussians (eq. 15), over black.
    pub rendered: Rendered<T>,
}

/// Renders the static Gaussians of a map and computes the loss of eq. 12 and its gradient. `weights` are wᵢ of the
/// penalty.
///
/// Golden: `train_step/*`.
///
/// # Errors
/// [`RasterError`].
pub fn iterate<T: Real>(
    engine: Engine<T>,
    map: &GaussianMap<T>,
    (camera, camera_from_world): (&Camera, &Se3),
    target: TargetImages<'_, T>,
    weights: Option<&[T]>,
    config: &TrainConfig,
    par: Par,
) -> Result<Iteration<T>, RasterError> {
    let options = RenderOptions {
        include: Include::StaticOnly,
        ..RenderOptions::default()
    };
    let rendered = (engine.draw)(map, camera, camera_from_world, &options, par)?;
    let loss = training_loss(&rendered, target, map, weights, config, par)?;
    let (pose, upstream) = (camera_from_world, &loss.upstream);
    let mut gradients = (engine.back)(map, camera, pose, &options, &rendered, upstream, par)?;
    if let Some(penalty) = loss.opacity_logits {
        for (g, p) in gradients.opacity_logits.iter_mut().zip(penalty) {
            *g += p;
        }
    }
    Ok(Iteration {
        loss: loss.value,
        gradients,
        rendered,
    })
}
