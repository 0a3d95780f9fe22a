"""Pyramidal Lucas-Kanade by OpenCV, and by its definition in numpy with exact sums.

    pip install numpy==2.4.6 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/lk.py

`xy` is the definition below; `xy_opencv` what OpenCV found, whose f32 sums depend on the order
of SIMD lanes; `flow_truth` the motion with which the second picture was made.
"""

import cv2
import numpy as np

import pictures
from case import write_case

WINDOW, PAD, LEVELS, ITERATIONS = 21, 24, 3, 30
F = np.float32


def scharr(image):
    return [np.pad(cv2.Scharr(image, cv2.CV_16S, dx, 1 - dx).astype(np.int64), PAD) for dx in (1, 0)]


def levels_of(image):
    levels = []
    for _ in range(LEVELS + 1):
        if levels and min(image.shape) <= WINDOW:
            break
        levels.append((np.pad(image.astype(np.int64), PAD, mode="reflect"), *scharr(image), image.shape))
        image = cv2.pyrDown(image)
    return levels


def place(corner, shape):
    """Integer corner and the four weights of 14 bits, or None if the window is too far outside."""
    x, y = np.floor(corner).astype(int)
    if x < -WINDOW or y < -WINDOW or x >= shape[1] or y >= shape[0]:
        return None
    a, b = corner - np.floor(corner)
    one = F(1 << 14)
    w = [int(np.rint(v * one)) for v in ((F(1) - a) * (F(1) - b), a * (F(1) - b), (F(1) - a) * b)]
    return x, y, (*w, (1 << 14) - sum(w))


def sample(padded, at, shift):
    x, y, (w00, w01, w10, w11) = at
    p = padded[y + PAD:y + PAD + WINDOW + 1, x + PAD:x + PAD + WINDOW + 1]
    total = w00 * p[:-1, :-1] + w01 * p[:-1, 1:] + w10 * p[1:, :-1] + w11 * p[1:, 1:]
    return (total + (1 << shift - 1)) >> shift


def follow(prev, following, point):
    """Status, position, residual; OpenCV's order of operations in float32."""
    half, scale = F((WINDOW - 1) * 0.5), F(2.0 ** -20)
    estimate = None
    for level in reversed(range(len(prev))):
        image, dx, dy, shape = prev[level]
        target = following[level][0]
        factor = F(0.5 ** level)
        estimate = point * factor if estimate is None else estimate * F(2)
        at = place(point * factor - half, shape)
        if at is None:
            if level == 0:
                return 0, estimate, F(0)
            continue
        i, ix, iy = sample(image, at, 9), sample(dx, at, 14), sample(dy, at, 14)
        a11, a12, a22 = (F((u * v).sum()) * scale for u, v in ((ix, ix), (ix, iy), (iy, iy)))
        det = a11 * a22 - a12 * a12
        smallest = (a22 + a11 - np.sqrt((a11 - a22) * (a11 - a22) + F(4) * a12 * a12)) / F(2 * WINDOW * WINDOW)
        if smallest < F(1e-4) or det < np.finfo(F).eps:
            if level == 0:
                return 0, estimate, F(0)
            continue
        inverse, corner, previous, inside = F(1) / det, estimate - half, np.zeros(2, F), True
        for step in range(ITERATIONS):
            at = place(corner, shape)
            if at is None:
                inside = False
                break
            diff = sample(target, at, 9) - i
            b1, b2 = F((diff * ix).sum()) * scale, F((diff * iy).sum()) * scale
            delta = np.array([(a12 * b2 - a22 * b1) * inverse, (a12 * b1 - a11 * b2) * inverse], F)
            corner = corner + delta
            estimate = corner + half
            if float(delta[0]) ** 2 + float(delta[1]) ** 2 <= 0.01 ** 2:
                break
            if step > 0 and (np.abs(delta + previous).astype(float) < 0.01).all():
                estimate = estimate - delta * F(0.5)
                break
            previous = delta
        if level == 0:
            at = place(estimate - half, shape) if inside else None
            if at is None:
                return 0, estimate, F(0)
            return 1, estimate, F(np.abs(sample(target, at, 9) - i).sum()) / F(32 * WINDOW * WINDOW)


