//! Residuals, and the pose with the least cost.

use garad_core::{Camera, Par, Se3, So3};
use garad_golden::Inputs;
use garad_optim::dense::{Problem, Recorder};
use garad_optim::pose::PoseProblem;
use garad_optim::{
    DepthObservation, PnpConfig, PoseConfig, PoseObservation, PoseSolution, RobustKernel,
    optimise_pose, p3p, solve_pnp_ransac,
};
use nalgebra::{Vector2, Vector3};

use crate::convert::{has, matrix, poses, vectors};
use crate::outputs::{Answer, Error, Outputs};

pub(crate) fn camera(inputs: &Inputs) -> Result<Camera, Error> {
    let n = |name| inputs.number(name);
    Ok(Camera::pinhole(
        (640, 480),
        [n("fx")?, n("fy")?, n("cx")?, n("cy")?],
    )?)
}

/// (u_R, σ_R), NaN for none.
pub(crate) fn right([u_px, sigma_px]: [f64; 2]) -> Option<DepthObservation> {
    u_px.is_finite()
        .then_some(DepthObservation::Right { u_px, sigma_px })
}

fn observations(inputs: &Inputs) -> Result<Vec<PoseObservation>, Error> {
    let (p, uv) = (
        vectors::<3>(inputs, "p_world")?,
        vectors::<2>(inputs, "uv")?,
    );
    let sigma = inputs.reals("sigma")?;
    let rights = match has(inputs, "right") {
        true => inputs.rows::<2>("right")?,
        false => vec![[f64::NAN; 2]; p.len()],
    };
    if [uv.len(), sigma.len(), rights.len()] != [p.len(); 3] {
        return Err("the numbers of observations differ".into());
    }
    let one = |i: usize| PoseObservation {
        p_world: p[i],
        uv_px: uv[i],
        sigma_px: sigma[i],
        depth: right(rights[i]),
    };
    Ok((0..p.len()).map(one).collect())
}

pub(crate) fn put_poses(out: &mut Outputs, poses: &[Se3]) {
    out.put(
        "rotation",
        poses.iter().map(|p| matrix(&p.rotation.matrix())),
    );
    out.put(
        "translation",
        poses.iter().map(|p| <[f64; 3]>::from(p.translation)),
    );
}

fn put_pose(out: &mut Outputs, pose: &Se3, inlier: &[bool]) {
    out.one("rotation", matrix(&pose.rotation.matrix()));
    out.one("translation", <[f64; 3]>::from(pose.translation));
    out.put("inlier", inlier.iter().copied());
}

pub(crate) fn robust(inputs: &Inputs) -> Answer {
    let scale = inputs.number("scale")?;
    let kernels = [
        ("huber", RobustKernel::Huber { delta: scale }),
        ("cauchy", RobustKernel::Cauchy { c: scale }),
        ("geman_mcclure", RobustKernel::GemanMcClure { c: scale }),
        ("tukey", RobustKernel::Tukey { c: scale }),
    ];
    let kernel = inputs.choice("kernel", &kernels)?;
    let s = inputs.reals("s")?;
    let mut out = Outputs::default();
    out.put("rho", s.iter().map(|s| kernel.rho(*s)));
    out.put("weight", s.iter().map(|s| kernel.weight(*s)));
    Ok(out)
}

pub(crate) fn reprojection(inputs: &Inputs) -> Answer {
    let (camera, bf) = (camera(inputs)?, inputs.number("bf")?);
    let (phi, t) = (vectors::<3>(inputs, "phi")?, vectors::<3>(inputs, "t")?);
    let [mut residual, mut by_pose, mut by_point] = [const { Vec::<f64>::new() }; 3];
    let seen = observations(inputs)?;
    for ((seen, phi), t) in seen.iter().zip(phi).zip(t) {
        let pose = Se3::new(So3::exp(&phi), t);
        let mut recorder = Recorder::<6>::default();
        PoseProblem::new(&camera, bf, None, vec![*seen]).blocks(&pose, &mut recorder);
        let block = recorder
            .blocks
            .first()
            .ok_or("a point without a residual")?;
        residual.extend(&block.residual);
        by_pose.extend(block.jacobian.iter().flat_map(|row| row.iter().copied()));
        let slope = camera.project_jacobian(&(pose * seen.p_world)) * pose.rotation.matrix();
        by_point.extend((slope / seen.sigma_px).transpose().iter().copied());
    }
    let mut out = Outputs::default();
    let n = seen.len();
    out.shaped("residual", &[n, 3], residual)?;
    out.shaped("by_pose", &[n, 3, 6], by_pose)?;
    out.shaped("by_point", &[n, 2, 3], by_point)?;
    Ok(out)
}

