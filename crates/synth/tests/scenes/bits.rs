//! The same bits for any number of threads, on any machine; shared rooms and noise.

use garad_core::Par;
use garad_synth::{Scene, SceneConfig, SceneName};

use crate::support::{all_scenes, pixels, scene};

/// A sibling equals a scene built alone, in the same room or another.
#[test]
fn siblings_equal_scenes_built_alone() {
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

/// Neither threads nor the order of frames change a bit.
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

/// A scene and its twin share the noise of what both see.
#[test]
fn noise_depends_on_the_pixel_alone() {
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

/// The bits themselves: the same in every build and on every machine. If a scene is changed on purpose, the
/// new numbers are in the message of the failure.
#[test]
fn bits_are_those_of_every_other_machine() {
    let hash = |scene: &Scene| {
        let frame = scene.frame(11, Par::Seq);
        let flow = scene.flow(11, 12, Par::Seq);
        let colour = frame.rgb.data().iter().flatten().copied();
        let depth = frame.depth.data().iter().flat_map(|z| z.to_le_bytes());
        let truth = frame.mask.data().iter().chain(frame.object.data()).copied();
        // adding 0 turns -0 into 0, and all NaN count as one
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
        "hall 24a9132a35ec5e91",
    ];
    assert_eq!(hashes, expected, "bits of frame 11 of each scene");
}
