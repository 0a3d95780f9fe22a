//! [`Recording`]: how a resumed run recognises the recording of its first part.

use anyhow::{Result, bail};
use garad_core::{DepthImage, MaskImage, RgbImage};
use serde::{Deserialize, Serialize};

/// Identity of a recording: the times of the frames that are done, and a checksum of the first and the
/// last of them. Its name may change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    /// Name, for messages.
    pub name: String,
    /// Masks were given (`--oracle-labels`).
    pub given_masks: bool,
    /// Times of the frames that are done, seconds.
    pub times_s: Vec<f64>,
    /// [`fingerprint`] of the first and the last of them; `None` if it cannot be read.
    pub fingerprints: [Option<u32>; 2],
}

/// CRC-32 of a frame's images.
#[must_use]
pub fn fingerprint(rgb: &RgbImage, depth: &DepthImage, mask: Option<&MaskImage>) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(rgb.data().as_flattened());
    for row in 0..depth.height() {
        let bytes: Vec<u8> = depth
            .row(row)
            .iter()
            .flat_map(|z| z.to_le_bytes())
            .collect();
        hasher.update(&bytes);
    }
    if let Some(mask) = mask {
        hasher.update(mask.data());
    }
    hasher.finalize()
}

impl Recording {
    /// Checks that `given` is the same recording. `given` has the times of all its frames.
    ///
    /// # Errors
    /// The first difference.
    pub fn check(&self, given: &Self) -> Result<()> {
        let done = self.times_s.len();
        if self.given_masks != given.given_masks {
            let [saved, now] = [self.given_masks, given.given_masks]
                .map(|masks| if masks { "with" } else { "without" });
            bail!("--oracle-labels: the session was made {saved}, this run is {now}");
        }
        if given.times_s.len() < done {
            bail!(
                "recording `{}`: {} frames are to be run, but {done} are already done; expected the same \
                 --first-frame, and no smaller --max-frames",
                given.name,
                given.times_s.len()
            );
        }
        for (i, (then, now)) in self.times_s.iter().zip(&given.times_s).enumerate() {
            if then.to_bits() != now.to_bits() {
                bail!(
                    "recording `{}`: frame {i} is at {now:.6} s; expected {then:.6} s as in `{}`, \
                     which the session was made from",
                    given.name,
                    self.name
                );
            }
        }
        let ends = [0, done.saturating_sub(1)];
        for ((then, now), i) in self.fingerprints.iter().zip(given.fingerprints).zip(ends) {
            if *then != now {
                bail!(
                    "recording `{}`: frame {i} differs from that of `{}`, which the session was made \
                     from; expected the same images",
                    given.name,
                    self.name
                );
            }
        }
        Ok(())
    }
}
