//! Landmarks from two views: points behind keypoints without depth (decision 018).
//!
//! A depth camera sees a few metres; in a hall most corners lie beyond. They say little about where the
//! camera is and much about how it is turned. A new keyframe's free keypoints without depth are searched for in
//! its neighbours, along the images of their rays:
//!
//! ```text
//! keypoint ─→ ray, from the nearest depth to infinity ─→ segment in the neighbour ─→ best descriptor
//!                                                                                       │
//!             landmark ←─ inverse depth known well enough ←─ triangulation (E25) ←──────┘
//! ```
//!
//! A pair becomes a landmark if both reprojection errors pass the gate of eq. 11 and its inverse depth is
//! `min_inverse_depth_sigmas` standard deviations from 0. The landmark keeps its covariance, which widens the σ of a
//! keypoint linked to it ([`link_observation`](crate::tracking::observation::link_observation)): seen along the old
//! rays its depth does not matter, seen from the side it does. Bundle adjustment treats it like any other; once a
//! keyframe observes it with depth it is one.

use garad_core::chi_square::CHI2_2DOF_95;
use garad_core::{KeyframeId, LandmarkId};
use garad_optim::{PointView, TriangulatedPoint, triangulate};
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::context::Context;
use crate::frame::Frame;
use crate::map::landmark::LandmarkDepth;
use crate::map::{Map, by_count};

/// Nearest depth on a keypoint's ray, metres. What is nearer has depth, but for holes.
const NEAREST_M: f64 = 1.0;

/// Longest image of a ray that is searched along: on a longer one too many keypoints look alike.
const MAX_SEGMENT_PX: f64 = 128.0;

/// Makes landmarks of the keyframe's keypoints that have neither landmark nor depth, from pairs with its
/// neighbours.
pub(crate) fn two_view_landmarks(
    context: &Context,
    map: &mut Map,
    id: KeyframeId,
) -> Vec<LandmarkId> {
    let config = &context.config.two_view;
    let mut neighbours = by_count(&map.covisible(id));
    neighbours.truncate(config.neighbours);
    let mut made = Vec::new();
    for neighbour in neighbours {
        let pairs = pairs(context, map.keyframe(id), map.keyframe(neighbour));
        for (i, j, point) in pairs {
            let landmark = map.add_landmark(point.p_world, id, i, &context.scales);
            map.add_observation(landmark, neighbour, j);
            map.refresh(landmark, &context.scales);
            set_covariance(map, landmark, point.covariance);
            made.push(landmark);
        }
    }
    made
}

fn set_covariance(map: &mut Map, id: LandmarkId, covariance: Matrix3<f64>) {
    let landmark = map.landmark_mut(id).expect("a landmark of the map");
    landmark.depth = LandmarkDepth::Triangulated { covariance };
}

/// After an adjustment: what the views of a landmark without depth now say of it. One that they no longer
/// determine is dropped.
pub(crate) fn update_covariance(context: &Context, map: &mut Map, id: LandmarkId) {
    let Some(landmark) = map.landmark(id) else {
        return;
    };
    let LandmarkDepth::Triangulated { .. } = landmark.depth else {
        return;
    };
    let views = landmark.observations.iter();
    let views: Vec<_> = views
        .map(|(k, i)| point_view(map.keyframe(*k), *i))
        .collect();
    let point = TriangulatedPoint::at(landmark.p_world, &context.camera, &views);
    match point.filter(|_| views.len() >= 2) {
        Some(point) => set_covariance(map, id, point.covariance),
        None => map.drop_landmark(id),
    }
}

fn point_view(frame: &Frame, i: usize) -> PointView {
    PointView {
        camera_from_world: frame.camera_from_world,
        uv_px: frame.uv_px[i],
        sigma_px: frame.sigma_px[i],
    }
}

/// Whether a keypoint is to become a landmark without depth.
fn is_free(frame: &Frame, i: usize) -> bool {
    frame.in_use[i] && frame.landmark[i].is_none() && frame.depth_m[i].is_none()
}

/// Keypoints of two keyframes that show one point, and the point. Each keypoint is in one pair at most.
fn pairs(
    context: &Context,
    first: &Frame,
    second: &Frame,
) -> Vec<(usize, usize, TriangulatedPoint)> {
    let mut taken = vec![false; second.len()];
    let mut pairs = Vec::new();
    for i in (0..first.len()).filter(|&i| is_free(first, i)) {
        let Some(j) = search_along_ray(context, first, i, second, &taken) else {
            continue;
        };
        if let Some(point) = point_of_pair(context, (first, i), (second, j)) {
            taken[j] = true;
            pairs.push((i, j, point));
        }
    }
    pairs
}

/// The free keypoint of `second` with the nearest descriptor, near the image of the ray of keypoint `i` of
/// `first`; `None` if it is not near enough, or not nearer than the runner-up.
fn search_along_ray(
    context: &Context,
    first: &Frame,
    i: usize,
    second: &Frame,
    taken: &[bool],
) -> Option<usize> {
    let camera = &context.camera;
    let config = &context.config.two_view;
    let second_from_first = second.camera_from_world * first.camera_from_world.inverse();
    let ray = camera.unproject(&first.uv_px[i], 1.0);
    let far: Vector3<f64> = second_from_first.rotation * ray;
    let near = second_from_first * (ray * NEAREST_M);
    let (far, near) = (camera.project(&far)?, camera.project(&near)?);
    let level = i32::from(first.keypoints[i].level);
    let radius_px = config.radius_px * context.scales[usize::from(first.keypoints[i].level)];
    if (near - far).norm() > MAX_SEGMENT_PX {
        return None;
    }
    let reach_px = 0.5 * (near - far).amax() + radius_px;
    let around = second.near(&(0.5 * (near + far)), reach_px, level - 1, level + 1);
    let mut candidates: Vec<(u32, usize)> = around
        .filter(|&j| !taken[j] && is_free(second, j))
        .filter(|&j| distance_to_segment(&second.uv_px[j], &far, &near) <= radius_px)
        .map(|j| (first.descriptors[i].distance(&second.descriptors[j]), j))
        .collect();
    candidates.sort_unstable();
    let (distance, j) = *candidates.first()?;
    let ratio = context.config.tracking.local_ratio;
    let runner_up = candidates.get(1);
    let ambiguous = runner_up.is_some_and(|(d, _)| f64::from(distance) > ratio * f64::from(*d));
    (distance <= config.match_distance && !ambiguous).then_some(j)
}

fn distance_to_segment(p: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let along = b - a;
    let length_squared = along.norm_squared();
    let t = match length_squared > 0.0 {
        true => ((p - a).dot(&along) / length_squared).clamp(0.0, 1.0),
        false => 0.0,
    };
    (p - (a + along * t)).norm()
}

/// The point behind a pair of keypoints, if it passes the gates.
fn point_of_pair(
    context: &Context,
    (first, i): (&Frame, usize),
    (second, j): (&Frame, usize),
) -> Option<TriangulatedPoint> {
    let views = [point_view(first, i), point_view(second, j)];
    let point = triangulate(&context.camera, &views).expect("poses and keypoints are finite")?;
    let (inverse_depth, sigma) = point.inverse_depth(&first.camera_from_world);
    let known = inverse_depth >= context.config.two_view.min_inverse_depth_sigmas * sigma;
    (known && point.largest_chi2 <= CHI2_2DOF_95).then_some(point)
}

#[cfg(test)]
mod tests;
