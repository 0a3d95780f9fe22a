//! Pyramids, corners, descriptors, their matches, tracked points, places.

use garad_core::pyramid::{GrayPyramid, level_scales};
use garad_core::{KeyframeId, Par};
use garad_features::lk::reference::scharr;
use garad_features::matching::{match_descriptors, nearest};
use garad_features::orb::{blur, orientation};
use garad_features::{
    Descriptor, FeatureError, LkConfig, LkPyramid, LkTrack, MatchConfig, OrbConfig, OrbExtractor,
    PlaceConfig, PlaceIndex, fast9,
};
use garad_golden::{InputError, Inputs};

use crate::convert::{gray, has};
use crate::outputs::{Answer, Error, Outputs};

pub(crate) fn pyramid(inputs: &Inputs) -> Answer {
    let image = gray(inputs, "image")?;
    let (dx, dy) = scharr(&image);
    let mut out = Outputs::default();
    out.image("gauss7", &blur::blur(&image));
    out.image("scharr_x", &dx.map(|v| i32::from(*v)));
    out.image("scharr_y", &dy.map(|v| i32::from(*v)));
    let halved = GrayPyramid::halved(image.clone(), 3);
    let scaled = GrayPyramid::scaled(image, 1.2, 8);
    for (name, pyramid) in [("half", &halved), ("orb", &scaled)] {
        for (l, level) in pyramid.levels().iter().enumerate().skip(1) {
            out.image(&format!("{name}_{l}"), level);
        }
    }
    out.put("scales", level_scales(1.2, 8));
    Ok(out)
}

fn threshold(inputs: &Inputs) -> Result<u8, Error> {
    Ok(u8::try_from(inputs.count("threshold")?)?)
}

pub(crate) fn fast(inputs: &Inputs) -> Answer {
    let (image, threshold) = (gray(inputs, "image")?, threshold(inputs)?);
    let corners = fast9::corners(&image, threshold, true);
    let mut out = Outputs::default();
    out.put("xy", corners.iter().map(|c| [c.x, c.y]));
    out.put("score", corners.iter().map(|c| c.score));
    out.one(
        "count_without_nms",
        fast9::corners(&image, threshold, false).len(),
    );
    Ok(out)
}

pub(crate) fn orb(inputs: &Inputs, par: Par) -> Answer {
    let mut out = Outputs::default();
    if !has(inputs, "image") {
        let points = inputs.singles("y")?.into_iter().zip(inputs.singles("x")?);
        out.put(
            "atan2",
            points.map(|(y, x)| orientation::fast_atan2_deg(y, x)),
        );
        return Ok(out);
    }
    let config = OrbConfig {
        features: inputs.count("features")?,
        ..OrbConfig::default()
    };
    let found = OrbExtractor::new(config)?.extract(&gray(inputs, "image")?, par)?;
    let keypoints = &found.keypoints;
    out.put("level", keypoints.iter().map(|k| k.level));
    out.put("pt", keypoints.iter().map(|k| [k.x, k.y]));
    out.put("response", keypoints.iter().map(|k| k.response));
    out.put("angle", keypoints.iter().map(|k| k.angle_deg));
    out.put(
        "descriptor",
        found.descriptors.iter().map(Descriptor::to_bytes),
    );
    Ok(out)
}

pub(crate) fn descriptors(inputs: &Inputs, name: &str) -> Result<Vec<Descriptor>, InputError> {
    let bytes = inputs.bytes(name)?.as_chunks::<32>().0.iter();
    Ok(bytes.map(Descriptor::from_bytes).collect())
}

pub(crate) fn matching(inputs: &Inputs, par: Par) -> Answer {
    let (query, train) = (descriptors(inputs, "query")?, descriptors(inputs, "train")?);
    let found: Vec<_> = nearest(&query, &train, par).into_iter().flatten().collect();
    let mutual = MatchConfig {
        max_distance: 256,
        ratio: None,
        mutual: true,
    };
    let pairs = match_descriptors(&query, &train, &mutual, par);
    let mut out = Outputs::default();
    out.put("nearest", found.iter().map(|n| n.train));
    out.put("distance", found.iter().map(|n| n.distance));
    out.put("second", found.iter().map(|n| n.second));
    out.put("mutual", pairs.iter().map(|m| [m.query, m.train]));
    Ok(out)
}

