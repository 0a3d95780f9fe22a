//! [`diff`]: where two traces part.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use super::{Entry, INDEX, Index, load_tensor, read_npy, tolerance};
use crate::compare::{Comparison, compare};
use crate::error::GoldenError;
use crate::tensor::Tensor;
use crate::tol;

/// By what the numbers are judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Judge {
    /// The same numbers.
    #[default]
    Exact,
    /// Each tensor by its [`tolerance`].
    Tolerances,
}

/// How a tensor differs.
#[derive(Debug, Clone, PartialEq)]
pub enum Why {
    /// Only the first trace has it.
    Missing,
    /// Only the second trace has it.
    Extra,
    /// Another shape: the second's.
    Shape(Vec<usize>),
    /// The file of the second cannot be read.
    Unreadable(String),
    /// Other numbers.
    Numbers(Comparison),
}

/// A tensor that differs.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Which.
    pub entry: Entry,
    /// How.
    pub why: Why,
}

/// What [`diff`] found.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TraceDiff {
    /// Tensors of which both have numbers.
    pub compared: usize,
    /// Tensors that a folder without an index does not have. They are no difference.
    pub absent: usize,
    /// What differs, in the order of the data.
    pub differences: Vec<Difference>,
}

/// Compares two traces; `second` may also be a folder without an index, of which only the files
/// that are there are looked at.
///
/// A type of its own (f32 for f64) is no difference, if the numbers agree.
///
/// # Errors
/// [`GoldenError`] if the first trace cannot be read, or the index of the second.
pub fn diff(first: &Path, second: &Path, judge: Judge) -> Result<TraceDiff, GoldenError> {
    let index = Index::load(first)?;
    let other = match second.join(INDEX).is_file() {
        true => Some(Index::load(second)?),
        false => None,
    };
    let others: Option<BTreeMap<&str, &Entry>> = other
        .as_ref()
        .map(|o| o.tensors.iter().map(|e| (e.file.as_str(), e)).collect());
    let mut found = TraceDiff::default();
    for entry in &index.tensors {
        let there = match &others {
            Some(others) => others.contains_key(entry.file.as_str()),
            None => second.join(&entry.file).is_file(),
        };
        let why = if there {
            found.compared += 1;
            let tensor = load_tensor(first, entry)?;
            difference(entry, &tensor, read_npy(&second.join(&entry.file)), judge)
        } else if others.is_some() {
            Some(Why::Missing)
        } else {
            found.absent += 1;
            None
        };
        if let Some(why) = why {
            let entry = entry.clone();
            found.differences.push(Difference { entry, why });
        }
    }
    let known: BTreeMap<&str, ()> = index
        .tensors
        .iter()
        .map(|e| (e.file.as_str(), ()))
        .collect();
    for entry in other.iter().flat_map(|o| &o.tensors) {
        if !known.contains_key(entry.file.as_str()) {
            found.differences.push(Difference {
                entry: entry.clone(),
                why: Why::Extra,
            });
        }
    }
    Ok(found)
}

fn difference(
    entry: &Entry,
    tensor: &Tensor,
    other: Result<Tensor, GoldenError>,
    judge: Judge,
) -> Option<Why> {
    let other = match other {
        Ok(other) => other,
        Err(error) => return Some(Why::Unreadable(error.to_string())),
    };
    if tensor.shape() != other.shape() {
        return Some(Why::Shape(other.shape().to_vec()));
    }
    let tolerance = match judge {
        Judge::Exact => &tol::TABLE[0],
        Judge::Tolerances => tolerance(&entry.stage, &entry.tensor),
    };
    match compare(tensor, &other.f64(), tolerance) {
        Ok(comparison) if comparison.passed => None,
        Ok(comparison) => Some(Why::Numbers(first_outside(
            tensor, &other, comparison, judge,
        ))),
        Err(error) => Some(Why::Unreadable(error.to_string())),
    }
}

/// Without a tolerance every error is as bad as any other: the first element that differs is shown, and
/// not one of many that are infinitely far away.
#[allow(clippy::float_cmp, reason = "this is the exact comparison")]
fn first_outside(a: &Tensor, b: &Tensor, mut found: Comparison, judge: Judge) -> Comparison {
    if judge == Judge::Exact {
        let (a_values, b_values) = (a.f64(), b.f64());
        let differs = |i: &usize| {
            let (x, y) = (a_values[*i], b_values[*i]);
            x != y && !(x.is_nan() && y.is_nan())
        };
        if let Some(i) = (0..a_values.len()).find(differs) {
            found.worst_index = a.unravel(i);
            (found.expected, found.got) = (a_values[i], b_values[i]);
        }
    }
    found
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => f.write_str("only in the first trace"),
            Self::Extra => f.write_str("only in the second trace"),
            Self::Shape(shape) => write!(f, "has the shape {shape:?} in the second trace"),
            Self::Unreadable(why) => write!(f, "cannot be read: {why}"),
            Self::Numbers(c) => write!(
                f,
                "at {:?}: {:?} and {:?}, difference {:e}; {} of {} differ",
                c.worst_index,
                c.expected,
                c.got,
                c.got - c.expected,
                c.outside,
                c.elements
            ),
        }
    }
}

/// The first difference, then every run of a stage that differs as well.
impl fmt::Display for TraceDiff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(first) = self.differences.first() else {
            write!(f, "no difference in {} tensors", self.compared)?;
            return match self.absent {
                0 => Ok(()),
                n => write!(f, "; {n} are not in the second folder"),
            };
        };
        writeln!(f, "first difference: {}", first.entry)?;
        writeln!(f, "    {}, {} of the stage", first.why, side(&first.entry))?;
        let mut rest = self.differences.iter().peekable();
        let mut more = Vec::new();
        while let Some(start) = rest.next() {
            let mut names = vec![start.entry.tensor.as_str()];
            while let Some(next) = rest.next_if(|d| d.entry.same_run(&start.entry)) {
                names.push(&next.entry.tensor);
            }
            more.push((&start.entry, names));
        }
        if self.differences.len() > 1 {
            writeln!(f, "also different, in the order of the data:")?;
        }
        for (entry, names) in &more {
            let names: Vec<&str> = match entry.same_run(&first.entry) {
                true => names.iter().skip(1).copied().collect(),
                false => names.clone(),
            };
            if !names.is_empty() {
                let run = match entry.call {
                    0 => String::new(),
                    n => format!(", run {n}"),
                };
                let (frame, stage) = (entry.frame, &entry.stage);
                writeln!(f, "    frame {frame}, {stage}{run}: {}", names.join(", "))?;
            }
        }
        write!(
            f,
            "{} of {} tensors differ",
            self.differences.len(),
            self.compared
        )
    }
}

fn side(entry: &Entry) -> &'static str {
    match entry.role {
        super::Role::Input => "an input",
        super::Role::Output => "an output",
    }
}
