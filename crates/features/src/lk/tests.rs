use super::reference::Reference;
use super::*;
use garad_core::{GrayImage, Rng};
use proptest::prelude::*;

/// A sum of waves: smooth, and known everywhere, so that it can be shifted by any amount.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to a byte"
)]
fn waves(width: usize, height: usize, shift: [f64; 2]) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        let (x, y) = (x as f64 - shift[0], y as f64 - shift[1]);
        let value = 128.0
            + 45.0 * libm::sin(0.31 * x + 0.17 * y)
            + 40.0 * libm::sin(0.23 * y - 0.11 * x + 1.0)
            + 30.0 * libm::sin(0.07 * x + 0.05 * y + 2.0);
        value.round().clamp(0.0, 255.0) as u8
    })
}

fn noise(width: usize, height: usize, seed: u64) -> GrayImage {
    let mut rng = Rng::new(seed);
    GrayImage::from_fn(width, height, |_, _| {
        u8::try_from(rng.below(256)).expect("byte")
    })
}

fn grid(width: u16, height: u16) -> Vec<[f32; 2]> {
    let xs = || (20..width - 20).step_by(17).map(f32::from);
    (20..height - 20)
        .step_by(13)
        .flat_map(|y| xs().map(move |x| [x + 0.3, f32::from(y) - 0.4]))
        .collect()
}

fn pyramid(image: &GrayImage) -> LkPyramid {
    LkPyramid::new(image, 3).expect("not empty")
}

/// The same laws for both implementations of the window sums.
macro_rules! tracking_laws {
    ($name:ident, $windows:ty) => {
        mod $name {
            use super::*;

            fn track(
                prev: &GrayImage,
                next: &GrayImage,
                points: &[[f32; 2]],
                config: &LkConfig,
            ) -> Vec<LkTrack> {
                track_with::<$windows>(
                    &pyramid(prev),
                    &pyramid(next),
                    points,
                    None,
                    config,
                    Par::Seq,
                )
                .expect("sizes agree")
            }

            #[test]
            fn nothing_moves_in_the_same_image() {
                let image = waves(160, 120, [0.0, 0.0]);
                let points = grid(160, 120);
                for (found, point) in track(&image, &image, &points, &LkConfig::default())
                    .iter()
                    .zip(&points)
                {
                    assert!(found.is_tracked(), "{found:?}");
                    assert_eq!(
                        found.xy.map(f32::to_bits),
                        point.map(f32::to_bits),
                        "exactly"
                    );
                    assert!(found.residual.abs() < 1e-9, "no difference: {found:?}");
                }
            }

            #[test]
            fn a_shift_is_found() {
                for shift in [[0.25, -0.5], [3.0, 2.0], [-7.3, 5.6]] {
                    let (prev, next) = (waves(160, 120, [0.0, 0.0]), waves(160, 120, shift));
                    let points = grid(160, 120);
                    let mut errors = Vec::new();
                    for (found, point) in track(&prev, &next, &points, &LkConfig::default())
                        .iter()
                        .zip(&points)
                    {
                        assert!(found.is_tracked(), "{found:?}");
                        let error = [0, 1].map(|i| f64::from(found.xy[i] - point[i]) - shift[i]);
                        errors.push(libm::hypot(error[0], error[1]));
                    }
                    errors.sort_by(f64::total_cmp);
                    let median = errors[errors.len() / 2];
                    assert!(median < 0.05, "median error {median} px for {shift:?}");
                }
            }

            #[test]
            fn each_way_to_lose_a_point() {
                let image = waves(160, 120, [0.0, 0.0]);
                let flat = GrayImage::new(160, 120, 99);
                let config = LkConfig::default();
                let status =
                    |prev: &GrayImage, next: &GrayImage, point: [f32; 2], config: &LkConfig| {
                        track(prev, next, &[point], config)[0].status
                    };
                assert_eq!(
                    status(&image, &image, [80.0, 60.0], &config),
                    LkStatus::Tracked
                );
                assert_eq!(
                    status(&flat, &image, [80.0, 60.0], &config),
                    LkStatus::FlatTexture
                );
                for point in [
                    [-11.5, 60.0],
                    [170.0, 60.0],
                    [80.0, -11.5],
                    [80.0, 130.0],
                    [f32::NAN, 60.0],
                    [1e30, 60.0],
                ] {
                    assert_eq!(
                        status(&image, &image, point, &config),
                        LkStatus::OutOfImage,
                        "{point:?}"
                    );
                }
                let strict = LkConfig {
                    max_residual: Some(20.0),
                    ..config
                };
                assert_eq!(
                    status(&image, &flat, [80.0, 60.0], &strict),
                    LkStatus::HighResidual
                );
                let fine =
                    track(&image, &image, &[[80.0, 60.0]], &LkConfig::default())[0].min_eigenvalue;
                let at = LkConfig {
                    min_eigenvalue: fine,
                    ..config
                };
                let above = LkConfig {
                    min_eigenvalue: fine * 1.001,
                    ..config
                };
                assert_eq!(
                    status(&image, &image, [80.0, 60.0], &at),
                    LkStatus::Tracked,
                    "at the gate"
                );
                assert_eq!(
                    status(&image, &image, [80.0, 60.0], &above),
                    LkStatus::FlatTexture,
                    "above it"
                );
            }
        }
    };
}
tracking_laws!(reference_laws, Reference);
tracking_laws!(fast_laws, Fast);

