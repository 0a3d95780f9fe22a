"""Images as a pinhole camera of the same intrinsics would have recorded them, in float64.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/undistort.py

Each pixel of the pinhole's image is looked up at its distorted place (cv2.projectPoints). A place outside
[0, W-1] x [0, H-1] is unseen: colour and depth 0, mask and `unseen` 255. Colour is bilinear, in [0, 1]; depth and mask are
those of the nearest pixel, at a tie the one to the right and below. cv2.remap, whose weights are multiples of 1/32, must
agree to 0.04.
"""

import cv2
import numpy as np

from case import write_case
from views import Margin, camera, distorted

MARGIN = Margin(1e-9)


def places(c):
    v, u = np.mgrid[:c["height"], :c["width"]].astype(float)
    xy = np.stack([(u - c["cx"]) / c["fx"], (v - c["cy"]) / c["fy"]], -1)
    return distorted(c, xy.reshape(-1, 2)).reshape(*u.shape, 2)


def lookup(c, margin=True):
    """(unseen, corner above and left, weights) of each pixel; a place on the rim or on a tie only if that is meant."""
    at, last = places(c), np.array([c["width"], c["height"]]) - 1
    if margin:
        for threshold in (np.zeros(2), last, np.floor(at) + 0.5):
            MARGIN(at, threshold)
    unseen = (at < 0).any(-1) | (at > last).any(-1)
    corner = np.clip(np.floor(at), 0, last).astype(int)
    return unseen, corner, np.where(unseen[..., None], 0, at - corner)


def bilinear(image, unseen, corner, weight):
    x, y = corner[..., 0], corner[..., 1]
    right, below = np.minimum(x + 1, image.shape[1] - 1), np.minimum(y + 1, image.shape[0] - 1)
    wx, wy = weight[..., :1], weight[..., 1:]
    pixels = image.astype(float)
    out = (1 - wy) * ((1 - wx) * pixels[y, x] + wx * pixels[y, right]) + wy * ((1 - wx) * pixels[below, x] + wx * pixels[below, right])
    return np.where(unseen[..., None], 0, out)


def nearest(image, value, unseen, corner, weight):
    at = corner + (weight >= 0.5)
    at = np.minimum(at, np.array(image.shape[1::-1]) - 1)
    return np.where(unseen, np.array(value, image.dtype), image[at[..., 1], at[..., 0]])


def scene(c, rng):
    """Colours, depth with holes, and a mask."""
    size = (c["height"], c["width"])
    rgb = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
    depth = np.where(rng.random(size) < 0.1, 0, rng.uniform(0.5, 6, size)).astype(np.float32)
    mask = rng.choice([0, 128, 255], size, p=[0.8, 0.1, 0.1]).astype(np.uint8)
    return rgb, depth, mask


def make(name, seed, c, why, flags=(), margin=True):
    rgb, depth, mask = scene(c, np.random.default_rng(seed))
    found = lookup(c, margin)
    color = bilinear(rgb / 255, *found)
    map_x, map_y = np.moveaxis(places(c), -1, 0).astype(np.float32)
    opencv = cv2.remap((rgb / 255).astype(np.float32), map_x, map_y, cv2.INTER_LINEAR)
    seen = ~found[0]
    assert np.abs(opencv - color)[seen].max() < 0.04 and seen.any()
    write_case(
        "undistort", name, basis="numpy, OpenCV", why=why, script="gen/undistort.py", seed=seed, params=c, flags=flags,
        inputs={"rgb": (rgb, "1/255"), "depth": (depth, "m"), "mask": (mask, "1")},
        outputs={
            "color": (color, "1", "undistort.color"), "nearest_depth": (nearest(depth, 0, *found), "m", "exact"),
            "nearest_mask": (nearest(mask, 255, *found), "1", "exact"), "unseen": ((~seen * 255).astype(np.uint8), "255 unseen", "exact"),
        },
    )
    return found


if __name__ == "__main__":
    unseen, _, _ = make("pincushion", 101, camera(53, 38, 41.5, 43.25, 25.3, 19.6, (0.26, -0.35, -0.005, 0.003, 0.2)),
                        "places move outwards: the corners are unseen, the images' axes differ")
    assert 50 < unseen.sum() < 1500
    unseen, _, _ = make("barrel", 102, camera(40, 31, 30.25, 28.5, 20.7, 14.2, (-0.2, 0.05, 0.004, -0.006, 0.0)), "places move inwards")
    # The principal point is the corner on the right and above: x = W-1 and y = 0 stay where they are, and count as seen.
    unseen, corner, weight = make("rim", 103, camera(20, 15, 33.0, 29.0, 19.0, 0.0, (-0.3, 0.1, 0, 0, 0)),
                                  "places on the first row and on the last column itself", ["on-threshold"], margin=False)
    assert not unseen.any() and (corner[:, -1, 0] == 19).all() and (weight[0, :, 1] == 0).all()
    make("pinhole", 104, camera(9, 7, 8.0, 9.0, 4.1, 2.9), "no lens: every pixel as it is", margin=False)
