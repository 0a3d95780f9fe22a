"""Golden cases of the rasterizer's forward pass, by a dense renderer: every pixel meets every Gaussian
in order of depth. No tiles, no lists, no early way out; formulas as 3D Gaussian Splatting states them
(covariance in the world, Jacobian, conic by the plain determinant), in 80-bit floats from the
covariance on, so that needles lose nothing either. Numbers follow docs/math.md R1 to R11.

Inputs are rounded to float32, so that a float32 implementation reads the same scene.

    Needs: numpy (2.4.6). Run: python3 raster.py
"""

import numpy as np
from case import write_case

LONG = np.longdouble
NEAR_M, BLUR_PX2, CLAMP, CELL = 0.2, 0.3, 1.3, 16
MIN_ALPHA, MAX_ALPHA, MIN_T = 1 / 255, 0.99, 1e-4


def rotation(q):
    """Rotation matrix of (w, x, y, z): v + 2 w (u x v) + 2 u x (u x v), column by column."""
    q = np.asarray(q, LONG)
    w, u = q[0] / np.sqrt(q @ q), q[1:] / np.sqrt(q @ q)
    return np.stack([v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v)) for v in np.eye(3, dtype=LONG)], 1)


def sh_basis(d):
    """Real spherical harmonics to degree 3 in the order and with the signs of 3D Gaussian Splatting."""
    x, y, z = d
    pi = np.pi
    c = lambda k, n: np.sqrt(k / (n * pi))
    return np.array([
        c(1, 4),
        -c(3, 4) * y, c(3, 4) * z, -c(3, 4) * x,
        c(15, 4) * x * y, -c(15, 4) * y * z, c(5, 16) * (3 * z * z - 1), -c(15, 4) * x * z, c(15, 16) * (x * x - y * y),
        -c(35, 32) * y * (3 * x * x - y * y), c(105, 4) * x * y * z, -c(21, 32) * y * (5 * z * z - 1),
        c(7, 16) * z * (5 * z * z - 3), -c(21, 32) * x * (5 * z * z - 1), c(105, 16) * z * (x * x - y * y),
        -c(35, 32) * x * (x * x - 3 * y * y),
    ])


