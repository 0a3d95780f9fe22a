// Stage `sh`: basis, its gradient on the sphere, and colours by degree 0 to 3.

@group(0) @binding(0) var<storage, read> directions: array<f32>;
@group(0) @binding(1) var<storage, read> coefficients: array<f32>;   // [N, 16, 3]
@group(0) @binding(2) var<storage, read_write> basis: array<f32>;    // [N, 16]
@group(0) @binding(3) var<storage, read_write> gradient: array<f32>; // [N, 16, 3]
@group(0) @binding(4) var<storage, read_write> colors: array<f32>;   // [N, 4, 3]

@compute @workgroup_size(256)
fn stage(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= arrayLength(&directions) / 3u {
        return;
    }
    let d = normalize(vec3(directions[3u * i], directions[3u * i + 1u], directions[3u * i + 2u]));
    var y = harmonics(d);
    var dy = harmonics_gradient(d);
    var color = vec3(0.5);
    for (var k = 0u; k < 16u; k += 1u) {
        let at = 3u * (16u * i + k);
        basis[16u * i + k] = y[k];
        let tangent = dy[k] - dot(dy[k], d) * d;
        gradient[at] = tangent.x;
        gradient[at + 1u] = tangent.y;
        gradient[at + 2u] = tangent.z;
        color += y[k] * vec3(coefficients[at], coefficients[at + 1u], coefficients[at + 2u]);
        if k == 0u || k == 3u || k == 8u || k == 15u {
            let degree = select(select(select(3u, 2u, k == 8u), 1u, k == 3u), 0u, k == 0u);
            let seen = max(color, vec3(0.0));
            colors[3u * (4u * i + degree)] = seen.x;
            colors[3u * (4u * i + degree) + 1u] = seen.y;
            colors[3u * (4u * i + degree) + 2u] = seen.z;
        }
    }
}
