//! Large cases of the stages that are not the rasterizer's.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use garad_core::{Par, Rng};
use garad_golden::Dtype;

use super::scene::{Scene, SceneKind, SceneOptions};
use super::{Made, Output, bytes, f32_of, shaped};
use crate::outputs::Error;
use crate::stages::forms;

/// A large case of a stage.
#[derive(Debug, Clone, Copy)]
pub struct Other {
    /// Columns and rows of its images.
    pub size: [usize; 2],
    /// How many points, features, descriptors, nodes, parameters or Gaussians.
    pub count: usize,
    /// Seed.
    pub seed: u64,
}

type Ask = fn(&Other, &mut Made) -> Result<(), Error>;

struct Recipe {
    stage: &'static str,
    /// What `count` counts, and how many if nothing is said.
    of: &'static str,
    count: usize,
    ask: Ask,
    outputs: &'static [Output],
}

const GRADIENT: &str = "train_step.rows";

#[rustfmt::skip]
const RECIPES: &[Recipe] = &[
    Recipe { stage: "lk", of: "points", count: 2000, ask: lk, outputs: &[
        ("status", Dtype::U8, "1", "exact"), ("xy", Dtype::F32, "px", "lk.xy"), ("residual", Dtype::F32, "1", "lk.residual"),
    ] },
    Recipe { stage: "orb", of: "features", count: 5000, ask: orb, outputs: &[
        ("level", Dtype::I32, "1", "exact"), ("pt", Dtype::F32, "px", "exact"), ("angle", Dtype::F32, "deg", "exact"),
        ("response", Dtype::F32, "1", "exact"), ("descriptor", Dtype::U8, "bits", "exact"),
    ] },
    Recipe { stage: "matching", of: "descriptors", count: 5000, ask: matching, outputs: &[
        ("nearest", Dtype::I32, "1", "exact"), ("distance", Dtype::I32, "bits", "exact"),
        ("second", Dtype::I32, "bits", "exact"), ("mutual", Dtype::I32, "1", "exact"),
    ] },
    Recipe { stage: "mean_field", of: "nodes", count: 2000, ask: mean_field, outputs: &[
        ("q", Dtype::F64, "1", "crf.q"), ("labels", Dtype::U8, "1", "exact"),
    ] },
    Recipe { stage: "losses", of: "nothing", count: 0, ask: losses, outputs: &[
        ("value", Dtype::F64, "1", "losses.value"), ("gradient", Dtype::F64, "1", "losses.gradient"),
    ] },
    Recipe { stage: "adam", of: "parameters", count: 100_000, ask: adam, outputs: &[
        ("path", Dtype::F64, "1", "adam.path"),
    ] },
    Recipe { stage: "train_step", of: "Gaussians", count: 20_000, ask: train_step, outputs: &[
        ("loss_0", Dtype::F64, "1", "train_step.loss"), ("d_means_0", Dtype::F64, "1", GRADIENT),
        ("d_log_scales_0", Dtype::F64, "1", GRADIENT), ("d_quaternions_0", Dtype::F64, "1", GRADIENT),
        ("d_opacity_logits_0", Dtype::F64, "1", GRADIENT), ("d_sh_0", Dtype::F64, "1", GRADIENT),
        ("means_0", Dtype::F64, "m", "trace.means"), ("log_scales_0", Dtype::F64, "1", "trace.log_scales"),
        ("quaternions_0", Dtype::F64, "1", "trace.quaternions"), ("opacity_logits_0", Dtype::F64, "1", "trace.opacity_logits"),
        ("sh_0", Dtype::F64, "1", "trace.sh"),
    ] },
];

impl Other {
    /// The stages there are, with what `count` counts and how many there are if nothing is said.
    pub fn stages() -> impl Iterator<Item = (&'static str, &'static str, usize)> {
        RECIPES.iter().map(|r| (r.stage, r.of, r.count))
    }

