"""Whether a tracked frame becomes a keyframe: a truth table.

    pip install numpy==2.4.6
    python3 tests/golden/gen/keyframe.py

Rows are decisions. With g = `frame` - `last_keyframe`, and keypoints in use with a depth below `close_m`, c of them linked to
a landmark and u not, a frame becomes a keyframe if g >= min_gap (at least 1) and inliers >= min_inliers, and one of

    inliers < tracked_share most_inliers      g >= max_gap      c < close_tracked_min and u > close_untracked_min

With method = render (no features) it does if g >= max_gap.
"""

import itertools

import numpy as np

from case import write_case
from views import camera

KEYPOINTS = 14


def decide(o, g, inliers, most, depth, linked, in_use):
    if o["method"] == "render":
        return g >= o["max_gap"]
    if g < max(o["min_gap"], 1) or inliers < o["min_inliers"]:
        return False
    close = (depth < o["close_m"]) & (in_use == 1)  # NaN is not
    few = (close & (linked == 1)).sum() < o["close_tracked_min"] and (close & (linked == 0)).sum() > o["close_untracked_min"]
    return inliers < o["tracked_share"] * most or few or g >= o["max_gap"]


def make(name, seed, why, flags=(), **changed):
    rng = np.random.default_rng(seed)
    o = dict(method="features", min_gap=3, max_gap=8, min_inliers=20, tracked_share=0.625, close_m=4.5, close_tracked_min=5, close_untracked_min=3) | changed
    rows = []
    # Gaps and inliers on both sides of each threshold (40 of 64 are the share), and close keypoints likewise.
    for g, (inliers, most), tracked, untracked in itertools.product(
            (0, 1, 2, 3, 5, 7, 8, 9), ((19, 20), (20, 20), (39, 64), (40, 64), (41, 64)), (4, 5), (3, 4)):
        kind = rng.permutation([0] * tracked + [1] * untracked + [2] * (KEYPOINTS - tracked - untracked))
        depth, linked, in_use = rng.uniform(0.5, 4.4, KEYPOINTS), (kind == 0).astype(np.uint8), np.ones(KEYPOINTS, np.uint8)
        for k, i in enumerate(np.flatnonzero(kind == 2)):  # not close, not known, or not in use
            depth[i], in_use[i] = [4.5, 4.6, np.nan, 1.0][k % 4], k % 4 != 3
            linked[i] = rng.integers(0, 2)
        last = int(rng.integers(3, 90))
        rows.append((last + g, last, inliers, most, depth, linked, in_use, decide(o, g, inliers, most, depth, linked, in_use)))
    frame, last, inliers, most, depth, linked, in_use, decision = (np.array(x) for x in zip(*rows))
    assert 0.1 < decision.mean() < 0.9
    write_case(
        "keyframe", name, basis="numpy", why=why, script="gen/keyframe.py", seed=seed, flags=["on-threshold", *flags],
        params=camera(64, 48, 50, 52, 31.5, 23.5) | o | {"keypoints": KEYPOINTS},
        inputs={
            "frame": (frame.astype(np.int32), "frame"), "last_keyframe": (last.astype(np.int32), "frame"), "inliers": (inliers.astype(np.int32), "1"),
            "most_inliers": (most.astype(np.int32), "1"), "depth_m": (depth, "m"), "linked": (linked, "1 linked"), "in_use": (in_use, "1 in use"),
        },
        outputs={"keyframe": (decision.astype(np.uint8), "1 becomes one", "exact")},
    )


make("features", 131, "gaps, inliers, and close keypoints on and beside every threshold, in all combinations")
make("no_gap", 132, "a least gap of 0 counts as 1", min_gap=0)
make("render", 133, "tracking by rendering: one frame in max_gap, whatever its features", method="render")
