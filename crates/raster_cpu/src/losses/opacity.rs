//! [`opacity_penalty`]: lowers the opacity of dynamic Gaussians.

use garad_core::{Label, Real};

use crate::error::RasterError;
use crate::scalar::sigmoid;

/// A number and its gradient by the opacity logits.
#[derive(Debug, Clone, PartialEq)]
pub struct OpacityPenalty<T> {
    /// Σ opacity² over dynamic Gaussians.
    pub value: T,
    /// By the logits; 0 for static Gaussians.
    pub opacity_logits: Vec<T>,
}

/// The penalty on dynamic Gaussians, a term of Eq. 12, and its gradient (O5).
///
/// L_dyn = Σ αᵢ² over the Gaussians labelled dynamic,  ∂L_dyn/∂oᵢ = 2 αᵢ² (1 - αᵢ)
///
/// with the opacity αᵢ = σ(oᵢ) of the logit oᵢ. Golden: `losses/opacity_*`.
///
/// # Numerics
/// 1 - α as σ(-o), exact for large logits; the value is summed in f64 in map order.
/// # Errors
/// [`RasterError::MapLength`].
/// # Example
/// ```
/// use garad_core::Label;
/// use garad_raster::losses::opacity_penalty;
/// let penalty = opacity_penalty(&[0.0f64, 3.0], &[Label::Dynamic, Label::Static])?;
/// assert_eq!((penalty.value, penalty.opacity_logits), (0.25, vec![0.25, 0.0]));
/// # Ok::<(), garad_raster::RasterError>(())
/// ```
pub fn opacity_penalty<T: Real>(
    opacity_logits: &[T],
    labels: &[Label],
) -> Result<OpacityPenalty<T>, RasterError> {
    if labels.len() != opacity_logits.len() {
        return Err(RasterError::MapLength {
            array: "label",
            expected: opacity_logits.len(),
            got: labels.len(),
        });
    }
    let mut sum = 0.0;
    let mut gradient = vec![T::ZERO; labels.len()];
    for (i, &logit) in opacity_logits.iter().enumerate() {
        if labels[i] == Label::Dynamic {
            let opacity = sigmoid(logit);
            sum += (opacity * opacity).to_f64();
            gradient[i] = T::from_f64(2.0) * opacity * opacity * sigmoid(-logit);
        }
    }
    Ok(OpacityPenalty {
        value: T::from_f64(sum),
        opacity_logits: gradient,
    })
}
