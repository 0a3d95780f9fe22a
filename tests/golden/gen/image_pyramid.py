"""The targets of training at each level (eq. 16), in float64.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/image_pyramid.py

Level 0 is the undistorted image (undistort.py); each further one has half its size, rounded up.

    color_l     cv2.pyrDown of the level before, as numbers: [1 4 6 4 1]/16 each way, mirrored at the edge, not rounded
    depth_l     every second pixel of the level before
    excluded_l  `moving`, and 255 where a pixel is unseen; above level 0 255 where one of the 5 x 5 under the filter of the level before is not 0
    camera_l    fx, fy, cx, cy, width, height

`level` is that of a view's iterations 0, 1, ..., `uses` - 1: `per_level` at level 2, as many at level 1, then level 0.
"""

import cv2
import numpy as np

from case import write_case
from undistort import bilinear, lookup, nearest, scene
from views import camera


def halved_mask(mask):
    """Zeros beyond the edge: a maximum over what is there."""
    wide = cv2.dilate(mask, np.ones((5, 5), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.where(wide[::2, ::2] > 0, 255, 0).astype(np.uint8)


def make(name, seed, c, per_level, uses, levels, why, with_moving=True, margin=True):
    rng = np.random.default_rng(seed)
    rgb, depth, _ = scene(c, rng)
    moving = np.zeros(depth.shape, np.uint8)
    moving[9:13, 5:8], moving[20, 20], moving[11, 17] = 255, 255, 128
    found = lookup(c, margin)
    color, near = bilinear(rgb / 255, *found), nearest(depth, 0, *found)
    excluded = np.where(found[0], 255, nearest(moving, 255, *found) if with_moving else 0).astype(np.uint8)
    numbers = np.array([c[key] for key in ("fx", "fy", "cx", "cy", "width", "height")], float)
    outputs = {}
    for level in range(levels):
        if level > 0:
            color, near, excluded = cv2.pyrDown(color, borderType=cv2.BORDER_REFLECT_101), near[::2, ::2], halved_mask(excluded)
            numbers = np.concatenate([numbers[:4] / 2, np.ceil(numbers[4:] / 2)])
        assert color.shape[:2] == near.shape == excluded.shape == tuple(int(n) for n in numbers[:3:-1]), level
        outputs |= {
            f"color_{level}": (color, "1", "image_pyramid.color"), f"depth_{level}": (near, "m", "exact"),
            f"excluded_{level}": (excluded, "not 0: excluded", "exact"), f"camera_{level}": (numbers, "px", "exact"),
        }
    schedule = np.array([max(0, 2 - n // per_level) for n in range(uses)], np.int32)
    write_case(
        "image_pyramid", name, basis="OpenCV", why=why, script="gen/image_pyramid.py", seed=seed, equations=["paper:16"],
        params=c | {"levels": levels, "per_level": per_level, "uses": uses},
        inputs={"rgb": (rgb, "1/255"), "depth": (depth, "m")} | ({"moving": (moving, "not 0: moving")} if with_moving else {}),
        outputs=outputs | {"level": (schedule, "halvings", "exact")},
    )


make("lens", 111, camera(37, 26, 33.5, 35.25, 18.3, 12.1, (0.2, -0.3, 0.004, -0.003, 0.1)), 3, 9, 3, "unseen corners and moving pixels spread with the filter; odd and even sizes")
make("pinhole", 112, camera(34, 27, 30.0, 31.0, 16.7, 13.4), 5, 16, 4, "no lens and no mask: the pyramid alone, one level more than training has", with_moving=False, margin=False)
