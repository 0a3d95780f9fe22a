//! Poses, points and relations with the least cost.

use garad_core::{Camera, Par, Se3, So3};
use garad_optim::dense::{Problem, Recorder};
use garad_optim::pose::PoseProblem;
use garad_optim::{
    BundleConfig, BundleObservation, DepthObservation, OptimError, PnpConfig, PoseConfig, PoseEdge,
    PoseGraph, PoseGraphConfig, PoseObservation, RobustKernel, optimise_bundle, optimise_pose, p3p,
    solve_pnp_ransac,
};
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};

use super::fields::Fields;
use super::{Outputs, OwnError};

/// Far enough that the optimum is reached to the last digit of the cost.
const STEPS: usize = 300;

fn camera(fields: Fields<'_>) -> Result<Camera, OwnError> {
    let n = |name| fields.number(name);
    let intrinsics = [n("fx")?, n("fy")?, n("cx")?, n("cy")?];
    Camera::pinhole((640, 480), intrinsics).map_err(|error| fields.wrong(error))
}

/// (u_R, σ_R), NaN for none.
fn right([u_px, sigma_px]: [f64; 2]) -> Option<DepthObservation> {
    u_px.is_finite()
        .then_some(DepthObservation::Right { u_px, sigma_px })
}

fn observations(fields: Fields<'_>, depth: bool) -> Result<Vec<PoseObservation>, OwnError> {
    let (p, uv) = (fields.rows::<3>("p_world")?, fields.rows::<2>("uv")?);
    let sigma = fields.reals("sigma")?;
    let rights = match depth {
        true => fields.rows::<2>("right")?,
        false => vec![[f64::NAN; 2]; p.len()],
    };
    if [uv.len(), sigma.len(), rights.len()] != [p.len(); 3] {
        return Err(fields.wrong("the numbers of observations differ"));
    }
    let one = |i: usize| PoseObservation {
        p_world: Vector3::from(p[i]),
        uv_px: Vector2::from(uv[i]),
        sigma_px: sigma[i],
        depth: right(rights[i]),
    };
    Ok((0..p.len()).map(one).collect())
}

fn poses(fields: Fields<'_>, rotation: &str, shift: &str) -> Result<Vec<Se3>, OwnError> {
    let pairs = fields.rows::<9>(rotation)?.into_iter();
    let pairs = pairs.zip(fields.rows::<3>(shift)?);
    Ok(pairs
        .map(|(r, t)| {
            let rotation = So3::from_matrix(&Matrix3::from_row_slice(&r));
            Se3::new(rotation, Vector3::from(t))
        })
        .collect())
}

fn put_poses<'a>(out: &mut Outputs, poses: impl Iterator<Item = &'a Se3> + Clone) {
    let rows = poses.clone().flat_map(|p| {
        let rows = p.rotation.matrix().transpose();
        rows.iter().copied().collect::<Vec<f64>>()
    });
    out.put("rotation", rows);
    out.put(
        "translation",
        poses.flat_map(|p| <[f64; 3]>::from(p.translation)),
    );
}

fn flags(values: &[bool]) -> impl Iterator<Item = u8> {
    values.iter().map(|v| u8::from(*v))
}

pub(super) fn robust(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let scale = fields.number("scale")?;
    let kernel = match fields.word("kernel")? {
        "huber" => RobustKernel::Huber { delta: scale },
        "cauchy" => RobustKernel::Cauchy { c: scale },
        "geman_mcclure" => RobustKernel::GemanMcClure { c: scale },
        "tukey" => RobustKernel::Tukey { c: scale },
        other => return Err(fields.wrong(format!("kernel '{other}'"))),
    };
    let s = fields.reals("s")?;
    let mut out = Outputs::default();
    out.put("rho", s.iter().map(|s| kernel.rho(*s)));
    out.put("weight", s.iter().map(|s| kernel.weight(*s)));
    Ok(out)
}

