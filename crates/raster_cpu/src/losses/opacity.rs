//! [`opacity_penalty`]: lowers the opacity of dynamic Gaussians.

use garad_core::{Label, Real};

use crate::error::RasterError;
use crate::scalar::sigmoid;

/// A number and its gradient by the opacity logits.
#[derive(Debug, Clone, PartialEq)]
pub struct OpacityPenalty<T> {
    /// Σ w opacity² over dynamic Gaussians.
    pub value: T,
    /// By the logits; 0 for static Gaussians.
    pub opacity_logits: Vec<T>,
}

/// The penalty on dynamic Gaussians, a term of Eq. 12, and its gradient (O5).
///
/// L_dyn = Σ wᵢ αᵢ² over the Gaussians labelled dynamic,  ∂L_dyn/∂oᵢ = 2 wᵢ αᵢ² (1 - αᵢ)
///
/// with the opacity αᵢ = σ(oᵢ) of the logit oᵢ, and wᵢ = 1 (the printed equation) without `weights`. Golden: `losses/opacity_*`.
///
/// # Numerics
/// 1 - α as σ(-o), exact for large logits; the value is summed in f64 in map order.
/// # Errors
/// [`RasterError::MapLength`].
/// # Example
/// ```
/// use garad_core::Label;
/// use garad_raster::losses::opacity_penalty;
/// let labels = [Label::Dynamic, Label::Static];
/// let penalty = opacity_penalty(&[0.0f64, 3.0], &labels, None)?;
/// assert_eq!((penalty.value, penalty.opacity_logits), (0.25, vec![0.25, 0.0]));
/// let half = opacity_penalty(&[0.0f64, 3.0], &labels, Some(&[0.5, 0.5]))?;
/// assert_eq!((half.value, half.opacity_logits), (0.125, vec![0.125, 0.0]));
/// # Ok::<(), garad_raster::RasterError>(())
/// ```
pub fn opacity_penalty<T: Real>(
    opacity_logits: &[T],
    labels: &[Label],
    weights: Option<&[T]>,
) -> Result<OpacityPenalty<T>, RasterError> {
    let expected = opacity_logits.len();
    let lengths = [
        ("label", Some(labels.len())),
        ("weight", weights.map(<[T]>::len)),
    ];
    for (array, got) in lengths {
        if let Some(got) = got.filter(|got| *got != expected) {
            return Err(RasterError::MapLength {
                array,
                expected,
                got,
            });
        }
    }
    let mut sum = 0.0;
    let mut gradient = vec![T::ZERO; labels.len()];
    for (i, &logit) in opacity_logits.iter().enumerate() {
        if labels[i] == Label::Dynamic {
            let opacity = sigmoid(logit);
            let weight = weights.map_or(T::ONE, |weights| weights[i]);
            sum += (weight * opacity * opacity).to_f64();
            gradient[i] = weight * T::from_f64(2.0) * opacity * opacity * sigmoid(-logit);
        }
    }
    Ok(OpacityPenalty {
        value: T::from_f64(sum),
        opacity_logits: gradient,
    })
}
