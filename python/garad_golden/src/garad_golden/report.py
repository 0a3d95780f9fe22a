"""Verdicts as a table to read and as JSON for machines, as `garad golden check` has them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from .judge import CRASH, FAIL, MISSING, PASS, TIMEOUT, UNSUPPORTED, CaseVerdict, OutputVerdict
from .table import Table

_WORDS = ("was not run", "passes", "FAILS")


def by_stage(verdicts: Sequence[CaseVerdict]) -> dict[str, str]:
    """How each stage went: the worst of its cases."""
    ranks: dict[str, int] = {}
    for verdict in verdicts:
        rank = {PASS: 1, MISSING: 0, UNSUPPORTED: 0}.get(verdict.outcome, 2)
        ranks[verdict.stage] = max(rank, ranks.get(verdict.stage, 0))
    return {stage: _WORDS[rank] for stage, rank in sorted(ranks.items())}


def advice(verdicts: Sequence[CaseVerdict], table: Table) -> list[str]:
    """Which stage to look at first: a failing one whose needs pass."""
    stages = by_stage(verdicts)
    failing = sorted((stage for stage, word in stages.items() if word == "FAILS"), key=table.rank)
    lines = []
    for stage in failing:
        needs = {need: stages.get(need, "was not run") for need in table.needs(stage)}
        below = next((need for need, word in needs.items() if word == "FAILS"), None)
        if below is not None:
            what = f"look at {below} first"
        elif all(word == "passes" for word in needs.values()):
            what = "the stages it needs pass: the mistake is in this stage"
        else:
            what = "run the stages it needs as well"
        words = ", ".join(f"{need} {word}" for need, word in needs.items())
        lines.append(f"{stage} FAILS{f' ({words})' if words else ''}: {what}")
    if len(failing) > 1:
        lines.append(f"first stage that differs: {failing[0]}")
    return lines


def _describe(output: OutputVerdict) -> str:
    """The worst element: where, what, how far."""
    c = output.comparison
    if c is None:
        return f"{output.verdict} {output.name}"
    numbers = c.tolerance.numbers
    bound = {
        "exact": "exactly",
        "ulp": f"within {numbers.get('ulp')} representable numbers",
        "banded": f"within {numbers.get('hard')}, all but {100.0 * numbers.get('share', 0.0):.1f} % within {numbers.get('tight')}",
        "rows": f"within {c.bound:.3e}, all but {100.0 * numbers.get('share', 0.0):.1f} % of the rows within "
                f"{c.bound / numbers.get('hard', 1.0):.3e}",
    }.get(c.tolerance.rule, f"within {c.bound:.3e}")
    return (f"{output.verdict} {output.name}{c.at}: got {c.got!r}, expected {c.expected!r} {bound} ({c.tolerance.name}); "
            f"{c.outside} of {c.elements} are outside")


def _whole(metrics: dict[str, float]) -> str:
    text = f"as a whole off by {metrics['rel_l2']:.2e}, cosine {metrics['cosine']:.6f}"
    for key, words in (("rows_missing", "rows are zeros that should not be"), ("rows_extra", "rows should be zeros")):
        text += f"; {metrics[key]} {words}" if metrics[key] else ""
    return text


def to_text(verdicts: Sequence[CaseVerdict], table: Table) -> str:
    """One line per case, with what failed below it; the stages the port does not do; which stage to look at first."""
    stage_width = max([5, *(len(v.stage) for v in verdicts)])
    case_width = max([5, *(len(v.case) for v in verdicts)])
    lines = [f"{'stage':{stage_width}}  {'case':{case_width}}  verdict      worst/tolerance"]
    for v in verdicts:
        if v.outcome == UNSUPPORTED:
            continue
        worst = v.worst
        said = f"{worst.comparison.worst:<10.3f} {worst.name} ({worst.dtype})" if worst and worst.comparison else ""
        lines.append(f"{v.stage:{stage_width}}  {v.case:{case_width}}  {v.outcome:<11}  {said}".rstrip())
        if v.outcome in (CRASH, TIMEOUT):
            lines.append(f"    {v.reason}")
        for output in v.outputs if v.outcome == FAIL else ():
            if output.verdict == PASS:
                continue
            lines.append(f"    {_describe(output)}")
            lines += [f"        {_whole(output.metrics)}"] if output.metrics else []
            lines += [f"        {output.note}"] if output.note else []
    unsupported = list(dict.fromkeys(v.stage for v in verdicts if v.outcome == UNSUPPORTED))
    lines += [f"unsupported: {', '.join(unsupported)}"] if unsupported else []
    lines += advice(verdicts, table)
    counts = ", ".join(f"{n} {name}" for name, n in sorted(Counter(v.outcome for v in verdicts).items()))
    return "\n".join([*lines, f"{len(verdicts)} cases: {counts}"])


def _number(value: float) -> float | str:
    """JSON has no NaN and no infinities: they become strings."""
    return value if math.isfinite(value) else "NaN" if math.isnan(value) else "inf" if value > 0 else "-inf"


def _output(output: OutputVerdict) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "output": output.name, "verdict": output.verdict.lower(), "dtype": output.dtype, "note": output.note,
    }
    if c := output.comparison:
        entry |= {
            "tolerance": c.tolerance.name, "class": c.tolerance.rule, "numbers": dict(c.tolerance.numbers),
            "allowed": _number(c.bound), "worst": _number(c.worst), "at": c.at, "expected": _number(c.expected),
            "got": _number(c.got), "outside": c.outside, "elements": c.elements,
        }
    return entry | (output.metrics or {})


def to_json(verdicts: Sequence[CaseVerdict], table: Table, allow_missing: bool = False) -> dict[str, Any]:
    """Everything, output by output, as `garad golden check --json` writes it."""
    return {
        "passed": not any(v.fails(allow_missing) for v in verdicts),
        "counts": dict(sorted(Counter(v.outcome for v in verdicts).items())),
        "stages": by_stage(verdicts),
        "advice": advice(verdicts, table),
        "cases": [
            {
                "stage": v.stage, "case": v.case, "basis": v.basis, "verdict": v.outcome.lower(), "reason": v.reason,
                "outputs": [_output(output) for output in v.outputs],
            }
            for v in verdicts
        ],
    }
