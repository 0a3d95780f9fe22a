//! What holds for every image.

mod common;

use common::{camera, map, pose};
use garad_core::{
    Camera, CameraError, GaussianMap, Image, KeyframeId, NewGaussian, Par, Rng, Se3, So3,
};
use garad_raster::{Include, RasterError, RenderOptions, Rendered, render};
use nalgebra::Vector3;
use proptest::prelude::*;

fn draw(map: &GaussianMap<f64>, options: &RenderOptions, par: Par) -> Rendered<f64> {
    render(map, &camera(), &pose(), options, par).expect("an image")
}

fn plain(map: &GaussianMap<f64>) -> Rendered<f64> {
    draw(map, &RenderOptions::default(), Par::Seq)
}

/// Same bits in every image; `last` counts positions in tile lists and is left out.
fn assert_same(a: &Rendered<f64>, b: &Rendered<f64>, what: &str) {
    assert!(a.color == b.color, "{what}: color");
    assert!(a.depth == b.depth, "{what}: depth");
    assert!(a.opacity == b.opacity, "{what}: opacity");
    assert!(a.transmittance == b.transmittance, "{what}: transmittance");
    assert!(a.contributors == b.contributors, "{what}: contributors");
}

/// The map with its rows in another order.
fn select(map: &GaussianMap<f64>, rows: &[usize]) -> GaussianMap<f64> {
    let mut out = GaussianMap::new(map.sh_degree());
    for &i in rows {
        out.means.push(map.means[i]);
        out.log_scales.push(map.log_scales[i]);
        out.quaternions.push(map.quaternions[i]);
        out.opacity_logits.push(map.opacity_logits[i]);
        out.sh.extend_from_slice(map.sh_of(i));
        out.landmark.push(map.landmark[i]);
        out.parent.push(map.parent[i]);
        out.born.push(map.born[i]);
        out.label.push(map.label[i]);
    }
    out
}

/// One round Gaussian.
fn ball(mean: [f64; 3], sigma_m: f64, opacity: f64, color: [f64; 3]) -> NewGaussian<f64> {
    NewGaussian {
        mean,
        sigma_m,
        opacity,
        color,
        landmark: None,
        born: KeyframeId(0),
    }
}

/// A camera at the world's origin whose axis goes through the centre of pixel (8, 8).
fn small() -> Camera {
    Camera::pinhole((17, 17), [20.0, 20.0, 8.0, 8.0]).expect("valid")
}

