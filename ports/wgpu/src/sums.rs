//! Sums and sorting on the GPU, in a fixed order.

use crate::Error;
use crate::gpu::{Buffer, Gpu};

/// The sum of each column of a table of `rows` rows.
pub fn columns(gpu: &Gpu, numbers: &Buffer, rows: usize, columns: usize) -> Buffer {
    let mut rows = rows;
    let mut numbers = numbers.clone();
    loop {
        let next = rows.div_ceil(1024);
        let totals = gpu.zeros(next * columns);
        let shape = gpu.upload(&[rows as u32, columns as u32]);
        gpu.run("sum/sum", &[&shape, &numbers, &totals], [next, columns]);
        if next <= 1 {
            return totals;
        }
        (rows, numbers) = (next, totals);
    }
}

/// The sum of the first `count` numbers, read back.
pub fn total(gpu: &Gpu, numbers: &Buffer, count: usize) -> Result<f32, Error> {
    let sum = gpu.read::<f32>(&columns(gpu, numbers, count, 1), 1)?;
    Ok(sum[0])
}

/// Replaces each of `count` numbers by the sum of those in front of it; returns the sum of all.
pub fn exclusive(gpu: &Gpu, numbers: &Buffer, count: usize) -> Buffer {
    let blocks = count.div_ceil(1024).max(1);
    let totals = gpu.zeros(blocks);
    gpu.run("sort/sums", &[numbers, &totals], [blocks, 1]);
    if blocks == 1 {
        return totals;
    }
    let all = exclusive(gpu, &totals, blocks);
    gpu.run_over("sort/raise", &[numbers, &totals], count);
    all
}

/// Pairs in the order of the lowest `bits` bits of their keys; equal keys stay in order.
pub fn sort(gpu: &Gpu, pairs: [Buffer; 2], count: usize, bits: u32) -> [Buffer; 2] {
    let blocks = count.div_ceil(1024);
    let [mut keys, mut values] = pairs;
    let [mut other_keys, mut other_values] = [gpu.zeros(count), gpu.zeros(count)];
    for shift in (0..bits).step_by(4) {
        let digit = gpu.upload(&[count as u32, blocks as u32, shift]);
        let counts = gpu.zeros(16 * blocks);
        gpu.run("sort/count", &[&digit, &keys, &counts], [blocks, 1]);
        exclusive(gpu, &counts, 16 * blocks);
        gpu.run(
            "sort/scatter",
            &[&digit, &keys, &values, &counts, &other_keys, &other_values],
            [blocks, 1],
        );
        std::mem::swap(&mut keys, &mut other_keys);
        std::mem::swap(&mut values, &mut other_values);
    }
    [keys, values]
}