    /// The case.
    ///
    /// # Errors
    /// If the stage is none of [`Other::stages`], or cannot compute with this size or count.
    pub fn make(&self, stage: &str, par: Par) -> Result<Made, Error> {
        let recipe = RECIPES.iter().find(|r| r.stage == stage);
        let recipe = recipe.ok_or_else(|| format!("stage '{stage}' has no large cases"))?;
        let [width, height] = self.size;
        let name = format!("made_{}_{width}x{height}_{}", self.count, self.seed);
        let why = "the committed cases of this stage are small".to_owned();
        let mut made = Made::new(recipe.stage, name, self.seed, why);
        (recipe.ask)(self, &mut made)?;
        let all = forms(stage);
        let plain = all.iter().find(|form| form.name.contains("reference"));
        let form = plain.or(all.first()).ok_or("no form")?;
        let found = form.answer(&made.question(), par)?;
        made.expect(&found, recipe.outputs)?;
        Ok(made)
    }

    fn rng(&self, key: u64) -> Rng {
        Rng::keyed(self.seed, &[u64::MAX - 1, key])
    }
}

/// Grey levels that are defined everywhere: waves of periods from 5 to 60 pixels.
struct Texture(Vec<[f64; 4]>);

impl Texture {
    fn new(rng: &mut Rng) -> Self {
        let wave = |_| {
            let (period, turn) = (5.0 * libm::pow(12.0, rng.uniform()), TAU * rng.uniform());
            let k = TAU / period;
            [
                k * libm::cos(turn),
                k * libm::sin(turn),
                TAU * rng.uniform(),
                rng.range(4.0, 16.0),
            ]
        };
        Self((0..24).map(wave).collect())
    }

    fn at(&self, x: f64, y: f64) -> f64 {
        let wave = |w: &[f64; 4]| w[3] * libm::sin(w[0] * x + w[1] * y + w[2]);
        (128.0 + self.0.iter().map(wave).sum::<f64>()).clamp(0.0, 255.0)
    }

    /// The image shifted by (dx, dy).
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "from 0 to 255"
    )]
    fn image(&self, [width, height]: [usize; 2], [dx, dy]: [f64; 2]) -> Vec<u8> {
        let at = |i: usize| {
            self.at((i % width) as f64 - dx, (i / width) as f64 - dy)
                .round() as u8
        };
        (0..width * height).map(at).collect()
    }
}

fn lk(o: &Other, made: &mut Made) -> Result<(), Error> {
    let [width, height] = o.size;
    if width < 120 || height < 120 || o.count <= 8 {
        return Err("lk: an image of at least 120 x 120 and more than 8 points".into());
    }
    let (rng, texture) = (&mut o.rng(1), Texture::new(&mut o.rng(0)));
    let image = |shift| bytes(texture.image(o.size, shift), &[height, width], Dtype::U8);
    made.param("levels", 3);
    made.input("prev", image([0.0; 2]), "1");
    made.input("next", image([3.3, -1.7]), "1");
    // The last eight are outside, as in the committed cases.
    let inside =
        (0..o.count - 8).flat_map(|_| o.size.map(|n| f32_of(rng.range(45.0, n as f64 - 45.0))));
    let mut points: Vec<f64> = inside.collect();
    points.extend([-60.0; 16]);
    made.input("points", shaped(points, &[o.count, 2], Dtype::F32), "px");
    Ok(())
}

fn orb(o: &Other, made: &mut Made) -> Result<(), Error> {
    let [width, height] = o.size;
    if width < 64 || height < 64 || o.count == 0 {
        return Err("orb: an image of at least 64 x 64 and a feature".into());
    }
    let (rng, texture) = (&mut o.rng(1), Texture::new(&mut o.rng(0)));
    let mut image = texture.image(o.size, [0.0; 2]);
    // Corners: boxes of one grey level.
    for _ in 0..width * height / 400 {
        let [x, y] = o.size.map(|n| rng.below(n - 12));
        let (side, level) = (4 + rng.below(8), rng.below(256));
        for row in y..y + side {
            image[row * width + x..row * width + x + side].fill(u8::try_from(level)?);
        }
    }
    made.param("features", o.count);
    made.input("image", bytes(image, &[height, width], Dtype::U8), "1");
    Ok(())
}

