"""Training losses (the book, chapter 11); their gradients by autograd."""

import torch
from torch.nn.functional import conv2d, logsigmoid

RADIUS, SIGMA, C1, C2 = 5, 1.5, 1e-4, 9e-4
TAPS = torch.exp(-torch.arange(-RADIUS, RADIUS + 1, dtype=torch.float64) ** 2 / (2 * SIGMA**2))
TAPS = TAPS / TAPS.sum()


def smooth(a):
    """[H, W, 3], rows then columns, zeros outside."""
    a = a.permute(2, 0, 1)[:, None]
    a = conv2d(a, TAPS.reshape(1, 1, 1, -1), padding=(0, RADIUS))
    return conv2d(a, TAPS.reshape(1, 1, -1, 1), padding=(RADIUS, 0))[:, 0].permute(1, 2, 0)


def l1(x, y, keep):
    return torch.where(keep[..., None], x - y, 0.0).abs().sum() / (3 * keep.sum())


def ssim(x, y, keep):
    x = torch.where(keep[..., None], x, y)
    mx, my = smooth(x), smooth(y)
    vx, vy, vxy = smooth(x * x) - mx * mx, smooth(y * y) - my * my, smooth(x * y) - mx * my
    s = (2 * mx * my + C1) * (2 * vxy + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))
    return torch.where(keep[..., None], s, 0.0).sum() / (3 * keep.sum())


def photometric(x, y, weight, keep):
    return (1 - weight) * l1(x, y, keep) + weight * (1 - ssim(x, y, keep))


def depth(rendered, opacity, measured, least, keep):
    keep = keep & measured.isfinite() & (measured > 0) & (opacity >= least)
    expected = rendered / torch.where(keep, opacity, 1.0)
    return torch.where(keep, expected - torch.where(keep, measured, 0.0), 0.0).abs().sum() / keep.sum().clamp(min=1)


def penalty(logits, dynamic):
    # o^2 as exp(2 ln o): autograd of sigmoid forms o (1 - o), which is 0 from logits of 37 on.
    return torch.where(dynamic > 0, (2 * logsigmoid(logits)).exp(), 0.0).sum()


def stage(case):
    kind = case.params["loss"]
    if kind == "opacity":
        logits = case["logits"].requires_grad_()
        value = penalty(logits, case["dynamic"])
        return {"value": value.reshape(1), "gradient": torch.autograd.grad(value, logits)[0]}
    x = case["depth" if kind == "depth" else "rendered"].requires_grad_()
    keep = case["excluded"] == 0 if "excluded" in case else torch.ones(x.shape[:2], dtype=torch.bool)
    if kind == "depth":
        o = case["opacity"].requires_grad_()
        value = depth(x, o, case["measured"], case.params["min_opacity"], keep)
        by_depth, by_opacity = torch.autograd.grad(value, (x, o))
        return {"value": value.reshape(1), "by_depth": by_depth, "by_opacity": by_opacity}
    y = case["target"]
    value = {"l1": lambda: l1(x, y, keep), "ssim": lambda: ssim(x, y, keep),
             "photometric": lambda: photometric(x, y, case.params["lambda"], keep)}[kind]()
    return {"value": value.reshape(1), "gradient": torch.autograd.grad(value, x)[0]}