def project(scene, i):
    """One Gaussian's splat, or None if it is invisible."""
    (width, height), (fx, fy, cx, cy) = scene["size"], scene["intrinsics"]
    world_to_cam, t = rotation(scene["q"]), np.asarray(scene["t"], LONG)
    p = world_to_cam @ scene["means"][i].astype(LONG) + t
    x, y, z = p
    if z <= NEAR_M:
        return None
    u, v = fx * x / z + cx, fy * y / z + cy
    clamp = lambda s, n, f: np.clip(s, -CLAMP * n / (2 * f), CLAMP * n / (2 * f))
    tx, ty = clamp(x / z, width, fx) * z, clamp(y / z, height, fy) * z
    jacobian = np.array([[fx / z, 0, -fx * tx / z**2], [0, fy / z, -fy * ty / z**2]], LONG)
    own = rotation(scene["quaternions"][i]) * np.exp(scene["log_scales"][i].astype(LONG))
    cov = jacobian @ world_to_cam @ own @ own.T @ world_to_cam.T @ jacobian.T + BLUR_PX2 * np.eye(2)
    det = cov[0, 0] * cov[1, 1] - cov[0, 1] ** 2
    mid = (cov[0, 0] + cov[1, 1]) / 2
    radius = np.ceil(3 * np.sqrt(mid + np.sqrt(max(LONG(0.1), mid**2 - det))))
    cells = lambda m, n: [min(max(int(np.floor(e / CELL)), 0), -(-n // CELL)) for e in (m - radius, m + radius + CELL - 1)]
    (c0, c1), (r0, r1) = cells(u, width), cells(v, height)
    if c0 >= c1 or r0 >= r1:
        return None
    direction = scene["means"][i] + world_to_cam.T @ t
    direction = (direction / np.sqrt(direction @ direction)).astype(np.float64)
    sh = scene["sh"][i]
    return {
        "index": i, "mean_px": np.array([u, v]), "depth_m": z, "radius": int(radius), "cells": (c0, c1, r0, r1),
        "conic": np.array([cov[1, 1], -cov[0, 1], cov[0, 0]]) / det,
        "opacity": 1 / (1 + np.exp(-LONG(scene["opacity_logits"][i]))),
        "color": np.maximum(0.5 + sh_basis(direction)[: len(sh)] @ sh, 0),
    }


def render(scene):
    width, height = scene["size"]
    splats = [s for s in (project(scene, i) for i in range(len(scene["means"]))) if s]
    splats.sort(key=lambda s: (s["depth_m"], s["index"]))
    y, x = np.mgrid[0:height, 0:width]
    color, depth, left = np.zeros((height, width, 3), LONG), np.zeros((height, width), LONG), np.ones((height, width), LONG)
    count, rank, last = (np.zeros((height, width), np.int32) for _ in range(3))
    open_, robust = (np.ones((height, width), bool) for _ in range(2))
    for s in splats:
        c0, c1, r0, r1 = s["cells"]
        inside = (x >= CELL * c0) & (x < CELL * c1) & (y >= CELL * r0) & (y < CELL * r1)
        rank += inside
        (a, b, c), dx, dy = s["conic"], x - s["mean_px"][0], y - s["mean_px"][1]
        alpha = np.minimum(MAX_ALPHA, s["opacity"] * np.exp(-(a * dx**2 + 2 * b * dx * dy + c * dy**2) / 2))
        thick = inside & open_ & (alpha >= MIN_ALPHA)
        behind = left * (1 - alpha)
        # Away from each cut by a thousandth: float32 decides the same way there.
        robust &= ~(inside & open_ & (abs(alpha / MIN_ALPHA - 1) < 1e-3))
        robust &= ~(thick & (abs(behind / MIN_T - 1) < 1e-3))
        open_ &= ~(thick & (behind < MIN_T))
        drawn = thick & open_
        weight = np.where(drawn, alpha * left, 0)
        color += weight[..., None] * s["color"]
        depth += weight * s["depth_m"]
        left = np.where(drawn, behind, left)
        count += drawn
        last = np.where(drawn, rank, last)
    radii = np.zeros(len(scene["means"]), np.int32)
    for s in splats:
        radii[s["index"]] = s["radius"]
    column = lambda name: np.array([s[name] for s in splats])
    f64 = lambda a: np.asarray(a, np.float64)
    outputs = {
        "color": (f64(color + left[..., None] * scene["background"]), "1", "raster.color"),
        "depth": (f64(depth), "m", "raster.depth"),
        "transmittance": (f64(left), "1", "raster.transmittance"),
        "contributors": (count, "1", "exact"),
        "last": (last, "1", "exact"),
        "radii": (radii, "px", "exact"),
        "order": (column("index").astype(np.int32), "1", "exact"),
        "mean_px": (f64(column("mean_px")), "px", "raster.mean_px"),
        "depth_m": (f64(column("depth_m")), "m", "raster.depth_m"),
        "conic": (f64(column("conic")), "px^-2", "raster.conic"),
        "splat_color": (f64(column("color")), "1", "raster.color"),
    }
    return outputs, robust


def f32(a):
    return np.asarray(a, np.float64).astype(np.float32).astype(np.float64)


def scene(size, intrinsics, means, quaternions, sigmas, opacities, sh, q=(1, 0, 0, 0), t=(0, 0, 0), background=(0, 0, 0)):
    opacities = np.asarray(opacities, np.float64)
    return {
        "size": size, "intrinsics": intrinsics, "q": np.array(q, np.float64), "t": np.array(t, np.float64),
        "background": np.array(background, np.float64), "means": f32(means), "quaternions": f32(quaternions),
        "log_scales": f32(np.log(sigmas)), "opacity_logits": f32(np.log(opacities / (1 - opacities))), "sh": f32(sh),
    }


def write(name, why, s, flags=(), seed=None):
    outputs, robust = render(s)
    n = len(s["means"])
    write_case(
        "raster", name, basis="numpy-f64", why=why, script="gen/raster.py", seed=seed, flags=flags,
        equations=["paper:15"], params={"width": s["size"][0], "height": s["size"][1],
                                        "sh_degree": int(round(np.sqrt(s["sh"].shape[1]))) - 1},
        inputs={
            "intrinsics": (np.array(s["intrinsics"], np.float64), "px: fx fy cx cy"),
            "camera_from_world_q": (s["q"], "w x y z"), "camera_from_world_t": (s["t"], "m"),
            "background": (s["background"], "1"), "means": (s["means"], "m"), "quaternions": (s["quaternions"], "w x y z"),
            "log_scales": (s["log_scales"], "ln m"), "opacity_logits": (s["opacity_logits"], "1"),
            "sh": (s["sh"].reshape(n, -1, 3), "1"), "robust": (robust, "away from every cut by 1e-3"),
        },
        outputs=outputs,
    )
    drawn = outputs["contributors"][0]
    print(f"{name}: {len(outputs['order'][0])} of {n} visible, {drawn.max()} deep, {robust.mean():.4f} robust")


def one():
    s = scene((24, 18), (25.0, 27.0, 11.5, 8.5), [[0.05, -0.03, 1.5]], [[0.9, 0.2, -0.3, 0.25]], [[0.22, 0.09, 0.05]],
              [0.77], [[[0.7, -0.4, 0.2]]], background=(0.1, 0.2, 0.3))
    write("one", "a single tilted Gaussian: the smallest picture that shows a wrong convention", s)


def cuts():
    """Identity pose, so that z is exactly what is written here."""
    means = [
        [0.00, 0.00, 0.1998], [0.00, 0.00, 0.2002],                    # either side of the near plane
        [0.30, 0.10, -1.00], [0.10, 0.10, 0.000],                      # behind; in the camera's centre
        [2.60, 0.20, 1.00], [-0.20, -2.20, 1.00],                      # beyond the Jacobian's clamp, reaching in
        [60.0, 0.00, 1.00],                                            # far outside
        [0.20, 0.10, 2.00], [0.20, 0.10, 2.10], [0.20, 0.10, 2.20],    # opaque, one behind the other: T < 1e-4
        [-0.40, 0.20, 2.50], [-0.40, 0.21, 2.50],                      # equal depth: order of rows
        [-0.30, -0.30, 2.00],                                          # thinner than 1/255 everywhere
    ]
    n = len(means)
    sigmas = np.full((n, 3), 0.12)
    sigmas[0:2] = 0.004
    sigmas[4:6] = [0.9, 0.7, 0.5]
    sigmas[7:10] = 0.25
    opacities = np.full(n, 0.8)
    opacities[7:10] = 0.999
    opacities[10:12] = [0.9, 0.6]
    opacities[12] = 0.0038
    colors = np.linspace(-1.2, 1.4, 3 * n).reshape(n, 1, 3)
    quaternions = np.tile([0.8, 0.1, -0.3, 0.5], (n, 1))
    s = scene((49, 37), (40.0, 38.0, 17.3, 22.8), means, quaternions, sigmas, opacities, colors, background=(0.9, 0.5, 0.1))
    write("cuts", "near plane, behind, outside, clamped Jacobian, alpha 0.99, T < 1e-4, ties, off-centre principal point",
          s, flags=["on-threshold"])


def random_scene(seed, n, size, intrinsics, degree, aspect, sigma_m, q, t):
    rng = np.random.default_rng(seed)
    r, centre = rotation(q).astype(np.float64), np.asarray(t, np.float64)
    depth = rng.uniform(0.8, 4.0, n)
    pixel = rng.uniform(-0.15, 1.15, (n, 2)) * size
    p_cam = np.stack([(pixel[:, 0] - intrinsics[2]) / intrinsics[0] * depth,
                      (pixel[:, 1] - intrinsics[3]) / intrinsics[1] * depth, depth], 1)
    means = (p_cam - centre) @ r
    sigmas = np.exp(rng.uniform(np.log(sigma_m), np.log(sigma_m * aspect), (n, 3)))
    sh = rng.normal(0, 0.25, (n, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.normal(0.4, 0.9, (n, 3))
    return scene(size, intrinsics, means, rng.normal(size=(n, 4)), sigmas, rng.uniform(0.05, 0.98, n), sh, q, t, (0.1, 0.2, 0.3))


def main():
    one()
    cuts()
    q, t = (0.45, -0.69, 0.28, 0.49), (1.0, -2.0, 0.7)
    write("sh3_80", "80 Gaussians of degree 3 under a general pose; the size a port debugs with",
          random_scene(17, 80, (61, 45), (66.0, 68.0, 27.4, 25.1), 3, 6.0, 0.03, q, t), seed=17)
    needles = random_scene(23, 12, (64, 48), (70.0, 70.0, 31.5, 23.5), 1, 1.0, 0.5, (1, 0.1, -0.2, 0.3), (0.1, 0.0, 0.2))
    needles["log_scales"][:, 1:] = f32(np.log(5e-4))
    write("needles", "half-axes of 0.5 m and 0.5 mm: where a plain determinant loses its digits in float32", needles,
          flags=["needles"], seed=23)


if __name__ == "__main__":
    main()