def make(name, seed, size, motion, gain, why):
    width, height = size
    rng = np.random.default_rng(seed)
    source = pictures.texture(width + 80, height + 80, seed, octaves=(2, 4, 8, 16)).astype(np.float32)
    source = 40 + 0.6 * source
    inner = np.array([[1, 0, 40], [0, 1, 40], [0, 0, 1.0]])
    warp = lambda m: cv2.warpAffine(source, m[:2], size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    motion = np.array([*motion, [0, 0, 1]], float)
    prev = warp(inner).round().clip(0, 255).astype(np.uint8)
    following = (gain * warp(inner @ np.linalg.inv(motion))).round().clip(0, 255).astype(np.uint8)
    prev[height - 40:, :40] = 128  # a patch without texture
    corners = cv2.goodFeaturesToTrack(prev, 120, 0.02, 6).reshape(-1, 2)
    corners = corners[(corners > 12).all(1) & (corners < np.array(size) - 13).all(1)]
    corners = corners[~((corners[:, 0] < 60) & (corners[:, 1] > height - 60))] + rng.uniform(-0.5, 0.5, 2)
    others = np.array([[15, height - 15], [-10.75, 50], [-12, 50], [width + 12, 20], [width + 8.5, 20],
                       [30, -11.5], [30, height + 9], [1e6, 3]])
    points = np.vstack([corners, others]).astype(F)
    truth = (np.c_[corners, np.ones(len(corners))] @ motion.T)[:, :2] - corners
    opencv, status, error = cv2.calcOpticalFlowPyrLK(prev, following, points, None, winSize=(WINDOW, WINDOW), maxLevel=LEVELS)
    a, b = levels_of(prev), levels_of(following)
    found = [follow(a, b, p) for p in points]
    assert [f[0] for f in found] == status.ravel().tolist(), "the definition agrees with OpenCV on who is lost"
    n = len(corners)
    distance = np.abs(np.array([f[1] for f in found[:n]]) - opencv[:n]).max(1)
    print(f"{name}: {n} corners, {status.sum()} tracked; definition - OpenCV: median {np.median(distance):.1e}, "
          f"max {distance.max():.1e} px; truth: median {np.median(np.abs(opencv[:n] - corners - truth)):.3f} px")
    # A gain breaks the assumption of constant brightness, and with it the answer.
    known = {"flow_truth": (truth, "px", "lk.flow_truth")} if gain == 1.0 else {}
    write_case(
        "lk", name, basis="opencv", why=why, script="gen/lk.py", seed=seed, params={"levels": LEVELS},
        inputs={"prev": (prev, "1"), "next": (following, "1"), "points": (points, "px")},
        outputs={
            "status": (status.ravel(), "1", "exact"),
            "xy": (np.array([f[1] for f in found[:n]], F), "px", "lk.xy"),
            "xy_opencv": (opencv[:n], "px", "lk.xy_opencv"),
            "residual": (np.array([f[2] for f in found[:n]], F), "1", "lk.residual"),
            "residual_opencv": (error.ravel()[:n], "1", "lk.residual_opencv"),
        } | known,
    )


make("shift", 31, (200, 150), [[1, 0, 3.4], [0, 1, -2.7]], 1.0, "a translation of several pixels")
make("turn", 32, (200, 150), [[0.9998, -0.0175, 2.0], [0.0175, 0.9998, -3.0]], 1.0, "one degree: every point moves otherwise")
make("still", 33, (160, 120), [[1, 0, 0], [0, 1, 0]], 1.0, "no motion: the first step must end it")
make("brighter", 34, (160, 120), [[1, 0, 0.6], [0, 1, 0.3]], 1.1, "residuals that are not 0")


def make_faint(name, seed, why):
    """Squares 1 to 6 grey levels brighter than the rest, moved by whole pixels. At a corner the smallest eigenvalue
    goes with the square of that step, and passes the gate of 1e-4 between steps of 1 and of 4 levels."""
    rng = np.random.default_rng(seed)
    prev, following = (np.full((150, 200), 128, np.uint8) for _ in range(2))
    corners = []
    for k in range(24):
        x, y, step = 14 + 30 * (k % 6), 14 + 34 * (k // 6), 1 + k % 6
        prev[y:y + 14, x:x + 14] += np.uint8(step)
        following[y - 1:y + 13, x + 1:x + 15] += np.uint8(step)
        corners.append([x + [0, 14, 0, 14][k // 6], y + [0, 0, 14, 14][k // 6]])
    corners = np.array(corners) + rng.uniform(-2.5, 2.5, (len(corners), 2))
    others = np.array([[195, 5], [195, 75], [-12, 50], [212, 20], [30, -11.5], [30, 159], [1e6, 3], [100, 148]])
    points = np.vstack([corners, others]).astype(F)
    opencv, status, error = cv2.calcOpticalFlowPyrLK(prev, following, points, None, winSize=(WINDOW, WINDOW), maxLevel=LEVELS)
    a, b = levels_of(prev), levels_of(following)
    found = [follow(a, b, p) for p in points]
    assert [f[0] for f in found] == status.ravel().tolist(), "the definition agrees with OpenCV on who is lost"
    n = len(corners)
    kept = status.ravel()[:n] == 1
    assert 6 <= kept.sum() <= n - 6, "both sides of the gate"
    distance = np.abs(np.array([f[1] for f in found[:n]]) - opencv[:n]).max(1)
    print(f"{name}: {n} corners, {kept.sum()} tracked; definition - OpenCV: max {distance.max():.1e} px")
    write_case(
        "lk", name, basis="opencv", why=why, script="gen/lk.py", seed=seed, params={"levels": LEVELS},
        inputs={"prev": (prev, "1"), "next": (following, "1"), "points": (points, "px")},
        outputs={
            "status": (status.ravel(), "1", "exact"),
            "xy": (np.array([f[1] for f in found[:n]], F), "px", "lk.xy"),
            "xy_opencv": (opencv[:n], "px", "lk.xy_opencv"),
            "residual": (np.array([f[2] for f in found[:n]], F), "1", "lk.residual"),
            # OpenCV leaves the error of lost points as it found it.
            "residual_opencv": (np.where(kept, error.ravel()[:n], 0).astype(F), "1", "lk.residual_opencv"),
        },
    )


make_faint("faint", 35, "texture of a few grey levels: both sides of the gate on the smallest eigenvalue")
