//! [`CaseVerdict`]: what is said of one case, output by output.

use crate::case::Case;
use crate::compare::Comparison;
use crate::metrics::Metrics;
use crate::tensor::Dtype;

/// The verdict on one output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Within tolerance.
    Pass,
    /// No answer.
    Missing,
    /// Out of tolerance.
    Fail,
    /// NaN or an infinity where a number is expected.
    NonFinite,
    /// Another shape.
    Shape,
    /// A file that is not a `.npy` file of a known type.
    Unreadable,
}

impl Verdict {
    /// One word.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Missing => "missing",
            Self::Fail => "FAIL",
            Self::NonFinite => "NONFINITE",
            Self::Shape => "SHAPE",
            Self::Unreadable => "UNREADABLE",
        }
    }
}

/// What is said of one output.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputVerdict {
    /// Output.
    pub name: String,
    /// Verdict.
    pub verdict: Verdict,
    /// Type of the answer, if there is one.
    pub dtype: Option<Dtype>,
    /// The worst element, if element could be compared with element.
    pub comparison: Option<Comparison>,
    /// How it differs as a whole, if it is a list of reals out of tolerance.
    pub metrics: Option<Metrics>,
    /// What else helps: the mistake that explains the answer, what the shape should be.
    pub note: Option<String>,
}

/// How a port ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// Every output within tolerance.
    Pass,
    /// An output is not.
    Fail,
    /// No output at all.
    Missing,
    /// The port says it does not do this stage.
    Unsupported,
    /// The port ended with an error; its code and the end of its output.
    Crash(String),
    /// The port took longer than it may.
    Timeout(String),
}

impl Outcome {
    /// One word.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::Missing => "missing",
            Self::Unsupported => "unsupported",
            Self::Crash(_) => "CRASH",
            Self::Timeout(_) => "TIMEOUT",
        }
    }
}

/// What is said of one case.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseVerdict {
    /// Stage.
    pub stage: String,
    /// Case.
    pub case: String,
    /// Where its expected values come from.
    pub basis: String,
    /// How it went.
    pub outcome: Outcome,
    /// Output by output, sorted by name.
    pub outputs: Vec<OutputVerdict>,
}

impl CaseVerdict {
    /// A case that gave no outputs to compare.
    #[must_use]
    pub fn without_outputs(case: &Case, outcome: Outcome) -> Self {
        Self {
            stage: case.stage().to_owned(),
            case: case.case().to_owned(),
            basis: case.basis().to_owned(),
            outcome,
            outputs: Vec::new(),
        }
    }

    /// Whether the run as a whole fails by this case.
    #[must_use]
    pub fn fails(&self, allow_missing: bool) -> bool {
        match self.outcome {
            Outcome::Pass | Outcome::Unsupported => false,
            Outcome::Missing => !allow_missing,
            _ => true,
        }
    }

    /// The output that is furthest from its tolerance's inside.
    #[must_use]
    pub fn worst(&self) -> Option<&OutputVerdict> {
        let ratio = |o: &OutputVerdict| o.comparison.as_ref().map_or(-1.0, |c| c.worst);
        let by = |a: &&OutputVerdict, b: &&OutputVerdict| {
            a.verdict
                .cmp(&b.verdict)
                .then(ratio(a).total_cmp(&ratio(b)))
        };
        self.outputs.iter().max_by(by)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tensor::Tensor;
    use crate::tol::{Class, Tolerance};

    fn output(name: &str, verdict: Verdict, off: Option<f64>) -> OutputVerdict {
        let tolerance = Tolerance {
            name: "test",
            class: Class::AbsRel { abs: 0.5, rel: 0.0 },
            reason: "test",
        };
        let one = Tensor::from(vec![1.0]);
        let compare = |off: f64| crate::compare::compare(&one, &[1.0 + off], &tolerance);
        OutputVerdict {
            name: name.to_owned(),
            verdict,
            dtype: None,
            comparison: off.map(|off| compare(off).expect("one number")),
            metrics: None,
            note: None,
        }
    }

    fn case(outcome: Outcome, outputs: Vec<OutputVerdict>) -> CaseVerdict {
        CaseVerdict {
            stage: "se3".to_owned(),
            case: "c".to_owned(),
            basis: "closed-form".to_owned(),
            outcome,
            outputs,
        }
    }

    /// The worse verdict first, then the larger share of the tolerance; nothing to compare is least.
    #[test]
    fn the_worst_output_by_hand() {
        let pass = |name, off| output(name, Verdict::Pass, off);
        let outputs = [
            pass("a", Some(0.2)),
            pass("b", Some(0.4)),
            pass("c", Some(0.3)),
            pass("d", None),
            output("e", Verdict::Missing, None),
            output("f", Verdict::Fail, Some(0.6)),
            output("g", Verdict::Fail, Some(0.7)),
            output("h", Verdict::NonFinite, Some(0.1)),
            output("i", Verdict::Shape, None),
            output("j", Verdict::Unreadable, None),
        ];
        for (n, worst) in [
            (1, "a"),
            (2, "b"),
            (4, "b"),
            (5, "e"),
            (6, "f"),
            (7, "g"),
            (8, "h"),
            (9, "i"),
            (10, "j"),
        ] {
            let case = case(Outcome::Pass, outputs[..n].to_vec());
            assert_eq!(case.worst().map(|o| o.name.as_str()), Some(worst), "of {n}");
        }
        assert!(case(Outcome::Pass, Vec::new()).worst().is_none(), "of none");
    }

    #[test]
    fn which_outcomes_fail() {
        let why = || "it ended".to_owned();
        for (outcome, strict, lenient) in [
            (Outcome::Pass, false, false),
            (Outcome::Unsupported, false, false),
            (Outcome::Missing, true, false),
            (Outcome::Fail, true, true),
            (Outcome::Crash(why()), true, true),
            (Outcome::Timeout(why()), true, true),
        ] {
            let case = case(outcome, Vec::new());
            assert_eq!(
                (case.fails(false), case.fails(true)),
                (strict, lenient),
                "{:?}",
                case.outcome
            );
        }
    }
}
