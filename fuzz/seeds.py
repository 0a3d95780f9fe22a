#!/usr/bin/env python3
"""Writes fuzz/seeds/TARGET/, the same bytes each time. The target `session` writes its own."""

import gzip
import io
import json
import shutil
import struct
import tarfile
import zipfile
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
SEEDS = HERE / "seeds"
WIDTH, HEIGHT = 8, 6


def put(target, name, data):
    path = SEEDS / target / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data if isinstance(data, bytes) else data.encode())


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(bits, color, rows, extra=b"", interlace=0):
    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, bits, color, 0, 0, interlace)
    raw = b"".join(bytes([i % 5 if not interlace else 0]) + row for i, row in enumerate(rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")


def pixels(channels, size=1):
    return [bytes((7 * x + 31 * y + c) % 256 for x in range(WIDTH) for c in range(channels * size)) for y in range(HEIGHT)]


RGB = png(8, 2, pixels(3))
DEPTH = png(16, 0, pixels(1, 2))
MASK = png(8, 0, [bytes([0, 128, 255, 0] * 2)] * HEIGHT)


def lists():
    good = "# colour\n1.00 rgb/1.00.png\n1.10 rgb/1.10.png\n1.20 rgb/1.20.png\n"
    depth = "# depth\n1.005 depth/1.005.png\n1.105 depth/1.105.png\n1.35 depth/1.35.png\n"
    put("lists", "good", good + "\0" + depth)
    put("lists", "odd", "\ufeff1.1 ./rgb//a.png\r\n\r\n 1.0 b.png\t\r\n1.0 c.png\n\0" + "1.0 camera.txt\n1.1 rgb.txt\n")
    for name in ["../a.png", "/a.png", "a:b.png", "a\\b", "rgb.txt/c"]:
        put("lists", f"name_{zlib.crc32(name.encode()):08x}", f"1 {name}\n")
    put("lists", "times", "1e11 a\n-0 b\n0 c\nnan d\n\0" + "1e11 a\n+.5e0 b\n")
    desk = ROOT / "tests/data/tum_fr1_desk_9"
    put("lists", "desk", (desk / "rgb.txt").read_bytes() + b"\0" + (desk / "depth.txt").read_bytes())


def trajectory():
    put("trajectory", "good", "# t\r\n1.5 1 2 3 0 0 0 1\n2.5 -1e-3 +2 .5 0.5 -0.5 0.5 0.5\n3 0 0 0 1 0 0 0\n")
    put("trajectory", "near", "0 0 0 0 0 0 0 1.0009\n0.000001 1e300 -1e300 0 0.6 0 -0.8 0\n1e11 0 0 0 0 0 0 -1\n")
    put("trajectory", "bad", "0.5 0 0 0 0 0 0 1\n0.5 0 0 inf 0 0 0 1\n")
    lines = (ROOT / "tests/data/tum_fr1_desk_9/groundtruth.txt").read_text().splitlines()[:20]
    put("trajectory", "desk", "\n".join(lines) + "\n")


def layouts():
    pose = [[0, -1, 0, 1.5], [1, 0, 0, -2.5], [0, 0, 1, 3.5], [0, 0, 0, 1]]
    frame = {"file_path": "images/frame_00001.png", "depth_file_path": "depth/frame_00001.png", "transform_matrix": pose}
    camera = {"w": 8, "h": 6.0, "fl_x": 10.0, "fl_y": 11, "cx": 4.0, "cy": 3.0, "k1": 0.01, "camera_model": "OPENCV"}
    alone = {"file_path": "./images/frame_00002.png", "transform_matrix": pose}
    put("layouts", "nerfstudio", json.dumps(camera | {"frames": [frame, alone]}, indent=1))
    of_frame = {key: camera[key] for key in ["fl_x", "fl_y", "cx", "cy", "w", "h"]}
    put("layouts", "polycam", json.dumps({"frames": [frame | of_frame, alone | of_frame | {"fl_x": 20.0}]}))
    rows = "\n".join(" ".join(map(str, row)) for row in pose)
    log = f"1 1 2\n{rows}\n0 0 1\n{rows}\n"
    matrix = [10.0, 0, 0, 0, 11.0, 0, 3.5, 2.5, 1]
    put("layouts", "open3d", json.dumps({"width": 8, "height": 6, "intrinsic_matrix": matrix}) + "\0" + log)
    replica = {"camera": {"w": 8, "h": 6, "fx": 10.0, "fy": 11.0, "cx": 3.5, "cy": 2.5, "scale": 6553.5}}
    put("layouts", "replica", json.dumps(replica) + "\0" + rows.replace("\n", " ") + "\n")


def calibration():
    put("calibration", "row", "# w h\n640 480 535.4 539.2 320.1 247.6 5000 30\n")
    put("calibration", "long", "640 480 517.3 516.5 318.6 255.3 1000 30 0.26 -0.95 -0.005 0.003 1.16\ndepth_delay_s = -0.015\n")
    keys = "width height fx fy cx cy depth_factor fps k1 k2 p1 p2 k3 depth_max_raw depth_delay_s".split()
    values = [8192, 1, 1e-3, 2e5, -1, 0.5, 1000, 30, 1e-9, 0, 0, 0, -0.0, 65535, 1]
    put("calibration", "keys", "".join(f"{k} = {v}  # {k}\n" for k, v in zip(keys, values)))
    put("calibration", "twice", "width = 3\nwidth = 4\n")
    put("calibration", "desk", (ROOT / "tests/data/tum_fr1_desk_9/camera.txt").read_bytes())


def images():
    put("images", "rgb.png", RGB)
    put("images", "depth.png", DEPTH)
    put("images", "mask.png", MASK)
    put("images", "rgba.png", png(8, 6, pixels(4)))
    put("images", "grey_alpha.png", png(8, 4, pixels(2)))
    put("images", "rgb16.png", png(16, 2, pixels(3, 2)))
    palette = chunk(b"PLTE", bytes(range(48))) + chunk(b"tRNS", bytes(range(16)))
    put("images", "palette4.png", png(4, 3, pixels(1)[:0] + [bytes(4)] * HEIGHT, palette))
    put("images", "bits1.png", png(1, 0, [b"\xa5"] * HEIGHT))
    # Adam7: the seven passes of 8 x 6 pixels, one byte each, filter 0.
    passes = [(1, 1), (1, 1), (2, 1), (2, 2), (4, 1), (4, 3), (8, 3)]
    raw = b"".join((b"\0" + bytes(range(w))) * h for w, h in passes)
    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 0, 0, 0, 1)
    put("images", "adam7.png", b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))
    big = struct.pack(">IIBBBBB", 8192, 2048, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes(8193 * 2048), 9)
    put("images", "large.png", b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", big) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))
    text = chunk(b"iCCP", b"x\0\0" + zlib.compress(bytes(100))) + chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1000)))
    put("images", "text.png", png(8, 2, pixels(3), text))
    # 8 x 8 grey baseline JPEG: one block, DC 0.
    dqt = b"\xff\xdb\0\x43\0" + b"\1" * 64
    sof = b"\xff\xc0\0\x0b\x08" + struct.pack(">HH", HEIGHT, WIDTH) + b"\1\1\x11\0"
    dht = b"".join(b"\xff\xc4\0\x14" + bytes([c, 1] + [0] * 15 + [0]) for c in (0x00, 0x10))
    sos = b"\xff\xda\0\x08\1\1\0\0\x3f\0" + b"\x3f"
    put("images", "grey.jpg", b"\xff\xd8" + dqt + sof + dht + sos + b"\xff\xd9")


