"""From splats to images and back (the book: splatting.md, backward.md). Every splat meets every pixel: no tiles, no
early stop, sums over whole images in numpy's order."""

import numpy as np

import splats as sp

F = np.float32
MIN_ALPHA, MAX_ALPHA, MIN_T = F(1 / 255), F(0.99), F(1e-4)


def pixel_grid(size):
    """Pixel centres are whole numbers."""
    y, x = np.mgrid[0:size[1], 0:size[0]]
    return x.astype(F), y.astype(F)


def leftover(color, left, background):
    """What is not covered shows the background."""
    return color + left[..., None] * background


def is_last(behind):
    """A pixel is finished before this splat."""
    return behind < MIN_T


def blend(splats, size, background, tape=None):
    """Front to back; `tape` keeps what the backward pass needs."""
    x, y = pixel_grid(size)
    columns, rows = np.arange(size[0]), np.arange(size[1])[:, None]
    shape = (size[1], size[0])
    color, depth, left = np.zeros((*shape, 3), F), np.zeros(shape, F), np.ones(shape, F)
    count, rank, last, open_ = (np.zeros(shape, np.int32) for _ in range(3)), None, None, np.ones(shape, bool)
    count, rank, last = count
    for i in sp.sort_keys(splats):
        if not splats["visible"][i]:
            continue
        x0, y0, x1, y1 = splats["footprint"][i]
        inside = (columns >= x0) & (columns < x1) & (rows >= y0) & (rows < y1)
        rank += inside
        a, shear, inv_yy = splats["conic"][i, 0], -splats["cov"][i, 1] / splats["cov"][i, 2], 1 / splats["cov"][i, 2]
        dx, dy = x - splats["mean_px"][i, 0], y - splats["mean_px"][i, 1]
        slant = dx + shear * dy
        dense = splats["opacity"][i] * np.exp(F(-0.5) * (a * slant * slant + dy * dy * inv_yy))
        alpha = np.minimum(MAX_ALPHA, dense)
        thick = inside & open_ & (alpha >= MIN_ALPHA)
        behind = left * (1 - alpha)
        open_ &= ~(thick & is_last(behind))
        drawn = thick & open_
        weight = np.where(drawn, alpha * left, F(0))
        if tape is not None:
            tape.append((i, drawn, alpha, dense, left, weight, dx, dy, slant, a, shear, inv_yy))
        color += weight[..., None] * splats["color"][i]
        depth += weight * splats["depth_m"][i]
        left = np.where(drawn, behind, left)
        count += drawn
        last = np.where(drawn, rank, last)
    return {"color": leftover(color, left, background), "depth": depth, "transmittance": left, "contributors": count, "last": last}


def blend_backward(tape, splats, background, g_color, g_depth, g_opacity, pass_through):
    """Back to front: what a unit of light brings behind splat i (R13), then the density (R14)."""
    n = len(splats["index"])
    g = {"mean_px": np.zeros((n, 2), F), "cov": np.zeros((n, 3), F), "conic": np.zeros((n, 3), F), "opacity": np.zeros(n, F),
         "color": np.zeros((n, 3), F), "depth": np.zeros(n, F)}
    light = (g_color * background).sum(2) - g_opacity
    for i, drawn, alpha, dense, left, weight, dx, dy, slant, a, shear, inv_yy in reversed(tape):
        gain = (g_color * splats["color"][i]).sum(2) + g_depth * splats["depth_m"][i]
        d_alpha = np.where(drawn, left * (gain - light), F(0))
        light = np.where(drawn, alpha * gain + (1 - alpha) * light, light)
        g["color"][i], g["depth"][i] = (weight[..., None] * g_color).sum((0, 1)), (weight * g_depth).sum()
        power = dense * d_alpha
        if not pass_through:
            power = np.where(dense > MAX_ALPHA, F(0), power)
        vx = a * slant
        vy = shear * vx + dy * inv_yy
        g["mean_px"][i] = (power * vx).sum(), (power * vy).sum()
        g["cov"][i] = F(0.5) * (power * vx * vx).sum(), (power * vx * vy).sum(), F(0.5) * (power * vy * vy).sum()
        g["conic"][i] = F(-0.5) * (power * dx * dx).sum(), -(power * dx * dy).sum(), F(-0.5) * (power * dy * dy).sum()
        g["opacity"][i] = power.sum() / splats["opacity"][i]
    return g


def scene(case):
    return {name: case[name] for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}


def forward(case):
    gaussians, camera = scene(case), sp.view(case)
    s = sp.paint(sp.project(gaussians, camera), gaussians, camera)
    out = blend(s, camera["size"], case["background"])
    order = np.array([i for i in sp.sort_keys(s) if s["visible"][i]], np.int32)
    rows = {"mean_px": "mean_px", "depth_m": "depth_m", "conic": "conic", "splat_color": "color"}
    return {**out, "radii": s["radius"], "order": order, **{name: s[field][order] for name, field in rows.items()}}


def backward(case):
    gaussians, camera, tape = scene(case), sp.view(case), []
    s = sp.paint(sp.project(gaussians, camera), gaussians, camera)
    blend(s, camera["size"], case["background"], tape)
    passing = case.params["clamp_gradient"] == "pass_through"
    g = blend_backward(tape, s, case["background"], case["upstream_color"], case["upstream_depth"], case["upstream_opacity"], passing)
    found = sp.project_backward(g, s, gaussians, camera, passing)
    out = {"d_" + name: value for name, value in found.items()}
    return out | {"d_means2d": g["mean_px"], "d_conics": g["conic"], "d_opacities": g["opacity"], "d_colors": g["color"], "d_depths": g["depth"]}
