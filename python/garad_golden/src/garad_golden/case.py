"""`Case`: one folder with inputs, parameters and expected outputs; and where the folders are."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import npy
from .npy import DTYPES, Array, NpyError
from .table import FILE, Table, Tolerance

VARIABLE = "GARAD_GOLDEN"
_REQUIRED = {"schema", "stage", "case", "why", "basis", "generator", "outputs"}
_OPTIONAL = {"equations", "flags", "params", "inputs"}
_WORDS = {"nan": float("nan"), "inf": float("inf"), "-inf": float("-inf")}


class CaseError(Exception):
    """A case, or the folder of all cases, that cannot be used."""


@dataclass(frozen=True)
class Case:
    """A golden case, read whole. A stage is given `inputs` and `params`; `outputs` must come out."""

    folder: Path
    table: Table = field(repr=False)
    stage: str
    case: str
    why: str
    basis: str
    equations: list[str]
    flags: list[str]
    params: dict[str, Any]
    inputs: dict[str, Array] = field(repr=False)
    outputs: dict[str, Array] = field(repr=False)
    #: Unit of each input and output, in words.
    units: dict[str, str] = field(repr=False)
    #: Name of the tolerance of each output.
    tolerances: dict[str, str] = field(repr=False)

    @property
    def name(self) -> str:
        """STAGE/CASE."""
        return f"{self.stage}/{self.case}"

    @classmethod
    def load(cls, folder: str | Path, table: Table | None = None) -> Case:
        """Reads the case in a folder; `table` is `tolerances.json` of the folder of all cases unless given.

        Raises CaseError with the file and what is wrong.
        """
        folder = Path(folder)
        path = folder / "case.json"
        if table is None:
            table = load_table(folder.resolve().parent.parent)
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise CaseError(f"{path}: {error}") from error
        odd = sorted((data.keys() - _REQUIRED - _OPTIONAL) | (_REQUIRED - data.keys()))
        if odd:
            raise CaseError(f"{path}: missing or not known: {', '.join(odd)}")
        if data["schema"] != 1:
            raise CaseError(f"{path}: schema {data['schema']}; expected 1")
        inputs, outputs = data.get("inputs", {}), data["outputs"]

        def tensors(entries: dict[str, Any]) -> dict[str, Array]:
            return {name: _tensor(folder, name, entry, table) for name, entry in sorted(entries.items())}

        return cls(
            folder=folder, table=table, stage=data["stage"], case=data["case"], why=data["why"], basis=data["basis"],
            equations=data.get("equations", []), flags=data.get("flags", []), params=data.get("params", {}),
            inputs=tensors(inputs), outputs=tensors(outputs),
            units={name: entry["unit"] for name, entry in (inputs | outputs).items()},
            tolerances={name: entry.get("tol", "") for name, entry in outputs.items()},
        )

    def tolerance(self, output: str, dtype: str = "f64") -> Tolerance:
        """What an answer of a type is held to: of dtype f32 where f64 is expected, the entry for float32.

        Raises KeyError if the table has no such entry.
        """
        wide = self.table.tolerances[self.tolerances[output]]
        if dtype == "f32" and npy.dtype_name(self.outputs[output]) == "f64":
            return self.table.for_f32(self.stage, output, self.flags, wide)
        return wide


def _tensor(folder: Path, name: str, entry: dict[str, Any], table: Table) -> Array:
    """From its file or its inline data; type and shape must be those stated."""
    where = f"{folder / 'case.json'}: tensor '{name}'"
    if not {"dtype", "shape", "unit"} <= entry.keys() or not entry.keys() <= {"dtype", "shape", "unit", "file", "data", "tol"}:
        raise CaseError(f"{where}: has {', '.join(sorted(entry))}")
    if entry["dtype"] not in DTYPES:
        raise CaseError(f"{where}: unknown dtype '{entry['dtype']}'")
    dtype, shape = np.dtype(DTYPES[entry["dtype"]]), tuple(entry["shape"])
    if ("file" in entry) == ("data" in entry):
        raise CaseError(f"{where}: needs either 'file' or 'data'")
    try:
        if "file" in entry:
            file = entry["file"]
            if "/" in file or "\\" in file or file.startswith("."):
                raise CaseError(f"{where}: file '{file}' is not a plain name")
            array = npy.read(folder / file, table.limits)
        else:
            flat: list[Any] = []
            _flatten(entry["data"], shape, dtype, flat)
            array = npy.exact(np.array(flat, dtype).reshape(shape), table.limits["whole_number"])
    except (OSError, NpyError, ValueError, OverflowError) as error:
        raise CaseError(f"{where}: {error}") from error
    if (array.dtype, array.shape) != (dtype, shape):
        raise CaseError(f"{where}: stated {dtype} {shape}, but {array.dtype} {array.shape} is there")
    return array


def _flatten(data: Any, shape: tuple[int, ...], dtype: np.dtype[Any], out: list[Any]) -> None:
    """Nested lists, as deep as the shape is long, in C order."""
    if shape:
        if not isinstance(data, list) or len(data) != shape[0]:
            raise ValueError(f"expected lists of shape {list(shape)}, got {data}")
        for item in data:
            _flatten(item, shape[1:], dtype, out)
        return
    if dtype.kind == "f":
        value = _WORDS.get(data) if isinstance(data, str) else data
        sound = isinstance(value, (int, float)) and not isinstance(value, bool)
    elif dtype.kind == "b":
        value, sound = data, isinstance(data, bool)
    else:
        value = data
        sound = isinstance(data, int) and not isinstance(data, bool) and np.iinfo(dtype).min <= data <= np.iinfo(dtype).max
    if not sound:
        raise ValueError(f"{data!r} is not a value of type {dtype}")
    out.append(value)


def find_root(cases: str | Path | None = None) -> Path:
    """The folder with STAGE/CASE/case.json.

    The one asked for; else the one that the environment names in GARAD_GOLDEN; else `tests/golden` with a
    `tolerances.json` in the current folder or the nearest one above. Raises CaseError if there is none.
    """
    if cases is not None:
        return Path(cases)
    if named := os.environ.get(VARIABLE):
        if not Path(named).is_dir():
            raise CaseError(f"{VARIABLE}={named}: no such folder")
        return Path(named)
    here = Path.cwd()
    for folder in (here, *here.parents):
        if (folder / "tests/golden" / FILE).is_file():
            return folder / "tests/golden"
    raise CaseError(
        f"no golden cases: name their folder with --cases DIR or with the variable {VARIABLE}, or start in a checkout "
        f"(tests/golden is neither in {here} nor above it)")


def load_table(root: str | Path | None = None, file: str | Path | None = None) -> Table:
    """`tolerances.json`: the file asked for; else that beside the cases; else that of `find_root()`, for cases kept elsewhere."""
    try:
        if file is None:
            file = find_root(root) / FILE
            if root is not None and not file.is_file():
                file = find_root() / FILE
        return Table.load(Path(file))
    except (OSError, ValueError, KeyError) as error:
        raise CaseError(f"{file}: {error}") from error


def load_cases(
    root: str | Path | None = None, stages: Iterable[str] = (), names: Iterable[str] = (), tag: str | None = None,
    table: Table | None = None,
) -> list[Case]:
    """The cases under a root in the order of the data, all or those of some stages, names, and a flag or basis.

    Raises CaseError if a stage is unknown, if there is none, or if one cannot be read.
    """
    root = find_root(root)
    if table is None:
        table = load_table(root)
    if not root.is_dir():
        raise CaseError(f"{root}: no such folder")
    stages, names = list(stages), list(names)
    folders = sorted(path.parent for path in root.glob("*/*/case.json"))
    cases = [Case.load(folder, table) for folder in folders]
    known = sorted({case.stage for case in cases})
    for stage in stages:
        if stage not in known:
            raise CaseError(f"no stage '{stage}'; there is {', '.join(known)}")
    cases = [
        case for case in cases
        if (not stages or case.stage in stages) and (not names or case.case in names)
        and (tag is None or tag in case.flags or tag == case.basis)
    ]
    if not cases:
        raise CaseError(f"{root}: no such case")
    rank = table.rank
    return sorted(cases, key=lambda case: (rank(case.stage), case.name))
