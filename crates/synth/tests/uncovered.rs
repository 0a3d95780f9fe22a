//! How much of the room is hidden in every frame.
//!
//! A map is judged against the twin over all pixels. What is hidden in every frame cannot be in any map and
//! limits that figure.

use garad_core::{Camera, Par};
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};
use nalgebra::Vector2;

/// Step between the frames used.
const STEP: usize = 5;
/// Largest relative difference of two depths of one surface.
const SAME_SURFACE: f64 = 0.05;

/// Whether `frame` sees the point of the room that the twin sees at pixel (u, v).
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "inside the image"
)]
fn uncovers(
    frame: &SynthFrame,
    twin: &SynthFrame,
    camera: &Camera,
    (u, v): (usize, usize),
) -> bool {
    let z = f64::from(twin.depth[(u, v)]);
    let p_cam = camera.unproject(&Vector2::new(u as f64, v as f64), z);
    let p = frame.world_from_camera.inverse() * (twin.world_from_camera * p_cam);
    let Some(uv) = camera.project(&p).filter(|uv| camera.contains(uv)) else {
        return false;
    };
    let at = (uv.x.round() as usize, uv.y.round() as usize);
    let same = frame
        .depth
        .get(at.0, at.1)
        .is_some_and(|seen| (f64::from(*seen) - p.z).abs() < SAME_SURFACE * p.z);
    same && frame.mask[at] == 0
}

/// Share of the pixels of the twin that are hidden in every frame.
fn never_uncovered(base: &Scene, name: SceneName) -> f64 {
    let (scene, camera) = (base.sibling(name), base.camera());
    let twin = scene.static_twin();
    let frames = |of: &Scene| -> Vec<SynthFrame> {
        let indices = (0..scene.config().frames).step_by(STEP);
        indices.map(|i| of.frame(i, Par::Threads(2))).collect()
    };
    let (frames, twins) = (frames(&scene), frames(&twin));
    let (mut covered, mut all) = (0usize, 0usize);
    for shown in &twins {
        let (width, height) = shown.depth.size();
        let pixels = (1..height - 1).flat_map(|v| (1..width - 1).map(move |u| (u, v)));
        for at in pixels.filter(|at| shown.depth[*at] > 0.0) {
            all += 1;
            let seen = frames.iter().any(|f| uncovers(f, shown, &camera, at));
            covered += usize::from(!seen);
        }
    }
    covered as f64 / all as f64
}

#[test]
fn nearly_all_of_the_room_is_seen_except_in_a_huddle() {
    let config = SceneConfig {
        width: 96,
        height: 72,
        supersample: 1,
        ..SceneConfig::new(SceneName::Walking)
    };
    let base = Scene::new(&config).expect("a good configuration");
    for name in [SceneName::Walking, SceneName::InStep, SceneName::Crowd] {
        let share = never_uncovered(&base, name);
        assert!(share < 0.01, "{name}: {share} is never seen");
    }
    // Two people stand in place all the time.
    let share = never_uncovered(&base, SceneName::Huddle);
    assert!((0.08..0.15).contains(&share), "huddle: {share}");
}
