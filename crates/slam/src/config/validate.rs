//! [`Config::validate`].

use garad_crf::CrfError;
use thiserror::Error;

use super::Config;

/// An invalid configuration.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// Out of its range.
    #[error("Invalid configuration: {key} = {value}, expected {expected}")]
    OutOfRange {
        /// Table and key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The valid range.
        expected: &'static str,
    },
    /// A setting of the random field.
    #[error("Invalid configuration: crf.{0}")]
    Crf(#[from] CrfError),
}

impl Config {
    /// Checks every value that could make a stage meaningless.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`] naming the first one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let (f, t, s) = (&self.features, &self.tracking, &self.insertion);
        let r = &self.render_tracking;
        let positive = "a positive number";
        let share = "a number in (0, 1)";
        let inside = |low: f64, v: f64, high: f64| v > low && v < high;
        #[rustfmt::skip]
        let checks = [
            ("features.count", f.count as f64, f.count > 0 && f.count <= 100_000, "1..100000"),
            ("features.max_oversampling", f.max_oversampling, (1.0..=10.0).contains(&f.max_oversampling), "a number from 1 to 10"),
            ("features.scale", f.scale, inside(1.0, f.scale, 4.0), "a number in (1, 4)"),
            ("features.levels", f.levels as f64, (1..=16).contains(&f.levels), "1..16"),
            ("features.fast_min_threshold", f64::from(f.fast_min_threshold),
             f.fast_min_threshold > 0 && f.fast_min_threshold <= f.fast_threshold, "1..fast_threshold"),
            ("features.max_depth_m", f.max_depth_m, inside(0.0, f.max_depth_m, f64::INFINITY), positive),
            ("features.edge_ratio", f.edge_ratio, inside(0.0, f.edge_ratio, f64::INFINITY), positive),
            ("tracking.bf", t.bf, inside(0.0, t.bf, f64::INFINITY), positive),
            ("tracking.disparity_sigma_px", t.disparity_sigma_px,
             inside(0.0, t.disparity_sigma_px, f64::INFINITY), positive),
            ("tracking.motion_radius_px", t.motion_radius_px,
             inside(0.0, t.motion_radius_px, 1e4), "a number in (0, 10000)"),
            ("render_tracking.iterations", r.iterations as f64, r.iterations > 0, "at least 1"),
            ("render_tracking.level", r.level as f64, r.level <= 4, "0..4"),
            ("render_tracking.translation_rate_m", r.translation_rate_m,
             inside(0.0, r.translation_rate_m, f64::INFINITY), positive),
            ("render_tracking.rotation_rate_rad", r.rotation_rate_rad,
             inside(0.0, r.rotation_rate_rad, f64::INFINITY), positive),
            ("render_tracking.min_opacity", r.min_opacity, inside(0.0, r.min_opacity, 1.0), share),
            ("render_tracking.lambda_color", r.lambda_color,
             r.lambda_color >= 0.0 && r.lambda_color.is_finite(), "0 or a positive number"),
            ("render_tracking.min_share", r.min_share, inside(0.0, r.min_share, 1.0), share),
            ("depth_planes.noise.floor_m", self.depth_planes.noise.floor_m,
             inside(0.0, self.depth_planes.noise.floor_m, f64::INFINITY), positive),
            ("depth_planes.noise.per_m", self.depth_planes.noise.per_m,
             self.depth_planes.noise.per_m >= 0.0 && self.depth_planes.noise.per_m.is_finite(), "0 or a positive number"),
            ("depth_planes.outlier_sigmas", self.depth_planes.outlier_sigmas,
             inside(0.0, self.depth_planes.outlier_sigmas, f64::INFINITY), positive),
            ("depth_planes.outlier_px", self.depth_planes.outlier_px,
             inside(0.0, self.depth_planes.outlier_px, f64::INFINITY), positive),
            ("keyframes.max_gap", self.keyframes.max_gap as f64,
             self.keyframes.max_gap >= self.keyframes.min_gap.max(1), "at least 1 and min_gap"),
            ("tracking.shutter_sigma_rad", t.shutter_sigma_rad,
             (0.0..=0.1).contains(&t.shutter_sigma_rad), "a number from 0 to 0.1"),
            ("motion.acceleration_m_s2", self.motion.acceleration_m_s2,
             inside(0.0, self.motion.acceleration_m_s2, f64::INFINITY), positive),
            ("motion.shared_error", self.motion.shared_error,
             self.motion.shared_error >= 0.0 && self.motion.shared_error.is_finite(), "0 or a positive number"),
            ("train.lambda_ssim", self.train.lambda_ssim,
             (0.0..=1.0).contains(&self.train.lambda_ssim), "a number in [0, 1]"),
            ("train.lambda_depth", self.train.lambda_depth,
             self.train.lambda_depth >= 0.0 && self.train.lambda_depth.is_finite(), "0 or a positive number"),
            ("train.sh_degree", self.train.sh_degree as f64, self.train.sh_degree <= 3, "0..3"),
            ("train.rates.sh_rest_divisor", self.train.rates.sh_rest_divisor,
             inside(0.0, self.train.rates.sh_rest_divisor, f64::INFINITY), positive),
            ("densify.every", self.densify.every as f64, self.densify.every > 0, "at least 1"),
            ("densify.grad_threshold", self.densify.grad_threshold, inside(0.0, self.densify.grad_threshold, f64::INFINITY), positive),
            ("densify.min_opacity", self.densify.min_opacity, inside(0.0, self.densify.min_opacity, 1.0), share),
            ("two_view.radius_px", self.two_view.radius_px,
             inside(0.0, self.two_view.radius_px, f64::INFINITY), positive),
            ("two_view.min_inverse_depth_sigmas", self.two_view.min_inverse_depth_sigmas,
             inside(0.0, self.two_view.min_inverse_depth_sigmas, f64::INFINITY), positive),
            ("labels.step_px", self.labels.step_px as f64, (4..=128).contains(&self.labels.step_px), "4..128"),
            ("labels.noise.floor_m", self.labels.noise.floor_m,
             inside(0.0, self.labels.noise.floor_m, f64::INFINITY), positive),
            ("labels.noise.per_m", self.labels.noise.per_m,
             self.labels.noise.per_m >= 0.0 && self.labels.noise.per_m.is_finite(), "0 or a positive number"),
            ("labels.trust_young", self.labels.trust_young, inside(0.0, self.labels.trust_young, 1.0), share),
            ("labels.trust_old", self.labels.trust_old, inside(0.0, self.labels.trust_old, 1.0), share),
            ("labels.settle_frames", f64::from(self.labels.settle_frames), self.labels.settle_frames > 0, "at least 1"),
            ("labels.trust_unknown", self.labels.trust_unknown,
             inside(0.0, self.labels.trust_unknown, 1.0), share),
            ("labels.edge_ratio", self.labels.edge_ratio,
             inside(0.0, self.labels.edge_ratio, f64::INFINITY), positive),
            ("labels.patch_motion.min_suspects", self.labels.patch_motion.min_suspects,
             (0.0..=1.0).contains(&self.labels.patch_motion.min_suspects), "a number in [0, 1]"),
            ("labels.spread.neighbours", self.labels.spread.neighbours as f64,
             self.labels.spread.neighbours > 0, "at least 1"),
            ("labels.spread.radius_m", self.labels.spread.radius_m,
             inside(0.0, self.labels.spread.radius_m, f64::INFINITY), positive),
            ("labels.gaussian_mask.opacity", self.labels.gaussian_mask.opacity,
             inside(0.0, self.labels.gaussian_mask.opacity, 1.0), share),
            ("labels.gaussian_mask.depth_m", self.labels.gaussian_mask.depth_m,
             self.labels.gaussian_mask.depth_m >= 0.0, "0 or a positive number"),
            ("labels.gaussian_mask.surface_share", self.labels.gaussian_mask.surface_share,
             (0.0..1.0).contains(&self.labels.gaussian_mask.surface_share), "a number in [0, 1)"),
            ("labels.rest_frames", f64::from(self.labels.rest_frames), self.labels.rest_frames > 0, "at least 1"),
            ("labels.patch_motion.same_correlation", self.labels.patch_motion.same_correlation,
             (-1.0..=1.0).contains(&self.labels.patch_motion.same_correlation), "a number in [-1, 1]"),
            ("labels.patch_motion.min_correlation", self.labels.patch_motion.min_correlation,
             (-1.0..=1.0).contains(&self.labels.patch_motion.min_correlation), "a number in [-1, 1]"),
            ("labels.history_gap", f64::from(self.labels.history_gap), self.labels.history_gap > 0, "at least 1"),
            ("labels.patch_motion.sigma_px", self.labels.patch_motion.sigma_px,
             inside(0.0, self.labels.patch_motion.sigma_px, f64::INFINITY), positive),
            ("labels.patch_motion.ages_frames",
             self.labels.patch_motion.ages_frames.map(f64::from).into_iter().fold(f64::INFINITY, f64::min),
             self.labels.patch_motion.ages_frames.iter().all(|a| *a > 0), "at least 1"),
            ("flow.covariance_floor_px2", self.flow.covariance_floor_px2,
             self.flow.covariance_floor_px2 >= 0.0 && self.flow.covariance_floor_px2.is_finite(), "0 or a positive number"),
            ("flow.min_support", self.flow.min_support as f64, self.flow.min_support >= 3, "at least 3"),
            ("flow.chi2", self.flow.chi2, inside(0.0, self.flow.chi2, f64::INFINITY), positive),
            ("loops.max_drift", self.loops.max_drift, inside(0.0, self.loops.max_drift, f64::INFINITY), positive),
            ("loops.max_drift_floor_m", self.loops.max_drift_floor_m,
             inside(0.0, self.loops.max_drift_floor_m, f64::INFINITY), positive),
            ("loops.in_a_row", self.loops.in_a_row as f64, self.loops.in_a_row > 0, "at least 1"),
            ("loops.min_inliers", self.loops.min_inliers as f64, self.loops.min_inliers >= 3, "at least 3"),
            ("culling.redundant_share", self.culling.redundant_share,
             inside(0.0, self.culling.redundant_share, 1.0 + f64::EPSILON), "a number in (0, 1]"),
            ("culling.observers", self.culling.observers as f64, self.culling.observers > 0, "at least 1"),
            ("train.max_views", self.train.max_views as f64, self.train.max_views >= 2, "at least 2"),
            ("insertion.stride_px", s.stride_px as f64, s.stride_px > 0, "at least 1"),
            ("insertion.footprint", s.footprint, inside(0.0, s.footprint, f64::INFINITY), positive),
            ("insertion.opacity", s.opacity, inside(0.0, s.opacity, 1.0), share),
        ];
        for (key, value, good, expected) in checks {
            if !good {
                return Err(ConfigError::OutOfRange {
                    key,
                    value,
                    expected,
                });
            }
        }
        self.crf.validate()?;
        self.labels.window.validate()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_nan_is_not() {
        Config::default().validate().expect("defaults");
        let mut config = Config::default();
        config.tracking.bf = f64::NAN;
        let error = config.validate().expect_err("NaN");
        assert!(error.to_string().contains("tracking.bf"), "{error}");
    }

