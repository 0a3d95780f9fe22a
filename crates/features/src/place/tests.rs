//! Planted places: descriptors with bits flipped, half of them replaced, must be found again.

use super::*;
use garad_core::Rng;

fn random(rng: &mut Rng) -> Descriptor {
    Descriptor([0; 4].map(|_| rng.next_u64()))
}

/// Each bit flipped with this probability.
fn noisy(descriptor: &Descriptor, flip: f64, rng: &mut Rng) -> Descriptor {
    let mut words = descriptor.0;
    for word in &mut words {
        for bit in 0..64 {
            *word ^= u64::from(rng.uniform() < flip) << bit;
        }
    }
    Descriptor(words)
}

/// A place is a list of descriptors; corners of the world come in 200 kinds.
struct World {
    rng: Rng,
    kinds: Vec<Descriptor>,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let kinds = (0..200).map(|_| random(&mut rng)).collect();
        Self { rng, kinds }
    }

    fn place(&mut self, n: usize) -> Vec<Descriptor> {
        (0..n)
            .map(|_| {
                let kind = self.rng.below(self.kinds.len());
                noisy(&self.kinds[kind], 0.15, &mut self.rng)
            })
            .collect()
    }

    /// The place seen again: half of its descriptors with bits flipped, the others are new.
    fn again(&mut self, place: &[Descriptor]) -> Vec<Descriptor> {
        let mut seen = self.place(place.len() / 2);
        let kept = place.iter().step_by(2);
        seen.extend(kept.map(|d| noisy(d, 0.06, &mut self.rng)));
        seen
    }
}

fn id(i: usize) -> KeyframeId {
    KeyframeId(u32::try_from(i).unwrap())
}

fn index(places: &[Vec<Descriptor>]) -> PlaceIndex {
    let mut index = PlaceIndex::new(PlaceConfig::default(), 1).unwrap();
    for (i, place) in places.iter().enumerate() {
        index.add(id(i), place);
    }
    index
}

#[test]
fn words_by_hand() {
    // Two tables of two bits: the words of all bits and of none are the last and first of a table.
    let config = PlaceConfig { tables: 2, bits: 2 };
    let index = PlaceIndex::new(config, 5).unwrap();
    let all = Descriptor([u64::MAX; 4]);
    let counts = index.count(&[Descriptor::default(), all, all]);
    assert_eq!(
        counts,
        [(0, 1), (3, 2), (4, 1), (7, 2)],
        "00 and 11 in both tables"
    );
    // One bit alone appears in one word at most: no bit is read twice.
    for bit in 0..256 {
        let mut one = Descriptor::default();
        one.0[bit / 64] = 1 << (bit % 64);
        let changed = index
            .count(&[one])
            .iter()
            .filter(|(word, _)| word % 4 != 0)
            .count();
        assert!(changed <= 1, "bit {bit}");
    }
}

/// Two keyframes, three words, one table that reads the bits in which they differ.
#[test]
fn scores_by_hand() {
    let config = PlaceConfig {
        tables: 1,
        bits: 16,
    };
    let mut rng = Rng::new(3);
    let [a, b, c] = [0; 3].map(|_| random(&mut rng));
    let mut index = PlaceIndex::new(config, 5).unwrap();
    index.add(id(0), &[a, a, b]);
    index.add(id(1), &[b, c]);
    // ln(1 + 2/1) for a and c, ln(1 + 2/2) for b.
    let (rare, common) = (libm::log(3.0), libm::log(2.0));
    let first = [
        2.0 * rare / (2.0 * rare + common),
        common / (2.0 * rare + common),
    ];
    let second = common / (common + rare);
    let seen = [a, b];
    let query = [rare / (rare + common), common / (rare + common)];
    let expected = [
        query[0].min(first[0]) + query[1].min(first[1]),
        query[1].min(second),
    ];
    let found = index.query(&seen, 5, |_| false);
    assert_eq!((found[0].id, found[1].id), (id(0), id(1)), "order");
    for (candidate, expected) in found.iter().zip(expected) {
        assert!(
            (candidate.score - expected).abs() < 1e-15,
            "{candidate:?} {expected}"
        );
    }
}

#[test]
fn planted_places_are_found_again() {
    let mut world = World::new(4);
    let places: Vec<_> = (0..80).map(|_| world.place(200)).collect();
    let index = index(&places);
    assert_eq!(index.len(), 80, "all of them");
    let mut first = 0;
    for (i, place) in places.iter().enumerate() {
        let found = index.query(&world.again(place), 3, |_| false);
        first += usize::from(found[0].id == id(i));
    }
    assert_eq!(first, 80, "all of them come first");
}

/// Unknown places score lower than all known ones.
#[test]
fn unknown_places_score_low() {
    let mut world = World::new(5);
    let places: Vec<_> = (0..64).map(|_| world.place(200)).collect();
    let index = index(&places);
    let best = |seen: &[Descriptor]| index.query(seen, 1, |_| false)[0].score;
    let mut known: Vec<f64> = places.iter().map(|p| best(&world.again(p))).collect();
    let mut unknown: Vec<f64> = (0..64).map(|_| best(&world.place(200))).collect();
    known.sort_by(f64::total_cmp);
    unknown.sort_by(f64::total_cmp);
    assert!(
        known[0] > unknown[63],
        "the worst and the best: {} {}",
        known[0],
        unknown[63]
    );
}

