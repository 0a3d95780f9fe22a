"""PyTorch's own Adam, and whole training iterations (the book, chapter 12)."""

import torch

import losses
import splat


def adam_of(tensor, params, rate=1.0):
    return torch.optim.Adam([tensor], lr=rate, betas=(params["beta1"], params["beta2"]), eps=params["eps"])


def adam_stage(case):
    gradients, rates, p = case["gradients"], case["learning_rates"], case.params
    kept = case["kept"] > 0 if "kept" in case else torch.ones(len(case["start"]), dtype=torch.bool)
    everything = case["start"].clone()
    rows = torch.arange(len(kept))                      # which rows of `start` there are
    now = everything[rows].clone().requires_grad_()
    optimiser, path = adam_of(now, p), []
    for t, (gradient, rate) in enumerate(zip(gradients, rates)):
        if t == p.get("change_after", -1):
            # Rows leave; rows come with moments of zero, and with the count of the others.
            state, new = optimiser.state[now], torch.arange(len(kept), len(everything))
            rows = torch.cat([rows[kept], new])
            now = torch.cat([now.detach()[kept], everything[new]]).requires_grad_()
            optimiser = adam_of(now, p)
            optimiser.state[now] = {"step": state["step"]} | {
                m: torch.cat([state[m][kept], torch.zeros_like(everything[new])]) for m in ("exp_avg", "exp_avg_sq")}
        optimiser.param_groups[0]["lr"] = rate.item()
        now.grad = gradient[rows].clone()
        optimiser.step()
        row = torch.full_like(everything, float("nan"))
        row[rows] = now.detach()
        path.append(row)
    return {"path": torch.stack(path)}


def stage(case):
    p, dynamic, out = case.params, case["dynamic"], {}
    now = {name: case[name].clone() for name in splat.NAMES}
    now["sh_rest"], now["sh"] = now["sh"][:, 1:].clone(), now["sh"][:, :1].clone()
    rate = {name: p[f"rate_{name}"] for name in splat.NAMES}
    rate["sh_rest"] = rate["sh"] / p["rate_sh_rest_divisor"]
    optimisers = {name: adam_of(tensor.requires_grad_(), p, rate[name]) for name, tensor in now.items()}
    for step in range(p["iterations"]):
        g = {name: now[name] for name in splat.NAMES} | {"sh": torch.cat([now["sh"], now["sh_rest"]], 1)}
        camera, keep = splat.camera_of(case, f"_{step}"), case[f"excluded_{step}"] == 0
        s = splat.paint(splat.project(g, camera), g, camera)
        s["visible"] = s["visible"] & (dynamic == 0)
        image = splat.blend(s, camera["size"], case["background"])
        loss = p["lambda_photometric"] * losses.photometric(image["color"], case[f"target_{step}"], p["lambda_ssim"], keep)
        loss = loss + p["lambda_depth"] * losses.depth(image["depth"], 1 - image["transmittance"],
                                                       case[f"measured_{step}"], p["min_opacity"], keep)
        loss = loss + p["lambda_dynamic"] * losses.penalty(g["opacity_logits"], dynamic)
        for optimiser in optimisers.values():
            optimiser.zero_grad()
        loss.backward()
        out[f"loss_{step}"] = loss.reshape(1)
        found = {name: now[name].grad.clone() for name in now}
        for optimiser in optimisers.values():
            optimiser.step()
        for table, values in (("d_", found), ("", now)):
            for name in splat.NAMES:
                tensor = values[name].detach().clone()
                if name == "sh":
                    tensor = torch.cat([tensor, values["sh_rest"].detach()], 1)
                out[f"{table}{name}_{step}"] = tensor
    return out
