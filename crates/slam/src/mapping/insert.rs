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
mod tests {
    use std::collections::BTreeSet;

    use garad_core::{Camera, DepthImage, FrameId, KeyframeId, MaskImage, Par, RgbImage};

    use super::*;
    use crate::config::Config;
    use crate::mapping::job::NewLandmark;

    fn wall(z: f32) -> (RgbImage, DepthImage) {
        (
            RgbImage::new(64, 48, [200, 100, 50]),
            DepthImage::new(64, 48, z),
        )
    }

    fn context() -> Context {
        context_of(Config::default())
    }

    fn context_of(config: Config) -> Context {
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        Context::new(camera, config, 0, Par::Seq).expect("valid")
    }

    /// A keyframe in front of a wall.
    fn job(keyframe: u32, z: f32, mask: Option<MaskImage>) -> MappingJob {
        let (rgb, depth) = wall(z);
        MappingJob {
            keyframe: KeyframeId(keyframe),
            frame: FrameId(0),
            rgb,
            depth,
            mask,
            cells: None,
            labels: Vec::new(),
            cues: Vec::new(),
            restored: BTreeSet::new(),
            poses: Vec::new(),
            moved: Vec::new(),
            new_landmarks: Vec::new(),
            living: Vec::new(),
            iterations: 0,
        }
    }

    /// Inserts depth samples; returns how many.
    fn seed(map: &mut GaussianMap, z: f32, mask: Option<&MaskImage>) -> usize {
        let before = map.len();
        let job = job(0, z, mask.cloned());
        insert_depth_samples(&context(), map, &job, &Se3::identity()).expect("rendered");
        map.len() - before
    }

    #[test]
    fn a_wall_gets_its_gaussians_once() {
        let mut map = GaussianMap::new(0);
        assert_eq!(seed(&mut map, 2.0, None), 16 * 12, "one per 4 x 4 pixels");
        map.validate().expect("finite");
        assert!(
            (map.means[0][2] - 2.0).abs() < 1e-6,
            "at the measured depth"
        );
        let again = seed(&mut map, 2.0, None);
        assert_eq!(again, 0, "all of it is explained, up to the rim");
    }

    #[test]
    fn a_landmark_brings_its_own_gaussian() {
        let mut map = GaussianMap::new(0);
        let landmark = |px| NewLandmark {
            id: LandmarkId(7),
            p_world: Vector3::new(0.1, 0.0, 3.0),
            px,
        };
        let job = MappingJob {
            rgb: RgbImage::from_fn(64, 48, |x, _| [u8::try_from(x).expect("small"), 0, 255]),
            new_landmarks: vec![landmark([51, 20]), landmark([64, 20])],
            ..job(1, 3.0, None)
        };
        insert_landmarks(&context(), &mut map, &job, &Se3::identity());
        assert_eq!(map.len(), 1, "one lies outside the image");
        assert_eq!(map.landmark, [Some(LandmarkId(7))], "tagged with it");
        let color = garad_core::sh::color(0, map.sh_of(0), [0.0, 0.0, 1.0]);
        assert!((color[0] - 0.2).abs() < 1e-6, "51 of 255: {color:?}");
    }

    #[test]
    fn a_surface_in_front_is_new_and_one_behind_is_hidden() {
        let mut map = GaussianMap::new(0);
        seed(&mut map, 2.0, None);
        let mut behind = map.clone();
        assert_eq!(seed(&mut map, 1.0, None), 16 * 12, "nearer than the map");
        assert!(
            seed(&mut behind, 3.0, None) < 16 * 12 / 4,
            "hidden by the map"
        );
    }

    /// The samples of a wall at 2 m are 0.133 m apart.
    #[test]
    fn on_a_wall_the_scale_is_the_distance_between_samples() {
        let (context, pose, spacing_m) = (context(), Se3::identity(), 4.0 * 2.0 / 60.0f32);
        let mut map = GaussianMap::new(0);
        seed(&mut map, 2.0, None);
        let n = map.len();
        let footprint = map.log_scales.clone();
        scale_by_neighbours(&context, &mut map, 0, &pose);
        let inside = map.log_scales[17].map(Real::exp);
        assert!((inside[0] - spacing_m).abs() < 1e-6, "{inside:?}");
        assert!(footprint[17] < map.log_scales[17], "0.6 of that");
        // A second wall in front: its nearest neighbours are its own, and what stood stays as it is.
        let before = map.log_scales.clone();
        seed(&mut map, 1.0, None);
        scale_by_neighbours(&context, &mut map, n, &pose);
        assert_eq!(map.log_scales[..n], before, "those before");
        let inside = map.log_scales[n + 17].map(Real::exp);
        assert!((inside[0] - 0.5 * spacing_m).abs() < 1e-6, "{inside:?}");
    }

