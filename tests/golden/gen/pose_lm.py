"""Optima of eq. 11 with Huber's kernel on each block.

The optimum is found twice: scipy's least_squares over (rotation vector, translation), with every
block scaled by sqrt(rho(s)/s) so that its sum of squares is the robust cost; then a
Gauss-Newton iteration in mpmath with 40 digits and numerical derivatives (step 1e-15), until the
step is below 1e-20. Nothing here knows a closed-form Jacobian. The two must agree to 1e-6.

    Needs: numpy 2.4.6, scipy 1.17.1, mpmath 1.3.0.
"""

import mpmath as mp
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from case import write_case

mp.mp.dps = 40
K = (535.4, 539.2, 320.1, 247.6)
CHI2_2D, CHI2_3D = 5.991, 7.815


def scene(seed, n, depth_share, outliers, noise=1.0, turn=0.05):
    """Points in front of a camera, as it sees them with noise, and a pose to start from."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix()
    t = np.array([0.2, -0.1, 0.3])
    z = rng.uniform(0.8, 6.0, n)
    uv = np.stack([rng.uniform(20, 620, n), rng.uniform(20, 460, n)], 1)
    p_cam = np.stack([(uv[:, 0] - K[2]) / K[0] * z, (uv[:, 1] - K[3]) / K[1] * z, z], 1)
    p_world = (p_cam - t) @ rotation
    sigma = 1.2 ** rng.integers(0, 8, n)
    uv = uv + noise * sigma[:, None] * rng.standard_normal((n, 2))
    right = np.full((n, 2), np.nan)
    has_depth = rng.random(n) < depth_share
    sigma_right = np.hypot(sigma, 40.0 * 0.0125)
    right[has_depth, 1] = sigma_right[has_depth]
    right[has_depth, 0] = (uv[:, 0] - 40.0 / z + noise * sigma_right * rng.standard_normal(n))[has_depth]
    wrong = rng.random(n) < outliers
    shift = rng.uniform(-80, 80, (n, 2))
    uv[wrong] += shift[wrong]
    right[wrong, 0] += shift[wrong, 0]
    delta = Rotation.from_rotvec(turn * rng.standard_normal(3)).as_matrix()
    initial = (delta @ rotation, delta @ t + 0.05 * rng.standard_normal(3))
    # Kept to a few digits, so that a reader sees them; the optimum is that of the numbers kept.
    return dict(p_world=p_world.round(4), uv=uv.round(3), sigma=sigma.round(6), right=right.round(4)), initial


# The third residual: ORB-SLAM's virtual right column, or the disparity alone.
DISPARITY = False


def residual_blocks(data, rotation, t, bf, exp=None):
    """Whitened rows [N, 3]; the third is 0 where there is no depth. Works on floats and on mpf."""
    p = data["p_world"] @ np.asarray(rotation).T + np.asarray(t)
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    has = ~np.isnan(data["right"][:, 0].astype(float))
    u_right, s_right = np.where(has, data["right"][:, 0], 0), np.where(has, data["right"][:, 1], 1)
    u = K[0] * x / z + K[2]
    rows = [(u - data["uv"][:, 0]) / data["sigma"], (K[1] * y / z + K[3] - data["uv"][:, 1]) / data["sigma"],
            np.where(has, ((0 if DISPARITY else u) - bf / z - (-u_right if DISPARITY else u_right)) / s_right, 0)]
    return np.stack(rows, 1), has


def huber(s, delta2):
    return s if s <= delta2 else 2 * mp.sqrt(delta2 * s) - delta2


def deltas2(has):
    return np.where(has, CHI2_3D, CHI2_2D)


def prior_residual(prior, rotation, t):
    """L^T (c - c0), with its norm bent by Huber's kernel at 3."""
    centre, root = prior
    r = root.T @ (-rotation.T @ t - centre)
    s = r @ r
    rho = s if s <= 9 else 6 * np.sqrt(s) - 9
    return r * np.sqrt(rho / max(s, 1e-300))


def solve_scipy(data, initial, bf, robust, prior=None):
    start = Rotation.from_matrix(initial[0]).as_rotvec()

    def residuals(x):
        r, has = residual_blocks(data, Rotation.from_rotvec(x[:3]).as_matrix(), x[3:], bf)
        s = (r * r).sum(1)
        d2 = deltas2(has)
        rho = np.where(s <= d2, s, 2 * np.sqrt(d2 * s) - d2) if robust else s
        rows = (r * np.sqrt(rho / np.maximum(s, 1e-300))[:, None]).ravel()
        if prior is None:
            return rows
        return np.concatenate([rows, prior_residual(prior, Rotation.from_rotvec(x[:3]).as_matrix(), x[3:])])

    found = least_squares(residuals, np.concatenate([start, initial[1]]), xtol=1e-15, ftol=1e-15, gtol=1e-15,
                          x_scale="jac", max_nfev=2000)
    return Rotation.from_rotvec(found.x[:3]).as_matrix(), found.x[3:]