fn matching(o: &Other, made: &mut Made) -> Result<(), Error> {
    if o.count < 16 {
        return Err("matching: at least 16 descriptors".into());
    }
    let rng = &mut o.rng(0);
    let mut one = || [0; 4].map(|_| rng.next_u64().to_le_bytes()).concat();
    let query: Vec<Vec<u8>> = (0..o.count).map(|_| one()).collect();
    let rng = &mut o.rng(1);
    // Two of three are seen again, backwards, with a few other bits; every eighth twice, which ties.
    let again = query.iter().rev().enumerate().filter(|(i, _)| i % 3 != 0);
    let mut train = Vec::new();
    for (i, descriptor) in again {
        let mut other = descriptor.clone();
        for _ in 0..rng.below(40) {
            let bit = rng.below(256);
            other[bit / 8] ^= 1 << (bit % 8);
        }
        train.push(other.clone());
        if i % 8 == 1 {
            train.push(other);
        }
    }
    let rows = |rows: Vec<Vec<u8>>| bytes(rows.concat(), &[rows.len(), 32], Dtype::U8);
    made.input("query", rows(query), "bits");
    made.input("train", rows(train), "bits");
    Ok(())
}

fn mean_field(o: &Other, made: &mut Made) -> Result<(), Error> {
    let (rng, n) = (&mut o.rng(0), o.count);
    for (name, value) in [
        ("feature_weight", 1.0),
        ("sigma_reproj_px", 0.6),
        ("sigma_observations", 1.5),
        ("position_weight", 3.0),
        ("sigma_m", 0.5),
        ("sigma_px", 18.0),
        ("damping", 0.5),
    ] {
        made.param(name, value);
    }
    for (name, word) in [
        ("distance", "squared"),
        ("terms", "both"),
        ("normalisation", "rows"),
        ("iterations", "0 1 5 10"),
    ] {
        made.param(name, word);
    }
    made.param("self_message", true);
    let size = o.size.map(|n| n as f64);
    let (mut p, mut uv, mut reproj, mut seen, mut odds) = (vec![], vec![], vec![], vec![], vec![]);
    for _ in 0..n {
        let px = size.map(|n| rng.range(0.0, n));
        let z = rng.range(1.0, 5.0);
        // One in five stands apart and moves.
        let moves = rng.uniform() < 0.2;
        p.extend([(px[0] / size[0] - 0.5) * z, (px[1] / size[0] - 0.4) * z, z]);
        uv.extend(px);
        reproj.push(if moves {
            rng.range(1.0, 4.0)
        } else {
            rng.range(0.0, 1.5)
        });
        seen.push((2 + rng.below(12)) as f64);
        odds.push(if moves { 1.5 } else { -1.5 } + rng.normal());
    }
    for (name, values, axes, unit) in [
        ("p_world", p, &[n, 3][..], "m"),
        ("uv_px", uv, &[n, 2], "px"),
        ("reproj_px", reproj, &[n], "px"),
        ("observations", seen, &[n], "1"),
        ("log_odds", odds, &[n], "nat"),
    ] {
        made.input(name, shaped(values, axes, Dtype::F64), unit);
    }
    Ok(())
}

/// Colours in [0, 1]: three textures.
fn colors(o: &Other, key: u64, noise: f64) -> Vec<f64> {
    let textures = [0, 1, 2].map(|k| Texture::new(&mut o.rng(10 + k)));
    let (rng, [width, height]) = (&mut o.rng(key), o.size);
    let at = |i: usize| {
        textures
            .each_ref()
            .map(|t| t.at((i % width) as f64, (i / width) as f64))
    };
    let values = (0..width * height).flat_map(at);
    values
        .map(|v| f32_of((v / 255.0 + noise * rng.normal()).clamp(0.0, 1.0)))
        .collect()
}

fn excluded(o: &Other, key: u64) -> Vec<u8> {
    let (rng, [width, height]) = (&mut o.rng(key), o.size);
    let (x, y) = (rng.below(width), rng.below(height));
    let inside =
        |i: usize| (i % width).abs_diff(x) < width / 6 && (i / width).abs_diff(y) < height / 5;
    (0..width * height).map(|i| u8::from(inside(i))).collect()
}

