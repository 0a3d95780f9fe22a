//! Many poses at once: with points, and by their relations.

use garad_core::Se3;
use garad_golden::Inputs;
use garad_optim::{
    BundleConfig, BundleObservation, PoseEdge, PoseGraph, PoseGraphConfig, Report, optimise_bundle,
};
use nalgebra::{Matrix6, Vector3};

use crate::convert::{poses, vectors};
use crate::outputs::{Answer, Error, Outputs};
use crate::poses::{camera, put_poses, right};

/// Poses, points, and how the adjustment went.
type Adjusted = (Vec<Se3>, Vec<Vector3<f64>>, Report);

fn adjust(inputs: &Inputs, config: BundleConfig) -> Result<Adjusted, Error> {
    let config = BundleConfig {
        chi2_2d: inputs.number("chi2_2d")?,
        chi2_3d: inputs.number("chi2_3d")?,
        ..config
    };
    let mut poses = poses(inputs, "rotation_initial", "translation_initial")?;
    let fixed: Vec<bool> = inputs.bytes("fixed")?.iter().map(|f| *f == 1).collect();
    let mut points = vectors::<3>(inputs, "points_initial")?;
    let observed = inputs.indices("observed")?;
    let rows = observed.chunks_exact(2).zip(vectors::<2>(inputs, "uv")?);
    let rows = rows
        .zip(inputs.reals("sigma")?)
        .zip(inputs.rows::<2>("right")?);
    let seen = rows.map(|(((of, uv_px), sigma_px), pair)| BundleObservation {
        pose: of[0],
        point: of[1],
        uv_px,
        sigma_px,
        depth: right(pair),
    });
    let seen: Vec<_> = seen.collect();
    let (camera, bf) = (camera(inputs)?, inputs.number("bf")?);
    let found = optimise_bundle(&camera, bf, &mut poses, &fixed, &mut points, &seen, &config)?;
    Ok((poses, points, found.report))
}

pub(crate) fn bundle(inputs: &Inputs) -> Answer {
    let config = BundleConfig {
        iterations: 300,
        cost_tolerance: 1e-18,
        ..BundleConfig::default()
    };
    let (poses, points, report) = adjust(inputs, config)?;
    let mut out = Outputs::default();
    out.one("cost_initial", report.cost0);
    out.one("cost", report.cost);
    put_poses(&mut out, &poses);
    out.put("points", points.into_iter().map(<[f64; 3]>::from));
    Ok(out)
}

fn solve_graph(inputs: &Inputs, config: &PoseGraphConfig) -> Result<(Vec<Se3>, Report), Error> {
    let start = poses(inputs, "rotation_initial", "translation_initial")?;
    let measured = poses(inputs, "edge_rotation", "edge_translation")?;
    let ends = inputs.indices("edges")?;
    let rows = ends
        .chunks_exact(2)
        .zip(measured)
        .zip(inputs.rows::<36>("information")?);
    let edges = rows.map(|((ends, a_from_b), information)| PoseEdge {
        a: ends[0],
        b: ends[1],
        a_from_b,
        information: Matrix6::from_row_slice(&information),
    });
    let mut graph = PoseGraph {
        fixed: (0..start.len()).map(|k| k == 0).collect(),
        poses: start,
        edges: edges.collect(),
    };
    let found = graph.optimise(config)?;
    Ok((graph.poses, found.report))
}

pub(crate) fn pose_graph(inputs: &Inputs) -> Answer {
    let config = PoseGraphConfig {
        iterations: 100,
        cost_tolerance: 1e-20,
        ..PoseGraphConfig::default()
    };
    let (poses, report) = solve_graph(inputs, &config)?;
    let mut out = Outputs::default();
    out.one("cost_initial", report.cost0);
    out.one("cost", report.cost);
    put_poses(&mut out, &poses);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use garad_golden::Case;
    use garad_optim::StopReason;

    use super::*;

    fn assert_at_the_optimum(case: &Case, report: &Report) {
        let optimum = case.output("cost").f64()[0];
        let near = report.cost <= optimum * (1.0 + 1e-6);
        assert!(
            near && report.stop == StopReason::Converged,
            "{}: {report:?}, {optimum}",
            case.name()
        );
    }

    /// At its default stop the cost is within 1e-6 of the optimum.
    #[test]
    fn bundles_stop_at_the_optimum() {
        for case in Case::load_all("bundle") {
            let config = BundleConfig {
                iterations: 40,
                ..BundleConfig::default()
            };
            let (.., report) = adjust(case.inputs(), config).unwrap();
            assert_at_the_optimum(&case, &report);
        }
    }

    /// With the default settings the cost is within 1e-6 of the optimum.
    #[test]
    fn pose_graphs_stop_at_the_optimum() {
        for case in Case::load_all("pose_graph") {
            let (_, report) = solve_graph(case.inputs(), &PoseGraphConfig::default()).unwrap();
            assert_at_the_optimum(&case, &report);
        }
    }
}
