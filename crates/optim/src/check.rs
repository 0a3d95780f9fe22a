//! [`check_jacobian`]: a Jacobian against finite differences of its residual.

use nalgebra::SVector;

use crate::dense::{Problem, Recorder};

/// The largest difference between a Jacobian and finite differences of its residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JacobianCheck {
    /// |analytic - numeric| over the largest absolute element of that block's Jacobian (of 1 if
    /// that is smaller).
    pub worst: f64,
    /// Block, in the order the problem shows them.
    pub block: usize,
    /// Row: which residual.
    pub row: usize,
    /// Column: which unknown.
    pub column: usize,
    /// The Jacobian's element.
    pub analytic: f64,
    /// The difference quotient.
    pub numeric: f64,
    /// Elements compared; 0 means that nothing was checked.
    pub elements: usize,
}

/// Compares every element of every Jacobian at a state with central differences through the
/// problem's own [`Problem::step`], so that the perturbation convention is checked too.
///
/// f' ≈ (8 [f(h) - f(-h)] - [f(2h) - f(-2h)]) / 12h, error h⁴ f⁽⁵⁾/30                      (E11)
///
/// # Numerics
/// The truncation (h⁴) and the rounding (ε/h) balance near h = 3e-4 for reprojections of points at
/// 0.5 to 6 m, where right Jacobians agree to 1e-10. The unknowns should be of order 1.
///
/// `None` if the number of blocks changes near the state (a block appears, a point leaves).
pub fn check_jacobian<P: Problem<N>, const N: usize>(
    problem: &P,
    state: &P::State,
    h: f64,
) -> Option<JacobianCheck> {
    let record = |column: usize, shift: f64| {
        let mut step = SVector::<f64, N>::zeros();
        step[column] = shift;
        let mut recorder = Recorder::default();
        problem.blocks(&problem.step(state, &step), &mut recorder);
        recorder
    };
    let mut here = Recorder::<N>::default();
    problem.blocks(state, &mut here);
    let mut check = JacobianCheck {
        worst: 0.0,
        block: 0,
        row: 0,
        column: 0,
        analytic: 0.0,
        numeric: 0.0,
        elements: 0,
    };
    for column in 0..N {
        let shifted = [h, -h, 2.0 * h, -2.0 * h].map(|shift| record(column, shift));
        let same_blocks = |r: &Recorder<N>| {
            !r.forbidden
                && r.blocks.len() == here.blocks.len()
                && r.blocks
                    .iter()
                    .zip(&here.blocks)
                    .all(|(a, b)| a.residual.len() == b.residual.len())
        };
        if here.forbidden || !shifted.iter().all(same_blocks) {
            return None;
        }
        for (i, block) in here.blocks.iter().enumerate() {
            let scale = block.jacobian.iter().map(SVector::amax).fold(1.0, f64::max);
            for (row, derivatives) in block.jacobian.iter().enumerate() {
                let at = |k: usize| shifted[k].blocks[i].residual[row];
                let numeric = (8.0 * (at(0) - at(1)) - (at(2) - at(3))) / (12.0 * h);
                let analytic = derivatives[column];
                let error = (analytic - numeric).abs() / scale;
                let error = if error.is_nan() { f64::INFINITY } else { error };
                check.elements += 1;
                if error > check.worst {
                    check = JacobianCheck {
                        worst: error,
                        block: i,
                        row,
                        column,
                        analytic,
                        numeric,
                        elements: check.elements,
                    };
                }
            }
        }
    }
    Some(check)
}