fn draw_small(map: &GaussianMap<f64>) -> Rendered<f64> {
    render(
        map,
        &small(),
        &Se3::default(),
        &RenderOptions::default(),
        Par::Seq,
    )
    .expect("an image")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn rows_may_stand_in_any_order(seed in 0u64..1_000_000) {
        let map = map(seed, 60);
        let mut rows: Vec<usize> = (0..60).collect();
        let mut rng = Rng::new(seed);
        for i in (1..60).rev() {
            rows.swap(i, rng.below(i + 1));
        }
        let (a, b) = (plain(&map), plain(&select(&map, &rows)));
        assert_same(&a, &b, "permuted");
        for (i, &row) in rows.iter().enumerate() {
            prop_assert_eq!(a.radii[row], b.radii[i], "radius of row {}", row);
        }
    }

    #[test]
    fn tiles_and_threads_change_nothing(seed in 0u64..1_000_000) {
        let map = map(seed, 60);
        let reference = plain(&map);
        for tile_px in [1, 5, 8, 32, 8_192] {
            let options = RenderOptions { tile_px, ..RenderOptions::default() };
            assert_same(&reference, &draw(&map, &options, Par::Seq), "tile size");
        }
        for threads in [2, 3] {
            let other = draw(&map, &RenderOptions::default(), Par::new(threads));
            prop_assert!(reference == other, "{} threads", threads);
        }
    }

    /// C(b) = C(0) + T b, to the bit.
    #[test]
    fn background_is_added_once(seed in 0u64..1_000_000, b in proptest::array::uniform3(-2.0f64..2.0)) {
        let map = map(seed, 60);
        let black = plain(&map);
        let lit = draw(&map, &RenderOptions { background: b, ..RenderOptions::default() }, Par::Seq);
        let expected = Image::from_fn(70, 50, |x, y| {
            [0, 1, 2].map(|k| black.color[(x, y)][k] + black.transmittance[(x, y)] * b[k])
        });
        prop_assert!(lit.color == expected, "colour");
        prop_assert!(lit.depth == black.depth, "depth has no background");
    }

    /// White splats before white: every weight counts once, and so does the rest of the light.
    #[test]
    fn weights_and_transmittance_add_to_one(seed in 0u64..1_000_000) {
        let mut map = map(seed, 60);
        map.sh.fill([0.0; 3]);
        for i in 0..60 {
            map.sh[4 * i] = [garad_core::sh::dc_from_color(1.0); 3];
        }
        let white = RenderOptions { background: [1.0; 3], ..RenderOptions::default() };
        let image = draw(&map, &white, Par::Seq);
        image.validate().expect("consistent");
        for v in image.color.data().iter().flatten() {
            prop_assert!((v - 1.0).abs() < 1e-13, "{v}");
        }
    }

    /// World and camera moved together: the same image.
    #[test]
    fn the_image_does_not_depend_on_the_world_frame(
        seed in 0u64..1_000_000, xi in proptest::array::uniform6(-1.0f64..1.0),
    ) {
        let mut map = map(seed, 60);
        for i in 0..60 {
            map.sh[4 * i + 1..4 * i + 4].fill([0.0; 3]);
        }
        let before = plain(&map);
        let new_from_old = Se3::exp(&xi.into());
        for i in 0..60 {
            let mean = new_from_old * Vector3::from(map.means[i]);
            map.means[i] = [mean.x, mean.y, mean.z];
            let [w, x, y, z] = map.quaternions[i];
            let turned = new_from_old.rotation * So3::from_quaternion(w, x, y, z).expect("not zero");
            map.quaternions[i] = turned.quaternion();
        }
        let camera_from_new = pose() * new_from_old.inverse();
        let after = render(&map, &camera(), &camera_from_new, &RenderOptions::default(), Par::Seq)
            .expect("an image");
        let mut moved = 0;
        for (a, b) in before.color.data().iter().flatten().zip(after.color.data().iter().flatten()) {
            moved += usize::from((a - b).abs() > 1e-10);
        }
        // A splat exactly at a cut may fall to the other side: not more than one in a scene.
        prop_assert!(moved <= 3, "{moved} channels moved");
    }

    /// A principal point one footprint cell further: the image one cell further. Fails where
    /// cx or cy is dropped, or put in twice.
    #[test]
    fn principal_point_moves_the_image(seed in 0u64..1_000_000) {
        // In front of the middle, so that the smaller field of view clamps nothing.
        let mut map = map(seed, 40);
        map.means.iter_mut().for_each(|m| {
            let p = pose() * Vector3::from(*m);
            let q = pose().inverse() * Vector3::new(0.2 * p.x, 0.2 * p.y, p.z);
            *m = [q.x, q.y, q.z];
        });
        let near = camera();
        let far = Camera { cx: near.cx + 16.0, cy: near.cy + 16.0, ..near };
        let draw = |camera| {
            render(&map, camera, &pose(), &RenderOptions::default(), Par::Seq).expect("an image")
        };
        let (a, b) = (draw(&near), draw(&far));
        for y in 0..34 {
            for x in 0..54 {
                let (here, there) = (a.color[(x, y)], b.color[(x + 16, y + 16)]);
                for k in 0..3 {
                    prop_assert!((here[k] - there[k]).abs() < 1e-10, "{x}, {y}");
                }
            }
        }
    }
}

#[test]
fn pixel_centres_are_integers() {
    let mut map = GaussianMap::new(0);
    map.push(&ball([0.0, 0.0, 2.0], 0.2, 0.8, [1.0, 1.0, 1.0]));
    let image = draw_small(&map);
    assert!((image.opacity[(8, 8)] - 0.8).abs() < 1e-15, "peak");
    for (dx, dy) in [(1, 0), (3, 2), (8, 8)] {
        let at = |x: usize, y: usize| image.opacity[(x, y)];
        let mirrored = at(8 + dx, 8 + dy) - at(8 - dx, 8 - dy);
        assert!(mirrored.abs() < 1e-16, "{dx}, {dy}: {mirrored:e}");
        let turned = at(8 + dx, 8 + dy) - at(8 + dy, 8 + dx);
        assert!(turned.abs() < 1e-16, "{dx}, {dy}: {turned:e}");
    }
    // Variance fx² σ²/z² + 0.3 = 4.3 px²: alpha one pixel aside.
    let expected = 0.8 * garad_core::Real::exp(-0.5f64 / 4.3);
    assert!((image.opacity[(9, 8)] - expected).abs() < 1e-15, "blur");
}