    #[test]
    fn neighbours_of_a_new_gaussian_are_static_ones() {
        let (context, pose) = (context(), Se3::identity());
        let scale = |label: Label| {
            let mut map = GaussianMap::new(0);
            let at = |x: f64| landmark(0, [x, 0.0, 2.0]);
            tag(&mut map, &[at(-0.15), at(0.15), at(0.3)]);
            map.label = vec![label; map.len()];
            let first = map.len();
            tag(&mut map, &[at(0.0)]);
            scale_by_neighbours(&context, &mut map, first, &pose);
            Real::exp(map.log_scales[first][0])
        };
        let expected = ((2.0 * 0.15 * 0.15 + 0.3 * 0.3) / 3.0f32).sqrt();
        assert!((scale(Label::Static) - expected).abs() < 1e-6, "three");
        let two_footprints = 2.0 * 4.0 * 2.0 / 60.0;
        assert!(
            (scale(Label::Dynamic) - two_footprints).abs() < 1e-6,
            "none"
        );
    }

    fn landmark(id: u32, p_world: [f64; 3]) -> NewLandmark {
        NewLandmark {
            id: LandmarkId(id),
            p_world: p_world.into(),
            px: [32, 24],
        }
    }

    /// The landmarks are at z = 2 m, where the stride of 4 px is 0.133 m.
    fn tag(map: &mut GaussianMap, landmarks: &[NewLandmark]) -> usize {
        let before = map.len();
        let job = MappingJob {
            new_landmarks: landmarks.to_vec(),
            ..job(5, 2.0, None)
        };
        insert_landmarks(&context(), map, &job, &Se3::identity());
        map.len() - before
    }

    fn tags(map: &GaussianMap) -> Vec<Option<u32>> {
        map.landmark.iter().map(|l| l.map(|l| l.0)).collect()
    }

    #[test]
    fn a_landmark_takes_the_nearest_gaussian_of_its_place_that_has_none() {
        let mut map = GaussianMap::new(0);
        let places = [[0.0, 0.0, 2.0], [0.05, 0.0, 2.0]];
        let first = [landmark(0, places[0]), landmark(1, places[1])];
        assert_eq!(tag(&mut map, &first), 2, "an empty map: each gets its own");
        let second = [landmark(2, [0.04, 0.0, 2.0])];
        assert_eq!(tag(&mut map, &second), 1, "both in reach are tagged");
        untag_dropped(&mut map, &[(LandmarkId(0), Label::Static)]);
        assert_eq!(tags(&map), [Some(0), None, None], "one lives");
        let third = [
            landmark(3, [0.048, 0.0, 2.0]),
            landmark(4, [0.048, 0.0, 2.0]),
        ];
        assert_eq!(tag(&mut map, &third), 0, "two are free");
        assert_eq!(tags(&map), [Some(0), Some(3), Some(4)], "the nearer first");
    }

    #[test]
    fn gaussians_far_behind_or_dynamic_are_not_of_the_place() {
        let alone = |p: [f64; 3]| -> usize {
            let mut map = GaussianMap::new(0);
            tag(&mut map, &[landmark(0, p)]);
            untag_dropped(&mut map, &[]);
            tag(&mut map, &[landmark(1, [0.0, 0.0, 2.0])])
        };
        assert_eq!(alone([0.13, 0.0, 2.0]), 0, "3.9 px beside it");
        assert_eq!(alone([0.137, 0.0, 2.0]), 1, "4.1 px beside it");
        assert_eq!(alone([0.0, 0.0, 2.09]), 0, "4.5 % behind it");
        assert_eq!(alone([0.0, 0.0, 2.11]), 1, "5.5 % behind it");
        assert_eq!(alone([0.0, 0.0, 1.89]), 1, "5.5 % before it");
        let mut map = GaussianMap::new(0);
        tag(&mut map, &[landmark(0, [0.0, 0.0, 2.0])]);
        untag_dropped(&mut map, &[]);
        map.label[0] = Label::Dynamic;
        assert_eq!(tag(&mut map, &[landmark(1, [0.0, 0.0, 2.0])]), 1, "moves");
    }

    #[test]
    fn a_sample_beside_a_gaussian_of_its_surface_makes_none() {
        // Fainter than what explains a pixel, so that every pixel is open.
        let faint = |z: f32| {
            let mut map = GaussianMap::new(0);
            seed(&mut map, 2.0, None);
            map.opacity_logits.fill(-3.0);
            seed(&mut map, z, None)
        };
        assert_eq!(faint(2.0), 0, "each has one already");
        assert_eq!(faint(1.8), 16 * 12, "another surface, 10 % nearer");
    }

    #[test]
    fn moving_and_missing_pixels_make_nothing() {
        let mut map = GaussianMap::new(0);
        let mask = MaskImage::from_fn(64, 48, |x, _| if x < 32 { 255 } else { 0 });
        let count = seed(&mut map, 2.0, Some(&mask));
        assert_eq!(
            count,
            7 * 12,
            "right half, one stride away from the moving part"
        );
        assert_eq!(seed(&mut map, f32::NAN, None), 0, "no depth");

        let mut config = Config::default();
        config.insertion.avoid_moving = false;
        let (mut map, job) = (GaussianMap::new(0), job(0, 2.0, Some(mask)));
        let inserted = insert_depth_samples(&context_of(config), &mut map, &job, &Se3::identity());
        inserted.expect("rendered");
        assert_eq!(map.len(), 16 * 12, "the mask is not asked");
    }
}
