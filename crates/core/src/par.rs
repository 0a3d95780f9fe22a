//! [`Par`]: threads that never change a result.
//!
//! Work is cut into pieces whose size does not depend on the number of threads; the pieces'
//! results come back in index order and are combined by the caller in that order. A float sum
//! therefore has one order of additions, whatever runs it. This is the only use of `rayon`.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::prelude::*;

/// How many threads a stage may use. Passed as an argument, never read from the environment.
///
/// # Example
/// ```
/// use garad_core::Par;
/// let squares = |par: Par| par.map_chunks(10, 3, |range| range.map(|i| i * i).sum::<usize>());
/// assert_eq!(squares(Par::Seq), vec![0 + 1 + 4, 9 + 16 + 25, 36 + 49 + 64, 81]);
/// assert_eq!(squares(Par::Seq), squares(Par::Threads(3)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Par {
    /// On the calling thread.
    #[default]
    Seq,
    /// On a pool of this many threads (0 and 1 mean [`Par::Seq`]).
    Threads(usize),
}

impl Par {
    /// [`Par::Seq`] for 0 and 1, otherwise a pool of that size.
    #[must_use]
    pub fn new(threads: usize) -> Self {
        if threads <= 1 {
            Self::Seq
        } else {
            Self::Threads(threads)
        }
    }

    /// Number of threads, at least 1.
    #[must_use]
    pub fn threads(self) -> usize {
        match self {
            Self::Seq => 1,
            Self::Threads(n) => n.max(1),
        }
    }

    /// `f` of each range of `chunk` indices out of `0..n`, in index order.
    ///
    /// The cuts depend on `n` and `chunk` alone, so folding the answer in order gives the same
    /// bits for any number of threads.
    pub fn map_chunks<R: Send>(
        self,
        n: usize,
        chunk: usize,
        f: impl Fn(Range<usize>) -> R + Sync + Send,
    ) -> Vec<R> {
        let chunk = chunk.max(1);
        let range_of = |i: usize| i * chunk..((i + 1) * chunk).min(n);
        let chunks = n.div_ceil(chunk);
        match self.pool() {
            Some(pool) if chunks > 1 => pool.install(|| {
                (0..chunks)
                    .into_par_iter()
                    .map(|i| f(range_of(i)))
                    .collect()
            }),
            _ => (0..chunks).map(|i| f(range_of(i))).collect(),
        }
    }

    /// `f(i)` for each i in `0..n`, in index order.
    pub fn map<R: Send>(self, n: usize, f: impl Fn(usize) -> R + Sync + Send) -> Vec<R> {
        match self.pool() {
            Some(pool) if n > 1 => pool.install(|| (0..n).into_par_iter().map(f).collect()),
            _ => (0..n).map(f).collect(),
        }
    }

    /// Hands each piece of `chunk` consecutive elements, with its number, to `f`.
    pub fn for_each_chunk_mut<T: Send>(
        self,
        data: &mut [T],
        chunk: usize,
        f: impl Fn(usize, &mut [T]) + Sync + Send,
    ) {
        let chunk = chunk.max(1);
        match self.pool() {
            Some(pool) if data.len() > chunk => pool.install(|| {
                data.par_chunks_mut(chunk)
                    .enumerate()
                    .for_each(|(i, piece)| f(i, piece));
            }),
            _ => data
                .chunks_mut(chunk)
                .enumerate()
                .for_each(|(i, piece)| f(i, piece)),
        }
    }

    /// Both results, computed in parallel when there is a second thread.
    pub fn join<A: Send, B: Send>(
        self,
        a: impl FnOnce() -> A + Send,
        b: impl FnOnce() -> B + Send,
    ) -> (A, B) {
        match self.pool() {
            Some(pool) => pool.install(|| rayon::join(a, b)),
            None => (a(), b()),
        }
    }

    /// The pool of this size, made once. `None`: run on this thread, also where the system cannot
    /// start a pool; the result is the same.
    fn pool(self) -> Option<Arc<rayon::ThreadPool>> {
        static POOLS: OnceLock<Mutex<BTreeMap<usize, Arc<rayon::ThreadPool>>>> = OnceLock::new();
        let threads = self.threads();
        if threads == 1 {
            return None;
        }
        let mut pools = POOLS
            .get_or_init(Mutex::default)
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(pool) = pools.get(&threads) {
            return Some(Arc::clone(pool));
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .ok()?;
        let pool = Arc::new(pool);
        pools.insert(threads, Arc::clone(&pool));
        Some(pool)
    }
}

#[cfg(test)]
mod tests {
    use super::Par;

    /// Summands of very different size: any change of order changes the last bits.
    fn chunked_sum(par: Par) -> f32 {
        let value =
            |i: usize| 1.0 / (1.0 + i as f32) * if i.is_multiple_of(7) { 1e4 } else { 1e-3 };
        par.map_chunks(100_003, 4096, |range| {
            range.map(value).fold(0.0f32, |a, b| a + b)
        })
        .into_iter()
        .fold(0.0, |a, b| a + b)
    }

    #[test]
    fn float_sums_have_one_bit_pattern() {
        let expected = chunked_sum(Par::Seq).to_bits();
        for threads in [1, 2, 3, 8] {
            for _ in 0..20 {
                assert_eq!(
                    chunked_sum(Par::new(threads)).to_bits(),
                    expected,
                    "{threads} threads"
                );
            }
        }
    }

    #[test]
    fn chunks_cover_everything_once_and_in_order() {
        for par in [Par::Seq, Par::Threads(3)] {
            let ranges = par.map_chunks(10, 4, |r| r);
            assert_eq!(ranges, vec![0..4, 4..8, 8..10], "cuts");
            assert!(par.map_chunks(0, 4, |r| r).is_empty(), "nothing to do");
            let mut data = vec![0usize; 10];
            par.for_each_chunk_mut(&mut data, 4, |i, piece| piece.fill(i));
            assert_eq!(data, [0, 0, 0, 0, 1, 1, 1, 1, 2, 2], "pieces");
            assert_eq!(par.map(3, |i| i), [0, 1, 2], "items");
            assert_eq!(par.join(|| 1, || 2), (1, 2), "pair");
        }
    }
}
