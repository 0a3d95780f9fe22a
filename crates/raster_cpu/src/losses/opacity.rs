//! [`opacity_penalty`]: what fades moving things out of the map.

use garad_core::{Label, Real};

use crate::error::RasterError;
use crate::project::sigmoid;

/// A number and its gradient by the opacity logits.
#[derive(Debug, Clone, PartialEq)]
pub struct OpacityPenalty<T> {
    /// Σ opacity² over dynamic Gaussians.
    pub value: T,
    /// By the logits; 0 for static Gaussians.
    pub opacity_logits: Vec<T>,
}

/// L_dyn = Σ opacityᵢ² over the Gaussians labelled dynamic (O5):
///
/// ∂L_dyn/∂oᵢ = 2 σ(oᵢ)² (1 - σ(oᵢ))
///
/// Source: paper eq. 12 (where opacity is called α). Golden: `losses/opacity_*`.
///
/// # Numerics
/// 1 - σ(o) as σ(-o), exact for large logits; the value is summed in f64 in map order.
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
    let gradient = opacity_logits.iter().zip(labels).map(|(&logit, label)| {
        if *label != Label::Dynamic {
            return T::ZERO;
        }
        let opacity = sigmoid(logit);
        sum += (opacity * opacity).to_f64();
        T::from_f64(2.0) * opacity * opacity * sigmoid(-logit)
    });
    let opacity_logits = gradient.collect();
    Ok(OpacityPenalty {
        value: T::from_f64(sum),
        opacity_logits,
    })
}
