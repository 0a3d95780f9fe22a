"""Writes golden cases: one folder with case.json and little-endian, C-order .npy files.

    from case import write_case
    write_case("fast", "noise_20", basis="opencv", why="...", script="gen/fast.py", seed=17,
               params={"threshold": 20},
               inputs={"image": (image, "1")},
               outputs={"xy": (xy, "px", "exact")})

Inputs are (array, unit), outputs (array, unit, tolerance); tolerances are entries of
crates/golden/src/tol.rs. Arrays of at most 64 numbers are written into case.json, where a
reviewer can read them. The same call always writes the same bytes.

    Needs: numpy (2.4.6).
"""

import json
import math
import pathlib
import shutil

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
INLINE_MAX = 64
FILE_MAX_BYTES = 256 * 1024
DTYPES = {
    "float32": "f32", "float64": "f64", "int8": "i8", "uint8": "u8", "int16": "i16", "uint16": "u16",
    "int32": "i32", "uint32": "u32", "int64": "i64", "bool": "bool",
}


def _scalar(value):
    """JSON has no NaN and no infinities: they become strings."""
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def _nested(value):
    return [_nested(v) for v in value] if isinstance(value, list) else _scalar(value)


def _entry(folder, name, array, unit, tol=None):
    array = np.ascontiguousarray(array).reshape(np.shape(array))
    if array.dtype.name not in DTYPES:
        raise TypeError(f"{name}: dtype {array.dtype} is not one of {sorted(DTYPES)}")
    entry = {"dtype": DTYPES[array.dtype.name], "shape": list(array.shape), "unit": unit}
    if array.size <= INLINE_MAX:
        entry["data"] = _nested(array.tolist())
    else:
        path = folder / f"{name}.npy"
        with open(path, "wb") as file:
            np.lib.format.write_array(file, array.astype(array.dtype.newbyteorder("<")), version=(1, 0))
        if path.stat().st_size > FILE_MAX_BYTES:
            raise ValueError(f"{path}: {path.stat().st_size} bytes; at most {FILE_MAX_BYTES}")
        entry["file"] = path.name
    if tol is not None:
        entry["tol"] = tol
    return entry


def write_case(stage, case, *, basis, why, script, inputs, outputs, params=None, equations=(), flags=(),
               version=1, seed=None, root=ROOT):
    """Replaces the folder root/stage/case."""
    both = set(inputs) & set(outputs)
    if both:
        raise ValueError(f"{stage}/{case}: input and output share a file: {sorted(both)}")
    folder = pathlib.Path(root) / stage / case
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    head = {
        "schema": 1, "stage": stage, "case": case, "equations": list(equations), "why": why,
        "flags": list(flags), "basis": basis,
        "generator": {"script": script, "version": version, "seed": seed},
        "params": params or {},
    }
    entries = {
        "inputs": {n: _entry(folder, n, *v) for n, v in inputs.items()},
        "outputs": {n: _entry(folder, n, *v) for n, v in outputs.items()},
    }
    dump = lambda value: json.dumps(value, allow_nan=False, ensure_ascii=False)
    lines = [f"  {dump(key)}: {dump(value)}," for key, value in head.items()]
    for group, tensors in entries.items():
        body = ",\n".join(f"    {dump(n)}: {dump(e)}" for n, e in tensors.items())
        end = "}," if group == "inputs" else "}"
        lines.append(f"  {dump(group)}: {{\n{body}\n  {end}" if body else f"  {dump(group)}: {{{end}")
    (folder / "case.json").write_text("{\n" + "\n".join(lines) + "\n}\n", encoding="utf-8")
    return folder
