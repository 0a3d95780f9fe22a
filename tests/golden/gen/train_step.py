"""Golden cases of whole training iterations: static Gaussians drawn, compared with a picture and its depth,
gradients, one step of Adam; then the same from another pose. Gradients are complex steps through the independent
renderer of raster_backward.py and the losses of losses.py; Adam's moments are the closed form of adam.py. No
derivative is written by hand.

    L = p ((1 - l) L1 + l (1 - SSIM)) + d L_depth + m sum of opacity^2 over the dynamic ones

Inputs are rounded to float32, so that a float32 implementation reads the same scene.

    Needs: numpy (2.4.6), scipy (1.17.1). Run: python3 train_step.py (a minute)
"""

import numpy as np
from adam import steps
from case import write_case
from losses import l1, magnitude, ssim
from raster import CELL, LONG, MAX_ALPHA, MIN_ALPHA, MIN_T, f32, random_scene, rotation
from raster_backward import COMPLEX, H, nudged, project

TENSORS = ["means", "log_scales", "quaternions", "opacity_logits", "sh"]
WEIGHTS = {"lambda_photometric": 0.8, "lambda_ssim": 0.2, "lambda_depth": 0.1, "lambda_dynamic": 0.2, "min_opacity": 0.5}
# As trained with, times ten: two steps must be seen.
RATES = {"means": 2e-3, "log_scales": 5e-2, "quaternions": 1e-2, "opacity_logits": 0.25, "sh": 2.5e-2, "sh_rest_divisor": 20.0}


def pictures(s, view, nudge):
    """Colour, depth and opacity of the static Gaussians."""
    (width, height), pose = s["size"], (rotation(view["q"]).astype(COMPLEX), np.array(view["t"], COMPLEX))
    static = [i for i in range(len(s["means"])) if not s["dynamic"][i]]
    splats = [p for p in (project(s, i, pose, nudge, False) for i in static) if p]
    splats.sort(key=lambda p: p["order"])
    y, x = np.mgrid[0:height, 0:width]
    color, depth = np.zeros((height, width, 3), COMPLEX), np.zeros((height, width), COMPLEX)
    left, open_, robust = np.ones((height, width), COMPLEX), np.ones((height, width), bool), np.ones((height, width), bool)
    for p in splats:
        c0, c1, r0, r1 = p["cells"]
        inside = (x >= CELL * c0) & (x < CELL * c1) & (y >= CELL * r0) & (y < CELL * r1)
        (a, b, c), dx, dy = p["conic"], x - p["mean_px"][0], y - p["mean_px"][1]
        alpha = p["opacity"] * np.exp(-(a * dx**2 + 2 * b * dx * dy + c * dy**2) / 2)
        alpha = np.where(alpha.real > MAX_ALPHA, MAX_ALPHA, alpha)
        robust &= ~(inside & open_ & (abs(alpha.real / MIN_ALPHA - 1) < 1e-4))
        thick = inside & open_ & (alpha.real >= MIN_ALPHA)
        behind = left * (1 - alpha)
        open_ &= ~(thick & (behind.real < MIN_T))
        weight = np.where(thick & open_, alpha * left, 0)
        color, depth = color + weight[..., None] * p["color"], depth + weight * p["depth_m"]
        left = np.where(thick & open_, behind, left)
    return color, depth, 1 - left, len(splats), int((~robust).sum())


def loss(s, view, nudge):
    color, depth, opacity, seen, near = pictures(s, view, nudge)
    w, keep = WEIGHTS, view["excluded"] == 0
    x, y = color.astype(np.complex128), view["target"]
    value = w["lambda_photometric"] * ((1 - w["lambda_ssim"]) * l1(x, y, keep) + w["lambda_ssim"] * (1 - ssim(x, y, keep)))
    judged = keep & (view["depth"] > 0) & (opacity.real >= w["min_opacity"])
    value += w["lambda_depth"] * magnitude(depth[judged] / opacity[judged] - view["depth"][judged]).mean()
    for i in np.flatnonzero(s["dynamic"]):
        o = 1 / (1 + np.exp(-nudged(s["opacity_logits"][i], "opacity_logits", i, nudge)))
        value += w["lambda_dynamic"] * o.item() ** 2
    return value, (seen, near, int(judged.sum()))


def gradient(s, view):
    found = {name: np.zeros(s[name].shape) for name in TENSORS}
    for name in TENSORS:
        rows = s[name].reshape(len(s["means"]), -1)
        for i in range(len(rows)):
            # A dynamic Gaussian is not drawn: only the penalty moves it.
            if s["dynamic"][i] and name != "opacity_logits":
                continue
            for k in range(rows.shape[1]):
                found[name].reshape(len(rows), -1)[i, k] = float(loss(s, view, (name, i, k))[0].imag / H)
    return found