#[test]
fn absent_culled_and_hidden_gaussians_change_no_pixel() {
    let map = map(3, 60);
    let without = plain(&map);
    let mut more = map.clone();
    let world_from_camera = pose().inverse();
    let at = |p: [f64; 3]| {
        let p = world_from_camera * Vector3::from(p);
        [p.x, p.y, p.z]
    };
    let thin = more.push(&ball(at([0.0, 0.0, 1.0]), 0.3, 0.5, [1.0, 0.0, 0.0]));
    more.opacity_logits[thin] = f64::NEG_INFINITY; // opacity 0
    more.push(&ball(at([0.0, 0.0, 1.0]), 0.3, 0.0039, [1.0, 0.0, 0.0])); // below 1/255
    let behind = more.push(&ball(at([0.0, 0.0, -1.0]), 0.3, 0.9, [1.0, 0.0, 0.0]));
    let near = more.push(&ball(at([0.0, 0.0, 0.19]), 0.3, 0.9, [1.0, 0.0, 0.0]));
    let aside = more.push(&ball(at([50.0, 0.0, 1.0]), 0.3, 0.9, [1.0, 0.0, 0.0]));
    let with = plain(&more);
    assert_same(&without, &with, "invisible");
    for i in [behind, near, aside] {
        assert_eq!(with.radii[i], 0, "row {i}");
    }
    assert!(with.radii[thin] > 0, "in view, though transparent");
}

#[test]
fn occluded_splats_change_no_pixel() {
    let mut map = GaussianMap::new(0);
    // Three splats far wider than the image: alpha 0.99 each, and the third is refused.
    for z in [1.0, 1.1, 1.2, 1.3] {
        map.push(&ball([0.0, 0.0, z], 30.0, 0.999_99, [0.2, 0.4, 0.6]));
    }
    let wall = draw_small(&map);
    map.push(&ball([0.0, 0.0, 2.0], 0.5, 0.9, [1.0, 0.0, 0.0]));
    assert_same(&wall, &draw_small(&map), "hidden");
    let t = wall.transmittance[(8, 8)];
    assert!((1e-4..1.01e-4).contains(&t), "two splats fit: {t}");
    assert_eq!(wall.contributors[(8, 8)], 2, "and the third does not");
    // (1 - 0.99)² is above 1e-4 in f64 and below it in f32, where 0.99 is rounded up.
    let f32_wall = render(
        &map.cast::<f32>(),
        &small(),
        &Se3::default(),
        &RenderOptions::default(),
        Par::Seq,
    )
    .expect("an image");
    assert_eq!(
        f32_wall.contributors[(8, 8)],
        1,
        "in f32 the second is refused"
    );
}

#[test]
fn alpha_is_cut_at_one_in_255() {
    let cut = 1.0 / 255.0;
    for (opacity, drawn) in [(cut * (1.0 - 1e-12), 0), (cut * (1.0 + 1e-12), 1)] {
        let mut map = GaussianMap::new(0);
        map.push(&ball([0.0, 0.0, 2.0], 0.2, opacity, [1.0, 1.0, 1.0]));
        let image = draw_small(&map);
        assert_eq!(image.contributors[(8, 8)], drawn, "opacity {opacity}");
        assert_eq!(image.contributors[(9, 8)], 0, "one pixel aside");
    }
}

#[test]
fn near_plane_is_excluded() {
    for (z, visible) in [(0.2, false), (0.2 + 1e-15, true)] {
        let mut map = GaussianMap::new(0);
        map.push(&ball([0.0, 0.0, z], 0.01, 0.5, [1.0, 1.0, 1.0]));
        assert_eq!(draw_small(&map).radii[0] > 0, visible, "z = {z}");
    }
}

#[test]
fn labels_choose_what_is_drawn() {
    let map = map(9, 60);
    let only = |include| {
        draw(
            &map,
            &RenderOptions {
                include,
                ..RenderOptions::default()
            },
            Par::Seq,
        )
    };
    let of =
        |dynamic: bool| -> Vec<usize> { (0..60).filter(|i| (i % 3 == 0) == dynamic).collect() };
    let fixed = plain(&select(&map, &of(false)));
    let moving = plain(&select(&map, &of(true)));
    assert_same(&only(Include::StaticOnly), &fixed, "static");
    assert_same(&only(Include::DynamicOnly), &moving, "dynamic");
    assert!(fixed.color != moving.color, "the two differ");
}

