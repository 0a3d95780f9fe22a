//! Adam (O6) over a table of numbers with one rate per column.

use crate::Error;
use crate::case::{Answer, Case};
use crate::gpu::{Buffer, Gpu};

pub struct Adam {
    beta: [f64; 2],
    /// βᵗ of both.
    powers: [f64; 2],
    epsilon: f32,
    rates: Buffer,
    columns: usize,
    numbers: usize,
    first: Buffer,
    second: Buffer,
}

impl Adam {
    pub fn of_case(gpu: &Gpu, case: &Case, numbers: usize, rates: &[f32]) -> Result<Self, Error> {
        Ok(Self {
            beta: [case.number("beta1")?, case.number("beta2")?],
            powers: [1.0; 2],
            epsilon: case.single("eps")?,
            rates: gpu.upload(rates),
            columns: rates.len(),
            numbers,
            first: gpu.zeros(numbers),
            second: gpu.zeros(numbers),
        })
    }

    pub fn set_rates(&mut self, gpu: &Gpu, rates: &[f32]) {
        self.rates = gpu.upload(rates);
    }

    pub fn step(&mut self, gpu: &Gpu, gradient: &Buffer, numbers: &Buffer) {
        for (power, beta) in self.powers.iter_mut().zip(self.beta) {
            *power *= beta;
        }
        let decay = self.beta.map(|b| ((1.0 - b) as f32).to_bits());
        let bias = self.powers.map(|p| ((1.0 - p) as f32).to_bits());
        let rest = [self.epsilon.to_bits(), self.columns as u32];
        let step = gpu.upload(&[decay, bias, rest].concat());
        let buffers = [
            &step,
            &self.rates,
            gradient,
            numbers,
            &self.first,
            &self.second,
        ];
        gpu.run_over("adam/update", &buffers, self.numbers);
    }
}

pub fn stage(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let start = case.singles("start")?;
    let n = start.len();
    let gradients = case.singles("gradients")?;
    let rates = case.singles("learning_rates")?;
    // Rows beyond `kept` come when others leave; until then they have no gradient, and m and v of zero.
    let kept = match case.has("kept") {
        true => Some(case.flags("kept")?),
        false => None,
    };
    let change = match &kept {
        Some(_) => case.whole("change_after")? as usize,
        None => usize::MAX,
    };
    let there = |step: usize, row: usize| match &kept {
        Some(kept) if step < change => row < kept.len(),
        Some(kept) => kept.get(row).is_none_or(|&k| k != 0),
        None => true,
    };
    let numbers = gpu.upload(&start);
    let mut adam = Adam::of_case(gpu, case, n, &[0.0])?;
    let mut path = Vec::new();
    for (t, &rate) in rates.iter().enumerate() {
        let given = (0..n).map(|i| {
            if there(t, i) {
                gradients[t * n + i]
            } else {
                0.0
            }
        });
        let gradient = gpu.upload(&given.collect::<Vec<f32>>());
        adam.set_rates(gpu, &[rate]);
        adam.step(gpu, &gradient, &numbers);
        let now = gpu.read::<f32>(&numbers, n)?;
        path.extend((0..n).map(|i| if there(t, i) { now[i] } else { f32::NAN }));
    }
    let mut out = Answer::default();
    out.put("path", &[rates.len(), n], path);
    Ok(out)
}
