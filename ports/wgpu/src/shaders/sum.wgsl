// Sums in a fixed order: 1024 numbers per workgroup, each thread four of them, then a tree.
//
// totals[row * columns + column] += nothing is ever added in place: a sum of n rows becomes a sum of
// ceil(n / 1024) rows, until one is left.

struct Shape {
    rows: u32,
    columns: u32,
}

@group(0) @binding(0) var<storage, read> shape: Shape;
@group(0) @binding(1) var<storage, read> numbers: array<f32>;
@group(0) @binding(2) var<storage, read_write> totals: array<f32>;

var<workgroup> part: array<f32, 256>;

@compute @workgroup_size(256)
fn sum(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let column = group.y;
    var total = 0.0;
    for (var k = 0u; k < 4u; k += 1u) {
        let row = group.x * 1024u + k * 256u + thread;
        if row < shape.rows {
            total += numbers[row * shape.columns + column];
        }
    }
    part[thread] = total;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if thread < half {
            part[thread] += part[thread + half];
        }
        workgroupBarrier();
    }
    if thread == 0u {
        totals[group.x * shape.columns + column] = part[0];
    }
}
