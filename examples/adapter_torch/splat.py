"""Gaussians to splats to images (the book, chapter 9), every splat against every pixel. Nothing here is
a gradient: autograd finds them all."""

import torch

import harmonics

NEAR_M, BLUR_PX2, CLAMP, CELL = 0.2, 0.3, 1.3, 16
MIN_ALPHA, MAX_ALPHA, MIN_T = 1 / 255, 0.99, 1e-4
NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


def rotation(q):
    """[..., 3, 3] of (w, x, y, z) of any length."""
    w, x, y, z = (q / q.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return torch.stack(rows, -1).reshape(q.shape[:-1] + (3, 3))


def hat(v):
    zero = torch.zeros(())
    return torch.stack([zero, -v[2], v[1], v[2], zero, -v[0], -v[1], v[0], zero]).reshape(3, 3)


def camera_of(case, suffix="", xi=None):
    """The pose, moved by exp(xi) on its left. First order is enough: only the derivative at 0 is asked for."""
    r, t = rotation(case["camera_from_world_q" + suffix]), case["camera_from_world_t" + suffix]
    if xi is not None:
        turn = torch.eye(3) + hat(xi[3:])
        r, t = turn @ r, turn @ t + xi[:3]
    return {"r": r, "t": t, "k": case["intrinsics"], "size": (case.params["width"], case.params["height"])}


def project(g, camera, pass_through=False):
    """Splats of all Gaussians; `visible` says which exist."""
    (fx, fy, cx, cy), (width, height) = camera["k"], camera["size"]
    f, c = torch.stack([fx, fy]), torch.stack([cx, cy])
    p = g["means"] @ camera["r"].T + camera["t"]
    z = p[:, 2:]
    mean_px = f * p[:, :2] / z + c
    limit = CLAMP * torch.tensor([width, height]) / (2 * f)
    free = p[:, :2] / z
    slope = free.clamp(-limit, limit)
    if pass_through:    # the CUDA rasterizer holds the clamped x and lets z move under it
        slope = torch.where(free.abs() > limit, (slope * z).detach() / z, slope)
    r = camera["r"]
    jw = (f / z)[..., None] * (r[:2] - slope[..., None] * r[2])
    # M = J W R S: columns are the half-axes in pixels; det(M M^T) as a sum of squares.
    m = jw @ (rotation(g["quaternions"]) * g["log_scales"].exp()[:, None, :])
    u, v = m[:, 0], m[:, 1]
    cross = torch.linalg.cross(u, v)
    xx, xy, yy = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    det = (cross * cross).sum(1) + BLUR_PX2 * (xx + yy) + BLUR_PX2**2
    xx, yy = xx + BLUR_PX2, yy + BLUR_PX2
    with torch.no_grad():
        largest = (xx + yy) / 2 + (((xx - yy) / 2) ** 2 + xy * xy).clamp(min=0.1).sqrt()
        radius = (3 * largest.sqrt()).ceil()[:, None]
        size = torch.tensor([width, height])
        low = ((mean_px - radius) / CELL).floor() * CELL
        high = ((mean_px + radius + CELL - 1) / CELL).floor() * CELL
        low, high = (e.nan_to_num().clamp(min=0).minimum(size).int() for e in (low, high))
        visible = (z[:, 0] > NEAR_M) & (low < high).all(1)
    return {"p": p, "mean_px": mean_px, "depth_m": p[:, 2], "a": yy / det, "shear": -xy / yy, "inv_yy": 1 / yy,
            "conic": torch.stack([yy, -xy, xx], 1) / det[:, None], "visible": visible,
            "radius": torch.where(visible, radius[:, 0].nan_to_num(), 0.0).int(), "footprint": torch.cat([low, high], 1)}


def paint(splats, g, camera):
    """Opacity, and the colour seen from the camera's centre -R^T t."""
    offset = g["means"] + camera["r"].T @ camera["t"]
    splats["color"] = harmonics.color(offset / offset.norm(dim=1, keepdim=True), g["sh"])
    splats["opacity"] = torch.sigmoid(g["opacity_logits"])
    splats["depth"] = splats["depth_m"] + 0.0           # a node of its own: depth as it is blended
    splats["d_conic"] = torch.zeros_like(splats["conic"], requires_grad=True)
    return splats


def blend(s, size, background, pass_through=False):
    """Front to back: depth, then row. Pixel centres are whole numbers."""
    width, height = size
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    color, depth, left = torch.zeros(height, width, 3), torch.zeros(height, width), torch.ones(height, width)
    count, rank, last = (torch.zeros(height, width, dtype=torch.int32) for _ in range(3))
    unfinished = torch.ones(height, width, dtype=torch.bool)
    order = [i for i in torch.sort(s["depth_m"].detach(), stable=True)[1].tolist() if s["visible"][i]]
    for i in order:
        x0, y0, x1, y1 = s["footprint"][i].tolist()
        inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
        rank = rank + inside.int()
        dx, dy = x - s["mean_px"][i, 0], y - s["mean_px"][i, 1]
        along = dx + s["shear"][i] * dy
        power = -0.5 * (s["a"][i] * along * along + s["inv_yy"][i] * dy * dy)
        # Adds nothing but its derivative, the gradient by the conic.
        hook = s["d_conic"][i]
        ex, ey = dx.detach(), dy.detach()
        power = power - 0.5 * (hook[0] * ex * ex + 2 * hook[1] * ex * ey + hook[2] * ey * ey)
        dense = s["opacity"][i] * power.exp()
        alpha = dense.clamp(max=MAX_ALPHA)
        if pass_through:
            alpha = dense + (alpha - dense).detach()
        with torch.no_grad():
            thick = inside & unfinished & (alpha >= MIN_ALPHA)
            unfinished &= ~(thick & (left * (1 - alpha) < MIN_T))
            drawn = thick & unfinished
        alpha = torch.where(drawn, alpha, 0.0)
        weight = alpha * left
        color = color + weight[..., None] * s["color"][i]
        depth = depth + weight * s["depth"][i]
        left = left * (1 - alpha)
        count, last = count + drawn.int(), torch.where(drawn, rank, last)
    return {"color": color + left[..., None] * background, "depth": depth, "transmittance": left,
            "contributors": count, "last": last, "order": torch.tensor(order, dtype=torch.int64)}


def render(g, camera, background, pass_through=False):
    s = paint(project(g, camera, pass_through), g, camera)
    return s, blend(s, camera["size"], background, pass_through)


def projection_stage(case):
    g = {name: case[name] for name in NAMES[:3]}
    s = project(g, camera_of(case))
    out = {"p_cam": s["p"], "rotation": rotation(g["quaternions"])}
    return out | {name: s[name][s["visible"]] for name in ("mean_px", "depth_m", "conic", "radius", "footprint")}


def forward_stage(case):
    s, image = render({name: case[name] for name in NAMES}, camera_of(case), case["background"])
    order = image.pop("order")
    rows = {"mean_px": "mean_px", "depth_m": "depth_m", "conic": "conic", "splat_color": "color"}
    return {**image, "radii": s["radius"], "order": order.int(), **{name: s[field][order] for name, field in rows.items()}}


def backward_stage(case):
    g, xi = {name: case[name].requires_grad_() for name in NAMES}, torch.zeros(6, requires_grad=True)
    pass_through = case.params["clamp_gradient"] == "pass_through"
    s, image = render(g, camera_of(case, xi=xi), case["background"], pass_through)
    loss = (case["upstream_color"] * image["color"]).sum() + (case["upstream_depth"] * image["depth"]).sum()
    loss = loss + (case["upstream_opacity"] * (1 - image["transmittance"])).sum()
    loss = loss + 0 * xi.sum()          # an empty map leaves no path to anything
    wanted = {"d_" + name: g[name] for name in NAMES} | {
        "d_pose": xi, "d_means2d": s["mean_px"], "d_conics": s["d_conic"], "d_opacities": s["opacity"],
        "d_colors": s["color"], "d_depths": s["depth"]}
    found = torch.autograd.grad(loss, list(wanted.values()), allow_unused=True)
    return {name: torch.zeros_like(t) if d is None else d for (name, t), d in zip(wanted.items(), found)}
