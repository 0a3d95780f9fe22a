"""Fundamental matrices and epipolar distances in 50 digits.

    pip install numpy==2.4.6 mpmath==1.3.0
    python3 tests/golden/gen/epipolar.py

Each case has exact pairs, noisy pairs, and wrong ones among the noisy; the distances are those of
the noisy pairs to the true F, which is scaled to norm 1 with its largest entry positive.
"""

import mpmath as mp
import numpy as np

from case import write_case

mp.mp.dps = 50
WIDTH, HEIGHT = 640, 480


def rotation(axis_angle):
    """Rodrigues' formula."""
    phi = mp.matrix(axis_angle)
    theta = mp.norm(phi)
    k = cross(phi / theta) if theta else mp.zeros(3)
    return mp.eye(3) + mp.sin(theta) * k + (1 - mp.cos(theta)) * k * k


def cross(v):
    return mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def array(matrix):
    return np.array(matrix.tolist(), dtype=float)


def make(name, seed, intrinsics, axis_angle, t, pairs, wrong, noise_px, why):
    rng = np.random.default_rng(seed)
    fx, fy, cx, cy = intrinsics
    k = mp.matrix([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    r = mp.matrix(array(rotation(axis_angle)).tolist())  # the doubles the case holds
    t = mp.matrix(t)
    f = mp.inverse(k).T * cross(t) * r * mp.inverse(k)
    largest = max(list(f), key=abs)
    f = f / (mp.sqrt(sum(v * v for v in f)) * mp.sign(largest))
    uv1, exact = [], []
    while len(uv1) < pairs:
        uv, depth = rng.uniform([0, 0], [WIDTH, HEIGHT]), mp.mpf(rng.uniform(0.8, 5))
        p = r * (mp.inverse(k) * mp.matrix([*uv, 1]) * depth) + t
        q = k * p
        seen = [q[0] / q[2], q[1] / q[2]]
        if p[2] > 0 and 0 <= seen[0] < WIDTH and 0 <= seen[1] < HEIGHT:
            uv1.append(uv)
            exact.append([float(v) for v in seen])
    uv1, exact = np.array(uv1), np.array(exact)
    uv2 = exact + rng.normal(0, noise_px, exact.shape)
    is_wrong = np.zeros(pairs, bool)
    is_wrong[rng.permutation(pairs)[:wrong]] = True
    uv2[is_wrong] = rng.uniform([0, 0], [WIDTH, HEIGHT], (wrong, 2))
    in_1, in_2, sampson = [], [], []
    for a, b in zip(uv1, uv2):
        p1, p2 = mp.matrix([*a, 1]), mp.matrix([*b, 1])
        line2, line1 = f * p1, f.T * p2
        e = (p2.T * line2)[0]
        n1, n2 = line1[0] ** 2 + line1[1] ** 2, line2[0] ** 2 + line2[1] ** 2
        in_1.append(float(abs(e) / mp.sqrt(n1)))
        in_2.append(float(abs(e) / mp.sqrt(n2)))
        sampson.append(float(e * e / (n1 + n2)))
    write_case(
        "epipolar", name, basis="mpmath", why=why, script="gen/epipolar.py", seed=seed,
        inputs={
            "uv1": (uv1, "px"), "uv2": (uv2, "px"), "exact_uv2": (exact, "px"), "is_wrong": (is_wrong, "1"),
            "intrinsics": (np.array(intrinsics), "px"), "rotation": (array(r), "1"), "translation": (array(t).ravel(), "m"),
        },
        outputs={
            "fundamental": (array(f), "1", "epipolar.fundamental"),
            "distance_in_1": (np.array(in_1), "px", "epipolar.distance"),
            "distance_in_2": (np.array(in_2), "px", "epipolar.distance"),
            "sampson": (np.array(sampson), "px2", "epipolar.distance"),
        },
    )


KINECT = (535.4, 539.2, 320.1, 247.6)

if __name__ == "__main__":
    make("handheld", 41, KINECT, [0.02, 0.08, -0.03], [0.25, -0.04, 0.06], 300, 90, 0.3, "a usual baseline, 30 % of the pairs wrong")
    make("forward", 42, KINECT, [0.0, 0.01, 0.0], [0.02, 0.0, -0.3], 150, 40, 0.3, "both epipoles inside the picture")
    make("half_wrong", 43, (517.3, 516.5, 318.6, 255.3), [-0.05, 0.02, 0.2], [-0.3, 0.1, 0.05], 200, 100, 0.2, "every other pair wrong, rolled camera")
