// Mean field over all pairs (eq. 1, 4 to 6; C2): 64 nodes at a time in workgroup memory. The sum of 64 is added to
// the sums of the others before it, in order.

struct Field {
    nodes: u32,
    feature_weight: f32,
    position_weight: f32,
    by_reproj: f32,         // 1 / 2σ²
    by_observations: f32,
    by_m: f32,
    by_px: f32,
    linear: u32,
    space: u32,             // 1: distances in metres count
    pixel: u32,
    self_message: u32,
    normalisation: u32,     // 0 none, 1 rows, 2 symmetric
    damping: f32,
}

struct Node {
    p: vec4<f32>,           // x y z, 1 if it has a pixel
    uv: vec4<f32>,          // u v, 1 if it has both features
    features: vec4<f32>,    // reprojection error, observations
}

@group(0) @binding(0) var<storage, read> field: Field;
@group(0) @binding(1) var<storage, read> nodes: array<Node>;

// A thread has four rows, so that what is read of another node serves four pairs; a number of the four is a vec4.
struct Rows {
    i: vec4<u32>,
    x: vec4<f32>,
    y: vec4<f32>,
    z: vec4<f32>,
    has_pixel: vec4<f32>,
    u: vec4<f32>,
    v: vec4<f32>,
    has_features: vec4<f32>,
    reproj: vec4<f32>,
    observations: vec4<f32>,
}

// Rows beyond the last node repeat it, and are not written.
fn rows_from(first: u32) -> Rows {
    var rows: Rows;
    for (var k = 0u; k < 4u; k += 1u) {
        let node = nodes[min(first + k, field.nodes - 1u)];
        rows.i[k] = first + k;
        rows.x[k] = node.p.x;
        rows.y[k] = node.p.y;
        rows.z[k] = node.p.z;
        rows.has_pixel[k] = node.p.w;
        rows.u[k] = node.uv.x;
        rows.v[k] = node.uv.y;
        rows.has_features[k] = node.uv.z;
        rows.reproj[k] = node.features.x;
        rows.observations[k] = node.features.y;
    }
    return rows;
}

// k¹ and k² of each row with node j (eq. 5, 6), as columns.
fn kernels(a: Rows, b: Node, j: u32) -> mat2x4<f32> {
    let by_reproj = a.reproj - b.features.x;
    let by_count = a.observations - b.features.y;
    let k1 = exp(-by_reproj * by_reproj * field.by_reproj - by_count * by_count * field.by_observations);
    let x = a.x - b.p.x;
    let y = a.y - b.p.y;
    let z = a.z - b.p.z;
    let u = a.u - b.uv.x;
    let v = a.v - b.uv.y;
    let both_px = a.has_pixel * b.p.w;
    var metres = (x * x + y * y + z * z) * f32(field.space);
    var pixels = (u * u + v * v) * both_px * f32(field.pixel);
    if field.linear != 0u {
        metres = sqrt(metres);
        pixels = sqrt(pixels);
    }
    let k2 = exp(-metres * field.by_m - pixels * field.by_px);
    let wanted = vec4<f32>((a.i != vec4(j)) | vec4(field.self_message != 0u));
    // Without a pixel only metres can tell.
    let known = select(both_px, vec4(1.0), field.space != 0u);
    return mat2x4(wanted * k1 * a.has_features * b.uv.z, wanted * k2 * known);
}

var<workgroup> tile: array<Node, 64>;

// Normalisations, by row: 1/r (rows), 1/√r (symmetric) of each kernel.
@group(0) @binding(2) var<storage, read_write> norms: array<vec2<f32>>;

@compute @workgroup_size(64)
fn row_sums(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let own = rows_from(4u * id.x);
    var total = mat2x4<f32>();
    for (var start = 0u; start < field.nodes; start += 64u) {
        tile[thread] = nodes[min(start + thread, field.nodes - 1u)];
        workgroupBarrier();
        let size = min(64u, field.nodes - start);
        var part = mat2x4<f32>();
        for (var k = 0u; k < size; k += 1u) {
            part += kernels(own, tile[k], start + k);
        }
        total += part;
        workgroupBarrier();
    }
    for (var k = 0u; k < 4u && own.i[k] < field.nodes; k += 1u) {
        let sums = vec2(total[0][k], total[1][k]);
        var norm = vec2(1.0);
        if field.normalisation != 0u {
            norm = select(vec2(0.0), 1.0 / sums, sums > vec2(0.0));
        }
        if field.normalisation == 2u {
            norm = sqrt(norm);
        }
        norms[own.i[k]] = norm;
    }
}

// One parallel update: q of all nodes from the old q of all nodes.
@group(0) @binding(2) var<storage, read> row_norms: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read> log_odds: array<f32>;
@group(0) @binding(4) var<storage, read> old: array<f32>;
@group(0) @binding(5) var<storage, read_write> new_q: array<f32>;

var<workgroup> messages: array<vec2<f32>, 64>;

