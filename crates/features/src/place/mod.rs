//! [`PlaceIndex`]: place recognition, the keyframes most similar to an image.
//!
//! A descriptor is turned into a few words by reading some of its bits: each table has its own
//! choice of bits, and their values are the word. An image becomes a list of words with weights,
//! and images of one place share many rare words. Each word keeps a list of the keyframes that
//! have it, so that a query looks only at those.
//!
//! Two descriptors of one corner that differ in k of 256 bits share the word of a table of b bits with
//! probability (1 - k/256)ᵇ: about 1/3 for k = 20 and b = 14, but 1/1000 for the k = 100 of two
//! different corners. So most words of a corner are lost from one view to the next, and those
//! that remain are significant.
//!
//! The weight of word i in an image is its number there times its rarity, made to sum to 1 over the
//! image:
//!
//! v_i ∝ n_i ln(1 + N / N_i)                                                              (E19)
//!
//! with n_i descriptors of the image and N_i of N keyframes that have the word. The score of two
//! images is 1 - ½ Σ |v_i - w_i| = Σ min(v_i, w_i): 0 if they share nothing, 1 if they are alike.
//!
//! Source: Indyk, Motwani 1998 (words from sampled bits); Sivic, Zisserman 2003 (weights, lists);
//! Nistér, Stewénius 2006 (score). A vocabulary tree (Gálvez-López, Tardós 2012), grown from the
//! run's own keyframes, was tried in place of sampled bits on 390 images of two rooms, one with
//! people walking about: keyframes every 30 images, 195 images asked for, 176 of them also
//! without the keyframes around them but with another view of the same place.
//!
//! | words | nearest keyframe first | another view first | learning |
//! |---|---|---|---|
//! | tree 10³ | 174 | 167 | up to 0.1 s at a keyframe |
//! | tree 10⁴ | 171 | 142 | more |
//! | 4 tables of 10 bits | 185 | 166 | none |
//! | 4 tables of 14 bits | 179 | 172 | none |
//! | 8 tables of 16 bits | 187 | 176 | none |
//! | every descriptor with every other | 185 | 173 | none |
//!
//! The right room came first 195 times in all rows but the second (194). Another choice of bits moves
//! a count by five or so.

use std::collections::BTreeMap;

use garad_core::{KeyframeId, Rng};
use serde::{Deserialize, Serialize};

use crate::descriptor::Descriptor;
use crate::error::{FeatureError, setting};

/// Settings of a [`PlaceIndex`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlaceConfig {
    /// Words of a descriptor. More reduce the noise of scores; time and memory grow in proportion.
    pub tables: usize,
    /// Bits of a word. More make words more distinctive, but fewer remain after a change of view.
    pub bits: usize,
}

impl Default for PlaceConfig {
    fn default() -> Self {
        Self {
            tables: 4,
            bits: 14,
        }
    }
}

/// Most bits of a word: a list is kept for each of the `tables` · 2^`bits` words there could be.
const MAX_BITS: usize = 16;

/// A keyframe that may show the place asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Which.
    pub id: KeyframeId,
    /// Σ min(v_i, w_i), in (0, 1].
    pub score: f64,
}

/// A keyframe that has a word: its slot, and how often.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct Posting {
    slot: u32,
    count: u32,
}

/// An index of keyframes by the words of their descriptors.
///
/// # Example
/// ```
/// use garad_core::{KeyframeId, Rng};
/// use garad_features::{Descriptor, PlaceConfig, PlaceIndex};
/// let mut rng = Rng::new(7);
/// let mut image = || -> Vec<_> {
///     (0..200).map(|_| Descriptor([0; 4].map(|_| rng.next_u64()))).collect()
/// };
/// let (kitchen, desk) = (image(), image());
/// let mut places = PlaceIndex::new(PlaceConfig::default(), 0).unwrap();
/// places.add(KeyframeId(0), &kitchen);
/// places.add(KeyframeId(1), &desk);
/// let found = places.query(&desk[..150], 2, |_| false);
/// assert_eq!(found[0].id, KeyframeId(1));
/// let without = places.query(&desk, 2, |id| id == KeyframeId(1));
/// assert!(without.iter().all(|c| c.id == KeyframeId(0)));
/// ```
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PlaceIndex {
    /// Per table, the bits that are read.
    tables: Vec<Vec<usize>>,
    bits: usize,
    /// The slot of each keyframe, handed out in order; those of removed ones come free at the next renewal.
    slot_of: BTreeMap<KeyframeId, u32>,
    /// Per slot, 1 / Σ n_i ln(1 + N / N_i); 0 once its keyframe is gone.
    scale: Vec<f64>,
    /// ln(1 + N / N_i) per word, as of the last renewal.
    rarity: Vec<f64>,
    /// Per word, by slot; slots of removed keyframes stay until the next renewal.
    postings: Vec<Vec<Posting>>,
    /// Slots there were at the last renewal.
    renewed: usize,
}

