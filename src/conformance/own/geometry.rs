//! Poses and cameras.

use garad_core::{Camera, Distortion, Se3, So3};
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3, Vector6};

use super::fields::Fields;
use super::{Outputs, OwnError};

/// Row by row.
fn flat<const R: usize, const C: usize>(m: &SMatrix<f64, R, C>) -> Vec<f64> {
    m.transpose().iter().copied().collect()
}

pub(super) fn se3(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let triples = |name| -> Result<Vec<Vector3<f64>>, OwnError> {
        Ok(fields
            .rows::<3>(name)?
            .into_iter()
            .map(Vector3::from)
            .collect())
    };
    let (phis, rhos) = (triples("phi")?, triples("rho")?);
    // The logarithm is taken of the matrices expected, which are numbers in f64.
    let case = fields.0;
    let known = case.output_names().any(|name| name == "rotation");
    let matrices = if known {
        case.output("rotation").f64()
    } else {
        Vec::new()
    };
    if rhos.len() != phis.len() || matrices.len() != 9 * phis.len() {
        return Err(fields.wrong("phi, rho and rotation differ in number"));
    }
    // Near a half turn the sign of the axis is free.
    let free = case.has_flag("log_sign_free");
    let mut columns: [Vec<f64>; 9] = Default::default();
    for ((phi, rho), matrix) in phis.iter().zip(&rhos).zip(matrices.chunks_exact(9)) {
        let rotation = So3::exp(phi);
        let pose = Se3::exp(&Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z));
        let log = Se3::new(So3::from_matrix(&Matrix3::from_row_slice(matrix)), *rho).log();
        let turn = Vector3::new(log[3], log[4], log[5]);
        let turn = if free && turn.dot(phi) < 0.0 {
            -turn
        } else {
            turn
        };
        let parts = [
            flat(&rotation.matrix()),
            rotation.quaternion().to_vec(),
            flat(&So3::left_jacobian(phi)),
            flat(&So3::left_jacobian_inverse(phi)),
            flat(&pose.translation),
            flat(&Se3::left_jacobian_q(rho, phi)),
            flat(&pose.adjoint()),
            flat(&turn),
            log.iter().take(3).copied().collect(),
        ];
        for (column, part) in columns.iter_mut().zip(parts) {
            column.extend(part);
        }
    }
    let names = [
        "rotation",
        "quaternion",
        "jacobian",
        "jacobian_inverse",
        "translation",
        "q",
        "adjoint",
        "log_rotation",
        "log_translation",
    ];
    let mut out = Outputs::default();
    for (name, column) in names.into_iter().zip(columns) {
        out.put(name, column);
    }
    Ok(out)
}

fn calibration(fields: Fields<'_>) -> Result<Camera, OwnError> {
    let n = |name| fields.number(name);
    let camera = Camera {
        width: fields.count("width")?,
        height: fields.count("height")?,
        fx: n("fx")?,
        fy: n("fy")?,
        cx: n("cx")?,
        cy: n("cy")?,
        distortion: Distortion {
            k1: n("k1")?,
            k2: n("k2")?,
            p1: n("p1")?,
            p2: n("p2")?,
            k3: n("k3")?,
        },
    };
    camera.validate().map_err(|error| fields.wrong(error))?;
    Ok(camera)
}

pub(super) fn camera(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let camera = calibration(fields)?;
    let nan = || Vector2::repeat(f64::NAN);
    let pixels = fields.rows::<2>("pixels")?.into_iter().map(Vector2::from);
    let points: Vec<_> = fields
        .rows::<3>("points")?
        .into_iter()
        .map(Vector3::from)
        .collect();
    let mut out = Outputs::default();
    let bent = pixels.clone().map(|p| camera.distort_pixel(&p));
    out.put("distorted", bent.flat_map(|p| [p.x, p.y]));
    let straight = pixels.map(|p| camera.undistort_pixel(&p).unwrap_or_else(nan));
    out.put("undistorted", straight.flat_map(|p| [p.x, p.y]));
    let seen = points.iter().map(|p| camera.project(p).unwrap_or_else(nan));
    out.put("projected", seen.flat_map(|p| [p.x, p.y]));
    let slopes = points.iter().map(|p| camera.project_jacobian(p));
    out.put("jacobian", slopes.flat_map(|m| flat(&m)));
    Ok(out)
}