#[test]
fn answers_are_sorted_limited_and_exclude() {
    let mut world = World::new(6);
    let places: Vec<_> = (0..20).map(|_| world.place(120)).collect();
    let index = index(&places);
    let all = index.query(&places[7], 100, |_| false);
    assert_eq!(all[0].id, id(7), "itself first");
    assert!(
        (all[0].score - 1.0).abs() < 1e-12,
        "and entirely: {}",
        all[0].score
    );
    assert!(
        all.windows(2).all(|w| w[0].score >= w[1].score),
        "descending"
    );
    assert_eq!(
        index.query(&places[7], 3, |_| false),
        all[..3],
        "the best three"
    );
    let without: Vec<_> = index.query(&places[7], 100, |k| k == id(7) || k == all[1].id);
    assert_eq!(without, all[2..], "all but those two");
    for c in &all {
        let score = index.score(c.id, &places[7]).unwrap();
        assert!(
            (score - c.score).abs() < 1e-12,
            "{}: {score} {}",
            c.id,
            c.score
        );
    }
    assert_eq!(index.score(id(20), &places[7]), None, "no such keyframe");
    assert!(
        index.query(&[], 5, |_| false).is_empty(),
        "an image without corners"
    );
    let empty = PlaceIndex::new(PlaceConfig::default(), 1).unwrap();
    assert!(
        empty.is_empty() && empty.query(&places[0], 5, |_| false).is_empty(),
        "no keyframes"
    );
}

#[test]
fn what_is_removed_or_replaced_is_not_found() {
    let mut world = World::new(7);
    let places: Vec<_> = (0..12).map(|_| world.place(120)).collect();
    let mut index = index(&places);
    assert!(index.remove(id(3)), "it was there");
    assert!(!index.remove(id(3)), "it is gone");
    let found = index.query(&places[3], 100, |_| false);
    assert!(found.iter().all(|c| c.id != id(3)), "gone");
    assert_eq!(
        (index.len(), index.score(id(3), &places[3])),
        (11, None),
        "gone"
    );
    index.add(id(4), &places[3]);
    assert_eq!(index.len(), 11, "replaced, not added");
    assert_eq!(
        index.query(&places[3], 1, |_| false)[0].id,
        id(4),
        "now looks like that"
    );
    // A keyframe without corners is never found and does no harm.
    index.add(id(99), &[]);
    assert!(
        index
            .query(&places[3], 100, |_| false)
            .iter()
            .all(|c| c.id != id(99)),
        "empty"
    );
}

#[test]
fn repetition_changes_nothing_and_a_seed_does() {
    let mut world = World::new(8);
    let places: Vec<_> = (0..40).map(|_| world.place(60)).collect();
    let seen = world.again(&places[31]);
    let run = |seed| {
        let mut index = PlaceIndex::new(PlaceConfig::default(), seed).unwrap();
        for (i, place) in places.iter().enumerate() {
            index.add(id(i), place);
        }
        index.remove(id(9));
        index.query(&seen, 10, |_| false)
    };
    let expected = run(1);
    assert_eq!(expected[0].id, id(31), "found");
    assert_eq!(run(1), expected, "again");
    assert_ne!(run(2), expected, "other bits, other scores");
    assert_eq!(run(2)[0].id, id(31), "but the same place");
}

#[test]
fn invalid_settings_are_named() {
    let error_of = |tables, bits| {
        let config = PlaceConfig { tables, bits };
        PlaceIndex::new(config, 0).unwrap_err().to_string()
    };
    assert!(error_of(0, 14).contains("tables is 0"), "no table");
    assert!(error_of(19, 14).contains("tables is 19"), "266 bits");
    assert!(
        PlaceIndex::new(
            PlaceConfig {
                tables: 18,
                bits: 14
            },
            0
        )
        .is_ok(),
        "252 bits"
    );
    assert!(error_of(4, 0).contains("bits is 0"), "no bits");
    assert!(error_of(4, 17).contains("bits is 17"), "too many lists");
}

/// A run that goes on for ever, with twenty keyframes at any time: the index does not grow, and answers
/// as one that never held the others.
#[test]
fn an_index_that_forgets_stays_small() {
    let mut world = World::new(7);
    let places: Vec<_> = (0..400).map(|_| world.place(60)).collect();
    let mut index = PlaceIndex::new(PlaceConfig::default(), 1).unwrap();
    for (i, place) in places.iter().enumerate() {
        index.add(id(i), place);
        if i >= 20 {
            assert!(index.remove(id(i - 20)), "still there");
        }
    }
    assert_eq!(index.len(), 20, "the last ones");
    assert!(index.scale.len() <= 2 * 21, "slots: {}", index.scale.len());
    let postings: usize = index.postings.iter().map(Vec::len).sum();
    assert!(postings <= 2 * 21 * 4 * 60, "postings: {postings}");
    assert!(
        index
            .postings
            .iter()
            .all(|l| l.is_sorted_by_key(|p| p.slot)),
        "lists stay sorted"
    );
    let mut fresh = PlaceIndex::new(PlaceConfig::default(), 1).unwrap();
    for (i, place) in places.iter().enumerate().skip(380) {
        fresh.add(id(i), place);
    }
    // Counted at the same moment, rarities and so scores are equal to the bit.
    index.renew();
    fresh.renew();
    let seen = world.again(&places[390]);
    let found = index.query(&seen, 20, |_| false);
    assert_eq!(found[0].id, id(390), "the place");
    assert_eq!(found, fresh.query(&seen, 20, |_| false), "and all the rest");
}
