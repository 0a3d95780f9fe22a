"""Points against depth images of other times.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/free_space.py

A depth image is reduced to cells of 4 x 4 px with the nearest and the farthest depth of the 3 x 3 cells around (scipy's
minimum and maximum filter); depths that are not above 0, or above `max_depth_m`, are missing. A point of the camera's
frame at depth z, in the cell of the pixel nearest to its distorted projection (OpenCV), is, with
s = max(noise_per_m near^2, noise_floor_m),

    0 unknown       behind the camera, outside, or no depth in the cells
    4 in front      z < near - s; by (near - z) / s sigmas
    1 occluded      z > far + 3 s, or the cell is moving (255) and z > near + 0.2 m
    2, 3 on the     surface, which is static (2) or moving (3)

`nearest_m` is near. All views together: `residual` is the largest distance in front, 0 if static surfaces alone have the
point, NaN if no view says anything; `agreed_frames` the largest age of a view that has it on a static surface.
"""

import numpy as np

from case import write_case
from views import FreeSpace, Margin, camera, evidence, pose, room, to_world, unproject, view_inputs

NONE = np.nan


def make(name, seed, c, depth, poses, ages, points, why, noise, max_depth, moving=None, margin=Margin(), flags=()):
    spaces = [FreeSpace(d.astype(float), max_depth, None if moving is None else moving[i]) for i, d in enumerate(depth)]
    found = np.array([[space.query(c, view, noise, p, margin) for p in points] for space, view in zip(spaces, poses)])
    both = np.array([evidence(c, list(zip(spaces, poses, ages)), noise, p, margin) for p in points])
    write_case(
        "free_space", name, basis="numpy, scipy.ndimage, OpenCV", why=why, script="gen/free_space.py", seed=seed, flags=flags,
        equations=["paper:2"],
        params=c | {"max_depth_m": max_depth, "noise_per_m": noise[0], "noise_floor_m": noise[1]},
        inputs=view_inputs(depth, poses, ages, moving) | {"points": (np.array(points), "m, world")},
        outputs={
            "visibility": (found[..., 0].astype(np.int32), "0 unknown, 1 occluded, 2 static, 3 dynamic, 4 in front", "exact"),
            "sigmas": (found[..., 1], "standard deviations", "free_space.sigmas"),
            "nearest_m": (found[..., 2], "m", "exact"),
            "residual": (both[:, 0], "standard deviations", "free_space.sigmas"),
            "agreed_frames": (both[:, 1].astype(np.int32), "frames", "exact"),
        },
    )
    return found[..., 0]


def by_hand():
    """3 m on the left, 1 m in the last columns; sigma is 0.09 m at 3 m and its floor of 0.02 m at 1 m."""
    c = camera(24, 12, 20, 25, 11.5, 5.5)
    depth = np.full((12, 24), 3, np.float32)
    depth[:, 16:] = 1
    at = lambda u, v, z: unproject(c, u, v, z)
    points = [at(3, 3, 2.82), at(3, 3, 2.95), at(3, 3, 3.2), at(3, 3, 3.3), at(21, 9, 0.95), at(14, 3, 2), at(3, 3, -1), at(30, 3, 1)]
    seen = make("by_hand", None, c, [depth], [pose([0, 0, 0], [0, 0, 0])], [7], points,
                "2 sigma in front of 3 m, on it, on it, behind it, 2.5 sigma in front of 1 m, between both beside the edge, behind the camera, outside",
                (0.01, 0.02), 8.0)
    assert seen.tolist() == [[4, 2, 2, 1, 4, 2, 0, 0]]


