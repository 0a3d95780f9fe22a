//! Insertion: one Gaussian for each new landmark, and depth samples where the map does not yet explain the
//! image. A place that has its Gaussians gets no more of them, however often it is seen (decision
//! 010).

use std::collections::BTreeMap;

use garad_core::{GaussianMap, Label, LandmarkId, NewGaussian, Real, Se3};
use garad_raster::{RasterError, RenderOptions, Rendered, fast, knn_scales_m};
use nalgebra::{Vector2, Vector3};

use super::job::MappingJob;
use crate::config::InsertionConfig;
use crate::context::Context;
use crate::mask::moving_near;

/// Halvings of the image at which the map is rendered to see what it already explains.
const CHECK_LEVEL: usize = 2;
const CHECK_STEP: usize = 1 << CHECK_LEVEL;

/// Share of a stride within which a depth sample makes no second Gaussian beside one of its surface.
const TOO_NEAR: f64 = 0.5;

/// Adds a Gaussian for every `stride_px`-th pixel with depth that the map, rendered from the same
/// pose, does not explain: little opacity, or a surface behind the measured one.
///
/// Standard deviation: `footprint` times the distance between neighbouring samples,
/// stride · z / f (`insertion.scale = "neighbours"` replaces it). Pixels that move, and those within
/// one stride of them, make no Gaussian (`insertion.avoid_moving`). Nor do those within half a stride of a Gaussian of the same surface: one that exists and does not fill its pixel
/// is to be trained, not doubled.
///
/// # Errors
/// [`RasterError`] if the map cannot be rendered.
pub fn insert_depth_samples(
    context: &Context,
    map: &mut GaussianMap,
    job: &MappingJob,
    camera_from_world: &Se3,
) -> Result<(), RasterError> {
    let (camera, config) = (&context.camera, &context.config.insertion);
    let small = camera.level(CHECK_LEVEL);
    let options = RenderOptions::default();
    let rendered = fast::render(map, &small, camera_from_world, &options, context.par)?;
    let stride = config.stride_px;
    let mask = job.mask.as_ref().filter(|_| config.avoid_moving);
    let (mut pixels, mut places) = (Vec::new(), Vec::new());
    for y in (stride / 2..job.depth.height()).step_by(stride) {
        for x in (stride / 2..job.depth.width()).step_by(stride) {
            let z_m = f64::from(job.depth[(x, y)]);
            let moves = mask.is_some_and(|m| moving_near(m, x, y, stride));
            if !(z_m > 0.0 && z_m <= context.config.features.max_depth_m) || moves {
                continue;
            }
            let Some(uv_px) = camera.undistort_pixel(&Vector2::new(x as f64, y as f64)) else {
                continue;
            };
            if !explained(&rendered, &uv_px, z_m, config) {
                pixels.push((x, y));
                places.push(Place { uv_px, z_m });
            }
        }
    }
    let reach_px = TOO_NEAR * stride as f64;
    let standing = standing_at(context, map, &places, reach_px, camera_from_world);
    let world_from_camera = camera_from_world.inverse();
    for ((pixel, place), standing) in pixels.into_iter().zip(&places).zip(standing) {
        if map.len() >= config.max_gaussians {
            break;
        }
        if standing.is_empty() {
            let p = world_from_camera * camera.unproject(&place.uv_px, place.z_m);
            map.push(&new_gaussian(context, p, place, job.rgb[pixel], None, job));
        }
    }
    Ok(())
}

/// Gives every landmark the keyframe made a Gaussian of its own, tagged with it. If one of the same
/// surface without a tag is within a stride of it, the nearest such takes the tag: landmarks of
/// one place come and go, and the place needs no more Gaussians than it ever had landmarks at a time. Else
/// a new one is made: the landmark's position, the keypoint's colour, the size of a depth sample at that
/// distance.
pub(crate) fn insert_landmarks(
    context: &Context,
    map: &mut GaussianMap,
    job: &MappingJob,
    camera_from_world: &Se3,
) {
    let config = &context.config.insertion;
    let stride_px = config.stride_px as f64;
    let seen = job.new_landmarks.iter().filter_map(|landmark| {
        let p_camera = *camera_from_world * landmark.p_world;
        let uv_px = context.camera.project(&p_camera)?;
        let color = job.rgb.get(landmark.px[0], landmark.px[1])?;
        let z_m = p_camera.z;
        Some((landmark, color, Place { uv_px, z_m }))
    });
    let seen: Vec<_> = seen.collect();
    let places: Vec<_> = seen.iter().map(|(_, _, place)| *place).collect();
    let standing = standing_at(context, map, &places, stride_px, camera_from_world);
    for ((landmark, color, place), standing) in seen.into_iter().zip(standing) {
        let free = standing.into_iter().find(|i| map.landmark[*i].is_none());
        if let Some(free) = free {
            map.landmark[free] = Some(landmark.id);
            continue;
        }
        if map.len() >= config.max_gaussians {
            break;
        }
        let (p, id) = (landmark.p_world, Some(landmark.id));
        map.push(&new_gaussian(context, p, &place, *color, id, job));
    }
}

