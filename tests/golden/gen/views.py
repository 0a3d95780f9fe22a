"""Cameras, poses and depth images of the cases about what moves; thresholds that no input may come near.

    Needs: numpy (2.4.6), opencv-python-headless (5.0.0), scipy (1.17.1).
"""

import cv2
import numpy as np
from scipy import ndimage

CELL = 4  # px
BODY_DEPTH = 0.2  # m
UNKNOWN, OCCLUDED, STATIC, DYNAMIC, IN_FRONT = range(5)
LENS = ["k1", "k2", "p1", "p2", "k3"]


def camera(width, height, fx, fy, cx, cy, lens=(0, 0, 0, 0, 0)):
    """Parameters of a case."""
    numbers = dict(width=width, height=height, fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy))
    return numbers | {name: float(v) for name, v in zip(LENS, lens)}


def matrix(c):
    return np.array([[c["fx"], 0, c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1]])


def pose(axis_angle, t):
    """camera_from_world: R [3,3], t [3]."""
    return cv2.Rodrigues(np.array(axis_angle, float))[0], np.array(t, float)


def to_world(p_cam, rotation, t):
    return (np.asarray(p_cam, float) - t) @ rotation


def unproject(c, u, v, z):
    """Without a lens."""
    return np.array([(u - c["cx"]) / c["fx"] * z, (v - c["cy"]) / c["fy"] * z, z])


def distorted(c, xy):
    """Pixels of points (x/z, y/z), by OpenCV."""
    lens = np.array([c[name] for name in LENS])
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(c), lens)[0][:, 0]


def sigma(z, noise):
    per_m, floor = noise
    return np.maximum(per_m * z * z, floor)


class Margin:
    """Relative distance of everything compared from its threshold; no case comes nearer than the least."""

    def __init__(self, least=1e-9):
        self.least = least

    def __call__(self, value, threshold):
        off = np.abs(np.asarray(value) - threshold) / np.maximum(np.abs(threshold), 1)
        assert np.all(off > self.least), f"{np.min(off):.2e} from a threshold"
        return value


class FreeSpace:
    """A depth image in cells: nearest and farthest depth of the 3 x 3 cells around each."""

    def __init__(self, depth, max_depth, moving=None):
        rows, columns = (-(-n // CELL) for n in depth.shape)
        padded = np.zeros((rows * CELL, columns * CELL))
        padded[:depth.shape[0], :depth.shape[1]] = depth
        cells = padded.reshape(rows, CELL, columns, CELL).swapaxes(1, 2).reshape(rows, columns, -1)
        valid = (cells > 0) & (cells <= max_depth)
        near, far = np.where(valid, cells, np.inf).min(-1), np.where(valid, cells, 0).max(-1)
        self.near = ndimage.minimum_filter(near, 3, mode="constant", cval=np.inf)
        self.far = ndimage.maximum_filter(far, 3, mode="constant", cval=0)
        self.moving = moving

    def query(self, c, view, noise, p_world, margin):
        """(visibility, sigmas in front, depth of the nearest surface around)."""
        rotation, t = view
        p = rotation @ p_world + t
        if margin(p[2], 0) <= 0:
            return UNKNOWN, np.nan, np.nan
        px = distorted(c, (p[:2] / p[2])[None])[0] + 0.5
        for value in px:
            margin(value / CELL, np.round(value / CELL))
            margin(value, np.round(value))
        x, y = np.floor(px).astype(int)
        if not (0 <= x < c["width"] and 0 <= y < c["height"]):
            return UNKNOWN, np.nan, np.nan
        at = (y // CELL, x // CELL)
        near, far, z = self.near[at], self.far[at], p[2]
        if np.isinf(near):
            return UNKNOWN, np.nan, np.nan
        s = sigma(near, noise)
        if margin(z, near - s) < near - s:
            return IN_FRONT, (near - z) / s, near
        if margin(z, far + 3 * s) > far + 3 * s:
            return OCCLUDED, np.nan, near
        if self.moving is None or self.moving[at] != 255:
            return STATIC, np.nan, near
        behind = margin(z, near + BODY_DEPTH) > near + BODY_DEPTH
        return (OCCLUDED if behind else DYNAMIC), np.nan, near


def evidence(c, views, noise, p_world, margin):
    """The largest distance in front of a surface, 0 if only static surfaces are there, NaN if nothing is; the age
    of the oldest view with the point on a static surface. views: (FreeSpace, pose, age)."""
    residual, agreed = np.nan, 0
    for space, view, age in views:
        seen, sigmas, _ = space.query(c, view, noise, p_world, margin)
        if seen == IN_FRONT:
            residual = np.fmax(residual, sigmas)
        elif seen == STATIC:
            residual, agreed = np.fmax(residual, 0.0), max(agreed, age)
    return residual, agreed


def view_inputs(depth, poses, ages, moving=None):
    """Inputs of the views: depth [V,H,W] of float32."""
    inputs = {
        "depth": (np.array(depth, np.float32), "m"),
        "view_rotation": (np.array([r for r, _ in poses]).reshape(-1, 3, 3), "1"),
        "view_translation": (np.array([t for _, t in poses]).reshape(-1, 3), "m"),
        "age_frames": (np.array(ages, np.int32), "frames"),
    }
    return inputs if moving is None else inputs | {"moving": (np.array(moving, np.uint8), "255 moving, in cells of 4 px")}


def room(c, seed, holes=0.04):
    """A sloped wall with a near body and holes of every kind: 0, negative, NaN, infinite."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:c["height"], :c["width"]]
    depth = 3.1 + 0.4 * (u - c["cx"]) / c["fx"] + 0.3 * (v - c["cy"]) / c["fy"]
    depth[v < 0.2 * c["height"]] = 6.5
    body = (np.abs(u - 0.35 * c["width"]) < 0.14 * c["width"]) & (v > 0.4 * c["height"])
    depth[body] = 1.7
    depth += rng.normal(0, 0.004, depth.shape)
    kind = rng.random(depth.shape)
    for k, value in enumerate([0.0, -1.0, np.nan, np.inf]):
        depth[(kind >= k * holes / 4) & (kind < (k + 1) * holes / 4)] = value
    depth[-9:, -12:] = 0
    return depth.astype(np.float32)
