"""Puts one mistake at a time into the kernels, and shows what the golden cases say of each.

    python3 ports/wgpu/faults.py GARAD PORT

Prints the first stage that fails, and how many cases do. What no committed case finds is tried on a larger one from `golden make`. Exit
code 1 if a fault is found elsewhere than stated in FAULTS. Kernels are read from a folder (`GARAD_WGPU_SHADERS`), so nothing is built.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

SHADERS = pathlib.Path(__file__).parent / "src/shaders"
STAGES = ["sh", "projection_covariance", "raster", "raster_backward", "losses", "adam", "train_step", "mean_field"]
AT_SIZE = ["--stage", "raster", "--stage", "raster_backward", "--scene", "soft", "--gaussians", "3000", "--size", "200x150"]
# File, stage that must fail first, what, correct text, faulty text. `size`: only at size. None: is not
# found on lavapipe (README.md).
FAULTS = [
    ("common", "sh", "a sign of the harmonics", "-SH[1] * y, SH[1] * z", "SH[1] * y, SH[1] * z"),
    ("project", "projection_covariance", "quaternion as x y z w",
     "vec4(map[at + 6u], map[at + 7u], map[at + 8u], map[at + 9u])", "vec4(map[at + 9u], map[at + 6u], map[at + 7u], map[at + 8u])"),
    ("project", "projection_covariance", "pixel centres at a half", "+ view.intrinsics.zw;", "+ view.intrinsics.zw - 0.5;"),
    ("project", "raster", "determinant a c - b²", "dot(c, c) + BLUR", "a * d - b * b + BLUR"),
    ("project", "projection_covariance", "radius not rounded up", "ceil(3.0 * sqrt(largest))", "floor(3.0 * sqrt(largest))"),
    ("project", "raster", "depth cut to 16 bits", "= bitcast<u32>(g.p.z);", "= bitcast<u32>(g.p.z) & 0xffff0000u;"),
    ("sort", "raster", "equal digits change places", "for (var t = 0u; t < THREADS; t += 1u) {\n            let mine",
     "for (var s = 0u; s < THREADS; s += 1u) {\n            let t = THREADS - 1u - s;\n            let mine"),
    ("sort", "raster", "only the lower three bits of a digit", "& (BINS - 1u)", "& (BINS / 2u - 1u)"),
    ("binning", "raster", "lists without their last splat", "ranges[2u * tile + 1u] = i + 1u;", "ranges[2u * tile + 1u] = i;"),
    ("binning", None, "reads behind the end of a buffer", "if i + 1u == count || sorted", "if sorted"),
    ("blend", "raster", "tiles counted by columns", "ranges[tile.y * view.tiles_x + tile.x];\n    var r", "ranges[tile.x * view.tiles_y + tile.y];\n    var r"),
    ("blend", "raster", "pixel finished after the splat", "let drawn = thick & open;", "let drawn = thick;"),
    ("blend", "size", "place in the batch, not in the list", "vec4(start + k + 1u - range.x)", "vec4(k + 1u)"),
    ("blend", "raster_backward", "splat behind the last one", "(vec4(place) < last)", "(vec4(place) <= last)"),
    ("blend", "raster_backward", "last of one of the four pixels", "max(max(last.x, last.y), max(last.z, last.w))", "last.x"),
    ("blend", "raster_backward", "63 of 64 columns added", "t < 64u; t += 1u", "t < 63u; t += 1u"),
    ("blend", "raster_backward", "light not carried through", "alpha * gain + through * light", "gain"),
    ("blend", "raster_backward", "no gradient by opacity", "light[p] = -upstream[5u * i + 4u];", "light[p] = 0.0;"),
    ("blend", "raster_backward", "clamped alpha passes a gradient", "vec4(view.pass_through != 0u)", "vec4(true)"),
    ("project", "raster_backward", "off-diagonal entry once", "let g_xy = a *", "let g_xy = 0.5 * a *"),
    ("project", "raster_backward", "first row of slots alone", "e < 10u * (mine.x + mine.y)", "e < 10u * (mine.x + 1u)"),
    ("project", "raster_backward", "direction of view detached", "d_p.z * view.w2.xyz + d_offset", "d_p.z * view.w2.xyz"),
    ("project", "raster_backward", "by opacity, not by its logit", "g_opacity * opacity * (1.0 - opacity)", "g_opacity"),
    ("sum", "raster_backward", "a level of the tree left out", "half > 0u", "half > 1u"),
    ("losses", "losses", "excluded pixels in the mean of S", "let share = counts[i / 3u] /", "let share = 1.0 /"),
    ("losses", "losses", "depth where nothing was rendered", "&& opacity[i] >= depth_settings.min_opacity", ""),
    ("losses", None, "1 - o as a difference", "sigmoid(-logits[at])", "(1.0 - o)"),
    ("adam", "adam", "no correction of the first moment", "(m / step.first_bias)", "m"),
    ("adam", "adam", "epsilon inside the root", "sqrt(v / step.second_bias) + step.epsilon", "sqrt(v / step.second_bias + step.epsilon)"),
    ("losses", "losses", "gradient of dynamic Gaussians replaced", "by_logit[at] += ", "by_logit[at] = 0.5 * "),
    ("field", "mean_field", "a tile of nodes that is not full", "let size = min(64u, field.nodes - start);\n        var part = mat2x4<f32>();\n        for (var k = 0u; k < size; k += 1u) {\n            let pair",
     "let size = 64u;\n        var part = mat2x4<f32>();\n        for (var k = 0u; k < size; k += 1u) {\n            let pair"),
    ("field", "mean_field", "a node without a pixel has one at 0", "let both_px = a.has_pixel * b.p.w;", "let both_px = vec4(1.0);"),
    ("field", "mean_field", "own message twice", "(a.i != vec4(j)) | vec4(field.self_message != 0u)", "vec4(true)"),
]


def check(garad, port, shaders, *where):
    """Stages of the cases that do not pass, in the order of STAGES, and how many cases they are."""
    words = [garad, "golden", "check", "--exec-batch", f"{port} list {{list}}", *where]
    done = subprocess.run(words, env=os.environ | {"GARAD_WGPU_SHADERS": str(shaders)}, capture_output=True, text=True)
    bad = re.findall(r"^(\w+) +\w+ +(?:FAIL|NONFINITE|CRASH|TIMEOUT|missing)\b", done.stdout, re.M)
    if (done.returncode == 0) == bool(bad):
        sys.exit(f"exit code {done.returncode}:\n{done.stdout}{done.stderr}")
    return [stage for stage in STAGES if stage in bad], len(bad)


def main(garad, port):
    wrong = 0
    made = tempfile.TemporaryDirectory()
    subprocess.run([garad, "golden", "make", *AT_SIZE, "-o", made.name], check=True, stdout=subprocess.DEVNULL)
    for file, expected, what, correct, faulty in FAULTS:
        with tempfile.TemporaryDirectory() as folder:
            shaders = pathlib.Path(shutil.copytree(SHADERS, folder, dirs_exist_ok=True)) / f"{file}.wgsl"
            text = shaders.read_text(encoding="utf-8")
            if text.count(correct) != 1:
                sys.exit(f"{file}.wgsl has {text.count(correct)} times: {correct}")
            shaders.write_text(text.replace(correct, faulty), encoding="utf-8")
            failing, count = check(garad, port, folder, *(f"--stage={stage}" for stage in STAGES))
            found = failing[0] if failing else None
            if not found:
                failing, count = check(garad, port, folder, "--cases", made.name)
                found = "size" if failing else None
        right = expected in (None, found)
        wrong += not right
        seen = {None: "not found", "size": f"{failing[0] if failing else ''}, at size alone"}.get(found, f"{found}, {count} cases")
        print(f"{what:42} {seen}{'' if right else f', expected {expected}'}", flush=True)
    print(f"{len(FAULTS) - wrong} of {len(FAULTS)} as stated")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
