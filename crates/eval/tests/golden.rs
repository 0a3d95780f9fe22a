//! The committed cases of the stages `trajectory` and `image_metrics`: truth from mpmath, evo,
//! OpenCV and scipy.

use garad_core::{Image, MaskImage, Par, Se3, So3, StampedPose};
use garad_eval::{
    Alignment, Ate, AteOptions, RpeDelta, RpeOptions, Sim3, Stats, align_points, align_trajectory,
    associate, ate, depth_l1, psnr_db, rpe, ssim, ssim_map,
};
use garad_golden::{Case, Tensor};
use nalgebra::Vector3;

const ALIGNMENTS: [(&str, Alignment); 3] = [
    ("none", Alignment::None),
    ("rigid", Alignment::Rigid),
    ("similarity", Alignment::Similarity),
];

/// Compares the answers to one case; a run shows the failures of all cases at once.
struct Answers<'a> {
    case: &'a Case,
    failures: Vec<String>,
    checked: usize,
}

impl<'a> Answers<'a> {
    fn to(case: &'a Case) -> Self {
        Self {
            case,
            failures: Vec::new(),
            checked: 0,
        }
    }

    /// Outputs that the case does not state are no question.
    fn answer(&mut self, name: &str, got: &[f64]) {
        if self.case.output_names().any(|output| output == name) {
            self.checked += 1;
            match self.case.compare(name, got) {
                Ok(verdict) if verdict.passed => {
                    if std::env::var_os("GARAD_SHOW_MARGINS").is_some() {
                        eprintln!("{} {name}: {verdict}", self.case.name());
                    }
                }
                Ok(verdict) => self.failures.push(format!("{name}: {verdict}")),
                Err(error) => self.failures.push(error.to_string()),
            }
        }
    }

    fn finish(mut self) -> Vec<String> {
        let outputs = self.case.output_names().count();
        if self.checked != outputs {
            let unanswered = outputs - self.checked;
            self.failures
                .push(format!("{unanswered} outputs unanswered"));
        }
        let name = self.case.name();
        let named = self
            .failures
            .iter()
            .map(|failure| format!("{name} {failure}"));
        named.collect()
    }
}

fn points(tensor: &Tensor) -> Vec<Vector3<f64>> {
    let values = tensor.f64();
    values
        .chunks_exact(3)
        .map(Vector3::from_column_slice)
        .collect()
}

fn trajectory(case: &Case, name: &str) -> Vec<StampedPose> {
    let times = case.input(&format!("{name}_t")).f64();
    let poses = case.input(name).f64();
    let pose = |(&t_s, p): (&f64, &[f64])| StampedPose {
        t_s,
        world_from_camera: Se3::new(
            So3::from_quaternion(p[3], p[4], p[5], p[6]).expect("a rotation"),
            Vector3::new(p[0], p[1], p[2]),
        ),
    };
    times.iter().zip(poses.chunks_exact(7)).map(pose).collect()
}

fn answer_motion(answers: &mut Answers<'_>, prefix: &str, sim3: &Sim3) {
    let rows = sim3.rotation.matrix().transpose();
    answers.answer(&format!("{prefix}_rotation"), rows.as_slice());
    answers.answer(
        &format!("{prefix}_translation"),
        sim3.translation.as_slice(),
    );
    answers.answer(&format!("{prefix}_scale"), &[sim3.scale]);
}

fn summary(stats: &Stats) -> [f64; 7] {
    [
        stats.rmse,
        stats.mean,
        stats.median,
        stats.std,
        stats.min,
        stats.max,
        stats.sse,
    ]
}

fn check_alignment(case: &Case) -> Vec<String> {
    let (from, to) = (points(case.input("from")), points(case.input("to")));
    let mut answers = Answers::to(case);
    for (name, alignment) in ALIGNMENTS {
        let sim3 = align_points(&from, &to, alignment).expect(name);
        answer_motion(&mut answers, name, &sim3);
    }
    answers.finish()
}

