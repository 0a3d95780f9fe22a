//! [`ParameterGroups`]: the optimiser's state for each kind of parameter, and one step of all of them.

use garad_core::{GaussianMap, Real};
use garad_optim::{Adam, AdamConfig, OptimError, sgd};
use garad_raster::Gradients;
use serde::{Deserialize, Serialize};

use crate::config::{Optimiser, RateConfig};

/// One optimiser per kind of parameter.
#[derive(Debug, Serialize, Deserialize)]
pub struct ParameterGroups<T> {
    /// Means.
    pub means: Adam<T>,
    /// Log-scales.
    pub log_scales: Adam<T>,
    /// Quaternions.
    pub quaternions: Adam<T>,
    /// Opacity logits.
    pub opacity_logits: Adam<T>,
    /// Spherical harmonics of all degrees.
    pub sh: Adam<T>,
}

/// The step sizes of one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroupRates {
    /// Means.
    pub mean: f64,
    /// Log-scales.
    pub log_scale: f64,
    /// Quaternions.
    pub quaternion: f64,
    /// Opacity logits.
    pub opacity_logit: f64,
    /// Spherical harmonics of degree 0, ...
    pub sh: f64,
    /// ... and of the others.
    pub sh_rest: f64,
}

impl GroupRates {
    /// η of the means is proportional to the extent of the path; that of the harmonics beyond degree 0 is that of
    /// degree 0 over `sh_rest_divisor`. No rate decays.
    #[must_use]
    pub fn new(rates: &RateConfig, extent_m: f64) -> Self {
        Self {
            mean: rates.mean * extent_m,
            log_scale: rates.log_scale,
            quaternion: rates.quaternion,
            opacity_logit: rates.opacity_logit,
            sh: rates.sh,
            sh_rest: rates.sh / rates.sh_rest_divisor,
        }
    }
}

/// One group about to take a step.
struct Step<'a, T> {
    parameters: &'a mut [T],
    gradient: &'a [T],
    adam: &'a mut Adam<T>,
    /// One per column.
    rates: Vec<f64>,
}

impl<T: Real> ParameterGroups<T> {
    /// No row yet; harmonics of degree 0.
    ///
    /// # Errors
    /// As [`Adam::new`].
    pub fn new(config: AdamConfig) -> Result<Self, OptimError> {
        let group = |width: usize| Adam::new(config, 0, width);
        Ok(Self {
            means: group(3)?,
            log_scales: group(3)?,
            quaternions: group(4)?,
            opacity_logits: group(1)?,
            sh: group(3)?,
        })
    }

    pub(super) fn each_mut(&mut self) -> [&mut Adam<T>; 5] {
        [
            &mut self.means,
            &mut self.log_scales,
            &mut self.quaternions,
            &mut self.opacity_logits,
            &mut self.sh,
        ]
    }

    /// Adds rows, up to this number of them.
    pub(super) fn extend(&mut self, rows: usize) {
        let new = rows.saturating_sub(self.means.rows());
        for group in self.each_mut() {
            group.extend(new);
        }
    }

    /// Adds state, all 0, for rows that the map has and for the degree of its colours.
    ///
    /// # Errors
    /// [`OptimError::SizeMismatch`] for a degree lower than before.
    pub fn fit(&mut self, map: &GaussianMap<T>) -> Result<(), OptimError> {
        self.sh.widen(3 * map.coefficients())?;
        self.extend(map.len());
        Ok(())
    }

    /// One step of every group, or of none.
    ///
    /// # Errors
    /// [`OptimError`]: a gradient that is not finite, or another number of rows.
    pub fn step(
        &mut self,
        map: &mut GaussianMap<T>,
        gradients: &Gradients<T>,
        rates: &GroupRates,
        optimiser: Optimiser,
    ) -> Result<(), OptimError> {
        let mut sh_rates = vec![rates.sh_rest; 3 * map.coefficients()];
        sh_rates[..3].fill(rates.sh);
        let group = |parameters, gradient, adam, rates| Step {
            parameters,
            gradient,
            adam,
            rates,
        };
        #[rustfmt::skip]
        let steps = [
            group(map.means.as_flattened_mut(), gradients.means.as_flattened(),
                  &mut self.means, vec![rates.mean; 3]),
            group(map.log_scales.as_flattened_mut(), gradients.log_scales.as_flattened(),
                  &mut self.log_scales, vec![rates.log_scale; 3]),
            group(map.quaternions.as_flattened_mut(), gradients.quaternions.as_flattened(),
                  &mut self.quaternions, vec![rates.quaternion; 4]),
            group(&mut map.opacity_logits, &gradients.opacity_logits,
                  &mut self.opacity_logits, vec![rates.opacity_logit]),
            group(map.sh.as_flattened_mut(), gradients.sh.as_flattened(), &mut self.sh, sh_rates),
        ];
        let bad = |step: &Step<'_, T>| step.gradient.iter().position(|g| !g.is_finite());
        if let Some(index) = steps.iter().find_map(bad) {
            return Err(OptimError::NotFinite {
                what: "gradient",
                index,
            });
        }
        for step in steps {
            match optimiser {
                Optimiser::Adam => {
                    step.adam
                        .step_by_column(step.parameters, step.gradient, &step.rates)?;
                }
                Optimiser::Sgd => sgd(step.parameters, step.gradient, step.rates[0])?,
            }
        }
        Ok(())
    }
}
