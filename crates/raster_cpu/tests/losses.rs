//! The losses against differences, and their laws.

use garad_core::{Image, Label, MaskImage, Par, Real, Rng};
use garad_raster::RasterError;
use garad_raster::losses::{
    ImageLoss, depth_l1, l1, opacity_penalty, photometric, reference, ssim,
};
use proptest::prelude::*;

type LossOf<T> = Result<ImageLoss<T>, RasterError>;
type Ssim<T> = fn(&Image<[T; 3]>, &Image<[T; 3]>, Option<&MaskImage>, Par) -> LossOf<T>;
type Photometric<T> = fn(&Image<[T; 3]>, &Image<[T; 3]>, f64, Option<&MaskImage>, Par) -> LossOf<T>;

/// What runs and the plain form: every test of the one is a test of the other.
fn forms<T: Real>() -> [(&'static str, Ssim<T>, Photometric<T>); 2] {
    [
        ("sweep", ssim, photometric),
        ("reference", reference::ssim, reference::photometric),
    ]
}

type ColorImage = Image<[f64; 3]>;

fn noise(seed: u64, width: usize, height: usize) -> ColorImage {
    let mut rng = Rng::keyed(seed, &[]);
    Image::from_fn(width, height, |_, _| [0; 3].map(|_| rng.uniform()))
}

/// Central differences of a loss by every third pixel of x.
fn assert_is_derivative(x: &ColorImage, f: impl Fn(&ColorImage) -> ImageLoss<f64>) {
    let gradient = f(x).gradient;
    let largest = gradient
        .data()
        .as_flattened()
        .iter()
        .fold(0.0f64, |m, v| m.max(v.abs()));
    assert!(largest > 1e-5, "there is a slope: {largest}");
    let h = 1e-5;
    for i in (0..x.data().len()).step_by(3) {
        for channel in 0..3 {
            let at = |shift: f64| {
                let mut moved = x.clone();
                moved.data_mut()[i][channel] += shift;
                f(&moved).value
            };
            let slope = (at(h) - at(-h)) / (2.0 * h);
            let analytic = gradient.data()[i][channel];
            assert!(
                (analytic - slope).abs() < 1e-6 * largest,
                "pixel {i}, channel {channel}: {analytic} against {slope}"
            );
        }
    }
}

#[test]
fn gradients_are_derivatives() {
    let (x, y) = (noise(1, 11, 9), noise(2, 11, 9));
    let mask = Image::from_fn(
        11,
        9,
        |u, v| if (3..6).contains(&u) && v > 4 { 255 } else { 0 },
    );
    for excluded in [None, Some(&mask)] {
        assert_is_derivative(&x, |x| l1(x, &y, excluded).expect("fits"));
        for (_, ssim, photometric) in forms::<f64>() {
            assert_is_derivative(&x, |x| ssim(x, &y, excluded, Par::Seq).expect("fits"));
            assert_is_derivative(&x, |x| {
                photometric(x, &y, 0.2, excluded, Par::Seq).expect("fits")
            });
        }
    }
}

#[test]
fn equal_images_minimise_the_losses() {
    let x = noise(7, 14, 13);
    for (by, ssim, photometric) in forms::<f64>() {
        let same = ssim(&x, &x, None, Par::Seq).expect("fits");
        assert!((same.value - 1.0).abs() < 1e-15, "{by}: {}", same.value);
        let slope = largest(&same.gradient);
        assert!(slope < 1e-15, "{by}: slope at the maximum: {slope:e}");
        let zero = photometric(&x, &x, 0.2, None, Par::Seq).expect("fits");
        assert!(zero.value.abs() < 1e-15, "{by}: {}", zero.value);
    }
}

fn largest<T: Real>(image: &Image<[T; 3]>) -> f64 {
    let numbers = image.data().as_flattened().iter();
    numbers.fold(0.0, |m, v| m.max(v.to_f64().abs()))
}

/// Bands end inside the image, elsewhere for each number of threads; each pixel still has the same
/// operations and each sum one order.
#[test]
fn bands_and_threads_change_no_bit() {
    for (w, h) in [(37, 150), (3, 97), (1, 64), (64, 1)] {
        let (x, y) = (noise(1, w, h), noise(2, w, h));
        let mask = Image::from_fn(w, h, |u, v| u8::from((u + 3 * v) % 7 == 0));
        for excluded in [None, Some(&mask)] {
            let one = photometric(&x, &y, 0.2, excluded, Par::Seq).expect("fits");
            for threads in [2, 3, 8] {
                let many = photometric(&x, &y, 0.2, excluded, Par::new(threads));
                assert!(many.as_ref() == Ok(&one), "{w} x {h}, {threads} threads");
            }
        }
    }
}

/// The sweep in f64 is the reference but for rounding, over several bands and with holes.
#[test]
fn the_sweep_is_the_reference() {
    for (w, h) in [(90, 140), (7, 200), (1, 1), (40, 5)] {
        let (x, y) = (noise(3, w, h), noise(4, w, h));
        let mut rng = Rng::new(8);
        let mask = Image::from_fn(w, h, |_, _| if rng.uniform() < 0.2 { 255u8 } else { 0 });
        for excluded in [None, Some(&mask)] {
            let plain = reference::photometric(&x, &y, 0.2, excluded, Par::Seq).expect("fits");
            let ours = photometric(&x, &y, 0.2, excluded, Par::Threads(2)).expect("fits");
            assert_eq!(ours.pixels, plain.pixels, "{w} x {h}");
            let value = (ours.value - plain.value).abs();
            assert!(value < 4e-15, "{w} x {h}: value off by {value:e}");
            let size = largest(&plain.gradient).max(1e-300);
            let pairs = ours.gradient.data().iter().zip(plain.gradient.data());
            for (a, b) in pairs.flat_map(|(a, b)| a.iter().zip(b)) {
                assert!(
                    (a - b).abs() < 2e-14 * size,
                    "{w} x {h}: {a:e} against {b:e}"
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Excluded pixels change nothing and get no gradient; threads change no bit.
    #[test]
    fn masked_pixels_neither_count_nor_leak(seed in 0u64..1000, w in 1usize..16, h in 1usize..16) {
        let (x, y) = (noise(seed, w, h), noise(seed + 5000, w, h));
        let mut rng = Rng::keyed(seed, &[9]);
        let mask = Image::from_fn(w, h, |_, _| if rng.uniform() < 0.3 { 128u8 } else { 0 });
        let other = noise(seed + 9000, w, h);
        let mixed = Image::from_fn(w, h, |u, v| {
            if mask[(u, v)] == 0 { x[(u, v)] } else { other[(u, v)] }
        });
        for (_, _, photometric) in forms::<f64>() {
            let loss = photometric(&x, &y, 0.3, Some(&mask), Par::Seq);
            prop_assert_eq!(&loss, &photometric(&mixed, &y, 0.3, Some(&mask), Par::Seq));
            prop_assert_eq!(&loss, &photometric(&x, &y, 0.3, Some(&mask), Par::Threads(2)));
            let loss = loss.expect("fits");
            for (g, m) in loss.gradient.data().iter().zip(mask.data()) {
                prop_assert!(*m == 0 || g.iter().all(|v| v.abs() < 1e-300), "{g:?}");
            }
        }
    }
}

#[test]
fn without_included_pixels_loss_and_gradient_are_zero() {
    for (by, _, photometric) in forms::<f64>() {
        for (w, h) in [(0, 0), (0, 5), (5, 0)] {
            let none = noise(1, w, h);
            let loss = photometric(&none, &none, 0.2, None, Par::Threads(2)).expect("fits");
            assert!(loss.value.abs() < 1e-300, "{by}, {w} x {h}: {}", loss.value);
        }
        let (x, y) = (noise(1, 6, 4), noise(2, 6, 4));
        let all = Image::new(6, 4, 255u8);
        let loss = photometric(&x, &y, 0.2, Some(&all), Par::Seq).expect("fits");
        assert_eq!(loss.pixels, 0, "{by}: included");
        assert!(loss.value.abs() < 1e-300, "{by}: {}", loss.value);
        assert!(largest(&loss.gradient) < 1e-300, "{by}: gradient");
    }
}

/// Smooth shading, a hard edge and a flat dark part, with a render a little off: what training
/// sees. In f32 exactly, so that both widths are asked the same.
fn photograph(width: usize, height: usize) -> [Image<[f32; 3]>; 2] {
    let mut rng = Rng::new(6);
    let target = Image::from_fn(width, height, |x, y| {
        let (x, y) = (x as f64 / width as f64, y as f64 / height as f64);
        let shade = if x > 0.6 {
            0.05
        } else {
            0.3 + 0.4 * x + 0.2 * (9.0 * y).floor() / 9.0
        };
        [shade, 0.8 * shade, 1.0 - shade].map(|v| v.to_f32())
    });
    let rendered = target.map(|p| p.map(|v| v + (0.02 * rng.normal()).to_f32()));
    [rendered, target]
}

/// What f32 costs the value; measured 1.0e-6 on the sweep and 4.3e-7 on the reference.
const VALUE_F32: f64 = 3e-6;
/// What it costs the gradient, largest difference by largest value; measured 1.9e-4 and 1.2e-4,
/// where noise of variance 4e-4 is the difference of two numbers near 1.
const GRADIENT_F32: f64 = 4e-4;

/// The figures of `photometric`'s documentation.
#[test]
fn what_f32_costs() {
    let narrow = photograph(160, 120);
    let [x, y] = [0, 1].map(|k| narrow[k].map(|p| p.map(f64::from)));
    let exact = reference::photometric(&x, &y, 0.2, None, Par::Seq).expect("fits");
    for (by, _, photometric) in forms::<f32>() {
        let ours = photometric(&narrow[0], &narrow[1], 0.2, None, Par::Seq).expect("fits");
        let value = (f64::from(ours.value) - exact.value).abs();
        let pairs = ours.gradient.data().iter().zip(exact.gradient.data());
        let worst = pairs
            .flat_map(|(a, b)| [0, 1, 2].map(|k| (f64::from(a[k]) - b[k]).abs()))
            .fold(0.0, f64::max)
            / largest(&exact.gradient);
        assert!(value < VALUE_F32, "{by}: value off by {value:e}");
        assert!(
            worst > 0.0 && worst < GRADIENT_F32,
            "{by}: gradient off by {worst:e} of its largest"
        );
    }
}

/// A NaN in the render is one in the value, and in the gradient up to ten pixels away; under the
/// mask it has no effect.
#[test]
fn a_nan_stays_near_unless_it_is_masked() {
    let (w, h) = (48, 40);
    let (mut x, y) = (noise(1, w, h), noise(2, w, h));
    let clean = photometric(&x, &y, 0.2, None, Par::Seq).expect("fits");
    let at = (20, 17);
    x[at][1] = f64::NAN;
    for (by, _, photometric) in forms::<f64>() {
        let loss = photometric(&x, &y, 0.2, None, Par::Threads(2)).expect("fits");
        assert!(loss.value.is_nan(), "{by}: value");
        for (u, v) in (0..h).flat_map(|v| (0..w).map(move |u| (u, v))) {
            let g = loss.gradient[(u, v)];
            let near = u.abs_diff(at.0) <= 10 && v.abs_diff(at.1) <= 10;
            assert_eq!(g[1].is_nan(), near, "{by}: {u}, {v}");
            assert!(g[0].is_finite() && g[2].is_finite(), "{by}: other channels");
        }
        let mask = Image::from_fn(w, h, |u, v| if (u, v) == at { 255u8 } else { 0 });
        let masked = photometric(&x, &y, 0.2, Some(&mask), Par::Seq).expect("fits");
        assert!(masked.value.is_finite(), "{by}: masked");
        assert!(
            largest(&masked.gradient) < 2.0 * largest(&clean.gradient),
            "{by}: no NaN"
        );
        let finite = masked
            .gradient
            .data()
            .as_flattened()
            .iter()
            .all(|v| v.is_finite());
        assert!(finite, "{by}: masked");
    }
}

/// Value, and FNV-1a over the words of the gradient.
const PINNED: (u32, u64) = (1_027_320_677, 17_051_812_900_672_904_396);

/// The bits of one run, the same on every machine, with whatever lanes the compiler chooses.
#[test]
fn bits_are_pinned() {
    let [x, y] = photograph(61, 43);
    let mask = Image::from_fn(61, 43, |u, v| u8::from(u > 50 && v > 20));
    let loss = photometric(&x, &y, 0.2, Some(&mask), Par::Threads(2)).expect("fits");
    let numbers = loss.gradient.data().as_flattened().iter();
    let hash = numbers.fold(0xcbf2_9ce4_8422_2325u64, |hash, v| {
        (hash ^ u64::from(v.to_bits())).wrapping_mul(0x0100_0000_01b3)
    });
    assert_eq!((loss.value.to_bits(), hash), PINNED, "value and gradient");
}

#[test]
fn depth_gradients_are_derivatives_and_thin_places_are_left_out() {
    let depth = Image::from_vec(3, 1, vec![1.2f64, 0.5, 0.02]).expect("3 pixels");
    let opacity = Image::from_vec(3, 1, vec![0.8, 0.5, 0.01]).expect("3 pixels");
    let measured = Image::from_vec(3, 1, vec![1.0f32, 1.5, 1.0]).expect("3 pixels");
    let loss = depth_l1(&depth, &opacity, &measured, 0.1, None).expect("fits");
    // |1.5 - 1| and |1 - 1.5|; the opacity of the third is too small.
    assert_eq!(loss.pixels, 2, "included");
    assert!((loss.value - 0.5).abs() < 1e-15, "{}", loss.value);
    for (got, want) in loss.depth.data().iter().zip([0.5 / 0.8, -0.5 / 0.5, 0.0]) {
        assert!((got - want).abs() < 1e-15, "{got} against {want}");
    }
    for (got, want) in loss
        .opacity
        .data()
        .iter()
        .zip([-1.5 * 0.5 / 0.8, 0.5 / 0.5, 0.0])
    {
        assert!((got - want).abs() < 1e-15, "{got} against {want}");
    }
}

/// Expected depths 2, 4, 1 and 5 m for measured 3, 1, 2 and 1 m, by opacities of 0.5, 0.49, 0.8 and 0.6; any value of the mask but
/// 0 leaves a pixel out.
#[test]
fn the_least_opacity_on_both_sides() {
    let opacity = [0.5, 0.49, 0.8, 0.6];
    let depth: Vec<f64> = [2.0, 4.0, 1.0, 5.0]
        .iter()
        .zip(opacity)
        .map(|(z, o)| z * o)
        .collect();
    let depth = Image::from_vec(4, 1, depth).expect("4 pixels");
    let opacity = Image::from_vec(4, 1, opacity.to_vec()).expect("4 pixels");
    let measured = Image::from_vec(4, 1, vec![3.0f32, 1.0, 2.0, 1.0]).expect("4 pixels");
    let masked = Image::from_vec(4, 1, vec![0u8, 0, 0, 1]).expect("4 pixels");
    for (least, mask, pixels, value) in [
        (0.48, None, 4, (1.0 + 3.0 + 1.0 + 4.0) / 4.0),
        (0.5, None, 3, (1.0 + 1.0 + 4.0) / 3.0),
        (0.51, None, 2, (1.0 + 4.0) / 2.0),
        (0.81, None, 0, 0.0),
        (0.5, Some(&masked), 2, 1.0),
    ] {
        let loss = depth_l1(&depth, &opacity, &measured, least, mask).expect("fits");
        assert_eq!(loss.pixels, pixels, "from {least}");
        assert!(
            (loss.value - value).abs() < 1e-14,
            "from {least}: {}",
            loss.value
        );
        let slopes = loss.depth.data().iter().filter(|d| d.abs() > 0.0).count();
        assert_eq!(slopes, pixels, "from {least}");
    }
    for (least, valid) in [(1.0, true), (1.000_1, false), (0.0, false)] {
        let loss = depth_l1(&depth, &opacity, &measured, least, None);
        assert_eq!(loss.is_ok(), valid, "{least}");
    }
}

/// What a depth camera writes where it measures nothing, and the mask, are left out.
#[test]
fn missing_depths_are_left_out() {
    let measured = vec![
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        -1.0,
        0.0,
        2.0,
        3.0,
    ];
    let measured = Image::from_vec(7, 1, measured).expect("7 pixels");
    let (depth, opacity) = (Image::new(7, 1, 1.0f64), Image::new(7, 1, 1.0));
    let mask = Image::from_fn(7, 1, |x, _| if x == 6 { 255u8 } else { 0 });
    let loss = depth_l1(&depth, &opacity, &measured, 0.5, Some(&mask)).expect("fits");
    assert_eq!(loss.pixels, 1, "the sixth alone");
    assert!((loss.value - 1.0).abs() < 1e-15, "{}", loss.value);
    assert_eq!(
        loss.depth.data(),
        [0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        "by depth"
    );
    assert_eq!(
        loss.opacity.data(),
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        "by opacity"
    );
}

#[test]
fn wrong_sizes_and_weights_are_errors() {
    let (x, y) = (noise(1, 6, 4), noise(2, 4, 6));
    let wrong = |image| RasterError::SizeMismatch {
        image,
        expected: (6, 4),
        got: (4, 6),
    };
    assert_eq!(l1(&x, &y, None), Err(wrong("target")), "target");
    let mask = Image::new(4, 6, 0u8);
    assert_eq!(
        ssim(&x, &x, Some(&mask), Par::Seq),
        Err(wrong("excluded")),
        "mask"
    );
    for value in [-0.1, 1.1, f64::NAN] {
        let lambda = photometric(&x, &x, value, None, Par::Seq);
        assert!(matches!(lambda, Err(RasterError::Lambda { .. })), "{value}");
        let (plane, metres) = (Image::new(2, 2, 0.5f64), Image::new(2, 2, 1.0f32));
        let least = depth_l1(&plane, &plane, &metres, value, None);
        assert!(
            matches!(least, Err(RasterError::MinOpacity { .. })),
            "{value}"
        );
    }
    let short = opacity_penalty(&[0.0f64, 1.0], &[Label::Dynamic], None);
    assert!(
        matches!(short, Err(RasterError::MapLength { array: "label", .. })),
        "{short:?}"
    );
}