fn check_errors(case: &Case) -> Vec<String> {
    let (truth, estimate) = (trajectory(case, "truth"), trajectory(case, "estimate"));
    let max_dt_s = case.param_f64("max_dt_s");
    let mut answers = Answers::to(case);
    let pairs = associate(&truth, &estimate, max_dt_s).expect("pairs");
    let times = pairs
        .iter()
        .flat_map(|&(g, e)| [truth[g].t_s, estimate[e].t_s]);
    answers.answer("pairs", &[pairs.len() as f64]);
    answers.answer("pair_times", &times.collect::<Vec<_>>());
    for (name, alignment) in ALIGNMENTS {
        let options = AteOptions {
            alignment,
            max_dt_s,
        };
        let Ate {
            stats,
            truth_from_estimate,
            points,
        } = ate(&truth, &estimate, &options).expect(name);
        let errors: Vec<f64> = points.iter().map(|point| point.error_m).collect();
        answers.answer(&format!("{name}_ate"), &summary(&stats));
        answers.answer(&format!("{name}_errors"), &errors);
        answer_motion(&mut answers, name, &truth_from_estimate);
        let aligned = align_trajectory(&truth_from_estimate, &estimate);
        for delta in [1, 30] {
            let options = RpeOptions {
                delta: RpeDelta::Frames(delta),
                max_dt_s,
            };
            let drift = rpe(&truth, &aligned, &options).expect("steps");
            let output = |kind| format!("{name}_rpe_{kind}_{delta}");
            answers.answer(&output("trans"), &summary(&drift.trans_m));
            answers.answer(&output("rot"), &summary(&drift.rot_deg));
        }
    }
    let options = RpeOptions {
        delta: RpeDelta::Seconds(1.0),
        max_dt_s,
    };
    let drift = rpe(&truth, &estimate, &options).expect("steps of 1 s");
    answers.answer("second_rpe_steps", &[drift.trans_m.pairs as f64]);
    answers.answer("second_rpe_trans", &summary(&drift.trans_m));
    answers.answer("second_rpe_rot", &summary(&drift.rot_deg));
    answers.finish()
}

#[test]
fn trajectory_cases() {
    let mut failures = Vec::new();
    for case in Case::load_all("trajectory") {
        failures.extend(match case.param_str("kind") {
            "alignment" => check_alignment(&case),
            "errors" => check_errors(&case),
            kind => panic!("{}: unknown kind '{kind}'", case.name()),
        });
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

fn image<T: Clone>(tensor: &Tensor, data: Vec<T>) -> Image<T> {
    let shape = tensor.shape();
    Image::from_vec(shape[1], shape[0], data).expect("height x width values")
}

fn mask(case: &Case) -> Option<MaskImage> {
    let mask = case.try_input("mask")?;
    Some(image(mask, mask.u8()))
}

/// Bytes divided by 255, or numbers in [0, 1], as pixels of `C` channels.
fn picture<const C: usize>(tensor: &Tensor) -> Image<[f64; C]> {
    let values: Vec<f64> = match tensor.dtype() {
        garad_golden::Dtype::U8 => tensor.u8().iter().map(|&v| f64::from(v) / 255.0).collect(),
        _ => tensor.f64(),
    };
    let pixels = values
        .chunks_exact(C)
        .map(|p| p.try_into().expect("C values"));
    image(tensor, pixels.collect())
}

fn check_picture<const C: usize>(case: &Case) -> Vec<String> {
    let render = picture::<C>(case.input("render"));
    let truth = picture::<C>(case.input("truth"));
    let mut answers = Answers::to(case);
    let map = ssim_map(&render, &truth, Par::Seq).expect("same size");
    answers.answer("ssim_map", map.data());
    for (suffix, mask) in [("", None), ("_masked", mask(case))] {
        let psnr = psnr_db(&render, &truth, mask.as_ref()).expect("same size");
        answers.answer(&format!("psnr_db{suffix}"), &[psnr]);
        let mean = ssim(&render, &truth, mask.as_ref(), Par::Threads(2)).expect("same size");
        answers.answer(&format!("ssim{suffix}"), &[mean]);
    }
    answers.finish()
}

fn check_depth(case: &Case) -> Vec<String> {
    let depth = |name| image(case.input(name), case.input(name).f32());
    let judged = depth_l1(&depth("render"), &depth("truth"), mask(case).as_ref());
    let judged = judged.expect("pixels in common");
    let mut answers = Answers::to(case);
    answers.answer("mean", &[judged.mean_m]);
    answers.answer("pixels", &[judged.pixels as f64]);
    answers.answer("coverage", &[judged.coverage]);
    answers.finish()
}

#[test]
fn image_metrics_cases() {
    let mut failures = Vec::new();
    for case in Case::load_all("image_metrics") {
        failures.extend(
            match (case.param_str("kind"), case.input("truth").shape()) {
                ("picture", [_, _, 3]) => check_picture::<3>(&case),
                ("picture", _) => check_picture::<1>(&case),
                ("depth", _) => check_depth(&case),
                (kind, _) => panic!("{}: unknown kind '{kind}'", case.name()),
            },
        );
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
