// Between projection and blending: a list of splats for each tile, front to back.

struct Sizes {
    gaussians: u32,
    tiles_x: u32,
}

@group(0) @binding(0) var<storage, read> sizes: Sizes;

// The cells covered by each Gaussian, front to back; and the numbers 0, 1, ...

@group(0) @binding(1) var<storage, read> order: array<u32>;
@group(0) @binding(2) var<storage, read> covered: array<u32>;
@group(0) @binding(3) var<storage, read_write> in_order: array<u32>;

@compute @workgroup_size(256)
fn gather(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < sizes.gaussians {
        in_order[id.x] = covered[order[id.x]];
    }
}

@group(0) @binding(0) var<storage, read_write> counting: array<u32>;

@compute @workgroup_size(256)
fn enumerate(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&counting) {
        counting[id.x] = id.x;
    }
}

// One entry per Gaussian and cell, front to back. Entry e belongs to Gaussian owners[e] and tile tiles[e];
// those of a Gaussian are neighbours, and stay so: sorting moves e, not the entry.

@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> first: array<u32>;              // by place in `order`
@group(0) @binding(4) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(5) var<storage, read_write> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> rows: array<vec2<u32>>;   // by Gaussian: first entry, count

@compute @workgroup_size(256)
fn emit(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= sizes.gaussians {
        return;
    }
    let i = order[id.x];
    let cells = splats[i].cells;
    var e = first[id.x];
    rows[i] = vec2(e, (cells.z - cells.x) * (cells.w - cells.y));
    for (var y = cells.y; y < cells.w; y += 1u) {
        for (var x = cells.x; x < cells.z; x += 1u) {
            tiles[e] = y * sizes.tiles_x + x;
            owners[e] = i;
            e += 1u;
        }
    }
}

// Where each tile's list starts and ends among the sorted entries.

@group(0) @binding(0) var<storage, read> sorted_tiles: array<u32>;
@group(0) @binding(1) var<storage, read_write> ranges: array<u32>;       // start, end

@compute @workgroup_size(256)
fn bounds(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    let count = arrayLength(&sorted_tiles);
    if i >= count {
        return;
    }
    let tile = sorted_tiles[i];
    if i == 0u || sorted_tiles[i - 1u] != tile {
        ranges[2u * tile] = i;
    }
    if i + 1u == count || sorted_tiles[i + 1u] != tile {
        ranges[2u * tile + 1u] = i + 1u;
    }
}
