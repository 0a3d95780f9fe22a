// Stable radix sort of pairs of words, four bits at a time, and the exclusive sums it needs.
//
// A block is 1024 pairs, 64 threads with 16 neighbouring pairs each. A thread counts its digits in a row of
// its own and hands places out in order, so equal digits stay in order and nothing depends on which thread is first.

const THREADS = 64u;
const EACH = 16u;
const BINS = 16u;

struct Digit {
    pairs: u32,
    blocks: u32,
    shift: u32,
}

@group(0) @binding(0) var<storage, read> digit: Digit;
@group(0) @binding(1) var<storage, read> keys: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;    // [bin, block]

@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<u32>;          // `counts` after `sums`
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;

var<workgroup> tally: array<u32, 1024>;   // [bin, thread]
var<workgroup> starts: array<u32, 64>;

fn bin_of(key: u32) -> u32 {
    return (key >> digit.shift) & (BINS - 1u);
}

fn count_own(first: u32, thread: u32) {
    for (var b = 0u; b < BINS; b += 1u) {
        tally[b * THREADS + thread] = 0u;
    }
    for (var k = 0u; k < EACH; k += 1u) {
        if first + k < digit.pairs {
            tally[bin_of(keys[first + k]) * THREADS + thread] += 1u;
        }
    }
}

@compute @workgroup_size(64)
fn count(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    count_own((group.x * THREADS + thread) * EACH, thread);
    workgroupBarrier();
    if thread < BINS {
        var total = 0u;
        for (var t = 0u; t < THREADS; t += 1u) {
            total += tally[thread * THREADS + t];
        }
        counts[thread * digit.blocks + group.x] = total;
    }
}

@compute @workgroup_size(64)
fn scatter(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let first = (group.x * THREADS + thread) * EACH;
    count_own(first, thread);
    workgroupBarrier();
    if thread < BINS {
        var place = places[thread * digit.blocks + group.x];
        for (var t = 0u; t < THREADS; t += 1u) {
            let mine = tally[thread * THREADS + t];
            tally[thread * THREADS + t] = place;
            place += mine;
        }
    }
    workgroupBarrier();
    for (var k = 0u; k < EACH; k += 1u) {
        if first + k < digit.pairs {
            let key = keys[first + k];
            let at = bin_of(key) * THREADS + thread;
            let place = tally[at];
            tally[at] = place + 1u;
            keys_out[place] = key;
            values_out[place] = values[first + k];
        }
    }
}

// Exclusive sums: 1024 numbers per workgroup in place, the total of each to `totals`; `raise` adds what is in front.

@group(0) @binding(0) var<storage, read_write> numbers: array<u32>;
@group(0) @binding(1) var<storage, read_write> totals: array<u32>;

@compute @workgroup_size(64)
fn sums(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let first = (group.x * THREADS + thread) * EACH;
    let end = arrayLength(&numbers);
    var total = 0u;
    for (var k = 0u; k < EACH; k += 1u) {
        if first + k < end {
            total += numbers[first + k];
        }
    }
    starts[thread] = total;
    workgroupBarrier();
    var before = 0u;
    for (var t = 0u; t < thread; t += 1u) {
        before += starts[t];
    }
    for (var k = 0u; k < EACH; k += 1u) {
        if first + k < end {
            let own = numbers[first + k];
            numbers[first + k] = before;
            before += own;
        }
    }
    if thread == THREADS - 1u {
        totals[group.x] = before;
    }
}

@compute @workgroup_size(256)
fn raise(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&numbers) {
        numbers[id.x] += totals[id.x / 1024u];
    }
}
