//! Losses with gradients (O1 to O5).

use crate::Error;
use crate::case::{Answer, Case};
use crate::gpu::{Buffer, Gpu};
use crate::sums;

/// Size of an image and how many of its pixels count.
pub struct Frame {
    pub width: usize,
    pub height: usize,
    pub mask: Buffer,
    counted: f32,
}

impl Frame {
    /// `excluded` as in the cases: 0 counts.
    pub fn new(gpu: &Gpu, [height, width]: [usize; 2], excluded: Option<&[u32]>) -> Self {
        let mask: Vec<f32> = match excluded {
            Some(flags) => flags
                .iter()
                .map(|&e| if e == 0 { 1.0 } else { 0.0 })
                .collect(),
            None => vec![1.0; width * height],
        };
        Self {
            width,
            height,
            counted: mask.iter().sum(),
            mask: gpu.upload(&mask),
        }
    }

    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    pub fn settings(&self, gpu: &Gpu, by_l1: f32, by_ssim: f32) -> Buffer {
        let size = [self.width as u32, self.height as u32];
        let weights = [self.counted, by_l1, by_ssim].map(f32::to_bits);
        gpu.upload(&[&size[..], &weights].concat())
    }
}

fn with<'a>(inputs: &[&'a Buffer], rest: &[&'a Buffer]) -> Vec<&'a Buffer> {
    [inputs, rest].concat()
}

/// by_l1 L1 + by_ssim SSIM: the terms of its value, to be summed, and its gradient, [height, width, 3] each.
pub fn photometric(
    gpu: &Gpu,
    frame: &Frame,
    [rendered, target]: [&Buffer; 2],
    [by_l1, by_ssim]: [f32; 2],
) -> [Buffer; 2] {
    let n = 3 * frame.pixels();
    let settings = frame.settings(gpu, by_l1, by_ssim);
    let inputs = [&settings, rendered, target, &frame.mask];
    let moments = gpu.zeros(8 * n);
    gpu.run_over("losses/moments_along", &with(&inputs, &[&moments]), n);
    let [raw, smooth] = [gpu.zeros(4 * n), gpu.zeros(4 * n)];
    gpu.run_over(
        "losses/similarity",
        &[&settings, &moments, &frame.mask, &raw],
        n,
    );
    gpu.run_over("losses/derivatives_along", &[&settings, &raw, &smooth], n);
    let [gradient, terms] = [gpu.zeros(n), gpu.zeros(n)];
    gpu.run_over(
        "losses/photometric",
        &with(&inputs, &[&smooth, &gradient, &terms]),
        n,
    );
    [terms, gradient]
}

/// What `depth` finds: pixels compared and the sum of their errors; gradients by depth and opacity.
pub struct DepthLoss {
    totals: Buffer,
    pub by_depth: Buffer,
    pub by_opacity: Buffer,
}

impl DepthLoss {
    pub fn value(&self, gpu: &Gpu) -> Result<f32, Error> {
        let totals = gpu.read::<f32>(&self.totals, 2)?;
        Ok(totals[1] / totals[0].max(1.0))
    }
}

/// `measured` is 0 where there is no depth; gradients are those of `weight` times the loss.
pub fn depth(
    gpu: &Gpu,
    frame: &Frame,
    [depth, opacity, measured]: [&Buffer; 3],
    min_opacity: f32,
    weight: f32,
) -> DepthLoss {
    let n = frame.pixels();
    let settings = gpu.upload(&[n as u32, min_opacity.to_bits(), weight.to_bits()]);
    let inputs = [&settings, depth, opacity, &frame.mask, measured];
    let counted = gpu.zeros(2 * n);
    gpu.run_over("losses/depth_terms", &with(&inputs, &[&counted]), n);
    let found = DepthLoss {
        totals: sums::columns(gpu, &counted, n, 2),
        by_depth: gpu.zeros(n),
        by_opacity: gpu.zeros(n),
    };
    let rest = [&found.totals, &found.by_depth, &found.by_opacity];
    gpu.run_over("losses/depth_gradient", &with(&inputs, &rest), n);
    found
}

/// Depth without what is no measurement, for `depth`.
pub fn measured(values: &[f32]) -> Vec<f32> {
    let known = |&z: &f32| if z.is_finite() && z > 0.0 { z } else { 0.0 };
    values.iter().map(known).collect()
}

/// Opacity of dynamic Gaussians: adds `weight` times the gradient to column `first` of `gradient`, and returns
/// the squares to be summed.
pub fn penalty(
    gpu: &Gpu,
    [logits, dynamic, gradient]: [&Buffer; 3],
    gaussians: usize,
    [stride, first]: [usize; 2],
    weight: f32,
) -> Buffer {
    let sizes = [gaussians, stride, first].map(|v| v as u32);
    let settings = gpu.upload(&[&sizes[..], &[weight.to_bits()]].concat());
    let squares = gpu.zeros(gaussians);
    let buffers = [&settings, logits, dynamic, gradient, &squares];
    gpu.run_over("losses/penalty", &buffers, gaussians);
    squares
}

pub fn stage(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let mut out = Answer::default();
    let kind = case.word("loss")?;
    if kind == "opacity" {
        let logits = case.singles("logits")?;
        let n = logits.len();
        let dynamic = gpu.upload(&case.flags("dynamic")?);
        let gradient = gpu.zeros(n);
        let buffers = [&gpu.upload(&logits), &dynamic, &gradient];
        let squares = penalty(gpu, buffers, n, [1, 0], 1.0);
        out.put("value", &[1], vec![sums::total(gpu, &squares, n)?]);
        out.put("gradient", &[n], gpu.read::<f32>(&gradient, n)?);
        return Ok(out);
    }
    let first = if kind == "depth" { "depth" } else { "rendered" };
    let shape = case.array(first)?.shape;
    let excluded = match case.has("excluded") {
        true => Some(case.flags("excluded")?),
        false => None,
    };
    let frame = Frame::new(gpu, [shape[0], shape[1]], excluded.as_deref());
    let image = gpu.upload(&case.singles(first)?);
    if kind == "depth" {
        let opacity = gpu.upload(&case.singles("opacity")?);
        let known = gpu.upload(&measured(&case.singles("measured")?));
        let least = case.single("min_opacity")?;
        let found = depth(gpu, &frame, [&image, &opacity, &known], least, 1.0);
        out.put("value", &[1], vec![found.value(gpu)?]);
        let n = frame.pixels();
        out.put("by_depth", &shape, gpu.read::<f32>(&found.by_depth, n)?);
        out.put("by_opacity", &shape, gpu.read::<f32>(&found.by_opacity, n)?);
        return Ok(out);
    }
    let target = gpu.upload(&case.singles("target")?);
    let (weights, constant) = match kind {
        "l1" => ([1.0, 0.0], 0.0),
        "ssim" => ([0.0, 1.0], 0.0),
        "photometric" => {
            let lambda = case.single("lambda")?;
            ([1.0 - lambda, -lambda], lambda)
        }
        other => return Err(format!("no loss {other}")),
    };
    let [terms, gradient] = photometric(gpu, &frame, [&image, &target], weights);
    let n = 3 * frame.pixels();
    out.put("value", &[1], vec![constant + sums::total(gpu, &terms, n)?]);
    out.put("gradient", &shape, gpu.read::<f32>(&gradient, n)?);
    Ok(out)
}
