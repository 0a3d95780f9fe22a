"""Golden cases of the rasterizer's backward pass, without a single derivative written by hand: a dense
renderer (as raster.py, every pixel meets every Gaussian) in complex numbers, and for each parameter one
rendering with an imaginary step,

    dL/dp = Im L(p + i h) / h,    h = 1e-30,

exact to rounding because nothing is subtracted. Every cut looks at real parts. 80-bit floats throughout.

Splats are nudged too (centre, conic, opacity, colour, blended depth), so that a wrong factor is found
where it is. With clamp "pass_through" the clamped alpha keeps the imaginary part it would have had, and
the clamped x = s z in the Jacobian is held fixed: what the CUDA rasterizer of 3DGS differentiates.

    Needs: numpy (2.4.6). Run: python3 raster_backward.py
"""

import numpy as np
from case import write_case
from raster import BLUR_PX2, CELL, CLAMP, LONG, MAX_ALPHA, MIN_ALPHA, MIN_T, NEAR_M, f32, random_scene, rotation, scene, sh_basis

COMPLEX = np.clongdouble
H = LONG(1e-30)


def quaternion_matrix(q):
    """v + 2 w (u x v) + 2 u x (u x v), column by column, for complex q; no conjugates anywhere."""
    norm = np.sqrt((q * q).sum())
    w, u = q[0] / norm, q[1:] / norm
    cross = lambda a, b: np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    return np.stack([v + 2 * w * cross(u, v) + 2 * cross(u, cross(u, v)) for v in np.eye(3, dtype=COMPLEX)], 1)


def nudged(array, name, i, nudge):
    """Row i of a parameter, with the imaginary step where `nudge` = (name, row, column) says so."""
    row = np.array(array, COMPLEX)
    if nudge is not None and nudge[0] == name and nudge[1] == i:
        row.reshape(-1)[nudge[2]] += 1j * H
    return row


