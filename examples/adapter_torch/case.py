"""Reads the inputs of a golden case as tensors and writes outputs as .npy."""

import json
import pathlib

import numpy as np
import torch

torch.set_default_dtype(torch.float64)
torch.set_num_threads(1)

DTYPES = {"f32": "f4", "f64": "f8", "i8": "i1", "u8": "u1", "i16": "i2", "u16": "u2", "i32": "i4", "u32": "u4", "i64": "i8", "bool": "?"}


class Case:
    """`case["means"]` is an input, `case.params["width"]` a parameter. Expected outputs are not looked at."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        manifest = json.loads((self.folder / "case.json").read_text(encoding="utf-8"))
        self.stage, self.params, self.inputs = manifest["stage"], manifest["params"], manifest["inputs"]

    def __contains__(self, name):
        return name in self.inputs

    def __getitem__(self, name):
        entry = self.inputs[name]
        if "file" in entry:
            array = np.load(self.folder / entry["file"])
        else:
            array = np.array(entry["data"], DTYPES[entry["dtype"]]).reshape(entry["shape"])     # "nan" and "inf" are strings
        if array.dtype.kind == "f":
            array = array.astype(np.float64)
        return torch.from_numpy(np.ascontiguousarray(array.reshape(entry["shape"])))


def write(folder, outputs):
    """One OUTPUT.npy per output. float64 is saved as float64: the checker takes its tolerance from the type."""
    for name, tensor in outputs.items():
        np.save(pathlib.Path(folder) / f"{name}.npy", np.ascontiguousarray(tensor.detach().numpy()))
