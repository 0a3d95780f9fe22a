//! Static points, flow, texture and time.

use garad_core::{Image, Par, Se3};
use garad_synth::{Scene, SceneConfig, SceneName};
use nalgebra::Vector2;

use crate::support::{all_scenes, corners, pixels, scene, world_point};

/// Value at a place between pixels, from a function of the four around it.
fn bilinear(uv: &Vector2<f64>, value: impl Fn(usize, usize) -> f64) -> f64 {
    let (x, y) = (uv.x.floor(), uv.y.floor());
    let (i, j, a, b) = (x as usize, y as usize, uv.x - x, uv.y - y);
    (value(i, j) * (1.0 - a) + value(i + 1, j) * a) * (1.0 - b)
        + (value(i, j + 1) * (1.0 - a) + value(i + 1, j + 1) * a) * b
}

/// Inverse depth is affine in the pixel on a plane: its second differences vanish there.
fn is_plane(depth: &Image<f32>, uv: &Vector2<f64>) -> bool {
    let (x, y) = (uv.x as usize, uv.y as usize);
    let inverse = |x: usize, y: usize| 1.0 / f64::from(depth[(x, y)]);
    let bend = |a: f64, b: f64, c: f64| (a - 2.0 * b + c).abs() < 3e-7;
    (x - 1..=x + 2).all(|x| bend(inverse(x, y - 1), inverse(x, y), inverse(x, y + 1)))
        && (y - 1..=y + 1).all(|y| bend(inverse(x - 1, y), inverse(x, y), inverse(x + 1, y)))
        && (y - 1..=y + 1).all(|y| bend(inverse(x, y), inverse(x + 1, y), inverse(x + 2, y)))
        && (x..=x + 1).all(|x| bend(inverse(x, y), inverse(x, y + 1), inverse(x, y + 2)))
}

fn grey([r, g, b]: [u8; 3]) -> f64 {
    0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b)
}

/// A static point of one frame, transformed by the poses into another, has the depth and colour seen there,
/// or is hidden.
#[test]
fn static_points_are_where_poses_and_depth_say() {
    for name in [SceneName::Walking, SceneName::QuietDesk] {
        let scene = scene(name, 240).static_twin();
        let camera = scene.camera();
        let (a, b) = (scene.frame(20, Par::Seq), scene.frame(26, Par::Seq));
        let b_from_world = b.world_from_camera.inverse();
        let (mut agree, mut hidden, mut wrong) = (0, 0, 0);
        let mut differences = Vec::new();
        for at in pixels(a.depth.size(), 4) {
            let p = b_from_world * world_point(&camera, &a, at);
            let Some(uv) = camera.project(&p) else {
                continue;
            };
            let inside = (2.0..236.0).contains(&uv.x) && (2.0..176.0).contains(&uv.y);
            if !inside || !is_plane(&b.depth, &uv) {
                continue;
            }
            let seen = 1.0 / bilinear(&uv, |x, y| 1.0 / f64::from(b.depth[(x, y)]));
            if (seen - p.z).abs() < 1e-4 {
                agree += 1;
                let colour = bilinear(&uv, |x, y| grey(b.rgb[(x, y)]));
                differences.push((colour - grey(a.rgb[at])).abs());
            } else if seen < p.z - 1e-3 {
                hidden += 1;
            } else {
                wrong += 1;
            }
        }
        assert!(agree > 12_000, "{name}: only {agree} points on planes");
        assert_eq!(wrong, 0, "{name}: points behind what is seen");
        assert!(hidden * 10 < agree, "{name}: {hidden} hidden, {agree} seen");
        differences.sort_by(f64::total_cmp);
        let median = differences[differences.len() / 2];
        assert!(
            median < 3.0,
            "{name}: median difference {median} grey levels"
        );
    }
}

/// Flow of static pixels follows from poses and depth; flow of moving objects leads to the same object, and
/// back again.
#[test]
fn flow_is_exact() {
    for name in [SceneName::Walking, SceneName::StopAndGo] {
        let scene = scene(name, 200);
        let camera = scene.camera();
        let (i, j) = (60, 63);
        let (a, b) = (scene.frame(i, Par::Seq), scene.frame(j, Par::Seq));
        let there = scene.flow(i, j, Par::Seq);
        let back = scene.flow(j, i, Par::Seq);
        let b_from_world: Se3 = b.world_from_camera.inverse();
        let (mut still, mut moving, mut same, mut away) = (0, 0, 0, 0);
        for at in pixels(a.depth.size(), 0) {
            let [du, dv] = there[at].map(f64::from);
            if du.is_nan() {
                continue;
            }
            let uv = Vector2::new(at.0 as f64 + du, at.1 as f64 + dv);
            let expected = camera.project(&(b_from_world * world_point(&camera, &a, at)));
            let expected = expected.expect("before the camera");
            if a.object[at] == 0 {
                still += 1;
                assert!(
                    (uv - expected).norm() < 2e-4,
                    "{name} at {at:?}: {uv} {expected}"
                );
                continue;
            }
            moving += 1;
            away += usize::from((uv - expected).norm() > 0.5);
            let pixel = (uv.x.round() as usize, uv.y.round() as usize);
            if b.object.get(pixel.0, pixel.1) == Some(&a.object[at]) {
                let [bu, bv] = back[pixel].map(f64::from);
                // neighbouring points of the same part move alike, other parts need not
                same += usize::from((bu + du).abs() < 0.5 && (bv + dv).abs() < 0.5);
            }
        }
        assert!(
            still > 15_000 && moving > 1000,
            "{name}: {still} still, {moving} moving"
        );
        assert!(
            same * 10 > moving * 8,
            "{name}: {same} of {moving} lead back"
        );
        assert!(away * 4 > moving, "{name}: {away} of {moving} moved");
    }
}

#[test]
fn flow_to_the_same_frame_is_zero_everywhere() {
    let flow = scene(SceneName::Crowd, 96).flow(7, 7, Par::Seq);
    let worst = flow
        .data()
        .iter()
        .flatten()
        .fold(0.0f32, |m, f| if f.abs() <= m { m } else { f.abs() });
    assert!(worst < 1e-4, "{worst} px");
}

#[test]
fn every_quarter_has_corners() {
    let config = SceneConfig {
        width: 240,
        height: 180,
        supersample: 1,
        ..SceneConfig::default()
    };
    for scene in all_scenes(&config) {
        let name = scene.config().name;
        for i in [0, 75] {
            let mut quarters = [0usize; 4];
            for (x, y) in corners(&scene.frame(i, Par::Seq).rgb.to_gray()) {
                quarters[usize::from(x >= 120) + 2 * usize::from(y >= 90)] += 1;
            }
            let least = quarters.iter().min().copied().unwrap_or(0);
            assert!(
                least > 60,
                "{name} frame {i}: {quarters:?} corner pixels in the quarters"
            );
        }
    }
}

#[test]
fn motion_is_a_function_of_time() {
    let slow = scene(SceneName::Loop, 64);
    let fast = Scene::new(&SceneConfig {
        fps: 60.0,
        ..slow.config().clone()
    })
    .expect("good");
    assert_eq!(
        slow.world_from_camera(15),
        fast.world_from_camera(30),
        "half a second"
    );
    let times: Vec<f64> = slow.trajectory().iter().map(|p| p.t_s).collect();
    assert_eq!(times.len(), slow.len(), "one pose a frame");
    assert!(times.windows(2).all(|w| w[0] < w[1]), "ascending");
}
