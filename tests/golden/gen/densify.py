"""Adaptive density control (Kerbl et al. 2023, section 5.2), in float64.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/densify.py

Iterations are rows: the image's `width` and `height`, and for each Gaussian its radius (0: not drawn) and the gradient of
the loss at its centre, per px. `mean_gradient` is the mean of |(gx W/2, gy H/2)| over the iterations that drew it, 0
without any.

In the order of the rows, until two more would exceed `max_gaussians`: a static Gaussian born at keyframe `young_from` or
later with a mean of at least `grad_threshold` is cloned if no standard deviation exceeds `split_extent` `extent_m`, else
split: two children at mean + R (s * n), n the next three of `normals`, deviations divided by 1.6. A quaternion of length 0
splits into nothing. New rows are copies of their parent in all else. `split` marks those to be removed.

`too_large`: static, a deviation above a tenth of the extent; `faded`: static, an opacity below `min_opacity`; both of all
rows, old and new.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from case import write_case
from views import Margin

SIZES = [(64, 32), (32, 16), (16, 8), (64, 32), (48, 20)]


def control(o, g, normals, margin):
    """Rows to be removed, and new rows (parent, mean, log scales)."""
    n, new, split, normals = len(g["label"]), [], np.zeros(len(g["label"]), np.uint8), iter(normals)
    large = o["split_extent"] * o["extent_m"]
    exact = lambda value, threshold: value if value == threshold else margin(value, threshold)
    for i in range(n):
        if g["label"][i] == 1 or g["born"][i] < o["young_from"] or exact(g["mean"][i], o["grad_threshold"]) < o["grad_threshold"]:
            continue
        if n + len(new) + 2 > o["max_gaussians"]:
            break
        sigma = np.exp(g["log_scales"][i].astype(float))
        if all(exact(s, large) <= large for s in sigma):
            new.append((i, g["means"][i].astype(float), g["log_scales"][i].astype(float)))
        elif np.any(g["quaternions"][i]):
            split[i] = 1
            rotation = Rotation.from_quat(g["quaternions"][i].astype(float), scalar_first=True)
            for _ in range(2):
                local = sigma * [next(normals) for _ in range(3)]
                new.append((i, g["means"][i] + rotation.apply(local), g["log_scales"][i] - np.log(1.6)))
    return split, new


def make(name, seed, max_gaussians, why):
    rng, margin, n = np.random.default_rng(seed), Margin(1e-5), 40
    o = dict(grad_threshold=0.625, split_extent=0.25, extent_m=4.0, young_from=5, max_gaussians=max_gaussians, min_opacity=0.125)
    quaternions = rng.normal(0, 1, (n, 4)) * rng.uniform(0.3, 3, (n, 1))
    log_scales = np.log(rng.choice([0.02, 0.3, 0.9, 1.1, 1.4], (n, 1)) * rng.uniform(0.9, 1.05, (n, 3)))
    log_scales[0], log_scales[1] = 0, [0, 0, 1e-3]      # 1 m, the limit, and one axis above it
    quaternions[2], log_scales[2] = 0, 0.2              # no direction
    log_scales[3], log_scales[4] = np.log([[0.1, 0.1, 0.3999], [0.1, 0.4001, 0.1]])  # a tenth of the extent
    opacity = rng.uniform(0.02, 0.6, n)
    opacity[5], opacity[6] = 0.1249, 0.1251
    g = dict(
        means=np.float32(rng.uniform(-3, 3, (n, 3))), log_scales=np.float32(log_scales), quaternions=np.float32(quaternions),
        opacity_logits=np.float32(np.log(opacity / (1 - opacity))), sh=np.float32(rng.normal(0, 1, (n, 1, 3))),
        label=(rng.random(n) < 0.2).astype(np.uint8), born=rng.integers(3, 9, n).astype(np.int32))
    g["label"][:9], g["born"][:9] = 0, 5
    g["born"][9], g["label"][10] = 4, 1
    gradients = np.float32(rng.normal(0, 1, (len(SIZES), n, 2)) * rng.choice([0.01, 0.05], n)[:, None])
    radii = (rng.random((len(SIZES), n)) < 0.7) * rng.integers(1, 9, (len(SIZES), n))
    for i in [*range(5), 9, 10]:                        # (0.375, 0.5) of NDC, 0.625 in all
        gradients[:, i] = [(0.375 * 2 / w, 0.5 * 2 / h) for w, h in SIZES]
        radii[:, i] = [0, 3, 1, 0, 0]
    gradients[:, 7], gradients[:, 8] = 1.0001 * gradients[:, 0], 0.9999 * gradients[:, 0]
    radii[:, 7:9] = radii[:, :1]
    radii[:, 11] = 0                                    # never drawn
    half = np.array(SIZES)[:, None] / 2
    lengths, drawn = np.linalg.norm(gradients.astype(float) * half, axis=-1), radii > 0
    g["mean"] = (lengths * drawn).sum(0) / np.maximum(drawn.sum(0), 1)
    normals = rng.normal(0, 1, 6 * n)
    split, new = control(o, g, normals, margin)
    parents, means, scales = (np.array(x) for x in zip(*new))
    every = lambda name: np.concatenate([g[name], g[name][parents]])
    scale_of_all = np.concatenate([g["log_scales"].astype(float), scales])
    static = every("label") == 0
    too_large = static & (margin(np.exp(scale_of_all), 0.1 * o["extent_m"]) > 0.1 * o["extent_m"]).any(1)
    faded = static & (margin(1 / (1 + np.exp(-every("opacity_logits").astype(float))), o["min_opacity"]) < o["min_opacity"])
    assert split.any() and len(new) > 2 * split.sum()   # clones and children
    units = {"means": "m", "log_scales": "ln m", "quaternions": "w, x, y, z", "opacity_logits": "1", "sh": "1", "label": "1 dynamic", "born": "keyframe"}
    write_case(
        "densify", name, basis="numpy, scipy Rotation", why=why, script="gen/densify.py", seed=seed, params=o, flags=["on-threshold"],
        inputs={key: (g[key], unit) for key, unit in units.items()} | {
            "gradients": (gradients, "1/px"), "radii": (radii.astype(np.int32), "px"), "width": (np.array(SIZES, np.int32)[:, 0], "px"),
            "height": (np.array(SIZES, np.int32)[:, 1], "px"), "normals": (normals, "1")},
        outputs={
            "mean_gradient": (g["mean"], "per unit of NDC", "densify.gradient"), "split": (split, "1 to be removed", "exact"),
            "parent": (parents.astype(np.int32), "row", "exact"), "new_means": (means, "m", "densify.means"),
            "new_log_scales": (scales, "ln m", "densify.log_scales"),
            "new_quaternions": (g["quaternions"][parents], "w, x, y, z", "exact"), "new_opacity_logits": (g["opacity_logits"][parents], "1", "exact"),
            "new_sh": (g["sh"][parents], "1", "exact"), "new_born": (g["born"][parents], "keyframe", "exact"),
            "new_label": (g["label"][parents], "1 dynamic", "exact"),
            "too_large": (too_large.astype(np.uint8), "1 to be removed", "exact"), "faded": (faded.astype(np.uint8), "1 to be removed", "exact"),
        },
    )


if __name__ == "__main__":
    make("free", 91, 400, "clones and children on both sides of every threshold, images of several sizes")
    make("full", 92, 50, "the map is full after some of them")
