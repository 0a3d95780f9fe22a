//! What moves: free space, the cues of landmarks, the labels of Gaussians.

use garad_core::{
    Camera, DepthImage, FrameId, Image, KeyframeId, Label, LandmarkId, NewGaussian, Par, Se3,
};
use garad_core::{GaussianMap, MaskImage};
use garad_crf::{DepthNoise, LabelWindow, LabelWindowConfig, WindowReading};
use garad_features::{Descriptor, Keypoint};
use garad_golden::{InputError, Inputs};
use garad_slam::Context;
use garad_slam::config::{Config, DepthCue, LabelConfig, TaggedLabels};
use garad_slam::frame::{Frame, Levels};
use garad_slam::map::Map;
use garad_slam::stages::{
    FreeSpace, FreeSpaceHistory, HistoryView, LandmarkLabel, Visibility, landmark_cues, relabel,
};

use crate::convert::{codes, has, known, labels, poses, rows, vectors};
use crate::geometry::calibration;
use crate::outputs::{Answer, Error, Outputs};

/// Side of a cell, px.
const CELL_PX: usize = 4;

fn noise(inputs: &Inputs) -> Result<DepthNoise, InputError> {
    Ok(DepthNoise {
        per_m: inputs.number("noise_per_m")?,
        floor_m: inputs.number("noise_floor_m")?,
    })
}

/// A depth image, its pose, and how many frames ago it was taken.
struct View {
    free_space: FreeSpace,
    camera_from_world: Se3,
    age_frames: u32,
}

impl View {
    fn of_history(&self) -> HistoryView<'_> {
        HistoryView {
            free_space: &self.free_space,
            camera_from_world: self.camera_from_world,
            age_frames: self.age_frames,
        }
    }
}

/// Depth images one after the other, and their masks of what moves, in cells.
fn views(inputs: &Inputs, camera: &Camera) -> Result<Vec<View>, Error> {
    let (width, height) = (camera.width, camera.height);
    let cells = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
    let max_depth_m = inputs.number("max_depth_m")?;
    let (depth, ages) = (inputs.singles("depth")?, inputs.indices("age_frames")?);
    let all = poses(inputs, "view_rotation", "view_translation")?;
    let moving = match has(inputs, "moving") {
        true => Some(inputs.bytes("moving")?),
        false => None,
    };
    let masks = moving.map_or(all.len() * cells.0 * cells.1, <[u8]>::len);
    if depth.len() != all.len() * width * height
        || ages.len() != all.len()
        || masks != all.len() * cells.0 * cells.1
    {
        return Err("depth, masks, ages and poses of the views do not have matching sizes".into());
    }
    let mut made = Vec::new();
    for (v, (camera_from_world, age)) in all.into_iter().zip(ages).enumerate() {
        let depth = depth[v * width * height..][..width * height].to_vec();
        let depth: Option<DepthImage> = Image::from_vec(width, height, depth);
        let depth = depth.ok_or("a view without pixels")?;
        let mut free_space = FreeSpace::new(&depth, max_depth_m);
        if let Some(moving) = moving {
            let mask = moving[v * cells.0 * cells.1..][..cells.0 * cells.1].to_vec();
            let mask: Option<MaskImage> = Image::from_vec(cells.0, cells.1, mask);
            free_space.set_moving(mask.ok_or("a view without cells")?);
        }
        made.push(View {
            free_space,
            camera_from_world,
            age_frames: u32::try_from(age)?,
        });
    }
    Ok(made)
}

/// 0 unknown, 1 occluded, 2 and 3 on a static and a dynamic surface, 4 in front of it by some standard deviations.
fn code(visibility: Visibility) -> (u8, f64) {
    match visibility {
        Visibility::Unknown => (0, f64::NAN),
        Visibility::Occluded => (1, f64::NAN),
        Visibility::OnSurface(Label::Static) => (2, f64::NAN),
        Visibility::OnSurface(Label::Dynamic) => (3, f64::NAN),
        Visibility::InFront(sigmas) => (4, sigmas),
    }
}