def gates():
    """Both sides of every comparison, 1e-4 away from it, seen from a turned and shifted camera of 62 x 45 px."""
    c = camera(62, 45, 61.25, 58.5, 29.75, 23.5)
    view, noise, most = pose([0.2, -0.35, 0.1], [0.4, -0.2, 0.7]), (0.012, 0.04), 5.0
    depth = np.full((45, 62), 2.5, np.float32)
    depth[:, 32:] = 4.0                                      # a depth edge at column 32
    depth[20:, 32:] = 1.0                                    # sigma at its floor
    depth[36:, :16] = most                                   # just not too far
    depth[36:, 16:32] = np.nextafter(np.float32(most), 9)    # just too far
    depth[0:4, 48:52] = 1.25                                 # alone in its cell
    moving = np.zeros((12, 16), np.uint8)
    moving[3, 2:11] = 255                                    # across the edge
    moving[3, 1] = 128                                       # not known
    e, s = 1e-4, 0.012 * 2.5 ** 2
    points = []
    for u in (2, 14):                                        # static (left), moving (right)
        for z in (2.5 - s, 2.5, 2.5 + 3 * s):
            points += [(u, 14, z - e), (u, 14, z + e)]
    points += [(6, 14, 2.5)]                                 # a mask of 128
    s4 = s                                                   # sigma is that of the nearest surface
    for v, z in ((14, 2.7), (14, 4 + 3 * s4), (6, 2.7), (6, 4 + 3 * s4)):  # near 2.5, far 4, moving and not
        points += [(30, v, z - e), (30, v, z + e)]
    for z in (1 - 0.04, 1 + 3 * 0.04):
        points += [(50, 30, z - e), (50, 30, z + e)]
    for u, v in ((-0.5, 7), (61.5, 7), (7, -0.5), (7, 44.5)):  # the rim of the image
        for sign in (-1, 1):
            points += [(u + sign * 1e-3 * (v == 7), v + sign * 1e-3 * (u == 7), 2.0)]
    # The 3 x 3 cells around (12, 0) see 1.25 m: rows 0 to 7, columns 44 to 55.
    for u, v in ((43.5, 2), (55.5, 2), (50, 7.5)):
        for sign in (-1, 1):
            points += [(u + sign * 1e-3 * (v == 2), v + sign * 1e-3 * (u == 50), 2.0)]
    points += [(4, 43, 4.5), (23.9, 44.2, 4.5), (24.1, 44.2, 4.5), (30, 23.2, 1e-3), (30, 23.2, -1e-3)]
    points = [to_world(unproject(c, *p), *view) for p in points]
    seen = make("gates", None, c, [depth], [view], [3], points, "both sides of every threshold, of the image's rim, and of a cell's",
                noise, most, [moving], flags=["on-threshold"])
    assert set(seen.ravel()) == {0, 1, 2, 3, 4}


def history(seed):
    """Three views of a room through a lens, one with nothing that moves; ages do not follow their order."""
    c = camera(62, 45, 55.5, 57.25, 30.2, 22.9, (0.12, -0.2, 0.004, -0.003, 0.05))
    rng = np.random.default_rng(seed)
    poses = [pose(rng.normal(0, 0.08, 3), rng.normal(0, 0.15, 3)) for _ in range(3)]
    depth = [room(c, seed + i) for i in range(3)]
    moving = np.zeros((3, 12, 16), np.uint8)
    moving[1, 4:, 3:8] = 255
    moving[2, 2:, 6:13] = 255
    moving[2, 2:5, 6:13] = 128
    u, v = rng.uniform(-4, 66, 240), rng.uniform(-4, 49, 240)
    z = rng.choice([1.7, 3.1, 6.5], 240) + rng.choice([0.0, 0.02, 0.1, 1.0], 240) * rng.normal(0, 1, 240)
    points = [to_world(unproject(c, *p), *poses[i % 3]) for i, p in enumerate(zip(u, v, z))]
    seen = make("history", seed, c, depth, poses, [12, 40, 25], points,
                "three views that contradict each other, through a lens, with missing depth, moving and unknown cells", (4e-3, 0.012), 6.51, moving)
    assert set(seen.ravel()) == {0, 1, 2, 3, 4}


by_hand()
gates()
history(61)