/// The last points of each case are flat or outside of the image: only whether they are lost is compared.
const POINTS_TO_LOSE: usize = 8;

type Track = fn(
    &LkPyramid,
    &LkPyramid,
    &[[f32; 2]],
    Option<&[[f32; 2]]>,
    &LkConfig,
    Par,
) -> Result<Vec<LkTrack>, FeatureError>;

pub(crate) fn lucas_kanade(inputs: &Inputs, par: Par, track: Track) -> Answer {
    let levels = inputs.count("levels")?;
    let prev = LkPyramid::new(&gray(inputs, "prev")?, levels)?;
    let next = LkPyramid::new(&gray(inputs, "next")?, levels)?;
    let points = inputs.singles("points")?;
    let points = points.as_chunks::<2>().0;
    let found = track(&prev, &next, points, None, &LkConfig::default(), par)?;
    let corners = &found[..found.len().saturating_sub(POINTS_TO_LOSE)];
    let moved = corners.iter().zip(points);
    let mut out = Outputs::default();
    out.put("status", found.iter().map(LkTrack::is_tracked));
    for suffix in ["", "_opencv"] {
        out.put(&format!("xy{suffix}"), corners.iter().map(|t| t.xy));
        out.put(
            &format!("residual{suffix}"),
            corners.iter().map(|t| t.residual),
        );
    }
    out.put(
        "flow_truth",
        moved.map(|(t, p)| [t.xy[0] - p[0], t.xy[1] - p[1]]),
    );
    Ok(out)
}

/// The first images of each case are keyframes, the others queries.
const KEYFRAMES: usize = 16;

pub(crate) fn place(inputs: &Inputs) -> Answer {
    let all = descriptors(inputs, "descriptors")?;
    let mut rest = all.as_slice();
    let mut images = Vec::new();
    for length in inputs.indices("length")? {
        let parts = rest.split_at_checked(length);
        let (image, after) = parts.ok_or("'length' does not add up")?;
        images.push(image);
        rest = after;
    }
    let config = PlaceConfig {
        tables: inputs.count("tables")?,
        bits: inputs.count("bits")?,
    };
    let mut index = PlaceIndex::new(config, inputs.count("seed")? as u64)?;
    let (keyframes, queries) = images.split_at_checked(KEYFRAMES).ok_or("too few images")?;
    let ids = || (0..).map(KeyframeId).take(KEYFRAMES);
    ids()
        .zip(keyframes)
        .for_each(|(id, image)| index.add(id, image));
    let axes = [queries.len(), KEYFRAMES];
    let scores = queries
        .iter()
        .flat_map(|image| ids().map(|id| index.score(id, image).unwrap_or(-1.0)));
    let order = queries
        .iter()
        .flat_map(|image| index.query(image, KEYFRAMES, |_| false));
    let mut out = Outputs::default();
    out.shaped("score", &axes, scores)?;
    out.shaped("order", &axes, order.map(|candidate| candidate.id.0))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use garad_core::GrayImage;
    use garad_features::fast9::Window;
    use garad_golden::Case;

    use super::*;

    /// The plain loops give the same scores.
    #[test]
    fn scores_of_reference_and_fast_are_the_same() {
        for case in Case::load_all("fast") {
            let image = gray(case.inputs(), "image").unwrap();
            let threshold = threshold(case.inputs()).unwrap();
            let (mut slow, mut quick) = (GrayImage::default(), GrayImage::default());
            fast9::reference::score_window(&image, threshold, Window::inside(&image), &mut slow);
            fast9::fast::score_window(&image, threshold, Window::inside(&image), &mut quick);
            assert_eq!(slow, quick, "{}", case.name());
        }
    }
}