pub(super) fn reprojection(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let (camera, bf) = (camera(fields)?, fields.number("bf")?);
    let (phi, t) = (fields.rows::<3>("phi")?, fields.rows::<3>("t")?);
    let [mut residual, mut by_pose, mut by_point] = [const { Vec::<f64>::new() }; 3];
    for ((seen, phi), t) in observations(fields, true)?.into_iter().zip(phi).zip(t) {
        let pose = Se3::new(So3::exp(&Vector3::from(phi)), Vector3::from(t));
        let mut recorder = Recorder::<6>::default();
        PoseProblem::new(&camera, bf, None, vec![seen]).blocks(&pose, &mut recorder);
        let block = recorder.blocks.first();
        let block = block.ok_or_else(|| fields.wrong("a point without a residual"))?;
        residual.extend(&block.residual);
        by_pose.extend(block.jacobian.iter().flat_map(|row| row.iter().copied()));
        let slope = camera.project_jacobian(&(pose * seen.p_world)) * pose.rotation.matrix();
        by_point.extend((slope / seen.sigma_px).transpose().iter().copied());
    }
    let mut out = Outputs::default();
    out.put("residual", residual);
    out.put("by_pose", by_pose);
    out.put("by_point", by_point);
    Ok(out)
}

fn to_the_optimum() -> PoseConfig {
    PoseConfig {
        iterations: STEPS,
        cost_tolerance: 1e-18,
        ..PoseConfig::default()
    }
}

pub(super) fn pose(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let config = PoseConfig {
        bf: fields.number("bf")?,
        rounds: fields.count("rounds")?,
        chi2_2d: fields.number("chi2_2d")?,
        chi2_3d: fields.number("chi2_3d")?,
        ..to_the_optimum()
    };
    let start = poses(fields, "rotation_initial", "translation_initial")?;
    let [start] = start.as_slice() else {
        return Err(fields.wrong("not one pose to start from"));
    };
    let seen = observations(fields, true)?;
    let solved = optimise_pose(&camera(fields)?, &seen, start, &config);
    let solved = solved.map_err(|error| fields.wrong(error))?;
    let mut out = Outputs::default();
    out.put("cost_initial", solved.reports.first().map(|r| r.cost0));
    out.put("cost", [solved.cost]);
    put_poses(&mut out, [solved.camera_from_world].iter());
    out.put_whole("inlier", flags(&solved.inlier));
    Ok(out)
}

pub(super) fn pnp(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let camera = camera(fields)?;
    let mut out = Outputs::default();
    if fields.0.has_flag("exact") {
        put_poses(&mut out, of_triples(fields, &camera)?.iter());
        return Ok(out);
    }
    let config = PnpConfig {
        pose: to_the_optimum(),
        ..PnpConfig::default()
    };
    let seen = observations(fields, false)?;
    let found = solve_pnp_ransac(&camera, &seen, &config, Par::Seq);
    let found = found.map_err(|error| fields.wrong(error))?;
    let found = found.ok_or_else(|| fields.wrong("no pose found"))?;
    put_poses(&mut out, [found.camera_from_world].iter());
    out.put_whole("inlier", flags(&found.inlier));
    Ok(out)
}

/// Of the answers to a triple the one nearest to the expected: which of them it is, nothing tells.
fn of_triples(fields: Fields<'_>, camera: &Camera) -> Result<Vec<Se3>, OwnError> {
    if !(fields.asks("rotation") && fields.asks("translation")) {
        return Err(fields.wrong("poses of triples are compared with expected ones"));
    }
    let expected = |name| fields.0.output(name).f64();
    let (rotation, translation) = (expected("rotation"), expected("translation"));
    let (points, pixels) = (fields.rows::<9>("p_world")?, fields.rows::<6>("uv")?);
    let mut found = Vec::new();
    for (i, (p, uv)) in points.iter().zip(pixels).enumerate() {
        let truth = Se3::new(
            So3::from_matrix(&Matrix3::from_row_slice(&rotation[9 * i..9 * i + 9])),
            Vector3::from_column_slice(&translation[3 * i..3 * i + 3]),
        );
        let p_world = [0, 1, 2].map(|k| Vector3::from_column_slice(&p[3 * k..3 * k + 3]));
        let seen =
            [0, 1, 2].map(|k| camera.unproject(&Vector2::new(uv[2 * k], uv[2 * k + 1]), 1.0));
        let error = |pose: &Se3| (*pose * truth.inverse()).log().norm();
        let all = p3p(&seen, &p_world);
        let nearest = all.iter().min_by(|a, b| error(a).total_cmp(&error(b)));
        found.push(*nearest.ok_or_else(|| fields.wrong(format!("triple {i} has no pose")))?);
    }
    Ok(found)
}