pub(crate) fn free_space(inputs: &Inputs) -> Answer {
    let (camera, noise) = (calibration(inputs)?, noise(inputs)?);
    let views = views(inputs, &camera)?;
    let points = vectors::<3>(inputs, "points")?;
    let pairs = || {
        views
            .iter()
            .flat_map(|v| points.iter().map(move |p| (v, p)))
    };
    let seen = pairs().map(|(view, p_world)| {
        let pose = &view.camera_from_world;
        code(view.free_space.query(p_world, &camera, pose, &noise))
    });
    let (visibility, sigmas): (Vec<u8>, Vec<f64>) = seen.unzip();
    let nearest = pairs().map(|(view, p_world)| {
        let p_cam = view.camera_from_world * *p_world;
        let nearest_m = view.free_space.nearest_m(&p_cam, &camera);
        nearest_m.unwrap_or(f64::NAN)
    });
    let history = FreeSpaceHistory {
        camera: &camera,
        noise: &noise,
        views: views.iter().map(View::of_history).collect(),
    };
    let evidence: Vec<_> = points.iter().map(|p| history.query(p)).collect();
    let mut out = Outputs::default();
    let axes = [views.len(), points.len()];
    out.shaped("visibility", &axes, visibility)?;
    out.shaped("sigmas", &axes, sigmas)?;
    out.shaped("nearest_m", &axes, nearest)?;
    let residuals = evidence.iter().map(|e| e.residual.unwrap_or(f64::NAN));
    out.put("residual", residuals);
    out.put("agreed_frames", evidence.iter().map(|e| e.agreed_frames));
    Ok(out)
}

/// Keypoints of level 0 that point nowhere in particular.
fn keypoints(n: usize) -> Vec<Keypoint> {
    let keypoint = Keypoint {
        x: 0.0,
        y: 0.0,
        level: 0,
        angle_deg: 0.0,
        response: 1.0,
    };
    vec![keypoint; n]
}

pub(crate) fn cues(inputs: &Inputs) -> Answer {
    let cue_names = [
        ("spread", DepthCue::Spread),
        ("free_space", DepthCue::FreeSpace),
    ];
    let camera = calibration(inputs)?;
    let mut config = Config::default();
    config.labels.noise = noise(inputs)?;
    config.labels.depth_cue = inputs.choice("depth_cue", &cue_names)?;
    let context = Context::new(camera, config, 0, Par::Seq)?;
    let points = vectors::<3>(inputs, "points")?;
    let [of, by] = ["landmark", "keyframe"].map(|name| inputs.indices(name));
    let (of, by) = (of?, by?);
    let (uv_px, depth_m) = (vectors::<2>(inputs, "uv")?, inputs.reals("depth_m")?);
    let poses = poses(inputs, "rotation", "translation")?;
    if [of.len(), by.len(), depth_m.len()] != [uv_px.len(); 3]
        || of.iter().any(|l| *l >= points.len())
        || by.iter().any(|k| *k >= poses.len())
    {
        return Err("observations do not have matching sizes".into());
    }
    // A keyframe has a keypoint for every observation; landmark l is added with keypoint l.
    let (size, n) = ((camera.width, camera.height), uv_px.len().max(points.len()));
    let depth = DepthImage::new(size.0, size.1, 0.0);
    let levels = Levels::new(size, 1.2, 8, true);
    let mut map = Map::default();
    for (id, camera_from_world) in (0u32..).zip(poses) {
        let features = (keypoints(n), vec![Descriptor::default(); n]);
        let mut frame = Frame::new(
            FrameId(id),
            0.0,
            features.0,
            features.1,
            &depth,
            None,
            &camera,
            &levels,
            &context.config,
        );
        frame.camera_from_world = camera_from_world;
        for (i, (uv, depth)) in uv_px.iter().zip(&depth_m).enumerate() {
            (frame.uv_px[i], frame.depth_m[i]) = (*uv, known(*depth));
        }
        map.add_keyframe(frame);
    }
    let views = views(inputs, &camera)?;
    let history = FreeSpaceHistory {
        camera: &context.camera,
        noise: &context.config.labels.noise,
        views: views.iter().map(View::of_history).collect(),
    };
    let mut found = Vec::new();
    for (l, p_world) in points.iter().enumerate() {
        let id = map.add_landmark(*p_world, KeyframeId(0), l, &context.scales);
        let landmark = map.landmark_mut(id).ok_or("a landmark was lost")?;
        let observed = (0..of.len()).filter(|i| of[*i] == l);
        let observations = observed.map(|i| Ok((KeyframeId(u32::try_from(by[i])?), i)));
        landmark.observations = observations.collect::<Result<_, Error>>()?;
        let landmark = map.landmark(id).ok_or("a landmark was lost")?;
        found.push(landmark_cues(&context, &map, landmark, &history));
    }
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let mut out = Outputs::default();
    out.put("alpha", found.iter().map(|c| number(c.reproj_px)));
    out.put("beta", found.iter().map(|c| number(c.depth_residual)));
    out.put(
        "gamma",
        found.iter().map(|c| number(c.observations.map(f64::from))),
    );
    out.put("delta", found.iter().map(|c| number(c.epipolar_px)));
    Ok(out)
}

