"""A port of the rasterizer and the training step in PyTorch, on the CPU, in float64: the forward pass as
its formulas read, and every gradient by autograd.

    garad golden check --exec 'python3 examples/adapter_torch/adapter.py {case} {out}'

Needs PyTorch (written with torch 2.15.0) and numpy. Exit code 77 says that a stage is not ported.
"""

import importlib
import json
import pathlib
import sys

# Stage: module and function from a case to its outputs.
STAGES = {
    "projection_covariance": ("splat", "projection_stage"),
    "sh": ("harmonics", "stage"),
    "raster": ("splat", "forward_stage"),
    "raster_backward": ("splat", "backward_stage"),
    "losses": ("losses", "stage"),
    "adam": ("train", "adam_stage"),
    "train_step": ("train", "stage"),
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
