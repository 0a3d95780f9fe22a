use super::*;
use crate::testing::with_each_solver;
use garad_core::Rng;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

fn filled(n: usize, pairs: &[(usize, usize)]) -> usize {
    Pattern::new(n, pairs.iter().copied(), LinearSolver::Portable)
        .row
        .len()
}

#[test]
fn chains_and_stars_do_not_fill() {
    assert_eq!(filled(5, &[(0, 1), (1, 2), (2, 3), (3, 4)]), 4, "chain");
    assert_eq!(
        filled(5, &[(0, 1), (0, 2), (0, 3), (0, 4)]),
        4,
        "star: its centre goes last"
    );
    assert_eq!(
        filled(4, &[(0, 1), (1, 2), (2, 3), (3, 0)]),
        5,
        "a ring gets one chord"
    );
    assert_eq!(
        filled(3, &[(0, 1), (1, 0), (2, 2)]),
        1,
        "pairs count once, loops not at all"
    );
    assert_eq!(filled(0, &[]), 0, "nothing");
}

/// A unit diagonal of two coupled poses but for one number, which both solvers name.
fn indefinite_matrices_are_errors(solver: LinearSolver) {
    let pattern = Pattern::new(2, [(0, 1)], solver);
    for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut matrix = BlockMatrix::zeros(&pattern);
        for block in &mut matrix.diagonal {
            *block = std::array::from_fn(|i| f64::from(u8::from(i % 7 == 0)));
        }
        matrix.diagonal[1][14] = wrong;
        let error = matrix.solve(&mut [Vector6::zeros(); 2]);
        assert_eq!(
            error.map_err(|e| e.row),
            Err(8),
            "{wrong} at (2, 2) of the second"
        );
    }
}

/// [1 2; 2 1] in two numbers of two poses: every element of the diagonal is positive.
fn positive_diagonals_are_not_enough(solver: LinearSolver) {
    let pattern = Pattern::new(2, [(0, 1)], solver);
    let mut matrix = BlockMatrix::zeros(&pattern);
    for block in &mut matrix.diagonal {
        *block = std::array::from_fn(|i| f64::from(u8::from(i % 7 == 0)));
    }
    matrix.lower[0][0] = 2.0;
    let row = matrix.solve(&mut [Vector6::zeros(); 2]).map_err(|e| e.row);
    assert!(matches!(row, Err(0 | 6)), "{row:?}: whichever comes later");
}

fn nothing_is_solved(solver: LinearSolver) {
    let pattern = Pattern::new(0, [], solver);
    let solved = BlockMatrix::zeros(&pattern).solve(&mut []);
    assert!(solved.is_ok(), "{solved:?}");
}

with_each_solver! {
    indefinite_matrices_are_errors
    positive_diagonals_are_not_enough
    nothing_is_solved
}

/// Σ JᵀJ over random couplings, and an identity.
fn coupled(n: usize, pairs: &[(usize, usize)], rng: &mut Rng) -> DMatrix<f64> {
    let mut full = DMatrix::<f64>::identity(6 * n, 6 * n);
    for &(a, b) in pairs {
        let mut j = DMatrix::<f64>::zeros(6, 6 * n);
        for i in 0..6 {
            for k in 0..6 {
                j[(i, 6 * a + k)] = rng.normal();
                j[(i, 6 * b + k)] = rng.normal();
            }
        }
        full += j.transpose() * j;
    }
    full
}

/// x with A x = b, by blocks.
fn solve(
    full: &DMatrix<f64>,
    pairs: &[(usize, usize)],
    right: &DVector<f64>,
    solver: LinearSolver,
) -> DVector<f64> {
    let n = right.len() / 6;
    let pattern = Pattern::new(n, pairs.iter().copied(), solver);
    let mut matrix = BlockMatrix::zeros(&pattern);
    let mut x = vec![Vector6::zeros(); n];
    for a in 0..n {
        x[pattern.step(a)] = right.fixed_rows::<6>(6 * a).into_owned();
        for b in 0..n {
            let block = |i: usize| full[(6 * a + i % 6, 6 * b + i / 6)];
            let (row, column) = (pattern.step(a), pattern.step(b));
            if a == b {
                matrix.diagonal[row] = std::array::from_fn(block);
            } else if row > column
                && let Some(slot) = pattern.slot(row, column)
            {
                matrix.lower[slot] = std::array::from_fn(block);
            }
        }
    }
    matrix.solve(&mut x).expect("positive definite");
    DVector::from_fn(6 * n, |i, _| x[pattern.step(i / 6)][i % 6])
}

proptest! {
    /// Both solvers against the dense matrix, times their solution, and against each other.
    #[test]
    fn solutions_solve(
        pairs in proptest::collection::vec((0usize..9, 0usize..9), 0..20),
        seed: u64,
    ) {
        let mut rng = Rng::new(seed);
        let full = coupled(9, &pairs, &mut rng);
        let right = DVector::from_fn(54, |_, _| rng.normal());
        let [portable, faer] = [LinearSolver::Portable, LinearSolver::Faer]
            .map(|solver| solve(&full, &pairs, &right, solver));
        for x in [&portable, &faer] {
            prop_assert!((&full * x - &right).amax() < 1e-10, "residual");
        }
        prop_assert!((&portable - &faer).amax() < 1e-10, "{portable} {faer}");
    }
}
