// From Gaussians to splats and back (R1 to R7, R14 to R20), one thread per Gaussian.
//
// A Gaussian is a row of `map`: mean 3, log-scales 3, quaternion 4 (w x y z), opacity logit,
// harmonics 3 * coefficients. Its gradient is a row of the same shape.

const NEAR_M = 0.2;
const BLUR_PX2 = 0.3;
const CLAMP = 1.3;

@group(0) @binding(0) var<storage, read> view: View;
@group(0) @binding(1) var<storage, read> map: array<f32>;
@group(0) @binding(2) var<storage, read> hidden: array<u32>;            // 1: not drawn
@group(0) @binding(3) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(4) var<storage, read_write> radii: array<i32>;
@group(0) @binding(5) var<storage, read_write> covered: array<u32>;     // cells in the footprint
@group(0) @binding(6) var<storage, read_write> depth_keys: array<u32>;

fn row_of(i: u32) -> u32 {
    return i * (11u + 3u * view.coefficients);
}

fn three(at: u32) -> vec3<f32> {
    return vec3(map[at], map[at + 1u], map[at + 2u]);
}

// R2; columns are own axes in the world.
fn rotation(q: vec4<f32>) -> mat3x3<f32> {
    let w = q.x; let x = q.y; let y = q.z; let z = q.w;
    return mat3x3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

struct Shape {
    p: vec3<f32>,           // mean in the camera
    slope: vec2<f32>,
    clamped: vec2<bool>,
    over_z: vec2<f32>,      // f / z
    ju: vec3<f32>,          // rows of J W
    jv: vec3<f32>,
    r: mat3x3<f32>,
    s: vec3<f32>,
    mu: vec3<f32>,          // rows of M
    mv: vec3<f32>,
    q: vec4<f32>,           // as stored
}

fn shape_of(at: u32) -> Shape {
    var g: Shape;
    let mean = vec4(three(at), 1.0);
    g.p = vec3(dot(view.w0, mean), dot(view.w1, mean), dot(view.w2, mean));
    g.s = vec3(exp(map[at + 3u]), exp(map[at + 4u]), exp(map[at + 5u]));
    g.q = vec4(map[at + 6u], map[at + 7u], map[at + 8u], map[at + 9u]);
    g.r = rotation(g.q / length(g.q));
    let limit = CLAMP * 0.5 * vec2(f32(view.width), f32(view.height)) / view.intrinsics.xy;
    let slope = g.p.xy / g.p.z;
    g.clamped = abs(slope) > limit;
    g.slope = clamp(slope, -limit, limit);
    g.over_z = view.intrinsics.xy / g.p.z;
    g.ju = g.over_z.x * (view.w0.xyz - g.slope.x * view.w2.xyz);
    g.jv = g.over_z.y * (view.w1.xyz - g.slope.y * view.w2.xyz);
    g.mu = (g.ju * g.r) * g.s;
    g.mv = (g.jv * g.r) * g.s;
    return g;
}

// From the camera's centre to the mean, in the world.
fn offset_of(at: u32) -> vec3<f32> {
    let t = vec3(view.w0.w, view.w1.w, view.w2.w);
    return three(at) + t.x * view.w0.xyz + t.y * view.w1.xyz + t.z * view.w2.xyz;
}

@compute @workgroup_size(256)
fn project(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= view.gaussians {
        return;
    }
    let at = row_of(i);
    radii[i] = 0;
    covered[i] = 0u;
    depth_keys[i] = 0xffffffffu;
    splats[i].cells = vec4(0u);
    let g = shape_of(at);
    if hidden[i] != 0u || !(g.p.z > NEAR_M) {
        return;
    }
    // det(M Mᵀ) as a sum of squares (R5): a c - b² loses needles.
    let c = cross(g.mu, g.mv);
    let a = dot(g.mu, g.mu);
    let b = dot(g.mu, g.mv);
    let d = dot(g.mv, g.mv);
    let det = dot(c, c) + BLUR_PX2 * (a + d) + BLUR_PX2 * BLUR_PX2;
    let xx = a + BLUR_PX2;
    let yy = d + BLUR_PX2;
    let half = 0.5 * (xx - yy);
    let largest = 0.5 * (xx + yy) + sqrt(max(0.1, half * half + b * b));
    let radius = ceil(3.0 * sqrt(largest));
    let uv = view.intrinsics.xy * g.p.xy / g.p.z + view.intrinsics.zw;
    let most = vec2(f32(view.tiles_x), f32(view.tiles_y));
    let low = clamp(floor((uv - radius) / 16.0), vec2(0.0), most);
    let high = clamp(floor((uv + radius + 15.0) / 16.0), vec2(0.0), most);
    if any(low >= high) {
        return;
    }
    let offset = offset_of(at);
    var y = harmonics(offset / length(offset));
    var color = vec3(0.5);
    for (var k = 0u; k < view.coefficients; k += 1u) {
        color += y[k] * three(at + 11u + 3u * k);
    }
    var splat: Splat;
    splat.centre = vec4(uv, yy / det, -b / yy);
    splat.rest = vec4(1.0 / yy, sigmoid(map[at + 10u]), g.p.z, xx / det);
    splat.color = vec4(max(color, vec3(0.0)), -b / det);
    splat.cells = vec4(vec2<u32>(low), vec2<u32>(high));
    splats[i] = splat;
    radii[i] = i32(radius);
    let wide = splat.cells.zw - splat.cells.xy;
    covered[i] = wide.x * wide.y;
    depth_keys[i] = bitcast<u32>(g.p.z);
}

// Stage `projection_covariance`: what `project` has on its way.

@group(0) @binding(2) var<storage, read_write> p_cam: array<f32>;
@group(0) @binding(3) var<storage, read_write> rotations: array<f32>;

@compute @workgroup_size(256)
fn describe(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= view.gaussians {
        return;
    }
    let g = shape_of(row_of(i));
    for (var k = 0u; k < 3u; k += 1u) {
        p_cam[3u * i + k] = g.p[k];
        for (var l = 0u; l < 3u; l += 1u) {
            rotations[9u * i + 3u * k + l] = g.r[l][k];
        }
    }
}

// Backward. A row of `slots` holds what one tile adds to one splat:
// Σ g, g r, g dy, g r², g r dy, g dy², w gc (3), w gz (R14). The rows of a Gaussian are neighbours.

@group(0) @binding(2) var<storage, read> seen: array<Splat>;
@group(0) @binding(3) var<storage, read> slots: array<f32>;
@group(0) @binding(4) var<storage, read> rows: array<vec2<u32>>;         // first, count
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;     // as `map`
@group(0) @binding(6) var<storage, read_write> by_splat: array<f32>;     // centre 2, conic 3, opacity, color 3, z
@group(0) @binding(7) var<storage, read_write> by_pose: array<f32>;      // rho 3, phi 3

@compute @workgroup_size(256)
fn project_backward(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= view.gaussians {
        return;
    }
    let at = row_of(i);
    let width = 11u + 3u * view.coefficients;
    let mine = rows[i];
    var g_sums = vec3(0.0);         // Σ g, g r, g dy
    var second = vec3(0.0);         // Σ g r², g r dy, g dy²
    var g_color = vec3(0.0);
    var g_z = 0.0;
    for (var e = 10u * mine.x; e < 10u * (mine.x + mine.y); e += 10u) {
        g_sums += vec3(slots[e], slots[e + 1u], slots[e + 2u]);
        second += vec3(slots[e + 3u], slots[e + 4u], slots[e + 5u]);
        g_color += vec3(slots[e + 6u], slots[e + 7u], slots[e + 8u]);
        g_z += slots[e + 9u];
    }
    if mine.y == 0u {
        for (var k = 0u; k < width; k += 1u) {
            gradient[at + k] = 0.0;
        }
        for (var k = 0u; k < 10u; k += 1u) {
            by_splat[10u * i + k] = 0.0;
        }
        for (var k = 0u; k < 6u; k += 1u) {
            by_pose[6u * i + k] = 0.0;
        }
        return;
    }
    let splat = seen[i];
    let a = splat.centre.z;
    let shear = splat.centre.w;
    let flat = splat.rest.x;
    let opacity = splat.rest.y;

    // R14: v = (A r, shear A r + dy / Σ'yy).
    let g_uv = vec2(a * g_sums.y, shear * a * g_sums.y + flat * g_sums.z);
    let g_xx = 0.5 * a * a * second.x;
    let g_xy = a * (shear * a * second.x + flat * second.y);
    let g_yy = 0.5 * (shear * a * (shear * a * second.x + 2.0 * flat * second.y) + flat * flat * second.z);
    let g_opacity = g_sums.x / opacity;
    let s = 10u * i;
    by_splat[s] = g_uv.x;
    by_splat[s + 1u] = g_uv.y;
    by_splat[s + 2u] = -0.5 * (second.x - 2.0 * shear * second.y + shear * shear * second.z);
    by_splat[s + 3u] = -(second.y - shear * second.z);
    by_splat[s + 4u] = -0.5 * second.z;
    by_splat[s + 5u] = g_opacity;
    by_splat[s + 6u] = g_color.x;
    by_splat[s + 7u] = g_color.y;
    by_splat[s + 8u] = g_color.z;
    by_splat[s + 9u] = g_z;

    // R15, R16.
    let g = shape_of(at);
    let dmu = 2.0 * g_xx * g.mu + g_xy * g.mv;
    let dmv = g_xy * g.mu + 2.0 * g_yy * g.mv;
    let d_scale = g.mu * dmu + g.mv * dmv;
    let du = dmu * g.s;
    let dv = dmv * g.s;
    let d_ju = g.r * du;
    let d_jv = g.r * dv;
    // Column l of dR is ju du_l + jv dv_l.
    let d_r = mat3x3(g.ju * du.x + g.jv * dv.x, g.ju * du.y + g.jv * dv.y, g.ju * du.z + g.jv * dv.z);

    // R17.
    let hu = vec3(dot(view.w0.xyz, d_ju), dot(view.w1.xyz, d_ju), dot(view.w2.xyz, d_ju));
    let hv = vec3(dot(view.w0.xyz, d_jv), dot(view.w1.xyz, d_jv), dot(view.w2.xyz, d_jv));
    let by_slope = -g.over_z * vec2(hu.z, hv.z);
    let held = select(by_slope, vec2(0.0), g.clamped);
    let in_z = select(held, by_slope, view.pass_through != 0u);
    let z = g.p.z;
    var d_p = vec3(held / z, -(dot(d_ju, g.ju) + dot(d_jv, g.jv) + dot(g.slope, in_z)) / z);
    let axis_u = g.over_z.x * vec3(1.0, 0.0, -g.slope.x);
    let axis_v = g.over_z.y * vec3(0.0, 1.0, -g.slope.y);

    // R1, R20.
    let f_g = view.intrinsics.xy * g_uv;
    d_p += vec3(f_g / z, -dot(f_g, g.p.xy) / (z * z) + g_z);

    // R19.
    let offset = offset_of(at);
    let distance = length(offset);
    let d = offset / distance;
    let lit = select(vec3(0.0), g_color, splat.color.rgb > vec3(0.0));
    var y = harmonics(d);
    var dy = harmonics_gradient(d);
    var turn = vec3(0.0);
    for (var k = 0u; k < view.coefficients; k += 1u) {
        let c = at + 11u + 3u * k;
        turn += dot(three(c), lit) * dy[k];
        gradient[c] = y[k] * lit.x;
        gradient[c + 1u] = y[k] * lit.y;
        gradient[c + 2u] = y[k] * lit.z;
    }
    let d_offset = (turn - dot(turn, d) * d) / distance;

    let d_mean = d_p.x * view.w0.xyz + d_p.y * view.w1.xyz + d_p.z * view.w2.xyz + d_offset;
    let d_rho = d_p + vec3(dot(view.w0.xyz, d_offset), dot(view.w1.xyz, d_offset), dot(view.w2.xyz, d_offset));
    let d_phi = cross(g.p, d_p) + cross(hu, axis_u) + cross(hv, axis_v);

    // R18: e(i, j) is d_r[j][i].
    let size = length(g.q);
    let q = g.q / size;
    let w = q.x; let qx = q.y; let qy = q.z; let qz = q.w;
    let e01 = d_r[1][0]; let e10 = d_r[0][1];
    let e02 = d_r[2][0]; let e20 = d_r[0][2];
    let e12 = d_r[2][1]; let e21 = d_r[1][2];
    let f = 2.0 * vec4(
        qx * (e21 - e12) + qy * (e02 - e20) + qz * (e10 - e01),
        qy * (e01 + e10) + qz * (e02 + e20) + w * (e21 - e12) - 2.0 * qx * (d_r[1][1] + d_r[2][2]),
        qx * (e01 + e10) + qz * (e12 + e21) + w * (e02 - e20) - 2.0 * qy * (d_r[0][0] + d_r[2][2]),
        qx * (e02 + e20) + qy * (e12 + e21) + w * (e10 - e01) - 2.0 * qz * (d_r[0][0] + d_r[1][1]));
    let d_q = (f - dot(f, q) * q) / size;

    for (var k = 0u; k < 3u; k += 1u) {
        gradient[at + k] = d_mean[k];
        gradient[at + 3u + k] = d_scale[k];
        by_pose[6u * i + k] = d_rho[k];
        by_pose[6u * i + 3u + k] = d_phi[k];
    }
    for (var k = 0u; k < 4u; k += 1u) {
        gradient[at + 6u + k] = d_q[k];
    }
    gradient[at + 10u] = g_opacity * opacity * (1.0 - opacity);
}
