//! [`Rng`]: a counter-based random generator; its state is its argument, never a global.

use serde::{Deserialize, Serialize};

/// SplitMix64 (Steele, Lea, Flood 2014): one addition and a mixing of 64 bits per number.
///
/// Streams are keyed: `Rng::keyed(seed, &[stage, frame, item])` gives each place its own
/// stream, so that drawing one number more here changes nothing there.
///
/// # Example
/// ```
/// use garad_core::Rng;
/// assert_eq!(Rng::new(0).next_u64(), 0xE220_A839_7B1D_CDAF); // published test value
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rng {
    state: u64,
}

const GOLDEN_GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Rng {
    /// A stream from a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The stream of one place, e.g. `[stage, frame, item]`.
    #[must_use]
    pub fn keyed(seed: u64, key: &[u64]) -> Self {
        let state = key
            .iter()
            .fold(mix(seed.wrapping_add(GOLDEN_GAMMA)), |state, &part| {
                mix(state ^ part.wrapping_add(GOLDEN_GAMMA)).wrapping_add(GOLDEN_GAMMA)
            });
        Self { state }
    }

    /// 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN_GAMMA);
        mix(self.state)
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform integer in 0..n (n > 0), by the high half of a 128-bit product.
    #[allow(
        clippy::cast_possible_truncation,
        reason = "the high half of u64 x n is below n, which is a usize"
    )]
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next_u64()) * n as u128) >> 64) as usize
    }

    /// Standard normal (Box-Muller, first of the pair).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::Rng;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut rng = Rng::keyed(7, &[1, 2, 3]);
        let n = 40_000;
        let (mut mean, mut var, mut uniform) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = rng.normal();
            mean += x / f64::from(n);
            var += x * x / f64::from(n);
            uniform += rng.uniform() / f64::from(n);
        }
        assert!(mean.abs() < 0.02, "mean {mean}");
        assert!((var - 1.0).abs() < 0.03, "variance {var}");
        assert!((uniform - 0.5).abs() < 0.01, "uniform {uniform}");
    }

    #[test]
    fn keys_separate_streams_and_below_stays_below() {
        let first = |key: &[u64]| Rng::keyed(1, key).next_u64();
        assert_ne!(first(&[0, 1]), first(&[1, 0]), "order of the key matters");
        let mut rng = Rng::new(3);
        let mut seen = [false; 5];
        for _ in 0..200 {
            seen[rng.below(5)] = true;
        }
        assert_eq!(seen, [true; 5], "every value of 0..5 comes up");
    }
}