@compute @workgroup_size(64)
fn update(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let own = rows_from(4u * id.x);
    var total = mat2x4<f32>();
    for (var start = 0u; start < field.nodes; start += 64u) {
        let j = min(start + thread, field.nodes - 1u);
        tile[thread] = nodes[j];
        let theirs = select(vec2(1.0), row_norms[j], field.normalisation == 2u);
        messages[thread] = (2.0 * old[j] - 1.0) * theirs;
        workgroupBarrier();
        let size = min(64u, field.nodes - start);
        var part = mat2x4<f32>();
        for (var k = 0u; k < size; k += 1u) {
            let pair = kernels(own, tile[k], start + k);
            let message = messages[k];
            part += mat2x4(pair[0] * message.x, pair[1] * message.y);
        }
        total += part;
        workgroupBarrier();
    }
    for (var k = 0u; k < 4u && own.i[k] < field.nodes; k += 1u) {
        let i = own.i[k];
        let weights = vec2(field.feature_weight, field.position_weight) * row_norms[i];
        let message = dot(weights, vec2(total[0][k], total[1][k]));
        new_q[i] = mix(sigmoid(log_odds[i] + message), old[i], field.damping);
    }
}

@group(0) @binding(1) var<storage, read_write> start_q: array<f32>;
@group(0) @binding(2) var<storage, read> odds: array<f32>;

@compute @workgroup_size(256)
fn begin(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < field.nodes {
        start_q[id.x] = sigmoid(odds[id.x]);
    }
}

// All labellings of a few nodes (C1), for kernels without normalisation: bit i of `x` is the label of node i.

@group(0) @binding(2) var<storage, read_write> couplings: array<f32>;    // [N, N]

@compute @workgroup_size(256)
fn couple(@builtin(global_invocation_id) id: vec3<u32>) {
    let own = rows_from(4u * id.x);
    for (var j = 0u; j < field.nodes; j += 1u) {
        let pair = kernels(own, nodes[j], j);
        for (var k = 0u; k < 4u && own.i[k] < field.nodes; k += 1u) {
            couplings[own.i[k] * field.nodes + j] = field.feature_weight * pair[0][k] + field.position_weight * pair[1][k];
        }
    }
}

@group(0) @binding(1) var<storage, read> coupling: array<f32>;
@group(0) @binding(3) var<storage, read_write> energies: array<f32>;     // [2^N]

@compute @workgroup_size(256)
fn energy(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = field.nodes;
    let x = id.x;
    if x >= 1u << n {
        return;
    }
    var total = 0.0;
    for (var i = 0u; i < n; i += 1u) {
        let label = x >> i & 1u;
        var row = -f32(label) * odds[i];
        for (var j = i + 1u; j < n; j += 1u) {
            row += f32(label ^ (x >> j & 1u)) * coupling[i * n + j];
        }
        total += row;
    }
    energies[x] = total;
}

@group(0) @binding(1) var<storage, read> all_energies: array<f32>;
@group(0) @binding(2) var<storage, read_write> best: array<f32>;         // least energy, its labelling

var<workgroup> least: array<vec2<f32>, 256>;

@compute @workgroup_size(256)
fn lowest(@builtin(local_invocation_index) thread: u32) {
    var mine = vec2(all_energies[0], 0.0);
    for (var x = thread; x < 1u << field.nodes; x += 256u) {
        if all_energies[x] < mine.x {
            mine = vec2(all_energies[x], f32(x));
        }
    }
    least[thread] = mine;
    workgroupBarrier();
    if thread == 0u {
        for (var t = 1u; t < 256u; t += 1u) {
            if least[t].x < mine.x || least[t].x == mine.x && least[t].y < mine.y {
                mine = least[t];
            }
        }
        best[0] = mine.x;
        best[1] = mine.y;
    }
}

// e^(least - E) of each labelling, and the same once more in the column of each node that is dynamic in it.
@group(0) @binding(2) var<storage, read> known_best: array<f32>;
@group(0) @binding(3) var<storage, read_write> weights: array<f32>;      // [2^N, 1 + N]

@compute @workgroup_size(256)
fn weigh(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = field.nodes;
    let x = id.x;
    if x >= 1u << n {
        return;
    }
    let w = exp(known_best[0] - all_energies[x]);
    weights[x * (n + 1u)] = w;
    for (var i = 0u; i < n; i += 1u) {
        weights[x * (n + 1u) + 1u + i] = w * f32(x >> i & 1u);
    }
}

// The terms of the free energy of the beliefs, by node.
@group(0) @binding(3) var<storage, read> beliefs: array<f32>;
@group(0) @binding(4) var<storage, read_write> terms: array<f32>;

@compute @workgroup_size(256)
fn free_energy(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = field.nodes;
    let i = id.x;
    if i >= n {
        return;
    }
    let q = beliefs[i];
    var total = -q * odds[i];
    if q > 0.0 && q < 1.0 {
        total += q * log(q) + (1.0 - q) * log(1.0 - q);
    }
    for (var j = i + 1u; j < n; j += 1u) {
        total += coupling[i * n + j] * (q * (1.0 - beliefs[j]) + beliefs[j] * (1.0 - q));
    }
    terms[i] = total;
}
