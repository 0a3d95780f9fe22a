//! Seeded damage to the bytes of a file, for tests.

use garad_core::Rng;

/// One to four small changes: flipped bits, special bytes, cuts, repetitions, swaps.
pub(crate) fn damage(bytes: &mut Vec<u8>, rng: &mut Rng) {
    const SPECIAL: &[u8] = b"\0\x01\x7F\x80\xFF\n\r\t #-+.eE09/\\:n";
    for _ in 0..=rng.below(4) {
        if bytes.is_empty() {
            return;
        }
        let at = rng.below(bytes.len());
        let length = 1 + rng.below((bytes.len() - at).min(16));
        match rng.below(6) {
            0 => bytes[at] ^= 1 << rng.below(8),
            1 => bytes[at] = SPECIAL[rng.below(SPECIAL.len())],
            2 => bytes.truncate(at),
            3 => {
                let piece = bytes[at..at + length].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => {
                bytes.drain(at..at + length);
            }
            _ => {
                let to = rng.below(bytes.len());
                bytes.swap(at, to);
            }
        }
    }
}