/// A Gaussian of the size of a depth sample.
fn new_gaussian(
    context: &Context,
    p_world: Vector3<f64>,
    place: &Place,
    color: [u8; 3],
    landmark: Option<LandmarkId>,
    job: &MappingJob,
) -> NewGaussian {
    let config = &context.config.insertion;
    let sigma_m = config.footprint * sample_distance_m(context, place.z_m);
    NewGaussian {
        mean: p_world.map(Real::to_f32).into(),
        sigma_m: sigma_m.to_f32(),
        opacity: config.opacity.to_f32(),
        color: color.map(|v| f32::from(v) / 255.0),
        landmark,
        born: job.keyframe,
    }
}

/// Distance between neighbouring depth samples on a surface at depth z that is parallel to the image
/// plane, stride · z / f, metres.
fn sample_distance_m(context: &Context, z_m: f64) -> f64 {
    let (camera, config) = (&context.camera, &context.config.insertion);
    let focal = 0.5 * (camera.fx + camera.fy);
    config.stride_px as f64 * z_m / focal
}

/// Gives the Gaussians from index `first` on, those inserted for one keyframe, scales that follow from
/// the distances to their neighbours ([`knn_scales_m`]): each other, and the static ones before them.
pub(crate) fn scale_by_neighbours(
    context: &Context,
    map: &mut GaussianMap,
    first: usize,
    camera_from_world: &Se3,
) {
    let place = |i: usize| map.means[i].map(f64::from);
    let standing = (0..first).filter(|&i| map.label[i] == Label::Static);
    let mut places: Vec<[f64; 3]> = standing.map(place).collect();
    let before = places.len();
    places.extend((first..map.len()).map(place));
    let footprint_m = |p_world: &[f64; 3]| {
        let p_camera = *camera_from_world * Vector3::from(*p_world);
        sample_distance_m(context, p_camera.z)
    };
    let footprints_m: Vec<f64> = places[before..].iter().map(footprint_m).collect();
    let scales_m = knn_scales_m(&places, before, &footprints_m);
    for (log_scales, scale_m) in map.log_scales[first..].iter_mut().zip(scales_m) {
        *log_scales = [Real::ln(scale_m.to_f32()); 3];
    }
}

/// Removes the tags of landmarks that were dropped. `living` is in ascending order.
pub(super) fn untag_dropped(map: &mut GaussianMap, living: &[(LandmarkId, Label)]) {
    for tag in &mut map.landmark {
        *tag = tag.filter(|l| living.binary_search_by_key(l, |(id, _)| *id).is_ok());
    }
}

/// A place that a keyframe sees.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Ideal pixel.
    uv_px: Vector2<f64>,
    /// Along z, metres.
    z_m: f64,
}

/// For each place the static Gaussians that project within `reach_px` of it, at a depth that differs by
/// no more than `depth_ratio`: those of its surface. Nearest first, then the older.
fn standing_at(
    context: &Context,
    map: &GaussianMap,
    places: &[Place],
    reach_px: f64,
    camera_from_world: &Se3,
) -> Vec<Vec<usize>> {
    let (camera, config) = (&context.camera, &context.config.insertion);
    let cell = |uv: &Vector2<f64>| (floor(uv.x / reach_px), floor(uv.y / reach_px));
    let mut by_cell: BTreeMap<(i32, i32), Vec<usize>> = BTreeMap::new();
    for (k, place) in places.iter().enumerate() {
        let (x, y) = cell(&place.uv_px);
        for near in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy))) {
            by_cell.entry(near).or_default().push(k);
        }
    }
    let mut found: Vec<Vec<(f64, usize)>> = vec![Vec::new(); places.len()];
    for i in (0..map.len()).filter(|&i| map.label[i] == Label::Static) {
        let p_camera = *camera_from_world * Vector3::from(map.means[i].map(f64::from));
        let Some(uv_px) = camera.project(&p_camera) else {
            continue;
        };
        for &k in by_cell.get(&cell(&uv_px)).into_iter().flatten() {
            let place = &places[k];
            let apart_px = (uv_px - place.uv_px).norm();
            let apart_m = (p_camera.z - place.z_m).abs();
            if apart_px <= reach_px && apart_m <= config.depth_ratio * place.z_m {
                found[k].push((apart_px, i));
            }
        }
    }
    let nearest_first = |mut found: Vec<(f64, usize)>| -> Vec<usize> {
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.into_iter().map(|(_, i)| i).collect()
    };
    found.into_iter().map(nearest_first).collect()
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "float to integer saturates, at half of the range to leave room for neighbours"
)]
fn floor(c: f64) -> i32 {
    c.floor().clamp(-1e9, 1e9) as i32
}

/// Whether the rendered map already shows this surface, or one in front of it.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates"
)]
fn explained(
    rendered: &Rendered<f32>,
    uv: &Vector2<f64>,
    z: f64,
    config: &InsertionConfig,
) -> bool {
    let (width, height) = rendered.opacity.size();
    // The last pixels of a row lie beyond the centre of the small image's last one.
    let at = |c: f64, n: usize| ((c / CHECK_STEP as f64 + 0.5) as usize).min(n.saturating_sub(1));
    let at = (at(uv.x, width), at(uv.y, height));
    let (opacity, depth) = (f64::from(rendered.opacity[at]), rendered.depth[at]);
    opacity >= config.explained_opacity
        && f64::from(depth) / opacity <= z * (1.0 + config.depth_ratio)
}

#[cfg(test)]
mod tests;
