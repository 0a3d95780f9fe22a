//! Insertion by hand: walls, landmarks, and a camera with unequal focal lengths.

use std::collections::BTreeSet;

use garad_core::{Camera, DepthImage, FrameId, KeyframeId, MaskImage, Par, RgbImage, So3};

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

/// Focal lengths of 50 and 70 px, mean 60; one sample in six pixels; a quarter turn about the optical axis.
#[test]
fn a_new_gaussian_is_where_its_pixel_is_and_as_large_as_its_sample() {
    let camera = Camera::pinhole((64, 48), [50.0, 70.0, 31.5, 23.5]).expect("valid");
    let mut config = Config::default();
    config.insertion.stride_px = 6;
    config.insertion.footprint = 0.75;
    config.insertion.opacity = 0.8;
    let context = Context::new(camera, config, 0, Par::Seq).expect("valid");
    let quarter = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
    let pose = Se3::new(quarter, Vector3::new(0.1, 0.2, -0.3));
    let job = MappingJob {
        rgb: RgbImage::from_fn(64, 48, |x, y| {
            [x, 2 * y, x + y].map(|v| u8::try_from(v).expect("small"))
        }),
        ..job(9, 3.0, None)
    };
    let mut map = GaussianMap::new(0);
    insert_depth_samples(&context, &mut map, &job, &pose).expect("rendered");
    assert_eq!(map.len(), 11 * 8, "from pixel (3, 3) on");
    // (-28.5/50, -20.5/70, 1) 3 m less the translation, turned back: (x, y) to (y, -x).
    let expected = [-61.5 / 70.0 - 0.2, 1.71 + 0.1, 3.3];
    for (got, expected) in map.means[0].map(f64::from).iter().zip(expected) {
        assert!((got - expected).abs() < 1e-6, "{:?}", map.means[0]);
    }
    let sigma = map.log_scales[0].map(Real::exp);
    assert!(
        sigma.iter().all(|s| (s - 0.225).abs() < 1e-6),
        "0.75 x 6 x 3/60: {sigma:?}"
    );
    let opacity = 1.0 / (1.0 + Real::exp(-map.opacity_logits[0]));
    assert!((opacity - 0.8).abs() < 1e-6, "{opacity}");
    for (i, expected) in [
        (0, [3.0, 6.0, 6.0]),
        (1, [9.0, 6.0, 12.0]),
        (11, [3.0, 18.0, 12.0]),
    ] {
        let color = garad_core::sh::color(0, map.sh_of(i), [0.0, 0.0, 1.0]);
        let apart = color
            .iter()
            .zip(expected)
            .map(|(c, e): (&f32, f32)| (255.0 * c - e).abs());
        assert!(apart.fold(0.0, f32::max) < 1e-3, "of its pixel: {color:?}");
    }
    assert_eq!(
        (map.born[0], map.landmark[0], map.label[0]),
        (KeyframeId(9), None, Label::Static)
    );
}

#[test]
fn samples_have_a_depth_up_to_the_largest_that_is_trusted() {
    let mut config = Config::default();
    config.features.max_depth_m = 5.0;
    let depths = [5.0, 5.001, f32::NAN, -1.0, 1.0, 0.0, f32::INFINITY];
    let job = MappingJob {
        depth: DepthImage::from_fn(64, 48, |x, _| *depths.get(x / 4).unwrap_or(&0.0)),
        ..job(0, 0.0, None)
    };
    let mut map = GaussianMap::new(0);
    insert_depth_samples(&context_of(config), &mut map, &job, &Se3::identity()).expect("rendered");
    let depths: Vec<_> = map.means.iter().map(|mean| mean[2].round()).collect();
    assert_eq!(depths, [5.0, 1.0].repeat(12), "row by row");
}

/// One Gaussian beside the sample of pixel (30, 22), too faint to explain a pixel.
#[test]
fn a_sample_keeps_half_a_stride_from_the_gaussians_of_its_surface() {
    for (beside_px, z_m, label, makes) in [
        ([1.3, 1.3], 2.0, Label::Static, false), // 1.84 px
        ([-1.5, 1.5], 2.0, Label::Static, true), // 2.12 px
        ([1.9, 0.0], 2.0, Label::Static, false),
        ([0.0, -1.9], 2.0, Label::Static, false),
        ([0.3, 0.0], 2.09, Label::Static, false), // 4.5 % behind
        ([0.3, 0.0], 2.11, Label::Static, true),
        ([0.3, 0.0], 1.91, Label::Static, false),
        ([0.3, 0.0], 1.89, Label::Static, true),
        ([0.3, 0.0], 2.0, Label::Dynamic, true),
    ] {
        let mut map = GaussianMap::new(0);
        let [x, y] = [
            (30.0 - 31.5 + beside_px[0]) / 60.0,
            (22.0 - 23.5 + beside_px[1]) / 60.0,
        ];
        tag(&mut map, &[landmark(0, [x * z_m, y * z_m, z_m])]);
        map.opacity_logits[0] = -5.0;
        map.label[0] = label;
        let samples = seed(&mut map, 2.0, None);
        assert_eq!(
            samples,
            16 * 12 - usize::from(!makes),
            "{beside_px:?} at {z_m} m, {label:?}"
        );
    }
}

