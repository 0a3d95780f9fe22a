"""Golden cases of the dataset crate: decode, associate, bonn, ply.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/dataset.py

Inputs are the committed sample tests/data/tum_fr1_desk_9 and numbers made up here.
"""

import pathlib

import cv2
import numpy as np
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from case import write_case

SCRIPT = "gen/dataset.py"
SAMPLE = pathlib.Path(__file__).resolve().parents[2] / "data" / "tum_fr1_desk_9"
STEP = 16  # every 16th pixel of every 16th row is kept


def decode():
    """Pixels of real frames as OpenCV reads them; sums over all pixels cover the rest."""
    names = {kind: [line.split()[1] for line in (SAMPLE / f"{kind}.txt").read_text().splitlines()
                    if not line.startswith("#")] for kind in ("rgb", "depth")}
    for frame in (0, 8):
        bgr = cv2.imread(str(SAMPLE / names["rgb"][frame]), cv2.IMREAD_COLOR)
        raw = cv2.imread(str(SAMPLE / names["depth"][frame]), cv2.IMREAD_UNCHANGED)
        assert raw.dtype == np.uint16
        rgb = bgr[:, :, ::-1]
        write_case(
            "decode", f"fr1_desk_{frame}", basis="opencv", script=SCRIPT,
            why="order of channels and bytes, metres per raw unit, on a real frame",
            params={"frame": frame, "step": STEP},
            inputs={},
            outputs={
                "rgb": (rgb[::STEP, ::STEP], "1", "exact"),
                "rgb_sum": (rgb.reshape(-1, 3).sum(axis=0, dtype=np.int64), "1", "exact"),
                "depth": ((raw[::STEP, ::STEP] / 5000.0).astype(np.float32), "m", "exact"),
                "depth_known": (np.array([np.count_nonzero(raw)], np.int64), "1", "exact"),
                "depth_raw_sum": (np.array([raw.sum(dtype=np.int64)]), "1/5000 m", "exact"),
            })


def greedy(a, b, window):
    """The TUM benchmark's rule: all pairs in the window, closest first, each time used once."""
    pairs = sorted((abs(t - u), i, j) for i, t in enumerate(a) for j, u in enumerate(b)
                   if abs(t - u) <= window)
    free_a, free_b, taken = set(range(len(a))), set(range(len(b))), []
    for _, i, j in pairs:
        if i in free_a and j in free_b:
            free_a.remove(i)
            free_b.remove(j)
            taken.append((i, j))
    return np.array(sorted(taken), np.int32).reshape(-1, 2)


def associate():
    rng = np.random.default_rng(11)
    t0 = 1305031453.0

    def stamps(rate, n, jitter, keep=1.0):
        t = t0 + np.arange(n) / rate + rng.normal(0.0, jitter, n)
        return np.unique(np.round(t[rng.random(n) < keep], 6))

    for name, why, a, b in [
        ("drift", "29.9 Hz against 30.0 Hz: pairs slip by one after half a period",
         stamps(29.9, 400, 1e-4), stamps(30.0, 400, 1e-4)),
        ("jitter", "neighbours compete for one partner", stamps(30.0, 300, 0.015), stamps(30.0, 300, 0.015)),
        ("gaps", "half of the depth images are missing", stamps(30.0, 300, 2e-3), stamps(30.0, 300, 2e-3, keep=0.5)),
        ("crowd", "a hundred times within the window of each other",
         t0 + np.sort(rng.random(100)) * 0.01, t0 + np.sort(rng.random(80)) * 0.01),
    ]:
        write_case("associate", name, basis="closed-form", why=why, script=SCRIPT, seed=11,
                   params={"max_dt": 0.02},
                   inputs={"a": (a, "s"), "b": (b, "s")},
                   outputs={"pairs": (greedy(a, b, 0.02), "1", "exact")})


