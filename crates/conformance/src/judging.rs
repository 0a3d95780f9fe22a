//! Trajectories and images judged.

use garad_core::{Image, Par, Se3, StampedPose};
use garad_eval::{
    Alignment, AteOptions, RpeDelta, RpeOptions, Sim3, Stats, align_points, align_trajectory,
    associate, ate, depth_l1, psnr_db, rpe, ssim, ssim_map,
};
use garad_golden::{Dtype, Inputs};
use nalgebra::Vector3;

use crate::convert::{channels, gray_if_there, matrix, plane, rotation, vectors};
use crate::outputs::{Answer, Error, Outputs};

const ALIGNMENTS: [(&str, Alignment); 3] = [
    ("none", Alignment::None),
    ("rigid", Alignment::Rigid),
    ("similarity", Alignment::Similarity),
];

fn poses(inputs: &Inputs, name: &str) -> Result<Vec<StampedPose>, Error> {
    let times = inputs.reals(&format!("{name}_t"))?.into_iter();
    let rows = times.zip(inputs.rows::<7>(name)?);
    rows.map(|(t_s, [x, y, z, qw, qx, qy, qz])| {
        Ok(StampedPose {
            t_s,
            world_from_camera: Se3::new(rotation([qw, qx, qy, qz])?, Vector3::new(x, y, z)),
        })
    })
    .collect()
}

fn put_motion(out: &mut Outputs, prefix: &str, motion: &Sim3) {
    out.one(
        &format!("{prefix}_rotation"),
        matrix(&motion.rotation.matrix()),
    );
    out.one(
        &format!("{prefix}_translation"),
        <[f64; 3]>::from(motion.translation),
    );
    out.one(&format!("{prefix}_scale"), motion.scale);
}

fn summary(s: &Stats) -> [f64; 7] {
    [s.rmse, s.mean, s.median, s.std, s.min, s.max, s.sse]
}

pub(crate) fn trajectory(inputs: &Inputs) -> Answer {
    match inputs.word("kind")? {
        "alignment" => alignment(inputs),
        "errors" => errors(inputs),
        other => Err(format!("kind '{other}'").into()),
    }
}

fn alignment(inputs: &Inputs) -> Answer {
    let (from, to) = (vectors::<3>(inputs, "from")?, vectors::<3>(inputs, "to")?);
    let mut out = Outputs::default();
    for (name, alignment) in ALIGNMENTS {
        put_motion(&mut out, name, &align_points(&from, &to, alignment)?);
    }
    Ok(out)
}

fn errors(inputs: &Inputs) -> Answer {
    let (truth, estimate) = (poses(inputs, "truth")?, poses(inputs, "estimate")?);
    let max_dt_s = inputs.number("max_dt_s")?;
    let mut out = Outputs::default();
    let pairs = associate(&truth, &estimate, max_dt_s)?;
    out.one("pairs", pairs.len());
    let times = pairs.iter().map(|&(g, e)| [truth[g].t_s, estimate[e].t_s]);
    out.put("pair_times", times);
    for (name, alignment) in ALIGNMENTS {
        let options = AteOptions {
            alignment,
            max_dt_s,
        };
        let found = ate(&truth, &estimate, &options)?;
        out.one(&format!("{name}_ate"), summary(&found.stats));
        out.put(
            &format!("{name}_errors"),
            found.points.iter().map(|p| p.error_m),
        );
        put_motion(&mut out, name, &found.truth_from_estimate);
        let aligned = align_trajectory(&found.truth_from_estimate, &estimate);
        for frames in [1, 30] {
            let delta = RpeDelta::Frames(frames);
            let drift = rpe(&truth, &aligned, &RpeOptions { delta, max_dt_s })?;
            out.one(
                &format!("{name}_rpe_trans_{frames}"),
                summary(&drift.trans_m),
            );
            out.one(&format!("{name}_rpe_rot_{frames}"), summary(&drift.rot_deg));
        }
    }
    let delta = RpeDelta::Seconds(1.0);
    let drift = rpe(&truth, &estimate, &RpeOptions { delta, max_dt_s })?;
    out.one("second_rpe_steps", drift.trans_m.pairs);
    out.one("second_rpe_trans", summary(&drift.trans_m));
    out.one("second_rpe_rot", summary(&drift.rot_deg));
    Ok(out)
}

/// Bytes divided by 255, or numbers in [0, 1], as pixels of `C` channels.
fn image<const C: usize>(inputs: &Inputs, name: &str) -> Result<Image<[f64; C]>, Error> {
    let scale = match inputs.tensor(name)?.dtype() {
        Dtype::U8 => 255.0,
        _ => 1.0,
    };
    Ok(channels::<f64, C>(inputs, name)?.map(|p| p.map(|v| v / scale)))
}

fn images<const C: usize>(inputs: &Inputs, par: Par) -> Answer {
    let (render, truth) = (image::<C>(inputs, "render")?, image::<C>(inputs, "truth")?);
    let mut out = Outputs::default();
    out.image("ssim_map", &ssim_map(&render, &truth, par)?);
    let mask = gray_if_there(inputs, "mask")?;
    let masked = mask.iter().map(|mask| ("_masked", Some(mask)));
    for (suffix, mask) in [("", None)].into_iter().chain(masked) {
        out.one(&format!("psnr_db{suffix}"), psnr_db(&render, &truth, mask)?);
        out.one(&format!("ssim{suffix}"), ssim(&render, &truth, mask, par)?);
    }
    Ok(out)
}

pub(crate) fn image_metrics(inputs: &Inputs, par: Par) -> Answer {
    match (inputs.word("kind")?, inputs.tensor("truth")?.shape()) {
        ("picture", [_, _, 3]) => images::<3>(inputs, par),
        ("picture", _) => images::<1>(inputs, par),
        ("depth", _) => {
            let (render, truth) = (plane(inputs, "render")?, plane(inputs, "truth")?);
            let judged = depth_l1(&render, &truth, gray_if_there(inputs, "mask")?.as_ref())?;
            let mut out = Outputs::default();
            out.one("mean", judged.mean_m);
            out.one("pixels", judged.pixels);
            out.one("coverage", judged.coverage);
            Ok(out)
        }
        (other, _) => Err(format!("kind '{other}'").into()),
    }
}
