"""Mutants of this port, each with a mistake that ports have: every one must fail, and first at its own stage. Below
them, changes that are legal and must pass.

    python3 examples/adapter_numpy/mutants.py            (a minute; garad must be built)
    python3 examples/adapter_numpy/mutants.py half_pixel --show

GARAD names the program, else target/release/garad, target/debug/garad or the one in the PATH is taken.
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

import numpy as np

import adam
import adapter
import flow
import harmonics
import losses
import render
import splats

F = np.float32
FITS = "fits, if this mistake is undone: "
ROOT = pathlib.Path(__file__).resolve().parents[2]


def swap(module, name, make):
    """Replaces something of a module by make(what it was)."""
    setattr(module, name, make(getattr(module, name)))


def after(change):
    """The function, with its result changed."""
    return lambda f: lambda *a, **k: change(f(*a, **k))


def changed(result, **fields):
    return result | {name: f(result[name]) for name, f in fields.items()}


def half_pixel():
    swap(render, "pixel_grid", after(lambda xy: tuple(v + F(0.5) for v in xy)))


def no_dilation():
    splats.BLUR_PX2 = F(0)


def quaternion_order():
    swap(splats, "quaternion_rows", lambda f: lambda q: f(np.roll(q, 1, -1)))


def transposed_rotation():
    swap(splats, "view", after(lambda v: changed(v, w=np.transpose)))


def world_for_camera():
    swap(splats, "view", after(lambda v: v | {"w": v["w"].T, "t": -v["t"] @ v["w"]}))


def principal_point():
    def centred(v):
        (fx, fy, _, _), (width, height) = v["k"], v["size"]
        return v | {"k": np.array([fx, fy, (width - 1) / 2, (height - 1) / 2], F)}
    swap(splats, "view", after(centred))


def no_clamp():
    splats.CLAMP = F(1e6)


def sh_sign():
    harmonics.BASIS[1], harmonics.BASIS[3] = [(harmonics.C[1], 0, 1, 0)], [(harmonics.C[1], 1, 0, 0)]


def sh_order():
    harmonics.BASIS[1], harmonics.BASIS[3] = harmonics.BASIS[3], harmonics.BASIS[1]


def sort_by_distance():
    splats.sort_keys = lambda s: np.lexsort((s["index"], (s["p"] ** 2).sum(1)))


def sort_in_half():
    """Keys in 16 bits: near depths become ties."""
    splats.sort_keys = lambda s: np.lexsort((s["index"], s["depth_m"].astype(np.float16)))


def no_alpha_threshold():
    render.MIN_ALPHA = F(0)


def no_alpha_limit():
    render.MAX_ALPHA = F(1)


def background_in_full():
    render.leftover = lambda color, left, background: color + background


def background_missing():
    render.leftover = lambda color, left, background: color


def no_stop():
    render.is_last = lambda behind: np.zeros(behind.shape, bool)


def early_stop():
    render.MIN_T = F(1e-3)


def conic_factor():
    """Entries off the diagonal counted once: the factor of the CUDA rasterizer."""
    once = lambda c: c * np.array([1, 0.5, 1], F)
    swap(render, "blend_backward", after(lambda g: changed(g, cov=once, conic=once)))


def subtle_conic():
    swap(render, "blend_backward", after(lambda g: changed(g, cov=lambda c: c * np.array([1, F(0.9999), 1], F))))


def opacity_for_logit():
    swap(splats, "project_backward", lambda f: lambda g, s, *rest: f(changed(g, opacity=lambda o: o / (s["opacity"] * (1 - s["opacity"]))), s, *rest))


def length_forgotten():
    """The gradient by the unit quaternion, without the length it was divided by."""
    swap(splats, "rotation_backward", lambda f: lambda d, q: f(d, q) * splats.quaternion_rows(q)[1])


def no_gradient_through_direction():
    swap(harmonics, "tangent_gradient", lambda f: lambda d, n: np.zeros((len(d), n, 3), F) if sys._getframe(1).f_code.co_name != "stage" else f(d, n))


def background_not_in_gradient():
    swap(render, "blend_backward", lambda f: lambda tape, s, background, *rest: f(tape, s, F(0) * background, *rest))


def coarse_exp():
    """exp off by 1e-4. 1e-5 would pass: a float32 renderer may lose 2.3e-5 of the brightest colour."""
    swap(splats, "paint", after(lambda s: changed(s, opacity=lambda o: o * F(1 + 1e-4))))


def ssim_window():
    losses.WINDOW = np.full(11, 1 / 11, F)


def adam_without_correction():
    def plain(self, gradient, rate):
        self.m += F(1 - self.b1) * (gradient - self.m)
        self.v += F(1 - self.b2) * (gradient * gradient - self.v)
        return rate * self.m / (np.sqrt(self.v) + F(self.eps))
    adam.Adam.step = plain


def truncated_window():
    """Interpolation weights cut off instead of rounded, as whole numbers in C are."""
    flow.np = type("numpy", (), {**vars(np), "rint": staticmethod(np.floor)})


def sums_backwards():
    """Images and their gradients added from the last pixel on."""
    def turned(f):
        def g(tape, s, background, *up):
            flip = lambda a: a[::-1, ::-1].copy()
            back = [(entry[0], *(flip(v) if isinstance(v, np.ndarray) and v.ndim > 1 else v for v in entry[1:])) for entry in tape]
            return f(back, s, background, *(flip(u) if isinstance(u, np.ndarray) else u for u in up))
        return g
    swap(render, "blend_backward", turned)


def noisy_exp():
    """exp right to 2 units in the last place, as on a GPU."""
    rng = np.random.default_rng(3)
    noisy = lambda v: np.exp(v) * (1 + F(2.4e-7) * rng.uniform(-1, 1, np.shape(v)).astype(F)) if np.ndim(v) > 1 else np.exp(v)
    render.np = type("numpy", (), {**vars(np), "exp": staticmethod(noisy)})


def plain_power():
    """The density from the conic as it stands, not as a sum of squares."""
    def plain(f):
        def g(s, *rest):
            (a, b, c) = s["conic"].T
            with np.errstate(all="ignore"):
                return f(s | {"cov": np.stack([s["cov"][:, 0], -b / a * (1 / (c - b * b / a)), 1 / (c - b * b / a)], 1)}, *rest)
        return g
    swap(render, "blend", plain)


MUTANTS = {
    half_pixel: "raster", no_dilation: "projection_covariance", quaternion_order: "projection_covariance",
    transposed_rotation: "projection_covariance", world_for_camera: "projection_covariance", principal_point: "projection_covariance",
    no_clamp: "projection_covariance", sh_sign: "sh", sh_order: "sh", sort_by_distance: "raster", sort_in_half: "raster",
    no_alpha_threshold: "raster", no_alpha_limit: "raster", background_in_full: "raster", background_missing: "raster",
    no_stop: "raster", early_stop: "raster", conic_factor: "raster_backward", subtle_conic: "raster_backward",
    opacity_for_logit: "raster_backward", length_forgotten: "raster_backward", no_gradient_through_direction: "raster_backward",
    background_not_in_gradient: "raster_backward", coarse_exp: "raster", ssim_window: "losses", adam_without_correction: "adam",
    truncated_window: "lk",
}
LEGAL = [sums_backwards, noisy_exp, plain_power]


def program():
    named = os.environ.get("GARAD")
    built = [ROOT / "target" / profile / "garad" for profile in ("release", "debug")]
    found = named or next((str(p) for p in built if p.is_file()), None) or shutil.which("garad")
    return found or sys.exit("garad is not built: cargo build --release, or name it in GARAD")


def judged(name):
    """The verdicts on one mutant, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, __file__, "--answer", name, folder], check=True)
        stages = [word for stage in adapter.STAGES for word in ("--stage", stage)]
        report = pathlib.Path(folder) / "report.json"
        command = [program(), "golden", "check", "--cases", ROOT / "tests/golden", "--actual", folder, "--json", report, *stages]
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode > 1:
            sys.exit(ended.stderr)
        return ended, json.loads(report.read_text())


