//! Files of recordings and maps.

use std::path::Path;

use garad_core::{Se3, So3, StampedPose};
use garad_dataset::ply::{format_ply, parse_ply};
use garad_dataset::{Dataset, OpenOptions, PlyOptions, associate, bonn_camera_from_marker};
use nalgebra::Vector3;

use super::fields::Fields;
use super::{Outputs, OwnError};

/// The recording of the stage `decode`, from the folder of one of its cases.
const SAMPLE: &str = "../../../data/tum_fr1_desk_9";
/// Bytes of a vertex in the layout of 3D Gaussian Splatting.
const VERTEX_BYTES: usize = 248;

fn whole(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

pub(super) fn decode(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let sample = fields.0.folder().join(SAMPLE);
    let dataset = Dataset::open(&sample, &OpenOptions::default());
    let dataset = dataset.map_err(|error| fields.wrong(error))?;
    let frame = dataset.read(fields.count("frame")?);
    let frame = frame.map_err(|error| fields.wrong(error))?;
    let step = fields.count("step")?.max(1);
    let (width, height) = frame.rgb.size();
    let (mut rgb, mut depth) = (Vec::new(), Vec::new());
    for y in (0..height).step_by(step) {
        for x in (0..width).step_by(step) {
            rgb.extend(frame.rgb[(x, y)]);
            depth.push(frame.depth[(x, y)]);
        }
    }
    let sum = frame.rgb.data().iter().fold([0.0; 3], |sum, pixel| {
        [0, 1, 2].map(|c| sum[c] + f64::from(pixel[c]))
    });
    let known = frame.depth.data().iter().filter(|d| **d > 0.0);
    let raw = known.clone().map(|d| (f64::from(*d) * 5000.0).round());
    let mut out = Outputs::default();
    out.put_whole("rgb", rgb);
    out.put("depth", depth);
    out.put("rgb_sum", sum);
    out.put("depth_raw_sum", [raw.fold(0.0, |sum, d| sum + d)]);
    out.put_whole("depth_known", [whole(known.count())]);
    Ok(out)
}

pub(super) fn pairs(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let (a, b) = (fields.reals("a")?, fields.reals("b")?);
    let pairs = associate(&a, &b, fields.number("max_dt")?);
    let mut out = Outputs::default();
    let flat = pairs.into_iter().flat_map(|(i, j)| [whole(i), whole(j)]);
    out.put_whole("pairs", flat);
    Ok(out)
}

pub(super) fn bonn(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let mut marker = Vec::new();
    let rows = fields.rows::<4>("quaternion_xyzw")?.into_iter();
    for ([x, y, z, w], p) in rows.zip(fields.rows::<3>("position")?) {
        let rotation = So3::from_quaternion(w, x, y, z);
        let rotation = rotation.ok_or_else(|| fields.wrong("a pose without rotation"))?;
        marker.push(StampedPose {
            t_s: 0.0,
            world_from_camera: Se3::new(rotation, Vector3::from(p)),
        });
    }
    let (mut rotation, mut translation) = (Vec::new(), Vec::new());
    for pose in bonn_camera_from_marker(&marker) {
        let rows = pose.world_from_camera.rotation.matrix().transpose();
        rotation.extend(rows.iter().copied());
        translation.extend(pose.world_from_camera.translation.iter().copied());
    }
    let mut out = Outputs::default();
    out.put("rotation", rotation);
    out.put("translation", translation);
    Ok(out)
}

pub(super) fn ply(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let file = fields.bytes("file")?;
    let map = parse_ply(Path::new("case.ply"), &mut &file[..]);
    let map = map.map_err(|error| fields.wrong(error))?;
    let mut out = Outputs::default();
    out.put("means", map.means.as_flattened().iter().copied());
    out.put("sh", map.sh.as_flattened().iter().copied());
    out.put("opacity_logits", map.opacity_logits.iter().copied());
    out.put("log_scales", map.log_scales.as_flattened().iter().copied());
    out.put(
        "quaternions",
        map.quaternions.as_flattened().iter().copied(),
    );
    // And written again.
    let mut written = Vec::new();
    format_ply(&mut written, &map, &PlyOptions::default()).map_err(|error| fields.wrong(error))?;
    let at = written.len().saturating_sub(map.len() * VERTEX_BYTES);
    out.put_whole("vertices", written[at..].iter().copied());
    Ok(out)
}
