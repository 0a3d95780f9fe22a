// Blending front to back (R9 to R11, eq. 15) and its backward pass (R13, R14). A workgroup is a tile of 16 x 16
// pixels. Tiles are the cells of the footprint, so every pixel of a tile is in the footprint of every
// splat of its list, and the place in the list is `last`.

const MIN_ALPHA = 1.0 / 255.0;
const MAX_ALPHA = 0.99;
const MIN_TRANSMITTANCE = 1e-4;

@group(0) @binding(0) var<storage, read> view: View;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> entries: array<u32>;            // sorted by tile, then front to back
@group(0) @binding(3) var<storage, read> owners: array<u32>;             // Gaussian of an entry
@group(0) @binding(4) var<storage, read> ranges: array<vec2<u32>>;       // of a tile
@group(0) @binding(5) var<storage, read_write> image: array<vec4<f32>>;  // r g b T, depth contributors last 0

// A thread has four pixels below each other; a number of the four is a vec4.
fn corner_of(tile: vec3<u32>, thread: u32) -> vec2<u32> {
    return 16u * tile.xy + vec2(thread % 16u, 4u * (thread / 16u));
}

// opacity e^power before it is clamped (R9, R10).
fn density(centre: vec4<f32>, rest: vec4<f32>, x: f32, y: vec4<f32>) -> vec4<f32> {
    let dy = y - centre.y;
    let r = x - centre.x + centre.w * dy;
    return rest.y * exp(-0.5 * (centre.z * r * r + rest.x * dy * dy));
}

// A number that all threads of a workgroup have put together, read by all of them alike.
var<workgroup> agreed: atomic<u32>;
var<workgroup> copy_of_agreed: u32;

fn agree(thread: u32) -> u32 {
    workgroupBarrier();
    if thread == 0u {
        copy_of_agreed = atomicLoad(&agreed);
    }
    return workgroupUniformLoad(&copy_of_agreed);
}

const BATCH = 64u;
var<workgroup> centres: array<vec4<f32>, 64>;
var<workgroup> rests: array<vec4<f32>, 64>;
var<workgroup> colors: array<vec4<f32>, 64>;

@compute @workgroup_size(64)
fn forward(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let corner = corner_of(tile, thread);
    let x = f32(corner.x);
    let y = f32(corner.y) + vec4(0.0, 1.0, 2.0, 3.0);
    let range = ranges[tile.y * view.tiles_x + tile.x];
    var r = vec4(0.0);
    var g = vec4(0.0);
    var b = vec4(0.0);
    var depth = vec4(0.0);
    var left = vec4(1.0);
    var contributors = vec4(0u);
    var last = vec4(0u);
    var open = vec4(corner.x < view.width) & (vec4(corner.y) + vec4(0u, 1u, 2u, 3u) < vec4(view.height));
    for (var start = range.x; start < range.y; start += BATCH) {
        if thread == 0u {
            atomicStore(&agreed, 0u);
        }
        let size = min(BATCH, range.y - start);
        if thread < size {
            let i = owners[entries[start + thread]];
            centres[thread] = splats[i].centre;
            rests[thread] = splats[i].rest;
            colors[thread] = splats[i].color;
        }
        workgroupBarrier();
        for (var k = 0u; any(open) && k < size; k += 1u) {
            let rest = rests[k];
            let alpha = min(vec4(MAX_ALPHA), density(centres[k], rest, x, y));
            let thick = open & (alpha >= vec4(MIN_ALPHA));
            if !any(thick) {
                continue;
            }
            let behind = left * (1.0 - alpha);
            open &= !(thick & (behind < vec4(MIN_TRANSMITTANCE)));
            let drawn = thick & open;
            let weight = select(vec4(0.0), alpha * left, drawn);
            let color = colors[k];
            r += weight * color.r;
            g += weight * color.g;
            b += weight * color.b;
            depth += weight * rest.z;
            left = select(left, behind, drawn);
            contributors += vec4<u32>(drawn);
            last = select(last, vec4(start + k + 1u - range.x), drawn);
        }
        if any(open) {
            atomicAdd(&agreed, 1u);
        }
        if agree(thread) == 0u {
            break;
        }
    }
    for (var p = 0u; p < 4u; p += 1u) {
        if corner.x < view.width && corner.y + p < view.height {
            let i = 2u * ((corner.y + p) * view.width + corner.x);
            image[i] = vec4(vec3(r[p], g[p], b[p]) + left[p] * view.background.rgb, left[p]);
            image[i + 1u] = vec4(depth[p], f32(contributors[p]), f32(last[p]), 0.0);
        }
    }
}