def exp_so3(w):
    theta = mp.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]], dtype=object)
    a = mp.sin(theta) / theta if theta else mp.mpf(1)
    b = (1 - mp.cos(theta)) / theta ** 2 if theta else mp.mpf(1) / 2
    return np.eye(3, dtype=int).astype(object) + a * k + b * k.dot(k)


def polish(data, pose, bf, robust):
    """Gauss-Newton with 40 digits: exact gradient, approximate matrix, so its fixed point is the optimum."""
    exact = {k: np.vectorize(lambda v: mp.mpf(float(v)), otypes=[object])(a) for k, a in data.items()}
    rotation = np.vectorize(mp.mpf, otypes=[object])(pose[0])
    # A rotation to 16 digits is one to 40 after two steps of Newton's polar iteration.
    for _ in range(3):
        rotation = rotation.dot(3 * np.eye(3, dtype=int) - rotation.T.dot(rotation)) / 2
    t = np.vectorize(mp.mpf, otypes=[object])(pose[1])
    global K
    floats, K = K, tuple(mp.mpf(v) for v in K)
    bf = mp.mpf(bf)
    h = mp.mpf(10) ** -15
    try:
        for _ in range(200):
            r, has = residual_blocks(exact, rotation, t, bf)
            columns = []
            for i in range(6):
                step = [mp.mpf(0)] * 6
                step[i] = h
                shifted = []
                for sign in (1, -1):
                    turn = exp_so3([sign * v for v in step[3:]])
                    shifted.append(residual_blocks(exact, turn.dot(rotation), turn.dot(t) + sign * np.array(step[:3]), bf)[0])
                columns.append((shifted[0] - shifted[1]) / (2 * h))
            j = np.stack(columns, 2)
            s = (r * r).sum(1)
            d2 = [mp.mpf(float(v)) for v in deltas2(has)]
            weight = np.array([1 if not robust or si <= d else mp.sqrt(d / si) for si, d in zip(s, d2)], dtype=object)
            gradient = np.einsum("nmi,nm,n->i", j, r, weight)
            jf, wf = j.astype(float), weight.astype(float)
            hessian = np.einsum("nmi,nmj,n->ij", jf, jf, wf)
            xi = -np.linalg.solve(hessian, np.eye(6)).astype(object).dot(gradient)
            turn = exp_so3(xi[3:])
            rotation, t = turn.dot(rotation), turn.dot(t) + xi[:3]
            if max(abs(v) for v in xi) < mp.mpf(10) ** -20:
                break
        else:
            raise RuntimeError("no convergence")
        cost = sum(huber(si, d) if robust else si for si, d in zip(s, d2)) / 2
    finally:
        K = floats
    return rotation.astype(float), t.astype(float), float(cost)


def optimum(data, initial, bf, robust=True):
    by_scipy = solve_scipy(data, initial, bf, robust)
    with np.errstate(invalid="ignore"):
        rotation, t, cost = polish(data, by_scipy, bf, robust)
    gap = max(abs(rotation - by_scipy[0]).max(), abs(t - by_scipy[1]).max())
    assert gap < 1e-6, gap
    return rotation, t, cost


def chi2(data, pose, bf):
    r, has = residual_blocks(data, *pose[:2], bf)
    return (r * r).sum(1), has


def write(name, why, data, initial, rounds, bf=40.0, flags=()):
    """`rounds` = 1: one robust optimum. 4: the full schedule of gates, each round from the initial pose."""
    n = len(data["uv"])
    inlier = np.ones(n, bool)
    for round_ in range(rounds):
        part = {k: v[inlier] for k, v in data.items()}
        rotation, t, cost = optimum(part, initial, bf, robust=round_ <= 2)
        s, has = chi2(data, (rotation, t), bf)
        distance = np.abs(s / deltas2(has) - 1).min()
        assert distance > 1e-6, f"{name}: a block sits on the gate ({distance})"
        inlier = s <= deltas2(has)
        print(f"{name} round {round_}: cost {cost:.6f}, {inlier.sum()} of {n}")
    s0, has = chi2(data, initial, bf)
    d2 = deltas2(has)
    cost0 = 0.5 * np.where(s0 <= d2, s0, 2 * np.sqrt(d2 * s0) - d2).sum()
    write_case(
        "pose_lm", name, basis="scipy + mpmath-40", why=why, script="gen/pose_lm.py", seed=None, flags=flags,
        equations=["paper:11", "E12"],
        params={"fx": K[0], "fy": K[1], "cx": K[2], "cy": K[3], "bf": bf, "rounds": rounds,
                "chi2_2d": CHI2_2D, "chi2_3d": CHI2_3D},
        inputs={"p_world": (data["p_world"], "m"), "uv": (data["uv"], "px"), "sigma": (data["sigma"], "px"),
                "right": (data["right"], "px"), "rotation_initial": (initial[0], "1"),
                "translation_initial": (initial[1], "m")},
        outputs={"cost_initial": (cost0, "1", "pose.cost_initial"), "cost": (cost, "1", "pose.cost"),
                 "rotation": (rotation, "1", "pose.pose"), "translation": (t, "m", "pose.pose"),
                 "inlier": (inlier, "1", "exact")},
    )


