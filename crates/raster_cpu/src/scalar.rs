//! Numbers, short vectors, and casts between pixels and coordinates.

use garad_core::Real;

/// (f(0), f(1)); the compiler leaves an array's own `map` as a call.
#[inline(always)]
pub(crate) fn two<A>(f: impl Fn(usize) -> A) -> [A; 2] {
    [f(0), f(1)]
}

/// (f(0), f(1), f(2)), as [`two`].
#[inline(always)]
pub(crate) fn three<A>(f: impl Fn(usize) -> A) -> [A; 3] {
    [f(0), f(1), f(2)]
}

/// a · b, terms in their order.
#[inline(always)]
pub(crate) fn dot<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a × b.
#[inline]
pub(crate) fn cross<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Column `k` of a matrix given row by row.
#[inline(always)]
pub(crate) fn column<T: Real>(rows: &[[T; 3]; 3], k: usize) -> [T; 3] {
    [rows[0][k], rows[1][k], rows[2][k]]
}

/// 1 / (1 + e⁻ˣ).
#[inline]
pub(crate) fn sigmoid<T: Real>(x: T) -> T {
    T::ONE / (T::ONE + (-x).exp())
}

/// An index as a coordinate; exact below [`crate::MAX_SIDE_PX`].
#[inline]
pub(crate) fn coordinate<T: Real>(index: usize) -> T {
    T::from_f64(index as f64)
}

/// A coordinate as an index: below 0 and NaN become 0, beyond the range its end.
#[inline]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "`as` saturates, which is what a cut to the image needs"
)]
pub(crate) fn to_index<T: Real>(x: T) -> usize {
    x.to_f64() as usize
}

/// A radius as an integer; beyond the range its end.
#[inline]
#[allow(clippy::cast_possible_truncation, reason = "`as` saturates")]
pub(crate) fn saturate<T: Real>(radius: T) -> i32 {
    radius.to_f64() as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sigmoid_reaches_both_ends() {
        assert!((sigmoid(0.0f64) - 0.5).abs() < 1e-16, "middle");
        assert!((sigmoid(-700.0f64)).abs() < 1e-300, "transparent");
        assert!((sigmoid(f32::NEG_INFINITY)).abs() < 1e-38, "absent");
        assert!((sigmoid(1000.0f32) - 1.0).abs() < 1e-7, "opaque");
    }

    #[test]
    fn casts_saturate() {
        assert_eq!(to_index(-1.5f64), 0, "below");
        assert_eq!(to_index(f32::NAN), 0, "NaN");
        assert_eq!(to_index(7.9f32), 7, "down");
        assert_eq!(saturate(1e30f64), i32::MAX, "radius");
    }
}