impl PlaceIndex {
    /// An index without keyframes; the seed chooses the bits.
    ///
    /// # Errors
    /// [`FeatureError::BadSetting`]: no table, no bits or more than 16, or more than 256 bits in all.
    pub fn new(config: PlaceConfig, seed: u64) -> Result<Self, FeatureError> {
        let PlaceConfig { tables, bits } = config;
        let valid = (1..=MAX_BITS).contains(&bits);
        setting("bits", bits as f64, "1 to 16", valid)?;
        let all = Descriptor::BITS as usize;
        let expected = "at least 1, with tables x bits up to 256";
        let valid = (1..=all / bits).contains(&tables);
        setting("tables", tables as f64, expected, valid)?;
        // The bits of a descriptor in random order (Fisher-Yates), dealt to the tables.
        let mut order: Vec<usize> = (0..all).collect();
        let mut rng = Rng::new(seed);
        for i in (1..all).rev() {
            order.swap(i, rng.below(i + 1));
        }
        let words = tables << bits;
        Ok(Self {
            tables: order.chunks(bits).take(tables).map(<[_]>::to_vec).collect(),
            bits,
            slot_of: BTreeMap::new(),
            scale: Vec::new(),
            rarity: vec![libm::log1p(1.0); words],
            postings: vec![Vec::new(); words],
            renewed: 0,
        })
    }

