//! The path of a minimisation, trial by trial: by a model that answers from a list, and by hand on one unknown.

use std::cell::Cell;

use super::*;
use crate::dense::{Dense, Problem, Visitor};
use crate::robust::RobustKernel;
use nalgebra::{SMatrix, SVector};

/// What the model answers to one trial: the decrease that it predicts and the cost after the step;
/// `None` where the system has no solution.
type Answer = Option<(f64, f64)>;

/// A state is its cost; the gradient is twice as large.
struct Script<'a> {
    answers: &'a [Answer],
    next: Cell<usize>,
}

struct Here<'a>(f64, &'a Script<'a>);

impl<'a> Model for &'a Script<'a> {
    type State = f64;
    type System = Here<'a>;

    fn cost(&self, state: &f64) -> f64 {
        *state
    }

    fn linearise(&self, state: &f64) -> Here<'a> {
        Here(*state, self)
    }

    fn step(&self, _: &f64, step: &f64) -> f64 {
        *step
    }
}

impl System for Here<'_> {
    type Step = f64;

    fn cost(&self) -> f64 {
        self.0
    }

    fn gradient_norm(&self) -> f64 {
        2.0 * self.0
    }

    fn solve(&self, _: f64) -> Option<Damped<f64>> {
        let answer = self.1.answers.get(self.1.next.get()).copied().flatten();
        self.1.next.set(self.1.next.get() + 1);
        answer.map(|(model_decrease, step)| Damped {
            step,
            model_decrease,
        })
    }
}

fn config(iterations: usize) -> LmConfig {
    LmConfig {
        iterations,
        lambda: 0.5,
        cost_tolerance: 0.125,
        cost_floor: 0.25,
    }
}

/// The trials and the report from a cost, and where it ended.
fn path(cost: f64, answers: &[Answer], config: &LmConfig) -> (Vec<Trial>, Report, f64) {
    let next = Cell::new(0);
    let script = Script { answers, next };
    let mut trials = Vec::new();
    let (state, report) = minimise_observed(&&script, cost, config, |t| trials.push(*t));
    (trials, report, state)
}

#[test]
fn damping_follows_the_gain_trial_by_trial() {
    let answers = [
        Some((8.0, 10.0)),     // ρ = ¾: λ (1 - ½³)
        Some((4.0, 9.0)),      // ρ = ¼: λ (1 + ½³)
        Some((4.0, 10.0)),     // dearer: 2 λ
        None,                  // no solution: 4 λ
        Some((0.5, f64::NAN)), // 8 λ; a small prediction after a rejection is no convergence
        Some((0.5, 8.5)),      // ρ = 1: λ/3, and the next factor is 2 again
        Some((4.0, 8.5)),      // as dear is not less: 2 λ
        Some((8.0, 0.5)),
    ];
    let (trials, report, state) = path(16.0, &answers, &config(8));
    // λ, cost before and after, gain ratio, taken
    let expected = [
        (0.5, 16.0, 10.0, 0.75, true),
        (0.4375, 10.0, 9.0, 0.25, true),
        (0.492_187_5, 9.0, 10.0, -0.25, false),
        (0.984_375, 9.0, f64::NAN, f64::NAN, false),
        (3.9375, 9.0, f64::NAN, f64::NAN, false),
        (31.5, 9.0, 8.5, 1.0, true),
        (10.5, 8.5, 8.5, 0.0, false),
        (21.0, 8.5, 0.5, 1.0, true),
    ];
    assert_eq!(trials.len(), expected.len(), "{trials:?}");
    for (i, (trial, (lambda, cost, new_cost, gain_ratio, accepted))) in
        trials.iter().zip(expected).enumerate()
    {
        let same = |a: f64, b: f64| (a.is_nan() && b.is_nan()) || (a - b).abs() <= 1e-15 * b.abs();
        assert!(
            same(trial.lambda, lambda)
                && same(trial.cost, cost)
                && same(trial.new_cost, new_cost)
                && same(trial.gain_ratio, gain_ratio)
                && trial.accepted == accepted,
            "trial {i}: {trial:?}"
        );
    }
    let expected = Report {
        cost0: 16.0,
        cost: 0.5,
        iterations: 4,
        rejected: 4,
        grad_norm: 1.0,
        stop: StopReason::IterationLimit,
    };
    assert_eq!(report, expected, "the report");
    assert!(
        (state - 0.5).abs() < 1e-300,
        "the last state taken: {state}"
    );
}

/// What, cost, answers, configuration, reason, taken, rejected.
type Case<'a> = (
    &'a str,
    f64,
    &'a [Answer],
    LmConfig,
    StopReason,
    usize,
    usize,
);

