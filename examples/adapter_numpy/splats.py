"""From Gaussians to splats and back (the book: splatting.md, backward.md). Arrays over all Gaussians; nothing is
formed that loses digits in float32."""

import numpy as np

import harmonics

F = np.float32
NEAR_M, BLUR_PX2, CLAMP, CELL = F(0.2), F(0.3), F(1.3), 16


def quaternion_rows(q):
    """Columns w, x, y, z of unit length, and the lengths there were."""
    length = np.sqrt((q * q).sum(-1, keepdims=True))
    return q / length, length


def rotation(q):
    """[..., 3, 3] of (w, x, y, z): own axes to the world's, or world to camera (R2)."""
    w, x, y, z = np.moveaxis(quaternion_rows(q)[0], -1, 0)
    one = np.ones_like(w)
    return np.stack([
        np.stack([one - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        np.stack([2 * (x * y + w * z), one - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), one - 2 * (x * x + y * y)], -1),
    ], -2)


def sort_keys(splats):
    """Front to back: depth, then row in the map (R8)."""
    return np.lexsort((splats["index"], splats["depth_m"]))


def view(case):
    return {"w": rotation(case["camera_from_world_q"]), "t": case["camera_from_world_t"], "k": case["intrinsics"],
            "size": (case.params["width"], case.params["height"])}


def project(gaussians, camera):
    """Every Gaussian's splat; `visible` says which exist."""
    w, t, (fx, fy, cx, cy), (width, height) = camera["w"], camera["t"], camera["k"], camera["size"]
    p = gaussians["means"] @ w.T + t
    with np.errstate(divide="ignore", invalid="ignore"):
        s = {"p": p, "depth_m": p[:, 2], "index": np.arange(len(p))}
        z = p[:, 2]
        s["mean_px"] = np.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy], 1)
        limit = np.array([CLAMP * width / (2 * fx), CLAMP * height / (2 * fy)], F)
        free = p[:, :2] / z[:, None]
        s["slope"], s["clamped"] = np.clip(free, -limit, limit), abs(free) > limit
        # J W: (f / z) (w_a - s_a w_3); M = J W R S, columns are the half-axes in pixels.
        f = np.array([fx, fy], F)
        s["f_over_z"] = f / z[:, None]
        s["jw"] = s["f_over_z"][..., None] * (w[None, :2] - s["slope"][..., None] * w[2])
        s["r"], s["sigma"] = rotation(gaussians["quaternions"]), np.exp(gaussians["log_scales"])
        s["m"] = m = s["jw"] @ (s["r"] * s["sigma"][:, None, :])
        xx, xy, yy = (m[:, 0] ** 2).sum(1), (m[:, 0] * m[:, 1]).sum(1), (m[:, 1] ** 2).sum(1)
        # det(M M^T) as a sum of squares: a c - b^2 loses needles.
        cross = lambda j, k: m[:, 0, j] * m[:, 1, k] - m[:, 1, j] * m[:, 0, k]
        det = cross(0, 1) ** 2 + cross(1, 2) ** 2 + cross(0, 2) ** 2 + BLUR_PX2 * (xx + yy) + BLUR_PX2 * BLUR_PX2
        xx, yy = xx + BLUR_PX2, yy + BLUR_PX2
        s["cov"], s["conic"] = np.stack([xx, xy, yy], 1), np.stack([yy, -xy, xx], 1) / det[:, None]
        largest = (xx + yy) / 2 + np.sqrt(np.maximum(F(0.1), ((xx - yy) / 2) ** 2 + xy * xy))
        radius = np.ceil(3 * np.sqrt(largest))
        low = np.floor((s["mean_px"] - radius[:, None]) / CELL)
        high = np.floor((s["mean_px"] + radius[:, None] + (CELL - 1)) / CELL)
        cells = [np.clip(np.nan_to_num(e), 0, [-(-width // CELL), -(-height // CELL)]).astype(int) for e in (low, high)]
    s["footprint"] = np.hstack([np.minimum(CELL * e, [width, height]) for e in cells])   # x0 y0 x1 y1
    s["visible"] = (z > NEAR_M) & (cells[0] < cells[1]).all(1)
    s["radius"] = np.where(s["visible"], np.nan_to_num(radius), 0).astype(np.int32)
    return s


def paint(splats, gaussians, camera):
    """Opacity and colour (R7, R9)."""
    offset = gaussians["means"] + camera["t"] @ camera["w"]
    splats["distance"] = np.sqrt((offset * offset).sum(1, keepdims=True))
    splats["direction"] = offset / splats["distance"]
    sh = gaussians["sh"]
    splats["basis"] = harmonics.basis(splats["direction"], sh.shape[1])
    color = F(0.5) + np.einsum("nk,nkc->nc", splats["basis"], sh)
    splats["lit"], splats["color"] = color > 0, np.maximum(color, 0)
    splats["opacity"] = 1 / (1 + np.exp(-gaussians["opacity_logits"]))
    return splats


def project_backward(g, splats, gaussians, camera, pass_through):
    """From gradients by centre, covariance, colour, opacity, depth to those by the parameters and the pose."""
    w, (fx, fy, _, _), p = camera["w"], camera["k"], splats["p"]
    z, m, r, sigma, seen = p[:, 2], splats["m"], splats["r"], splats["sigma"], splats["visible"][:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        # R15, R16
        gxx, gxy, gyy = (g["cov"][:, k, None] for k in range(3))
        dm = np.stack([2 * gxx * m[:, 0] + gxy * m[:, 1], gxy * m[:, 0] + 2 * gyy * m[:, 1]], 1)
        d_jw = (dm * sigma[:, None]) @ np.swapaxes(r, 1, 2)
        d_r = np.swapaxes(splats["jw"], 1, 2) @ (dm * sigma[:, None])
        d_log = (m * dm).sum(1)
        # R17
        h = d_jw @ w.T
        ds = -splats["f_over_z"] * h[..., 2]
        held = np.where(splats["clamped"], F(0), ds)
        in_z = ds if pass_through else held
        d_p = np.zeros_like(p)
        d_p[:, :2] = held / z[:, None]
        d_p[:, 2] = -((d_jw * splats["jw"]).sum(2) + splats["slope"] * in_z).sum(1) / z
        j = np.zeros_like(h)
        j[:, 0, 0], j[:, 1, 1] = splats["f_over_z"][:, 0], splats["f_over_z"][:, 1]
        j[..., 2] = -splats["f_over_z"] * splats["slope"]
        d_turn = np.cross(h, j).sum(1)
        # R1, R20
        gu, gv = g["mean_px"][:, 0], g["mean_px"][:, 1]
        d_p += np.stack([fx * gu / z, fy * gv / z, -(fx * gu * p[:, 0] + fy * gv * p[:, 1]) / (z * z) + g["depth"]], 1)
        # R19
        lit = np.where(splats["lit"], g["color"], 0)
        d_sh = splats["basis"][:, :, None] * lit[:, None]
        slopes = harmonics.tangent_gradient(splats["direction"], gaussians["sh"].shape[1])
        d_offset = np.einsum("nk,nkd->nd", (gaussians["sh"] * lit[:, None]).sum(2), slopes) / splats["distance"]
        d_mean = d_p @ w + d_offset
        d_move, d_turn = d_p + d_offset @ w.T, np.cross(p, d_p) + d_turn
        o = splats["opacity"]
    clean = lambda a: np.where(seen.reshape((-1,) + (1,) * (a.ndim - 1)), a, F(0)).astype(F)
    return {
        "means": clean(d_mean), "log_scales": clean(d_log), "quaternions": clean(rotation_backward(d_r, gaussians["quaternions"])),
        "opacity_logits": clean(g["opacity"] * o * (1 - o)), "sh": clean(d_sh),
        "pose": np.concatenate([clean(d_move).sum(0), clean(d_turn).sum(0)]),
    }


def rotation_backward(g, q):
    """R18: the entries of R are quadratic in the unit quaternion; the result is orthogonal to q."""
    (w, x, y, z), length = quaternion_rows(q)[0].T, quaternion_rows(q)[1]
    e = lambda i, j: g[:, i, j]
    f = 2 * np.stack([
        x * (e(2, 1) - e(1, 2)) + y * (e(0, 2) - e(2, 0)) + z * (e(1, 0) - e(0, 1)),
        y * (e(0, 1) + e(1, 0)) + z * (e(0, 2) + e(2, 0)) + w * (e(2, 1) - e(1, 2)) - 2 * x * (e(1, 1) + e(2, 2)),
        x * (e(0, 1) + e(1, 0)) + z * (e(1, 2) + e(2, 1)) + w * (e(0, 2) - e(2, 0)) - 2 * y * (e(0, 0) + e(2, 2)),
        x * (e(0, 2) + e(2, 0)) + y * (e(1, 2) + e(2, 1)) + w * (e(1, 0) - e(0, 1)) - 2 * z * (e(0, 0) + e(1, 1)),
    ], 1)
    unit = np.stack([w, x, y, z], 1)
    return (f - (f * unit).sum(1, keepdims=True) * unit) / length


def stage(case):
    gaussians = {name: case[name] for name in ("means", "log_scales", "quaternions")}
    s = project(gaussians, view(case))
    out = {"p_cam": s["p"], "rotation": s["r"]}
    return out | {name: s[name][s["visible"]] for name in ("mean_px", "depth_m", "conic", "radius", "footprint")}