def answer_all(name, folder):
    if name != "none":
        globals()[name]()
    np.seterr(all="ignore")
    for case in sorted((ROOT / "tests/golden").glob("*/*/case.json")):
        if case.parent.parent.name in adapter.STAGES:
            out = pathlib.Path(folder) / case.parent.parent.name / case.parent.name
            out.mkdir(parents=True)
            adapter.answer(case.parent, out)


def main():
    asked = [f for f in [*MUTANTS, *LEGAL] if not sys.argv[1:] or f.__name__ in sys.argv[1:]]
    right = True
    print(f"{'mutant':30} {'belongs to':22} {'first to fail':22} named as")
    for mutant in asked:
        ended, report = judged(mutant.__name__)
        if "--show" in sys.argv:
            print(ended.stdout)
        failed = [case for case in report["cases"] if case["verdict"] != "pass"]
        first = failed[0]["stage"] if failed else "none"
        notes = [o["note"] for case in failed for o in case["outputs"] if o["verdict"] != "pass" and o["note"]]
        marks = [n for n in notes if n.startswith(FITS)] or notes
        note = marks[0].removeprefix(FITS) if marks else ""
        expected = MUTANTS.get(mutant, "none")
        right &= first == expected
        print(f"{mutant.__name__:30} {expected:22} {first:22} {note}{'' if first == expected else '  <-- NOT AS IT SHOULD BE'}", flush=True)
    sys.exit(0 if right else 1)


if __name__ == "__main__":
    answer_all(*sys.argv[2:4]) if sys.argv[1:2] == ["--answer"] else main()
