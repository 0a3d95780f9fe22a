//! Corners, descriptors, matches, flow.

use garad_core::Par;
use garad_features::matching::{match_descriptors, nearest};
use garad_features::{
    Descriptor, FeatureError, LkConfig, LkPyramid, MatchConfig, OrbConfig, OrbExtractor, fast9, lk,
    orb::orientation,
};

use super::fields::Fields;
use super::{Outputs, OwnError};

fn whole(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

pub(super) fn fast(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let image = fields.gray("image")?;
    let threshold = u8::try_from(fields.count("threshold")?);
    let threshold = threshold.map_err(|_| fields.wrong("the threshold is no byte"))?;
    let corners = fast9::corners(&image, threshold, true);
    let all = fast9::corners(&image, threshold, false);
    let mut out = Outputs::default();
    out.put_whole("xy", corners.iter().flat_map(|c| [whole(c.x), whole(c.y)]));
    out.put_whole("score", corners.iter().map(|c| c.score));
    out.put_whole("count_without_nms", [whole(all.len())]);
    Ok(out)
}

fn singles(fields: Fields<'_>, name: &str) -> Result<Vec<f32>, OwnError> {
    let tensor = fields.tensor(name)?;
    match tensor.dtype() {
        garad_golden::Dtype::F32 => Ok(tensor.f32()),
        other => Err(fields.wrong(format!("'{name}' is {}, not f32", other.name()))),
    }
}

pub(super) fn orb(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let mut out = Outputs::default();
    if fields.0.try_input("image").is_none() {
        let (y, x) = (singles(fields, "y")?, singles(fields, "x")?);
        let angles = y
            .iter()
            .zip(&x)
            .map(|(&y, &x)| orientation::fast_atan2_deg(y, x));
        out.put("atan2", angles);
        return Ok(out);
    }
    let config = OrbConfig {
        features: fields.count("features")?,
        ..OrbConfig::default()
    };
    let wrong = |error: FeatureError| fields.wrong(error);
    let mut extractor = OrbExtractor::new(config).map_err(wrong)?;
    let found = extractor
        .extract(&fields.gray("image")?, Par::Seq)
        .map_err(wrong)?;
    let keypoints = &found.keypoints;
    out.put_whole("level", keypoints.iter().map(|k| k.level));
    out.put("pt", keypoints.iter().flat_map(|k| [k.x, k.y]));
    out.put("response", keypoints.iter().map(|k| k.response));
    out.put("angle", keypoints.iter().map(|k| k.angle_deg));
    out.put_whole(
        "descriptor",
        found.descriptors.iter().flat_map(Descriptor::to_bytes),
    );
    Ok(out)
}

pub(super) fn matching(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let descriptors = |name| -> Result<Vec<Descriptor>, OwnError> {
        let bytes = fields.bytes(name)?;
        Ok(bytes
            .as_chunks::<32>()
            .0
            .iter()
            .map(Descriptor::from_bytes)
            .collect())
    };
    let (query, train) = (descriptors("query")?, descriptors("train")?);
    let found: Vec<_> = nearest(&query, &train, Par::Seq)
        .into_iter()
        .flatten()
        .collect();
    let mutual = MatchConfig {
        max_distance: 256,
        ratio: None,
        mutual: true,
    };
    let pairs = match_descriptors(&query, &train, &mutual, Par::Seq);
    let mut out = Outputs::default();
    out.put_whole("nearest", found.iter().map(|n| whole(n.train)));
    out.put_whole("distance", found.iter().map(|n| n.distance));
    out.put_whole("second", found.iter().map(|n| n.second));
    out.put_whole(
        "mutual",
        pairs.iter().flat_map(|m| [whole(m.query), whole(m.train)]),
    );
    Ok(out)
}

pub(super) fn lucas_kanade(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let levels = fields.count("levels")?;
    let wrong = |error: FeatureError| fields.wrong(error);
    let pyramid = |name| -> Result<LkPyramid, OwnError> {
        LkPyramid::new(&fields.gray(name)?, levels).map_err(wrong)
    };
    let (prev, next) = (pyramid("prev")?, pyramid("next")?);
    let points = singles(fields, "points")?;
    let points = points.as_chunks::<2>().0;
    let found = lk::track(&prev, &next, points, None, &LkConfig::default(), Par::Seq);
    let found = found.map_err(wrong)?;
    // Positions are compared on the corners, which come first; the rest is flat or outside.
    let case = fields.0;
    let known = case.output_names().any(|name| name == "xy");
    let n = if known {
        case.output("xy").len() / 2
    } else {
        found.len()
    };
    let corners = &found[..n.min(found.len())];
    let mut out = Outputs::default();
    out.put_whole("status", found.iter().map(|t| u8::from(t.is_tracked())));
    for name in ["xy", "xy_opencv"] {
        out.put(name, corners.iter().flat_map(|t| t.xy));
    }
    for name in ["residual", "residual_opencv"] {
        out.put(name, corners.iter().map(|t| t.residual));
    }
    let moved = corners.iter().zip(points);
    out.put(
        "flow_truth",
        moved.flat_map(|(t, p)| [t.xy[0] - p[0], t.xy[1] - p[1]]),
    );
    Ok(out)
}
