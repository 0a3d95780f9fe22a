"""Pyramidal Lucas-Kanade (the book: lucas_kanade.md, features.md), all points at once.

Grey levels are interpolated with weights of 14 bits and kept as 32 times the level in whole numbers, slopes
likewise; the sums over the window are of integers and have no order. The rest is float32.
"""

import numpy as np

F = np.float32
WINDOW, ITERATIONS, ENOUGH_PX, LEAST = 21, 30, 0.01, F(1e-4)
PAD = WINDOW + 3        # pixels kept around a level
HALF = F((WINDOW - 1) / 2)


def half(image):
    """5 taps 1 4 6 4 1 each way, mirrored without repeating the border, every second pixel."""
    p = np.pad(image.astype(np.int64), 2, mode="reflect")
    rows = p[:-4] + 4 * p[1:-3] + 6 * p[2:-2] + 4 * p[3:-1] + p[4:]
    both = rows[:, :-4] + 4 * rows[:, 1:-3] + 6 * rows[:, 2:-2] + 4 * rows[:, 3:-1] + rows[:, 4:]
    return ((both[::2, ::2] + 128) >> 8).astype(np.uint8)


def scharr(image):
    p = np.pad(image.astype(np.int64), 1, mode="reflect")
    across = lambda a: 3 * a[:-2] + 10 * a[1:-1] + 3 * a[2:]
    dx = across(p)[:, 2:] - across(p)[:, :-2]
    dy = across(p.T)[:, 2:] - across(p.T)[:, :-2]
    return np.pad(dx, PAD), np.pad(dy.T, PAD)


def levels_of(image, count):
    levels = []
    for _ in range(count + 1):
        if levels and min(image.shape) <= WINDOW:
            break
        levels.append((np.pad(image.astype(np.int64), PAD, mode="reflect"), *scharr(image), image.shape))
        image = half(image)
    return levels


def sample(padded, corner, shift):
    """[N, 21, 21]: the window with its upper left pixel at `corner`."""
    whole = np.floor(corner)
    fraction, one = corner - whole, F(1 << 14)
    a, b = fraction[:, 0], fraction[:, 1]
    w = [np.rint(v * one).astype(np.int64) for v in ((1 - a) * (1 - b), a * (1 - b), (1 - a) * b)]
    w.append((1 << 14) - w[0] - w[1] - w[2])
    x, y = (whole.astype(np.int64) + PAD).T
    steps = np.arange(WINDOW)
    at = lambda dy, dx: padded[(y + dy)[:, None, None] + steps[:, None], (x + dx)[:, None, None] + steps]
    total = sum(weight[:, None, None] * at(*d) for weight, d in zip(w, ((0, 0), (0, 1), (1, 0), (1, 1))))
    return (total + (1 << shift - 1)) >> shift


def inside(corner, shape):
    whole = np.floor(corner)
    return (whole >= -WINDOW).all(1) & (whole[:, 0] < shape[1]) & (whole[:, 1] < shape[0])


def summed(a, b):
    return (a * b).sum((1, 2)).astype(F) * F(2.0**-20)


def follow_level(image, target, at, estimate, alive):
    """One level for the points in `alive`; says which of them the level can hold."""
    (grey, dx, dy, shape), (following, *_) = image, target
    good = alive & inside(at - HALF, shape)
    who = np.flatnonzero(good)
    i, ix, iy = sample(grey, at[who] - HALF, 9), sample(dx, at[who] - HALF, 14), sample(dy, at[who] - HALF, 14)
    gxx, gxy, gyy = summed(ix, ix), summed(ix, iy), summed(iy, iy)
    det = gxx * gyy - gxy * gxy
    least = (gyy + gxx - np.sqrt((gxx - gyy) ** 2 + 4 * gxy * gxy)) / F(2 * WINDOW * WINDOW)
    held = (least >= LEAST) & (det >= np.finfo(F).eps)
    good[who[~held]] = False
    keep = np.flatnonzero(held)
    who, (i, ix, iy, gxx, gxy, gyy, det) = who[keep], (v[keep] for v in (i, ix, iy, gxx, gxy, gyy, det))
    corner, previous, lost = estimate[who] - HALF, np.zeros((len(who), 2), F), np.zeros(len(who), bool)
    run = np.arange(len(who))
    for step in range(ITERATIONS):
        outside = ~inside(corner[run], shape)
        lost[run[outside]] = True
        run = run[~outside]
        if not len(run):
            break
        diff = sample(following, corner[run], 9) - i[run]
        bx, by = summed(diff, ix[run]), summed(diff, iy[run])
        delta = np.stack([gxy[run] * by - gyy[run] * bx, gxy[run] * bx - gxx[run] * by], 1) * (1 / det[run])[:, None]
        corner[run] += delta
        estimate[who[run]] = corner[run] + HALF
        done = (delta.astype(float) ** 2).sum(1) <= ENOUGH_PX**2
        undone = ~done & (step > 0) & (abs(delta + previous[run]) < ENOUGH_PX).all(1)
        estimate[who[run[undone]]] -= delta[undone] * F(0.5)
        previous[run] = delta
        run = run[~(done | undone)]
    return good, who, lost, i


def stage(case):
    count, points = case.params["levels"], case["points"]
    prev, following = levels_of(case["prev"], count), levels_of(case["next"], count)
    estimate = points * F(0.5 ** (len(prev) - 1))
    alive = np.ones(len(points), bool)
    for level in reversed(range(len(prev))):
        if level < len(prev) - 1:
            estimate = estimate * 2
        found = follow_level(prev[level], following[level], points * F(0.5**level), estimate, alive)
    good, who, lost, window = found
    status, residual = np.zeros(len(points), np.uint8), np.zeros(len(points), F)
    stays = ~lost & inside(estimate[who] - HALF, prev[0][3])
    difference = abs(sample(following[0][0], estimate[who[stays]] - HALF, 9) - window[stays])
    status[who[stays]], residual[who[stays]] = 1, difference.sum((1, 2)).astype(F) / F(32 * WINDOW * WINDOW)
    # Cases compare positions on the corners, which come first: the eight others are flat or outside.
    n = len(points) - 8
    moved = (estimate - points)[:n]
    return {"status": status, "xy": estimate[:n], "xy_opencv": estimate[:n], "residual": residual[:n],
            "residual_opencv": residual[:n], "flow_truth": moved}
