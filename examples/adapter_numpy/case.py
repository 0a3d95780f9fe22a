"""Reads the inputs of a golden case and writes outputs; numpy and the standard library alone."""

import json
import pathlib

import numpy as np

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
            data = np.array(entry["data"], DTYPES[entry["dtype"]])      # "nan" and "inf" are strings
            array = data.reshape(entry["shape"])                        # lists without rows do not say how wide they are
        # A GPU computes in float32.
        return array.astype(np.float32) if array.dtype == np.float64 else array


def write(folder, outputs):
    """One OUTPUT.npy per output. What was computed in float32 is saved as float32: the checker
    takes its tolerance from the type."""
    for name, array in outputs.items():
        np.save(pathlib.Path(folder) / f"{name}.npy", np.ascontiguousarray(array))
