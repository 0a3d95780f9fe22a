use garad_core::{DepthImage, GrayImage, KeyframeId, Label, MaskImage, RgbImage, Rng};
use garad_features::LkPyramid;

use super::*;
use crate::io::{FrameInput, LabelledFrame, TrackingState};
use crate::keyframing::loop_closing::LoopClosure;
use crate::observer::Silent;

fn slam() -> Slam {
    let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
    Slam::new(camera, Config::default(), 3, Par::Seq).expect("valid")
}

#[test]
fn the_field_that_differs_is_named() {
    let mut slam = slam();
    let (camera, config) = (slam.context.camera, slam.context.config.clone());
    slam.resume_with(&camera, &config, 3).expect("the same");
    let mut lens = camera;
    lens.distortion.k2 = 0.25;
    let mut few = config.clone();
    few.features.count = 500;
    let mut untrained = config.clone();
    untrained.train.per_keyframe = 0;
    for (camera, config, seed, expected) in [
        (
            lens,
            &config,
            3,
            "camera.distortion.k2: the session has 0.0, this run 0.25",
        ),
        (
            camera,
            &few,
            3,
            "configuration.features.count: the session has 1000, this run 500",
        ),
        (camera, &config, 4, "seed: the session has 3, this run 4"),
        (camera, &untrained, 3, "configuration.train.per_keyframe"),
    ] {
        let error = slam
            .resume_with(&camera, config, seed)
            .expect_err("refused");
        assert!(error.to_string().starts_with(expected), "{error}");
    }
}

#[test]
fn final_iterations_may_differ_while_images_are_kept() {
    let mut slam = slam();
    let mut config = slam.context.config.clone();
    config.train.final_iterations = 77;
    slam.resume_with(&slam.context.camera.clone(), &config, 3)
        .expect("allowed");
    assert_eq!(slam.context.config.train.final_iterations, 77, "taken over");
    let mut mute = slam.context.config.clone();
    (
        mute.train.per_keyframe,
        mute.train.per_frame,
        mute.train.final_iterations,
    ) = (0, 0, 0);
    slam.context.config = mute.clone();
    mute.train.final_iterations = 77;
    let error = slam
        .resume_with(&slam.context.camera.clone(), &mute, 3)
        .expect_err("no image was kept to train on");
    assert!(
        error.to_string().contains("train.final_iterations"),
        "{error}"
    );
}

#[test]
fn a_pyramid_is_rebuilt_from_its_image() {
    let image = GrayImage::from_fn(70, 60, |x, y| [3, 250, 0, 99, 128][(x * x + 3 * y) % 5]);
    for above in [0, 1] {
        let pyramid = LkPyramid::new(&image, above).expect("an image");
        let bytes = postcard::to_stdvec(&pyramid).expect("a form");
        let again: LkPyramid = postcard::from_bytes(&bytes).expect("a pyramid");
        assert_eq!(again.levels(), above + 1, "levels");
        assert_eq!(
            format!("{again:?}"),
            format!("{pyramid:?}"),
            "every pixel, borders too"
        );
    }
}

#[test]
fn an_image_without_all_its_pixels_is_refused() {
    let bytes =
        |pixels: usize| postcard::to_stdvec(&(3usize, 2usize, vec![7u8; pixels])).expect("a form");
    let image: GrayImage = postcard::from_bytes(&bytes(6)).expect("six pixels");
    assert_eq!(image, GrayImage::new(3, 2, 7), "3 x 2");
    for pixels in [0, 5, 7] {
        let image: Result<GrayImage, _> = postcard::from_bytes(&bytes(pixels));
        assert!(image.is_err(), "{pixels} pixels");
    }
}

/// Nine frames of a wall that moves by 2 px from each to the next, every second one a keyframe.
fn moving() -> Slam {
    let mut rng = Rng::new(11);
    let blots = GrayImage::from_fn(60, 41, |_, _| {
        40 + u8::try_from(rng.below(170)).expect("u8")
    });
    let camera = Camera::pinhole((160, 120), [120.0, 115.0, 79.5, 59.5]).expect("valid");
    let mut config = Config::default();
    config.features.count = 300;
    (config.keyframes.min_gap, config.keyframes.max_gap) = (1, 2);
    config.schedule.handover_frames = 3;
    (config.train.per_keyframe, config.train.per_frame) = (1, 0);
    let mut slam = Slam::new(camera, config, 3, Par::Seq).expect("valid");
    for k in 0..9 {
        let rgb = RgbImage::from_fn(160, 120, |x, y| {
            let g = blots[((x + 2 * k) / 3, y / 3)];
            [g, 255 - g, g / 2]
        });
        let t_s = 0.1 * k as f64;
        let input = FrameInput {
            t_s,
            depth_t_s: t_s,
            rgb: &rgb,
            depth: &DepthImage::new(160, 120, 3.0),
            mask: None,
        };
        slam.process(&input, &mut Silent).expect("valid frame");
    }
    slam
}

