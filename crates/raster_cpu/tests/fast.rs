//! The fast rasterizer against the reference: its splats bit for bit, its images and
//! gradients to what f32 can do, pixels at a cut to what the cut can move.

mod common;

use common::{GRADIENT_COST, camera, map, narrow, pose, tensors, upstream};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, NewGaussian, Par, Real, Se3};
use garad_raster::{
    ClampGradient, Gradients, Include, RasterError, RenderOptions, Rendered, Upstream, backward,
    fast, render,
};
use proptest::prelude::*;

/// What f32 costs color, depth and transmittance: measured on a reference in f32 against itself
/// in f64, largest difference by largest value, for 20 000 Gaussians.
const COST: [f64; 3] = [6.8e-6, 6.6e-6, 7.0e-6];
/// A splat that one of two images leaves out at a cut has at most this weight: alpha T with
/// T (1 - alpha) = 1e-4 and alpha = 0.99.
const FLIP: f64 = 0.0101;

/// The same bits for one to three threads; splats and radii those of the reference; pixels that
/// blend as many splats within 8 times what f32 costs, others within a flip. Returns the fast
/// image and how many pixels flip.
fn assert_same_image(
    map: &GaussianMap<f32>,
    camera: &Camera,
    pose: &Se3,
    options: &RenderOptions,
) -> (Rendered<f32>, usize) {
    let reference = render(map, camera, pose, options, Par::Seq).expect("an image");
    let ours = fast::render(map, camera, pose, options, Par::Seq).expect("an image");
    for threads in [2, 3] {
        let many = fast::render(map, camera, pose, options, Par::new(threads)).expect("an image");
        assert!(many == ours, "{threads} threads");
    }
    assert_eq!(ours.validate(), Ok(()), "consistent");
    assert!(ours.projected == reference.projected, "splats");
    assert!(ours.radii == reference.radii, "radii");
    let values = |p: &Rendered<f32>, at: (usize, usize)| {
        let [r, g, b] = p.color[at].map(f64::from);
        let (depth, t) = (f64::from(p.depth[at]), f64::from(p.transmittance[at]));
        [(0, r), (0, g), (0, b), (1, depth), (2, t)]
    };
    // A weight is multiplied by a colour or a depth; the image's largest may be smaller.
    let of_splats = ours.projected.iter().fold([1.0f64; 3], |[c, d, t], s| {
        let bright = s.color.iter().fold(c, |c, v| c.max(f64::from(*v)));
        [bright, d.max(f64::from(s.depth_m)), t]
    });
    let places = || (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
    let mut largest = [0.0f64; 3];
    for (kind, value) in places().flat_map(|at| values(&reference, at)) {
        largest[kind] = largest[kind].max(value.abs());
    }
    let mut flips = 0;
    for at in places() {
        let same = ours.contributors[at] == reference.contributors[at]
            && ours.last[at] == reference.last[at];
        flips += usize::from(!same);
        for ((kind, a), (_, b)) in values(&ours, at).into_iter().zip(values(&reference, at)) {
            let allowed = if same {
                8.0 * COST[kind] * largest[kind]
            } else {
                FLIP * of_splats[kind]
            };
            assert!(
                (a - b).abs() <= allowed,
                "{at:?}: {a} against {b}, image {kind}, as many splats: {same}"
            );
        }
    }
    (ours, flips)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Random scenes in images whose last tiles are cut anywhere.
    #[test]
    fn fast_is_the_reference(
        seed in 0u64..1_000_000,
        size in (1usize..80, 1usize..60),
        background in proptest::array::uniform3(-1.0f64..1.0),
        which in 0usize..3,
        tile_px in prop_oneof![4 => Just(16usize), 1 => Just(8usize)],
    ) {
        let map = map(seed, 120).cast::<f32>();
        let camera = Camera { width: size.0, height: size.1, ..camera() };
        let include = [Include::All, Include::StaticOnly, Include::DynamicOnly][which];
        let options = RenderOptions { background, include, tile_px, ..RenderOptions::default() };
        let (_, flips) = assert_same_image(&map, &camera, &pose(), &options);
        // 1 in 200, and a few in images of a few pixels.
        prop_assert!(flips * 200 <= size.0 * size.1 + 400, "{flips} pixels at a cut");
    }
}

fn ball(z: f32, sigma_m: f32, opacity: f32) -> NewGaussian<f32> {
    NewGaussian {
        mean: [0.01, -0.02, z],
        sigma_m,
        opacity,
        color: [0.9, 0.4, 0.1],
        landmark: None,
        born: KeyframeId(0),
    }
}

/// A few ulp to both sides of 1/255, of 0.99 and of the near plane, walls that end a pixel, sizes
/// beyond reason, and rows with a bad number.
#[test]
fn fast_is_the_reference_on_the_cuts() {
    let camera = Camera::pinhole((41, 37), [30.0, 30.0, 20.3, 18.2]).expect("valid");
    let draw = |map: &GaussianMap<f32>| {
        assert_same_image(map, &camera, &Se3::default(), &RenderOptions::default())
    };
    let near = |x: f32| {
        [-64i32, -8, 0, 8, 64].map(|step| f32::from_bits(x.to_bits().wrapping_add_signed(step)))
    };
    let mut counts = Vec::new();
    for opacity in near(1.0 / 255.0).into_iter().chain(near(0.99)) {
        let mut map = GaussianMap::new(0);
        map.push(&ball(2.0, 30.0, opacity));
        map.push(&ball(3.0, 0.2, opacity));
        let (image, flips) = draw(&map);
        counts.push((image.contributors.data().iter().sum::<u32>(), flips));
    }
    assert!(counts[0].0 < counts[4].0, "the cut is crossed: {counts:?}");
    let sure = [0, 4, 5, 9].map(|k| counts[k].1);
    assert!(
        sure.iter().all(|&flips| flips < 8),
        "64 ulp off: {counts:?}"
    );
    for z in near(0.2) {
        let mut map = GaussianMap::new(0);
        map.push(&ball(z, 0.01, 0.5));
        draw(&map);
    }
    let mut wall = GaussianMap::new(0);
    for k in 0..40u8 {
        wall.push(&ball(
            1.0 + f32::from(k % 7),
            0.05 * f32::from(k),
            0.05 + 0.02 * f32::from(k),
        ));
    }
    let (last, _) = draw(&wall);
    assert!(
        last.transmittance.data().iter().any(|&t| t < 2e-4),
        "some pixels are finished"
    );
    for sigma in [0.0, 1e-30, 1e-3, 1e5, 1e8, 1e12, 1e30] {
        for opacity in [0.003, 0.5, 0.999_99] {
            let mut map = GaussianMap::new(0);
            let i = map.push(&ball(1.0, sigma, opacity));
            draw(&map);
            map.log_scales[i][0] = -20.0;
            map.quaternions[i] = [0.9, 0.1, -0.3, 0.2];
            draw(&map);
        }
    }
    for value in [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e38,
        -1e38,
        1e-40,
    ] {
        for array in 0..5 {
            let mut map = wall.clone();
            match array {
                0 => map.means[3][1] = value,
                1 => map.log_scales[3][2] = value,
                2 => map.quaternions[3][3] = value,
                3 => map.opacity_logits[3] = value,
                _ => map.sh[3][0] = value,
            }
            draw(&map);
        }
    }
    draw(&GaussianMap::new(2));
}

/// Many splats at few depths: order among equals, and tiles that close.
#[test]
fn fast_is_the_reference_in_a_crowd() {
    let mut map = map(77, 4000).cast::<f32>();
    // Every fourth stands at the very depth of its neighbour.
    for i in (0..3996).step_by(4) {
        map.means[i + 1] = map.means[i];
    }
    let (_, flips) = assert_same_image(&map, &camera(), &pose(), &RenderOptions::default());
    assert!(flips < 35, "{flips} of 3500 pixels at a cut");
}

/// Largest difference by largest value, in units of [`GRADIENT_COST`], per tensor.
fn distances<A: Real, B: Real>(a: &Gradients<A>, b: &Gradients<B>) -> Vec<(&'static str, f64)> {
    let pairs = tensors(a).into_iter().zip(tensors(b)).zip(GRADIENT_COST);
    pairs
        .map(|(((name, a), (_, b)), unit)| {
            let largest = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let difference = a
                .iter()
                .zip(&b)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            (name, difference / (largest * unit))
        })
        .collect()
}

/// Against the reference in f64, on pixels that f32 blends from as many splats: within 8 times
/// the table. Against the reference in f32, which blends the same: within the table.
#[test]
fn fast_gradients_are_those_of_the_reference() {
    let (camera, pose) = (camera(), pose());
    for (seed, clamp_gradient) in (0..8).zip(
        [ClampGradient::True, ClampGradient::PassThrough]
            .into_iter()
            .cycle(),
    ) {
        let options = RenderOptions {
            background: [0.3, 0.1, 0.6],
            clamp_gradient,
            ..RenderOptions::default()
        };
        let (wide_map, mut up) = (map(seed, 150), upstream(seed, &camera));
        let map = wide_map.cast::<f32>();
        let image = fast::render(&map, &camera, &pose, &options, Par::Seq).expect("an image");
        let like = render(&map, &camera, &pose, &options, Par::Seq).expect("an image");
        let wide_map = map.cast::<f64>();
        let wide = render(&wide_map, &camera, &pose, &options, Par::Seq).expect("an image");
        let mut lost = 0;
        for y in 0..camera.height {
            for x in 0..camera.width {
                let at = (x, y);
                let met = [
                    (image.contributors[at], image.last[at]),
                    (like.contributors[at], like.last[at]),
                    (wide.contributors[at], wide.last[at]),
                ];
                if met[0] != met[1] || met[0] != met[2] {
                    lost += 1;
                    up.color[at] = [0.0; 3];
                    up.depth.as_mut().expect("given")[at] = 0.0;
                    up.opacity.as_mut().expect("given")[at] = 0.0;
                }
            }
        }
        assert!(
            lost * 100 < camera.width * camera.height,
            "{lost} pixels differ"
        );
        let narrow = narrow(&up);
        let up = Upstream {
            color: narrow.color.map(|c| c.map(f64::from)),
            depth: narrow.depth.as_ref().map(|i| i.map(|&v| f64::from(v))),
            opacity: narrow.opacity.as_ref().map(|i| i.map(|&v| f64::from(v))),
        };
        let ours = fast::backward(&map, &camera, &pose, &options, &image, &narrow, Par::Seq)
            .expect("gradients");
        let same =
            backward(&map, &camera, &pose, &options, &like, &narrow, Par::Seq).expect("gradients");
        let exact =
            backward(&wide_map, &camera, &pose, &options, &wide, &up, Par::Seq).expect("gradients");
        for (name, distance) in distances(&ours, &same) {
            assert!(
                distance < 1.0,
                "seed {seed}, {name}: {distance} of the table, both in f32"
            );
        }
        for (name, distance) in distances(&ours, &exact) {
            assert!(
                distance < 8.0,
                "seed {seed}, {name}: {distance} times the table"
            );
        }
        for threads in [2, 3] {
            let many = fast::backward(
                &map,
                &camera,
                &pose,
                &options,
                &image,
                &narrow,
                Par::new(threads),
            );
            assert!(many.as_ref() == Ok(&ours), "seed {seed}, {threads} threads");
        }
    }
}

/// A NaN at a pixel reaches the splats of that pixel and no others.
#[test]
fn an_upstream_nan_reaches_the_same_rows_as_in_the_reference() {
    let (camera, pose, options) = (camera(), pose(), RenderOptions::default());
    let map = map(11, 60).cast::<f32>();
    let image = fast::render(&map, &camera, &pose, &options, Par::Seq).expect("an image");
    let mut up = narrow(&upstream(11, &camera));
    up.color[(33, 21)][1] = f32::NAN;
    let both = [
        backward(&map, &camera, &pose, &options, &image, &up, Par::Seq),
        fast::backward(&map, &camera, &pose, &options, &image, &up, Par::Seq),
    ]
    .map(|g| g.expect("gradients").means2d);
    let reached = both.map(|m| m.iter().map(|v| v[0].is_nan()).collect::<Vec<_>>());
    assert_eq!(reached[0], reached[1], "the same rows");
    let n = reached[0].iter().filter(|s| **s).count();
    assert!(n > 0 && n < 40, "{n} rows");
}

#[test]
fn fast_refuses_what_the_reference_refuses() {
    let (camera, pose, options) = (camera(), pose(), RenderOptions::default());
    let map = map(1, 40).cast::<f32>();
    let image = fast::render(&map, &camera, &pose, &options, Par::Seq).expect("an image");
    let up = narrow(&upstream(1, &camera));
    let same = |map: &GaussianMap<f32>,
                image: &Rendered<f32>,
                up: &Upstream<f32>,
                options: &RenderOptions| {
        let reference = backward(map, &camera, &pose, options, image, up, Par::Seq);
        let ours = fast::backward(map, &camera, &pose, options, image, up, Par::Threads(2));
        let (reference, ours) = (reference.expect_err("refused"), ours.expect_err("refused"));
        assert_eq!(ours, reference, "the same error");
        ours
    };
    let mut small = up.clone();
    small.color = Image::new(1, 1, [0.0; 3]);
    same(&map, &image, &small, &options);
    let mut other = image.clone();
    other.projected[2].footprint.x1 = 71;
    same(&map, &other, &up, &options);
    let mut poisoned = map.clone();
    for splat in [20, 12, 25] {
        poisoned.quaternions[image.projected[splat].index as usize] = [0.0; 4];
    }
    let error = same(&poisoned, &image, &up, &options);
    assert_eq!(error, RasterError::NotThisMap { splat: 12 }, "the first");
    let none = RenderOptions {
        tile_px: 0,
        ..options
    };
    same(&map, &image, &up, &none);
    let night = RenderOptions {
        background: [f64::INFINITY; 3],
        ..options
    };
    same(&map, &image, &up, &night);
    let error = fast::render(&map, &camera, &pose, &night, Par::Seq).expect_err("refused");
    assert!(
        matches!(error, RasterError::BackgroundNotFinite { .. }),
        "{error}"
    );
    let mut short = map.clone();
    short.sh.pop();
    let error = fast::render(&short, &camera, &pose, &options, Par::Seq).expect_err("refused");
    assert!(
        matches!(error, RasterError::MapLength { array: "sh", .. }),
        "{error}"
    );
}

/// In images that end within a tile, with and without splats, on one and three threads.
#[test]
fn coverage_is_two_images_of_the_render() {
    let options = RenderOptions::default();
    let gaussians = map(1, 40).cast::<f32>();
    let (whole, pose) = (camera(), pose());
    for (map, camera) in [
        (&gaussians, whole),
        (&gaussians, whole.level(1)),
        (&GaussianMap::new(0), whole),
    ] {
        let rendered = fast::render(map, &camera, &pose, &options, Par::Seq).expect("an image");
        for par in [Par::Seq, Par::Threads(3)] {
            let covered = fast::coverage(map, &camera, &pose, par).expect("an image");
            assert!(covered.opacity == rendered.opacity, "opacity, {par:?}");
            assert!(covered.depth == rendered.depth, "depth, {par:?}");
        }
        let seen = rendered.opacity.data().iter().any(|o| *o > 0.1);
        assert_eq!(seen, !map.is_empty(), "something is drawn");
    }
    let mut short = gaussians.clone();
    short.sh.pop();
    let reference = render(&short, &whole, &pose, &options, Par::Seq).expect_err("refused");
    let error = fast::coverage(&short, &whole, &pose, Par::Seq).expect_err("refused");
    assert_eq!(error, reference, "the same error");
}
