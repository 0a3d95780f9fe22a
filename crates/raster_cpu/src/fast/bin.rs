//! Order in depth, and which splats each row of tiles has to look at.

use super::splat::Splat;

/// Digits of the keys that one pass sorts by.
const BITS: u32 = 11;

/// The numbers of `keys` in ascending order of (key, number): R8, since the bits of positive
/// floats are ordered as the floats are.
///
/// Radix sort from the last digit to the first; each pass keeps the order of equals.
pub(crate) fn sorted(keys: &[(u32, u32)]) -> Vec<u32> {
    let mut from = keys.to_vec();
    let mut to = vec![(0, 0); keys.len()];
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

/// For each row of tiles the splats whose footprint reaches into it, front to back.
#[derive(Debug)]
pub(crate) struct Bands {
    /// Band b owns `entries[starts[b]..starts[b + 1]]`.
    starts: Vec<usize>,
    /// Positions in the sorted splats.
    entries: Vec<u32>,
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
        let mut entries = vec![0u32; starts[rows]];
        let mut next = starts.clone();
        for (splat, position) in splats.iter().zip(0u32..) {
            for row in splat.cells[2]..splat.cells[3] {
                let next = &mut next[usize::from(row)];
                entries[*next] = position;
                *next += 1;
            }
        }
        Self { starts, entries }
    }

    /// Positions of the splats of a band, ascending.
    pub(crate) fn list(&self, band: usize) -> &[u32] {
        &self.entries[self.starts[band]..self.starts[band + 1]]
    }
}

/// The lists of the tiles of one band.
#[derive(Debug)]
pub(crate) struct Columns {
    starts: Vec<usize>,
    entries: Vec<u32>,
}

impl Columns {
    /// `band` as in [`Bands::list`]. Entries are places in it, ascending within a tile.
    pub(crate) fn new(splats: &[Splat], band: &[u32], columns: usize) -> Self {
        let mut starts = vec![0usize; columns + 1];
        for &position in band {
            let [x0, x1, ..] = splats[position as usize].cells;
            for column in x0..x1 {
                starts[usize::from(column) + 1] += 1;
            }
        }
        for column in 0..columns {
            starts[column + 1] += starts[column];
        }
        let mut entries = vec![0u32; starts[columns]];
        let mut next = starts.clone();
        for (&position, place) in band.iter().zip(0u32..) {
            let [x0, x1, ..] = splats[position as usize].cells;
            for column in x0..x1 {
                let next = &mut next[usize::from(column)];
                entries[*next] = place;
                *next += 1;
            }
        }
        Self { starts, entries }
    }

    /// The tile's splats, front to back, as places in the band's list.
    pub(crate) fn list(&self, column: usize) -> &[u32] {
        &self.entries[self.starts[column]..self.starts[column + 1]]
    }
}
