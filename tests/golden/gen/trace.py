"""What can be checked of a trace from outside: every stage's outputs computed a second time from its inputs, by
OpenCV, scipy, and the reference scripts of the single stages here. Writes basis.json beside the trace: for each
output who computed it again and how far apart the two are, or `pin`, if nobody did: such an output only guards
against change.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93 mpmath==1.3.0
    python3 tests/golden/gen/trace.py [TRACE]          (default: all of tests/golden/trace)

The traces themselves are made by garad from recordings made by garad; tests/golden/README.md has the commands.
"""

import json
import pathlib
import sys
import tomllib

import cv2
import numpy as np
from scipy import ndimage, optimize

import bundle
import crf
import densify
import flow
import losses
import orb
import pose_lm
import raster
from pyramid import orb_levels

CELL = 4
NONE = 2 ** 32 - 1  # no landmark
F = np.float32
DRAWN = ("means", "quaternions", "log_scales", "opacity_logits", "sh")


class Run(dict):
    """The tensors of one run of a stage, by name."""


class Checks:
    def __init__(self):
        self.found, self.problems = {}, []

    def same(self, run, name, expected, basis, abs_=0.0, rel=0.0, share=0.0):
        got, expected = np.asarray(run[name], float), np.asarray(expected, float)
        if got.shape != expected.shape:
            self.problems.append(f"{run.name} {name}: shape {got.shape}, {basis} has {expected.shape}")
            return
        equal = (got == expected) | (np.isnan(got) & np.isnan(expected))
        with np.errstate(invalid="ignore"):
            error = np.where(equal, 0, np.abs(got - expected))
            beyond = ~equal & ~(error <= abs_ + rel * np.abs(expected))
        if beyond.sum() > share * beyond.size:
            at = np.unravel_index(np.nanargmax(np.where(beyond, error, -1)), error.shape) if error.shape else ()
            self.problems.append(f"{run.name} {name}: at {tuple(map(int, at))} {got[at]!r}, {basis} has {expected[at]!r}; {int(beyond.sum())} differ")
            return
        entry = self.found.setdefault(f"{run.stage}/{name}", {"basis": basis, "allowed": max(abs_, rel), "worst": 0.0, "tensors": 0})
        if beyond.any():
            entry["beyond"] = entry.get("beyond", 0) + int(beyond.sum())
        entry["worst"] = max(entry["worst"], float(np.where(beyond, 0, error).max(initial=0)))
        entry["tensors"] += 1


def load(folder):
    index = json.loads((folder / "trace.json").read_text())
    runs = {}
    for e in index["tensors"]:
        run = runs.setdefault((e["frame"], e["stage"], e["call"]), Run())
        run.stage, run.frame, run.call = e["stage"], e["frame"], e["call"]
        run.name = f"frame {e['frame']} {e['stage']} {e['call']}"
        run[e["tensor"]] = np.load(folder / e["file"])
    return index, runs


def check_orb(checks, run, rgb, config):
    # OpenCV 3 counted in 14 bits, OpenCV 5 counts in 15: a grey level more or less where both are near a half.
    y = (rgb.astype(int) @ [4899, 9617, 1868] + 8192) >> 14
    if np.abs(y - cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)).max() > 1:
        checks.problems.append(f"{run.name} gray: more than a level from OpenCV")
    checks.same(run, "gray", y, "numpy: BT.601 in 14 bits; opencv: within a level")
    scales, levels = orb_levels(run["gray"])
    for l, level in enumerate(levels[1:], 1):
        checks.same(run, f"level_{l}", level, "opencv")
    again = orb.extract(run["gray"], int(run["wanted"].item()))
    for name, other in [("xy", "pt"), ("level", "level"), ("angle_deg", "angle"), ("response", "response"), ("descriptor", "descriptor")]:
        checks.same(run, name, again[other][0], "opencv + gen/orb.py")


def usable(z, config):
    return np.isfinite(z) & (z > 0) & (z <= config["features"]["max_depth_m"])


def check_keypoints(checks, run, features, depth, config):
    height, width = depth.shape
    sizes = [(l.shape[1], l.shape[0]) for l in orb_levels(features["gray"])[1]]
    scales = orb_levels(features["gray"])[0]
    ratio = np.array([(width / w, height / h) for w, h in sizes])
    level = features["level"]
    px = (features["xy"].astype(float) / np.array(scales, F)[level].astype(float)[:, None] + 0.5) * ratio[level] - 0.5
    checks.same(run, "px", px, "numpy: outer edges of the levels", abs_=1e-12)
    checks.same(run, "uv_px", px, "numpy: no distortion", abs_=1e-12)
    checks.same(run, "sigma_px", 1.2 ** level.astype(float), "numpy", rel=1e-6)
    nearest = np.floor(px + 0.5).astype(int)
    found = []
    for x, y in nearest:
        z = depth[y, x]
        around = depth[max(y - 1, 0):y + 2, max(x - 1, 0):x + 2]
        around = around[usable(around, config)]
        good = usable(z, config) and float(F(around.max() - around.min())) <= config["features"]["edge_ratio"] * float(z)
        found.append(float(z) if good else np.nan)
    checks.same(run, "depth_m", found, "numpy: 3 x 3 pixels")
    surface = []
    for x, y in nearest:
        offsets = [(x + dx, y + dy) for dy in range(-10, 11, 5) for dx in range(-10, 11, 5)]
        z = [float(depth[b, a]) for a, b in offsets if 0 <= a < width and 0 <= b < height]
        center = float(depth[y, x])
        surface.append(center > 0 and all(v <= 0 or abs(v - center) <= config["subpixel"]["surface_ratio"] * center for v in z))
    checks.same(run, "one_surface", surface, "numpy: 21 x 21 pixels")
    checks.same(run, "in_use", np.ones(len(px)), "no mask is given")


