"""`compare`: how far an answer is from the expected array, in units of its tolerance.

For an element, with e expected, g got, E all that is expected; error / bound <= 1 passes:

    class    error                          bound
    exact    |g - e|                        0
    ulp      representable numbers between  ulp
    abs_rel  |g - e|                        abs + rel |e|
    vector   |g - e|                        abs + rel max |E|, the largest of the finite numbers
    banded   |g - e|                        hard; and error / bound <= tight / hard for all but share of the elements

Equal numbers, two NaNs and two infinities of one sign have no error; anything else that is not finite has an infinite one.
"""

from __future__ import annotations

from collections.abc import Callable
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
    #: Number of elements.
    elements: int
    #: Elements beyond their bound (banded: beyond `tight`).
    outside: int
    #: Largest error over bound; infinite for a wrong label or a NaN.
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
    return np.where(negative[0] == negative[1], high - low, high + low).astype(np.float64)


def _abs_rel(tolerance: Tolerance, e: Floats, largest: float) -> Floats:
    return tolerance.numbers["abs"] + tolerance.numbers["rel"] * np.abs(e)


def _vector(tolerance: Tolerance, e: Floats, largest: float) -> Floats:
    return np.full(e.shape, tolerance.numbers["abs"] + tolerance.numbers["rel"] * largest)


#: Class to the bound of each element.
CLASSES: dict[str, Callable[[Tolerance, Floats, float], Floats]] = {
    "exact": lambda tolerance, e, largest: np.zeros(e.shape),
    "ulp": lambda tolerance, e, largest: np.full(e.shape, float(tolerance.numbers["ulp"])),
    "abs_rel": _abs_rel,
    "vector": _vector,
    "banded": lambda tolerance, e, largest: np.full(e.shape, tolerance.numbers["hard"]),
}


def compare(expected: Array, got: npt.ArrayLike, tolerance: Tolerance) -> Comparison:
    """Compares an answer, in C order, with the expected array.

    Raises ValueError if the number of elements differs.
    """
    e = np.asarray(expected, np.float64).reshape(-1)
    g = np.asarray(got, np.float64).reshape(-1)
    if e.size != g.size:
        raise ValueError(f"{g.size} elements; expected {e.size} {list(expected.shape)}")
    if e.size == 0:
        return Comparison(True, 0, 0, 0.0, [], 0.0, 0.0, 0.0, tolerance)
    finite = np.abs(e[np.isfinite(e)])
    largest = float(finite.max()) if finite.size else 0.0
    with np.errstate(all="ignore"):
        bound = CLASSES[tolerance.rule](tolerance, e, largest)
        error = _apart(expected, e, g) if tolerance.rule == "ulp" else np.abs(g - e)
        ratio = np.where(np.isfinite(e) & np.isfinite(g), error / bound, np.inf)
    ratio[(e == g) | (np.isnan(e) & np.isnan(g))] = 0.0
    ratio[np.isnan(ratio)] = np.inf
    limit, allowed = 1.0, 0.0
    if tolerance.rule == "banded":
        limit = tolerance.numbers["tight"] / tolerance.numbers["hard"]
        allowed = tolerance.numbers["share"] * e.size
    outside = int(np.count_nonzero(ratio > limit))
    i = int(np.argmax(ratio))
    worst = float(ratio[i])
    return Comparison(
        passed=worst <= 1.0 and outside <= allowed, elements=e.size, outside=outside, worst=worst,
        at=[int(k) for k in np.unravel_index(i, expected.shape)] if expected.shape else [],
        expected=float(e[i]), got=float(g[i]), bound=float(bound[i]), tolerance=tolerance)
