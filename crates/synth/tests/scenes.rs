//! What a scene promises, checked from outside: geometry against poses and depth alone, colours
//! against geometry, movers against the twin, bits against threads.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates inside a picture"
)]

use garad_core::{Camera, Image, Par, Se3};
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};
use nalgebra::{Vector2, Vector3};

fn scene(name: SceneName, width: usize) -> Scene {
    let config = SceneConfig {
        width,
        height: width * 3 / 4,
        ..SceneConfig::new(name)
    };
    Scene::new(&config).expect("a good configuration")
}

/// Every scene, each of the three rooms built once.
fn all_scenes(config: &SceneConfig) -> Vec<Scene> {
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

/// In the same room or another, a sibling is what it would be alone.
#[test]
fn siblings_are_scenes_of_their_own() {
    let quiet = scene(SceneName::QuietDesk, 48);
    let lit = quiet.frame(0, Par::Seq);
    for name in [SceneName::Loop, SceneName::Throng] {
        let (sibling, alone) = (quiet.sibling(name), scene(name, 48));
        assert_eq!(sibling.config(), alone.config(), "{name}");
        let frames = [&sibling, &alone].map(|s| s.frame(7, Par::Seq));
        assert!(frames[0] == frames[1] && frames[0] != lit, "{name}");
        let twins = [sibling, alone].map(|s| s.static_twin().frame(7, Par::Seq));
        assert!(twins[0] == twins[1], "{name}: twins");
        let of_twin = quiet.static_twin().sibling(name);
        assert!(of_twin.frame(7, Par::Seq) == twins[0], "{name}: of a twin");
    }
}

fn pixels(size: (usize, usize), border: usize) -> impl Iterator<Item = (usize, usize)> {
    (border..size.1 - border).flat_map(move |y| (border..size.0 - border).map(move |x| (x, y)))
}

/// The point that a pixel sees, in the world.
fn world_point(camera: &Camera, frame: &SynthFrame, (x, y): (usize, usize)) -> Vector3<f64> {
    let uv = Vector2::new(x as f64, y as f64);
    frame.world_from_camera * camera.unproject(&uv, f64::from(frame.depth[(x, y)]))
}

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

/// A static point of one frame, carried by the poses into another, has the depth seen there, or
/// something stands before it; and it has the colour seen there.
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

/// Flow of static pixels is what poses and depth say; flow of movers leads to the same mover, and
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
                // the same surface close by moves alike, other parts of the mover need not
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
        assert!(
            away * 4 > moving,
            "{name}: {away} of {moving} moved by themselves"
        );
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

/// Depth differs from the twin's on the movers' pixels and nowhere else; colour besides only at
/// their outlines, where corners of pixels are shared.
#[test]
fn a_scene_and_its_twin_differ_where_a_mover_is() {
    let scene = scene(SceneName::Walking, 200);
    let (with, without) = (
        scene.frame(45, Par::Seq),
        scene.static_twin().frame(45, Par::Seq),
    );
    assert_eq!(
        with.world_from_camera, without.world_from_camera,
        "same path"
    );
    let covered = with.object.data().iter().filter(|&&id| id > 0).count();
    assert!(covered > 3000, "{covered} pixels of movers");
    let near_mover = |x: usize, y: usize| {
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        around.into_iter().any(|(dx, dy)| {
            let at = x.checked_add_signed(dx).zip(y.checked_add_signed(dy));
            at.and_then(|(x, y)| with.object.get(x, y))
                .is_some_and(|&id| id > 0)
        })
    };
    let mut recoloured = 0;
    for at in pixels(with.rgb.size(), 0) {
        let nearer = with.depth[at] < without.depth[at];
        assert_eq!(nearer, with.object[at] > 0, "depth at {at:?}");
        assert_eq!(
            with.mask[at] == 255,
            with.object[at] > 0,
            "both people walk, at {at:?}"
        );
        if with.rgb[at] != without.rgb[at] {
            assert!(near_mover(at.0, at.1), "colour at {at:?}");
            recoloured += 1;
        }
    }
    assert!(
        recoloured * 10 > covered * 9,
        "{recoloured} of {covered} look different"
    );
    assert!(
        without.mask.data().iter().all(|&m| m == 0),
        "nothing moves in the twin"
    );
}

/// The trolley stands until 1.2 s, rolls until 3.4 s, stands again; the mask remembers 10 frames.
#[test]
fn the_mask_follows_stop_and_go() {
    let scene = scene(SceneName::StopAndGo, 96);
    let trolley = |index: usize| {
        let frame = scene.frame(index, Par::Seq);
        let of_trolley = |(&id, &m): (&u8, &u8)| (id == 1).then_some(m);
        let values: Vec<u8> = frame
            .object
            .data()
            .iter()
            .zip(frame.mask.data())
            .filter_map(of_trolley)
            .collect();
        assert!(values.len() > 100, "frame {index}: {} pixels", values.len());
        assert!(
            values.iter().all(|v| *v == values[0]),
            "one mover, one state"
        );
        values[0]
    };
    assert_eq!(trolley(0), 0, "has not started");
    assert_eq!(trolley(35), 0, "still has not");
    assert_eq!(trolley(45), 255, "rolls");
    assert_eq!(trolley(108), 255, "stopped at frame 102, remembered");
    assert_eq!(trolley(118), 0, "forgotten");
}

/// Values of the mask on one mover; all of them are alike.
fn state_of(frame: &SynthFrame, object: u8) -> u8 {
    let pairs = frame.object.data().iter().zip(frame.mask.data());
    let of_mover = pairs.filter(|(id, _)| **id == object);
    let values: Vec<u8> = of_mover.map(|(_, m)| *m).collect();
    assert!(
        values.len() > 100,
        "mover {object}: {} pixels",
        values.len()
    );
    assert!(
        values.iter().all(|v| *v == values[0]),
        "one mover, one state"
    );
    values[0]
}

fn nothing_moves(frame: &SynthFrame) -> bool {
    frame.mask.data().iter().all(|&m| m == 0)
}

/// The trolley stops at 1.5 s (frame 45), the person at 2 s (60); ten frames later each belongs to
/// the room, for good.
#[test]
fn what_comes_to_rest_becomes_part_of_the_room() {
    let scene = scene(SceneName::ComesToRest, 96);
    let states = |index: usize| {
        let frame = scene.frame(index, Par::Seq);
        [1, 2].map(|object| state_of(&frame, object))
    };
    for index in [0, 20, 45, 52] {
        assert_eq!(states(index), [255, 255], "both move, frame {index}");
    }
    assert_eq!(states(56), [0, 255], "the trolley is at rest");
    assert_eq!(states(67), [0, 255], "the person's last step is remembered");
    for index in [72, 100, 149, 400] {
        assert_eq!(states(index), [0, 0], "for good, frame {index}");
    }
    // At rest to the last digit: their flow is what poses and depth say.
    let (frame, flow) = (scene.frame(100, Par::Seq), scene.flow(100, 149, Par::Seq));
    let camera = scene.camera();
    let to_149 = scene.world_from_camera(149).inverse();
    let mut still = 0;
    for at in pixels(frame.depth.size(), 0) {
        let [du, dv] = flow[at].map(f64::from);
        if frame.object[at] > 0 && !du.is_nan() {
            let p = to_149 * world_point(&camera, &frame, at);
            let expected = camera.project(&p).expect("before the camera");
            let uv = Vector2::new(at.0 as f64 + du, at.1 as f64 + dv);
            assert!((uv - expected).norm() < 2e-4, "{at:?}: {uv} {expected}");
            still += 1;
        }
    }
    assert!(still > 200, "{still} pixels of movers seen in both");
}

/// Nothing moves until 1.5 s (frame 45); then the chair does, and from 2.2 s (66) the person.
#[test]
fn what_sets_off_was_part_of_the_room() {
    let scene = scene(SceneName::SetsOff, 96);
    let first = scene.frame(0, Par::Seq);
    for index in [0, 10, 30, 45] {
        let frame = scene.frame(index, Par::Seq);
        assert!(nothing_moves(&frame), "frame {index}");
        assert_eq!([1, 2].map(|k| state_of(&frame, k)), [0, 0], "but is there");
    }
    let states = |index: usize| [1, 2].map(|k| state_of(&scene.frame(index, Par::Seq), k));
    assert_eq!(states(50), [255, 0], "the chair sets off");
    assert_eq!(states(66), [255, 0], "the person has not");
    for index in [71, 100, 149] {
        assert_eq!(states(index), [255, 255], "both, frame {index}");
    }
    // Before they start, the movers are the room's: their flow is what poses and depth say.
    let flow = scene.flow(0, 45, Par::Seq);
    let to_45 = scene.world_from_camera(45).inverse();
    let camera = scene.camera();
    for at in pixels(first.depth.size(), 0) {
        let [du, dv] = flow[at].map(f64::from);
        if !du.is_nan() {
            let p = to_45 * world_point(&camera, &first, at);
            let expected = camera.project(&p).expect("before the camera");
            let uv = Vector2::new(at.0 as f64 + du, at.1 as f64 + dv);
            assert!((uv - expected).norm() < 2e-4, "{at:?}: {uv} {expected}");
        }
    }
}

/// The background has what stands, lacks what moves, and is the frame itself elsewhere.
#[test]
fn the_background_is_what_does_not_move() {
    let scene = scene(SceneName::ComesToRest, 96);
    for (index, movers) in [(20, 2), (60, 1), (100, 0)] {
        let frame = scene.frame(index, Par::Seq);
        let background = scene.background(index, Par::Seq);
        assert!(nothing_moves(&background), "frame {index}");
        let mut moving = [false; 3];
        for at in pixels(frame.depth.size(), 0) {
            if frame.mask[at] == 255 {
                moving[usize::from(frame.object[at])] = true;
                assert!(background.depth[at] > frame.depth[at], "{at:?} behind");
            } else {
                let same = background.depth[at].to_bits() == frame.depth[at].to_bits();
                assert!(same, "{at:?} of frame {index}");
                assert_eq!(background.object[at], frame.object[at], "{at:?}");
            }
        }
        let seen = moving.iter().filter(|m| **m).count();
        assert_eq!(seen, movers, "movers in frame {index}");
        if movers == 0 {
            assert_eq!(background, frame, "the whole frame");
        }
    }
}

#[test]
fn a_tripod_stands_and_people_walk() {
    let scene = scene(SceneName::Tripod, 96);
    let first = scene.world_from_camera(0);
    for index in 0..scene.len() {
        assert_eq!(scene.world_from_camera(index), first, "frame {index}");
    }
    let (frame, flow) = (scene.frame(40, Par::Seq), scene.flow(40, 43, Par::Seq));
    let (mut room, mut fastest) = (0, 0.0f32);
    for (&[du, dv], &id) in flow.data().iter().zip(frame.object.data()) {
        if id == 0 && !du.is_nan() {
            assert!(du.abs().max(dv.abs()) < 1e-4, "the room has no flow");
            room += 1;
        } else if id > 0 && !du.is_nan() {
            fastest = fastest.max(du.abs());
        }
    }
    assert!(room > 5000 && fastest > 1.0, "{room} px, {fastest} px");
}

/// Six frames from 1.2 s and fifteen from 3 s are black; all else is as in `walking`.
#[test]
fn lights_go_out_and_nothing_else_changes() {
    let (dim, lit) = (
        scene(SceneName::LightsOut, 96),
        scene(SceneName::Walking, 96),
    );
    let dark: Vec<usize> = (0..150).filter(|&i| dim.brightness(i) < 1.0).collect();
    assert_eq!(dark, (36..42).chain(90..105).collect::<Vec<_>>(), "dark");
    assert!((0..150).all(|i| lit.brightness(i) >= 1.0), "always lit");
    for (index, is_dark) in [
        (35, false),
        (36, true),
        (41, true),
        (42, false),
        (104, true),
    ] {
        let (a, b) = (dim.frame(index, Par::Seq), lit.frame(index, Par::Seq));
        let brightest = a.rgb.data().iter().flatten().max().copied();
        assert_eq!(
            brightest < Some(16),
            is_dark,
            "frame {index}: {brightest:?}"
        );
        assert_eq!(a.rgb == b.rgb, !is_dark, "colour of frame {index}");
        let rest = |f: SynthFrame| (f.depth, f.mask, f.object, f.world_from_camera);
        let moving = a.mask.data().iter().filter(|&&m| m == 255).count();
        assert!(moving > 300, "someone walks: {moving} pixels");
        assert!(rest(a) == rest(b), "all else of frame {index}");
    }
}

#[test]
fn a_throng_is_most_of_the_picture() {
    let scene = scene(SceneName::Throng, 64);
    let mut shares = Vec::new();
    for i in (0..150).step_by(6) {
        let frame = scene.frame(i, Par::Seq);
        let moving = frame.mask.data().iter().filter(|&&m| m == 255).count();
        let movers = frame.object.data().iter().filter(|&&id| id > 0).count();
        assert_eq!(moving, movers, "nobody stands in frame {i}");
        let nearest = frame.depth.data().iter().fold(9.0, |a: f32, z| a.min(*z));
        assert!(nearest > 0.5, "nobody steps into the camera: {nearest} m");
        shares.push(moving as f64 / (64.0 * 48.0));
    }
    let over_half = shares.iter().filter(|&&s| s > 0.5).count();
    assert!(4 * over_half > 3 * shares.len(), "{shares:?}");
    let within = shares.iter().all(|s| (0.45..0.75).contains(s));
    assert!(within, "half to two thirds: {shares:?}");
}

/// Two people keep their place in the picture while the room goes by.
#[test]
fn in_step_is_slower_on_people_than_on_the_room() {
    let scene = scene(SceneName::InStep, 160);
    let (mut people, mut room) = (Vec::new(), Vec::new());
    for i in [0, 10, 20] {
        let frame = scene.frame(i, Par::Seq);
        let flow = scene.flow(i, i + 3, Par::Seq);
        for (f, &id) in flow.data().iter().zip(frame.object.data()) {
            let along_x = f64::from(f[0].abs());
            if along_x.is_finite() {
                if id > 0 {
                    people.push(along_x)
                } else {
                    room.push(along_x)
                }
            }
        }
    }
    let median = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    let (people, room) = (median(&mut people), median(&mut room));
    assert!(people < 0.75 * room, "people {people} px, room {room} px");
}

#[test]
fn crowd_covers_much_and_never_all() {
    for name in [SceneName::Crowd, SceneName::Huddle] {
        let scene = scene(name, 64);
        let (mut least, mut most) = (1.0f64, 0.0f64);
        for i in (0..150).step_by(10) {
            let object = scene.frame(i, Par::Seq).object;
            let share = object.data().iter().filter(|&&id| id > 0).count() as f64 / (64.0 * 48.0);
            (least, most) = (least.min(share), most.max(share));
        }
        assert!(least > 0.25, "{name}: at least {least}");
        assert!((0.5..0.75).contains(&most), "{name}: at most {most}");
    }
}

/// Threads, and the order in which frames are asked for, change no bit.
#[test]
fn same_bits_for_any_number_of_threads() {
    let config = SceneConfig {
        width: 80,
        height: 60,
        noise: true,
        ..SceneConfig::new(SceneName::Crowd)
    };
    let make = |par: Par| {
        let scene = Scene::new(&config).expect("a good configuration");
        let other = (par != Par::Seq).then(|| scene.frame(3, par));
        let frame = scene.frame(17, par);
        let flow = scene.flow(17, 18, par).map(|f| f.map(f32::to_bits));
        let depth = frame.depth.map(|z| z.to_bits());
        let pose = frame.world_from_camera;
        drop(other);
        (frame.rgb, depth, frame.mask, frame.object, pose, flow)
    };
    let expected = make(Par::Seq);
    for threads in [2, 3] {
        assert!(make(Par::Threads(threads)) == expected, "{threads} threads");
    }
}

/// The twin shares the noise of what both see.
#[test]
fn noise_is_of_the_pixel_and_not_of_the_scene() {
    let config = SceneConfig {
        width: 120,
        height: 90,
        noise: true,
        ..SceneConfig::new(SceneName::Walking)
    };
    let scene = Scene::new(&config).expect("a good configuration");
    let twin = scene.static_twin();
    let (with, without) = (scene.frame(45, Par::Seq), twin.frame(45, Par::Seq));
    let exact = Scene::new(&SceneConfig {
        noise: false,
        ..config
    })
    .expect("a good configuration")
    .frame(45, Par::Seq);
    let (mut equal, mut noisy) = (0, 0);
    for at in pixels(with.rgb.size(), 0) {
        if with.object[at] == 0 && exact.depth[at] < 6.0 {
            equal += usize::from(with.rgb[at] == without.rgb[at]);
            noisy += usize::from(with.rgb[at] != exact.rgb[at]);
        }
    }
    assert!(equal > 8000, "{equal} pixels as in the twin");
    assert!(noisy * 10 > equal * 9, "{noisy} of {equal} have noise");
    let missing = with.depth.data().iter().filter(|&&z| z <= 0.0).count();
    assert!(
        (100..3000).contains(&missing),
        "{missing} pixels without depth"
    );
}

/// Something to hold on to in every quarter of the picture: pixels whose grey differs by more than
/// 20 from that of at least two pixels three to the side, one of them across (a corner's arms).
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
            let frame = scene.frame(i, Par::Seq);
            let image = frame.rgb.to_gray();
            let mut corners = [0usize; 4];
            for (x, y) in pixels(image.size(), 3) {
                let c = i32::from(image[(x, y)]);
                let far = |dx: isize, dy: isize| {
                    let at = |a: usize, d: isize| a.checked_add_signed(d).expect("inside");
                    i32::from(image[(at(x, dx), at(y, dy))]) - c
                };
                let (l, r, u, d) = (far(-3, 0), far(3, 0), far(0, -3), far(0, 3));
                let diagonal = [far(-2, -2), far(2, -2), far(-2, 2), far(2, 2)];
                let ring = [
                    l,
                    r,
                    u,
                    d,
                    diagonal[0],
                    diagonal[1],
                    diagonal[2],
                    diagonal[3],
                ];
                let brighter = ring.iter().filter(|&&v| v > 20).count();
                let darker = ring.iter().filter(|&&v| v < -20).count();
                if brighter.max(darker) >= 5 {
                    corners[usize::from(x >= 120) + 2 * usize::from(y >= 90)] += 1;
                }
            }
            let least = corners.iter().min().copied().unwrap_or(0);
            assert!(
                least > 60,
                "{name} frame {i}: {corners:?} corner pixels in the quarters"
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

/// The bits themselves: the same in every build and on every machine. When a scene is changed on
/// purpose, the new numbers come from the failure's message.
#[test]
fn bits_are_those_of_every_other_machine() {
    let hash = |scene: &Scene| {
        let frame = scene.frame(11, Par::Seq);
        let flow = scene.flow(11, 12, Par::Seq);
        let colour = frame.rgb.data().iter().flatten().copied();
        let depth = frame.depth.data().iter().flat_map(|z| z.to_le_bytes());
        let truth = frame.mask.data().iter().chain(frame.object.data()).copied();
        // adding 0 makes -0 into 0, and one NaN stands for all
        let numbers = flow
            .data()
            .iter()
            .flatten()
            .map(|f| if f.is_nan() { 1e9 } else { f + 0.0 });
        let flow = numbers.flat_map(f32::to_le_bytes);
        let bytes = colour.chain(depth).chain(truth).chain(flow);
        // FNV-1a
        bytes.fold(0xCBF2_9CE4_8422_2325u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01B3)
        })
    };
    let scenes = all_scenes(&SceneConfig {
        width: 48,
        height: 36,
        noise: true,
        ..SceneConfig::default()
    });
    let named = |scene: &Scene| format!("{} {:016x}", scene.config().name, hash(scene));
    let hashes: Vec<String> = scenes.iter().map(named).collect();
    let expected = [
        "quiet_desk 81aab33718972fe2",
        "walking e533a47ee4867120",
        "crowd a9b4c327b8926281",
        "stop_and_go afb173b70056d048",
        "in_step 823db3950d006552",
        "loop 6317fc369b01820f",
        "comes_to_rest d2d212738d936f04",
        "sets_off 5ea89b2de9e81310",
        "tripod 7b49102bd61082b7",
        "lights_out e533a47ee4867120",
        "throng 01aaddf8fb848401",
        "huddle 931e6dc3bb794a94",
    ];
    assert_eq!(hashes, expected, "bits of frame 11 of each scene");
}
