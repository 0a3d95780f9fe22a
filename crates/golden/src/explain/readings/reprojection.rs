//! Residuals and Jacobians of the pose with one mistake: docs/math.md E12.

use super::Reading;
use crate::explain::suspect::Suspect;

const NO_SIGMA: &str = "residual and Jacobian are not divided by σ of the keypoint";
const SIGMA_SQUARED: &str = "residual and Jacobian are divided by σ², not by σ";
const NOT_TURNED: &str = "the Jacobian by a point of the world lacks the rotation of the camera";

/// Of `reprojection`. The third row, that of the right image, has a σ of its own.
pub(super) fn readings(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let inputs = s.case.inputs();
    let sigma = inputs.reals("sigma").ok()?;
    let &[points, rows, ..] = s.shape else {
        return None;
    };
    if points != sigma.len() {
        return None;
    }
    let width = s.expected.len() / (points * rows).max(1);
    let by = |power: i32| -> Vec<f64> {
        let pairs = s.expected.iter().enumerate();
        let factor = |i: usize| match i / width % rows {
            2 => 1.0,
            _ => libm::pow(sigma[i / width / rows], f64::from(power)),
        };
        pairs.map(|(i, e)| e * factor(i)).collect()
    };
    let mut all = vec![(NO_SIGMA, by(1)), (SIGMA_SQUARED, by(-1))];
    if s.output == "by_point" {
        let turns = inputs.rows::<3>("phi").ok()?;
        let free = s.expected.iter().enumerate().map(|(i, _)| {
            let r = rotation(turns[i / 3 / rows]);
            let row = &s.expected[i - i % 3..][..3];
            // The row times the transpose of R: J without R.
            let [a, b, c] = r[i % 3];
            row[0] * a + row[1] * b + row[2] * c
        });
        all.push((NOT_TURNED, free.collect()));
    }
    Some(all)
}

/// Rodrigues' formula.
fn rotation(phi: [f64; 3]) -> [[f64; 3]; 3] {
    let angle = phi.iter().map(|v| v * v).sum::<f64>().sqrt();
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    let [x, y, z] = phi.map(|v| if angle > 0.0 { v / angle } else { 0.0 });
    let axis = [x, y, z];
    let cross = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
    [0, 1, 2].map(|a| {
        [0, 1, 2].map(|b| {
            let unit = if a == b { cos } else { 0.0 };
            unit + sin * cross[a][b] + (1.0 - cos) * axis[a] * axis[b]
        })
    })
}
