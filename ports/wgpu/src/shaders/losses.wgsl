// Losses with their gradients (O1 to O5). Images are [height, width, 3]; `mask` is 1 where a pixel counts.

struct Settings {
    width: u32,
    height: u32,
    pixels: f32,            // that count
    by_l1: f32,             // value: by_l1 L1 + by_ssim SSIM
    by_ssim: f32,
}

const C1 = 1e-4;
const C2 = 9e-4;
// e^(-k²/4.5) / sum, k = 0..5.
const TAPS = array<f32, 6>(
    0.2660117248617943, 0.21300553771125366, 0.1093606895097, 0.03600077212843082, 0.007598758135239184,
    0.0010283800844791099);

@group(0) @binding(0) var<storage, read> settings: Settings;
@group(0) @binding(1) var<storage, read> rendered: array<f32>;
@group(0) @binding(2) var<storage, read> target_image: array<f32>;
@group(0) @binding(3) var<storage, read> mask: array<f32>;

struct Moments {
    means: vec4<f32>,       // g*x, g*y, g*x², g*y²
    xy: vec4<f32>,          // g*(x y)
}

// Window along a row.
@group(0) @binding(4) var<storage, read_write> moments: array<Moments>;

@compute @workgroup_size(256)
fn moments_along(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= 3u * settings.width * settings.height {
        return;
    }
    let channel = i % 3u;
    let column = i32(i / 3u % settings.width);
    let first = i / 3u - u32(column);
    var taps = TAPS;
    var sum: Moments;
    // The far taps, which are small, first.
    for (var k = 10; k >= 0; k -= 1) {
        let far = (k + 1) / 2;
        let c = column + select(far, -far, k % 2 == 0);
        if c >= 0 && c < i32(settings.width) {
            let pixel = first + u32(c);
            let y = target_image[3u * pixel + channel];
            let x = select(y, rendered[3u * pixel + channel], mask[pixel] > 0.0);
            sum.means += taps[far] * vec4(x, y, x * x, y * y);
            sum.xy.x += taps[far] * x * y;
        }
    }
    moments[i] = sum;
}

// Window along a column; then S and m times its derivatives by μ_x, q = g*x², p = g*(x y) (O2).
@group(0) @binding(1) var<storage, read> along: array<Moments>;
@group(0) @binding(2) var<storage, read> counts: array<f32>;             // the mask
@group(0) @binding(3) var<storage, read_write> derivatives: array<vec4<f32>>;    // by μ_x, by q, by p, m S

@compute @workgroup_size(256)
fn similarity(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= 3u * settings.width * settings.height {
        return;
    }
    let row = i32(i / 3u / settings.width);
    var taps = TAPS;
    var sum: Moments;
    for (var k = 10; k >= 0; k -= 1) {
        let far = (k + 1) / 2;
        let r = row + select(far, -far, k % 2 == 0);
        if r >= 0 && r < i32(settings.height) {
            let there = along[u32(i32(i) + (r - row) * 3 * i32(settings.width))];
            sum.means += taps[far] * there.means;
            sum.xy += taps[far] * there.xy;
        }
    }
    let mx = sum.means.x;
    let my = sum.means.y;
    let a1 = 2.0 * mx * my + C1;
    let a2 = 2.0 * (sum.xy.x - mx * my) + C2;
    let b1 = mx * mx + my * my + C1;
    let b2 = (sum.means.z - mx * mx) + (sum.means.w - my * my) + C2;
    let s = a1 * a2 / (b1 * b2);
    let by_p = 2.0 * a1 / (b1 * b2);
    let by_q = -s / b2;
    let by_m = 2.0 * (my * a2 / b2 - mx * s) / b1 - my * by_p - 2.0 * mx * by_q;
    let share = counts[i / 3u] / (3.0 * settings.pixels);
    derivatives[i] = share * vec4(by_m, by_q, by_p, s);
}

@group(0) @binding(1) var<storage, read> raw: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> smoothed: array<vec4<f32>>;

@compute @workgroup_size(256)
fn derivatives_along(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= 3u * settings.width * settings.height {
        return;
    }
    let column = i32(i / 3u % settings.width);
    var taps = TAPS;
    var sum = vec4(0.0);
    for (var k = 10; k >= 0; k -= 1) {
        let far = (k + 1) / 2;
        let c = column + select(far, -far, k % 2 == 0);
        if c >= 0 && c < i32(settings.width) {
            sum += taps[far] * raw[u32(i32(i) + 3 * (c - column))];
        }
    }
    smoothed[i] = vec4(sum.xyz, raw[i].w);
}

@group(0) @binding(4) var<storage, read> half_smoothed: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> gradient: array<f32>;
@group(0) @binding(6) var<storage, read_write> terms: array<f32>;       // whose sum is the value

