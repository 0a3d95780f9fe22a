//! Properties of single scenes.

use garad_core::Par;
use garad_synth::noise::HALL_RANGE_M;
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};

use crate::support::{corners, scene};

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

/// Six frames from 1.2 s and fifteen from 3 s are black; all else equals `walking`.
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
        assert!(moving > 300, "moving: {moving} pixels");
        assert!(rest(a) == rest(b), "all else of frame {index}");
    }
}

#[test]
fn a_throng_covers_most_of_the_image() {
    let scene = scene(SceneName::Throng, 64);
    let mut shares = Vec::new();
    for i in (0..150).step_by(6) {
        let frame = scene.frame(i, Par::Seq);
        let moving = frame.mask.data().iter().filter(|&&m| m == 255).count();
        let movers = frame.object.data().iter().filter(|&&id| id > 0).count();
        assert_eq!(moving, movers, "all move in frame {i}");
        let nearest = frame.depth.data().iter().fold(9.0, |a: f32, z| a.min(*z));
        assert!(nearest > 0.5, "distance to the camera: {nearest} m");
        shares.push(moving as f64 / (64.0 * 48.0));
    }
    let over_half = shares.iter().filter(|&&s| s > 0.5).count();
    assert!(4 * over_half > 3 * shares.len(), "{shares:?}");
    let within = shares.iter().all(|s| (0.45..0.75).contains(s));
    assert!(within, "half to two thirds: {shares:?}");
}

/// Two people stay in place in the image while the room passes by.
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

/// Few corners of the room have depth, exact or measured, which ends at [`HALL_RANGE_M`]; the person comes from beyond
/// it and leaves the image.
#[test]
fn most_corners_of_the_hall_have_no_depth() {
    let exact = scene(SceneName::Hall, 640);
    let noisy = Scene::new(&SceneConfig {
        noise: true,
        ..exact.config().clone()
    })
    .expect("a good configuration");
    for scene in [&exact.static_twin(), &noisy.static_twin()] {
        for i in [0, 75, 149] {
            let frame = scene.frame(i, Par::Threads(2));
            let depths = || frame.depth.data().iter().map(|&z| f64::from(z));
            let farthest = depths().fold(0.0, f64::max);
            assert!((4.7..=HALL_RANGE_M).contains(&farthest), "{farthest} m");
            let found = corners(&frame.rgb.to_gray());
            let near = found.iter().filter(|&&at| frame.depth[at] > 0.0).count();
            let share = near as f64 / found.len() as f64;
            assert!(found.len() > 600, "frame {i}: {} corners", found.len());
            assert!((0.03..0.2).contains(&share), "frame {i}: {share} near");
        }
    }
    let person = |i: usize| {
        let frame = exact.frame(i, Par::Threads(2));
        let of_person = frame.mask.data().iter().zip(frame.depth.data());
        let depths: Vec<f32> = of_person
            .filter(|(m, _)| **m > 0)
            .map(|(_, z)| *z)
            .collect();
        let measured = depths.iter().filter(|z| **z > 0.0).count();
        (depths.len(), measured)
    };
    let (far, near) = (person(40), person(100));
    assert!(far.0 > 300 && far.1 == 0, "beyond the range: {far:?}");
    assert!(near.0 > 2000 && near.1 == near.0, "within it: {near:?}");
    assert_eq!(person(149).0, 0, "has left the image");
}
