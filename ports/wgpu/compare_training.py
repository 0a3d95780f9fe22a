"""Trains one map on the CPU by garad and on the GPU by the port, from the same views with the same settings, and compares the images.

    python3 ports/wgpu/compare_training.py GARAD PORT FOLDER

Six frames of the scene of `garad demo` at 160 x 120; the map is made of every fifth pixel of their depth, as the mapper inserts it.
FOLDER gets a case of the stage `train_step`; `garad golden answer` is the CPU's training of it. Both maps are
rendered by garad. Needs numpy and OpenCV.
"""

import json
import pathlib
import subprocess
import sys

import cv2
import numpy as np

FRAMES, SIZE, EVERY, ITERATIONS = [4, 18, 32, 46, 60, 74], "160x120", 5, 300
RATES = {"means": 3.2e-4, "log_scales": 5e-3, "quaternions": 1e-3, "opacity_logits": 5e-2, "sh": 2.5e-3, "sh_rest_divisor": 20.0}
SETTINGS = {"lambda_photometric": 0.8, "lambda_ssim": 0.2, "lambda_depth": 0.2, "lambda_dynamic": 0.2, "min_opacity": 0.5,
            "beta1": 0.9, "beta2": 0.999, "eps": 1e-15} | {f"rate_{name}": rate for name, rate in RATES.items()}
TENSORS = ["means", "log_scales", "quaternions", "opacity_logits", "sh"]


def run(*words):
    subprocess.run([str(word) for word in words], check=True)


def rotation(q):
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def views(recording):
    """Camera; per frame colour, depth in metres, pixels of people, camera_from_world."""
    lines = lambda name: [line.split() for line in (recording / name).read_text().splitlines() if line[0] != "#"]
    width, height, fx, fy, cx, cy, factor, _ = map(float, lines("camera.txt")[0])
    found = []
    for frame in FRAMES:
        read = lambda name, flag: cv2.imread(str(recording / lines(name)[frame][1]), flag)
        color = read("rgb.txt", cv2.IMREAD_COLOR)[:, :, ::-1] / 255
        depth = read("depth.txt", cv2.IMREAD_UNCHANGED) / factor
        mask = cv2.imread(str(recording / "mask" / pathlib.Path(lines("rgb.txt")[frame][1]).name), cv2.IMREAD_GRAYSCALE) > 0
        _, *t, x, y, z, w = map(float, lines("groundtruth.txt")[frame])
        q = np.array([w, -x, -y, -z])
        found.append((color, depth, mask, q, -rotation(q) @ t))
    return (int(width), int(height), [fx, fy, cx, cy]), found


def seeds(camera, found):
    """A round Gaussian per EVERY pixels each way, with sigma of 0.6 samples, an opacity of 0.9 and the pixel's colour."""
    _, _, (fx, fy, cx, cy) = camera
    rows = []
    for color, depth, mask, q, t in found:
        v, u = np.mgrid[2:depth.shape[0]:EVERY, 2:depth.shape[1]:EVERY].reshape(2, -1)
        good = (depth[v, u] > 0) & ~mask[v, u]
        u, v, z = u[good], v[good], depth[v, u][good]
        p = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], 1)
        rows.append(((p - t) @ rotation(q), np.log(0.6 * EVERY * z / fx), color[v, u]))
    means, scale, color = (np.concatenate(part) for part in zip(*rows))
    n = len(means)
    return {"means": means, "log_scales": np.repeat(scale[:, None], 3, 1), "quaternions": np.tile([1.0, 0, 0, 0], (n, 1)),
            "opacity_logits": np.full(n, np.log(9)), "sh": (color[:, None] - 0.5) / 0.28209479177387814}


