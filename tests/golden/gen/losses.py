"""Golden cases of the training losses, values by their definitions with scipy's filters, gradients by complex
steps: dL/dx = Im L(x + i h)/h with h = 1e-30, pixel by pixel. No derivative is written by hand.

Colours are rounded to float32, so that a float32 implementation reads the same pictures.

    Needs: numpy (2.4.6), scipy (1.17.1). Run: python3 losses.py
"""

import numpy as np
from case import write_case
from scipy.ndimage import correlate1d
from scipy.signal.windows import gaussian

H = 1e-30
WINDOW = gaussian(11, 1.5) / gaussian(11, 1.5).sum()
SCRIPT = "gen/losses.py"


def f32(a):
    return np.asarray(a, np.float64).astype(np.float32).astype(np.float64)


def smooth(a):
    """Separable, zeros outside; each channel by itself."""
    one = lambda v: correlate1d(correlate1d(v, WINDOW, 0, mode="constant"), WINDOW, 1, mode="constant")
    return one(a.real) + (1j * one(a.imag) if np.iscomplexobj(a) else 0)


def magnitude(d):
    return np.where(d.real < 0, -d, d)


def l1(x, y, keep):
    return magnitude(x - y)[keep].mean()


def ssim(x, y, keep):
    x = np.where(keep[..., None], x, y)
    mx, my = smooth(x), smooth(y)
    vx, vy, vxy = smooth(x * x) - mx * mx, smooth(y * y) - my * my, smooth(x * y) - mx * my
    return (((2 * mx * my + 1e-4) * (2 * vxy + 9e-4)) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4)))[keep].mean()


def gradient(f, x):
    out = np.zeros(x.shape)
    for i in np.ndindex(x.shape):
        step = x.astype(np.complex128)
        step[i] += 1j * H
        out[i] = f(step).imag / H
    return out


def pictures(seed, height, width):
    """A soft pattern and the same, displaced, brighter and noisy."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:height, 0:width]
    y = 0.5 + 0.3 * np.sin(u[..., None] * [0.5, 0.3, 0.2] + v[..., None] * [0.1, 0.4, 0.6]) + 0.05 * rng.normal(size=(height, width, 3))
    x = 0.9 * np.roll(y, 1, axis=1) + 0.08 + 0.03 * rng.normal(size=(height, width, 3))
    return f32(np.clip(x, 0, 1)), f32(np.clip(y, 0, 1))


def color_case(kind, name, why, x, y, mask, weight=0.2, flags=()):
    keep = np.ones(x.shape[:2], bool) if mask is None else mask == 0
    f = {
        "l1": lambda x: l1(x, y, keep), "ssim": lambda x: ssim(x, y, keep),
        "photometric": lambda x: (1 - weight) * l1(x, y, keep) + weight * (1 - ssim(x, y, keep)),
    }[kind]
    inputs = {"rendered": (x, "1"), "target": (y, "1")}
    if mask is not None:
        inputs["excluded"] = (mask, "0 judged")
    write_case("losses", name, basis="complex-step", why=why, script=SCRIPT, equations=["paper:13"], flags=flags,
               params={"loss": kind, "lambda": weight}, inputs=inputs,
               outputs={"value": (np.array([f(x)]), "1", "losses.value"), "gradient": (gradient(f, x), "1", "losses.gradient")})


def depth():
    rng = np.random.default_rng(41)
    opacity = f32(rng.uniform(0.3, 1.0, (6, 9)))
    rendered = f32(opacity * rng.uniform(0.8, 3.0, (6, 9)))
    measured = rng.uniform(0.8, 3.0, (6, 9)).astype(np.float32)
    measured[0, :3] = [0.0, np.nan, np.inf]
    mask = np.zeros((6, 9), np.uint8)
    mask[2:4, 5:7] = 255
    least = 0.5
    keep = (mask == 0) & np.isfinite(measured) & (measured > 0) & (opacity >= least)
    f = lambda d, o: magnitude(d / o - np.where(keep, measured, 0))[keep].mean()
    write_case("losses", "depth_masked", basis="complex-step", script=SCRIPT,
               why="depth missing in three ways, a mask, and places where little was drawn",
               params={"loss": "depth", "min_opacity": least},
               inputs={"depth": (rendered, "m"), "opacity": (opacity, "1"), "measured": (measured, "m"), "excluded": (mask, "0 judged")},
               outputs={"value": (np.array([f(rendered, opacity)]), "m", "losses.value"),
                        "by_depth": (gradient(lambda d: f(d, opacity), rendered), "1", "losses.gradient"),
                        "by_opacity": (gradient(lambda o: f(rendered, o), opacity), "m", "losses.gradient")})


def opacity():
    logits = np.array([-40.0, -3.0, -0.7, 0.0, 0.2, 1.5, 4.0, 9.0, 40.0, 0.9])
    dynamic = np.array([1, 1, 1, 1, 0, 1, 1, 1, 1, 0], np.uint8)
    f = lambda o: (dynamic / (1 + np.exp(-o)) ** 2).sum()
    write_case("losses", "opacity", basis="complex-step", why="logits from transparent to opaque, two of them static", script=SCRIPT,
               equations=["paper:12"], params={"loss": "opacity"}, inputs={"logits": (logits, "1"), "dynamic": (dynamic, "1")},
               outputs={"value": (np.array([f(logits)]), "1", "losses.value"), "gradient": (gradient(f, logits), "1", "losses.logit_gradient")})


def main():
    x, y = pictures(3, 7, 5)
    for kind in ("l1", "ssim"):
        color_case(kind, f"{kind}_small", "7 x 5 px, smaller than the window", x, y, None)
    x, y = pictures(5, 21, 17)
    mask = np.zeros((21, 17), np.uint8)
    mask[6:14, 4:11], mask[0, 0] = 255, 128
    color_case("photometric", "photometric_whole", "the mix with its usual weight", x, y, None)
    color_case("photometric", "photometric_masked", "moving pixels neither count nor leak", x, y, mask, 0.35)
    color_case("ssim", "ssim_flat", "flat pictures: only the constants keep the quotients apart", np.full((9, 12, 3), 0.5), np.full((9, 12, 3), 0.75), None,
               flags=["flat"])
    depth()
    opacity()


if __name__ == "__main__":
    main()