    /// Number of keyframes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.slot_of.len()
    }

    /// No keyframes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.slot_of.is_empty()
    }

    /// Adds a keyframe; one of the same id is replaced.
    ///
    /// Rarities are counted anew at the 1st, 2nd, 4th, 8th, ... keyframe, so that scores of one query
    /// always rest on the same ones. Where keyframes are removed, too, it is done whenever there have been as
    /// many new ones as were left the last time: the index stays in proportion to what is in it.
    pub fn add(&mut self, id: KeyframeId, descriptors: &[Descriptor]) {
        self.remove(id);
        #[allow(
            clippy::cast_possible_truncation,
            reason = "a run has fewer than 2^32 keyframes: their ids are u32"
        )]
        let slot = self.scale.len() as u32;
        let counts = self.count(descriptors);
        for &(word, count) in &counts {
            self.postings[word].push(Posting { slot, count });
        }
        self.slot_of.insert(id, slot);
        self.scale.push(self.scale_of(&counts));
        if self.scale.len() >= 2 * self.renewed {
            self.renew();
        }
    }

    /// Removes a keyframe; `false` if there is none of this id.
    pub fn remove(&mut self, id: KeyframeId) -> bool {
        match self.slot_of.remove(&id) {
            Some(slot) => {
                self.scale[slot as usize] = 0.0;
                true
            }
            None => false,
        }
    }

    /// The keyframes most like an image, best first, the older first among equals: at most `max`,
    /// none of those that `exclude` names, none that share no word.
    ///
    /// A score depends on the number of words and on how alike all images are; compare it with other
    /// scores ([`PlaceIndex::score`] of keyframes known to be near) and not with a constant.
    ///
    /// # Numerics
    /// Sums in the order of words, one thread: the same bits everywhere. 2 to 3 ms for 1,000
    /// descriptors against 1,000 keyframes of as many (`cargo bench --bench loop_closing`).
    #[must_use]
    pub fn query(
        &self,
        descriptors: &[Descriptor],
        max: usize,
        exclude: impl Fn(KeyframeId) -> bool,
    ) -> Vec<Candidate> {
        let mut scores = vec![0.0; self.scale.len()];
        let counts = self.count(descriptors);
        let scale = self.scale_of(&counts);
        for (word, count) in counts {
            let rarity = self.rarity[word];
            let weight = f64::from(count) * rarity * scale;
            for posting in &self.postings[word] {
                let slot = posting.slot as usize;
                scores[slot] += weight.min(f64::from(posting.count) * rarity * self.scale[slot]);
            }
        }
        let mut found: Vec<Candidate> = (self.slot_of.iter())
            .map(|(&id, &slot)| Candidate {
                id,
                score: scores[slot as usize],
            })
            .filter(|c| c.score > 0.0 && !exclude(c.id))
            .collect();
        found.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id)));
        found.truncate(max);
        found
    }

    /// The score of one keyframe against an image, as a query gives it; `None` if there is none of
    /// this id.
    #[must_use]
    pub fn score(&self, id: KeyframeId, descriptors: &[Descriptor]) -> Option<f64> {
        let slot = *self.slot_of.get(&id)?;
        let counts = self.count(descriptors);
        let scale = self.scale_of(&counts);
        let mut score = 0.0;
        for (word, count) in counts {
            let list = &self.postings[word];
            if let Ok(at) = list.binary_search_by_key(&slot, |p| p.slot) {
                let rarity = self.rarity[word];
                let theirs = f64::from(list[at].count) * rarity * self.scale[slot as usize];
                score += theirs.min(f64::from(count) * rarity * scale);
            }
        }
        Some(score)
    }

    /// The words of an image and how often each occurs, ascending.
    fn count(&self, descriptors: &[Descriptor]) -> Vec<(usize, u32)> {
        let mut words = Vec::with_capacity(descriptors.len() * self.tables.len());
        for (table, bits) in self.tables.iter().enumerate() {
            for descriptor in descriptors {
                let spelled = bits.iter().fold(0, |word, &bit| {
                    (word << 1) | usize::from((descriptor.0[bit / 64] >> (bit % 64)) & 1 == 1)
                });
                words.push((table << self.bits) + spelled);
            }
        }
        words.sort_unstable();
        let runs = words.chunk_by(|a, b| a == b);
        #[allow(
            clippy::cast_possible_truncation,
            reason = "an image has fewer than 2^32 descriptors"
        )]
        runs.map(|run| (run[0], run.len() as u32)).collect()
    }

    /// The factor that makes the weights of an image sum to 1 (E19); 0 for one without words.
    fn scale_of(&self, counts: &[(usize, u32)]) -> f64 {
        let weights = counts
            .iter()
            .map(|&(word, n)| f64::from(n) * self.rarity[word]);
        let sum = weights.fold(0.0, |sum, w| sum + w);
        if sum > 0.0 { 1.0 / sum } else { 0.0 }
    }

    /// Drops removed keyframes, closes the gaps among the slots, and counts rarities anew.
    fn renew(&mut self) {
        let mut live: Vec<(&mut u32, usize)> = (self.slot_of.values_mut())
            .map(|slot| {
                let old = *slot as usize;
                (slot, old)
            })
            .collect();
        live.sort_unstable_by_key(|(_, old)| *old);
        let mut slots = vec![None; self.scale.len()];
        for ((slot, old), new) in live.into_iter().zip(0u32..) {
            *slot = new;
            slots[old] = Some(new);
        }
        let n = self.slot_of.len();
        let mut sums = vec![0.0; n];
        for (list, rarity) in self.postings.iter_mut().zip(&mut self.rarity) {
            list.retain_mut(|posting| match slots[posting.slot as usize] {
                Some(slot) => {
                    posting.slot = slot; // slots keep their order, and lists stay sorted
                    true
                }
                None => false,
            });
            // A word of no keyframe counts as one of a single keyframe.
            *rarity = libm::log1p(n as f64 / list.len().max(1) as f64);
            for posting in list {
                sums[posting.slot as usize] += f64::from(posting.count) * *rarity;
            }
        }
        let scales = sums.into_iter();
        self.scale = (scales.map(|sum| if sum > 0.0 { 1.0 / sum } else { 0.0 })).collect();
        self.renewed = n;
    }
}

#[cfg(test)]
mod tests;