/// The number of OpenCV's documentation: the smaller eigenvalue of the sums of ∇I ∇Iᵀ over the window,
/// divided by its number of pixels. Scharr's derivatives are 32 times the slope of a byte, and a
/// byte counts 2⁻¹⁰.
#[test]
fn spec_min_eigenvalue() {
    let image = noise(61, 61, 5);
    let (dx, dy) = reference::scharr(&image);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for y in 20..=40 {
        for x in 20..=40 {
            let (gx, gy) = (f64::from(dx[(x, y)]), f64::from(dy[(x, y)]));
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    }
    let smaller = nalgebra::Matrix2::new(xx, xy, xy, yy)
        .symmetric_eigenvalues()
        .min();
    let expected = smaller / (1024.0 * 1024.0) / (21.0 * 21.0);
    let level = LkPyramid::new(&image, 0).expect("not empty");
    let config = LkConfig::default();
    let found = track(&level, &level, &[[30.0; 2]], None, &config, Par::Seq).expect("sizes agree");
    let got = f64::from(found[0].min_eigenvalue);
    assert!(
        (got - expected).abs() < 1e-5 * expected,
        "{got}, expected {expected}"
    );
}

#[test]
fn extreme_images_do_not_overflow() {
    // A checkerboard of black and white squares against its negative: the largest sums there are.
    for size in [1, 2, 5, 11, 21] {
        let board = GrayImage::from_fn(64, 64, |x, y| {
            if (x / size + y / size) % 2 == 0 {
                0
            } else {
                255
            }
        });
        let negative = board.map(|v| 255 - v);
        let (prev, next) = (pyramid(&board), pyramid(&negative));
        for x in 0..8u8 {
            let point = [[25.0 + f32::from(x), 30.0 + f32::from(x) * 0.37]];
            let config = LkConfig::default();
            assert_eq!(
                track(&prev, &next, &point, None, &config, Par::Seq),
                track_reference(&prev, &next, &point, None, &config, Par::Seq),
                "squares of {size}"
            );
        }
    }
}

#[test]
fn the_start_matters_and_sizes_must_agree() {
    let (prev, next) = (waves(160, 120, [0.0, 0.0]), waves(160, 120, [15.0, 0.0]));
    let (prev, next) = (pyramid(&prev), pyramid(&next));
    let config = LkConfig::default();
    let start = [[95.0, 60.0]];
    let found = track(
        &prev,
        &next,
        &[[80.0, 60.0]],
        Some(&start),
        &config,
        Par::Seq,
    )
    .expect("sizes agree");
    assert!((found[0].xy[0] - 95.0).abs() < 0.05, "{found:?}");
    let other = pyramid(&GrayImage::new(100, 120, 0));
    let fewer = LkPyramid::new(&GrayImage::new(160, 120, 0), 1).expect("not empty");
    for (next, starts) in [(&other, None), (&fewer, None), (&next, Some(&start[..0]))] {
        let error = track(&prev, next, &[[80.0, 60.0]], starts, &config, Par::Seq);
        assert!(
            matches!(error, Err(FeatureError::SizeMismatch { .. })),
            "{error:?}"
        );
    }
    assert_eq!(
        track(&prev, &next, &[], None, &config, Par::Seq),
        Ok(Vec::new()),
        "no points"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn both_agree_for_any_number_of_threads(seed: u64, w in 22usize..120, h in 22usize..90) {
        let prev = noise(w, h, seed);
        let next = GrayImage::from_fn(w, h, |x, y| prev[(x.saturating_sub(1), y)]);
        let mut rng = Rng::new(seed ^ 1);
        // Some outside the image.
        let points: Vec<[f32; 2]> = (0..40)
            .map(|_| [rng.range(-30.0, w as f64 + 30.0), rng.range(-30.0, h as f64 + 30.0)].map(garad_core::Real::to_f32))
            .collect();
        let (prev, next) = (pyramid(&prev), pyramid(&next));
        let config = LkConfig::default();
        let expected = track_with::<Reference>(&prev, &next, &points, None, &config, Par::Seq);
        for threads in [1, 2, 3] {
            let got = track(&prev, &next, &points, None, &config, Par::new(threads));
            prop_assert_eq!(&got, &expected);
        }
    }
}

/// c of two windows, term by term in f64.
fn correlation_by_hand(
    a: &GrayImage,
    [ax, ay]: [usize; 2],
    b: &GrayImage,
    [bx, by]: [usize; 2],
) -> f64 {
    let window = |image: &GrayImage, x: usize, y: usize| {
        let rows = (0..21).flat_map(move |dy| (0..21).map(move |dx| (x - 10 + dx, y - 10 + dy)));
        rows.map(|at| f64::from(image[at])).collect::<Vec<_>>()
    };
    let (a, b) = (window(a, ax, ay), window(b, bx, by));
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(&a), mean(&b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| {
        let pairs = a.iter().zip(&b);
        pairs.map(|(a, b)| f(a - ma, b - mb)).sum::<f64>()
    };
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
}

#[test]
fn correlation_is_that_of_the_formula() {
    let a = noise(64, 48, 5);
    let brighter = a.map(|v| v / 2 + 80);
    let negative = a.map(|v| 255 - v);
    let [p, q, n] = [&a, &brighter, &negative].map(|i| LkPyramid::new(i, 1).expect("an image"));
    let at = [30.4, 20.0];
    let with = |other: &LkPyramid, to: [f32; 2]| p.correlation(at, other, to);
    assert!(
        (with(&p, at).expect("inside") - 1.0).abs() < 1e-12,
        "itself"
    );
    assert!(
        (with(&n, at).expect("inside") + 1.0).abs() < 1e-12,
        "its negative"
    );
    for to in [[30, 20], [31, 20], [12, 33]] {
        let expected = correlation_by_hand(&a, [30, 20], &brighter, to);
        let found = with(
            &q,
            [to[0], to[1]].map(|v| f32::from(u8::try_from(v).expect("small"))),
        )
        .expect("inside");
        assert!(
            (found - expected).abs() < 1e-12,
            "{to:?}: {found} {expected}"
        );
    }
    assert!(with(&p, [9.4, 20.0]).is_none(), "a column outside");
    assert!(with(&p, [9.6, 20.0]).is_some(), "just inside");
    assert!(
        with(&p, [53.4, 20.0]).is_some() && with(&p, [53.6, 20.0]).is_none(),
        "right"
    );
    let flat = LkPyramid::new(&GrayImage::new(64, 48, 90), 1).expect("an image");
    assert!(with(&flat, at).is_none(), "flat");
}

/// Each setting away from its default, by what it must equal or change.
#[test]
fn settings_do_what_they_say() {
    let (a, b) = (waves(160, 120, [0.0, 0.0]), waves(160, 120, [7.3, -4.6]));
    let points = grid(160, 120);
    let run = |levels: usize, config: &LkConfig| {
        let [prev, next] = [&a, &b].map(|i| LkPyramid::new(i, levels).expect("an image"));
        track(&prev, &next, &points, None, config, Par::Seq).expect("sizes agree")
    };
    let default = LkConfig::default();
    let with = |change: fn(&mut LkConfig)| {
        let mut config = default;
        change(&mut config);
        config
    };
    let all = run(3, &default);
    for coarsest_level in [0, 1, 2] {
        let config = LkConfig {
            coarsest_level,
            ..default
        };
        let found = run(3, &config);
        assert_eq!(
            found,
            run(coarsest_level, &default),
            "coarsest level {coarsest_level}"
        );
        assert!(
            coarsest_level > 1 || found != all,
            "other than from level 3"
        );
    }
    let still = run(3, &with(|c| c.iterations = 0));
    for (found, point) in still.iter().zip(&points) {
        assert_eq!(
            found.xy.map(f32::to_bits),
            point.map(f32::to_bits),
            "no step"
        );
    }
    let one_step = run(3, &with(|c| c.iterations = 1));
    assert!(one_step != all && one_step != still, "one step a level");
    assert_eq!(
        run(3, &with(|c| c.epsilon_px = 1e3)),
        one_step,
        "every step is short"
    );
    let worst = all.iter().map(|t| t.residual).fold(0.0, f32::max);
    let least = all.iter().map(|t| t.residual).fold(f32::MAX, f32::min);
    assert!(least > 0.0 && worst > least, "{least} {worst}");
    for (max, expected) in [(worst, 0), (worst * 0.999, 1), (least, points.len() - 1)] {
        let config = LkConfig {
            max_residual: Some(max),
            ..default
        };
        let lost = run(3, &config)
            .iter()
            .filter(|t| t.status == LkStatus::HighResidual)
            .count();
        assert_eq!(lost, expected, "above {max}");
    }
}
