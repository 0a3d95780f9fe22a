"""Keypoints linked to the landmarks that project near them.

    pip install numpy==2.4.6 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/landmark_links.py

For one landmark after the other, candidates are the keypoints of the frame in use and not linked, strictly within r in x and
in y of the expected pixel (ideal px), at levels low..high, and, where they have depth, with |bf / depth_m - bf / z| <= r,
z the expected depth. The one with the least Hamming distance is linked if that is at most `match_distance`. No two
best ones tie, nor two second best of different levels where that counts. Scales are 1.2^level.

search = last_frame: landmarks are those linked in the last frame, in the order of its keypoints, if they are still alive and
project into the image. r = `radius_px` times the scale of the last keypoint. Levels: those of the last keypoint and one to
each side; only it and higher ones if the camera has moved forward by more than bf / fx, only it and lower ones if
backward. Then links whose angle (last - now) is in none of the three fullest of 30 bins of 12 degrees are undone; the second
and third count only with a tenth of the first.

search = local_map: landmarks are `visible`, each with its expected pixel, depth, level and the cosine between its view and the
mean one. r = `local_radius_px`, or `local_radius_oblique_px` unless the cosine is above 0.998, times the scale of the level; levels:
it and the one below. No link if the second best is of the best's level and best > `local_ratio` second.
"""

import numpy as np

from case import write_case
from views import Margin, camera, pose, to_world, unproject

SCALES = 1.2 ** np.arange(8)
BF, MATCH_DISTANCE = 9.0, 60
MARGIN = Margin(1e-7)


def turned(rng, descriptor, bits):
    """A descriptor so many bits away."""
    all_bits = np.unpackbits(descriptor)
    all_bits[rng.choice(256, bits, replace=False)] ^= 1
    return np.packbits(all_bits)


def search(frame, link, uv, z, r, low, high, descriptor):
    """Candidates as (distance, keypoint), nearest first."""
    found = []
    for k in range(len(link)):
        off = np.abs(frame["px"][k] - uv)
        MARGIN(off, r)
        if link[k] >= 0 or not frame["in_use"][k] or not (off < r).all() or not low <= int(frame["level"][k]) <= high:
            continue
        if not np.isnan(frame["depth_m"][k]) and MARGIN(abs(BF / frame["depth_m"][k] - BF / z), r) > r:
            continue
        found.append((int(np.unpackbits(frame["descriptor"][k] ^ descriptor).sum()), k))
    found.sort()
    best, rest = [d for d, _ in found[:1]], found[1:]
    rivals = {int(frame["level"][k]) for d, k in rest if d == rest[0][0]}
    if best and best[0] <= MATCH_DISTANCE and rest:
        assert best[0] < rest[0][0] and (len(rivals) == 1 or best[0] < 0.7 * rest[0][0]), "a tie"
    return found


def consistent(pairs, last, frame):
    count = np.zeros(30, int)
    bins = []
    for i, k in pairs:
        turn = (float(last["angle"][i]) - float(frame["angle"][k])) % 360 / 12
        Margin(1e-5)(turn, np.round(turn))  # angles are float32
        bins.append(int(turn) % 30)
        count[bins[-1]] += 1
    fullest = np.argsort(-count, kind="stable")[:3]
    kept = [b for b in fullest if count[b] >= 0.1 * count[fullest[0]]]
    return [pair for pair, b in zip(pairs, bins) if b in kept]


