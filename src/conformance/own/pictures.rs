//! Pyramids, two views, flow, places.

use garad_core::chi_square::chi2_2dof_quantile;
use garad_core::pyramid::{GrayPyramid, level_scales};
use garad_core::{Camera, KeyframeId, Se3, So3};
use garad_features::epipolar::{fundamental, point_to_line_px, sampson_px2};
use garad_features::flow::FlowFit;
use garad_features::lk::reference::scharr;
use garad_features::orb::blur;
use garad_features::{
    Descriptor, FeatureError, FlowConfig, FlowEstimator, FlowForm, FlowPoint, PlaceConfig,
    PlaceIndex, verify_flow,
};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::fields::Fields;
use super::{Outputs, OwnError};

fn whole(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

pub(super) fn pyramid(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let image = fields.gray("image")?;
    let mut out = Outputs::default();
    out.put_whole("gauss7", blur::blur(&image).data().iter().copied());
    let (dx, dy) = scharr(&image);
    out.put_whole("scharr_x", dx.data().iter().copied());
    out.put_whole("scharr_y", dy.data().iter().copied());
    let halved = GrayPyramid::halved(image.clone(), 3);
    let scaled = GrayPyramid::scaled(image, 1.2, 8);
    for (name, pyramid) in [("half", &halved), ("orb", &scaled)] {
        for (l, level) in pyramid.levels().iter().enumerate().skip(1) {
            out.put_whole(&format!("{name}_{l}"), level.data().iter().copied());
        }
    }
    out.put("scales", level_scales(1.2, 8));
    Ok(out)
}

fn pixels(fields: Fields<'_>, name: &str) -> Result<Vec<Vector2<f64>>, OwnError> {
    let rows = fields.rows::<2>(name)?.into_iter();
    Ok(rows.map(Vector2::from).collect())
}

/// F has neither scale nor sign: it is brought to norm 1 with its largest entry positive.
pub(super) fn epipolar(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let (uv1, uv2) = (pixels(fields, "uv1")?, pixels(fields, "uv2")?);
    let camera = Camera::pinhole((640, 480), fields.row("intrinsics")?);
    let camera = camera.map_err(|error| fields.wrong(error))?;
    let rotation = Matrix3::from_row_slice(&fields.row::<9>("rotation")?);
    let shift = Vector3::from(fields.row::<3>("translation")?);
    let motion = Se3::new(So3::from_matrix(&rotation), shift);
    let f = fundamental(&camera, &camera, &motion);
    let largest = f
        .iter()
        .fold(0.0f64, |a, &b| if b.abs() > a.abs() { b } else { a });
    let scaled = f * (largest.signum() / f.norm());
    let mut out = Outputs::default();
    out.put("fundamental", scaled.transpose().iter().copied());
    let pairs = uv1.iter().zip(&uv2);
    let distances: Vec<[f64; 2]> = pairs
        .clone()
        .map(|(a, b)| point_to_line_px(&f, a, b))
        .collect();
    out.put("distance_in_1", distances.iter().map(|d| d[0]));
    out.put("distance_in_2", distances.iter().map(|d| d[1]));
    out.put("sampson", pairs.map(|(a, b)| sampson_px2(&f, a, b)));
    Ok(out)
}

fn flow_points(fields: Fields<'_>, who: &str) -> Result<Vec<FlowPoint>, OwnError> {
    let flow = pixels(fields, &format!("{who}_flow"))?;
    let name = format!("{who}_predicted");
    let predicted = match fields.0.try_input(&name) {
        Some(_) => pixels(fields, &name)?.into_iter().map(Some).collect(),
        None => vec![None; flow.len()],
    };
    let both = flow.into_iter().zip(predicted);
    Ok(both
        .map(|(flow, predicted)| FlowPoint { flow, predicted })
        .collect())
}

pub(super) fn flow(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let config = FlowConfig {
        enabled: true,
        model: match fields.word("form")? {
            "raw" => FlowForm::Raw,
            "residual" => FlowForm::Residual,
            other => return Err(fields.wrong(format!("form '{other}'"))),
        },
        estimator: match fields.word("estimator")? {
            "moments" => FlowEstimator::Moments,
            "median_mad" => FlowEstimator::MedianMad,
            "trimmed" => FlowEstimator::Trimmed,
            other => return Err(fields.wrong(format!("estimator '{other}'"))),
        },
        covariance_floor_px2: fields.number("covariance_floor_px2")?,
        min_support: 3,
        chi2: fields.number("chi2")?,
    };
    let (fixed, suspects) = (
        flow_points(fields, "static")?,
        flow_points(fields, "suspect")?,
    );
    let found = verify_flow(&fixed, &suspects, &config).map_err(|error| fields.wrong(error))?;
    let FlowFit::Model(model) = found.fit else {
        return Err(fields.wrong("static points that make no model"));
    };
    let mut out = Outputs::default();
    out.put("mean", model.mean.iter().copied());
    out.put("covariance", model.covariance.iter().copied());
    out.put_whole("support", [whole(model.support)]);
    let verdicts = found.verdicts.iter();
    let distance2 = verdicts
        .clone()
        .map(|v| v.map_or(f64::NAN, |v| v.distance2));
    out.put("distance2", distance2);
    out.put_whole(
        "inside",
        verdicts.map(|v| u8::from(v.is_some_and(|v| v.inside))),
    );
    let levels = fields.reals("levels")?;
    out.put("quantiles", levels.into_iter().map(chi2_2dof_quantile));
    Ok(out)
}

pub(super) fn place(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let bytes = fields.bytes("descriptors")?;
    let all: Vec<Descriptor> = bytes
        .as_chunks::<32>()
        .0
        .iter()
        .map(Descriptor::from_bytes)
        .collect();
    let config = PlaceConfig {
        tables: fields.count("tables")?,
        bits: fields.count("bits")?,
    };
    let wrong = |error: FeatureError| fields.wrong(error);
    let mut index = PlaceIndex::new(config, fields.count("seed")? as u64).map_err(wrong)?;
    let mut rest = all.as_slice();
    let mut pictures = Vec::new();
    for length in fields.tensor("length")?.i64() {
        let length = usize::try_from(length).ok();
        let parts = length.and_then(|n| rest.split_at_checked(n));
        let (picture, after) = parts.ok_or_else(|| fields.wrong("'length' does not add up"))?;
        pictures.push(picture);
        rest = after;
    }
    // As many keyframes as the scores have columns; the rest are queries.
    let columns = fields
        .asks("score")
        .then(|| fields.0.output("score").shape());
    let keyframes = match columns {
        Some(&[_, keyframes]) => keyframes.min(pictures.len()),
        _ => return Err(fields.wrong("nothing says how many keyframes there are")),
    };
    let ids: Vec<_> = (0..whole(keyframes)).map(KeyframeId).collect();
    for (id, picture) in ids.iter().zip(&pictures) {
        index.add(*id, picture);
    }
    let (mut scores, mut order) = (Vec::new(), Vec::new());
    for picture in &pictures[keyframes..] {
        scores.extend(
            ids.iter()
                .map(|&id| index.score(id, picture).unwrap_or(-1.0)),
        );
        let found = index.query(picture, keyframes, |_| false);
        order.extend(found.iter().map(|candidate| candidate.id.0));
    }
    let mut out = Outputs::default();
    out.put("score", scores);
    out.put_whole("order", order);
    Ok(out)
}