def bonn():
    """A T A T_m with homogeneous matrices; scipy's polar factor for the rotation in T_m."""
    rng = np.random.default_rng(12)
    axes = np.diag([-1.0, 0.0, 0.0, 1.0])
    axes[1, 2] = axes[2, 1] = 1.0
    t_m = np.array([[1.0157, 0.1828, -0.2389, 0.0113],
                    [0.0009, -0.8431, -0.6413, -0.0098],
                    [-0.3009, 0.6147, -0.8085, 0.0111],
                    [0.0, 0.0, 0.0, 1.0]])
    t_m[:3, :3], stretch = polar(t_m[:3, :3])
    assert abs(np.trace(stretch) / 3.0 - 1.0593) < 1e-4
    quaternions = Rotation.random(6, rng=rng).as_quat()
    quaternions[0] = [0.0, 0.0, 0.0, 1.0]
    positions = rng.uniform(-3.0, 3.0, (6, 3))
    cameras = []
    for quaternion, position in zip(quaternions, positions):
        marker = np.eye(4)
        marker[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
        marker[:3, 3] = position
        cameras.append(axes @ marker @ axes @ t_m)
    cameras = np.array(cameras)
    write_case("bonn", "made_up_poses", basis="scipy", script=SCRIPT, seed=12, flags=["convention"],
               why="order of the four factors, and the scale taken out of T_m",
               inputs={"quaternion_xyzw": (quaternions, "1"), "position": (positions, "m")},
               outputs={"rotation": (cameras[:, :3, :3], "1", "dataset.rotation"),
                        "translation": (cameras[:, :3, 3], "m", "dataset.translation")})


def ply():
    """A 3DGS file of degree 3 as its Python authors write it: a structured array, little-endian."""
    rng = np.random.default_rng(13)
    names = (["x", "y", "z", "nx", "ny", "nz"] + [f"f_dc_{i}" for i in range(3)]
             + [f"f_rest_{i}" for i in range(45)] + ["opacity"]
             + [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)])
    n = 7
    vertices = np.zeros(n, dtype=[(name, "<f4") for name in names])
    means = rng.normal(size=(n, 3)).astype(np.float32)
    sh = rng.normal(size=(n, 16, 3)).astype(np.float32)
    opacity = rng.normal(size=n).astype(np.float32)
    scales = rng.normal(-3.0, 1.0, (n, 3)).astype(np.float32)
    quaternions = rng.normal(size=(n, 4)).astype(np.float32)
    for i, axis in enumerate("xyz"):
        vertices[axis] = means[:, i]
        vertices[f"f_dc_{i}"] = sh[:, 0, i]
        vertices[f"scale_{i}"] = scales[:, i]
    # channel-major: all of red, then all of green, then all of blue
    rest = sh[:, 1:, :].transpose(0, 2, 1).reshape(n, 45)
    for i in range(45):
        vertices[f"f_rest_{i}"] = rest[:, i]
    for i in range(4):
        vertices[f"rot_{i}"] = quaternions[:, i]
    vertices["opacity"] = opacity
    header = "".join(["ply\nformat binary_little_endian 1.0\n", f"element vertex {n}\n"]
                     + [f"property float {name}\n" for name in names] + ["end_header\n"])
    body = vertices.tobytes()
    write_case("ply", "degree_3", basis="closed-form", script=SCRIPT, seed=13, flags=["convention"],
               why="channel-major f_rest, w first, 62 floats",
               inputs={"file": (np.frombuffer(header.encode() + body, np.uint8), "1")},
               outputs={"means": (means, "m", "exact"), "sh": (sh, "1", "exact"),
                        "opacity_logits": (opacity, "1", "exact"), "log_scales": (scales, "ln m", "exact"),
                        "quaternions": (quaternions, "1", "exact"),
                        "vertices": (np.frombuffer(body, np.uint8), "1", "exact")})


if __name__ == "__main__":
    decode()
    associate()
    bonn()
    ply()