/// Every owner's state, field by field, also of fields that a session does not hold.
fn state(slam: &Slam) -> Vec<(&'static str, String)> {
    let Slam {
        context,
        extractor: _, // holds the last image, to be overwritten
        straight,
        tracker,
        dynamics,
        map,
        keyframing,
        mapping,
        places,
        images,
        trajectory,
        labelled,
        replayed,
        next_frame,
        localising,
        recorder,
    } = slam;
    vec![
        ("context", format!("{context:?}")),
        ("straight", format!("{straight:?}")),
        ("tracker", format!("{tracker:?}")),
        ("dynamics", format!("{dynamics:?}")),
        ("map", format!("{map:?}")),
        ("keyframing", format!("{keyframing:?}")),
        ("mapping", format!("{mapping:?}")),
        ("mapper", format!("{:?}", mapping.mapper())),
        ("places", format!("{places:?}")),
        ("images", format!("{images:?}")),
        ("trajectory", format!("{trajectory:?}")),
        ("labelled", format!("{labelled:?}")),
        ("replayed", format!("{replayed:?}")),
        ("next_frame", format!("{next_frame:?}")),
        ("localising", format!("{localising:?}")),
        ("recorder", format!("{recorder:?}")),
    ]
}

#[test]
fn every_field_of_every_owner_survives() {
    let mut slam = moving();
    assert!(
        slam.map.keyframes().len() > 2 && !slam.trajectory().is_empty(),
        "it tracks"
    );
    assert!(slam.images.keyframes().next().is_some(), "images are kept");
    assert!(
        !slam.keyframing.recent.is_empty(),
        "landmarks are to be confirmed"
    );
    // What such a run does not come to.
    slam.keyframing.loops.push(LoopClosure {
        keyframe: KeyframeId(2),
        older: KeyframeId(1),
        inliers: 43,
        drift_m: 0.25,
    });
    slam.keyframing.most_inliers = 123;
    slam.labelled = Some(LabelledFrame {
        frame: FrameId(8),
        keypoints: vec![([3.5, 4.25], Label::Dynamic)],
        cells: MaskImage::from_fn(40, 30, |x, y| if x == y { 255 } else { 0 }),
    });
    slam.localising = true;
    let mut bytes = Vec::new();
    slam.save(&mut bytes).expect("saved");
    let loaded = Slam::load(&mut &bytes[..], Par::Seq).expect("loaded");
    for ((owner, saved), (_, loaded)) in state(&slam).iter().zip(state(&loaded)) {
        let at = saved.bytes().zip(loaded.bytes()).position(|(a, b)| a != b);
        let near = |s: &str| -> String {
            s.chars()
                .skip(at.unwrap_or(0).saturating_sub(80))
                .take(160)
                .collect()
        };
        assert!(
            *saved == loaded,
            "{owner}: saved {}, loaded {}",
            near(saved),
            near(&loaded)
        );
    }
}

/// The map, its places and images, and where the camera was last stay; all that belongs to a recording begins
/// anew.
#[test]
fn in_a_finished_map_everything_else_begins_anew() {
    let mut slam = moving();
    slam.finish().expect("alive");
    let kept = [
        "context",
        "straight",
        "map",
        "keyframing",
        "mapper",
        "places",
        "images",
    ];
    let of = |slam: &Slam| {
        state(slam)
            .into_iter()
            .filter(|(owner, _)| kept.contains(owner))
            .collect::<Vec<_>>()
    };
    let (before, reference) = (of(&slam), slam.tracker.reference());
    assert!(reference.0 > 0 && !slam.mapped().is_empty() && slam.next_frame.0 == 9);
    slam.localise_only().expect("alive");
    assert!(of(&slam) == before, "the map as it is");
    assert_eq!(slam.tracker.state(), TrackingState::Lost);
    assert_eq!(slam.tracker.reference(), reference);
    assert!(
        slam.tracker.last().is_none() && slam.labelled.is_none(),
        "no frame yet"
    );
    assert!(
        slam.trajectory().is_empty() && slam.mapped().is_empty(),
        "a new path"
    );
    assert_eq!(
        (slam.next_frame, slam.localising, slam.may_restart()),
        (FrameId(0), true, false)
    );
}

#[test]
fn an_empty_run_is_saved_too() {
    let mut bytes = Vec::new();
    slam().save(&mut bytes).expect("saved");
    let mut again = Vec::new();
    let mut loaded = Slam::load(&mut &bytes[..], Par::Threads(2)).expect("loaded");
    loaded.save(&mut again).expect("saved");
    assert!(bytes == again, "the same bits");
}
