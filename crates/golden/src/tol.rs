//! The one place with tolerances. `case.json` names an entry; the number lives here, with its
//! reason.
//!
//! To add one, add a line to its stage's block. A tolerance says how far a *correct* implementation may
//! be from the expected value; it is derived from conditioning or measured and then rounded up
//! by less than 4, never widened to make a case pass.

/// How two values are compared. Two NaNs are equal, and so are two infinities of one sign;
/// against anything else they are infinitely far away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Class {
    /// The same number: ids, orders, labels, integers, bits (0.0 and -0.0 are the same).
    Exact,
    /// At most this many representable numbers apart, in the type of the expected tensor.
    Ulp(u64),
    /// |got - expected| ≤ abs + rel |expected|, per element.
    AbsRel {
        /// In the tensor's unit.
        abs: f64,
        /// Relative to the element.
        rel: f64,
    },
    /// |got - expected| ≤ abs + rel max |expected|: elements that cancel are judged by the
    /// largest of the tensor.
    Vector {
        /// In the tensor's unit.
        abs: f64,
        /// Relative to the largest element.
        rel: f64,
    },
    /// For values behind a threshold: all within `hard`, and at most `share` of them beyond
    /// `tight`.
    Banded {
        /// Away from the threshold.
        tight: f64,
        /// Share of elements in the band, in [0, 1].
        share: f64,
        /// Anywhere.
        hard: f64,
    },
}

/// An entry of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// `STAGE.QUANTITY`, as `case.json` says it.
    pub name: &'static str,
    /// Comparison and its numbers.
    pub class: Class,
    /// Why these numbers.
    pub reason: &'static str,
}

const fn abs_rel(name: &'static str, abs: f64, rel: f64, reason: &'static str) -> Tolerance {
    Tolerance {
        name,
        class: Class::AbsRel { abs, rel },
        reason,
    }
}

const fn vector(name: &'static str, abs: f64, rel: f64, reason: &'static str) -> Tolerance {
    Tolerance {
        name,
        class: Class::Vector { abs, rel },
        reason,
    }
}

/// Every tolerance.
#[rustfmt::skip]
pub const TABLE: &[Tolerance] = &[
    // any stage
    Tolerance { name: "exact", class: Class::Exact, reason: "ids, orders, labels, bits" },
    Tolerance { name: "ulp1", class: Class::Ulp(1), reason: "one rounding, by another route" },
    // se3
    abs_rel("se3.rotation", 1e-15, 0.0, "entries of R, J, q in [-1, 1]: a few roundings of 1.1e-16"),
    vector("se3.translation", 2e-15, 2e-15, "J rho: three products and the error of J"),
    abs_rel("se3.jacobian_inverse", 4e-15, 0.0, "theta < 3: entries up to 3, cot(theta/2) form"),
    vector("se3.jacobian_inverse_near_pi", 0.0, 1e-14, "theta to pi: relative to the largest entry"),
    vector("se3.q", 0.0, 4e-15, "sum of four terms of size |rho|"),
    abs_rel("se3.log", 1e-15, 1e-15, "components of a rotation vector, theta < 3"),
    abs_rel("se3.log_near_pi", 2e-15, 0.0, "theta to pi - 1e-7: |phi| = pi has a spacing of 4.4e-16"),
    // camera
    abs_rel("camera.jacobian", 1e-10, 1e-13, "a few products and one division"),
    abs_rel("camera.pixel", 1e-12, 1e-13, "polynomial of degree 7 and one division; px"),
    abs_rel("camera.undistorted", 1e-9, 0.0, "Newton stops at 1e-12 in normalised coordinates, f = 500 px"),
];

/// The entry of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Tolerance> {
    TABLE.iter().find(|t| t.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_has_its_own_name_and_a_reason() {
        for (i, entry) in TABLE.iter().enumerate() {
            assert!(
                TABLE[..i].iter().all(|other| other.name != entry.name),
                "{} stands twice",
                entry.name
            );
            assert!(entry.reason.len() > 5, "{}: why?", entry.name);
        }
    }
}
