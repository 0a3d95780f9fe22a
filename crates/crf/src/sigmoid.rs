//! [`sigmoid`]: from log-odds to probability.

/// 1 / (1 + e⁻ˣ), to its last digits at both ends.
pub(crate) fn sigmoid(x: f64) -> f64 {
    if x >= 0.0 {
        1.0 / (1.0 + libm::exp(-x))
    } else {
        let e = libm::exp(x);
        e / (1.0 + e)
    }
}

#[cfg(test)]
mod tests {
    use super::sigmoid;

    #[test]
    fn sigmoid_keeps_its_digits() {
        assert!((sigmoid(0.0) - 0.5).abs() < 1e-16, "middle");
        assert!(
            (sigmoid(-40.0) / 4.248_354_255_291_589e-18 - 1.0).abs() < 1e-14,
            "far below"
        );
        assert!(
            (sigmoid(2.0) + sigmoid(-2.0) - 1.0).abs() < 1e-15,
            "symmetric"
        );
        let ends = [-800.0, 800.0].map(|x| sigmoid(x).to_bits());
        assert_eq!(ends, [0.0f64, 1.0].map(f64::to_bits), "ends");
    }
}