fn index(fields: Fields<'_>, i: f64) -> Result<usize, OwnError> {
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked before"
    )]
    let whole = (0.0..1e9).contains(&i).then_some(i as usize);
    whole.ok_or_else(|| fields.wrong(format!("{i} is no index")))
}

pub(super) fn bundle(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let mut poses = poses(fields, "rotation_initial", "translation_initial")?;
    let fixed: Vec<bool> = fields.bytes("fixed")?.iter().map(|f| *f == 1).collect();
    let points = fields.rows::<3>("points_initial")?.into_iter();
    let mut points: Vec<_> = points.map(Vector3::from).collect();
    let rows = fields.rows::<2>("observed")?.into_iter();
    let rows = rows
        .zip(fields.rows::<2>("uv")?)
        .zip(fields.reals("sigma")?);
    let mut seen = Vec::new();
    for (((of, uv), sigma_px), pair) in rows.zip(fields.rows::<2>("right")?) {
        seen.push(BundleObservation {
            pose: index(fields, of[0])?,
            point: index(fields, of[1])?,
            uv_px: Vector2::from(uv),
            sigma_px,
            depth: right(pair),
        });
    }
    let config = BundleConfig {
        chi2_2d: fields.number("chi2_2d")?,
        chi2_3d: fields.number("chi2_3d")?,
        iterations: STEPS,
        cost_tolerance: 1e-18,
        ..BundleConfig::default()
    };
    let (camera, bf) = (camera(fields)?, fields.number("bf")?);
    let report = optimise_bundle(&camera, bf, &mut poses, &fixed, &mut points, &seen, &config);
    let report = report.map_err(|error: OptimError| fields.wrong(error))?;
    let mut out = Outputs::default();
    out.put("cost_initial", [report.report.cost0]);
    out.put("cost", [report.report.cost]);
    put_poses(&mut out, poses.iter());
    out.put("points", points.into_iter().flat_map(<[f64; 3]>::from));
    Ok(out)
}

pub(super) fn pose_graph(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let start = poses(fields, "rotation_initial", "translation_initial")?;
    let measured = poses(fields, "edge_rotation", "edge_translation")?.into_iter();
    let rows = fields.rows::<2>("edges")?.into_iter().zip(measured);
    let mut edges = Vec::new();
    for ((ends, a_from_b), information) in rows.zip(fields.rows::<36>("information")?) {
        edges.push(PoseEdge {
            a: index(fields, ends[0])?,
            b: index(fields, ends[1])?,
            a_from_b,
            information: Matrix6::from_row_slice(&information),
        });
    }
    let mut graph = PoseGraph {
        fixed: (0..start.len()).map(|k| k == 0).collect(),
        poses: start,
        edges,
    };
    let config = PoseGraphConfig {
        iterations: STEPS,
        cost_tolerance: 1e-20,
        ..PoseGraphConfig::default()
    };
    let report = graph
        .optimise(&config)
        .map_err(|error| fields.wrong(error))?;
    let mut out = Outputs::default();
    out.put("cost_initial", [report.report.cost0]);
    out.put("cost", [report.report.cost]);
    put_poses(&mut out, graph.poses.iter());
    Ok(out)
}
