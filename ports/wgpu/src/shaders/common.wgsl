// In front of every file of kernels.

struct View {
    w0: vec4<f32>,          // rows of camera_from_world: rotation, translation
    w1: vec4<f32>,
    w2: vec4<f32>,
    intrinsics: vec4<f32>,  // fx fy cx cy
    background: vec4<f32>,
    width: u32,
    height: u32,
    tiles_x: u32,
    tiles_y: u32,
    gaussians: u32,
    coefficients: u32,
    pass_through: u32,
    unused: u32,
}

struct Splat {
    centre: vec4<f32>,      // u, v, A, B/A
    rest: vec4<f32>,        // 1/Σ'yy, opacity, z, C
    color: vec4<f32>,       // r, g, b, B
    cells: vec4<u32>,       // x0 y0 x1 y1 in cells of 16 px, ends excluded; empty: invisible
}

// 1 / (1 + e^-x). One minus it is sigmoid(-x), to its last digit.
fn sigmoid(x: f32) -> f32 {
    let e = exp(-abs(x));
    return select(e, 1.0, x >= 0.0) / (1.0 + e);
}

// Real spherical harmonics to degree 3 (R7) and their gradients as polynomials in d = (x, y, z).

const SH = array<f32, 10>(
    0.28209479177387814, 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396,
    0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277);

fn harmonics(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    return array<f32, 16>(
        SH[0],
        -SH[1] * y, SH[1] * z, -SH[1] * x,
        SH[2] * x * y, -SH[2] * y * z, SH[3] * (2.0 * zz - xx - yy), -SH[2] * x * z, SH[4] * (xx - yy),
        -SH[5] * y * (3.0 * xx - yy), SH[6] * x * y * z, -SH[7] * y * (4.0 * zz - xx - yy),
        SH[8] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -SH[7] * x * (4.0 * zz - xx - yy),
        SH[9] * z * (xx - yy), -SH[5] * x * (xx - 3.0 * yy));
}

fn harmonics_gradient(d: vec3<f32>) -> array<vec3<f32>, 16> {
    let x = d.x; let y = d.y; let z = d.z;
    let xx = x * x; let yy = y * y; let zz = z * z;
    return array<vec3<f32>, 16>(
        vec3(0.0),
        SH[1] * vec3(0.0, -1.0, 0.0), SH[1] * vec3(0.0, 0.0, 1.0), SH[1] * vec3(-1.0, 0.0, 0.0),
        SH[2] * vec3(y, x, 0.0), SH[2] * vec3(0.0, -z, -y), SH[3] * vec3(-2.0 * x, -2.0 * y, 4.0 * z),
        SH[2] * vec3(-z, 0.0, -x), SH[4] * vec3(2.0 * x, -2.0 * y, 0.0),
        SH[5] * vec3(-6.0 * x * y, 3.0 * (yy - xx), 0.0), SH[6] * vec3(y * z, x * z, x * y),
        SH[7] * vec3(2.0 * x * y, xx + 3.0 * yy - 4.0 * zz, -8.0 * y * z),
        SH[8] * vec3(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy),
        SH[7] * vec3(3.0 * xx + yy - 4.0 * zz, 2.0 * x * y, -8.0 * x * z),
        SH[9] * vec3(2.0 * x * z, -2.0 * y * z, xx - yy), SH[5] * vec3(3.0 * (yy - xx), 6.0 * x * y, 0.0));
}

