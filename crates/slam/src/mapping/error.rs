//! [`TrainError`].

use garad_optim::OptimError;
use garad_raster::RasterError;
use thiserror::Error;

/// What stops training.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainError {
    /// The map could not be rendered, or its gradient not computed.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A gradient that is not finite.
    #[error(transparent)]
    Optim(#[from] OptimError),
}