def ply():
    names = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    tail = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    for degree, rest in [(0, 0), (1, 9), (3, 45)]:
        columns = names + [f"f_rest_{i}" for i in range(rest)] + tail
        rows = [[0.25 * (i + 1) * (-1) ** j for j in range(len(columns))] for i in range(2)]
        for encoding in ["ascii", "binary_little_endian", "binary_big_endian"]:
            order = ">" if "big" in encoding else "<"
            header = f"ply\nformat {encoding} 1.0\ncomment seed\nelement vertex 2\n"
            header += "".join(f"property float {c}\n" for c in columns) + "property uchar label\nend_header\n"
            body = b""
            for i, row in enumerate(rows):
                if encoding == "ascii":
                    body += " ".join(map(str, row + [i])).encode() + b"\n"
                else:
                    body += struct.pack(f"{order}{len(row)}fB", *row, i)
            put("ply", f"{encoding}_{degree}", header.encode() + body)
    lists = "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int f\nelement face 1\nproperty double x\nend_header\n2 1 2\n1\n"
    put("ply", "lists", lists)
    huge = "ply\nformat binary_little_endian 1.0\nelement vertex 2000000\n"
    put("ply", "promises", huge + "".join(f"property float {c}\n" for c in names + tail) + "end_header\n")


FILES = {
    "rgb.txt": b"1.00 rgb/1.png\n",
    "depth.txt": b"1.005 depth/1.png\n",
    "camera.txt": b"8 6 10 11 3.5 2.5 5000 30\n",
    "groundtruth.txt": b"1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n",
    "rgb/1.png": RGB,
    "depth/1.png": DEPTH,
    "mask/1.png": MASK,
}


