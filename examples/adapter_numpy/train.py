"""Whole training iterations (the book: training.md): render, losses, backward, Adam."""

import numpy as np

import losses
import render
import splats as sp
from adam import Adam

F = np.float32
TENSORS = ["means", "log_scales", "quaternions", "opacity_logits", "sh"]


def stage(case):
    p, now = case.params, {name: case[name] for name in TENSORS}
    optimisers, out, dynamic = {name: Adam(now[name].shape, p) for name in TENSORS}, {}, case["dynamic"]
    for step in range(p["iterations"]):
        camera = {"w": sp.rotation(case[f"camera_from_world_q_{step}"]), "t": case[f"camera_from_world_t_{step}"],
                  "k": case["intrinsics"], "size": (p["width"], p["height"])}
        keep, tape = case[f"excluded_{step}"] == 0, []
        s = sp.paint(sp.project(now, camera), now, camera)
        s["visible"] = s["visible"] & (dynamic == 0)
        image = render.blend(s, camera["size"], case["background"], tape)
        opacity = 1 - image["transmittance"]
        photo, by_color = losses.photometric(image["color"], case[f"target_{step}"], p["lambda_ssim"], keep)
        depth, by_depth, by_opacity = losses.depth(image["depth"], opacity, case[f"measured_{step}"], p["min_opacity"], keep)
        penalty, by_logit = losses.penalty(now["opacity_logits"], dynamic)
        g = render.blend_backward(tape, s, case["background"], F(p["lambda_photometric"]) * by_color,
                                  F(p["lambda_depth"]) * by_depth, F(p["lambda_depth"]) * by_opacity, False)
        found = sp.project_backward(g, s, now, camera, False)
        found["opacity_logits"] = found["opacity_logits"] + F(p["lambda_dynamic"]) * by_logit
        loss = p["lambda_photometric"] * photo + p["lambda_depth"] * depth + p["lambda_dynamic"] * penalty
        out[f"loss_{step}"] = F(loss).reshape(1)
        for name in TENSORS:
            rate = np.full(now[name].shape, p[f"rate_{name}"], F)
            if name == "sh":
                rate[:, 1:] /= F(p["rate_sh_rest_divisor"])
            now[name] = (now[name] - optimisers[name].step(found[name], rate)).astype(F)
            out[f"d_{name}_{step}"], out[f"{name}_{step}"] = found[name], now[name].copy()
    return out
