//! Trajectories and pictures judged.

use garad_core::{Image, MaskImage, Par, Se3, So3, StampedPose};
use garad_eval::{
    Alignment, AteOptions, EvalError, RpeDelta, RpeOptions, Sim3, Stats, align_points,
    align_trajectory, associate, ate, depth_l1, psnr_db, rpe, ssim, ssim_map,
};
use nalgebra::Vector3;

use super::fields::Fields;
use super::{Outputs, OwnError};

const ALIGNMENTS: [(&str, Alignment); 3] = [
    ("none", Alignment::None),
    ("rigid", Alignment::Rigid),
    ("similarity", Alignment::Similarity),
];

fn whole(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

fn poses(fields: Fields<'_>, name: &str) -> Result<Vec<StampedPose>, OwnError> {
    let times = fields.reals(&format!("{name}_t"))?.into_iter();
    let rows = times.zip(fields.rows::<7>(name)?);
    rows.map(|(t_s, [x, y, z, qw, qx, qy, qz])| {
        let rotation = So3::from_quaternion(qw, qx, qy, qz);
        let rotation = rotation.ok_or_else(|| fields.wrong("a pose without rotation"))?;
        Ok(StampedPose {
            t_s,
            world_from_camera: Se3::new(rotation, Vector3::new(x, y, z)),
        })
    })
    .collect()
}

fn put_motion(out: &mut Outputs, prefix: &str, motion: &Sim3) {
    let rows = motion.rotation.matrix().transpose();
    out.put(&format!("{prefix}_rotation"), rows.iter().copied());
    let shift = motion.translation.iter().copied();
    out.put(&format!("{prefix}_translation"), shift);
    out.put(&format!("{prefix}_scale"), [motion.scale]);
}

fn summary(s: &Stats) -> [f64; 7] {
    [s.rmse, s.mean, s.median, s.std, s.min, s.max, s.sse]
}

pub(super) fn trajectory(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    match fields.word("kind")? {
        "alignment" => alignment(fields),
        "errors" => errors(fields),
        other => Err(fields.wrong(format!("kind '{other}'"))),
    }
}

fn alignment(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let points = |name| -> Result<Vec<Vector3<f64>>, OwnError> {
        let rows = fields.rows::<3>(name)?.into_iter();
        Ok(rows.map(Vector3::from).collect())
    };
    let (from, to) = (points("from")?, points("to")?);
    let mut out = Outputs::default();
    for (name, alignment) in ALIGNMENTS {
        let motion = align_points(&from, &to, alignment);
        put_motion(
            &mut out,
            name,
            &motion.map_err(|error| fields.wrong(error))?,
        );
    }
    Ok(out)
}

fn errors(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let wrong = |error: EvalError| fields.wrong(error);
    let (truth, estimate) = (poses(fields, "truth")?, poses(fields, "estimate")?);
    let max_dt_s = fields.number("max_dt_s")?;
    let mut out = Outputs::default();
    let pairs = associate(&truth, &estimate, max_dt_s).map_err(wrong)?;
    out.put_whole("pairs", [whole(pairs.len())]);
    let times = pairs.iter();
    out.put(
        "pair_times",
        times.flat_map(|&(g, e)| [truth[g].t_s, estimate[e].t_s]),
    );
    for (name, alignment) in ALIGNMENTS {
        let options = AteOptions {
            alignment,
            max_dt_s,
        };
        let found = ate(&truth, &estimate, &options).map_err(wrong)?;
        out.put(&format!("{name}_ate"), summary(&found.stats));
        let each = found.points.iter().map(|p| p.error_m);
        out.put(&format!("{name}_errors"), each);
        put_motion(&mut out, name, &found.truth_from_estimate);
        let aligned = align_trajectory(&found.truth_from_estimate, &estimate);
        for frames in [1, 30] {
            let options = RpeOptions {
                delta: RpeDelta::Frames(frames),
                max_dt_s,
            };
            let drift = rpe(&truth, &aligned, &options).map_err(wrong)?;
            let named = |kind| format!("{name}_rpe_{kind}_{frames}");
            out.put(&named("trans"), summary(&drift.trans_m));
            out.put(&named("rot"), summary(&drift.rot_deg));
        }
    }
    let options = RpeOptions {
        delta: RpeDelta::Seconds(1.0),
        max_dt_s,
    };
    let drift = rpe(&truth, &estimate, &options).map_err(wrong)?;
    out.put_whole("second_rpe_steps", [whole(drift.trans_m.pairs)]);
    out.put("second_rpe_trans", summary(&drift.trans_m));
    out.put("second_rpe_rot", summary(&drift.rot_deg));
    Ok(out)
}

fn mask(fields: Fields<'_>) -> Result<Option<MaskImage>, OwnError> {
    match fields.0.try_input("mask") {
        Some(_) => fields.gray("mask").map(Some),
        None => Ok(None),
    }
}

/// Bytes divided by 255, or numbers in [0, 1], as pixels of `C` channels.
fn picture<const C: usize>(fields: Fields<'_>, name: &str) -> Result<Image<[f64; C]>, OwnError> {
    let tensor = fields.tensor(name)?;
    let scale = match tensor.dtype() {
        garad_golden::Dtype::U8 => 255.0,
        _ => 1.0,
    };
    let &[height, width, ..] = tensor.shape() else {
        return Err(fields.wrong(format!("'{name}' is no picture")));
    };
    let pixels = fields.rows::<C>(name)?.into_iter();
    let pixels = pixels.map(|p| p.map(|v| v / scale)).collect();
    let image = Image::from_vec(width, height, pixels);
    image.ok_or_else(|| fields.wrong(format!("'{name}' has not {C} channels")))
}

fn pictures<const C: usize>(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let wrong = |error: EvalError| fields.wrong(error);
    let (render, truth) = (
        picture::<C>(fields, "render")?,
        picture::<C>(fields, "truth")?,
    );
    let mut out = Outputs::default();
    let map = ssim_map(&render, &truth, Par::Seq).map_err(wrong)?;
    out.put("ssim_map", map.data().iter().copied());
    for (suffix, mask) in [("", None), ("_masked", mask(fields)?)] {
        let mask = mask.as_ref();
        let psnr = psnr_db(&render, &truth, mask).map_err(wrong)?;
        out.put(&format!("psnr_db{suffix}"), [psnr]);
        let mean = ssim(&render, &truth, mask, Par::Seq).map_err(wrong)?;
        out.put(&format!("ssim{suffix}"), [mean]);
    }
    Ok(out)
}

pub(super) fn image_metrics(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    match (fields.word("kind")?, fields.tensor("truth")?.shape()) {
        ("picture", [_, _, 3]) => pictures::<3>(fields),
        ("picture", _) => pictures::<1>(fields),
        ("depth", _) => {
            let (render, truth) = (fields.plane("render")?, fields.plane("truth")?);
            let judged = depth_l1(&render, &truth, mask(fields)?.as_ref());
            let judged = judged.map_err(|error| fields.wrong(error))?;
            let mut out = Outputs::default();
            out.put("mean", [judged.mean_m]);
            out.put_whole("pixels", [whole(judged.pixels)]);
            out.put("coverage", [judged.coverage]);
            Ok(out)
        }
        (other, _) => Err(fields.wrong(format!("kind '{other}'"))),
    }
}
