//! Adam, SSIM and the photometric loss with one mistake.

use super::Reading;
use crate::explain::suspect::Suspect;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Adam {
    NoCorrection,
    ConstantCorrection,
    FirstOnly,
    SecondOnly,
    EpsilonInRoot,
    EpsilonScaled,
    BetasExchanged,
    Ascends,
    RateHeld,
}

const ADAM: &[(Adam, &str)] = &[
    (
        Adam::NoCorrection,
        "the bias correction of both moments is missing",
    ),
    (
        Adam::ConstantCorrection,
        "the bias correction is that of the first step at every step",
    ),
    (
        Adam::FirstOnly,
        "the bias correction of the second moment is missing",
    ),
    (
        Adam::SecondOnly,
        "the bias correction of the first moment is missing",
    ),
    (
        Adam::EpsilonInRoot,
        "eps is added inside of the root; √v + eps",
    ),
    (
        Adam::EpsilonScaled,
        "eps is added before the bias correction of the second moment; √(v/(1 - β₂ᵗ)) + eps",
    ),
    (Adam::BetasExchanged, "beta1 and beta2 are exchanged"),
    (Adam::Ascends, "the steps go uphill: the step is subtracted"),
    (
        Adam::RateHeld,
        "the learning rate of the first step at every step",
    ),
];

/// Of `adam`. Rows that are not there at a step are as expected.
pub(super) fn adam(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let inputs = s.case.inputs();
    let number = |name| inputs.number(name).ok();
    let betas = [number("beta1")?, number("beta2")?];
    let eps = number("eps")?;
    let reals = |name| inputs.reals(name).ok();
    let (start, rates) = (reals("start")?, reals("learning_rates")?);
    let gradients = reals("gradients")?;
    let n = start.len();
    if s.output != "path" || s.expected.len() != n * rates.len() {
        return None;
    }
    let path = |slip: Adam| -> Vec<f64> {
        let [b1, b2] = match slip {
            Adam::BetasExchanged => [betas[1], betas[0]],
            _ => betas,
        };
        let (mut x, mut m, mut v) = (start.clone(), vec![0.0; n], vec![0.0; n]);
        let (mut p1, mut p2) = (1.0, 1.0);
        let mut path = Vec::new();
        for (t, rate) in rates.iter().enumerate() {
            (p1, p2) = (p1 * b1, p2 * b2);
            let (c1, c2) = match slip {
                Adam::NoCorrection => (1.0, 1.0),
                Adam::ConstantCorrection => (1.0 - b1, 1.0 - b2),
                Adam::FirstOnly => (1.0 - p1, 1.0),
                Adam::SecondOnly => (1.0, 1.0 - p2),
                _ => (1.0 - p1, 1.0 - p2),
            };
            let rate = if slip == Adam::RateHeld {
                rates[0]
            } else {
                *rate
            };
            for i in 0..n {
                let expected = s.expected[t * n + i];
                if expected.is_nan() {
                    path.push(expected);
                    continue;
                }
                let g = gradients[t * n + i];
                m[i] = b1 * m[i] + (1.0 - b1) * g;
                v[i] = b2 * v[i] + (1.0 - b2) * g * g;
                let below = match slip {
                    Adam::EpsilonInRoot => (v[i] / c2 + eps).sqrt(),
                    Adam::EpsilonScaled => (v[i].sqrt() + eps) / c2.sqrt(),
                    _ => (v[i] / c2).sqrt() + eps,
                };
                let step = rate * (m[i] / c1) / below;
                x[i] -= if slip == Adam::Ascends { -step } else { step };
                path.push(x[i]);
            }
        }
        path
    };
    Some(
        ADAM.iter()
            .map(|&(slip, name)| (name, path(slip)))
            .collect(),
    )
}

/// Beyond the edge of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Edge {
    Zeros,
    Reflects,
    Repeats,
}

/// How SSIM and the loss are computed.
#[derive(Debug, Clone, Copy)]
struct Ssim {
    half: isize,
    sigma: f64,
    edge: Edge,
    /// Largest value of a pixel, for the constants.
    range: f64,
    halved: bool,
    exchanged: bool,
    sum: bool,
    unbiased: bool,
}

const RIGHT: Ssim = Ssim {
    half: 5,
    sigma: 1.5,
    edge: Edge::Zeros,
    range: 1.0,
    halved: false,
    exchanged: false,
    sum: false,
    unbiased: false,
};