/// Pixel (1, 2) of the small image: opacity 1/2, expected depth 2.5 m.
#[test]
fn a_pixel_is_explained_by_enough_opacity_not_far_behind_it() {
    let small = |value: f32| {
        garad_core::Image::from_fn(4, 3, |x, y| if (x, y) == (1, 2) { value } else { 0.0 })
    };
    let rendered = Rendered {
        color: garad_core::Image::new(4, 3, [0.0; 3]),
        depth: small(1.25),
        opacity: small(0.5),
        transmittance: garad_core::Image::new(4, 3, 1.0),
        contributors: garad_core::Image::new(4, 3, 0),
        last: garad_core::Image::new(4, 3, 0),
        radii: Vec::new(),
        projected: Vec::new(),
    };
    for (uv_px, z_m, explained_opacity, expected) in [
        ([4.0, 8.0], 2.0, 0.5, true), // as opaque, and 25 % behind, as allowed
        ([4.0, 8.0], 2.0, 0.51, false),
        ([4.0, 8.0], 1.99, 0.5, false),
        ([4.0, 8.0], 9.0, 0.5, true), // far in front
        ([2.0, 6.0], 2.0, 0.5, true), // the corners of its pixel
        ([5.9, 11.9], 2.0, 0.5, true),
        ([1.9, 8.0], 2.0, 0.5, false),
        ([6.0, 8.0], 2.0, 0.5, false),
        ([4.0, 5.9], 2.0, 0.5, false),
    ] {
        let config = InsertionConfig {
            explained_opacity,
            depth_ratio: 0.25,
            ..InsertionConfig::default()
        };
        let found = explained(&rendered, &Vector2::from(uv_px), z_m, &config);
        assert_eq!(found, expected, "{uv_px:?}, {z_m} m, {explained_opacity}");
    }
}

#[test]
fn there_are_never_more_gaussians_than_configured() {
    for most in [0, 1, 5] {
        let mut config = Config::default();
        config.insertion.max_gaussians = most;
        let context = context_of(config);
        let apart = (0..7).map(|i| landmark(i, [0.3 * f64::from(i) - 0.9, 0.0, 2.0]));
        let job = MappingJob {
            new_landmarks: apart.collect(),
            ..job(0, 2.0, None)
        };
        let mut map = GaussianMap::new(0);
        insert_landmarks(&context, &mut map, &job, &Se3::identity());
        assert_eq!(map.len(), most, "landmarks");
        let mut map = GaussianMap::new(0);
        insert_depth_samples(&context, &mut map, &job, &Se3::identity()).expect("rendered");
        assert_eq!(map.len(), most, "samples");
    }
}

/// The camera stands 1 m behind the origin: 2 m are 3 m from it.
#[test]
fn the_gaussian_of_a_landmark_is_at_the_landmark_with_the_size_of_its_distance() {
    let mut map = GaussianMap::new(0);
    let pose = Se3::new(So3::identity(), Vector3::new(0.0, 0.0, 1.0));
    let job = MappingJob {
        new_landmarks: vec![landmark(3, [0.2, -0.1, 2.0]), landmark(4, [0.0, 0.0, -1.5])],
        ..job(6, 3.0, None)
    };
    insert_landmarks(&context(), &mut map, &job, &pose);
    assert_eq!(
        map.means,
        [[0.2, -0.1, 2.0]],
        "the other is behind the camera"
    );
    assert_eq!(
        (map.born[0], map.landmark[0]),
        (KeyframeId(6), Some(LandmarkId(3)))
    );
    let sigma = Real::exp(map.log_scales[0][0]);
    assert!((sigma - 0.6 * 4.0 * 3.0 / 60.0).abs() < 1e-6, "{sigma}");
    scale_by_neighbours(&context(), &mut map, 0, &pose);
    let sigma = Real::exp(map.log_scales[0][0]);
    assert!(
        (sigma - 2.0 * 4.0 * 3.0 / 60.0).abs() < 1e-6,
        "alone: {sigma}"
    );
}