def from_last_frame(c, world, last, frame, radius):
    link, pairs = frame["link"].copy(), []
    (r0, t0), (r1, t1) = last["pose"], frame["pose"]
    forward, baseline = (t0 - r0 @ r1.T @ t1)[2], BF / c["fx"]
    MARGIN(abs(forward), baseline)
    for i, l in enumerate(last["link"]):
        if l < 0 or not world["alive"][l]:
            continue
        p = r1 @ world["points"][l] + t1
        if p[2] <= 0:
            continue
        uv = np.array([c["fx"] * p[0] / p[2] + c["cx"], c["fy"] * p[1] / p[2] + c["cy"]])
        if not ((MARGIN(uv, -0.5) >= -0.5) & (MARGIN(uv, np.array([c["width"], c["height"]]) - 0.5) < np.array([c["width"], c["height"]]) - 0.5)).all():
            continue
        level = int(last["level"][i])
        low, high = (level, 7) if forward > baseline else (0, level) if forward < -baseline else (level - 1, level + 1)
        found = search(frame, link, uv, p[2], radius * SCALES[level], low, high, world["descriptor"][l])
        if found and found[0][0] <= MATCH_DISTANCE:
            link[found[0][1]] = l
            pairs.append((i, found[0][1]))
    kept = consistent(pairs, last, frame)
    for pair in pairs:
        if pair not in kept:
            link[pair[1]] = -1
    return link, len(kept), len(pairs)


def from_local_map(world, visible, frame, o):
    link, count, ambiguous = frame["link"].copy(), 0, 0
    for l, uv, z, level, cosine in visible:
        if not world["alive"][l]:
            continue
        r = SCALES[level] * (o["local_radius_px"] if cosine > 0.998 else o["local_radius_oblique_px"])
        found = search(frame, link, uv, z, r, level - 1, level, world["descriptor"][l])
        if not found:
            continue
        best, k = found[0]
        if len(found) > 1 and frame["level"][found[1][1]] == frame["level"][k] and best > o["local_ratio"] * found[1][0]:
            ambiguous += 1
        elif best <= MATCH_DISTANCE:
            link[k], count = l, count + 1
    return link, count, ambiguous


def frame_inputs(prefix, f):
    units = {"px": "px", "level": "1", "angle": "degrees", "depth_m": "m", "in_use": "1 in use", "link": "landmark", "descriptor": "256 bits"}
    inputs = {f"{prefix}_{key}": (f[key], unit) for key, unit in units.items()}
    return inputs | {f"{prefix}_rotation": (f["pose"][0], "1"), f"{prefix}_translation": (f["pose"][1], "m")}


def scene(seed, forward):
    """Landmarks, the last frame, and a frame that moved on: keypoints near the projections, copies that compete, and clutter."""
    rng, n = np.random.default_rng(seed), 90
    c = camera(160, 120, 101.0, 97.5, 81.3, 57.2)
    last_pose = pose([0.05, -0.1, 0.02], [0.1, 0.05, -0.2])
    step = pose([0.01, 0.02, -0.015], [0.015, -0.01, -forward])
    now_pose = (step[0] @ last_pose[0], step[0] @ last_pose[1] + step[1])
    uv, z = rng.uniform([2, 2], [158, 118], (n, 2)), rng.uniform(0.8, 4, n)
    points = np.array([to_world(unproject(c, *p, d), *last_pose) for p, d in zip(uv, z)])
    world = dict(points=points, alive=(rng.random(n) < 0.9).astype(np.uint8), descriptor=rng.integers(0, 256, (n, 32)).astype(np.uint8))
    level = rng.integers(0, 8, n).astype(np.uint8)
    link = np.where(rng.random(n) < 0.85, np.arange(n), -1).astype(np.int32)
    last = dict(px=np.float32(uv), level=level, angle=np.float32(rng.uniform(0, 360, n)), depth_m=z, in_use=np.ones(n, np.uint8),
                link=link, descriptor=world["descriptor"], pose=last_pose)
    px, levels, angles, depth, words = [], [], [], [], []
    turn = rng.choice([40.0, 50.0, 61.0, 200.0, 300.0], n, p=[0.5, 0.25, 0.13, 0.06, 0.06])
    for i, p in enumerate(points @ now_pose[0].T + now_pose[1]):
        at = np.array([c["fx"] * p[0] / p[2] + c["cx"], c["fy"] * p[1] / p[2] + c["cy"]])
        bits = rng.integers(4, 62)
        for copy in range(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2])):
            px.append(at + rng.normal(0, 3, 2) * SCALES[level[i]])
            levels.append(np.clip(level[i] + rng.integers(-2, 3), 0, 7))
            angles.append((last["angle"][i] - turn[i] + rng.uniform(-1, 1)) % 360)
            depth.append([np.nan, p[2] * (1 + rng.normal(0, 0.02)), p[2] * 2.5][rng.choice(3, p=[0.3, 0.55, 0.15])])
            words.append(turned(rng, world["descriptor"][i], int(bits + copy * rng.integers(3, 20))))
    px = np.float32(np.floor(np.array(px) * 16) / 16 + 1 / 32)  # never half way between two pixels
    keep = ((px >= 0) & (px <= [159, 119])).all(1)
    _, first = np.unique(np.round(px).astype(int), axis=0, return_index=True)  # a pixel has one keypoint
    keep &= np.isin(np.arange(len(px)), first)
    take = lambda values, dtype: np.array(values)[keep].astype(dtype)
    m = keep.sum()
    linked = np.where(rng.random(m) < 0.06, n - 1, -1).astype(np.int32)
    frame = dict(px=px[keep], level=take(levels, np.uint8), angle=take(angles, np.float32), depth_m=take(depth, float),
                 in_use=(rng.random(m) < 0.93).astype(np.uint8), link=linked, descriptor=take(words, np.uint8), pose=now_pose)
    return rng, c, world, last, frame