def write_derivatives(name, why, seed, n):
    """Residual rows and their derivatives by the pose (left perturbation, translation first) and by the point."""
    rng = np.random.default_rng(seed)
    phi, t = rng.uniform(-1.5, 1.5, (n, 3)).round(3), rng.uniform(-1, 1, (n, 3)).round(3)
    p_cam = rng.uniform([-1.5, -1.0, 0.4], [1.5, 1.0, 6.0], (n, 3))
    p_world = np.einsum("nji,nj->ni", Rotation.from_rotvec(phi).as_matrix(), p_cam - t).round(4)
    sigma, sigma_right = (1.2 ** rng.integers(0, 8, n)).round(6), rng.uniform(0.5, 3, n).round(3)
    uv = rng.uniform([0, 0], [640, 480], (n, 2)).round(2)
    right = np.stack([uv[:, 0] - 10, sigma_right], 1)
    h = mp.mpf(10) ** -15
    k, bf = [mp.mpf(v) for v in K], mp.mpf(40)
    rows, by_pose, by_point = [], [], []
    for i in range(n):
        number = lambda v: [mp.mpf(float(x)) for x in v]
        rotation, shift, point = exp_so3(number(phi[i])), number(t[i]), number(p_world[i])
        (u, v), (u_r, s_r), s = number(uv[i]), number(right[i]), mp.mpf(float(sigma[i]))

        def residual(xi, d):
            moved = rotation.dot(np.array(point) + d) + shift
            x, y, z = exp_so3(list(xi[3:])).dot(moved) + xi[:3]
            return np.array([(k[0] * x / z + k[2] - u) / s, (k[1] * y / z + k[3] - v) / s,
                             (k[0] * x / z + k[2] - bf / z - u_r) / s_r])

        zero = np.array([mp.mpf(0)] * 9)
        columns = []
        for c in range(9):
            step = zero.copy()
            step[c] = h
            columns.append((residual(step[:6], step[6:]) - residual(-step[:6], -step[6:])) / (2 * h))
        j = np.stack(columns, 1).astype(float)
        rows.append(residual(zero[:6], zero[6:]).astype(float))
        by_pose.append(j[:, :6])
        by_point.append(j[:, 6:])
    write_case(
        "reprojection", name, basis="mpmath-40", why=why, script="gen/pose_lm.py", seed=seed,
        equations=["paper:11", "E12"],
        params={"fx": K[0], "fy": K[1], "cx": K[2], "cy": K[3], "bf": 40.0},
        inputs={"phi": (phi, "rad"), "t": (t, "m"), "p_world": (p_world, "m"), "uv": (uv, "px"), "sigma": (sigma, "px"),
                "right": (right, "px")},
        outputs={"residual": (np.array(rows), "1", "reprojection.residual"),
                 "by_pose": (np.array(by_pose), "1/m, 1/rad", "reprojection.jacobian"),
                 "by_point": (np.array(by_point)[:, :2], "1/m", "reprojection.jacobian")},
    )


if __name__ == "__main__":
    write_derivatives("derivatives", "every sign and order of the 3x6 Jacobian", 9, 24)
    for name, why, rounds, kwargs in [
        ("six_points", "small enough to read: no outlier, no depth", 1, dict(seed=1, n=6, depth_share=0, outliers=0)),
        ("mono_outliers_30", "Huber at work: 30 % of the matches are wrong", 1,
         dict(seed=2, n=150, depth_share=0, outliers=0.3)),
        ("depth_mixed", "blocks of two and of three rows, each with its own knee", 1,
         dict(seed=3, n=150, depth_share=0.6, outliers=0.15)),
        ("three_with_depth", "the fewest observations allowed", 1, dict(seed=4, n=3, depth_share=1, outliers=0)),
        ("rounding_noise", "the only noise is that of digits cut off: tiny residuals, a sharp optimum", 1,
         dict(seed=5, n=40, depth_share=0.5, outliers=0, noise=0.0)),
        ("far_start", "a start 0.3 rad away", 1, dict(seed=6, n=100, depth_share=0.5, outliers=0.1, turn=0.2)),
        ("gates_mono", "four rounds with gates, no depth", 4, dict(seed=7, n=200, depth_share=0, outliers=0.35)),
        ("gates_depth", "four rounds with gates, with depth", 4, dict(seed=8, n=200, depth_share=0.8, outliers=0.35)),
    ]:
        data, initial = scene(**kwargs)
        write(name, why, data, initial, rounds)
