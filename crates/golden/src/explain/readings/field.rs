//! Kernels, mean field and robust kernels with one mistake: docs/math_crf.md, eq. 4 to 6.

use super::{MAX_TERMS, Reading};
use crate::explain::suspect::Suspect;
use crate::inputs::{InputError, Inputs};

/// What a kernel and the field are computed from; a mistake changes one of it.
#[derive(Debug, Clone)]
struct Model {
    p: Vec<[f64; 3]>,
    uv: Vec<[f64; 2]>,
    reproj_px: Vec<f64>,
    observations: Vec<f64>,
    /// σ of reprojection, observations, metres, pixels.
    sigma: [f64; 4],
    /// The denominator of the exponent by σ.
    denominator: fn(f64) -> f64,
    linear: bool,
    terms: &'static str,
    missing_is_far: bool,
    weights: [f64; 2],
    normalisation: &'static str,
    self_message: bool,
    damping: f64,
    log_odds: Vec<f64>,
    counts: Vec<usize>,
    sign: f64,
    /// The message of a node by its q.
    message: fn(f64) -> f64,
    in_place: bool,
    start_even: bool,
    one_less: bool,
}

const DISTANCES: [(&str, bool); 2] = [("squared", false), ("linear", true)];
const TERMS: [(&str, &str); 3] = [("both", "both"), ("space", "space"), ("pixel", "pixel")];
const NORMALISATIONS: [(&str, &str); 3] = [
    ("rows", "rows"),
    ("symmetric", "symmetric"),
    ("none", "none"),
];

type Change = fn(&mut Model);

/// Of the kernels.
const KERNEL_SLIPS: &[(&str, Change)] = &[
    (
        "the exponent is divided by σ², not by 2σ² (eq. 5, 6)",
        |m| m.denominator = |s| s * s,
    ),
    (
        "the exponent is divided by 2σ, not by 2σ² (eq. 5, 6)",
        |m| m.denominator = |s| 2.0 * s,
    ),
    (
        "the exponent is divided by σ, not by 2σ² (eq. 5, 6)",
        |m| m.denominator = |s| s,
    ),
    (
        "the distances are read otherwise: `distance` says whether they are squared",
        |m| m.linear = !m.linear,
    ),
    (
        "the second kernel has both terms; `terms` says which",
        |m| m.terms = "both",
    ),
    (
        "the second kernel has the term of space only; `terms` says which",
        |m| m.terms = "space",
    ),
    (
        "the second kernel has the term of pixels only; `terms` says which",
        |m| m.terms = "pixel",
    ),
    (
        "a pair with a missing pixel has no second kernel; with `terms` both it keeps the term of space",
        |m| m.missing_is_far = true,
    ),
    ("σ of metres and of pixels are exchanged", |m| {
        m.sigma.swap(2, 3);
    }),
    (
        "σ of the reprojection error and of the observations are exchanged",
        |m| m.sigma.swap(0, 1),
    ),
];

/// Of the field alone.
const FIELD_SLIPS: &[(&str, Change)] = &[
    (
        "the field is updated in place; every node is updated from the q of the iteration before",
        |m| m.in_place = true,
    ),
    ("the message of a node is q, not 2q - 1", |m| {
        m.message = |q| q;
    }),
    ("the message of a node is 1 - q, not 2q - 1", |m| {
        m.message = |q| 1.0 - q;
    }),
    (
        "the kernels are normalised by rows; `normalisation` says how",
        |m| m.normalisation = "rows",
    ),
    (
        "the kernels are normalised symmetrically, by the roots of both rows; `normalisation` says how",
        |m| m.normalisation = "symmetric",
    ),
    (
        "the kernels are not normalised; `normalisation` says how",
        |m| m.normalisation = "none",
    ),
    (
        "the message of a node to itself is taken otherwise: `self_message` says whether it counts",
        |m| m.self_message = !m.self_message,
    ),
    (
        "damping is left out: q is damping times the old q plus (1 - damping) times the new one",
        |m| m.damping = 0.0,
    ),
    (
        "damping is the share of the new q; it is that of the old one",
        |m| m.damping = 1.0 - m.damping,
    ),
    (
        "the messages have the other sign: equal labels attract each other",
        |m| m.sign = -1.0,
    ),
    ("the two weights of the kernels are exchanged", |m| {
        m.weights.swap(0, 1);
    }),
    ("the weights of the kernels are left out", |m| {
        m.weights = [1.0; 2];
    }),
    ("the field starts at 1/2; it starts at σ(log_odds)", |m| {
        m.start_even = true;
    }),
    ("one iteration less than asked; count 0 is the start", |m| {
        m.one_less = true
    }),
];

