//! New Gaussians: one for each new landmark, and a keyframe's depth where the map does not yet
//! explain the picture.

use garad_core::{
    Camera, DepthImage, GaussianMap, KeyframeId, MaskImage, NewGaussian, Par, RgbImage, Se3,
};
use garad_raster::{RenderOptions, Rendered, fast};
use nalgebra::Vector2;

use super::NewLandmark;
use crate::config::SeedConfig;
use crate::mask::moving_near;

/// The picture a keyframe was made from.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// Colour.
    pub rgb: &'a RgbImage,
    /// Metres; 0 and NaN are missing.
    pub depth: &'a DepthImage,
    /// 255 where something moves.
    pub mask: Option<&'a MaskImage>,
}

/// Halvings of the picture the map is drawn at to see what it already explains.
const CHECK_LEVEL: usize = 2;
const CHECK_STEP: usize = 1 << CHECK_LEVEL;

/// Adds a Gaussian for every `stride_px`-th pixel with depth that the map, drawn from the same
/// pose, leaves open: little opacity, or a surface behind the measured one. Returns how many.
///
/// Standard deviation: `footprint` times the distance between neighbouring samples,
/// stride · z / f. Pixels that move, and those within one stride of them, make no Gaussian.
pub fn seed_from_depth(
    map: &mut GaussianMap,
    picture: &Picture<'_>,
    camera: &Camera,
    camera_from_world: &Se3,
    born: KeyframeId,
    config: &SeedConfig,
    max_depth_m: f64,
    par: Par,
) -> usize {
    let small = camera.level(CHECK_LEVEL);
    let drawn = fast::render(
        map,
        &small,
        camera_from_world,
        &RenderOptions::default(),
        par,
    )
    .ok();
    let world_from_camera = camera_from_world.inverse();
    let focal = 0.5 * (camera.fx + camera.fy);
    let stride = config.stride_px;
    let before = map.len();
    for y in (stride / 2..picture.depth.height()).step_by(stride) {
        for x in (stride / 2..picture.depth.width()).step_by(stride) {
            if map.len() >= config.max_gaussians {
                return map.len() - before;
            }
            let z = f64::from(picture.depth[(x, y)]);
            let moves = picture.mask.is_some_and(|m| moving_near(m, x, y, stride));
            if !(z > 0.0 && z <= max_depth_m) || moves {
                continue;
            }
            let Some(uv) = camera.undistort_pixel(&Vector2::new(x as f64, y as f64)) else {
                continue;
            };
            if drawn.as_ref().is_some_and(|d| explained(d, &uv, z, config)) {
                continue;
            }
            let p = world_from_camera * camera.unproject(&uv, z);
            map.push(&NewGaussian {
                mean: [p.x, p.y, p.z].map(to_f32),
                sigma_m: to_f32(config.footprint * stride as f64 * z / focal),
                opacity: to_f32(config.opacity),
                color: picture.rgb[(x, y)].map(|v| f32::from(v) / 255.0),
                landmark: None,
                born,
            });
        }
    }
    map.len() - before
}

/// Adds a Gaussian for every landmark the keyframe made, tagged with it: the landmark's place, the
/// keypoint's colour, the size of a depth sample at that distance.
pub fn insert_landmarks(
    map: &mut GaussianMap,
    landmarks: &[NewLandmark],
    rgb: &RgbImage,
    camera: &Camera,
    camera_from_world: &Se3,
    born: KeyframeId,
    config: &SeedConfig,
) {
    let focal = 0.5 * (camera.fx + camera.fy);
    for landmark in landmarks {
        let z = (*camera_from_world * landmark.p_world).z;
        let Some(color) = rgb.get(landmark.px[0], landmark.px[1]) else {
            continue;
        };
        if map.len() >= config.max_gaussians {
            return;
        }
        if z > 0.0 {
            let p = landmark.p_world;
            map.push(&NewGaussian {
                mean: [p.x, p.y, p.z].map(to_f32),
                sigma_m: to_f32(config.footprint * config.stride_px as f64 * z / focal),
                opacity: to_f32(config.opacity),
                color: color.map(|v| f32::from(v) / 255.0),
                landmark: Some(landmark.id),
                born,
            });
        }
    }
}

/// Does the drawn map already show this surface (or one in front of it)?
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; `get` refuses what lies outside"
)]
fn explained(drawn: &Rendered<f32>, uv: &Vector2<f64>, z: f64, config: &SeedConfig) -> bool {
    let at = |c: f64| (c / CHECK_STEP as f64 + 0.5) as usize;
    let (x, y) = (at(uv.x), at(uv.y));
    let (Some(&opacity), Some(&depth)) = (drawn.opacity.get(x, y), drawn.depth.get(x, y)) else {
        return false;
    };
    let opacity = f64::from(opacity);
    opacity >= config.explained_opacity
        && f64::from(depth) / opacity <= z * (1.0 + config.depth_ratio)
}

#[allow(clippy::cast_possible_truncation, reason = "the map is f32 by design")]
fn to_f32(v: f64) -> f32 {
    v as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(z: f32) -> (RgbImage, DepthImage) {
        (
            RgbImage::new(64, 48, [200, 100, 50]),
            DepthImage::new(64, 48, z),
        )
    }

    fn seed(map: &mut GaussianMap, z: f32, mask: Option<&MaskImage>) -> usize {
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        let (rgb, depth) = wall(z);
        let picture = Picture {
            rgb: &rgb,
            depth: &depth,
            mask,
        };
        seed_from_depth(
            map,
            &picture,
            &camera,
            &Se3::identity(),
            KeyframeId(0),
            &SeedConfig::default(),
            8.0,
            Par::Seq,
        )
    }

    #[test]
    fn a_wall_is_seeded_once() {
        let mut map = GaussianMap::new(0);
        assert_eq!(seed(&mut map, 2.0, None), 16 * 12, "one per 4 x 4 pixels");
        map.validate().expect("finite");
        assert!(
            (map.means[0][2] - 2.0).abs() < 1e-6,
            "at the measured depth"
        );
        let again = seed(&mut map, 2.0, None);
        assert!(again < 16 * 12 / 4, "only the rim is left open: {again}");
    }

    #[test]
    fn a_landmark_brings_its_own_gaussian() {
        let mut map = GaussianMap::new(0);
        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        let rgb = RgbImage::from_fn(64, 48, |x, _| [u8::try_from(x).expect("small"), 0, 255]);
        let landmark = |px| NewLandmark {
            id: garad_core::LandmarkId(7),
            p_world: nalgebra::Vector3::new(0.1, 0.0, 3.0),
            px,
        };
        let config = SeedConfig::default();
        let landmarks = [landmark([51, 20]), landmark([64, 20])];
        insert_landmarks(
            &mut map,
            &landmarks,
            &rgb,
            &camera,
            &Se3::identity(),
            KeyframeId(1),
            &config,
        );
        assert_eq!(map.len(), 1, "one lies beside the picture");
        assert_eq!(
            map.landmark,
            [Some(garad_core::LandmarkId(7))],
            "tagged with it"
        );
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
    }
}