def save(name, seed, c, world, frame, params, inputs, link, count, why):
    write_case(
        "landmark_links", name, basis="numpy", why=why, script="gen/landmark_links.py", seed=seed,
        params=c | {"bf": BF, "match_distance": MATCH_DISTANCE} | params,
        inputs={"points": (world["points"], "m, world"), "alive": (world["alive"], "0 dropped"), "descriptor": (world["descriptor"], "256 bits")}
        | frame_inputs("frame", frame) | inputs,
        outputs={"link": (link, "landmark", "exact"), "count": (np.int32(count), "1", "exact")},
    )


def last_frame(name, seed, forward, why):
    _, c, world, last, frame = scene(seed, forward)
    link, count, before = from_last_frame(c, world, last, frame, 4.0)
    assert 12 < count < before, (count, before)
    save(name, seed, c, world, frame, {"search": "last_frame", "radius_px": 4.0}, frame_inputs("last", last), link, count, why)


def local_map(seed):
    rng, c, world, last, frame = scene(seed, 0.02)
    o = {"search": "local_map", "local_radius_px": 3.0, "local_radius_oblique_px": 5.5, "local_ratio": 0.75}
    r, t = frame["pose"]
    visible = []
    for l, p in enumerate(world["points"] @ r.T + t):
        uv = np.array([c["fx"] * p[0] / p[2] + c["cx"], c["fy"] * p[1] / p[2] + c["cy"]])
        visible.append((l, uv, p[2], int(last["level"][l]), [0.9979, 0.9981, 0.7][rng.integers(3)]))
    link, count, ambiguous = from_local_map(world, visible, frame, o)
    assert count > 12 and ambiguous > 3, (count, ambiguous)
    ids, uv, z, level, cosine = (np.array(x) for x in zip(*visible))
    save("local_map", seed, c, world, frame, o,
         {"visible": (ids.astype(np.int32), "landmark"), "visible_uv": (uv, "px"), "visible_depth_m": (z, "m"), "visible_level": (level.astype(np.int32), "1"), "visible_cosine": (cosine, "1")},
         link, count, "radii for points seen head on and obliquely, ambiguous seconds, keypoints that are taken")


# The virtual baseline is 9 / 101 = 0.0891 m.
last_frame("still", 141, 0.085, "levels to both sides: the camera has moved by less than the virtual baseline")
last_frame("forward", 142, 0.095, "the camera has moved forward by more than that: the same level and higher ones")
last_frame("backward", 143, -0.095, "and backward: the same level and lower ones")
local_map(144)