    /// Every number at and beyond its limits: key, values that are valid, values that are not.
    #[test]
    #[rustfmt::skip]
    fn every_limit() {
        let most = f64::MAX;
        let cases: &[(&str, &[f64], &[f64])] = &[
            ("features.count", &[1.0, 100_000.0], &[0.0, 100_001.0]),
            ("features.max_oversampling", &[1.0, 10.0], &[0.99, 10.01]),
            ("features.scale", &[1.01, 3.99], &[1.0, 4.0]),
            ("features.levels", &[1.0, 16.0], &[0.0, 17.0]),
            ("features.fast_min_threshold", &[1.0, 20.0], &[0.0, 21.0]),
            ("features.max_depth_m", &[1e-9, most], &[0.0, -1.0]),
            ("features.edge_ratio", &[1e-9, most], &[0.0, -1.0]),
            ("tracking.bf", &[1e-9, most], &[0.0, -1.0]),
            ("tracking.disparity_sigma_px", &[1e-9, most], &[0.0, -1.0]),
            ("tracking.motion_radius_px", &[1e-9, 9999.0], &[0.0, 1e4]),
            ("tracking.shutter_sigma_rad", &[0.0, 0.1], &[-1e-9, 0.11]),
            ("render_tracking.iterations", &[1.0], &[0.0]),
            ("render_tracking.level", &[0.0, 4.0], &[5.0]),
            ("render_tracking.translation_rate_m", &[1e-9, most], &[0.0, -1.0]),
            ("render_tracking.rotation_rate_rad", &[1e-9, most], &[0.0, -1.0]),
            ("render_tracking.min_opacity", &[1e-9, 0.999], &[0.0, 1.0]),
            ("render_tracking.lambda_color", &[0.0, most], &[-1e-9]),
            ("render_tracking.min_share", &[1e-9, 0.999], &[0.0, 1.0]),
            ("depth_planes.noise.floor_m", &[1e-9, most], &[0.0, -1.0]),
            ("depth_planes.noise.per_m", &[0.0, most], &[-1e-9]),
            ("depth_planes.outlier_sigmas", &[1e-9, most], &[0.0, -1.0]),
            ("depth_planes.outlier_px", &[1e-9, most], &[0.0, -1.0]),
            ("keyframes.max_gap", &[3.0], &[2.0, 0.0]), // min_gap is 3
            ("motion.acceleration_m_s2", &[1e-9, most], &[0.0, -1.0]),
            ("motion.shared_error", &[0.0, most], &[-1e-9]),
            ("train.lambda_ssim", &[0.0, 1.0], &[-1e-9, 1.001]),
            ("train.lambda_depth", &[0.0, most], &[-1e-9]),
            ("train.sh_degree", &[0.0, 3.0], &[4.0]),
            ("train.rates.sh_rest_divisor", &[1e-9, most], &[0.0, -1.0]),
            ("train.max_views", &[2.0], &[1.0]),
            ("densify.every", &[1.0], &[0.0]),
            ("densify.grad_threshold", &[1e-9, most], &[0.0, -1.0]),
            ("densify.min_opacity", &[1e-9, 0.999], &[0.0, 1.0]),
            ("two_view.radius_px", &[1e-9, most], &[0.0, -1.0]),
            ("two_view.min_inverse_depth_sigmas", &[1e-9, most], &[0.0, -1.0]),
            ("labels.step_px", &[4.0, 128.0], &[3.0, 129.0]),
            ("labels.noise.floor_m", &[1e-9, most], &[0.0, -1.0]),
            ("labels.noise.per_m", &[0.0, most], &[-1e-9]),
            ("labels.trust_young", &[1e-9, 0.999], &[0.0, 1.0]),
            ("labels.trust_old", &[1e-9, 0.999], &[0.0, 1.0]),
            ("labels.trust_unknown", &[1e-9, 0.999], &[0.0, 1.0]),
            ("labels.settle_frames", &[1.0], &[0.0]),
            ("labels.rest_frames", &[1.0], &[0.0]),
            ("labels.history_gap", &[1.0], &[0.0]),
            ("labels.edge_ratio", &[1e-9, most], &[0.0, -1.0]),
            ("labels.spread.neighbours", &[1.0], &[0.0]),
            ("labels.spread.radius_m", &[1e-9, most], &[0.0, -1.0]),
            ("labels.gaussian_mask.opacity", &[1e-9, 0.999], &[0.0, 1.0]),
            ("labels.gaussian_mask.depth_m", &[0.0, most], &[-1e-9]),
            ("labels.gaussian_mask.surface_share", &[0.0, 0.999], &[-1e-9, 1.0]),
            ("labels.patch_motion.min_suspects", &[0.0, 1.0], &[-1e-9, 1.001]),
            ("labels.patch_motion.same_correlation", &[-1.0, 1.0], &[-1.001, 1.001]),
            ("labels.patch_motion.min_correlation", &[-1.0, 1.0], &[-1.001, 1.001]),
            ("labels.patch_motion.sigma_px", &[1e-9, most], &[0.0, -1.0]),
            ("labels.patch_motion.ages_frames.2", &[1.0], &[0.0]),
            ("flow.covariance_floor_px2", &[0.0, most], &[-1e-9]),
            ("flow.min_support", &[3.0], &[2.0]),
            ("flow.chi2", &[1e-9, most], &[0.0, -1.0]),
            ("loops.max_drift", &[1e-9, most], &[0.0, -1.0]),
            ("loops.max_drift_floor_m", &[1e-9, most], &[0.0, -1.0]),
            ("loops.in_a_row", &[1.0], &[0.0]),
            ("loops.min_inliers", &[3.0], &[2.0]),
            ("culling.redundant_share", &[1e-9, 1.0], &[0.0, 1.001]),
            ("culling.observers", &[1.0], &[0.0]),
            ("insertion.stride_px", &[1.0], &[0.0]),
            ("insertion.footprint", &[1e-9, most], &[0.0, -1.0]),
            ("insertion.opacity", &[1e-9, 0.999], &[0.0, 1.0]),
        ];
        for (key, good, bad) in cases {
            let with = |value: f64| -> Config {
                let mut json = serde_json::to_value(Config::default()).expect("numbers");
                let path = format!("/{}", key.replace('.', "/"));
                let place = json.pointer_mut(&path).expect("the key");
                *place = match place.is_f64() {
                    true => value.into(),
                    false => serde_json::from_str(&format!("{value:.0}")).expect("an integer"),
                };
                serde_json::from_value(json).expect("a configuration")
            };
            for value in *good {
                assert_eq!(with(*value).validate(), Ok(()), "{key} = {value}");
            }
            for value in *bad {
                let found = with(*value).validate();
                let expected = key.trim_end_matches(".2");
                let named = matches!(&found, Err(ConfigError::OutOfRange { key, value: v, .. })
                    if *key == expected && (v - value).abs() <= 0.0);
                assert!(named, "{key} = {value}: {found:?}");
            }
        }
    }

    #[test]
    fn a_gap_of_at_least_one_frame() {
        let mut config = Config::default();
        (config.keyframes.min_gap, config.keyframes.max_gap) = (0, 1);
        assert_eq!(config.validate(), Ok(()), "every frame");
        config.keyframes.max_gap = 0;
        config.validate().expect_err("none");
        config.features.fast_threshold = 6;
        let error = config.validate().expect_err("below the least");
        assert!(error.to_string().contains("fast_min_threshold"), "{error}");
    }
}
