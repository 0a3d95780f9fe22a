"""`compare`: how far an answer is from the expected array, in units of its tolerance.

For an element, with e expected, g got, E all that is expected; error / bound <= 1 passes:

    class    error                          bound
    exact    |g - e|                        0
    ulp      representable numbers between  ulp
    abs_rel  |g - e|                        abs + rel |e|
    vector   |g - e|                        abs + rel max |E|, the largest of the finite numbers
    banded   |g - e|                        hard; and error / bound <= tight / hard for all but share of the elements
    rows     |g - e|                        hard (rel size + floor scale); and error / bound <= 1 / hard in all but share of the rows

A row is everything behind the first index, its size the largest of its finite |e|. Its scale is what it is a sum of, without
signs; where that is not given, it is for all rows the lower median of the sizes above 0.

Equal numbers, two NaNs and two infinities of one sign have no error; anything else that is not finite has an infinite one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .npy import Array
from .table import Tolerance

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """The verdict on one array."""

    passed: bool
    #: Number of elements (rows: of rows).
    elements: int
    #: Elements beyond their bound (banded: beyond `tight`; rows: rows beyond bound / hard).
    outside: int
    #: Largest error over bound; infinite for a wrong label or a NaN. Where a share may be beyond, over what none may exceed.
    worst: float
    #: Where it is; empty for an empty array and for a single number.
    at: list[int]
    expected: float
    got: float
    #: How far `got` may be from `expected` there.
    bound: float
    tolerance: Tolerance


def _apart(expected: Array, e: Floats, g: Floats) -> Floats:
    """Representable numbers between e and g, of float32 if the expected array is of it.

    Bits read as sign and magnitude, so that neighbours differ by 1 across 0 as well.
    """
    narrow = expected.dtype.itemsize == 4 and expected.dtype.kind == "f"
    real, bits = ("<f4", "<u4") if narrow else ("<f8", "<u8")
    magnitude, negative = [], []
    for values in (e, g):
        raw = values.astype(real)
        magnitude.append(np.abs(raw).view(bits).astype(np.uint64))
        negative.append(np.signbit(raw))
    high, low = np.maximum(*magnitude), np.minimum(*magnitude)
    apart: Floats = np.where(negative[0] == negative[1], high - low, high + low).astype(np.float64)
    return apart


def _largest(values: Floats) -> float:
    """The largest finite size; 0 of none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


#: Classes by name.
CLASSES = ("exact", "ulp", "abs_rel", "vector", "banded", "rows")


def _bounds(expected: Array, e: Floats, tolerance: Tolerance, scales: Floats | None) -> Floats:
    """The bound of each element."""
    n = tolerance.numbers
    if tolerance.rule == "abs_rel":
        each: Floats = n["abs"] + n["rel"] * np.abs(e)
        return each
    if tolerance.rule == "rows":
        rows = e.reshape(expected.shape[0] if expected.ndim else 1, -1)
        sizes = np.array([_largest(row) for row in rows])
        if scales is None:
            above = np.sort(sizes[sizes > 0.0])
            scales = np.full(len(sizes), above[(above.size - 1) // 2] if above.size else 0.0)
        return np.repeat(n["hard"] * (n["rel"] * sizes + n["floor"] * scales), rows.shape[1])
    one = {
        "exact": lambda: 0.0, "ulp": lambda: float(n["ulp"]), "banded": lambda: n["hard"],
        "vector": lambda: n["abs"] + n["rel"] * _largest(e),
    }
    return np.full(e.shape, one[tolerance.rule]())


def compare(expected: Array, got: npt.ArrayLike, tolerance: Tolerance, scales: Floats | None = None) -> Comparison:
    """Compares an answer, in C order, with the expected array; `scales` are those of the rows, for the class rows.

    Raises ValueError if the number of elements differs, or if there is not one scale for each row.
    """
    e = np.asarray(expected, np.float64).reshape(-1)
    g = np.asarray(got, np.float64).reshape(-1)
    if e.size != g.size:
        raise ValueError(f"{g.size} elements; expected {e.size} {list(expected.shape)}")
    count = 0 if e.size == 0 else expected.shape[0] if expected.ndim else 1
    if tolerance.rule == "rows" and scales is not None and len(scales) != count:
        raise ValueError(f"{len(scales)} scales; expected one for each of {count} rows")
    if e.size == 0:
        return Comparison(True, 0, 0, 0.0, [], 0.0, 0.0, 0.0, tolerance)
    n = tolerance.numbers
    with np.errstate(all="ignore"):
        bound = _bounds(expected, e, tolerance, scales)
        error = _apart(expected, e, g) if tolerance.rule == "ulp" else np.abs(g - e)
        ratio = np.where(np.isfinite(e) & np.isfinite(g), error / bound, np.inf)
    ratio[(e == g) | (np.isnan(e) & np.isnan(g))] = 0.0
    ratio[np.isnan(ratio)] = np.inf
    judged, limit, share = ratio, 1.0, 0.0
    if tolerance.rule == "banded":
        limit, share = n["tight"] / n["hard"], n["share"]
    elif tolerance.rule == "rows":
        judged, limit, share = ratio.reshape(count, -1).max(axis=1), 1.0 / n["hard"], n["share"]
    outside = int(np.count_nonzero(judged > limit))
    i = int(np.argmax(ratio))
    worst = float(ratio[i])
    return Comparison(
        passed=worst <= 1.0 and outside <= share * judged.size, elements=judged.size, outside=outside, worst=worst,
        at=[int(k) for k in np.unravel_index(i, expected.shape)] if expected.shape else [],
        expected=float(e[i]), got=float(g[i]), bound=float(bound[i]), tolerance=tolerance)