def tar(prefix, format, extra=()):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=format) as archive:
        for name, data in FILES.items():
            info = tarfile.TarInfo(prefix + name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
        for info in extra:
            archive.addfile(info)
    return out.getvalue().rstrip(b"\0") + bytes(1024)


def archive():
    put("archive", "flat.tar", tar("", tarfile.USTAR_FORMAT))
    put("archive", "room.tar", tar("./some/rgbd_room/", tarfile.GNU_FORMAT))
    deep = "a_long_folder_name_" * 8 + "/"
    put("archive", "gnu_long.tar", tar(deep, tarfile.GNU_FORMAT))
    put("archive", "pax_long.tar", tar(deep, tarfile.PAX_FORMAT))
    link = tarfile.TarInfo("rgb/2.png")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/hostname"
    put("archive", "link.tar", tar("", tarfile.USTAR_FORMAT, [link]))
    put("archive", "flat.tgz", gzip.compress(tar("", tarfile.USTAR_FORMAT), 9, mtime=0))
    for name, kind in [("stored.zip", zipfile.ZIP_STORED), ("deflated.zip", zipfile.ZIP_DEFLATED)]:
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", kind) as packed:
            for file, data in FILES.items():
                packed.writestr(zipfile.ZipInfo("rgbd_room/" + file), data, kind)
        put("archive", name, out.getvalue())


def config():
    for profile in sorted((ROOT / "profiles").glob("*.toml")):
        put("config", profile.name, profile.read_bytes())
    old = "[seed]\nopacity = 0.5\n[refine]\nkeyframes = 7\n[surface.noise]\nfloor_m = 0.02\n[labels]\nsecond_sight = false\n"
    put("config", "renamed.toml", old)
    put("config", "floats.toml", "[crf.kernels]\nsigma_m = 1e300\nsigma_px = inf\n[flow]\nchi2 = nan\n")
    put("config", "kinds.toml", 'crf.mean_field.method = "reference"\nflow = { enabled = false }\n[loops]\nlinear_solver = "faer"\n')


def npy_file(descr, shape, data, order="False"):
    header = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


NPY = {
    "f64": npy_file("<f8", "(2, 3)", struct.pack("<6d", 1, 2.5, -3, 0, 1e-9, 7)),
    "f32": npy_file("<f4", "(6,)", struct.pack("<6f", 1, 2.5, -3, 0, 1e-9, 7)),
    "nan": npy_file("<f8", "(2, 3)", struct.pack("<6d", 1, 2.5, float("nan"), float("inf"), 1e-9, 1e300)),
    "i64": npy_file("<i8", "(4,)", struct.pack("<4q", 3, -1, 4, 1)),
    "u2": npy_file("<u2", "(4, 1)", struct.pack("<4H", 3, 1, 4, 1)),
    "bool": npy_file("|b1", "(3,)", b"\1\0\1"),
    "bool_2": npy_file("|b1", "(3,)", b"\1\0\2"),
    "scalar": npy_file("|i1", "()", b"\xff"),
    "empty": npy_file("<u4", "(0, 4)", b""),
    "fortran": npy_file("<i2", "(2,)", b"\1\0\2\0", "True"),
    "overflow": npy_file("<f8", "(4294967296, 4294967296, 2)", bytes(16)),
}


def npy():
    for target in ["npy", "answer"]:
        for name, data in NPY.items():
            put(target, name, data)


def case():
    outputs = {
        "a": {"dtype": "f64", "shape": [6], "unit": "m", "file": "a.npy", "tol": "exact"},
        "b": {"dtype": "u8", "shape": [3, 1], "unit": "1", "file": "b.npy", "tol": "exact"},
        "c": {"dtype": "i64", "shape": [2], "unit": "1", "file": "c.npy", "tol": "exact"},
        "inline": {"dtype": "f32", "shape": [2, 2], "unit": "1", "data": [[1, "nan"], ["-inf", 0.1]], "tol": "camera.undistorted"},
    }
    text = {
        "schema": 1, "stage": "fast", "case": "seed", "equations": ["paper:1"], "why": "seed", "flags": ["x"],
        "basis": "hand", "generator": {}, "params": {"kind": "errors"}, "inputs": {"a": outputs["a"]}, "outputs": outputs,
    }
    put("case", "all", json.dumps(text))
    for stage, name in [("knn_scale", "by_hand"), ("trajectory", "umeyama_planar"), ("bonn", "made_up_poses")]:
        put("case", f"{stage}_{name}", (ROOT / f"tests/golden/{stage}/{name}/case.json").read_bytes())


def documents():
    header = {
        "format": 10, "program": "0.2.0", "recording": "seed", "frames_done": 3, "tracked": 3, "keyframes": 1,
        "landmarks": 5, "gaussians": 7, "seed": 1,
        "camera": {"width": 8, "height": 6, "fx": 10.0, "fy": 11.0, "cx": 3.5, "cy": 2.5,
                   "distortion": {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}},
        "state": "state-a.bin",
    }
    put("json", "session", json.dumps(header))
    entry = {"frame": 10, "stage": "pose", "call": 0, "role": "output", "tensor": "after", "dtype": "f64",
             "shape": [3], "unit": "m", "file": "000010/pose_0/after.npy"}
    put("json", "trace", json.dumps({"schema": 1, "about": {}, "tensors": [entry, entry | {"call": 1}]}))
    unknown = dict.fromkeys(["precision", "recall", "f1", "iou"])
    quality = {"psnr_db": 21.5, "ssim": 0.75}
    metrics = {
        "schema": 1, "version": "0.2.0", "dataset": "seed", "frames": 3, "tracked": 3, "threads": 1,
        "ate": {"rmse_m": 0.01, "mean_m": None, "median_m": None, "std_m": None, "max_m": None, "pairs": 3},
        "rpe": {"trans_rmse_m_per_s": 1e-3, "rot_rmse_deg_per_s": None},
        "render": quality, "render_static": quality, "labels": {"keypoints": unknown, "pixels": unknown},
        "map": {"gaussians": 7, "dynamic": None}, "timing": {"frame": {"median_ms": 1.5, "p95_ms": 2, "calls": 3}},
        "wall_s": 1.0, "peak_rss_mb": None,
    }
    put("json", "metrics", json.dumps(metrics))


if __name__ == "__main__":
    for old in SEEDS.glob("*"):
        if old.name != "session":
            shutil.rmtree(old)
    for make in [lists, layouts, trajectory, calibration, images, ply, archive, config, npy, case, documents]:
        make()