@compute @workgroup_size(256)
fn photometric(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= 3u * settings.width * settings.height {
        return;
    }
    let row = i32(i / 3u / settings.width);
    var taps = TAPS;
    var sum = vec3(0.0);
    for (var k = 10; k >= 0; k -= 1) {
        let far = (k + 1) / 2;
        let r = row + select(far, -far, k % 2 == 0);
        if r >= 0 && r < i32(settings.height) {
            sum += taps[far] * half_smoothed[u32(i32(i) + (r - row) * 3 * i32(settings.width))].xyz;
        }
    }
    let judged = mask[i / 3u];
    let x = rendered[i];
    let y = target_image[i];
    let difference = judged * (x - y);
    let l1 = settings.by_l1 / (3.0 * settings.pixels);
    let by_x = l1 * sign(difference) + settings.by_ssim * (sum.x + 2.0 * x * sum.y + y * sum.z);
    gradient[i] = select(0.0, by_x, judged > 0.0);
    terms[i] = l1 * abs(difference) + settings.by_ssim * half_smoothed[i].w;
}

// Depth (O4). `measured` is 0 where there is no depth.

struct DepthSettings {
    pixels: u32,
    min_opacity: f32,
    weight: f32,
}

@group(0) @binding(0) var<storage, read> depth_settings: DepthSettings;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read> opacity: array<f32>;
@group(0) @binding(4) var<storage, read> measured: array<f32>;
@group(0) @binding(5) var<storage, read_write> counted: array<vec2<f32>>;   // 1 and |D/O - z|

fn compared(i: u32) -> bool {
    return mask[i] > 0.0 && measured[i] > 0.0 && opacity[i] >= depth_settings.min_opacity;
}

@compute @workgroup_size(256)
fn depth_terms(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= depth_settings.pixels {
        return;
    }
    counted[i] = vec2(0.0);
    if compared(i) {
        counted[i] = vec2(1.0, abs(depth[i] / opacity[i] - measured[i]));
    }
}

@group(0) @binding(5) var<storage, read> totals: array<f32>;                // pixels compared, sum of errors
@group(0) @binding(6) var<storage, read_write> by_depth: array<f32>;
@group(0) @binding(7) var<storage, read_write> by_opacity: array<f32>;

@compute @workgroup_size(256)
fn depth_gradient(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= depth_settings.pixels {
        return;
    }
    by_depth[i] = 0.0;
    by_opacity[i] = 0.0;
    if compared(i) {
        let mean = depth[i] / opacity[i];
        let g = depth_settings.weight * sign(mean - measured[i]) / (totals[0] * opacity[i]);
        by_depth[i] = g;
        by_opacity[i] = -mean * g;
    }
}

// Opacity of dynamic Gaussians (O5). Logit of Gaussian i: logits[i * stride + first]; its gradient likewise.

struct PenaltySettings {
    gaussians: u32,
    stride: u32,
    first: u32,
    weight: f32,
}

@group(0) @binding(0) var<storage, read> penalty_settings: PenaltySettings;
@group(0) @binding(1) var<storage, read> logits: array<f32>;
@group(0) @binding(2) var<storage, read> dynamic: array<u32>;
@group(0) @binding(3) var<storage, read_write> by_logit: array<f32>;    // added to
@group(0) @binding(4) var<storage, read_write> squares: array<f32>;

@compute @workgroup_size(256)
fn penalty(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= penalty_settings.gaussians {
        return;
    }
    let at = i * penalty_settings.stride + penalty_settings.first;
    squares[i] = 0.0;
    if dynamic[i] != 0u {
        let o = sigmoid(logits[at]);
        squares[i] = o * o;
        by_logit[at] += penalty_settings.weight * 2.0 * o * o * sigmoid(-logits[at]);
    }
}

// Between the renderer and the losses.

@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> color_out: array<f32>;
@group(0) @binding(3) var<storage, read_write> depth_out: array<f32>;
@group(0) @binding(4) var<storage, read_write> opacity_out: array<f32>;

@compute @workgroup_size(256)
fn unpack(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= settings.width * settings.height {
        return;
    }
    for (var c = 0u; c < 3u; c += 1u) {
        color_out[3u * i + c] = image[2u * i][c];
    }
    depth_out[i] = image[2u * i + 1u].x;
    opacity_out[i] = 1.0 - image[2u * i].w;
}

@group(0) @binding(1) var<storage, read> g_color: array<f32>;
@group(0) @binding(2) var<storage, read> g_depth: array<f32>;
@group(0) @binding(3) var<storage, read> g_opacity: array<f32>;
@group(0) @binding(4) var<storage, read_write> upstream: array<f32>;

@compute @workgroup_size(256)
fn pack(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= settings.width * settings.height {
        return;
    }
    for (var c = 0u; c < 3u; c += 1u) {
        upstream[5u * i + c] = g_color[3u * i + c];
    }
    upstream[5u * i + 3u] = g_depth[i];
    upstream[5u * i + 4u] = g_opacity[i];
}
