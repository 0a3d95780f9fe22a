"""A port of some stages in numpy, in float32: what has to be written to check one's own.

    garad golden check --exec 'python3 examples/adapter_numpy/adapter.py {case} {out}'

Exit code 77 says that a stage is not ported.
"""

import importlib
import json
import pathlib
import sys

# Stage: module and function from a case to its outputs.
STAGES = {
    "sh": ("harmonics", "stage"),
    "projection_covariance": ("splats", "stage"),
    "raster": ("render", "forward"),
    "raster_backward": ("render", "backward"),
    "losses": ("losses", "stage"),
    "adam": ("adam", "stage"),
    "train_step": ("train", "stage"),
    "lk": ("flow", "stage"),
}


def answer(folder, out):
    """Writes the outputs of a case; False if its stage is not ported."""
    stage = json.loads((pathlib.Path(folder) / "case.json").read_text(encoding="utf-8"))["stage"]
    if stage not in STAGES:
        return False
    module, function = STAGES[stage]
    case = importlib.import_module("case")
    case.write(out, getattr(importlib.import_module(module), function)(case.Case(folder)))
    return True


if __name__ == "__main__":
    sys.exit(0 if answer(*sys.argv[1:3]) else 77)
