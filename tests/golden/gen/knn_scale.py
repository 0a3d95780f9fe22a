"""Initial scales of Gaussians from the distances to three neighbours, by scipy's k-d tree.

    pip install numpy==2.4.6 scipy==1.17.1
    python3 tests/golden/gen/knn_scale.py

The neighbours of a point are all other points, also those before `first`, which get no scale. Output
`distance` is the root of the mean of the three squared distances, infinite with fewer than three other points;
`scale` is the same, limited to 0.5 and 2 footprints.
"""

import numpy as np
from scipy.spatial import cKDTree

from case import write_case

FOCAL_PX, STRIDE_PX = 525.0, 8


def make(name, seed, points, first, footprints, why):
    points = np.asarray(points, float)
    near, _ = cKDTree(points).query(points[first:], k=4)  # the point itself, or one at its place, is the first
    distance = np.sqrt(np.mean(near[:, 1:] ** 2, axis=1))  # scipy: inf for a neighbour that does not exist
    write_case(
        "knn_scale", name, basis="scipy cKDTree", why=why, script="gen/knn_scale.py", seed=seed,
        params={"first": first},
        inputs={"points": (points, "m"), "footprints": (footprints, "m")},
        outputs={
            "distance": (distance, "m", "knn_scale.scale"),
            "scale": (np.clip(distance, 0.5 * footprints, 2 * footprints), "m", "knn_scale.scale"),
        },
    )


def by_hand():
    """Distances 1, 2, 2 m; a point at the same place as another; one that is far from all."""
    points = [[2, 0, 1], [0, -2, 1], [0, 0, 0], [0, 0, 1], [5, 5, 5], [5, 5, 5], [90, 0, 0]]
    make("by_hand", None, points, 3, np.array([1.0, 2.0, 20.0, 1.0]),
         "small enough to compute by hand: sqrt(3) m; two at one place, limited from above and from below by their footprints; a far point")


def alone():
    make("alone", None, [[0, 0, 1.0], [0, 0.5, 1.0], [0, 0, 2.0]], 1, np.array([0.1, 0.2]),
         "two neighbours only: an infinite mean, the upper limit")


def room(seed):
    """What a keyframe inserts: a wall, a table that is seen at a flat angle, and a body in front, beside a map that stands."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[4:240:STRIDE_PX, 4:320:STRIDE_PX].astype(float)
    x, y = (u - 159.5) / FOCAL_PX, (v - 119.5) / FOCAL_PX
    wall, table = np.full(u.shape, 3.0), 0.3 / np.maximum(y, 1e-9)
    z = np.minimum(wall, table)
    z[(np.abs(u - 90) < 30) & (v > 60)] = 1.2
    z *= 1 + rng.normal(0, 0.003, z.shape)
    seen = np.stack([x * z, y * z, z], axis=-1).reshape(-1, 3)
    standing = rng.permutation(len(seen))[:400]
    old = seen[standing] + rng.normal(0, 0.004, (400, 3))
    new = np.delete(seen, standing, axis=0)
    points = np.float32(np.concatenate([old, new])).astype(float)
    make("room", seed, points, 400, STRIDE_PX * points[400:, 2] / FOCAL_PX,
         "a keyframe's samples beside a standing map: interior, slope, depth edges")


def lattice(seed):
    """Points on a lattice: many neighbours at the same distance, and many points with the same coordinate."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, [12, 9, 3], (500, 3)) * 0.125
    make("lattice", seed, points, 0, np.full(500, 0.125),
         "equal distances, doubled points, and more equal coordinates than a leaf of a tree has room for")


by_hand()
alone()
room(51)
lattice(52)