def pose_data(run):
    return dict(p_world=run["p_world"], uv=run["uv_px"], sigma=run["sigma_px"],
                right=np.stack([run["third_px"], run["third_sigma_px"]], 1))


def check_pose(checks, run, intrinsics, bf):
    """Four rounds from the same start, each to the optimum of those inside the gate before."""
    pose_lm.K = tuple(intrinsics)
    data, initial = pose_data(run), (run["before"][:, :3], run["before"][:, 3])
    n = len(data["uv"])
    prior = (run["prior_centre"], run["prior_root"]) if "prior_root" in run else None
    inlier = np.ones(n, bool)
    for round_ in range(4 if n >= 10 else 1):
        part = {k: v[inlier] for k, v in data.items()}
        robust = round_ <= 2
        rotation, t = pose_lm.solve_scipy(part, initial, bf, robust, prior)
        s, has = pose_lm.chi2(part, (rotation, t), bf)
        d2 = pose_lm.deltas2(has)
        cost = 0.5 * (np.where(s <= d2, s, 2 * np.sqrt(d2 * s) - d2) if robust else s).sum()
        if prior is not None:
            cost += 0.5 * (pose_lm.prior_residual(prior, rotation, t) ** 2).sum()
        s, has = pose_lm.chi2(data, (rotation, t), bf)
        inlier = s <= pose_lm.deltas2(has)
    # Steps end where the cost no longer falls by 1e-9 of itself: 1e-5 in the pose.
    checks.same(run, "after", np.c_[rotation, t], "scipy", abs_=3e-5)
    checks.same(run, "inlier", inlier, "scipy")
    checks.same(run, "cost", [cost], "scipy", rel=1e-8)


def planes(depth, config):
    """Inverse depth as a linear function of the pixel, by numpy's least squares, in blocks of 16 x 16."""
    noise, far, rows = config["depth_planes"]["noise"], config["features"]["max_depth_m"], []
    for y0 in range(0, depth.shape[0] - 15, 16):
        for x0 in range(0, depth.shape[1] - 15, 16):
            y, x = np.mgrid[-7.5:8, -7.5:8]
            z = depth[y0:y0 + 16, x0:x0 + 16].astype(float)
            good = (z > 0) & (z <= far)
            rows.append([np.nan] * 5)
            if good.sum() < 192:
                continue
            a, w = np.c_[x[good], y[good], np.ones(good.sum())], 1 / z[good]
            plane = np.linalg.lstsq(a, w, rcond=None)[0]
            middle = 1 / plane[2]
            stray = np.sqrt(((a @ plane - w) ** 2).mean()) * middle ** 2
            if plane[2] > 0 and stray <= 8 * max(noise["per_m"] * middle ** 2, noise["floor_m"]):
                rows[-1] = [x0 + 7.5, y0 + 7.5, *plane]
    return np.array(rows)


def depth_pose_cost(run, pose, intrinsics, size, config):
    """F of decision 009 at a pose, formula by formula."""
    fx, fy, cx, cy = intrinsics
    c, noise = config["depth_planes"], config["depth_planes"]["noise"]
    geman = lambda s, scale: s / (1 + s / scale ** 2)
    p = run["p_world"] @ pose[:, :3].T + pose[:, 3]
    r = (np.c_[fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy] - run["uv_px"]) / run["sigma_px"][:, None]
    cost = 0.5 * geman((r ** 2).sum(1), c["outlier_px"]).sum()
    if "prior_root" in run:
        prior = run["prior_centre"], run["prior_root"]
        cost += 0.5 * (pose_lm.prior_residual(prior, pose[:, :3], pose[:, 3]) ** 2).sum()
    others = sum(f"planes_{k}" in run for k in range(c["keyframes"]))
    now = run["planes"][~np.isnan(run["planes"][:, 0])]
    x, y, w = now[:, 0], now[:, 1], now[:, 4]
    p_world = (np.c_[(x - cx) / fx, (y - cy) / fy, np.ones(len(w))] / w[:, None] - pose[:, 3]) @ pose[:, :3]
    for k in range(others):
        then, other = run[f"planes_{k}"], run[f"pose_{k}"]
        q = p_world @ other[:, :3].T + other[:, 3]
        q = q[q[:, 2] >= 0.1]
        u, v = fx * q[:, 0] / q[:, 2] + cx, fy * q[:, 1] / q[:, 2] + cy
        columns, rows = size[0] // 16, size[1] // 16
        bx, by = np.floor((u + 0.5) / 16).astype(int), np.floor((v + 0.5) / 16).astype(int)
        inside = (bx >= 0) & (by >= 0) & (bx < columns) & (by < rows)
        q, u, v, plane = q[inside], u[inside], v[inside], then[(by * columns + bx)[inside]]
        expected = plane[:, 4] + plane[:, 2] * (u - plane[:, 0]) + plane[:, 3] * (v - plane[:, 1])
        good = expected > 0
        z = q[good, 2]
        offset = (1 / z - expected[good]) * z ** 2
        sigma = np.maximum(noise["per_m"] * z ** 2, noise["floor_m"])
        cost += 0.5 * geman((offset / sigma) ** 2 / others, c["outlier_sigmas"] / np.sqrt(others)).sum()
    return cost


def check_depth_pose(checks, run, intrinsics, size, config):
    cost = lambda pose: depth_pose_cost(run, pose, intrinsics, size, config)
    checks.same(run, "cost", [cost(run["after"])], "numpy: the formula at the pose found", rel=1e-9)
    if cost(run["after"]) > cost(run["before"]) * (1 + 1e-9):
        checks.problems.append(f"{run.name}: the cost has risen")