#[rustfmt::skip]
const SSIM: &[(Ssim, &str)] = &[
    (Ssim { sigma: f64::INFINITY, ..RIGHT }, "SSIM's window is flat; it is a Gaussian of 1.5 px"),
    (Ssim { half: 6, ..RIGHT }, "SSIM's window has 13 x 13 pixels; 11 x 11"),
    (Ssim { half: 4, ..RIGHT }, "SSIM's window has 9 x 9 pixels; 11 x 11"),
    (Ssim { half: 3, ..RIGHT }, "SSIM's window has 7 x 7 pixels; 11 x 11"),
    (Ssim { half: 3, sigma: f64::INFINITY, ..RIGHT }, "SSIM's window is flat with 7 x 7 pixels; a Gaussian of 1.5 px on 11 x 11"),
    (Ssim { sigma: 1.0, ..RIGHT }, "SSIM's window has a sigma of 1 px; 1.5 px"),
    (Ssim { edge: Edge::Reflects, ..RIGHT }, "SSIM reflects the image at its edges; outside are zeros"),
    (Ssim { edge: Edge::Repeats, ..RIGHT }, "SSIM repeats the pixels at the edges; outside are zeros"),
    (Ssim { range: 255.0, ..RIGHT }, "SSIM's constants are those of bytes, 0.01 x 255; the range is 1"),
    (Ssim { unbiased: true, ..RIGHT }, "SSIM's variances are divided by n - 1"),
    (Ssim { halved: true, ..RIGHT }, "the loss is (1 - SSIM)/2; it is 1 - SSIM"),
    (Ssim { exchanged: true, ..RIGHT }, "lambda and 1 - lambda are exchanged"),
    (Ssim { sum: true, ..RIGHT }, "sums instead of means over the pixels"),
];

/// Smoothed along both axes.
fn smooth(a: &[f64], (width, height): (usize, usize), how: Ssim) -> Vec<f64> {
    let weight = |d: isize| libm::exp(-((d * d) as f64) / (2.0 * how.sigma * how.sigma));
    let weights: Vec<f64> = (-how.half..=how.half).map(weight).collect();
    let total: f64 = weights.iter().sum();
    let along = |a: &[f64], axis: usize| -> Vec<f64> {
        let (n, step) = ([width, height][axis].cast_signed(), [1, width][axis]);
        let inside = |i: isize| match how.edge {
            Edge::Reflects if n > 1 => {
                let i = i.rem_euclid(2 * (n - 1));
                Some(i.min(2 * (n - 1) - i))
            }
            Edge::Repeats => Some(i.clamp(0, n - 1)),
            _ => (0..n).contains(&i).then_some(i),
        };
        let at = |k: usize| {
            let place = [k % width, k / width][axis];
            let terms = (-how.half..=how.half).zip(&weights).map(|(d, w)| {
                let from = inside(place.cast_signed() + d);
                let value = from.map_or(0.0, |i| a[k - place * step + i.cast_unsigned() * step]);
                w / total * value
            });
            terms.sum()
        };
        (0..width * height).map(at).collect()
    };
    along(&along(a, 0), 1)
}

/// Of `losses`: the values of SSIM and of the photometric loss.
pub(super) fn losses(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let inputs = s.case.inputs();
    let kind = inputs.word("loss").ok()?;
    if s.output != "value" || !["ssim", "photometric"].contains(&kind) {
        return None;
    }
    let lambda = inputs.number("lambda").ok()?;
    let size = inputs.size("rendered").ok()?;
    let (x, y) = (inputs.reals("rendered").ok()?, inputs.reals("target").ok()?);
    let keep: Vec<bool> = match inputs.get("excluded") {
        Some(mask) => mask.f64().iter().map(|v| *v <= 0.0).collect(),
        None => vec![true; size.0 * size.1],
    };
    let value = |how: Ssim| -> f64 {
        let (c1, c2) = (1e-4 * how.range * how.range, 9e-4 * how.range * how.range);
        let (mut similar, mut apart, mut n) = (0.0, 0.0, 0.0);
        for c in 0..3 {
            let b: Vec<f64> = y.iter().skip(c).step_by(3).copied().collect();
            let a = x.iter().skip(c).step_by(3).zip(&b).zip(&keep);
            let a: Vec<f64> = a.map(|((a, b), k)| if *k { *a } else { *b }).collect();
            let of = |f: fn(f64, f64) -> f64| {
                let both: Vec<f64> = a.iter().zip(&b).map(|(a, b)| f(*a, *b)).collect();
                smooth(&both, size, how)
            };
            let (ma, mb) = (of(|a, _| a), of(|_, b| b));
            let (aa, bb, ab) = (of(|a, _| a * a), of(|_, b| b * b), of(|a, b| a * b));
            let taps = (2 * how.half + 1) as f64;
            let more = if how.unbiased {
                taps * taps / (taps * taps - 1.0)
            } else {
                1.0
            };
            for k in (0..a.len()).filter(|&k| keep[k]) {
                let (va, vb) = (aa[k] - ma[k] * ma[k], bb[k] - mb[k] * mb[k]);
                let both = more * (ab[k] - ma[k] * mb[k]);
                let above = (2.0 * ma[k] * mb[k] + c1) * (2.0 * both + c2);
                let below = (ma[k] * ma[k] + mb[k] * mb[k] + c1) * (more * (va + vb) + c2);
                similar += above / below;
                apart += (a[k] - b[k]).abs();
                n += 1.0;
            }
        }
        if !how.sum {
            (similar, apart) = (similar / n, apart / n);
        }
        let one = if how.sum { n } else { 1.0 };
        if kind == "ssim" {
            return similar;
        }
        let lambda = if how.exchanged { 1.0 - lambda } else { lambda };
        let half = if how.halved { 0.5 } else { 1.0 };
        (1.0 - lambda) * apart + lambda * half * (one - similar)
    };
    Some(
        SSIM.iter()
            .map(|&(how, name)| (name, vec![value(how)]))
            .collect(),
    )
}