// Backward, six splats at a time. Each thread writes its sums of ten numbers per
// splat to a column of `table`; then 60 threads add one row each, in order. The sums of a tile go to the slot of
// the entry. No sum depends on which thread is first.

@group(0) @binding(5) var<storage, read> rendered: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> upstream: array<f32>;           // by r g b, depth, opacity
@group(0) @binding(7) var<storage, read_write> slots: array<f32>;        // ten numbers per entry

struct Near {
    centre: vec4<f32>,
    rest: vec4<f32>,
    color: vec4<f32>,
    entry: u32,
}

const GROUP = 6u;   // 60 rows of the table keep 60 of 64 threads at work, and fit into 16 KiB
const ROW = 65u;    // 64 columns and one more, so that a row does not share its memory banks with the next
var<workgroup> table: array<f32, 3900>;
var<workgroup> near: array<Near, 6>;

@compute @workgroup_size(64)
fn backward(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let range = ranges[tile.y * view.tiles_x + tile.x];
    let corner = corner_of(tile, thread);
    let x = f32(corner.x);
    let y = f32(corner.y) + vec4(0.0, 1.0, 2.0, 3.0);
    var left = vec4(1.0);
    var light = vec4(0.0);         // by the transmittance behind
    var by_r = vec4(0.0);
    var by_g = vec4(0.0);
    var by_b = vec4(0.0);
    var by_depth = vec4(0.0);
    var last = vec4(0u);
    for (var p = 0u; p < 4u; p += 1u) {
        if corner.x < view.width && corner.y + p < view.height {
            let i = (corner.y + p) * view.width + corner.x;
            left[p] = rendered[2u * i].w;
            last[p] = u32(rendered[2u * i + 1u].z);
            by_r[p] = upstream[5u * i];
            by_g[p] = upstream[5u * i + 1u];
            by_b[p] = upstream[5u * i + 2u];
            by_depth[p] = upstream[5u * i + 3u];
            light[p] = -upstream[5u * i + 4u];
        }
    }
    light += by_r * view.background.r + by_g * view.background.g + by_b * view.background.b;
    if thread == 0u {
        atomicStore(&agreed, 0u);
    }
    workgroupBarrier();
    atomicMax(&agreed, max(max(last.x, last.y), max(last.z, last.w)));
    // Splats behind the last one of every pixel keep the zeros of `slots`.
    var end = agree(thread);
    while end > 0u {
        let size = min(GROUP, end);
        if thread < size {
            let entry = entries[range.x + end - 1u - thread];
            let i = owners[entry];
            near[thread] = Near(splats[i].centre, splats[i].rest, vec4(splats[i].color.rgb, 0.0), entry);
        }
        workgroupBarrier();
        for (var k = 0u; k < size; k += 1u) {
            let place = end - 1u - k;
            let centre = near[k].centre;
            let rest = near[k].rest;
            let color = near[k].color;
            let dy = y - centre.y;
            let r = x - centre.x + centre.w * dy;
            let dense = density(centre, rest, x, y);
            let alpha = min(vec4(MAX_ALPHA), dense);
            let drawn = (vec4(place) < last) & (alpha >= vec4(MIN_ALPHA));
            let through = select(vec4(1.0), 1.0 - alpha, drawn);
            left /= through;
            let weight = select(vec4(0.0), alpha * left, drawn);
            let gain = by_r * color.r + by_g * color.g + by_b * color.b + by_depth * rest.z;
            let free = drawn & ((dense <= vec4(MAX_ALPHA)) | vec4(view.pass_through != 0u));
            let g = select(vec4(0.0), dense * left * (gain - light), free);
            light = select(light, alpha * gain + through * light, drawn);
            let row = 10u * k * ROW + thread;
            let one = vec4(1.0);
            table[row] = dot(g, one);
            table[row + ROW] = dot(g * r, one);
            table[row + 2u * ROW] = dot(g * dy, one);
            table[row + 3u * ROW] = dot(g * r, r);
            table[row + 4u * ROW] = dot(g * r, dy);
            table[row + 5u * ROW] = dot(g * dy, dy);
            table[row + 6u * ROW] = dot(weight, by_r);
            table[row + 7u * ROW] = dot(weight, by_g);
            table[row + 8u * ROW] = dot(weight, by_b);
            table[row + 9u * ROW] = dot(weight, by_depth);
        }
        workgroupBarrier();
        if thread < 10u * size {
            var total = 0.0;
            for (var t = 0u; t < 64u; t += 1u) {
                total += table[thread * ROW + t];
            }
            slots[10u * near[thread / 10u].entry + thread % 10u] = total;
        }
        workgroupBarrier();
        end -= size;
    }
}