#[test]
fn depth_is_that_of_the_gaussian_and_missing_elsewhere() {
    let mut map = GaussianMap::new(0);
    map.push(&ball([0.0, 0.0, 2.0], 0.05, 0.5, [1.0, 1.0, 1.0]));
    let image = draw_small(&map);
    assert!((image.depth[(8, 8)] - 1.0).abs() < 1e-15, "w z = 0.5 · 2");
    let depth = image.normalized_depth();
    assert!((depth[(8, 8)] - 2.0).abs() < 1e-15, "expected depth");
    assert_eq!(depth[(0, 0)].to_bits(), 0, "nothing there");
}

/// A row with one bad number is invisible; its neighbours are drawn as if it were not there.
#[test]
fn poisoned_rows_are_invisible() {
    let clean = map(5, 20);
    let image = plain(&clean);
    type Poison = fn(&mut GaussianMap<f64>, f64);
    let poisons: [(&str, Poison); 5] = [
        ("mean", |m, v| m.means[20][1] = v),
        ("log-scale", |m, v| m.log_scales[20][2] = v),
        ("quaternion", |m, v| m.quaternions[20][3] = v),
        ("opacity", |m, v| m.opacity_logits[20] = v),
        ("colour", |m, v| m.sh[81][0] = v),
    ];
    let mut ill = clean.clone();
    let p = pose().inverse() * Vector3::new(0.0, 0.0, 1.0);
    ill.push(&ball([p.x, p.y, p.z], 0.2, 0.9, [1.0, 0.0, 0.0]));
    for (name, poison) in poisons {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut ill = ill.clone();
            poison(&mut ill, value);
            let harmless = (name == "log-scale" && value < 0.0) // e^-inf: a flat one
                || (name == "opacity" && value > 0.0); // opacity 1
            let drawn = plain(&ill);
            assert_eq!(
                drawn.radii[20] > 0,
                harmless || (name == "opacity" && value < 0.0),
                "{name} {value}"
            );
            if !harmless {
                assert_same(&image, &drawn, name);
            }
            // The same in f32, and no panic.
            render(
                &ill.cast::<f32>(),
                &camera(),
                &pose(),
                &RenderOptions::default(),
                Par::Seq,
            )
            .expect("an image");
        }
    }
    ill.quaternions[20] = [0.0; 4];
    assert_same(&image, &plain(&ill), "zero quaternion");
}

#[test]
fn extreme_sizes_are_drawn_or_left_out() {
    for (sigma, visible) in [
        (1e-30, true),  // a dot of the blur's size
        (1e30, true),   // the whole sky
        (1e200, false), // its covariance overflows
    ] {
        let mut map = GaussianMap::new(0);
        map.push(&ball([0.0, 0.0, 2.0], sigma, 0.9, [1.0, 1.0, 1.0]));
        let image = draw_small(&map);
        image.validate().expect("consistent");
        assert_eq!(image.radii[0] > 0, visible, "sigma {sigma}");
    }
    // Σ'xx = 1e26 px² fits into f32, the determinant does not.
    let mut map = GaussianMap::new(0);
    map.push(&ball([0.0, 0.0, 2.0], 1e12, 0.9, [1.0, 1.0, 1.0]));
    let options = RenderOptions::default();
    let narrow = render(
        &map.cast::<f32>(),
        &small(),
        &Se3::default(),
        &options,
        Par::Seq,
    );
    assert_eq!(narrow.expect("an image").radii, [0], "left out in f32");
    assert!(draw_small(&map).radii[0] > 0, "drawn in f64");
    let mut map = GaussianMap::new(0);
    map.push(&ball([1e300, -1e300, 1e300], 1.0, 0.9, [1.0, 1.0, 1.0]));
    map.push(&ball([1e300, 0.0, 0.3], 1e150, 0.9, [1.0, 1.0, 1.0]));
    draw_small(&map).validate().expect("consistent");
    draw_small(&map.cast::<f32>().cast::<f64>())
        .validate()
        .expect("consistent");
}