def view_of(s, seed, q, t):
    """What the camera sees of a map that is a little different, with a hole in depth and a mask."""
    rng = np.random.default_rng(seed)
    other = dict(s, means=s["means"] + rng.normal(0, 0.03, s["means"].shape), sh=s["sh"] + rng.normal(0, 0.3, s["sh"].shape))
    view = {"q": np.array(q, np.float64), "t": np.array(t, np.float64)}
    color, depth, opacity, _, _ = pictures(other, view, None)
    height, width = opacity.shape
    view["target"] = f32(np.clip(color.real.astype(float) + rng.normal(0, 0.02, color.shape), 0, 1))
    view["depth"] = f32(np.where(opacity.real > 0.6, (depth / np.maximum(opacity.real, 0.1)).real, 0) * rng.uniform(0.9, 1.1, (height, width)))
    view["depth"][3:7, 5:9] = 0
    view["excluded"] = np.zeros((height, width), np.uint8)
    view["excluded"][10:16, 12:20] = 255
    return view


def main():
    size, k, n = (36, 28), (40.0, 42.0, 17.3, 14.2), 9
    q, t = (0.95, 0.1, -0.2, 0.15), (0.2, -0.1, 0.3)
    s = random_scene(71, n, size, k, 1, 3.0, 0.12, q, t)
    s["opacity_logits"] = f32(np.linspace(-1.5, 2.0, n))
    s["dynamic"] = np.array([0, 0, 1, 0, 0, 0, 1, 0, 0], np.uint8)
    views = [view_of(s, 73, q, t), view_of(s, 79, (0.96, 0.06, -0.17, 0.2), (0.25, -0.05, 0.35))]
    now, slopes, outputs = {name: s[name].copy() for name in TENSORS}, [], {}
    for step, view in enumerate(views):
        value, found = loss(dict(s, **now), view, None)
        slopes.append(gradient(dict(s, **now), view))
        outputs[f"loss_{step}"] = (np.array([float(value.real)]), "1", "train_step.loss")
        print(f"view {step}: {found[0]} splats, {found[1]} px near a cut, {found[2]} px with depth, loss {value.real:.6f}")
        for name in TENSORS:
            g = np.stack([slope[name].reshape(-1) for slope in slopes])
            rates = np.full(s[name].shape, RATES[name])
            if name == "sh":
                rates[:, 1:] /= RATES["sh_rest_divisor"]
            moved = np.zeros(g.shape[1])
            for j, rate in enumerate(rates.reshape(-1)):
                # The last step alone: earlier ones are in `now`. No gradient, no step.
                moved[j] = float(steps(g[:, j], [rate] * len(g))[-1]) if np.any(g[:, j]) else 0.0
            nonzero = abs(g[-1][g[-1] != 0])
            print(f"  {name}: gradient {nonzero.min():.1e} to {nonzero.max():.1e}")
            now[name] = now[name] - moved.reshape(s[name].shape)
            outputs[f"d_{name}_{step}"] = (slopes[-1][name], "1", "train_step.gradient")
            outputs[f"{name}_{step}"] = (now[name].copy(), "1", "train_step.parameter")
    inputs = {"intrinsics": (np.array(k), "px: fx fy cx cy"), "background": (np.zeros(3), "1"), "dynamic": (s["dynamic"], "1"),
              **{name: (s[name], "1") for name in TENSORS}}
    for step, view in enumerate(views):
        inputs |= {f"camera_from_world_q_{step}": (view["q"], "w x y z"), f"camera_from_world_t_{step}": (view["t"], "m"),
                   f"target_{step}": (view["target"], "1"), f"measured_{step}": (view["depth"].astype(np.float32), "m"),
                   f"excluded_{step}": (view["excluded"], "0 judged")}
    write_case("train_step", "two_views", basis="complex-step", script="gen/train_step.py", seed=71,
               equations=["paper:12", "paper:13", "paper:15", "O3", "O4", "O5", "O6"],
               why="two iterations from two poses: render, losses, gradients, Adam; two Gaussians are dynamic, part is masked, depth has a hole",
               params={"width": size[0], "height": size[1], "sh_degree": 1, "iterations": 2, "beta1": 0.9, "beta2": 0.999, "eps": 1e-15,
                       **WEIGHTS, **{f"rate_{name}": rate for name, rate in RATES.items()}},
               inputs=inputs, outputs=outputs)


if __name__ == "__main__":
    main()
