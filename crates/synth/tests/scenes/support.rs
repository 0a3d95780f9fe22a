//! Scenes, pixels and points.

use garad_core::{Camera, Image};
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};
use nalgebra::{Vector2, Vector3};

pub(crate) fn scene(name: SceneName, width: usize) -> Scene {
    let config = SceneConfig {
        width,
        height: width * 3 / 4,
        ..SceneConfig::new(name)
    };
    Scene::new(&config).expect("a good configuration")
}

/// Every scene, each variant of the room built once.
pub(crate) fn all_scenes(config: &SceneConfig) -> Vec<Scene> {
    let rooms = [SceneName::QuietDesk, SceneName::Walking, SceneName::Crowd].map(|name| {
        Scene::new(&SceneConfig {
            name,
            ..config.clone()
        })
        .expect("a good configuration")
    });
    let sibling = |name: SceneName| match name {
        SceneName::QuietDesk | SceneName::Loop => rooms[0].sibling(name),
        SceneName::Crowd | SceneName::Throng | SceneName::Huddle => rooms[2].sibling(name),
        _ => rooms[1].sibling(name),
    };
    SceneName::all().map(sibling).to_vec()
}

pub(crate) fn pixels(size: (usize, usize), border: usize) -> impl Iterator<Item = (usize, usize)> {
    (border..size.1 - border).flat_map(move |y| (border..size.0 - border).map(move |x| (x, y)))
}

/// The point seen by a pixel, in the world.
pub(crate) fn world_point(
    camera: &Camera,
    frame: &SynthFrame,
    (x, y): (usize, usize),
) -> Vector3<f64> {
    let uv = Vector2::new(x as f64, y as f64);
    frame.world_from_camera * camera.unproject(&uv, f64::from(frame.depth[(x, y)]))
}

/// Pixels whose grey differs by more than 20 from that of at least five of eight pixels around.
pub(crate) fn corners(image: &Image<u8>) -> Vec<(usize, usize)> {
    const RING: [(isize, isize); 8] = [
        (-3, 0),
        (3, 0),
        (0, -3),
        (0, 3),
        (-2, -2),
        (2, -2),
        (-2, 2),
        (2, 2),
    ];
    let is_corner = |&(x, y): &(usize, usize)| {
        let ring = RING.map(|(dx, dy)| {
            let at = |a: usize, d: isize| a.checked_add_signed(d).expect("inside");
            i32::from(image[(at(x, dx), at(y, dy))]) - i32::from(image[(x, y)])
        });
        let count = |far: fn(i32) -> bool| ring.iter().filter(|&&d| far(d)).count();
        count(|d| d > 20).max(count(|d| d < -20)) >= 5
    };
    pixels(image.size(), 3).filter(is_corner).collect()
}
