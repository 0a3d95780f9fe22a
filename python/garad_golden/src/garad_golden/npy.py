"""`.npy` files as golden cases use them: version 1.0, little-endian, C order, ten types of element.

numpy reads more than that. A judge that did would pass an answer that `garad golden check` cannot read.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: Names in `case.json`, and numpy's descriptors.
DTYPES: dict[str, str] = {
    "f32": "<f4", "f64": "<f8", "i8": "|i1", "u8": "|u1", "i16": "<i2", "u16": "<u2", "i32": "<i4", "u32": "<u4",
    "i64": "<i8", "bool": "|b1",
}
_NAMES = {descr: name for name, descr in DTYPES.items()}

_MAGIC = b"\x93NUMPY"
_MOST_DIMENSIONS = 32       # numpy's own limit
_BLANK = r"[ \n\t\r]*"
_SHAPE = rf"\({_BLANK}((?:[0-9]+{_BLANK}(?:,{_BLANK}|(?=\))))*)\)"
_ITEM = re.compile(
    rf"{_BLANK}'([!-&(-\[\]-~]*)'{_BLANK}:{_BLANK}(?:'([!-&(-\[\]-~]*)'|([A-Za-z]+)|{_SHAPE}){_BLANK}(?:,{_BLANK}|(?=\}}))"
)


class NpyError(Exception):
    """Bytes that are not such a file, or an array of a type that golden cases do not use."""


def dtype_name(array: Array) -> str:
    """`f32`, `f64`, `i8`, ... of an array of any byte order.

    Raises NpyError for a type that golden cases do not use, float16 and complex numbers among them.
    """
    descr = np.dtype(array.dtype.newbyteorder("<")).str
    if descr not in _NAMES:
        raise NpyError(f"element type '{descr}' is not one of {' '.join(DTYPES.values())}")
    return _NAMES[descr]


def exact(array: Array, whole_number: int) -> Array:
    """The array, if float64 holds each of its numbers exactly: |i| <= whole_number for 64-bit integers.

    Raises NpyError with the first that it does not.
    """
    if array.dtype.kind == "i" and array.dtype.itemsize == 8:
        flat = array.reshape(-1)
        beyond = np.flatnonzero((flat > whole_number) | (flat < -whole_number))
        if beyond.size:
            at = int(beyond[0])
            raise NpyError(f"{int(flat[at])} at position {at}; expected whole numbers of at most {whole_number}")
    return array


def _header(text: str) -> tuple[str, bool, tuple[int, ...]]:
    """`descr`, `fortran_order`, `shape` of a header, the keys in any order."""
    start = re.match(rf"{_BLANK}\{{", text)
    if start is None:
        raise NpyError("header: expected {")
    at = start.end()
    found: dict[str, Any] = {}
    while item := _ITEM.match(text, at):
        key, word, name, sizes = item.groups()
        if key in found:
            raise NpyError(f"header: '{key}' twice")
        found[key] = word if word is not None else {"True": True, "False": False}.get(name) if name else sizes
        if key == "shape" and sizes is not None:
            found[key] = tuple(int(size) for size in re.findall("[0-9]+", sizes))
        at = item.end()
    types = {"descr": str, "fortran_order": bool, "shape": tuple}
    sound = found.keys() == types.keys() and all(isinstance(found[k], t) for k, t in types.items())
    if not sound or re.fullmatch(rf"{_BLANK}\}}{_BLANK}", text[at:]) is None:
        raise NpyError(f"header: expected descr, fortran_order and shape, each once, got {text!r}")
    if len(found["shape"]) > _MOST_DIMENSIONS:
        raise NpyError(f"header: expected at most {_MOST_DIMENSIONS} dimensions")
    return found["descr"], found["fortran_order"], found["shape"]


def decode(data: bytes) -> Array:
    """The array in the bytes of a file. Raises NpyError with what is wrong."""
    if not data.startswith(_MAGIC):
        raise NpyError("not a .npy file: the first six bytes are not \\x93NUMPY")
    if len(data) < 10:
        raise NpyError("the file ends in its header")
    if (data[6], data[7]) != (1, 0):
        raise NpyError(f".npy version {data[6]}.{data[7]}; expected 1.0")
    end = 10 + int.from_bytes(data[8:10], "little")
    if end > len(data):
        raise NpyError(f"header of {end - 10} bytes, but {len(data) - 10} are there")
    descr, fortran, shape = _header(data[10:end].decode("latin-1"))
    if descr not in _NAMES:
        raise NpyError(f"element type '{descr}' is not one of {' '.join(DTYPES.values())}")
    if fortran:
        raise NpyError("Fortran order; expected C order")
    rest = len(data) - end
    if math.prod(shape) * np.dtype(descr).itemsize != rest:
        raise NpyError(f"shape {list(shape)} of '{descr}' does not have the {rest} bytes that are there")
    if descr == "|b1":
        odd = np.flatnonzero(np.frombuffer(data, "|u1", offset=end) > 1)
        if odd.size:
            raise NpyError(f"bool at position {int(odd[0])} has the value {data[end + int(odd[0])]}")
    return np.frombuffer(data, descr, offset=end).reshape(shape)


def read(path: Path, limits: dict[str, int]) -> Array:
    """A file of at most `limits["file_bytes"]`, its numbers exact in float64. Raises OSError, NpyError."""
    size = path.stat().st_size
    if size > limits["file_bytes"]:
        raise NpyError(f"{size} bytes; at most {limits['file_bytes']} are read")
    return exact(decode(path.read_bytes()), limits["whole_number"])