fn losses(o: &Other, made: &mut Made) -> Result<(), Error> {
    let [width, height] = o.size;
    made.param("loss", "photometric");
    made.param("lambda", 0.2);
    for (name, key) in [("rendered", 1), ("target", 2)] {
        let values = colors(o, key, 0.05);
        made.input(name, shaped(values, &[height, width, 3], Dtype::F32), "1");
    }
    let mask = bytes(excluded(o, 3), &[height, width], Dtype::U8);
    made.input("excluded", mask, "0 judged");
    Ok(())
}

/// Twenty steps; one gradient in eight is zero, and they are of all sizes.
fn adam(o: &Other, made: &mut Made) -> Result<(), Error> {
    const STEPS: usize = 20;
    let (rng, n) = (&mut o.rng(0), o.count);
    for (name, value) in [("beta1", 0.9), ("beta2", 0.999), ("eps", 1e-15)] {
        made.param(name, value);
    }
    made.param("width", 1);
    let start = (0..n).map(|_| f32_of(rng.normal())).collect();
    made.input("start", shaped(start, &[n], Dtype::F32), "1");
    let gradient = |_| {
        let size = libm::pow(10.0, rng.range(-6.0, 1.0));
        let zero = rng.below(8) == 0;
        if zero {
            0.0
        } else {
            f32_of(size * rng.normal())
        }
    };
    let gradients = (0..STEPS * n).map(gradient).collect();
    made.input("gradients", shaped(gradients, &[STEPS, n], Dtype::F32), "1");
    let rates = (0..STEPS)
        .map(|t| 1e-2 * libm::pow(0.9, t as f64))
        .collect();
    made.input("learning_rates", shaped(rates, &[STEPS], Dtype::F64), "1");
    Ok(())
}

fn train_step(o: &Other, made: &mut Made) -> Result<(), Error> {
    let options = SceneOptions {
        kind: SceneKind::Room,
        gaussians: o.count,
        size: o.size,
        degree: 1,
        seed: o.seed,
    };
    let scene = Scene::new(&options, Par::Seq)?;
    super::splatting::put_scene(made, &scene);
    let [width, height] = o.size;
    let [q, t] = ["camera_from_world_q", "camera_from_world_t"].map(|name| {
        let tensor = made.inputs.remove(name).expect("of the scene");
        (format!("{name}_0"), tensor)
    });
    made.input(&q.0, q.1, "w x y z");
    made.input(&t.0, t.1, "m");
    made.input("background", shaped(vec![0.0; 3], &[3], Dtype::F64), "1");
    let numbers = BTreeMap::from([
        ("beta1", 0.9),
        ("beta2", 0.999),
        ("eps", 1e-15),
        ("lambda_photometric", 0.8),
        ("lambda_ssim", 0.2),
        ("lambda_depth", 0.1),
        ("lambda_dynamic", 0.2),
        ("min_opacity", 0.5),
        ("rate_means", 3.2e-4),
        ("rate_log_scales", 5e-3),
        ("rate_quaternions", 1e-3),
        ("rate_opacity_logits", 0.05),
        ("rate_sh", 2.5e-3),
        ("rate_sh_rest_divisor", 20.0),
    ]);
    for (name, value) in numbers {
        made.param(name, value);
    }
    made.param("iterations", 1);
    let rng = &mut o.rng(20);
    let dynamic = (0..o.count).map(|_| u8::from(rng.below(10) == 0)).collect();
    made.input("dynamic", bytes(dynamic, &[o.count], Dtype::U8), "1");
    let target = shaped(colors(o, 21, 0.02), &[height, width, 3], Dtype::F32);
    made.input("target_0", target, "1");
    let measured = (0..width * height).map(|_| match rng.below(10) {
        0 => 0.0,
        _ => f32_of(rng.range(1.0, 4.5)),
    });
    let measured = shaped(measured.collect(), &[height, width], Dtype::F32);
    made.input("measured_0", measured, "m");
    let mask = bytes(excluded(o, 22), &[height, width], Dtype::U8);
    made.input("excluded_0", mask, "0 judged");
    Ok(())
}
