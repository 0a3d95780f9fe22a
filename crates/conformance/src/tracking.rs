//! Links of keypoints to landmarks, and the decision for a keyframe.

use garad_core::{DepthImage, FrameId, LandmarkId, MaskImage, Par};
use garad_features::Keypoint;
use garad_golden::Inputs;
use garad_slam::Context;
use garad_slam::config::{Config, TrackingMethod};
use garad_slam::frame::{Frame, Levels};
use garad_slam::map::Map;
use garad_slam::map::landmark::Appearance;
use garad_slam::stages::{from_last_frame, from_local_map, needs_keyframe};

use crate::convert::{known, poses, rows, vectors};
use crate::features::descriptors;
use crate::geometry::calibration;
use crate::outputs::{Answer, Error, Outputs};

/// Links as they stand in a case: an index, or -1 for none.
fn links(inputs: &Inputs, name: &str) -> Result<Vec<Option<LandmarkId>>, Error> {
    let link = |index: i64| match index {
        -1 => Ok(None),
        index => Ok(Some(LandmarkId(u32::try_from(index)?))),
    };
    inputs.tensor(name)?.i64().into_iter().map(link).collect()
}

/// A frame of the keypoints whose inputs start with this prefix. Those not in use lie on something that moves.
fn frame(inputs: &Inputs, context: &Context, prefix: &str) -> Result<Frame, Error> {
    let named = |name: &str| format!("{prefix}_{name}");
    let (px, angle) = (
        rows::<f32, 2>(inputs, &named("px"))?,
        inputs.singles(&named("angle"))?,
    );
    let (level, depth_m) = (
        inputs.bytes(&named("level"))?,
        inputs.reals(&named("depth_m"))?,
    );
    let (in_use, link) = (
        inputs.bytes(&named("in_use"))?,
        links(inputs, &named("link"))?,
    );
    let descriptors = descriptors(inputs, &named("descriptor"))?;
    let n = px.len();
    if [
        angle.len(),
        level.len(),
        depth_m.len(),
        in_use.len(),
        link.len(),
        descriptors.len(),
    ] != [n; 6]
        || level
            .iter()
            .any(|l| usize::from(*l) >= context.scales.len())
    {
        return Err(format!("keypoints of '{prefix}' do not have matching sizes").into());
    }
    let camera = &context.camera;
    let size = (camera.width, camera.height);
    let mut mask = MaskImage::new(size.0, size.1, 0);
    let pixel = |px: &[f32; 2]| {
        let near = |v: f32, n: usize| (0..n).find(|i| (*i as f64 - f64::from(v)).abs() <= 0.5);
        near(px[0], size.0).zip(near(px[1], size.1))
    };
    for (px, _) in px.iter().zip(in_use).filter(|(_, used)| **used == 0) {
        mask[pixel(px).ok_or("a keypoint outside the image")?] = 255;
    }
    let keypoint = |i: usize| Keypoint {
        x: px[i][0],
        y: px[i][1],
        level: level[i],
        angle_deg: angle[i],
        response: 1.0,
    };
    let mut frame = Frame::new(
        FrameId(0),
        0.0,
        (0..n).map(keypoint).collect(),
        descriptors,
        &DepthImage::new(size.0, size.1, 0.0),
        Some(&mask),
        camera,
        &Levels::new(size, 1.2, context.scales.len(), false),
        &context.config,
    );
    frame.depth_m = depth_m.into_iter().map(known).collect();
    frame.landmark = link;
    let pose = poses(inputs, &named("rotation"), &named("translation"))?;
    frame.camera_from_world = *pose.first().ok_or("a frame without a pose")?;
    Ok(frame)
}

/// A map of these landmarks, those not alive dropped again.
fn landmarks(inputs: &Inputs, context: &Context) -> Result<Map, Error> {
    let (points, alive) = (vectors::<3>(inputs, "points")?, inputs.bytes("alive")?);
    let descriptors = descriptors(inputs, "descriptor")?;
    let n = points.len();
    if [alive.len(), descriptors.len()] != [n; 2] {
        return Err("landmarks do not have matching sizes".into());
    }
    let size = (context.camera.width, context.camera.height);
    let keypoint = Keypoint {
        x: 0.0,
        y: 0.0,
        level: 0,
        angle_deg: 0.0,
        response: 1.0,
    };
    let mut map = Map::default();
    let keyframe = map.add_keyframe(Frame::new(
        FrameId(0),
        0.0,
        vec![keypoint; n],
        descriptors,
        &DepthImage::new(size.0, size.1, 0.0),
        None,
        &context.camera,
        &Levels::new(size, 1.2, context.scales.len(), false),
        &context.config,
    ));
    for (i, p_world) in points.into_iter().enumerate() {
        map.add_landmark(p_world, keyframe, i, &context.scales);
    }
    for (id, _) in (0u32..).zip(alive).filter(|(_, alive)| **alive == 0) {
        map.drop_landmark(LandmarkId(id));
    }
    Ok(map)
}

