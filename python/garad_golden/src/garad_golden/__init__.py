"""Golden cases of garad: what goes into a stage, what must come out, and how close is close enough.

    from garad_golden import judge, load_cases

    for case in load_cases(stages=["sh"]):
        verdict = judge(case, {"basis": my_basis(case.inputs["direction"]), ...})
        print(case.name, verdict.outcome, verdict.worst)

The verdicts are those of `garad golden check`. Every tolerance and every rule with a number in it is read from
`tests/golden/tolerances.json`.

Reading order: `npy` (files) -> `table` (tolerances) -> `case` (the folder) -> `compare` (one array) -> `judge` (one case)
-> `report` -> `port` (a port that is a program) -> `cli`.
"""

from .case import Case, CaseError, find_root, load_cases
from .compare import Comparison, compare
from .judge import CaseVerdict, OutputVerdict, judge, read_answers
from .npy import NpyError
from .report import to_json, to_text
from .table import Stage, Table, Tolerance

__all__ = [
    "Case", "CaseError", "CaseVerdict", "Comparison", "NpyError", "OutputVerdict", "Stage", "Table", "Tolerance",
    "compare", "find_root", "judge", "load_cases", "read_answers", "to_json", "to_text",
]
