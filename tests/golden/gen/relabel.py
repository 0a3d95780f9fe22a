"""The labels that Gaussians take on at a keyframe.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/relabel.py

A Gaussian's depth evidence, by the keyframe's one view (free_space.py): in front by more than `suspect_sigmas`: dynamic;
on a surface: as that is; else none. `tag` is its landmark (-1: none). With `tagged` = landmark a tagged Gaussian has the
label of its landmark, if that was labelled, and none else; with evidence, the label of its landmark if that has changed,
and else its evidence. Without a view there is no evidence.

A label replaces the one before and enters the window: `history` has the earlier runs, oldest first (0 static, 1 dynamic, 2
not labelled in that run). `expired`: dynamic in the last `runs` labels. `counts`: to dynamic, to static, expired.
"""

import numpy as np

from case import write_case
from views import DYNAMIC, IN_FRONT, STATIC, FreeSpace, Margin, camera, pose, room, to_world, unproject, view_inputs

RUNS, HISTORY = 4, 6


def make(name, seed, tagged, seen, why):
    rng, margin = np.random.default_rng(seed), Margin()
    c = camera(62, 45, 55.5, 57.25, 30.2, 22.9)
    noise, most, suspect, n = (4e-3, 0.012), 8.0, 2.5, 90
    view, depth = pose([0.1, -0.15, 0.06], [0.3, -0.1, 0.2]), room(c, seed)
    moving = np.zeros((12, 16), np.uint8)
    moving[4:, 3:8] = 255
    z = rng.choice([1.7, 3.1, 6.5], n) + rng.choice([0.0, 0.05, 1.0], n) * rng.normal(0, 1, n)
    means = [to_world(unproject(c, *p), *view) for p in zip(rng.uniform(-3, 65, n), rng.uniform(-3, 48, n), z)]
    means = np.float32(means)
    tag = np.where(rng.random(n) < 0.5, rng.integers(3, 15, n), -1).astype(np.int32)
    ids = np.array([4, 3, 12, 8, 9, 7, 14], np.int32)  # in any order; the others were not labelled
    of_landmark, changed = np.array([1, 0, 1, 0, 1, 0, 1], np.uint8), np.array([1, 1, 0, 0, 1, 1, 0], np.uint8)
    label = (rng.random(n) < 0.4).astype(np.uint8)
    history = rng.choice([0, 1, 1, 1, 1, 2], (n, HISTORY)).astype(np.uint8)
    history[::4] = 2                                    # no window yet
    history[1::4, -3:] = 1                              # one short of the window
    space = FreeSpace(depth.astype(float), most, moving)
    after, expired, runs_seen, dynamic_runs, counts = label.copy(), np.zeros(n, np.uint8), [], [], [0, 0, 0]
    for i in range(n):
        by_landmark = {int(l): (int(d), bool(x)) for l, d, x in zip(ids, of_landmark, changed)}.get(int(tag[i]))
        evidence = None
        if seen:
            what, sigmas, _ = space.query(c, view, noise, means[i].astype(float), margin)
            if what == IN_FRONT and margin(sigmas, suspect) > suspect:
                evidence = 1
            elif what in (STATIC, DYNAMIC):
                evidence = int(what == DYNAMIC)
        if tagged == "landmark" and tag[i] >= 0:
            new = by_landmark and by_landmark[0]
        elif by_landmark and by_landmark[1]:
            new = by_landmark[0]
        else:
            new = evidence
        window = [int(l) for l in history[i] if l != 2]
        if new is not None:
            window.append(new)
            counts[0] += new == 1 and label[i] == 0
            counts[1] += new == 0 and label[i] == 1
            after[i] = new
            expired[i] = len(window) >= RUNS and all(window[-RUNS:])
        runs_seen.append(len(window))
        dynamic_runs.append(sum(window[-RUNS:]))
    counts[2] = int(expired.sum())
    assert min(counts) > 0, counts
    write_case(
        "relabel", name, basis="numpy, scipy.ndimage, OpenCV", why=why, script="gen/relabel.py", seed=seed, equations=["paper:7"],
        params=c | {"max_depth_m": most, "noise_per_m": noise[0], "noise_floor_m": noise[1], "suspect_sigmas": suspect,
                    "tagged": tagged, "runs": RUNS, "history_runs": HISTORY},
        inputs={
            "means": (means, "m, world"), "label": (label, "1 dynamic"), "tag": (tag, "landmark"), "history": (history, "0 static, 1 dynamic, 2 none"),
            "landmark_id": (ids, "landmark"), "landmark_label": (of_landmark, "1 dynamic"), "landmark_changed": (changed, "1 changed"),
        } | view_inputs([depth][:seen], [view][:seen], [0][:seen], np.array([moving])[:seen]),
        outputs={
            "label_after": (after, "1 dynamic", "exact"), "expired": (expired, "1 to be removed", "exact"),
            "counts": (np.array(counts, np.int32), "Gaussians", "exact"), "runs_seen": (np.array(runs_seen, np.int32), "runs", "exact"),
            "dynamic_runs": (np.array(dynamic_runs, np.int32), "runs", "exact"),
        },
    )


make("evidence", 81, "evidence", 1, "tagged Gaussians have evidence of their own unless their landmark has changed")
make("landmark", 82, "landmark", 1, "a tagged Gaussian follows its landmark whatever the depth says")
make("unseen", 83, "evidence", 0, "no depth image: landmarks that changed alone give labels")
