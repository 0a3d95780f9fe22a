"""Optima of a bundle: poses and points together, Huber's kernel on each block.

As pose_lm.py: scipy first, then Gauss-Newton with 40 digits and numerical derivatives until the
step is below 1e-20. Each observation depends on one pose and one point, so nine differences give its Jacobian.

    Needs: numpy 2.4.6, scipy 1.17.1, mpmath 1.3.0.
"""

import mpmath as mp
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from case import write_case
from pose_lm import CHI2_2D, CHI2_3D, K, deltas2, exp_so3, huber

BF = 40.0
as_mp = np.vectorize(lambda v: mp.mpf(float(v)), otypes=[object])


def scene(seed, poses, points, depth_share, outliers):
    """Cameras on an arc, points before them, pixels with noise, and disturbed estimates of both."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(-0.25, 0.25, poses)
    rotations = Rotation.from_rotvec(np.stack([0 * angles, angles, 0.1 * angles], 1)).as_matrix()
    t = np.stack([-1.5 * angles, 0.2 * np.sin(7 * angles), 0.3 * angles**2], 1)
    world = np.stack([rng.uniform(-1.2, 1.2, points), rng.uniform(-0.9, 0.9, points), rng.uniform(2, 5, points)], 1)
    rows = []
    for k in range(poses):
        for i in range(points):
            x, y, z = rotations[k] @ world[i] + t[k]
            uv = np.array([K[0] * x / z + K[2], K[1] * y / z + K[3]])
            if not (0 <= uv[0] < 640 and 0 <= uv[1] < 480) or rng.random() < 0.2:
                continue
            sigma = round(1.2 ** rng.integers(0, 5), 6)
            uv += sigma * rng.standard_normal(2)
            right = (np.nan, np.nan)
            if rng.random() < depth_share:
                right = (uv[0] - BF / z + 1.5 * sigma * rng.standard_normal(), 1.5 * sigma)
            if rng.random() < outliers:
                uv += rng.uniform(-60, 60, 2)
            rows.append((k, i, *uv, sigma, *right))
    rows = [r for r in rows if sum(q[1] == r[1] for q in rows) >= 3]
    kept = {i: n for n, i in enumerate(sorted({r[1] for r in rows}))}
    table = np.array([(r[0], kept[r[1]], *r[2:]) for r in rows])
    fixed = np.arange(poses) < (2 if depth_share == 0 else 1)
    noise = 0.02 * rng.standard_normal((poses, 6)) * ~fixed[:, None]
    turns = Rotation.from_rotvec(noise[:, 3:]).as_matrix()
    return dict(
        rotation=turns @ rotations, t=t + noise[:, :3],
        points=(world[list(kept)] + 0.04 * rng.standard_normal((len(kept), 3))).round(4), fixed=fixed,
        observed=table[:, :2].astype(np.int32), uv=table[:, 2:4].round(3), sigma=table[:, 4], right=table[:, 5:7].round(4),
    )


# The third residual: ORB-SLAM's virtual right column, or the disparity alone.
DISPARITY = False


def blocks(data, rotation, t, points, k=K, bf=BF):
    """Whitened rows [M, 3] from poses and points given per observation; the third is 0 without depth."""
    p = (rotation * points[:, None, :]).sum(2) + t
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    has = ~np.isnan(data["right"][:, 0].astype(float))
    u = k[0] * x / z + k[2]
    right = np.where(has[:, None], data["right"], 1)
    rows = [(u - data["uv"][:, 0]) / data["sigma"], (k[1] * y / z + k[3] - data["uv"][:, 1]) / data["sigma"],
            np.where(has, ((0 if DISPARITY else u) - bf / z - (-right[:, 0] if DISPARITY else right[:, 0])) / right[:, 1], 0)]
    return np.stack(rows, 1), has


def solve_scipy(data):
    free = np.flatnonzero(~data["fixed"])
    n = len(free)
    pose_of, point_of = data["observed"].T

    def unpack(x):
        rotation, t = data["rotation"].copy(), data["t"].copy()
        step = x[: 6 * n].reshape(n, 6)
        turns = Rotation.from_rotvec(step[:, 3:]).as_matrix()
        rotation[free] = turns @ rotation[free]
        t[free] = np.einsum("kij,kj->ki", turns, t[free]) + step[:, :3]
        return rotation, t, data["points"] + x[6 * n:].reshape(-1, 3)

    def residuals(x):
        rotation, t, points = unpack(x)
        r, has = blocks(data, rotation[pose_of], t[pose_of], points[point_of])
        s, d2 = (r * r).sum(1), deltas2(has)
        rho = np.where(s <= d2, s, 2 * np.sqrt(d2 * s) - d2)
        return (r * np.sqrt(rho / np.maximum(s, 1e-300))[:, None]).ravel()

    found = least_squares(residuals, np.zeros(6 * n + data["points"].size), xtol=1e-15, ftol=1e-15, gtol=1e-15,
                          jac="3-point", x_scale="jac", max_nfev=300)
    return unpack(found.x)


def polish(data, start):
    exact = dict(data, uv=as_mp(data["uv"]), sigma=as_mp(data["sigma"]), right=as_mp(data["right"]))
    k_mp, bf_mp, h = [mp.mpf(v) for v in K], mp.mpf(BF), mp.mpf(10) ** -15
    rotation, t, points = (as_mp(v) for v in start)
    for i in range(len(rotation)):
        for _ in range(3):  # orthonormal to 40 digits
            rotation[i] = rotation[i].dot(3 * np.eye(3, dtype=int) - rotation[i].T.dot(rotation[i])) / 2
    # The fixed poses are those of the input, to the last digit.
    fixed = data["fixed"]
    rotation[fixed], t[fixed] = as_mp(data["rotation"][fixed]), as_mp(data["t"][fixed])
    free = {k: n for n, k in enumerate(np.flatnonzero(~fixed))}
    pose_of, point_of = data["observed"].T
    size = 6 * len(free) + 3 * len(points)
    axes = np.eye(6, dtype=int).astype(object) * h
    for iteration in range(300):
        evaluate = lambda r, v, p: blocks(exact, r, v, p, k_mp, bf_mp)[0]
        r0, v0, p0 = rotation[pose_of], t[pose_of], points[point_of]
        r, has = blocks(exact, r0, v0, p0, k_mp, bf_mp)
        columns = []
        for i in range(9):
            ends = []
            for sign in (1, -1):
                if i < 6:
                    turn = exp_so3(list(sign * axes[i][3:]))
                    turned = np.stack([turn.dot(m) for m in r0])
                    ends.append(evaluate(turned, v0.dot(turn.T) + sign * axes[i][:3], p0))
                else:
                    ends.append(evaluate(r0, v0, p0 + sign * axes[i - 6][:3]))
            columns.append((ends[0] - ends[1]) / (2 * h))
        j = np.stack(columns, 2)
        s = (r * r).sum(1)
        d2 = [mp.mpf(float(v)) for v in deltas2(has)]
        weight = np.array([1 if si <= d else mp.sqrt(d / si) for si, d in zip(s, d2)], dtype=object)
        gradient = np.zeros(size, dtype=object)
        hessian = np.zeros((size, size))
        for m in range(len(s)):
            index = np.concatenate([
                np.arange(6) + 6 * free[pose_of[m]] if pose_of[m] in free else np.full(6, -1),
                6 * len(free) + 3 * point_of[m] + np.arange(3)])
            keep = index >= 0
            jm = j[m][:, keep]
            gradient[index[keep]] += weight[m] * jm.T.dot(r[m])
            jf = jm.astype(float)
            hessian[np.ix_(index[keep], index[keep])] += float(weight[m]) * jf.T @ jf
        xi = -np.linalg.inv(hessian).astype(object).dot(gradient)
        for k, n in free.items():
            turn = exp_so3(list(xi[6 * n + 3: 6 * n + 6]))
            rotation[k], t[k] = turn.dot(rotation[k]), turn.dot(t[k]) + xi[6 * n: 6 * n + 3]
        points = points + xi[6 * len(free):].reshape(-1, 3)
        if max(abs(v) for v in xi) < mp.mpf(10) ** -18:
            cost = sum(huber(si, d) for si, d in zip(s, d2)) / 2
            return rotation.astype(float), t.astype(float), points.astype(float), float(cost)
    raise RuntimeError("no convergence")


def write(name, why, **kwargs):
    data = scene(**kwargs)
    start = solve_scipy(data)
    rotation, t, points, cost = polish(data, start)
    gap = max(abs(a - b).max() for a, b in zip(start, (rotation, t, points)))
    assert gap < 1e-5, gap
    pose_of, point_of = data["observed"].T
    r, has = blocks(data, data["rotation"][pose_of], data["t"][pose_of], data["points"][point_of])
    s, d2 = (r * r).sum(1), deltas2(has)
    cost0 = 0.5 * np.where(s <= d2, s, 2 * np.sqrt(d2 * s) - d2).sum()
    print(f"{name}: {len(s)} observations, {len(points)} points, cost {cost0:.3f} -> {cost:.6f}; scipy off by {gap:.1e}")
    write_case(
        "bundle", name, basis="scipy + mpmath-40", why=why, script="gen/bundle.py", seed=kwargs["seed"],
        equations=["paper:11", "E12", "E13"],
        params={"fx": K[0], "fy": K[1], "cx": K[2], "cy": K[3], "bf": BF, "chi2_2d": CHI2_2D, "chi2_3d": CHI2_3D},
        inputs={"rotation_initial": (data["rotation"], "1"), "translation_initial": (data["t"], "m"),
                "fixed": (data["fixed"], "1"), "points_initial": (data["points"], "m"),
                "observed": (data["observed"], "1"), "uv": (data["uv"], "px"), "sigma": (data["sigma"], "px"),
                "right": (data["right"], "px")},
        outputs={"cost_initial": (cost0, "1", "pose.cost_initial"), "cost": (cost, "1", "bundle.cost"),
                 "rotation": (rotation, "1", "pose.pose"), "translation": (t, "m", "pose.pose"),
                 "points": (points, "m", "bundle.points")},
    )


if __name__ == "__main__":
    with np.errstate(invalid="ignore"):
        write("mono", "no depth: two fixed poses hold the scale", seed=1, poses=5, points=16, depth_share=0, outliers=0.05)
        write("depth", "depth readings hold the scale with one fixed pose", seed=2, poses=5, points=24, depth_share=0.7, outliers=0.05)