/// So many steps, so small a tolerance, that the cost is that of the optimum to its last digit.
fn to_the_optimum(config: PoseConfig) -> PoseConfig {
    PoseConfig {
        iterations: 60,
        cost_tolerance: 1e-18,
        ..config
    }
}

fn pose_config(inputs: &Inputs) -> Result<PoseConfig, Error> {
    Ok(PoseConfig {
        bf: inputs.number("bf")?,
        rounds: inputs.count("rounds")?,
        chi2_2d: inputs.number("chi2_2d")?,
        chi2_3d: inputs.number("chi2_3d")?,
        ..PoseConfig::default()
    })
}

fn solve(inputs: &Inputs, config: &PoseConfig) -> Result<PoseSolution, Error> {
    let start = poses(inputs, "rotation_initial", "translation_initial")?;
    let [start] = start.as_slice() else {
        return Err("not one pose to start from".into());
    };
    Ok(optimise_pose(
        &camera(inputs)?,
        &observations(inputs)?,
        start,
        config,
    )?)
}

pub(crate) fn pose(inputs: &Inputs) -> Answer {
    let solved = solve(inputs, &to_the_optimum(pose_config(inputs)?))?;
    let first = solved.reports.first().ok_or("no round was run")?;
    let mut out = Outputs::default();
    out.one("cost_initial", first.cost0);
    out.one("cost", solved.cost);
    put_pose(&mut out, &solved.camera_from_world, &solved.inlier);
    Ok(out)
}

pub(crate) fn pnp(inputs: &Inputs, par: Par) -> Answer {
    let camera = camera(inputs)?;
    let mut out = Outputs::default();
    if inputs.has_flag("exact") {
        put_triples(&mut out, inputs, &camera)?;
        return Ok(out);
    }
    let config = PnpConfig {
        pose: to_the_optimum(PoseConfig::default()),
        ..PnpConfig::default()
    };
    let found = solve_pnp_ransac(&camera, &observations(inputs)?, &config, par)?;
    let found = found.ok_or("no pose found")?;
    put_pose(&mut out, &found.camera_from_world, &found.inlier);
    Ok(out)
}

/// All poses that see three points so, up to four; NaN in the places left over.
fn put_triples(out: &mut Outputs, inputs: &Inputs, camera: &Camera) -> Result<(), Error> {
    let (points, pixels) = (inputs.rows::<9>("p_world")?, inputs.rows::<6>("uv")?);
    let (mut rotations, mut translations) = (Vec::new(), Vec::new());
    for (p, uv) in points.iter().zip(pixels) {
        let p_world = [0, 1, 2].map(|k| Vector3::from_column_slice(&p[3 * k..][..3]));
        let seen = [0, 1, 2]
            .map(|k| camera.unproject(&Vector2::from_column_slice(&uv[2 * k..][..2]), 1.0));
        let found = p3p(&seen, &p_world);
        let at = |k: usize| found.get(k);
        rotations.push(
            [0, 1, 2, 3]
                .map(|k| at(k).map_or([[f64::NAN; 3]; 3], |p| matrix(&p.rotation.matrix()))),
        );
        translations
            .push([0, 1, 2, 3].map(|k| at(k).map_or([f64::NAN; 3], |p| p.translation.into())));
    }
    out.put("rotation", rotations);
    out.put("translation", translations);
    Ok(())
}

#[cfg(test)]
mod tests {
    use garad_golden::Case;

    use super::*;

    /// With the default budget of 10 trials per round the cost is within 1e-6 of the optimum, and a run never ends
    /// above its start.
    #[test]
    fn ten_trials_are_enough() {
        for case in Case::load_all("pose_lm") {
            let config = pose_config(case.inputs()).unwrap();
            let PoseSolution { cost, reports, .. } = solve(case.inputs(), &config).unwrap();
            let optimum = case.output("cost").f64()[0];
            let name = case.name();
            assert!(
                cost <= optimum * (1.0 + 1e-6),
                "{name}: {cost} against {optimum}, {reports:?}"
            );
            for report in &reports {
                assert!(report.cost <= report.cost0, "{name}: {report:?}");
            }
        }
    }
}
