//! Scenes, pixels and points.

use garad_core::Camera;
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

/// Every scene, each of the three rooms built once.
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
