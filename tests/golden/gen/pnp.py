"""Poses from points: exact triples with a known pose, and optima of noisy sets found by OpenCV and scipy.

Exact: three points in front of a random camera, projected with numpy; the pose is an input of the construction.
Triples whose equations are badly conditioned (the camera near the cylinder around the triangle) are drawn again.
Noisy: cv2.solvePnP (iterative) on the right matches, then scipy.optimize.least_squares to the last digit; noise is
cut at 2 sigma, so that no robust kernel acts, and wrong matches are at least 15 px off.

    Needs: numpy 2.4.6, scipy 1.17.1, opencv-python-headless 5.0.0.
"""

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from case import write_case

K = (535.4, 539.2, 320.1, 247.6)
PARAMS = dict(zip(("fx", "fy", "cx", "cy"), K))


def project(rotation, t, world):
    p = world @ rotation.T + t
    return np.stack([K[0] * p[:, 0] / p[:, 2] + K[2], K[1] * p[:, 1] / p[:, 2] + K[3]], 1), p


def unproject(uv, depth):
    return np.stack([(uv[:, 0] - K[2]) / K[0], (uv[:, 1] - K[3]) / K[1], np.ones(len(uv))], 1) * depth[:, None]


def pose(rng):
    return Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)


def conditioning(p):
    """Determinant over norm^3 of the derivative of the three laws of cosines by the distances."""
    s = np.linalg.norm(p, axis=1)
    f = p / s[:, None]
    j = np.zeros((3, 3))
    for row, (a, b) in enumerate([(1, 2), (0, 2), (0, 1)]):
        c = f[a] @ f[b]
        j[row, a], j[row, b] = 2 * (s[a] - s[b] * c), 2 * (s[b] - s[a] * c)
    return abs(np.linalg.det(j)) / np.linalg.norm(j) ** 3


def exact(seed, n):
    rng = np.random.default_rng(seed)
    out = dict(world=[], uv=[], rotation=[], t=[])
    while len(out["world"]) < n:
        rotation, t = pose(rng)
        p = unproject(rng.uniform([0, 0], [640, 480], (3, 2)), rng.uniform(0.5, 8, 3))
        if conditioning(p) < 3e-3:
            continue
        world = (p - t) @ rotation
        out["world"].append(world)
        out["uv"].append(project(rotation, t, world)[0])
        out["rotation"].append(rotation)
        out["t"].append(t)
    out = {k: np.array(v) for k, v in out.items()}
    write_case(
        "pnp", "triples", basis="numpy, by construction", why="the true pose is one of at most four", script="gen/pnp.py",
        seed=seed, params=PARAMS, flags=["exact"],
        inputs={"p_world": (out["world"], "m"), "uv": (out["uv"], "px")},
        outputs={"rotation": (out["rotation"], "1", "pnp.exact"), "translation": (out["t"], "m", "pnp.exact")},
    )


def noisy(name, seed, right, wrong, why):
    rng = np.random.default_rng(seed)
    rotation, t = pose(rng)
    n = right + wrong
    p = unproject(rng.uniform([0, 0], [640, 480], (n, 2)), rng.uniform(0.8, 6, n))
    world = ((p - t) @ rotation).round(6)
    true, _ = project(rotation, t, world)
    sigma = (1.2 ** rng.integers(0, 4, n)).round(6)
    noise = rng.normal(size=(n, 2))
    noise *= np.minimum(1, 2 / np.linalg.norm(noise, axis=1))[:, None]
    uv = true + noise * sigma[:, None]
    is_right = rng.permutation(n) < right
    for i in np.flatnonzero(~is_right):
        while np.linalg.norm(uv[i] - true[i]) < 15:
            uv[i] = rng.uniform([0, 0], [640, 480])
    uv = uv.round(3)
    k = np.array([[K[0], 0, K[2]], [0, K[1], K[3]], [0, 0, 1]])
    _, rvec, tvec = cv2.solvePnP(world[is_right], uv[is_right], k, None, flags=cv2.SOLVEPNP_ITERATIVE)
    first = Rotation.from_rotvec(rvec.ravel()), tvec.ravel()

    def residual(x):
        r = (Rotation.from_rotvec(x[:3]) * first[0]).as_matrix()
        return ((project(r, first[1] + x[3:], world[is_right])[0] - uv[is_right]) / sigma[is_right, None]).ravel()

    found = least_squares(residual, np.zeros(6), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x
    best, best_t = (Rotation.from_rotvec(found[:3]) * first[0]).as_matrix(), first[1] + found[3:]
    chi2 = (((project(best, best_t, world)[0] - uv) / sigma[:, None]) ** 2).sum(1)
    assert (chi2[is_right] < 5.5).all() and (chi2[~is_right] > 20).all(), (chi2[is_right].max(), chi2[~is_right].min())
    print(name, "OpenCV's own pose is", np.abs(found).max(), "away (it does not weight)")
    write_case(
        "pnp", name, basis="opencv + scipy", why=why, script="gen/pnp.py", seed=seed, params=PARAMS,
        inputs={"p_world": (world, "m"), "uv": (uv, "px"), "sigma": (sigma, "px")},
        outputs={"rotation": (best, "1", "pnp.pose"), "translation": (best_t, "m", "pnp.pose"),
                 "inlier": (is_right.astype(np.uint8), "1", "exact")},
    )


if __name__ == "__main__":
    exact(5, 40)
    noisy("noisy_40", 11, 40, 0, "nothing wrong: one optimum")
    noisy("half_wrong", 12, 60, 60, "one match in two is wrong")
