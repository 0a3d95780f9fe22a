//! [`rigid_from_pairs`]: a rigid motion from pairs of points, in closed form.

use garad_core::{Se3, So3};
use nalgebra::{Matrix3, Vector3};

/// The motion a_from_b that fits the pairs (a, b) in least squares (Kabsch 1976):
/// H = Σ (b - b̄)(a - ā)ᵀ = U S Vᵀ, R = V diag(1, 1, det(V Uᵀ)) Uᵀ, t = ā - R b̄ (E16).
///
/// `None` for fewer than three pairs or numbers that are not finite. Collinear pairs leave the rotation
/// about their line open: one of the many motions is returned.
#[must_use]
pub(crate) fn rigid_from_pairs(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Se3> {
    if pairs.len() < 3 {
        return None;
    }
    let n = pairs.len() as f64;
    let mut mean_a = Vector3::zeros();
    let mut mean_b = Vector3::zeros();
    for (a, b) in pairs {
        mean_a += a / n;
        mean_b += b / n;
    }
    let mut h = Matrix3::zeros();
    for (a, b) in pairs {
        h += (b - mean_b) * (a - mean_a).transpose();
    }
    if !h.iter().all(|v| v.is_finite()) {
        return None;
    }
    let svd = h.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    let sign = if (v * u.transpose()).determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    let r = v * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * u.transpose();
    let rotation = So3::from_matrix(&r);
    Some(Se3::new(rotation, mean_a - rotation * mean_b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn closed_form_gives_the_motion_back() {
        let a_from_b = Se3::exp(&Vector6::new(0.3, -0.2, 1.0, 0.4, -1.1, 2.0));
        let points = [
            [0.0, 0.0, 1.0],
            [1.0, 0.2, 2.0],
            [-0.4, 0.9, 1.5],
            [0.1, -0.7, 3.0],
        ];
        let pairs: Vec<_> = points
            .iter()
            .map(|p| Vector3::from(*p))
            .map(|b| (a_from_b * b, b))
            .collect();
        for n in [3, 4] {
            let found = rigid_from_pairs(&pairs[..n]).expect("enough pairs");
            assert!(
                (found * a_from_b.inverse()).log().norm() < 1e-13,
                "{n} pairs"
            );
        }
        assert!(
            rigid_from_pairs(&pairs[..2]).is_none(),
            "two do not fix a rotation"
        );
        let nan = [(Vector3::repeat(f64::NAN), Vector3::x()); 3];
        assert!(rigid_from_pairs(&nan).is_none(), "NaN");
    }
}
