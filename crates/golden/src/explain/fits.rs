//! The right numbers but for a factor, an offset or a function.

use super::suspect::Suspect;

/// Factors of usual mistakes: signs, halves, squares of two, degrees.
const FACTORS: [(f64, &str); 8] = [
    (-1.0, "the sign"),
    (2.0, "a factor of 2"),
    (0.5, "a factor of 1/2"),
    (-2.0, "a factor of -2"),
    (-0.5, "a factor of -1/2"),
    (4.0, "a factor of 4"),
    (0.25, "a factor of 1/4"),
    (180.0 / std::f64::consts::PI, "degrees instead of radians"),
];

/// Offsets of usual mistakes.
const OFFSETS: [(f64, &str); 4] = [
    (0.5, "half a unit too much: pixel centres at 0.5?"),
    (-0.5, "half a unit too little: pixel centres at 0.5?"),
    (1.0, "one too much"),
    (-1.0, "one too little"),
];

/// A free number per column is fitted from this many rows on.
const ROWS_TO_FIT: usize = 4;
/// A free factor nearer to 1 than this explains nothing.
const LEAST_FACTOR: f64 = 1e-2;
/// An offset smaller than this share of the largest number explains nothing.
const LEAST_OFFSET: f64 = 5e-3;
/// Columns beyond this are not looked at one by one.
const MAX_COLUMNS: usize = 16;

/// Tries factors, offsets and functions.
pub(super) fn find(s: &Suspect<'_>) -> Option<String> {
    whole_factor(s)
        .or_else(|| whole_offset(s))
        .or_else(|| functions(s))
        .or_else(|| column_factors(s))
        .or_else(|| column_offsets(s))
}

fn whole_factor(s: &Suspect<'_>) -> Option<String> {
    FACTORS
        .iter()
        .find_map(|(factor, name)| s.named(name, &s.map(|_, g| g / factor)))
}

fn whole_offset(s: &Suspect<'_>) -> Option<String> {
    OFFSETS
        .iter()
        .find_map(|(offset, name)| s.named(name, &s.map(|_, g| g - offset)))
}

fn functions(s: &Suspect<'_>) -> Option<String> {
    let sigmoid = |v: f64| 1.0 / (1.0 + libm::exp(-v));
    let logit = |v: f64| libm::log(v / (1.0 - v));
    let list: [(&str, &dyn Fn(f64) -> f64); 8] = [
        ("the logit instead of the value in [0, 1]", &sigmoid),
        ("the value in [0, 1] instead of its logit", &logit),
        ("the logarithm instead of the value", &libm::exp),
        ("the value instead of its logarithm", &libm::log),
        (
            "one minus the value: opacity instead of transmittance?",
            &|v| 1.0 - v,
        ),
        ("the inverse of the value", &|v| 1.0 / v),
        ("the square of the value", &libm::sqrt),
        ("the root of the value", &|v| v * v),
    ];
    list.into_iter()
        .find_map(|(name, f)| s.named(name, &s.map(|_, g| f(g))))
}

/// What each column of the answer is too much by: a factor.
fn column_factors(s: &Suspect<'_>) -> Option<String> {
    let n = s.columns();
    if n > MAX_COLUMNS || s.rows() < 2 {
        return None;
    }
    let factors: Vec<f64> = (0..n)
        .map(|c| {
            let (mut eg, mut ee) = (0.0, 0.0);
            for (e, g) in s.expected.iter().zip(s.got).skip(c).step_by(n) {
                eg += e * g;
                ee += e * e;
            }
            let free = if ee > 0.0 { eg / ee } else { 1.0 };
            let known = FACTORS
                .iter()
                .map(|f| f.0)
                .find(|f| (free / f - 1.0).abs() < 1e-2);
            let far = free.abs() > 1e-6 && (free - 1.0).abs() > LEAST_FACTOR;
            let fallback = if s.rows() >= ROWS_TO_FIT && far {
                free
            } else {
                1.0
            };
            known.unwrap_or(fallback)
        })
        .collect();
    let fixed = s.map(|i, g| g / factors[i % n]);
    describe(s, &fixed, &factors, 1.0, |factor| {
        let known = FACTORS
            .iter()
            .find(|(f, _)| (factor / f - 1.0).abs() < 1e-9);
        known.map_or(format!("a factor of {factor:.6}"), |(_, name)| {
            (*name).to_owned()
        })
    })
}

/// What each column of the answer is too much by: a number of its unit.
fn column_offsets(s: &Suspect<'_>) -> Option<String> {
    let n = s.columns();
    if n > MAX_COLUMNS || s.rows() < 2 {
        return None;
    }
    let rows = s.rows() as f64;
    let offsets: Vec<f64> = (0..n)
        .map(|c| {
            let pairs = s.expected.iter().zip(s.got).skip(c).step_by(n);
            let free = pairs.map(|(e, g)| g - e).sum::<f64>() / rows;
            let known = OFFSETS
                .iter()
                .map(|o| o.0)
                .find(|o| (free - o).abs() < 1e-3);
            known.unwrap_or(if s.rows() >= ROWS_TO_FIT { free } else { 0.0 })
        })
        .collect();
    let fixed = s.map(|i, g| g - offsets[i % n]);
    let largest = s.expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let small = |o: &f64| *o != 0.0 && o.abs() < LEAST_OFFSET * largest;
    if offsets.iter().any(small) {
        return None;
    }
    let centers = centers(s);
    describe(s, &fixed, &offsets, 0.0, |offset| {
        let known = OFFSETS.iter().find(|(o, _)| (offset - o).abs() < 1e-9);
        let center = centers.iter().find(|(c, _)| (offset - c).abs() < 1e-3);
        match (known, center) {
            (Some((_, name)), _) => (*name).to_owned(),
            (None, Some((_, name))) => format!("{offset:.6}: {name}"),
            (None, None) => format!("a constant of {offset:.6}"),
        }
    })
}

/// What pixels are too much by if the principal point is put elsewhere.
fn centers(s: &Suspect<'_>) -> Vec<(f64, &'static str)> {
    let size = ["width", "height"].map(|name| s.case.inputs().number(name));
    let k = s.case.inputs().row::<4>("intrinsics");
    let ([Ok(width), Ok(height)], Ok([_, _, cx, cy])) = (size, k) else {
        return Vec::new();
    };
    let pairs = [(width, cx), (height, cy)];
    let named = pairs.into_iter().flat_map(|(n, c)| {
        [
            (-c, "the principal point is not added"),
            (
                (n - 1.0) / 2.0 - c,
                "the principal point is put into the middle",
            ),
            (
                n / 2.0 - c,
                "the principal point is put into the middle, half a pixel off",
            ),
        ]
    });
    named.collect()
}

/// Names the columns whose number is not the neutral one.
fn describe(
    s: &Suspect<'_>,
    fixed: &[f64],
    numbers: &[f64],
    neutral: f64,
    word: impl Fn(f64) -> String,
) -> Option<String> {
    if !(s.passes)(fixed) {
        return None;
    }
    let odd: Vec<usize> = (0..numbers.len())
        .filter(|&c| (numbers[c] - neutral).abs() > 1e-4)
        .collect();
    match *odd.as_slice() {
        [] => None,
        _ if numbers.len() == 1 => Some(word(numbers[0])),
        _ => {
            let words: Vec<String> = odd
                .iter()
                .map(|&c| format!("component {c}: {}", word(numbers[c])))
                .collect();
            Some(words.join("; "))
        }
    }
}
