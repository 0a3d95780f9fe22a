"""Training losses with their gradients (the book: losses.md)."""

import numpy as np

F = np.float32
RADIUS, SIGMA, C1, C2 = 5, 1.5, F(1e-4), F(9e-4)
WINDOW = np.exp(-np.arange(-RADIUS, RADIUS + 1) ** 2 / (2 * SIGMA**2))
WINDOW = (WINDOW / WINDOW.sum()).astype(F)


def smooth(a):
    """Rows, then columns, zeros outside; the far taps are added first."""
    for axis in (1, 0):
        padded = np.pad(a, [(RADIUS, RADIUS) if k == axis else (0, 0) for k in range(a.ndim)])
        n, total = a.shape[axis], np.zeros_like(a)
        for far in range(RADIUS, -1, -1):
            for tap in {RADIUS - far, RADIUS + far}:
                total += WINDOW[tap] * np.take(padded, range(tap, tap + n), axis)
        a = total
    return a


def l1(x, y, keep):
    n = F(3 * keep.sum())
    difference = np.where(keep[..., None], x - y, 0)
    return abs(difference).sum() / n, np.sign(difference).astype(F) / n


def ssim(x, y, keep):
    x = np.where(keep[..., None], x, y)
    mx, my = smooth(x), smooth(y)
    vx, vy, vxy = smooth(x * x) - mx * mx, smooth(y * y) - my * my, smooth(x * y) - mx * my
    a1, a2, b1, b2 = 2 * mx * my + C1, 2 * vxy + C2, mx * mx + my * my + C1, vx + vy + C2
    s = a1 * a2 / (b1 * b2)
    share = np.where(keep, F(1) / F(3 * keep.sum()), F(0))[..., None]
    by_p, by_q = 2 * a1 / (b1 * b2), -s / b2
    by_m = 2 * (my * a2 / b2 - mx * s) / b1 - my * by_p - 2 * mx * by_q
    gradient = smooth(share * by_m) + 2 * x * smooth(share * by_q) + y * smooth(share * by_p)
    return (share * s).sum(), np.where(keep[..., None], gradient, 0)


def photometric(x, y, weight, keep):
    (a, da), (b, db) = l1(x, y, keep), ssim(x, y, keep)
    weight = F(weight)
    return (1 - weight) * a + weight * (1 - b), (1 - weight) * da - weight * db


def depth(rendered, opacity, measured, least, keep):
    keep = keep & np.isfinite(measured) & (measured > 0) & (opacity >= F(least))
    n, o = F(max(keep.sum(), 1)), np.where(keep, opacity, 1)
    error = np.where(keep, rendered / o - np.where(keep, measured, 0), 0)
    by_depth = np.sign(error).astype(F) / (n * o)
    return abs(error).sum() / n, by_depth, -rendered / o * by_depth


def penalty(logits, dynamic):
    o = np.where(dynamic > 0, 1 / (1 + np.exp(-logits)), 0).astype(F)
    closed = np.where(dynamic > 0, 1 / (1 + np.exp(logits)), 0).astype(F)      # 1 - o, to its last digit
    return (o * o).sum(), 2 * o * o * closed


def stage(case):
    kind = case.params["loss"]
    if kind == "opacity":
        with np.errstate(over="ignore"):
            value, gradient = penalty(case["logits"], case["dynamic"])
        return {"value": F(value).reshape(1), "gradient": gradient}
    first = case["depth" if kind == "depth" else "rendered"]
    keep = case["excluded"] == 0 if "excluded" in case else np.ones(first.shape[:2], bool)
    if kind == "depth":
        value, by_depth, by_opacity = depth(first, case["opacity"], case["measured"], case.params["min_opacity"], keep)
        return {"value": F(value).reshape(1), "by_depth": by_depth.astype(F), "by_opacity": by_opacity.astype(F)}
    x, y = first, case["target"]
    value, gradient = {"l1": lambda: l1(x, y, keep), "ssim": lambda: ssim(x, y, keep),
                       "photometric": lambda: photometric(x, y, case.params["lambda"], keep)}[kind]()
    return {"value": F(value).reshape(1), "gradient": gradient.astype(F)}