pub(crate) fn landmark_links(inputs: &Inputs) -> Answer {
    let mut config = Config::default();
    config.labels.dilate_px = 0;
    let tracking = &mut config.tracking;
    tracking.bf = inputs.number("bf")?;
    tracking.match_distance = u32::try_from(inputs.count("match_distance")?)?;
    let search = inputs.word("search")?;
    if search == "local_map" {
        tracking.local_radius_px = inputs.number("local_radius_px")?;
        tracking.local_radius_oblique_px = inputs.number("local_radius_oblique_px")?;
        tracking.local_ratio = inputs.number("local_ratio")?;
    }
    let context = Context::new(calibration(inputs)?, config, 0, Par::Seq)?;
    let map = landmarks(inputs, &context)?;
    let mut now = frame(inputs, &context, "frame")?;
    let count = match search {
        "last_frame" => {
            let last = frame(inputs, &context, "last")?;
            let radius_px = inputs.number("radius_px")?;
            from_last_frame(&context, &map, &last, &mut now, radius_px)
        }
        "local_map" => {
            let visible = visible(inputs, context.scales.len())?;
            from_local_map(&context, &map, &visible, &mut now)
        }
        other => return Err(format!("search '{other}'").into()),
    };
    let code = |link: &Option<LandmarkId>| link.map_or(-1, |id| i64::from(id.0));
    let mut out = Outputs::default();
    out.put("link", now.landmark.iter().map(code));
    out.one("count", count);
    Ok(out)
}

/// Where landmarks should be seen.
fn visible(inputs: &Inputs, levels: usize) -> Result<Vec<(LandmarkId, Appearance)>, Error> {
    let ids = inputs.indices("visible")?;
    let (uv, depth) = (
        vectors::<2>(inputs, "visible_uv")?,
        inputs.reals("visible_depth_m")?,
    );
    let (level, cosine) = (
        inputs.indices("visible_level")?,
        inputs.reals("visible_cosine")?,
    );
    if [uv.len(), depth.len(), level.len(), cosine.len()] != [ids.len(); 4]
        || level.iter().any(|l| *l >= levels)
    {
        return Err("visible landmarks do not have matching sizes".into());
    }
    let row = |(i, id): (usize, &usize)| {
        let seen = Appearance {
            uv_px: uv[i],
            depth_m: depth[i],
            level: level[i],
            view_cosine: cosine[i],
        };
        Ok((LandmarkId(u32::try_from(*id)?), seen))
    };
    ids.iter().enumerate().map(row).collect()
}

/// One decision for each row.
pub(crate) fn keyframe(inputs: &Inputs) -> Answer {
    let methods = [
        ("features", TrackingMethod::Features),
        ("render", TrackingMethod::Render),
    ];
    let mut config = Config::default();
    config.tracking.method = inputs.choice("method", &methods)?;
    let k = &mut config.keyframes;
    k.min_gap = inputs.count("min_gap")?;
    k.max_gap = inputs.count("max_gap")?;
    k.min_inliers = inputs.count("min_inliers")?;
    k.tracked_share = inputs.number("tracked_share")?;
    k.close_m = inputs.number("close_m")?;
    k.close_tracked_min = inputs.count("close_tracked_min")?;
    k.close_untracked_min = inputs.count("close_untracked_min")?;
    let context = Context::new(calibration(inputs)?, config, 0, Par::Seq)?;
    let [frame, last, inliers, most] =
        ["frame", "last_keyframe", "inliers", "most_inliers"].map(|name| inputs.indices(name));
    let (frame, last, inliers, most) = (frame?, last?, inliers?, most?);
    let (depth_m, in_use) = (inputs.reals("depth_m")?, inputs.bytes("in_use")?);
    let (linked, n) = (inputs.bytes("linked")?, frame.len());
    let points = inputs.count("keypoints")?;
    if [last.len(), inliers.len(), most.len()] != [n; 3]
        || [depth_m.len(), in_use.len(), linked.len()] != [n * points; 3]
    {
        return Err("decisions do not have matching sizes".into());
    }
    let size = (context.camera.width, context.camera.height);
    let keypoint = Keypoint {
        x: 0.0,
        y: 0.0,
        level: 0,
        angle_deg: 0.0,
        response: 1.0,
    };
    let made = |id: usize| -> Result<Frame, Error> {
        Ok(Frame::new(
            FrameId(u32::try_from(id)?),
            0.0,
            vec![keypoint; points],
            vec![garad_features::Descriptor::default(); points],
            &DepthImage::new(size.0, size.1, 0.0),
            None,
            &context.camera,
            &Levels::new(size, 1.2, context.scales.len(), false),
            &context.config,
        ))
    };
    let mut decisions = Vec::new();
    for row in 0..n {
        let mut map = Map::default();
        map.add_keyframe(made(last[row])?);
        let mut now = made(frame[row])?;
        for i in 0..points {
            let at = row * points + i;
            now.depth_m[i] = known(depth_m[at]);
            now.in_use[i] = in_use[at] != 0;
            now.landmark[i] = (linked[at] != 0).then_some(LandmarkId(0));
        }
        decisions.push(needs_keyframe(
            &context,
            &map,
            &now,
            inliers[row],
            most[row],
        ));
    }
    let mut out = Outputs::default();
    out.put("keyframe", decisions);
    Ok(out)
}
