//! [`Descriptor`]: 256 bits, similar for similar patches.

use serde::{Deserialize, Serialize};

/// A binary descriptor, 256 comparisons of one bit each.
///
/// Bit i of byte b is comparison 8 b + i, in OpenCV's byte order; word w holds bytes 8 w .. 8 w + 7,
/// the first lowest.
///
/// # Example
/// ```
/// use garad_features::Descriptor;
/// let zero = Descriptor::default();
/// let three = Descriptor([0b111, 0, 0, 0]);
/// assert_eq!(zero.distance(&three), 3);
/// assert_eq!(three.to_bytes()[0], 7);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Descriptor(pub [u64; 4]);

impl Descriptor {
    /// Bits in all, the largest possible distance.
    pub const BITS: u32 = 256;

    /// Hamming distance: the number of bits that differ, 0..=256.
    #[inline]
    #[must_use]
    pub fn distance(&self, other: &Self) -> u32 {
        let (a, b) = (&self.0, &other.0);
        (a[0] ^ b[0]).count_ones()
            + (a[1] ^ b[1]).count_ones()
            + (a[2] ^ b[2]).count_ones()
            + (a[3] ^ b[3]).count_ones()
    }

    /// From 32 bytes in OpenCV's order.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; 32]) -> Self {
        let mut words = [0u64; 4];
        for (word, chunk) in words.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_le_bytes(*chunk);
        }
        Self(words)
    }

    /// The 32 bytes in OpenCV's order.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; 32] {
        let mut bytes = [0; 32];
        for (chunk, word) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(self.0) {
            *chunk = word.to_le_bytes();
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::Descriptor;
    use proptest::prelude::*;

    #[test]
    fn byte_order_is_lowest_first() {
        let mut bytes = [0; 32];
        bytes[0] = 1; // comparison 0
        bytes[9] = 0x80; // comparison 79
        let d = Descriptor::from_bytes(&bytes);
        assert_eq!(d.0, [1, 1 << 15, 0, 0], "word and bit");
        assert_eq!(
            Descriptor([u64::MAX; 4]).distance(&Descriptor::default()),
            256,
            "all bits"
        );
    }

    proptest! {
        #[test]
        fn distance_is_a_metric(a: [u64; 4], b: [u64; 4], c: [u64; 4]) {
            let [a, b, c] = [a, b, c].map(Descriptor);
            prop_assert_eq!(a.distance(&a), 0);
            prop_assert_eq!(a.distance(&b), b.distance(&a));
            prop_assert!(a.distance(&c) <= a.distance(&b) + b.distance(&c), "triangle");
            let by_bits: u32 = a.to_bytes().iter().zip(b.to_bytes())
                .map(|(x, y)| (x ^ y).count_ones()).sum();
            prop_assert_eq!(a.distance(&b), by_bits);
            prop_assert_eq!(Descriptor::from_bytes(&a.to_bytes()), a);
        }
    }
}