fn sigmoid(x: f64) -> f64 {
    let e = libm::exp(-x.abs());
    (if x >= 0.0 { 1.0 } else { e }) / (1.0 + e)
}

impl Model {
    fn read(inputs: &Inputs) -> Result<Self, InputError> {
        let n = |name| inputs.number(name);
        let counts = inputs.word("iterations").unwrap_or_default();
        Ok(Self {
            p: inputs.rows("p_world")?,
            uv: inputs.rows("uv_px")?,
            reproj_px: inputs.reals("reproj_px")?,
            observations: inputs.reals("observations")?,
            sigma: [
                n("sigma_reproj_px")?,
                n("sigma_observations")?,
                n("sigma_m")?,
                n("sigma_px")?,
            ],
            denominator: |s| 2.0 * s * s,
            linear: inputs.choice("distance", &DISTANCES)?,
            terms: inputs.choice("terms", &TERMS)?,
            missing_is_far: false,
            weights: [n("feature_weight")?, n("position_weight")?],
            normalisation: inputs.choice("normalisation", &NORMALISATIONS)?,
            self_message: inputs.switch("self_message")?,
            damping: n("damping").unwrap_or(0.0),
            log_odds: inputs.reals("log_odds").unwrap_or_default(),
            counts: counts.split(' ').filter_map(|c| c.parse().ok()).collect(),
            sign: 1.0,
            message: |q| 2.0 * q - 1.0,
            in_place: false,
            start_even: false,
            one_less: false,
        })
    }

    /// Both kernels of all pairs, row by row.
    fn kernels(&self) -> [Vec<f64>; 2] {
        let [reproj, seen, metres, pixels] = self.sigma.map(self.denominator);
        let square = |a: f64, b: f64| (a - b) * (a - b);
        let kernel = |x: f64| if x.is_nan() { 0.0 } else { libm::exp(-x) };
        let n = self.p.len();
        let mut both = [Vec::new(), Vec::new()];
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            both[0].push(kernel(
                square(self.reproj_px[i], self.reproj_px[j]) / reproj
                    + square(self.observations[i], self.observations[j]) / seen,
            ));
            let mut space: f64 = (0..3).map(|k| square(self.p[i][k], self.p[j][k])).sum();
            let mut pixel: f64 = (0..2).map(|k| square(self.uv[i][k], self.uv[j][k])).sum();
            match self.terms {
                "space" => pixel = 0.0,
                "pixel" => space = 0.0,
                _ if pixel.is_nan() && !self.missing_is_far => pixel = 0.0,
                _ => {}
            }
            if self.linear {
                (space, pixel) = (space.sqrt(), pixel.sqrt());
            }
            both[1].push(kernel(space / metres + pixel / pixels));
        }
        both
    }

    /// q after each count of iterations.
    fn field(&self) -> Vec<Vec<f64>> {
        let n = self.log_odds.len();
        let mut coupling = vec![0.0; n * n];
        for (mut k, weight) in self.kernels().into_iter().zip(self.weights) {
            if !self.self_message {
                (0..n).for_each(|i| k[i * n + i] = 0.0);
            }
            let inverse = |row: &[f64]| match row.iter().sum::<f64>() {
                sum if sum > 0.0 => 1.0 / sum,
                _ => 0.0,
            };
            let inverse: Vec<f64> = k.chunks(n).map(inverse).collect();
            for (at, k) in k.iter().enumerate() {
                let norm = match self.normalisation {
                    "rows" => inverse[at / n],
                    "symmetric" => (inverse[at / n] * inverse[at % n]).sqrt(),
                    _ => 1.0,
                };
                coupling[at] += weight * k * norm;
            }
        }
        let start = |u: &f64| if self.start_even { 0.5 } else { sigmoid(*u) };
        let mut q: Vec<f64> = self.log_odds.iter().map(start).collect();
        let (mut all, mut done) = (Vec::new(), 0);
        for &count in &self.counts {
            while done < count.saturating_sub(usize::from(self.one_less)) {
                let before = q.clone();
                for i in 0..n {
                    let read = if self.in_place { &q } else { &before };
                    let terms = coupling[i * n..].iter().zip(read);
                    let heard: f64 = terms.map(|(c, q)| c * (self.message)(*q)).sum();
                    let new = sigmoid(self.log_odds[i] + self.sign * heard);
                    q[i] = (1.0 - self.damping) * new + self.damping * q[i];
                }
                done += 1;
            }
            all.push(q.clone());
        }
        all
    }
}

