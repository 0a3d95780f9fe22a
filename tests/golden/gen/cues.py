"""The four cues of eq. 2 of a landmark, from the keyframes that observe it.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93 mpmath==1.3.0
    python3 tests/golden/gen/cues.py

Observations are rows: `landmark`, `keyframe`, `uv` (ideal px) and `depth_m` (NaN: none), in order of the keyframes.

    alpha   mean distance between uv and the projection, over the keyframes that have the landmark in front of them
    beta    depth_cue = spread: standard deviation (n - 1) of (depth_m - z) / s(depth_m), s(z) = max(noise_per_m z^2,
            noise_floor_m); free_space: the largest distance in front of the surfaces that the views saw, see free_space.py
    gamma   number of observations
    delta   mean of (d1 + d2) / 2, the distances of both points from each other's epipolar line, over the observations
            but the first, each with the first; those with a baseline of at most 0.02 of the landmark's distance from
            the first camera are left out

NaN where there is nothing to take a mean of. 50 digits.
"""

import mpmath as mp
import numpy as np

from case import write_case
from epipolar import cross
from views import FreeSpace, Margin, camera, evidence, matrix, pose, room, sigma, to_world, unproject, view_inputs

mp.mp.dps = 50
MIN_BASELINE = 0.02


def mean(values):
    return float(mp.fsum(values) / len(values)) if values else np.nan


def landmark_cues(c, poses, p, observed, noise, margin):
    """(alpha, spread, gamma, delta); observed: rows (keyframe, uv, depth)."""
    k, p = mp.matrix(matrix(c).tolist()), mp.matrix(p.tolist())
    motion = [(mp.matrix(r.tolist()), mp.matrix(t.tolist())) for r, t in poses]
    centre = [-(r.T * t) for r, t in motion]
    alpha, residuals, delta = [], [], []
    for i, (key, uv, depth) in enumerate(observed):
        r, t = motion[key]
        q = r * p + t
        if margin(float(q[2]), 0) > 0:
            u, v = c["fx"] * q[0] / q[2] + c["cx"], c["fy"] * q[1] / q[2] + c["cy"]
            alpha.append(mp.sqrt((u - uv[0]) ** 2 + (v - uv[1]) ** 2))
        if not np.isnan(depth):
            residuals.append((mp.mpf(depth) - q[2]) / mp.mpf(sigma(depth, noise)))
        first, uv0, _ = observed[0]
        if i == 0:
            continue
        share = float(mp.norm(centre[key] - centre[first]) / mp.norm(p - centre[first]))
        if margin(share, MIN_BASELINE) > MIN_BASELINE:
            turn = r * motion[first][0].T
            f = mp.inverse(k).T * cross(t - turn * motion[first][1]) * turn * mp.inverse(k)
            a, b = mp.matrix([*uv0, 1]), mp.matrix([*uv, 1])
            line2, line1 = f * a, f.T * b
            e = abs((b.T * line2)[0])
            delta.append((e / mp.hypot(line1[0], line1[1]) + e / mp.hypot(line2[0], line2[1])) / 2)
    spread = np.nan
    if len(residuals) > 1:
        middle = mp.fsum(residuals) / len(residuals)
        spread = float(mp.sqrt(mp.fsum((x - middle) ** 2 for x in residuals) / (len(residuals) - 1)))
    return mean(alpha), spread, len(observed), mean(delta)


def make(seed):
    rng, margin = np.random.default_rng(seed), Margin(1e-4)
    c = camera(62, 45, 55.5, 51.25, 30.2, 21.9)
    noise, most = (6e-3, 0.012), 8.0
    # Keyframe 1 is 0.06 m ahead of keyframe 0: the baseline counts for landmarks nearer to that than 3 m. Keyframe 3 looks back.
    poses = [pose([0, 0, 0], [0, 0, 0]), pose([0.01, -0.02, 0.015], [-0.02, 0.01, -0.056]),
             pose([-0.05, 0.12, 0.04], [-0.3, 0.12, 0.2]), pose([0.1, 2.9, 0.05], [0.2, -0.1, 0.5]), pose([0.1, -0.06, -0.2], [0.25, 0.1, -0.15])]
    seen_by = [[0, 1, 2, 4], [0, 1], [0, 1, 2], [1, 2, 4], [2], [0, 1, 2, 3, 4], [3], [], [2, 4], [0, 4]]
    points, rows = [], []
    for i in range(30):
        p = unproject(c, *rng.uniform([4, 4], [57, 40]), rng.uniform(1.4, 6.0))
        if i < 6:
            p *= [0.99, 1.01][i % 2] * np.linalg.norm(poses[1][1]) / MIN_BASELINE / np.linalg.norm(p)
        points.append(to_world(p, *poses[0]))
        for key in seen_by[i % len(seen_by)]:
            r, t = poses[key]
            q = r @ points[i] + t
            uv = [c["fx"] * q[0] / q[2] + c["cx"], c["fy"] * q[1] / q[2] + c["cy"]] + rng.normal(0, 1.1, 2)
            known = q[2] > 0 and rng.random() < 0.7
            depth = q[2] + sigma(q[2], noise) * rng.normal(0, 2) if known else np.nan
            rows.append((i, key, *uv, depth))
    rows = np.array(rows)
    views = [room(c, seed + v) for v in range(2)]
    spaces, view_poses, ages = [FreeSpace(d.astype(float), most) for d in views], [poses[0], poses[2]], [4, 9]
    history = list(zip(spaces, view_poses, ages))
    found = []
    for i, p in enumerate(points):
        observed = [(int(r[1]), r[2:4], r[4]) for r in rows if r[0] == i]
        found.append(landmark_cues(c, poses, p, observed, noise, margin) + evidence(c, history, noise, p, Margin())[:1])
    alpha, spread, gamma, delta, free = np.array(found).T
    for case, beta in (("spread", spread), ("free_space", free)):
        write_case(
            "cues", case, basis="mpmath, numpy, OpenCV", script="gen/cues.py", seed=seed, equations=["paper:2"],
            why="landmarks seen by none to five keyframes, also from behind, with and without depth, and with baselines on both sides of the least; "
                + {"spread": "the printed depth cue", "free_space": "the depth cue from free space"}[case],
            params=c | {"max_depth_m": most, "noise_per_m": noise[0], "noise_floor_m": noise[1], "depth_cue": case},
            inputs={
                "points": (np.array(points), "m, world"),
                "landmark": (rows[:, 0].astype(np.int32), "index"), "keyframe": (rows[:, 1].astype(np.int32), "index"),
                "uv": (rows[:, 2:4], "px"), "depth_m": (rows[:, 4], "m"),
                "rotation": (np.array([r for r, _ in poses]), "1"), "translation": (np.array([t for _, t in poses]), "m"),
            } | view_inputs(views, view_poses, ages),
            outputs={
                "alpha": (alpha, "px", "cues.reprojection"), "beta": (beta, "standard deviations", "cues.depth"),
                "gamma": (gamma.astype(np.int32), "observations", "exact"), "delta": (delta, "px", "cues.epipolar"),
            },
        )
    for name, values in (("alpha", alpha), ("spread", spread), ("free", free), ("delta", delta)):
        there = np.isfinite(values).sum()
        assert 0 < there < 30, (name, there)
    assert (free == 0).any() and (free > 3).any()


make(71)
