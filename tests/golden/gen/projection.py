"""Golden cases of what a splat is before it is drawn, with 50 digits: centre, depth, conic, radius and footprint
from docs/math.md R1 to R6, with the covariance formed in the world and inverted as it stands; colour by spherical
harmonics from their definition with Rodrigues' formula, not from tabulated polynomials.

Inputs are rounded to float32, so that a float32 implementation reads the same numbers.

    Needs: numpy (2.4.6), mpmath (1.3.0). Run: python3 projection.py
"""

import mpmath as mp
import numpy as np
from case import write_case

mp.mp.dps = 50
SCRIPT = "gen/projection.py"


def f32(a):
    return np.asarray(a, np.float64).astype(np.float32).astype(np.float64)


def rotation(q):
    """The matrix of conjugation by the unit quaternion: v goes to q v q*."""
    q = [mp.mpf(float(c)) for c in q]
    norm = mp.sqrt(sum(c * c for c in q))
    w, x, y, z = (c / norm for c in q)
    left = mp.matrix([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    right = mp.matrix([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    return (left * right)[1:4, 1:4]


def splat(mean, log_scales, quaternion, q, t, intrinsics, size):
    fx, fy, cx, cy = (mp.mpf(float(k)) for k in intrinsics)
    w = rotation(q)
    p_cam = w * mp.matrix([mp.mpf(float(c)) for c in mean]) + mp.matrix([mp.mpf(float(c)) for c in t])
    x, y, z = p_cam
    assert z > mp.mpf("0.2"), "in front of the near plane"
    limit = [mp.mpf("1.3") * n / (2 * f) for n, f in zip(size, (fx, fy))]
    sx, sy = (max(-l, min(l, s / z)) for l, s in zip(limit, (x, y)))
    j = mp.matrix([[fx / z, 0, -fx * sx / z], [0, fy / z, -fy * sy / z]])
    s = mp.diag([mp.e ** mp.mpf(float(c)) for c in log_scales])
    r = rotation(quaternion)
    world = r * s * s.T * r.T
    cov = j * w * world * w.T * j.T + mp.mpf("0.3") * mp.eye(2)
    a, b, c = cov[0, 0], cov[0, 1], cov[1, 1]
    u, v = fx * x / z + cx, fy * y / z + cy
    mid, det = (a + c) / 2, a * c - b * b
    exact = 3 * mp.sqrt(mid + mp.sqrt(max(mp.mpf("0.1"), mid**2 - det)))
    assert abs(exact - mp.nint(exact)) > 1e-4, "float32 must round the same way"
    radius = int(mp.ceil(exact))
    edges = [int(mp.floor(e / 16)) for e in (u - radius, v - radius, u + radius + 15, v + radius + 15)]
    cells = [max(0, min(e, -(-n // 16))) for e, n in zip(edges, (*size, *size))]
    footprint = [min(16 * e, n) for e, n in zip(cells, (*size, *size))]
    assert footprint[0] < footprint[2] and footprint[1] < footprint[3], "visible"
    clamped = sx != x / z or sy != y / z
    return (u, v), z, (c / det, -b / det, a / det), radius, footprint, clamped, list(p_cam), list(r)


def projection(name, why, means, log_scales, quaternions, q, t, intrinsics, size, flags=()):
    means, log_scales, quaternions = f32(means), f32(log_scales), f32(quaternions)
    found = [splat(*row, q, t, intrinsics, size) for row in zip(means, log_scales, quaternions)]
    floats = lambda k: np.array([[float(v) for v in f[k]] for f in found])
    write_case(
        "projection_covariance", name, basis="mpmath-50", why=why, script=SCRIPT, flags=flags,
        equations=["R1", "R2", "R3", "R4", "R5", "R6"], params={"width": size[0], "height": size[1]},
        inputs={"intrinsics": (np.array(intrinsics, np.float64), "px: fx fy cx cy"),
                "camera_from_world_q": (np.array(q, np.float64), "w x y z"), "camera_from_world_t": (np.array(t, np.float64), "m"),
                "means": (means, "m"), "quaternions": (quaternions, "w x y z"), "log_scales": (log_scales, "ln m")},
        outputs={"p_cam": (floats(6), "m", "projection.p_cam"), "rotation": (floats(7).reshape(-1, 3, 3), "1", "se3.rotation"),
                 "mean_px": (floats(0), "px", "raster.mean_px"), "depth_m": (np.array([float(f[1]) for f in found]), "m", "raster.depth_m"),
                 "conic": (floats(2), "px^-2", "raster.conic"), "radius": (np.array([f[3] for f in found], np.int32), "px", "exact"),
                 "footprint": (np.array([f[4] for f in found], np.int32), "px: x0 y0 x1 y1, ends excluded", "exact")})
    print(f"{name}: {len(found)} splats, {sum(f[5] for f in found)} with a clamped slope, radii {[f[3] for f in found]}")


def projections():
    projection("one", "a tilted Gaussian, by hand", [[0.05, -0.03, 1.5]], np.log([[0.22, 0.09, 0.05]]), [[0.9, 0.2, -0.3, 0.25]],
               (1, 0, 0, 0), (0, 0, 0), (25.0, 27.0, 11.5, 8.5), (24, 18))
    rng = np.random.default_rng(61)
    n, size, k = 24, (96, 72), (80.0, 83.0, 41.3, 38.9)
    depth = rng.uniform(0.5, 4, n)
    pixel = rng.uniform(0, 1, (n, 2)) * size
    cam = np.stack([(pixel[:, 0] - k[2]) / k[0] * depth, (pixel[:, 1] - k[3]) / k[1] * depth, depth], 1)
    cam[:4] = [[2.0, 0.1, 1.0], [-1.9, 0.3, 1.1], [0.1, 1.6, 0.9], [0.2, -1.5, 1.2]]   # beyond the clamp, reaching in
    q, t = np.array([0.45, -0.69, 0.28, 0.49]), np.array([1.0, -2.0, 0.7])
    r = np.array(rotation(q).tolist(), np.float64)
    log_scales = rng.uniform(np.log(0.02), np.log(0.3), (n, 3))
    log_scales[:4] = np.log(0.6)
    log_scales[4:8, 1:] = np.log(5e-4)                                                # needles
    projection("general", "general pose, four slopes beyond the clamp, four needles of 1:600", (cam - t) @ r, log_scales,
               rng.normal(size=(n, 4)), q, t, k, size, flags=["clamp", "needles"])


def legendre(l, m, cosine, sine):
    """Rodrigues: (-1)^m sin^m d^(l+m)/dc^(l+m) (c^2 - 1)^l / (2^l l!), coefficients in whole numbers."""
    power = np.array([1], object)
    for _ in range(l):
        power = np.convolve(power, np.array([1, 0, -1], object))
    for _ in range(l + m):
        power = power[:-1] * np.arange(len(power) - 1, 0, -1).astype(object)
    return (-sine) ** m * mp.polyval([int(c) for c in power], cosine) / (2**l * mp.factorial(l))


def harmonic(l, m, direction):
    """Real, orthonormal, with the Condon-Shortley phase."""
    x, y, z = direction
    r = mp.sqrt(x * x + y * y + z * z)
    phi, k = mp.atan2(y, x), abs(m)
    norm = mp.sqrt((2 * l + 1) / (4 * mp.pi) * mp.factorial(l - k) / mp.factorial(l + k))
    return norm * legendre(l, k, z / r, mp.sqrt(x * x + y * y) / r) * (1 if m == 0 else mp.sqrt(2) * (mp.cos(k * phi) if m > 0 else mp.sin(k * phi)))


def harmonics():
    rng = np.random.default_rng(67)
    directions = np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(14, 3))])
    directions = f32(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    orders = [(l, m) for l in range(4) for m in range(-l, l + 1)]
    sh = f32(rng.normal(0, 0.4, (len(directions), 16, 3)))
    sh[0, 0] = [-3.0, 0.5, -2.5]        # dark: channels clamped at 0
    basis, slope = [], []
    h = mp.mpf(10) ** -20
    for d in directions:
        d = [mp.mpf(float(c)) for c in d]
        d = [c / mp.sqrt(sum(e * e for e in d)) for c in d]
        basis.append([harmonic(l, m, d) for l, m in orders])
        along = lambda axis, sign: [c + sign * h * (i == axis) for i, c in enumerate(d)]
        slope.append([[(harmonic(l, m, along(axis, 1)) - harmonic(l, m, along(axis, -1))) / (2 * h) for axis in range(3)] for l, m in orders])
    color = [[[max(mp.mpf(0), mp.mpf("0.5") + sum(b[k] * mp.mpf(float(c[k, channel])) for k in range((degree + 1) ** 2)))
               for channel in range(3)] for degree in range(4)] for b, c in zip(basis, sh)]
    array = lambda v: np.array([[[float(e) for e in row] for row in rows] for rows in v])
    write_case("sh", "degree_3", basis="mpmath-50", script=SCRIPT, seed=67, equations=["R7", "R19"], flags=["convention"],
               why="both poles, the axes and 14 directions; a flipped sign, a swapped order or a wrong constant shows in one column",
               params={"degree": 3},
               inputs={"direction": (directions, "1"), "sh": (sh, "1")},
               outputs={"basis": (np.array([[float(v) for v in row] for row in basis]), "1", "sh.basis"),
                        "tangent_gradient": (array(slope), "1", "sh.gradient"),
                        "color": (array(color), "1", "sh.color")})


if __name__ == "__main__":
    projections()
    harmonics()
