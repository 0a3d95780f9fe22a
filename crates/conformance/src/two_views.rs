//! Two views of a scene: epipolar lines, and the flow between them.

use garad_core::chi_square::chi2_2dof_quantile;
use garad_core::{Camera, Se3, So3};
use garad_features::epipolar::{fundamental, point_to_line_px, sampson_px2};
use garad_features::flow::FlowFit;
use garad_features::{FlowConfig, FlowEstimator, FlowForm, FlowPoint, verify_flow};
use garad_golden::{InputError, Inputs};
use nalgebra::{Matrix3, Vector3};

use crate::convert::{has, matrix, vectors};
use crate::outputs::{Answer, Outputs};

/// F has neither scale nor sign: it is brought to norm 1 with its largest entry positive.
pub(crate) fn epipolar(inputs: &Inputs) -> Answer {
    let (uv1, uv2) = (vectors::<2>(inputs, "uv1")?, vectors::<2>(inputs, "uv2")?);
    let camera = Camera::pinhole((640, 480), inputs.row("intrinsics")?)?;
    let rotation = Matrix3::from_row_slice(&inputs.row::<9>("rotation")?);
    let translation = Vector3::from(inputs.row::<3>("translation")?);
    let f = fundamental(
        &camera,
        &camera,
        &Se3::new(So3::from_matrix(&rotation), translation),
    );
    let largest = f
        .iter()
        .fold(0.0f64, |a, &b| if b.abs() > a.abs() { b } else { a });
    let pairs = || uv1.iter().zip(&uv2);
    let distances: Vec<[f64; 2]> = pairs().map(|(a, b)| point_to_line_px(&f, a, b)).collect();
    let mut out = Outputs::default();
    out.put("fundamental", matrix(&(f * (largest.signum() / f.norm()))));
    out.put("distance_in_1", distances.iter().map(|d| d[0]));
    out.put("distance_in_2", distances.iter().map(|d| d[1]));
    out.put("sampson", pairs().map(|(a, b)| sampson_px2(&f, a, b)));
    Ok(out)
}

fn flow_points(inputs: &Inputs, of: &str) -> Result<Vec<FlowPoint>, InputError> {
    let flow = vectors::<2>(inputs, &format!("{of}_flow"))?;
    let name = format!("{of}_predicted");
    let predicted = match has(inputs, &name) {
        true => vectors::<2>(inputs, &name)?.into_iter().map(Some).collect(),
        false => vec![None; flow.len()],
    };
    let both = flow.into_iter().zip(predicted);
    Ok(both
        .map(|(flow, predicted)| FlowPoint { flow, predicted })
        .collect())
}

pub(crate) fn flow(inputs: &Inputs) -> Answer {
    let forms = [("raw", FlowForm::Raw), ("residual", FlowForm::Residual)];
    let estimators = [
        ("moments", FlowEstimator::Moments),
        ("median_mad", FlowEstimator::MedianMad),
        ("trimmed", FlowEstimator::Trimmed),
    ];
    let config = FlowConfig {
        enabled: true,
        model: inputs.choice("form", &forms)?,
        estimator: inputs.choice("estimator", &estimators)?,
        covariance_floor_px2: inputs.number("covariance_floor_px2")?,
        min_support: 3,
        chi2: inputs.number("chi2")?,
    };
    let (fixed, suspects) = (
        flow_points(inputs, "static")?,
        flow_points(inputs, "suspect")?,
    );
    let found = verify_flow(&fixed, &suspects, &config)?;
    let FlowFit::Model(model) = found.fit else {
        return Err("static points that make no model".into());
    };
    let verdicts = || found.verdicts.iter();
    let levels = inputs.reals("levels")?;
    let mut out = Outputs::default();
    out.one("mean", <[f64; 2]>::from(model.mean));
    out.one("covariance", matrix(&model.covariance));
    out.put("support", [model.support]);
    out.put(
        "distance2",
        verdicts().map(|v| v.map_or(f64::NAN, |v| v.distance2)),
    );
    out.put("inside", verdicts().map(|v| v.is_some_and(|v| v.inside)));
    out.put("quantiles", levels.into_iter().map(chi2_2dof_quantile));
    Ok(out)
}

#[cfg(test)]
mod tests {
    use garad_core::Par;
    use garad_features::epipolar::{RansacConfig, eight_point, fundamental_ransac};
    use garad_golden::Case;

    use super::*;

    #[test]
    fn exact_pairs_give_the_lines_back() {
        for case in Case::load_all("epipolar") {
            let uv1 = vectors::<2>(case.inputs(), "uv1").unwrap();
            let exact = vectors::<2>(case.inputs(), "exact_uv2").unwrap();
            let linear = eight_point(&uv1, &exact).expect("general position");
            let pairs = uv1.iter().zip(&exact);
            let worst = pairs.map(|(a, b)| sampson_px2(&linear, a, b).sqrt());
            let worst = worst.fold(0.0, f64::max);
            assert!(worst <= 1e-6, "{}: {worst} px", case.name());
        }
    }

    #[test]
    fn wrong_pairs_are_told_apart() {
        for case in Case::load_all("epipolar") {
            let [uv1, uv2] = ["uv1", "uv2"].map(|n| vectors::<2>(case.inputs(), n).unwrap());
            let is_wrong = case.inputs().indices("is_wrong").unwrap();
            let config = RansacConfig::default();
            let found = fundamental_ransac(&uv1, &uv2, &config, Par::Threads(2)).expect("solvable");
            let (mut kept, mut right, mut kept_right) = (0.0, 0.0, 0.0);
            for (&inlier, &wrong) in found.inliers.iter().zip(&is_wrong) {
                kept += f64::from(inlier);
                right += f64::from(wrong == 0);
                kept_right += f64::from(inlier && wrong == 0);
            }
            let (recall, precision) = (kept_right / right, kept_right / kept);
            let verdict = format!("{}: recall {recall}, precision {precision}", case.name());
            assert!(recall >= 0.97 && precision >= 0.97, "{verdict}");
        }
    }
}