/// The model with each mistake.
fn changed<'a>(
    model: &'a Model,
    slips: &'a [(&'static str, Change)],
) -> impl Iterator<Item = (&'static str, Model)> + 'a {
    slips.iter().map(|(name, change)| {
        let mut other = model.clone();
        change(&mut other);
        (*name, other)
    })
}

/// Of `kernel`.
pub(super) fn kernel(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let model = Model::read(s.case.inputs()).ok()?;
    let which = usize::from(match s.output {
        "k1" => false,
        "k2" => true,
        _ => return None,
    });
    let n = model.p.len();
    let [k1, k2] = model.kernels();
    let other = if which == 0 { k2 } else { k1 };
    let diagonal = s.expected.iter().enumerate();
    let diagonal = diagonal.map(|(at, k)| if at % (n + 1) == 0 { 0.0 } else { *k });
    let fixed = [
        ("k1 and k2 are exchanged", other),
        (
            "the kernel of a node with itself is 0; it is 1",
            diagonal.collect(),
        ),
    ];
    let slips = changed(&model, KERNEL_SLIPS);
    let slips = slips.map(|(name, model)| (name, model.kernels()[which].clone()));
    Some(slips.chain(fixed).collect())
}

/// Of `mean_field`.
pub(super) fn mean_field(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let model = Model::read(s.case.inputs()).ok()?;
    // Labels agree by chance with many mistakes.
    if s.output != "q" || model.p.len().pow(2) > MAX_TERMS {
        return None;
    }
    let slips = changed(&model, FIELD_SLIPS).chain(changed(&model, KERNEL_SLIPS));
    Some(
        slips
            .map(|(name, model)| (name, model.field().concat()))
            .collect(),
    )
}

/// Value and slope of a robust kernel at the squared norm s.
fn robust_kernel(kernel: &str, scale: f64, s: f64) -> Option<[f64; 2]> {
    let c2 = scale * scale;
    let x = s / c2;
    Some(match kernel {
        "huber" if s <= c2 => [s, 1.0],
        "huber" => [2.0 * scale * s.sqrt() - c2, scale / s.sqrt()],
        "cauchy" => [c2 * libm::log1p(x), 1.0 / (1.0 + x)],
        "geman_mcclure" => [s / (1.0 + x), 1.0 / ((1.0 + x) * (1.0 + x))],
        "tukey" if s <= c2 => {
            let rest = 1.0 - x;
            // 1 - (1 - x)³ without cancellation.
            [c2 / 3.0 * x * (3.0 - 3.0 * x + x * x), rest * rest]
        }
        "tukey" => [c2 / 3.0, 0.0],
        _ => return None,
    })
}

/// Of `robust`.
pub(super) fn robust(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let inputs = s.case.inputs();
    let (kernel, scale) = (inputs.word("kernel").ok()?, inputs.number("scale").ok()?);
    let which = match s.output {
        "rho" => 0,
        "weight" => 1,
        _ => return None,
    };
    let squared = inputs.reals("s").ok()?;
    let with = |scale: f64, of: fn(f64) -> f64| -> Option<Vec<f64>> {
        let values = squared.iter();
        values
            .map(|s| Some(robust_kernel(kernel, scale, of(*s))?[which]))
            .collect()
    };
    let beyond = |change: fn(f64, f64) -> f64| -> Vec<f64> {
        let pairs = squared.iter().zip(s.expected);
        let outside = |s: f64| kernel == "huber" && s > scale * scale;
        pairs
            .map(|(s, e)| if outside(*s) { change(*e, scale) } else { *e })
            .collect()
    };
    let mut all = vec![
        (
            "the scale is not squared: s is compared with c, not with c²",
            with(scale.sqrt(), |s| s)?,
        ),
        (
            "the scale is squared twice: s is compared with c⁴, not with c²",
            with(scale * scale, |s| s)?,
        ),
        (
            "s is squared once more: it is already the squared norm",
            with(scale, |s| s * s)?,
        ),
        (
            "the norm is taken for s; s is the squared norm",
            with(scale, f64::sqrt)?,
        ),
        ("no robust kernel: the squared norm itself", {
            let plain = |s: &f64| if which == 0 { *s } else { 1.0 };
            squared.iter().map(plain).collect()
        }),
    ];
    if which == 0 {
        let lost = "beyond the knee - δ² is missing: 2δ√s - δ²";
        all.push((lost, beyond(|e, d| e + d * d)));
        let half = "beyond the knee δ(√s - δ/2), half of 2δ√s - δ²";
        all.push((half, beyond(|e, _| e / 2.0)));
    } else {
        let half = "beyond the knee half of the weight δ/√s";
        all.push((half, beyond(|e, _| e / 2.0)));
        let root = "the root of the weight beyond the knee: √(δ/√s)";
        all.push((root, beyond(|e, _| e.sqrt())));
        let square = "the square of the weight beyond the knee";
        all.push((square, beyond(|e, _| e * e)));
    }
    Some(all)
}