def write_case(folder, stage, camera, inputs, params, shared=()):
    """`shared` names further inputs that are the same file as an earlier one."""
    folder.mkdir(parents=True, exist_ok=True)
    table = {}
    for name, array in inputs.items():
        array = np.asarray(array, np.float32 if name.startswith("measured") else None)
        array = array.astype(np.uint8 if array.dtype in (bool, np.uint8) else array.dtype)
        np.save(folder / f"{name}.npy", array)
        kind = {"float64": "f64", "float32": "f32", "uint8": "u8"}[str(array.dtype)]
        table[name] = {"dtype": kind, "shape": list(array.shape), "unit": "1", "file": f"{name}.npy"}
    table |= {name: table[same] for name, same in shared}
    width, height, k = camera
    for name, numbers in {"intrinsics": k, "background": [0.0, 0.0, 0.0]}.items():
        table[name] = {"dtype": "f64", "shape": [len(numbers)], "unit": "1", "data": numbers}
    manifest = {"schema": 1, "stage": stage, "case": folder.name, "equations": [], "why": "training of a whole map", "flags": [],
                "basis": "none", "generator": {"script": "ports/wgpu/compare_training.py", "version": 1, "seed": 0},
                "params": params | {"width": width, "height": height}, "inputs": table, "outputs": {}}
    (folder / "case.json").write_text(json.dumps(manifest))


def observations(found):
    inputs = {}
    for i, (color, depth, mask, q, t) in enumerate(found):
        inputs |= {f"target_{i}": color, f"measured_{i}": depth, f"excluded_{i}": mask,
                   f"camera_from_world_q_{i}": q, f"camera_from_world_t_{i}": t}
    return inputs


def psnr(garad, folder, camera, found, gaussians):
    figures = []
    for i, (color, _, mask, q, t) in enumerate(found):
        case = folder / f"render_{i}"
        write_case(case, "raster", camera, gaussians | {"camera_from_world_q": q, "camera_from_world_t": t}, {"sh_degree": 0})
        run(garad, "golden", "answer", case, case / "out")
        error = (np.clip(np.load(case / "out/color.npy"), 0, 1) - color)[~mask]
        figures.append(-10 * np.log10((error ** 2).mean()))
    return np.array(figures)


def main(garad, port, folder):
    folder = pathlib.Path(folder)
    run(garad, "synth", "walking", "--frames", 75, "--size", SIZE, "--noise", "--quiet", "-o", folder / "recording")
    camera, found = views(folder / "recording")
    start = seeds(camera, found)
    count, n = len(found), len(start["means"])
    kinds = ["target", "measured", "excluded", "camera_from_world_q", "camera_from_world_t"]
    shared = [(f"{kind}_{i}", f"{kind}_{i % count}") for i in range(count, ITERATIONS) for kind in kinds]
    write_case(folder / "training", "train_step", camera, start | observations(found) | {"dynamic": np.zeros(n, np.uint8)},
               SETTINGS | {"iterations": ITERATIONS, "sh_degree": 0, "views": count}, shared)
    run(port, "train", folder / "training", folder / "gpu")
    run(garad, "golden", "answer", "--width", "f32", folder / "training", folder / "cpu")
    load = lambda path: np.load(path).astype(np.float64)
    last = {name: load(folder / f"cpu/{name}_{ITERATIONS - 1}.npy") for name in TENSORS}
    gpu = {name: load(folder / f"gpu/{name}.npy") for name in TENSORS}
    before, by_cpu, by_gpu = (psnr(garad, folder / "rendered", camera, found, m) for m in (start, last, gpu))
    own = load(folder / "gpu/psnr.npy")
    print(f"{n} Gaussians, {count} views of {SIZE}, {ITERATIONS} iterations; PSNR in dB:")
    print("view   before     CPU     GPU  GPU by its own renderer")
    for i in range(count):
        print(f"{i:4} {before[i]:8.3f} {by_cpu[i]:7.3f} {by_gpu[i]:7.3f} {own[i]:7.3f}")
    print(f"mean {before.mean():8.3f} {by_cpu.mean():7.3f} {by_gpu.mean():7.3f} {own.mean():7.3f}")
    loss = [float(load(folder / f"cpu/loss_{i}.npy")[0]) for i in range(ITERATIONS)], load(folder / "gpu/loss.npy")
    print("loss, CPU and GPU:", ", ".join(f"{i + 1}: {loss[0][i]:.6f} {loss[1][i]:.6f}" for i in (0, 9, 99, ITERATIONS - 1)))
    return 0 if abs(by_cpu.mean() - by_gpu.mean()) < 0.1 else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