def field(nodes_of, config, log_odds):
    k, m = config["crf"]["kernels"], config["crf"]["mean_field"]
    o = crf.DEFAULT_FIELD | {name: k[name] for name in k} | {name: m[name] for name in ("normalisation", "self_message", "damping")}
    return crf.beliefs(nodes_of, log_odds, o, [m["iterations"]])[0]


def check_label(checks, run, config):
    labels, depth = config["labels"], config["crf"]["unary"]["depth"]
    residual, known = run["depth_residual"], ~np.isnan(run["depth_residual"])
    settled = np.minimum(run["agreed_frames"] / labels["settle_frames"], 1)
    trust = np.where(known, labels["trust_young"] + (labels["trust_old"] - labels["trust_young"]) * settled, labels["trust_unknown"])
    beyond = np.maximum(np.where(known, residual, 0) - depth["mean"], 0) / depth["sigma"]
    clamp = config["crf"]["unary"]["clamp"]
    likelihood = np.where(known, np.clip(np.exp(-beyond ** 2 / 2), clamp, 1 - clamp), 1)
    p = np.maximum(likelihood * trust, clamp)
    checks.same(run, "log_odds", np.log((1 - p) / p), "numpy: the formula of decision 005", abs_=1e-12)
    nan = np.full(len(p), np.nan)
    nodes = {"p_world": run["p_world"], "uv_px": run["px"], "reproj_px": nan, "observations": nan}
    # The fast field leaves pairs out; its own bound on that is what is allowed here.
    checks.same(run, "belief", field(nodes, config, run["log_odds"]), "gen/crf.py, every pair", abs_=2e-3)


