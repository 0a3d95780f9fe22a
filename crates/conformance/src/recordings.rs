//! Files of recordings and maps.

use std::path::Path;

use garad_core::{Se3, StampedPose};
use garad_dataset::ply::{format_ply, parse_ply};
use garad_dataset::{Dataset, OpenOptions, PlyOptions, associate, bonn_camera_from_marker};
use garad_golden::Inputs;

use crate::convert::{matrix, rotation, vectors};
use crate::outputs::{Answer, Outputs};

/// The recording of the stage `decode`.
const RECORDING: &str = "tum_fr1_desk_9";
/// Bytes of a vertex in the layout of 3D Gaussian Splatting.
const VERTEX_BYTES: usize = 248;

pub(crate) fn decode(inputs: &Inputs) -> Answer {
    let dataset = Dataset::open(
        &inputs.data_folder().join(RECORDING),
        &OpenOptions::default(),
    )?;
    let frame = dataset.read(inputs.count("frame")?)?;
    let step = inputs.count("step")?.max(1);
    let (width, height) = frame.rgb.size();
    let rows = (0..height).step_by(step);
    let places = rows.flat_map(|y| (0..width).step_by(step).map(move |x| (x, y)));
    let axes = [height, width].map(|n| n.div_ceil(step));
    let sum = frame.rgb.data().iter().fold([0.0; 3], |sum, pixel| {
        [0, 1, 2].map(|c| sum[c] + f64::from(pixel[c]))
    });
    let known = frame.depth.data().iter().filter(|d| **d > 0.0);
    let raw = known.clone().map(|d| (f64::from(*d) * 5000.0).round());
    let mut out = Outputs::default();
    out.shaped("rgb", &axes, places.clone().map(|at| frame.rgb[at]))?;
    out.shaped("depth", &axes, places.map(|at| frame.depth[at]))?;
    out.put("rgb_sum", sum);
    out.put("depth_raw_sum", [raw.fold(0.0, |sum, d| sum + d)]);
    out.put("depth_known", [known.count()]);
    Ok(out)
}

pub(crate) fn pairs(inputs: &Inputs) -> Answer {
    let (a, b) = (inputs.reals("a")?, inputs.reals("b")?);
    let pairs = associate(&a, &b, inputs.number("max_dt")?);
    let mut out = Outputs::default();
    out.put("pairs", pairs.into_iter().map(|(i, j)| [i, j]));
    Ok(out)
}

pub(crate) fn bonn(inputs: &Inputs) -> Answer {
    let mut marker = Vec::new();
    let rows = inputs.rows::<4>("quaternion_xyzw")?.into_iter();
    for ([x, y, z, w], p) in rows.zip(vectors::<3>(inputs, "position")?) {
        marker.push(StampedPose {
            t_s: 0.0,
            world_from_camera: Se3::new(rotation([w, x, y, z])?, p),
        });
    }
    let found = bonn_camera_from_marker(&marker);
    let poses = || found.iter().map(|pose| &pose.world_from_camera);
    let mut out = Outputs::default();
    out.put("rotation", poses().map(|p| matrix(&p.rotation.matrix())));
    out.put(
        "translation",
        poses().map(|p| <[f64; 3]>::from(p.translation)),
    );
    Ok(out)
}

pub(crate) fn ply(inputs: &Inputs) -> Answer {
    let mut file = inputs.bytes("file")?;
    let map = parse_ply(Path::new("case.ply"), &mut file)?;
    let mut out = Outputs::default();
    out.put("means", map.means.iter().copied());
    let coefficients = [map.len(), map.coefficients()];
    out.shaped("sh", &coefficients, map.sh.iter().copied())?;
    out.put("opacity_logits", map.opacity_logits.iter().copied());
    out.put("log_scales", map.log_scales.iter().copied());
    out.put("quaternions", map.quaternions.iter().copied());
    // And written again.
    let mut written = Vec::new();
    format_ply(&mut written, &map, &PlyOptions::default())?;
    let at = written.len().saturating_sub(map.len() * VERTEX_BYTES);
    out.put("vertices", written[at..].iter().copied());
    Ok(out)
}
