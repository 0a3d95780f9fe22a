//! What the tests of several modules share.

/// `portable::name` and `faer::name`, tests that call `name` with that solver.
macro_rules! with_each_solver {
    ($($name:ident)*) => {
        mod portable {
            $(#[test]
            fn $name() {
                super::$name($crate::LinearSolver::Portable);
            })*
        }
        mod faer {
            $(#[test]
            fn $name() {
                super::$name($crate::LinearSolver::Faer);
            })*
        }
    };
}

pub(crate) use with_each_solver;
