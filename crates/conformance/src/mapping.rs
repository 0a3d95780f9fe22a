//! The targets of training, level by level, and density control.

use garad_core::undistort::Undistortion;
use garad_core::{Camera, GaussianMap, KeyframeId, Label, Par};
use garad_golden::Inputs;
use garad_slam::config::DensifyConfig;
use garad_slam::stages::{Densifier, Target, densify_with, faded, level_of_iteration, too_large};

use crate::convert::{gray_if_there, has, labels, of_size, plane, rows};
use crate::geometry::{calibration, colors};
use crate::outputs::{Answer, Outputs};

pub(crate) fn image_pyramid(inputs: &Inputs, par: Par) -> Answer {
    let camera = calibration(inputs)?;
    let (straight, rgb) = (Undistortion::new(&camera), colors(inputs, &camera)?);
    let depth = match has(inputs, "depth") {
        true => Some(of_size(inputs, "depth", plane(inputs, "depth")?, &camera)?),
        false => None,
    };
    let moving = gray_if_there(inputs, "moving")?;
    let moving = moving
        .map(|m| of_size(inputs, "moving", m, &camera))
        .transpose()?;
    let mut out = Outputs::default();
    for level in 0..inputs.count("levels")? {
        let recorded = (&rgb, depth.as_ref(), moving.as_ref());
        let target = Target::new(&camera, &straight, recorded, level, par);
        out.image(&format!("color_{level}"), &target.color);
        out.image(&format!("excluded_{level}"), &target.excluded);
        if let Some(depth) = &target.depth {
            out.image(&format!("depth_{level}"), depth);
        }
        let Camera { fx, fy, cx, cy, .. } = target.camera;
        let [width, height] = [target.camera.width, target.camera.height].map(|n| n as f64);
        out.one(&format!("camera_{level}"), [fx, fy, cx, cy, width, height]);
    }
    let per_level = inputs.count("per_level")?;
    let uses = 0..inputs.count("uses")?;
    out.put("level", uses.map(|n| level_of_iteration(n, per_level)));
    Ok(out)
}

/// Gradients of some iterations, each at the size of its image; then one run of density control.
pub(crate) fn density(inputs: &Inputs) -> Answer {
    let mut map = GaussianMap::new(0);
    map.means = rows(inputs, "means")?;
    let n = map.means.len();
    map.log_scales = rows(inputs, "log_scales")?;
    map.quaternions = rows(inputs, "quaternions")?;
    map.opacity_logits = inputs.singles("opacity_logits")?;
    map.sh = rows(inputs, "sh")?;
    map.label = labels(inputs, "label")?;
    (map.landmark, map.parent) = (vec![None; n], vec![None; n]);
    for born in inputs.indices("born")? {
        map.born.push(KeyframeId(u32::try_from(born)?));
    }
    map.validate()?;
    let config = DensifyConfig {
        grad_threshold: inputs.number("grad_threshold")?,
        split_extent: inputs.number("split_extent")?,
        max_gaussians: inputs.count("max_gaussians")?,
        ..DensifyConfig::default()
    };
    let gradients = rows::<f32, 2>(inputs, "gradients")?;
    let radii = inputs.tensor("radii")?.i64().into_iter().map(i32::try_from);
    let radii: Vec<i32> = radii.collect::<Result<_, _>>()?;
    let (widths, heights) = (inputs.indices("width")?, inputs.indices("height")?);
    let iterations = widths.len();
    if heights.len() != iterations || [gradients.len(), radii.len()] != [iterations * n; 2] {
        return Err("gradients, radii and image sizes do not have matching sizes".into());
    }
    let mut accumulated = Densifier::default();
    for (t, (width, height)) in widths.into_iter().zip(heights).enumerate() {
        let camera = Camera::pinhole((width, height), [1.0, 1.0, 0.0, 0.0])?;
        let rows = t * n..(t + 1) * n;
        accumulated.add(&gradients[rows.clone()], &radii[rows], &camera);
    }
    let extent_m = inputs.number("extent_m")?;
    let young_from = KeyframeId(u32::try_from(inputs.count("young_from")?)?);
    let mut normals = inputs.reals("normals")?.into_iter();
    let normal = || normals.next().unwrap_or(f64::NAN);
    let split = densify_with(
        &mut map,
        &accumulated,
        extent_m,
        young_from,
        &config,
        normal,
    );
    let mut out = Outputs::default();
    out.put("mean_gradient", (0..n).map(|i| accumulated.mean(i)));
    out.put("split", split);
    let added = n..map.len();
    let parents = map.parent[added.clone()].iter();
    out.put("parent", parents.map(|p| p.map_or(-1, i64::from)));
    out.put("new_means", map.means[added.clone()].iter().copied());
    out.put(
        "new_log_scales",
        map.log_scales[added.clone()].iter().copied(),
    );
    out.put(
        "new_quaternions",
        map.quaternions[added.clone()].iter().copied(),
    );
    out.put(
        "new_opacity_logits",
        map.opacity_logits[added.clone()].iter().copied(),
    );
    out.put("new_sh", map.sh[added.clone()].iter().copied());
    out.put("new_born", map.born[added.clone()].iter().map(|k| k.0));
    let dynamic = map.label[added].iter().map(|l| *l == Label::Dynamic);
    out.put("new_label", dynamic);
    out.put("too_large", too_large(&map, extent_m));
    out.put("faded", faded(&map, inputs.number("min_opacity")?));
    Ok(out)
}