/// The landmark behind each Gaussian; -1: none.
fn tags(inputs: &Inputs) -> Result<Vec<Option<LandmarkId>>, Error> {
    let tag = |tag: i64| match tag {
        -1 => Ok(None),
        tag => Ok(Some(LandmarkId(u32::try_from(tag)?))),
    };
    inputs.tensor("tag")?.i64().into_iter().map(tag).collect()
}

/// Labels of earlier runs, the oldest first: 0 static, 1 dynamic, 2 not labelled in that run.
fn window(history: &[u8]) -> LabelWindow {
    let mut window = LabelWindow::default();
    for label in history {
        match label {
            0 => window.push(Label::Static),
            1 => window.push(Label::Dynamic),
            _ => {}
        }
    }
    window
}

pub(crate) fn relabelled(inputs: &Inputs) -> Answer {
    let names = [
        ("evidence", TaggedLabels::Evidence),
        ("landmark", TaggedLabels::Landmark),
    ];
    let camera = calibration(inputs)?;
    let config = LabelConfig {
        noise: noise(inputs)?,
        suspect_sigmas: inputs.number("suspect_sigmas")?,
        tagged: inputs.choice("tagged", &names)?,
        window: LabelWindowConfig {
            runs: u32::try_from(inputs.count("runs")?)?,
            reading: WindowReading::StaticShare,
        },
        ..LabelConfig::default()
    };
    let mut map = GaussianMap::new(0);
    for mean in rows(inputs, "means")? {
        map.push(&NewGaussian {
            mean,
            sigma_m: 0.02,
            opacity: 0.9,
            color: [0.5; 3],
            landmark: None,
            born: KeyframeId(0),
        });
    }
    let (label, tag) = (labels(inputs, "label")?, tags(inputs)?);
    let (history, per_row) = (inputs.bytes("history")?, inputs.count("history_runs")?);
    let changed = labels(inputs, "landmark_changed")?;
    let landmark_label = labels(inputs, "landmark_label")?;
    let ids = inputs.indices("landmark_id")?;
    let n = map.len();
    if [label.len(), tag.len()] != [n; 2]
        || history.len() != n * per_row
        || [changed.len(), landmark_label.len()] != [ids.len(); 2]
    {
        return Err("Gaussians or landmarks do not have matching sizes".into());
    }
    (map.label, map.landmark) = (label, tag);
    let mut windows: Vec<_> = (0..n)
        .map(|i| window(&history[i * per_row..][..per_row]))
        .collect();
    let mut labelled = Vec::new();
    for (id, (label, changed)) in ids.into_iter().zip(landmark_label.into_iter().zip(changed)) {
        labelled.push(LandmarkLabel {
            id: LandmarkId(u32::try_from(id)?),
            label,
            changed: changed == Label::Dynamic,
        });
    }
    let views = views(inputs, &camera)?;
    let view = views.first();
    let pose = view.map_or(Se3::identity(), |v| v.camera_from_world);
    let free_space = view.map(|v| &v.free_space);
    let (counts, expired) = relabel(
        &mut map,
        &mut windows,
        &labelled,
        free_space,
        &camera,
        &pose,
        &config,
    );
    let mut out = Outputs::default();
    out.put("label_after", codes(&map.label));
    out.put("expired", expired);
    out.put(
        "counts",
        [counts.to_dynamic, counts.to_static, counts.removed],
    );
    let runs = config.window.runs;
    out.put("runs_seen", windows.iter().map(LabelWindow::seen));
    out.put("dynamic_runs", windows.iter().map(|w| w.dynamic_runs(runs)));
    Ok(out)
}