#[test]
fn empty_maps_and_single_pixels() {
    let white = RenderOptions {
        background: [1.0, 0.5, 0.25],
        ..RenderOptions::default()
    };
    let dot = Camera::pinhole((1, 1), [1.0, 1.0, 0.0, 0.0]).expect("valid");
    let mut map = GaussianMap::<f64>::new(3);
    let empty = render(&map, &dot, &Se3::default(), &white, Par::Threads(2)).expect("an image");
    assert_eq!(empty.color.data(), [[1.0, 0.5, 0.25]], "background alone");
    assert!(
        empty.radii.is_empty() && empty.projected.is_empty(),
        "no splat"
    );
    map.push(&ball([0.0, 0.0, 1.0], 0.1, 0.5, [0.0, 0.0, 0.0]));
    let one = render(&map, &dot, &Se3::default(), &white, Par::Threads(2)).expect("an image");
    assert!((one.color[(0, 0)][0] - 0.5).abs() < 1e-15, "half covered");
}

#[test]
fn invalid_input_is_an_error() {
    let good = map(1, 3);
    let attempt = |map: &GaussianMap<f64>, camera: &Camera, pose: &Se3, options: &RenderOptions| {
        render(map, camera, pose, options, Par::Seq).expect_err("refused")
    };
    let (cam, at, plain) = (camera(), pose(), RenderOptions::default());

    let flat = Camera { fx: 0.0, ..cam };
    let error = attempt(&good, &flat, &at, &plain);
    assert!(matches!(error, RasterError::Camera(_)), "{error}");

    let huge = Camera {
        width: usize::MAX,
        ..cam
    };
    let error = attempt(&good, &huge, &at, &plain);
    assert!(
        matches!(
            error,
            RasterError::Camera(CameraError::TooLarge {
                field: "width",
                value: usize::MAX
            })
        ),
        "{error}"
    );

    let high = Camera {
        height: 8_193,
        ..cam
    };
    let error = attempt(&good, &high, &at, &plain);
    assert!(
        matches!(
            error,
            RasterError::Camera(CameraError::TooLarge {
                field: "height",
                value: 8_193
            })
        ),
        "{error}"
    );

    let lost = Se3::new(So3::identity(), Vector3::new(f64::NAN, 0.0, 0.0));
    let error = attempt(&good, &cam, &lost, &plain);
    assert_eq!(error, RasterError::PoseNotFinite, "pose");

    let night = RenderOptions {
        background: [0.0, f64::INFINITY, 0.0],
        ..plain
    };
    let error = attempt(&good, &cam, &at, &night);
    assert!(
        matches!(error, RasterError::BackgroundNotFinite { channel: 1, .. }),
        "{error}"
    );
    // Finite in f64 and not in f32.
    let bright = RenderOptions {
        background: [1e300, 0.0, 0.0],
        ..plain
    };
    let error = render(&good.cast::<f32>(), &cam, &at, &bright, Par::Seq).expect_err("refused");
    assert!(
        matches!(error, RasterError::BackgroundNotFinite { channel: 0, .. }),
        "{error}"
    );

    for tile_px in [0, 8_193] {
        let options = RenderOptions { tile_px, ..plain };
        let error = attempt(&good, &cam, &at, &options);
        assert_eq!(error, RasterError::TileSize { tile_px }, "tile");
    }

    let mut short = good.clone();
    short.sh.pop();
    let error = attempt(&short, &cam, &at, &plain);
    let expected = RasterError::MapLength {
        array: "sh",
        expected: 12,
        got: 11,
    };
    assert_eq!(error, expected, "{error}");
}

#[test]
fn validate_names_the_first_bad_pixel() {
    type Damage = fn(&mut Rendered<f64>);
    let damages: [(&str, Damage); 6] = [
        ("NaN colour", |r| r.color[(3, 2)][1] = f64::NAN),
        ("infinite depth", |r| r.depth[(3, 2)] = f64::INFINITY),
        ("too dark", |r| r.transmittance[(3, 2)] = 0.99e-4),
        ("too bright", |r| r.transmittance[(3, 2)] = 1.01),
        ("nothing drawn, light lost", |r| {
            r.contributors[(3, 2)] = 0;
            r.last[(3, 2)] = 0;
        }),
        ("more splats than positions", |r| r.last[(3, 2)] = 1),
    ];
    let mut map = GaussianMap::new(0);
    map.push(&ball([0.0, 0.0, 2.0], 1.0, 0.5, [1.0, 1.0, 1.0]));
    map.push(&ball([0.0, 0.0, 3.0], 1.0, 0.5, [1.0, 1.0, 1.0]));
    let good = draw_small(&map);
    assert_eq!(good.validate(), Ok(()), "as drawn");
    for (name, damage) in damages {
        let mut bad = good.clone();
        damage(&mut bad);
        let sentence = bad.validate().expect_err(name);
        assert!(sentence.contains("pixel (3, 2)"), "{name}: {sentence}");
    }
}
