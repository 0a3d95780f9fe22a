"""`judge`: the verdict on a case, given a port's outputs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import npy
from .case import Case
from .compare import Comparison, Floats, compare
from .npy import Array, NpyError

PASS, MISSING, FAIL, NONFINITE, SHAPE, UNREADABLE = "pass", "missing", "FAIL", "NONFINITE", "SHAPE", "UNREADABLE"
#: From the best to the worst.
VERDICTS = (PASS, MISSING, FAIL, NONFINITE, SHAPE, UNREADABLE)
UNSUPPORTED, CRASH, TIMEOUT = "unsupported", "CRASH", "TIMEOUT"


@dataclass(frozen=True)
class OutputVerdict:
    """The verdict on one output, one of `VERDICTS`."""

    name: str
    verdict: str
    #: Type of the answer, if there is one.
    dtype: str | None = None
    #: The worst element, if element could be compared with element.
    comparison: Comparison | None = None
    #: How it differs as a whole, if it is a list of reals out of tolerance: see `metrics`.
    metrics: dict[str, float] | None = None
    note: str | None = None


@dataclass(frozen=True)
class CaseVerdict:
    """What is said of one case: pass, FAIL, missing, unsupported, CRASH or TIMEOUT."""

    stage: str
    case: str
    basis: str
    outcome: str
    outputs: tuple[OutputVerdict, ...] = ()
    #: Why a port crashed or was ended.
    reason: str | None = None

    def fails(self, allow_missing: bool = False) -> bool:
        """Whether the run as a whole fails by this case."""
        return self.outcome not in (PASS, UNSUPPORTED) and not (allow_missing and self.outcome == MISSING)

    @property
    def worst(self) -> OutputVerdict | None:
        """The output with the worst verdict, of those the one that is furthest in units of its tolerance."""
        def rank(output: OutputVerdict) -> tuple[int, float]:
            return VERDICTS.index(output.verdict), output.comparison.worst if output.comparison else -1.0

        # The last of equals.
        return max(reversed(self.outputs), key=rank, default=None)


def read_answers(case: Case, folder: str | Path) -> dict[str, Array | NpyError]:
    """Reads OUTPUT.npy for every output of a case; a file that is not there is no answer, one that cannot be used an error."""
    answers: dict[str, Array | NpyError] = {}
    for name in case.outputs:
        try:
            answers[name] = npy.read(Path(folder) / f"{name}.npy", case.table.limits)
        except FileNotFoundError:
            continue
        except NpyError as error:
            answers[name] = error
        except OSError as error:
            answers[name] = NpyError(error.strerror or str(error))
    return answers


def judge(case: Case, answers: Mapping[str, Any], allow_missing: bool = False) -> CaseVerdict:
    """Judges every output of a case.

    `answers` has an array by the name of each output (anything numpy makes an array of), or an NpyError for a file that
    cannot be used. Axes of size 1 may be left out or added. The tolerance follows from the type of the answer:
    `Case.tolerance`. Where the case has an input `robust` and an answer is in float32, elements away from every cut are held
    to the tolerance, and all together to the budget `Table.flips`. An input `robust_OUTPUT` takes its place for one output,
    without a budget.
    """
    known = {name: _checked(case, answers[name]) for name in case.outputs if name in answers}
    known = _nearest(case, known)
    in_f32 = any(_is_narrow(case, name, answer) for name, answer in known.items())
    outputs = []
    for name in sorted(case.outputs):
        answer = known.get(name)
        if answer is None:
            outputs.append(OutputVerdict(name, MISSING, note="no file of this name"))
        elif isinstance(answer, NpyError):
            outputs.append(OutputVerdict(name, UNREADABLE, note=str(answer)))
        else:
            outputs.append(_judge_output(case, name, answer, in_f32))
    ranks = [VERDICTS.index(output.verdict) for output in outputs]
    passed, missing = VERDICTS.index(PASS), VERDICTS.index(MISSING)
    if any(rank > missing for rank in ranks):
        outcome = FAIL
    elif passed not in ranks:
        outcome = MISSING
    elif missing in ranks and not allow_missing:
        outcome = FAIL
    else:
        outcome = PASS
    return CaseVerdict(case.stage, case.case, case.basis, outcome, tuple(outputs))


def _checked(case: Case, answer: Any) -> Array | NpyError:
    if isinstance(answer, NpyError):
        return answer
    array = np.asarray(answer)
    try:
        npy.dtype_name(array)
        return npy.exact(array, case.table.limits["whole_number"])
    except NpyError as error:
        return error


def _is_narrow(case: Case, name: str, answer: Array | NpyError) -> bool:
    """In float32 where float64 is expected."""
    if isinstance(answer, NpyError):
        return False
    return npy.dtype_name(answer) == "f32" and npy.dtype_name(case.outputs[name]) == "f64"


def _nearest(case: Case, answers: dict[str, Array | NpyError]) -> dict[str, Array | NpyError]:
    """The answers with one solution per row.

    Where a problem has several solutions (`several_solutions` in the table), an answer of shape [n, k, ...] stands for an
    expected one of shape [n, ...]. In each row the one is taken with the least sum, over all such outputs, of
    |g - e|^2; a sum that is NaN is infinite, and the first of equals counts.
    """
    most = case.table.most_solutions(case.stage, case.flags)
    several: dict[str, Array] = {}
    for name, answer in answers.items():
        expected = case.outputs[name]
        if isinstance(answer, NpyError) or expected.ndim < 1 or answer.ndim < 2:
            continue
        n, k, *rest = answer.shape
        if (n, *rest) == expected.shape and 1 <= k <= most and most > 1:
            several[name] = answer
    if len({answer.shape[:2] for answer in several.values()}) != 1:
        return answers
    rows, solutions = next(iter(several.values())).shape[:2]
    total = np.zeros((rows, solutions))
    for name, answer in sorted(several.items()):
        off = answer.astype(np.float64) - case.outputs[name].astype(np.float64)[:, None]
        squares = (off * off).reshape(rows, solutions, math.prod(off.shape[2:]))
        sums = np.zeros((rows, solutions))
        for i in range(squares.shape[2]):
            sums = sums + squares[:, :, i]
        total = total + np.where(np.isnan(sums), np.inf, sums)
    choice = np.argmin(total, axis=1)
    chosen: dict[str, Array | NpyError] = {name: answer[np.arange(rows), choice] for name, answer in several.items()}
    return answers | chosen


def _judge_output(case: Case, name: str, answer: Array, in_f32: bool) -> OutputVerdict:
    expected = case.outputs[name]
    dtype = npy.dtype_name(answer)

    def squeezed(array: Array) -> list[int]:
        return [size for size in array.shape if size != 1]

    try:
        tolerance = case.tolerance(name, dtype)
    except KeyError:
        tolerance = None
    if squeezed(answer) != squeezed(expected):
        exact = tolerance is not None and tolerance.rule == "exact"
        return OutputVerdict(name, SHAPE, dtype, note=_other_shape(expected, answer, exact))
    if tolerance is None:
        return OutputVerdict(name, UNREADABLE, dtype, note=f"no tolerance '{case.tolerances[name]}' in the table")
    e: Floats = expected.astype(np.float64).reshape(-1)
    g: Floats = np.ascontiguousarray(answer).astype(np.float64).reshape(-1)
    scales = case.inputs.get(f"scale_{name}")
    scales = None if scales is None else scales.astype(np.float64).reshape(-1)
    try:
        comparison = compare(expected, g, tolerance, scales)
    except ValueError:
        # Not one scale for each row: a mistake of the case.
        return OutputVerdict(name, SHAPE, dtype, note=_other_shape(expected, answer, False))
    own = case.inputs.get(f"robust_{name}")
    robust = (case.inputs.get("robust") if own is None else own) if in_f32 else None
    if robust is not None and robust.size and expected.shape[:robust.ndim] == robust.shape:
        away = np.repeat(robust.reshape(-1) != 0, e.size // robust.size)
        comparison = compare(expected, np.where(away, g, e), tolerance, scales)
        flips = case.table.flips(case.stage, case.flags) if own is None else None
        if flips is not None and tolerance.rule != "exact" and comparison.passed:
            everywhere = compare(expected, g, flips)
            comparison = comparison if everywhere.passed else everywhere
    if comparison.passed:
        return OutputVerdict(name, PASS, dtype, comparison)
    lost = int(np.count_nonzero(np.isfinite(e) & ~np.isfinite(g)))
    verdict, note = FAIL, None
    if lost:
        verdict, note = NONFINITE, f"{lost} of {g.size} numbers are NaN or infinite"
    elif dtype == "f64" and _looks_narrow(case, g, comparison):
        note = ("every number fits in float32: if it was computed in float32, save it as float32 (<f4) "
                "and it is held to that tolerance")
    columns = expected.shape[-1] if expected.shape else 1
    whole = None if tolerance.rule == "exact" else metrics(e, g, columns)
    return OutputVerdict(name, verdict, dtype, comparison, whole, note)


def _looks_narrow(case: Case, g: Floats, comparison: Comparison) -> bool:
    """Numbers in float64 that float32 could hold were hardly computed in float64."""
    close = comparison.worst < 10.0 * case.table.rules["f32"]["factor"]
    with np.errstate(over="ignore"):
        fits = bool(np.all(g.astype(np.float32).astype(np.float64) == g))
    return close and fits and not bool(np.all(np.modf(g)[0] == 0.0))


def metrics(e: Floats, g: Floats, columns: int) -> dict[str, float] | None:
    """How an answer differs as a whole.

    rel_l2 = |g - e| / |e| and cosine = e.g / (|e| |g|), Euclidean: a wrong factor leaves the cosine at 1. rows_missing and
    rows_extra count rows of `columns` numbers that are zero and should not be, and the reverse. None unless all numbers
    are finite and both have a direction.
    """
    if columns == 0 or not (np.isfinite(e).all() and np.isfinite(g).all()):
        return None

    def total(terms: Floats) -> float:
        # In order, as garad adds.
        return float(np.cumsum(terms)[-1]) if terms.size else 0.0

    with np.errstate(all="ignore"):
        ee, gg = math.sqrt(total(e * e)), math.sqrt(total(g * g))
        off, dot = math.sqrt(total((g - e) * (g - e))), total(e * g)
    if not (ee > 0.0 and gg > 0.0):
        return None
    zero_e, zero_g = (np.all(v.reshape(-1, columns) == 0.0, axis=1) for v in (e, g))
    return {
        "rel_l2": off / ee, "cosine": dot / (ee * gg), "rows_missing": int(np.count_nonzero(~zero_e & zero_g)),
        "rows_extra": int(np.count_nonzero(zero_e & ~zero_g)),
    }


def _other_shape(expected: Array, answer: Array, exact: bool) -> str:
    """What is wrong with a shape, and for lists of whole numbers how many rows are missing or too many."""
    note = f"shape {list(answer.shape)}; expected {list(expected.shape)}"
    if answer.shape == expected.shape[::-1]:
        return note + ": the axes are reversed (column-major, or (width, height))"
    if answer.size == expected.size:
        return note + ": as many numbers; reshape"
    if exact and answer.ndim and expected.ndim and answer.shape[1:] == expected.shape[1:]:
        def rows(array: Array) -> list[bytes]:
            return [row.tobytes() for row in array.astype(np.float64)]

        theirs, mine = rows(expected), rows(answer)
        missing, extra = (sum(row not in there for row in own) for own, there in ((theirs, set(mine)), (mine, set(theirs))))
        return note + f": {missing} rows are missing; {extra} should not be there"
    return note
