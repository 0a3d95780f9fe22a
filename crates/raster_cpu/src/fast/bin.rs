//! Order in depth, and the splats of each row of tiles.

use super::splat::Splat;

/// Digits of the keys that one pass sorts by.
const BITS: u32 = 11;

/// The numbers of pairs (key, number), given in ascending order of numbers, in ascending order of
/// (key, number): R8, since the bits of positive
/// floats are ordered as the floats are.
///
/// Radix sort from the last digit to the first; each pass keeps the order of equals.
pub(crate) fn sorted(mut from: Vec<(u32, u32)>) -> Vec<u32> {
    let mut to = vec![(0, 0); from.len()];
    for shift in (0..32).step_by(BITS as usize) {
        let digit = |key: u32| (key >> shift) as usize & ((1 << BITS) - 1);
        let mut starts = [0u32; 1 << BITS];
        for &(key, _) in &from {
            starts[digit(key)] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            (*start, sum) = (sum, sum + *start);
        }
        for &(key, number) in &from {
            let start = &mut starts[digit(key)];
            to[*start as usize] = (key, number);
            *start += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
    from.into_iter().map(|(_, number)| number).collect()
}

/// A splat in a row of tiles.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Entry {
    /// Position in the sorted splats.
    pub(crate) position: u32,
    /// Its columns of tiles, [x0, x1).
    columns: [u16; 2],
}

/// For each row of tiles the splats whose footprint reaches into it, front to back.
#[derive(Debug)]
pub(crate) struct Bands {
    /// Band b owns `entries[starts[b]..starts[b + 1]]`.
    starts: Vec<usize>,
    entries: Vec<Entry>,
}

impl Bands {
    /// Counts, then fills in order of depth.
    pub(crate) fn new(splats: &[Splat], rows: usize) -> Self {
        let mut starts = vec![0usize; rows + 1];
        for splat in splats {
            for row in splat.cells[2]..splat.cells[3] {
                starts[usize::from(row) + 1] += 1;
            }
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut entries = vec![Entry::default(); starts[rows]];
        let mut next = starts.clone();
        for (splat, position) in splats.iter().zip(0u32..) {
            let [x0, x1, y0, y1] = splat.cells;
            for next in &mut next[usize::from(y0)..usize::from(y1)] {
                entries[*next] = Entry {
                    position,
                    columns: [x0, x1],
                };
                *next += 1;
            }
        }
        Self { starts, entries }
    }

    /// Entries of all bands.
    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }

    /// `values`, one per entry, as a slice for each band.
    pub(crate) fn cut<'a, A>(&self, mut values: &'a mut [A]) -> Vec<&'a mut [A]> {
        let lengths = self.starts.windows(2).map(|w| w[1] - w[0]);
        let mut band = |n| values.split_off_mut(..n).expect("one value per entry");
        lengths.map(&mut band).collect()
    }

    /// Number of bands.
    pub(crate) fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// Where a band's entries begin among all.
    pub(crate) fn start(&self, band: usize) -> usize {
        self.starts[band]
    }

    /// The splats of a band; positions ascend.
    pub(crate) fn list(&self, band: usize) -> &[Entry] {
        &self.entries[self.starts[band]..self.starts[band + 1]]
    }
}

/// The lists of the tiles of one band, and the band's splats side by side, so that its tiles
/// find them in the cache.
#[derive(Debug)]
pub(crate) struct Columns {
    pub(crate) splats: Vec<Splat>,
    starts: Vec<usize>,
    places: Vec<u32>,
}

impl Columns {
    /// `band` as in [`Bands::list`].
    pub(crate) fn new(splats: &[Splat], band: &[Entry], columns: usize) -> Self {
        let mut starts = vec![0usize; columns + 1];
        for entry in band {
            for column in entry.columns[0]..entry.columns[1] {
                starts[usize::from(column) + 1] += 1;
            }
        }
        for column in 0..columns {
            starts[column + 1] += starts[column];
        }
        let mut places = vec![0u32; starts[columns]];
        let mut next = starts.clone();
        for (entry, place) in band.iter().zip(0u32..) {
            let [x0, x1] = entry.columns.map(usize::from);
            for next in &mut next[x0..x1] {
                places[*next] = place;
                *next += 1;
            }
        }
        let splats = band.iter().map(|e| splats[e.position as usize]).collect();
        Self {
            splats,
            starts,
            places,
        }
    }

    /// The tile's splats, front to back, as places in the band.
    pub(crate) fn list(&self, column: usize) -> &[u32] {
        &self.places[self.starts[column]..self.starts[column + 1]]
    }
}