def cells_of(px, belief, depth, threshold, config):
    """The mask in cells, from the beliefs of the lattice's samples."""
    step, (height, width) = config["labels"]["step_px"], depth.shape
    samples = {tuple((p // step).astype(int)): (p, b) for p, b in zip(px, belief)}
    z_of = {k: float(depth[int(p[1]), int(p[0])]) for k, (p, _) in samples.items()}
    rows, columns = -(-height // CELL), -(-width // CELL)
    cells = np.zeros((rows, columns))
    for cy in range(rows):
        for cx in range(columns):
            center = np.array([cx, cy]) * CELL + CELL / 2 - 0.5
            z = float(depth[min(cy * CELL + CELL // 2, height - 1), min(cx * CELL + CELL // 2, width - 1)])
            bx, by = cx * CELL // step, cy * CELL // step
            total = weights = 0.0
            for y in range(by - 1, by + 2):
                for x in range(bx - 1, bx + 2):
                    if (x, y) in samples:
                        p, b = samples[x, y]
                        w = np.maximum(1 - np.abs(p - center) / (1.5 * step), 0).prod()
                        if z > 0:
                            w *= np.exp(-0.5 * ((z_of[x, y] - z) / (config["labels"]["edge_ratio"] * z)) ** 2) + 1e-6
                        total, weights = total + w * b, weights + w
            cells[cy, cx] = 255 * (weights > 0 and total > threshold * weights)
    return cells


def at_keypoints(mask, keypoints):
    """Whether the cell of each keypoint is in the mask."""
    cell = np.floor((keypoints["px"] + 0.5) / CELL).astype(int)
    return mask[np.minimum(cell[:, 1], len(mask) - 1), np.minimum(cell[:, 0], len(mask[0]) - 1)] > 0


def check_masks(checks, run, label, keypoints, depth, config):
    threshold, with_depth = config["crf"]["threshold"], np.flatnonzero(~np.isnan(keypoints["depth_m"]))
    first = len(with_depth)
    cells = cells_of(label["px"][first:], label["belief"][first:], depth, threshold, config)
    moving = at_keypoints(cells, keypoints)
    moving[with_depth] |= label["belief"][:first] > threshold
    check_labels(checks, run, cells, moving, np.zeros(len(moving), bool), keypoints, config)


def check_labels(checks, run, cells, moving, restored, keypoints, config):
    checks.same(run, "cells", cells, "numpy: decision 005")
    checks.same(run, "label", moving, "numpy")
    reach = -(-config["labels"]["reach_px"] // CELL)
    near = ndimage.maximum_filter(cells, size=2 * reach + 1, mode="constant")
    checks.same(run, "in_use", ~moving & (restored | ~at_keypoints(near, keypoints)), "scipy: dilation by a square")


def check_gaussian_mask(checks, run, keypoints, levels, depth, camera, config):
    """The dynamic Gaussians whose surface is still there, drawn at three levels; who lies in them (decision 020)."""
    c, pose, (fx, fy, cx, cy) = config["labels"]["gaussian_mask"], run["camera_from_world"], camera["fx_fy_cx_cy"]
    project = lambda p: np.c_[fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy]
    p = run["means"].astype(float) @ pose[:, :3].T + pose[:, 3]
    at = np.floor(project(p) + 0.5)
    inside = (p[:, 2] > 0) & (at >= 0).all(1) & (at < np.array(depth.shape)[::-1]).all(1)
    x, y = np.where(inside, at.T, 0).astype(int)
    there = ~inside | ~(depth[y, x] > 0) | (np.abs(depth[y, x].astype(float) - p[:, 2]) < c["depth_m"])
    for level in range(3):
        drawn = draw({name: run[name][there] for name in DRAWN}, camera, level, pose)
        for name, other in [("opacity", 1 - drawn["transmittance"][0]), ("depth_m", drawn["depth"][0])]:
            checks.same(run, f"{name}_{level}", other, "gen/raster.py, dense, 80 bits", abs_=2e-4, share=2e-2)

    def in_mask(level, uv, z):
        opacity = run[f"opacity_{level}"].astype(float)
        x, y = np.floor(uv / 2 ** level + 0.5).astype(int)
        if not (0 <= x < opacity.shape[1] and 0 <= y < opacity.shape[0] and opacity[y, x] > c["opacity"]):
            return False
        return np.isnan(z) or abs(z - float(run[f"depth_m_{level}"][y, x]) / opacity[y, x]) < c["depth_m"]

    nearest = [int(np.argmin([abs(np.log(1.2 ** l / 2 ** level)) for level in range(3)])) for l in levels]
    moving = [in_mask(*of) for of in zip(nearest, keypoints["uv_px"], keypoints["depth_m"])]
    checks.same(run, "in_mask", moving, "numpy")
    first = int((~np.isnan(keypoints["depth_m"])).sum())
    blocks = project(run["p_world"] @ pose[:, :3].T + pose[:, 3])[first:]
    blocks = [in_mask(2, uv, z) for uv, z in zip(blocks, run["depth_m"][first:])]
    checks.same(run, "suspected", np.r_[np.array(moving)[~np.isnan(keypoints["depth_m"])], blocks], "numpy")


def check_restore(checks, run, mask, tracks, verdicts, features, keypoints, config):
    """Suspects whose flow is that of the static scene, and the landmarks they show."""
    rests = np.zeros(len(mask["suspected"]), bool)
    if verdicts is not None:
        suspects = np.flatnonzero(mask["suspected"])
        judged = suspects[tracks["tracked"][-len(suspects):] == 1]
        rests[judged] = verdicts["inside"] == 1
    checks.same(run, "rests", rests, "numpy, by the flow")
    with_depth = np.flatnonzero(~np.isnan(keypoints["depth_m"]))
    restored = with_depth[rests[:len(with_depth)]]
    checks.same(run, "keypoint", restored, "numpy")
    t, shown = config["tracking"], set()
    for i in restored:
        radius = t["local_radius_px"] * 1.2 ** float(features["level"][i])
        near = np.linalg.norm(run["dynamic_uv_px"] - keypoints["uv_px"][i], axis=1) < radius
        bits = np.unpackbits(run["dynamic_descriptor"] ^ features["descriptor"][i], axis=1).sum(1)
        best = min(((int(bits[k]), int(run["dynamic_landmark"][k])) for k in np.flatnonzero(near)), default=(257, 0))
        shown |= {best[1]} if best[0] <= t["match_distance"] else set()
    checks.same(run, "landmark", sorted(shown), "numpy")


def check_masks_of_gaussians(checks, run, mask, restore, keypoints, depth, config):
    first = int((~np.isnan(keypoints["depth_m"])).sum())
    moves = (mask["suspected"] == 1) & (restore["rests"] == 0)
    share = config["labels"]["gaussian_mask"]["surface_share"]
    cells = cells_of(mask["px"][first:], moves[first:].astype(float), depth, share, config)
    restored = np.isin(np.arange(len(keypoints["px"])), restore["keypoint"])
    moving = ~restored & ((mask["in_mask"] == 1) | at_keypoints(cells, keypoints))
    check_labels(checks, run, cells, moving, restored, keypoints, config)


def votes(means, voters, labels, c):
    """The label of each mean by its nearest voters; -1 where none is near enough."""
    found = np.full(len(means), -1)
    for i, mean in enumerate(means.astype(float)):
        distance = np.linalg.norm(voters.astype(float) - mean, axis=1)
        nearest = np.argsort(distance, kind="stable")[:c["neighbours"]]
        weight = np.maximum(1 - distance[nearest] / c["radius_m"], 0)
        if weight.sum() > 0:
            found[i] = weight[labels[nearest] == 1].sum() > weight[labels[nearest] == 0].sum()
    return found


def check_label_gaussians(checks, run, field, config):
    """The field's labels, the vote for those without a landmark, and the window of eq. 7."""
    n, label = config["labels"]["window"]["runs"], run["before"].astype(int)
    restored = np.isin(run["landmark"], run["restored"]) & (run["landmark"] != NONE)
    label[restored] = 0
    pushed = votes(run["means"], run["means"][run["voter"]], run["voter_label"], config["labels"]["spread"])
    pushed[run["landmark"] != NONE] = -1
    if field["label"].tolist() != run["voter_label"].tolist() or field["landmark"].tolist() != run["landmark"][run["voter"]].tolist():
        checks.problems.append(f"{run.name}: voters are not what the field labelled")
    pushed[run["voter"]] = run["voter_label"]
    checks.same(run, "label", np.where(pushed < 0, label, pushed), "numpy: decision 020")
    runs, moving = run["window"].T
    checks.same(run, "removed", (pushed == 1) & ~restored & (runs + 1 >= n) & (moving == n - 1), "numpy: eq. 7")


def check_densify(checks, run, config):
    """gen/densify.py on the map before, with the normal numbers drawn; then what is split, faded or too large goes."""
    names = [*DRAWN, "label", "landmark"]
    before = {name: run[f"before_{name}"] for name in names}
    mean = run["gradient"].astype(float) / np.maximum(run["seen"], 1)
    c, extent = config["densify"], float(run["extent_m"][0])
    o = {key: c[key] for key in ("grad_threshold", "split_extent", "max_gaussians")}
    o |= dict(extent_m=extent, young_from=int(run["young_from"][0]))
    grown = dict(before, born=run["born"].astype(int), mean=np.r_[mean, np.zeros(len(before["label"]) - len(mean))])
    split, new = densify.control(o, grown, run["normals"].ravel(), lambda value, _: value)
    parents = np.array([i for i, _, _ in new], int)
    every = {name: np.concatenate([v, v[parents]]) for name, v in before.items()}
    every["landmark"][len(split):] = NONE
    if new:
        every["means"] = np.concatenate([before["means"], [m for _, m, _ in new]])
        every["log_scales"] = np.concatenate([before["log_scales"], [s for _, _, s in new]])
    static = every["label"] == 0
    gone = np.r_[split == 1, np.zeros(len(new), bool)]
    gone |= static & (1 / (1 + np.exp(-every["opacity_logits"].astype(float))) < c["min_opacity"])
    if c["prune_large"]:
        gone |= static & (np.exp(every["log_scales"].astype(float)) > 0.1 * extent).any(1)
    for name in names:
        checks.same(run, name, every[name][~gone], "gen/densify.py", rel=1e-6 if name in ("means", "log_scales") else 0)


def check_relocalise(checks, run, poses, config):
    """The first keyframe with enough inliers, else that with most; its pose is the last that was optimised for it."""
    t, inliers = config["tracking"], run["inliers"].astype(int)
    enough, needed = t["min_inliers_after_recovery"], t["reference_min_matches"]
    if (inliers[:-1] >= enough).any():
        checks.problems.append(f"{run.name}: went on after a keyframe with enough inliers")
    found = inliers.max(initial=0) >= needed
    checks.same(run, "found", [found], "numpy")
    taken = [p["after"] for p in poses if p["inlier"].sum() == inliers.max(initial=0)]
    if found and taken:
        checks.same(run, "camera_from_world", taken[0], "the stage before")


def twists(motions):
    """(rho, phi) of rigid motions: the logarithm, with rho = V^-1 t."""
    phi = pose_lm.Rotation.from_matrix(motions[:, :3, :3]).as_rotvec()
    angle = np.maximum(np.linalg.norm(phi, axis=1), 1e-9)
    second = np.where(angle < 1e-4, 1 / 12, 1 / angle ** 2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle)))
    once = np.cross(phi, motions[:, :3, 3])
    return np.c_[motions[:, :3, 3] - once / 2 + second[:, None] * np.cross(phi, once), phi]


def check_loop(checks, run):
    """The poses of keyframes that were not culled: scipy's optimum of the same graph."""
    full = lambda poses: np.concatenate([poses, np.broadcast_to([[[0, 0, 0, 1.0]]], (len(poses), 1, 4))], 1)
    center = lambda pose: -pose[:, :3].T @ pose[:, 3]
    newest = int(run["keyframe"][0, 0])
    checks.same(run, "drift_m", [np.linalg.norm(center(run["located"]) - center(run["poses_before"][newest]))], "numpy", rel=1e-9)
    kept = np.flatnonzero((run["fixed"] == 0) | (np.arange(len(run["fixed"])) == 0))
    row = {k: i for i, k in enumerate(kept)}
    edges = np.array([[row[a], row[b]] for a, b in run["edge"]])
    root, measured, start = np.sqrt(run["information"]), np.linalg.inv(full(run["a_from_b"])), full(run["poses_before"])[kept]

    def moved(x):
        by = np.zeros((len(kept) - 1, 4, 4))
        by[:, :3, :3], by[:, :3, 3], by[:, 3, 3] = pose_lm.Rotation.from_rotvec(x.reshape(-1, 6)[:, 3:]).as_matrix(), x.reshape(-1, 6)[:, :3], 1
        return np.concatenate([start[:1], by @ start[1:]])

    def residual(x):
        poses = moved(x)
        return (root * twists(measured @ poses[edges[:, 0]] @ np.linalg.inv(poses[edges[:, 1]]))).ravel()

    best = optimize.least_squares(residual, np.zeros(6 * len(kept) - 6), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    part = Run({"poses_after": run["poses_after"][kept]})
    part.stage, part.name = run.stage, run.name
    checks.same(part, "poses_after", moved(best.x)[:, :3], "scipy, without culled keyframes", abs_=1e-5)


def check_cull(checks, run, config):
    """By the observations of all keyframes, each judged by what those before it have left."""
    c, close = config["culling"], config["keyframes"]["close_m"]
    rows = [(int(k), int(l), int(level), z, s == 1) for (k, l, level), z, s in zip(run["observation"], run["depth_m"], run["static"])]
    newest, ends = int(run["newest"][0]), set(run["loop_end"].tolist())
    seen = {l for k, l, *_ in rows if k == newest}
    shared = {}
    for k, l, *_ in rows:
        if k != newest and l in seen:
            shared[k] = shared.get(k, 0) + 1
    culled = []
    for k in sorted(shared, key=lambda k: (shared[k], k), reverse=True):
        if k == 0 or k + c["keep_youngest"] > newest or k in ends:
            continue
        near = [(l, level) for other, l, level, z, static in rows if other == k and static and z < close]
        others = lambda l, level: sum(o != k and o not in culled and m == l and v <= level + 1 for o, m, v, *_ in rows)
        good = sum(others(l, level) >= c["observers"] for l, level in near)
        if near and good >= c["redundant_share"] * len(near):
            culled.append(k)
    checks.same(run, "culled", culled, "numpy: decision 010")


def check_tracks(checks, run, max_residual):
    points, starts = run["points"], run["starts"].copy()
    found, status, error = cv2.calcOpticalFlowPyrLK(run["from"], run["to"], points, starts, winSize=(21, 21), maxLevel=1,
                                                    flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
    error = error.ravel()
    tracked = (status.ravel() == 1) & ~(error > max_residual)
    checks.same(run, "tracked", tracked, "opencv")
    keep = tracked & (run["tracked"] == 1)
    part = Run({"xy": run["xy"][keep], "residual": run["residual"][keep]})
    part.stage, part.name = run.stage, run.name
    checks.same(part, "xy", found[keep], "opencv", abs_=1e-2)
    checks.same(part, "residual", error[keep], "opencv", abs_=3e-2)


def check_flow(checks, run, config):
    c = config["flow"]
    static, suspect = (run[f"{n}_flow"] - run[f"{n}_predicted"] for n in ("static", "suspect"))
    static = static[~np.isnan(static).any(1)]
    mean, covariance, _ = flow.trimmed(static, c["covariance_floor_px2"])
    covariance = covariance + c["covariance_floor_px2"] * flow.mp.eye(2)
    checks.same(run, "mean", flow.array(mean).ravel(), "gen/flow.py, mpmath", abs_=1e-12)
    checks.same(run, "covariance", flow.array(covariance), "gen/flow.py, mpmath", rel=1e-10)
    known = ~np.isnan(suspect).any(1)
    distance = np.full(len(suspect), np.nan)
    distance[known] = flow.mahalanobis2(suspect[known], mean, covariance)
    checks.same(run, "distance2", distance, "gen/flow.py, mpmath", rel=1e-10)
    checks.same(run, "inside", distance <= c["chi2"], "gen/flow.py, mpmath")


def check_label_map(checks, run, config):
    u = config["crf"]["unary"]
    cues = ["reprojection", "depth", "observations", "epipolar"]
    o = crf.DEFAULT_UNARY | {key: [u[c][key] for c in cues] for key in ("mean", "sigma", "side", "weight")}
    o |= {key: u[key] for key in ("height", "pooling", "clamp", "min_observations")}
    log_odds = np.array([float(crf.unary(row, o)[2]) for row in run["cues"]])
    nodes = {"p_world": run["p_world"], "uv_px": run["uv_px"], "reproj_px": run["cues"][:, 0], "observations": run["cues"][:, 2]}
    q = field(nodes, config, log_odds)
    thin = run["cues"][:, 2] < u["min_observations"]
    q = np.where(thin & ~np.isnan(run["previous"]), run["previous"], q)
    checks.same(run, "belief", q, "gen/crf.py, every pair", abs_=2e-3)
    checks.same(run, "label", q > config["crf"]["threshold"], "gen/crf.py, every pair")


def check_bundle(checks, run, intrinsics, bf):
    """Ten steps need not end at the optimum: what is checked is the cost of what was found, and that nothing near it is
    cheaper by more than a hundredth of what was gained."""
    data = dict(uv=run["uv_px"], sigma=run["sigma_px"], right=np.stack([run["third_px"], run["third_sigma_px"]], 1),
                rotation=run["poses_after"][:, :, :3], t=run["poses_after"][:, :, 3], points=run["points_after"],
                fixed=run["fixed"] == 1, observed=run["observation"])
    bundle.K = tuple(intrinsics)
    of_pose, of_point = run["observation"].T
    blocks = bundle.blocks

    def cost(rotation, t, points):
        r, has = blocks(data, rotation[of_pose], t[of_pose], points[of_point], intrinsics, bf)
        s, d2 = (r * r).sum(1), bundle.deltas2(has)
        return 0.5 * np.where(s <= d2, s, 2 * np.sqrt(d2 * s) - d2).sum(), s <= d2

    before = cost(run["poses_before"][:, :, :3], run["poses_before"][:, :, 3], run["points_before"])[0]
    after, inlier = cost(data["rotation"], data["t"], data["points"])
    checks.same(run, "cost", [before, after], "numpy: the cost of both ends", rel=1e-9)
    checks.same(run, "inlier", inlier, "numpy")
    bundle.blocks = lambda *a: blocks(*a, intrinsics, bf)
    least = cost(*bundle.solve_scipy(data))[0]
    bundle.blocks = blocks
    gap = (after - least) / (before - least)
    if not gap <= 1e-2:
        checks.problems.append(f"{run.name}: cost {before} to {after}; scipy goes on to {least}")
        return
    basis = f"scipy: the optimum is {gap:.0e} of the gain lower"
    for name in ("poses_after", "points_after"):
        checks.same(run, name, run[name], basis)


def check_train(checks, run, gaussians, camera, config):
    """The picture of the map inserted or densified, drawn dense and in 80 bits, and the loss of the picture drawn."""
    level, pose = int(run["level"][0]), run["camera_from_world"]
    if gaussians is not None:
        keep = gaussians["label"] == 0
        drawn = draw({name: gaussians[name][keep] for name in DRAWN}, camera, level, pose)
        for name, other in [("color", drawn["color"][0]), ("depth_m", drawn["depth"][0]), ("opacity", 1 - drawn["transmittance"][0])]:
            checks.same(run, name, other, "gen/raster.py, dense, 80 bits", abs_=2e-4, share=2e-2)
    t, excluded = config["train"], run["excluded"] == 0
    x, y = run["color"].astype(float), run["target"].astype(float)
    photo = (1 - t["lambda_ssim"]) * losses.l1(x, y, excluded) + t["lambda_ssim"] * (1 - losses.ssim(x, y, excluded))
    measured, opacity = run["measured_m"].astype(float), run["opacity"].astype(float)
    judged = excluded & np.isfinite(measured) & (measured > 0) & (opacity >= 0.5)
    depth = np.abs(run["depth_m"].astype(float)[judged] / opacity[judged] - measured[judged]).sum() / max(judged.sum(), 1)
    loss = t["lambda_photometric"] * photo + t["lambda_depth"] * depth
    if gaussians is not None:  # later iterations have moved the opacities that are punished
        moving = 1 / (1 + np.exp(-gaussians["opacity_logits"][gaussians["label"] == 1].astype(float)))
        checks.same(run, "loss", [loss + t["lambda_dynamic"] * (moving ** 2).sum()], "gen/losses.py", rel=1e-5)


def draw(gaussians, camera, level, pose):
    width, height = (-(-n // 2 ** level) for n in camera["size"])
    scene = {"size": (width, height), "intrinsics": [v / 2 ** level for v in camera["fx_fy_cx_cy"]],
             "q": quaternion_of(pose[:, :3]), "t": pose[:, 3], "background": np.zeros(3)}
    return raster.render(scene | {name: gaussians[name].astype(float) for name in DRAWN})[0]


def standing(world, camera, pose, uv, z, reach_px, depth_ratio):
    """Gaussians of the surface at a place: drawn within reach of it, at its depth. Nearest first."""
    fx, fy, cx, cy = camera["fx_fy_cx_cy"]
    p = np.array(world["means"], float) @ pose[:, :3].T + pose[:, 3]
    depth = np.where(p[:, 2] > 0, p[:, 2], np.nan)
    apart = np.hypot(fx * p[:, 0] / depth + cx - uv[0], fy * p[:, 1] / depth + cy - uv[1])
    of_it = (world["label"] == 0) & (apart <= reach_px) & (np.abs(depth - z) <= depth_ratio * z)
    return [i for i in np.argsort(apart, kind="stable") if of_it[i]]


def check_insert(checks, run, before, labelled, picture, masks, pose, camera, config):
    """A new landmark takes a free Gaussian of its place or brings one; then one for every lattice pixel with depth
    that the map with those leaves open and that has none of its surface beside it. Labels are given before, or, by
    the field over Gaussians, in between."""
    seed, rgb, depth = config["insertion"], picture["rgb"], picture["depth_m"]
    fx, fy, cx, cy = camera["fx_fy_cx_cy"]
    focal, stride, (height, width) = (fx + fy) / 2, seed["stride_px"], depth.shape
    old = len(before["means"])
    # What is labelled at this keyframe is labelled before insertion.
    world = dict(before) if labelled is not None else dict(before, label=run["label"][:old])
    world["landmark"] = np.where(np.isin(before["landmark"], run["living"]), before["landmark"], NONE)

    def added(world, p_world, z, pixel, tag):
        logit = np.log(seed["opacity"] / (1 - seed["opacity"]))
        sh = np.zeros((1, *world["sh"].shape[1:]))
        sh[0, 0] = (rgb[pixel[1], pixel[0]] / 255 - 0.5) * np.sqrt(4 * np.pi)
        new = dict(means=[p_world], log_scales=[[np.log(seed["footprint"] * stride * z / focal)] * 3], quaternions=[[1, 0, 0, 0]],
                   opacity_logits=[logit], sh=sh, label=[0], landmark=[tag])
        return {name: np.concatenate([world[name], v]) for name, v in new.items()}

    # All look at the map as it was; a tag given is seen by the next.
    was = dict(world)
    for tag, p_world, pixel in zip(run["new_landmark"], run["new_p_world"], run["new_px"].astype(int)):
        x, y, z = pose[:, :3] @ p_world + pose[:, 3]
        if not (z > 0 and pixel[0] < width and pixel[1] < height):
            continue
        there = standing(was, camera, pose, (fx * x / z + cx, fy * y / z + cy), z, stride, seed["depth_ratio"])
        free = [i for i in there if world["landmark"][i] == NONE]
        if free:
            world["landmark"][free[0]] = tag
        else:
            world = added(world, p_world, z, pixel, tag)

    if labelled is not None:
        if len(labelled["means"]) != len(world["means"]):
            checks.problems.append(f"{run.name}: {len(world['means'])} Gaussians with those of landmarks, {len(labelled['means'])} labelled")
            return
        kept = labelled["removed"] == 0
        world = {name: v[kept] for name, v in dict(world, label=labelled["label"]).items()}
    first = len(world["means"])
    moving = np.zeros(depth.shape) if masks is None else np.kron(masks["cells"], np.ones((CELL, CELL)))[:height, :width]
    near = ndimage.maximum_filter(moving, size=2 * stride + 1, mode="constant") * seed["avoid_moving"]
    drawn = draw(world, camera, 2, pose)  # what moves hides what is behind it, too
    drawn_m, drawn_opacity = drawn["depth"][0], 1 - drawn["transmittance"][0]
    was = dict(world)
    for y in range(stride // 2, height, stride):
        for x in range(stride // 2, width, stride):
            z = float(depth[y, x])
            if not (usable(depth[y, x], config) and near[y, x] == 0):
                continue
            at = tuple(min(int(c / 4 + 0.5), n - 1) for c, n in zip((y, x), drawn_m.shape))
            shown = drawn_opacity[at] >= seed["explained_opacity"]
            if shown and drawn_m[at] / drawn_opacity[at] <= z * (1 + seed["depth_ratio"]):
                continue
            if not standing(was, camera, pose, (x, y), z, stride / 2, seed["depth_ratio"]):
                p = np.array([(x - cx) * z / fx, (y - cy) * z / fy, z])
                world = added(world, pose[:, :3].T @ (p - pose[:, 3]), z, (x, y), NONE)

    if labelled is not None:
        voters = labelled["means"][labelled["voter"]]
        label = votes(np.array(world["means"])[first:], voters, labelled["voter_label"], config["labels"]["spread"])
        p = np.array(world["means"], float)[first:] @ pose[:, :3].T + pose[:, 3]
        x, y = np.floor(np.array([fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy]) + 0.5).astype(int)
        if config["labels"]["spread"]["from_mask"]:
            label[moving[y, x] > 0] = 1
        world["label"] = np.r_[world["label"][:first], np.maximum(label, 0)]
        checks.same(run, "label", world["label"], "numpy: decision 020")

    basis = "numpy, on a picture by gen/raster.py"
    for name, allowed in dict(means=1e-6, log_scales=1e-6, quaternions=0, opacity_logits=1e-6, sh=1e-6, landmark=0).items():
        checks.same(run, name, world[name], basis, abs_=allowed)


def quaternion_of(rotation):
    x, y, z, w = pose_lm.Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def check_trace(folder):
    """Writes basis.json; the problems found."""
    index, runs = load(folder)
    config = tomllib.loads((folder / "config.toml").read_text())
    camera = index["about"]["camera"]
    intrinsics, bf = camera["fx_fy_cx_cy"], config["tracking"]["bf"]
    pose_lm.DISPARITY = bundle.DISPARITY = config["tracking"]["depth_residual"] == "disparity"
    checks = Checks()
    get = lambda frame, stage, call=0: runs.get((frame, stage, call))
    every = lambda frame, stage: [r for k, r in runs.items() if k[:2] == (frame, stage)]
    ready = None  # the map that the next iteration draws, where it is known
    for (frame, stage, call), run in runs.items():
        rgb, depth = get(frame, "input")["rgb"], get(frame, "input")["depth_m"]
        if stage == "orb":
            check_orb(checks, run, rgb, config)
        elif stage == "keypoints":
            check_keypoints(checks, run, get(frame, "orb"), depth, config)
        elif stage == "predict":
            full = lambda m: np.vstack([m, [0, 0, 0, 1]])
            checks.same(run, "predicted", (full(run["velocity"]) @ full(run["last"]))[:3], "numpy: a product of matrices", abs_=1e-14)
        elif stage == "pose":
            check_pose(checks, run, intrinsics, bf)
        elif stage == "depth_planes":
            checks.same(run, "planes", planes(depth, config), "numpy", abs_=1e-9, rel=1e-9)
        elif stage == "depth_pose":
            check_depth_pose(checks, run, intrinsics, depth.shape[::-1], config)
        elif stage == "label":
            check_label(checks, run, config)
        elif stage == "masks":
            field = get(frame, "label", 1) or get(frame, "label")  # once more after the flow check
            if field:
                check_masks(checks, run, field, get(frame, "keypoints"), depth, config)
            else:
                check_masks_of_gaussians(checks, run, get(frame, "gaussian_mask"), get(frame, "restore"), get(frame, "keypoints"), depth, config)
        elif stage == "gaussian_mask":
            check_gaussian_mask(checks, run, get(frame, "keypoints"), get(frame, "orb")["level"], depth, camera, config)
        elif stage == "restore":
            check_restore(checks, run, get(frame, "gaussian_mask"), get(frame, "flow_lk"), get(frame, "flow"), get(frame, "orb"), get(frame, "keypoints"), config)
        elif stage == "label_gaussians":
            check_label_gaussians(checks, run, get(frame, "label_map"), config)
        elif stage == "relocalise":
            check_relocalise(checks, run, every(frame, "pose"), config)
        elif stage == "loop":
            check_loop(checks, run)
        elif stage == "cull":
            check_cull(checks, run, config)
        elif stage == "densify":
            check_densify(checks, run, config)
            ready = run
        elif stage in ("flow_lk", "subpixel"):
            check_tracks(checks, run, config["subpixel"]["max_residual"])
        elif stage == "flow":
            check_flow(checks, run, config)
        elif stage == "label_map":
            check_label_map(checks, run, config)
        elif stage == "bundle":
            check_bundle(checks, run, intrinsics, bf)
        elif stage == "train":
            check_train(checks, run, ready, camera, config)
            ready = None
        elif stage == "insert":
            pose = get(frame, "trajectory")["camera_from_world"]
            if not get(frame, "loop"):  # a loop moves the map first
                check_insert(checks, run, get(frame, "map_before"), get(frame, "label_gaussians"), get(frame, "input"), get(frame, "masks"), pose, camera, config)
            ready = run
        elif stage == "trajectory":
            last, adjusted = every(frame, "pose")[-1]["after"], every(frame, "bundle")
            for bundled in adjusted[:1]:  # the newest is the first, after a loop the last that is free
                last = bundled["poses_after"][0]
            for bundled in adjusted[1:]:
                last = bundled["poses_after"][bundled["fixed"] == 0][-1]
            checks.same(run, "camera_from_world", last, "the stage before")
    outputs = [e for e in index["tensors"] if e["role"] == "output"]
    names = sorted({f"{e['stage']}/{e['tensor']}" for e in outputs})
    count = lambda name: sum(f"{e['stage']}/{e['tensor']}" == name for e in outputs)
    basis = {}
    for name in names:
        found = checks.found.get(name)
        basis[name] = {"basis": "pin"} if found is None else found | {"worst": float(f"{found['worst']:.1e}")}
        if found and found["tensors"] < count(name):
            basis[name]["pinned"] = count(name) - found["tensors"]
    checked = sum(f["tensors"] for f in checks.found.values())
    lines = [f'  {json.dumps(name)}: {json.dumps(basis[name])}' for name in names]
    (folder / "basis.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    for problem in checks.problems:
        print("NOT CONFIRMED:", problem)
    print(f"{folder.name}: {checked} of {len(outputs)} outputs computed again from their inputs; {len(outputs) - checked} are pins against change")
    return checks.problems


def main():
    traces = pathlib.Path(__file__).resolve().parent.parent / "trace"
    folders = [pathlib.Path(a) for a in sys.argv[1:]] or sorted(p for p in traces.iterdir() if p.is_dir())
    sys.exit(1 if any([check_trace(folder) for folder in folders]) else 0)


if __name__ == "__main__":
    main()