#[test]
fn every_reason_to_stop_on_both_sides() {
    let seven = config(7);
    let start_at = |lambda: f64| LmConfig { lambda, ..seven };
    let never = [None; 20];
    let up = [Some((4.0, 17.0)); 20];
    #[rustfmt::skip]
    let cases: [Case<'_>; 13] = [
        ("an eighth of 16 is expected", 16.0, &[Some((2.0, 8.0))], seven, StopReason::Converged, 0, 0),
        ("more is expected, then nothing is solved", 16.0, &[Some((2.001, 8.0))], seven, StopReason::IterationLimit, 1, 6),
        ("at the floor", 0.25, &[], seven, StopReason::Converged, 0, 0),
        ("above the floor", 0.251, &[], seven, StopReason::IterationLimit, 0, 7),
        ("down to the floor at the last trial", 16.0, &[Some((4.0, 0.25))], config(1), StopReason::Converged, 1, 0),
        ("no trial", 16.0, &up, config(0), StopReason::IterationLimit, 0, 0),
        ("the gradient is zero", 0.0, &up, seven, StopReason::ZeroGradient, 0, 0),
        ("the cost is NaN", f64::NAN, &up, seven, StopReason::NotFinite, 0, 0),
        ("the gradient overflows", 1e308, &up, seven, StopReason::NotFinite, 0, 0),
        ("the largest λ", 16.0, &never, start_at(1e16), StopReason::Stalled, 0, 1),
        ("beyond it", 16.0, &never, start_at(1.001e16), StopReason::Stalled, 0, 0),
        // λ = 2^(n (n + 1)/2) after n rejections: 2^45 after 9, 2^55 = 3.6e16 after 10
        ("dearer every time", 16.0, &up, LmConfig { iterations: 20, ..start_at(1.0) }, StopReason::Stalled, 0, 10),
        ("dearer, and the limit", 16.0, &up, LmConfig { iterations: 9, ..start_at(1.0) }, StopReason::IterationLimit, 0, 9),
    ];
    for (what, cost, answers, config, stop, taken, rejected) in cases {
        let (trials, report, _) = path(cost, answers, &config);
        assert_eq!(
            (
                report.stop,
                report.iterations,
                report.rejected,
                trials.len()
            ),
            (stop, taken, rejected, taken + rejected),
            "{what}: {report:?}"
        );
    }
}

/// One residual of one unknown, and its derivative.
struct OneResidual(RobustKernel, fn(f64) -> (f64, f64));

impl Problem<1> for OneResidual {
    type State = f64;

    fn blocks(&self, x: &f64, visitor: &mut impl Visitor<1>) {
        let (r, j) = (self.1)(*x);
        visitor.block(self.0, &SVector::from([r]), || SMatrix::<f64, 1, 1>::new(j));
    }

    fn step(&self, x: &f64, step: &SVector<f64, 1>) -> f64 {
        x + step[0]
    }
}

/// h = -g / ((1 + λ) H), and the gain ratio is F(x) - F(x + h) over ½ h (λ H h - g).
#[test]
fn first_steps_of_one_unknown_by_hand() {
    let huber = RobustKernel::Huber { delta: 2.0 };
    // problem, x, λ; x + h, cost before and after, gain ratio
    #[rustfmt::skip]
    let cases = [
        // r = x²: H = 16, g = 16, h = -16/32, ½ h (16 h - 16) = 6
        (OneResidual(RobustKernel::None, |x| (x * x, 2.0 * x)), 2.0, 1.0, [1.5, 8.0, 2.531_25, 175.0 / 192.0]),
        // r = x - 5 = -5: ρ' = 2/5, H = 0.4, g = -2, h = 2/0.5; ½ · 4 (0.1 · 4 + 2) = 4.8
        (OneResidual(huber, |x| (x - 5.0, 1.0)), 0.0, 0.25, [4.0, 8.0, 0.5, 7.5 / 4.8]),
        // r = 3 x - 6 = -3: ρ' = 2/3, H = 6, g = -6, h = 6/7.5; ½ · 0.8 (1.5 · 0.8 + 6) = 2.88
        (OneResidual(huber, |x| (3.0 * x - 6.0, 3.0)), 1.0, 0.25, [1.8, 4.0, 0.18, 3.82 / 2.88]),
    ];
    for (i, (problem, x, lambda, [moved, before, after, gain])) in cases.iter().enumerate() {
        let config = LmConfig {
            lambda: *lambda,
            ..config(1)
        };
        let mut trial = None;
        let (state, report) = minimise_observed(&Dense(problem), *x, &config, |t| trial = Some(*t));
        let trial = trial.expect("one trial");
        let errors = [
            state - moved,
            trial.cost - before,
            trial.new_cost - after,
            trial.gain_ratio - gain,
            report.cost0 - before,
            report.cost - after,
        ];
        assert!(errors.iter().all(|e| e.abs() < 1e-14), "{i}: {errors:?}");
        assert!((trial.lambda - lambda).abs() < 1e-300, "{i}: {trial:?}");
    }
}