def project(s, i, pose, nudge, passing):
    (width, height), (fx, fy, cx, cy) = s["size"], s["intrinsics"]
    w, t = pose
    mean = nudged(s["means"][i], "means", i, nudge)
    p = w @ mean + t
    x, y, z = p
    if z.real <= NEAR_M:
        return None

    def slope(a, n, f):
        """The slope inside the Jacobian."""
        limit = CLAMP * n / (2 * f)
        if abs((a / z).real) <= limit:
            return a / z
        side = LONG(np.copysign(limit, a.real))
        return side * z.real / z if passing else side

    jacobian = np.array([[fx / z, 0, -fx / z * slope(x, width, fx)], [0, fy / z, -fy / z * slope(y, height, fy)]])
    sigma = np.exp(nudged(s["log_scales"][i], "log_scales", i, nudge))
    m = jacobian @ w @ (quaternion_matrix(nudged(s["quaternions"][i], "quaternions", i, nudge)) * sigma)
    cov = m @ m.T + BLUR_PX2 * np.eye(2)
    det = cov[0, 0] * cov[1, 1] - cov[0, 1] ** 2
    mid, u, v = (cov[0, 0] + cov[1, 1]) / 2, fx * x / z + cx, fy * y / z + cy
    radius = np.ceil(3 * np.sqrt(mid.real + np.sqrt(max(LONG(0.1), (mid**2 - det).real))))
    cells = lambda c, n: [min(max(int(np.floor(e / CELL)), 0), -(-n // CELL)) for e in (c - radius, c + radius + CELL - 1)]
    (c0, c1), (r0, r1) = cells(u.real, width), cells(v.real, height)
    if c0 >= c1 or r0 >= r1:
        return None
    offset = mean + w.T @ t
    sh = nudged(s["sh"][i], "sh", i, nudge)
    color = 0.5 + sh_basis(offset / np.sqrt((offset * offset).sum()))[: len(sh)] @ sh
    opacity = 1 / (1 + np.exp(-nudged(s["opacity_logits"][i], "opacity_logits", i, nudge)))
    return {
        "cells": (c0, c1, r0, r1), "order": (z.real, i), "index": i,
        "mean_px": nudged([u, v], "means2d", i, nudge),
        "conic": nudged(np.array([cov[1, 1], -cov[0, 1], cov[0, 0]]) / det, "conics", i, nudge),
        "opacity": nudged(opacity, "opacities", i, nudge),
        "color": nudged(np.where(color.real > 0, color, 0), "colors", i, nudge),
        "depth_m": nudged(z, "depths", i, nudge),
    }


def loss(s, upstream, nudge, passing):
    (width, height), w = s["size"], rotation(s["q"]).astype(COMPLEX)
    t = np.array(s["t"], COMPLEX)
    step = nudged(np.zeros(6), "pose", 0, nudge)
    a, b, c = step[3:]
    turn = np.eye(3) + np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    pose = (turn @ w, turn @ t + step[:3])
    splats = [q for q in (project(s, i, pose, nudge, passing) for i in range(len(s["means"]))) if q]
    splats.sort(key=lambda q: q["order"])
    y, x = np.mgrid[0:height, 0:width]
    color, depth = np.zeros((height, width, 3), COMPLEX), np.zeros((height, width), COMPLEX)
    left, open_ = np.ones((height, width), COMPLEX), np.ones((height, width), bool)
    flags = {"saturated": 0, "closed": 0, "seen": [q["index"] for q in splats]}
    for q in splats:
        c0, c1, r0, r1 = q["cells"]
        inside = (x >= CELL * c0) & (x < CELL * c1) & (y >= CELL * r0) & (y < CELL * r1)
        (a, b, c), dx, dy = q["conic"], x - q["mean_px"][0], y - q["mean_px"][1]
        alpha = q["opacity"] * np.exp(-(a * dx**2 + 2 * b * dx * dy + c * dy**2) / 2)
        over = alpha.real > MAX_ALPHA
        alpha = np.where(over, MAX_ALPHA + (1j * alpha.imag if passing else 0), alpha)
        thick = inside & open_ & (alpha.real >= MIN_ALPHA)
        behind = left * (1 - alpha)
        open_ &= ~(thick & (behind.real < MIN_T))
        drawn = thick & open_
        weight = np.where(drawn, alpha * left, 0)
        color, depth = color + weight[..., None] * q["color"], depth + weight * q["depth_m"]
        left = np.where(drawn, behind, left)
        flags["saturated"] += int((drawn & over).sum())
    flags["closed"] = int((~open_).sum())
    color = color + left[..., None] * s["background"]
    d_color, d_depth, d_opacity = upstream
    return (d_color * color).sum() + (d_depth * depth).sum() + (d_opacity * (1 - left)).sum(), flags


# Name, columns, unit; sh is set per scene.
TENSORS = [
    ("means", 3, "m^-1"), ("log_scales", 3, "1"), ("quaternions", 4, "1"), ("opacity_logits", 1, "1"), ("sh", None, "1"),
    ("means2d", 2, "px^-1"), ("conics", 3, "px^2"), ("opacities", 1, "1"), ("colors", 3, "1"), ("depths", 1, "m^-1"),
]


def write(name, why, s, seed, clamp="true", flags=()):
    rng = np.random.default_rng(seed)
    n, (width, height), passing = len(s["means"]), s["size"], clamp == "pass_through"
    upstream = [f32(rng.normal(size=(height, width, 3))), f32(0.3 * rng.normal(size=(height, width))), f32(rng.normal(size=(height, width)))]
    found = loss(s, upstream, None, passing)[1]
    slope = lambda nudge: float(loss(s, upstream, nudge, passing)[0].imag / H)
    triples = s["sh"].shape[1]
    outputs = {"d_pose": (np.array([slope(("pose", 0, k)) for k in range(6)]), "m^-1, rad^-1", "raster_backward.gradient")}
    for tensor, columns, unit in TENSORS:
        columns = 3 * triples if tensor == "sh" else columns
        rows = [[slope((tensor, i, k)) if i in found["seen"] else 0.0 for k in range(columns)] for i in range(n)]
        outputs["d_" + tensor] = (np.array(rows).reshape((n, triples, 3) if tensor == "sh" else (n, columns) if columns > 1 else n), unit, "raster_backward.gradient")
    write_case(
        "raster_backward", name, basis="complex-step", why=why, script="gen/raster_backward.py", seed=seed, flags=flags,
        equations=["paper:15"],
        params={"width": width, "height": height, "sh_degree": int(round(np.sqrt(triples))) - 1, "clamp_gradient": clamp},
        inputs={
            "intrinsics": (np.array(s["intrinsics"], np.float64), "px: fx fy cx cy"),
            "camera_from_world_q": (s["q"], "w x y z"), "camera_from_world_t": (s["t"], "m"),
            "background": (s["background"], "1"), "means": (s["means"], "m"), "quaternions": (s["quaternions"], "w x y z"),
            "log_scales": (s["log_scales"], "ln m"), "opacity_logits": (s["opacity_logits"], "1"), "sh": (s["sh"], "1"),
            "upstream_color": (upstream[0], "1"), "upstream_depth": (upstream[1], "m^-1"), "upstream_opacity": (upstream[2], "1"),
        },
        outputs=outputs,
    )
    print(f"{name}: {len(found['seen'])} of {n} visible, {found['saturated']} saturated alphas, {found['closed']} pixels closed")


def one():
    s = scene((24, 18), (25.0, 27.0, 10.5, 9.5), [[0.05, -0.03, 1.5]], [[0.9, 0.2, -0.3, 0.25]], [[0.22, 0.09, 0.05]],
              [0.77], [[[0.7, -0.4, 0.2]]], background=(0.1, 0.2, 0.3))
    write("one", "a single tilted Gaussian: the smallest picture that shows a wrong factor", s, 5)


def clamps(clamp):
    means = [
        [0.10, 0.05, -1.0], [0.0, 0.0, 0.15],                        # behind; before the near plane
        [2.40, 0.20, 1.00], [-0.30, -1.90, 1.10],                    # beyond the Jacobian's clamp, reaching in
        [0.10, 0.10, 1.50], [0.12, 0.09, 1.60], [0.11, 0.12, 1.70],  # opaque, one behind the other: alpha 0.99, T < 1e-4
        [0.10, 0.11, 2.50],                                          # behind all of them
        [-0.40, 0.20, 2.00],                                         # dark: channels clamped at 0
    ]
    n = len(means)
    sigmas = np.tile([0.14, 0.11, 0.09], (n, 1))
    sigmas[2:4] = [0.9, 0.7, 0.5]
    sigmas[4:7] = [0.25, 0.2, 0.22]
    opacities = np.full(n, 0.8)
    opacities[4:7] = [0.999, 0.998, 0.997]
    sh = np.random.default_rng(2).normal(0.5, 0.2, (n, 4, 3))
    sh[8, 0] = [-3.0, 0.2, -2.5]
    quaternions = np.tile([0.8, 0.1, -0.3, 0.5], (n, 1))
    s = scene((40, 33), (40.0, 38.0, 15.3, 18.8), means, quaternions, sigmas, opacities, sh, background=(0.9, 0.5, 0.1))
    write(f"clamps_{clamp}", "saturated alpha, clamped Jacobian, clamped colour, closed pixels, behind, near plane", s, 7, clamp,
          flags=["on-threshold"])


def empty():
    """Shapes are all there is to get wrong: a row per Gaussian, of which there is none."""
    none = lambda *shape: np.zeros((0, *shape))
    s = scene((12, 9), (10.0, 11.0, 5.5, 4.0), none(3), none(4), none(3), none(), none(1, 3), background=(0.1, 0.2, 0.3))
    write("empty", "no Gaussian at all: gradients without rows, no pull on the pose", s, 3, flags=["empty"])


def main():
    one()
    empty()
    clamps("true")
    clamps("pass_through")
    q, t = (0.45, -0.69, 0.28, 0.49), (1.0, -2.0, 0.7)
    s = random_scene(31, 14, (37, 29), (42.0, 44.0, 14.6, 17.1), 3, 6.0, 0.05, q, t)
    write("sh3_14", "14 Gaussians of degree 3 under a general pose, principal point off the middle", s, 31)


if __name__ == "__main__":
    main()
