//! The mean field over labels, all pairs (eq. 1, 4 to 6; C2).

use crate::Error;
use crate::case::{Answer, Case};
use crate::gpu::Gpu;
use crate::sums;

/// More nodes than this have too many labellings to try them all.
const ENUMERATED: usize = 12;

fn code(word: &str, words: &[&str]) -> Result<u32, Error> {
    let found = words.iter().position(|w| *w == word);
    found
        .map(|i| i as u32)
        .ok_or_else(|| format!("none of {words:?}: {word}"))
}

pub fn stage(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let [p, uv, reproj, observations] =
        ["p_world", "uv_px", "reproj_px", "observations"].map(|name| case.singles(name));
    let (p, uv, reproj, observations) = (p?, uv?, reproj?, observations?);
    let n = reproj.len();
    // The GPU has no NaN: what a node lacks is 0, with a flag.
    let known = |values: &[f32]| f32::from(u8::from(values.iter().all(|v| v.is_finite())));
    let or_zero = |v: f32| if v.is_finite() { v } else { 0.0 };
    let node = |i: usize| {
        let [pixel, features] = [&uv[2 * i..2 * i + 2], &[reproj[i], observations[i]]];
        [
            [p[3 * i], p[3 * i + 1], p[3 * i + 2], known(pixel)],
            [or_zero(pixel[0]), or_zero(pixel[1]), known(features), 0.0],
            [or_zero(features[0]), or_zero(features[1]), 0.0, 0.0],
        ]
    };
    let nodes = gpu.upload(&(0..n).flat_map(node).collect::<Vec<_>>());

    let scale = |name: &str| {
        let sigma = case.number(name)?;
        Ok::<_, Error>((0.5 / (sigma * sigma)) as f32)
    };
    let normalisation = code(case.word("normalisation")?, &["none", "rows", "symmetric"])?;
    let terms = case.word("terms")?;
    let settings = gpu.upload(&[
        n as u32,
        case.single("feature_weight")?.to_bits(),
        case.single("position_weight")?.to_bits(),
        scale("sigma_reproj_px")?.to_bits(),
        scale("sigma_observations")?.to_bits(),
        scale("sigma_m")?.to_bits(),
        scale("sigma_px")?.to_bits(),
        code(case.word("distance")?, &["squared", "linear"])?,
        u32::from(terms != "pixel"),
        u32::from(terms != "space"),
        u32::from(case.switch("self_message")?),
        normalisation,
        case.single("damping")?.to_bits(),
    ]);
    let counts: Vec<usize> = case
        .word("iterations")?
        .split(' ')
        .map(|c| c.parse().map_err(|e| format!("iterations: {e}")))
        .collect::<Result<_, _>>()?;

    let groups = [n.div_ceil(256), 1];
    let norms = gpu.zeros(2 * n);
    gpu.run("field/row_sums", &[&settings, &nodes, &norms], groups);
    let log_odds = gpu.upload(&case.singles("log_odds")?);
    let [mut now, mut next] = [gpu.zeros(n), gpu.zeros(n)];
    gpu.run_over("field/begin", &[&settings, &now, &log_odds], n);
    let mut answers = Vec::new();
    for iteration in 0..=counts.iter().copied().max().unwrap_or(0) {
        if iteration > 0 {
            let buffers = [&settings, &nodes, &norms, &log_odds, &now, &next];
            gpu.run("field/update", &buffers, groups);
            std::mem::swap(&mut now, &mut next);
        }
        if counts.contains(&iteration) {
            answers.extend(gpu.read::<f32>(&now, n)?);
        }
    }
    let mut out = Answer::default();
    let last = &answers[answers.len() - n..];
    let labels: Vec<u8> = last.iter().map(|&q| u8::from(q > 0.5)).collect();
    out.put("labels", &[n], labels);
    out.put("q", &[counts.len(), n], answers);

    // Couplings without a norm are symmetric, so that labellings have an energy.
    if normalisation == 0 && n <= ENUMERATED {
        let [coupling, energies, best, weights, free] =
            [n * n, 1 << n, 2, (1 << n) * (n + 1), n].map(|words| gpu.zeros(words));
        gpu.run_over(
            "field/couple",
            &[&settings, &nodes, &coupling],
            n.div_ceil(4),
        );
        let buffers = [&settings, &coupling, &log_odds, &energies];
        gpu.run_over("field/energy", &buffers, 1 << n);
        gpu.run("field/lowest", &[&settings, &energies, &best], [1, 1]);
        let buffers = [&settings, &energies, &best, &weights];
        gpu.run_over("field/weigh", &buffers, 1 << n);
        let buffers = [&settings, &coupling, &log_odds, &now, &free];
        gpu.run_over("field/free_energy", &buffers, n);
        let found = gpu.read::<f32>(&best, 2)?;
        let sums_of = sums::columns(gpu, &weights, 1 << n, n + 1);
        let totals = gpu.read::<f32>(&sums_of, n + 1)?;
        let labelling = found[1] as usize;
        let map: Vec<u8> = (0..n).map(|i| (labelling >> i & 1) as u8).collect();
        out.put("map", &[n], map);
        out.put("map_energy", &[1], vec![found[0]]);
        #[allow(
            clippy::disallowed_methods,
            reason = "one number, compared within a tolerance"
        )]
        let log_total = totals[0].ln();
        out.put("log_z", &[1], vec![log_total - found[0]]);
        let marginals: Vec<f32> = totals[1..].iter().map(|t| t / totals[0]).collect();
        out.put("marginals", &[n], marginals);
        out.put("free_energy", &[1], vec![sums::total(gpu, &free, n)?]);
    }
    Ok(out)
}
