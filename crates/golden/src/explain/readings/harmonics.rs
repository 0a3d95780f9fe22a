//! Spherical harmonics of the colours, and their slopes (docs/math.md R7, R19).

/// Real harmonics to degree 3, in the order and with the signs of 3D Gaussian Splatting.
pub(super) fn basis([x, y, z]: [f64; 3]) -> [f64; 16] {
    let pi = std::f64::consts::PI;
    let c = |k: f64, n: f64| (k / (n * pi)).sqrt();
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        c(1.0, 4.0),
        -c(3.0, 4.0) * y,
        c(3.0, 4.0) * z,
        -c(3.0, 4.0) * x,
        c(15.0, 4.0) * x * y,
        -c(15.0, 4.0) * y * z,
        c(5.0, 16.0) * (2.0 * zz - xx - yy),
        -c(15.0, 4.0) * x * z,
        c(15.0, 16.0) * (xx - yy),
        -c(35.0, 32.0) * y * (3.0 * xx - yy),
        c(105.0, 4.0) * x * y * z,
        -c(21.0, 32.0) * y * (4.0 * zz - xx - yy),
        c(7.0, 16.0) * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -c(21.0, 32.0) * x * (4.0 * zz - xx - yy),
        c(105.0, 16.0) * z * (xx - yy),
        -c(35.0, 32.0) * x * (xx - 3.0 * yy),
    ]
}

/// The gradients of `basis`, not yet on the tangent plane.
pub(super) fn slopes([x, y, z]: [f64; 3]) -> [[f64; 3]; 16] {
    let pi = std::f64::consts::PI;
    let c = |k: f64, n: f64, v: [f64; 3]| v.map(|v| (k / (n * pi)).sqrt() * v);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        [0.0; 3],
        c(3.0, 4.0, [0.0, -1.0, 0.0]),
        c(3.0, 4.0, [0.0, 0.0, 1.0]),
        c(3.0, 4.0, [-1.0, 0.0, 0.0]),
        c(15.0, 4.0, [y, x, 0.0]),
        c(15.0, 4.0, [0.0, -z, -y]),
        c(5.0, 16.0, [-2.0 * x, -2.0 * y, 4.0 * z]),
        c(15.0, 4.0, [-z, 0.0, -x]),
        c(15.0, 16.0, [2.0 * x, -2.0 * y, 0.0]),
        c(35.0, 32.0, [-6.0 * x * y, 3.0 * (yy - xx), 0.0]),
        c(105.0, 4.0, [y * z, x * z, x * y]),
        c(
            21.0,
            32.0,
            [2.0 * x * y, xx + 3.0 * yy - 4.0 * zz, -8.0 * y * z],
        ),
        c(
            7.0,
            16.0,
            [-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy],
        ),
        c(
            21.0,
            32.0,
            [3.0 * xx + yy - 4.0 * zz, 2.0 * x * y, -8.0 * x * z],
        ),
        c(105.0, 16.0, [2.0 * x * z, -2.0 * y * z, xx - yy]),
        c(35.0, 32.0, [3.0 * (yy - xx), 6.0 * x * y, 0.0]),
    ]
}
