"""`garad-golden`: a port's outputs, or a port itself, against the golden cases."""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from . import port
from .case import Case, CaseError, find_root, load_cases, load_table
from .judge import MISSING, CaseVerdict, judge, read_answers
from .report import to_json, to_text

PASSED, FAILED, WRONG = 0, 1, 2


def _seconds(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and 0.0 < value <= 1e6):
        raise argparse.ArgumentTypeError(f"{text}: expected seconds, more than 0")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="garad-golden", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    chosen = argparse.ArgumentParser(add_help=False)
    chosen.add_argument("--cases", metavar="DIR", help="folder that holds STAGE/CASE/case.json [default: GARAD_GOLDEN of the "
                        "environment, else tests/golden here or in a folder above]")
    chosen.add_argument("--tolerances", metavar="FILE", help="tolerances.json [default: the one beside the cases]")
    chosen.add_argument("--stage", metavar="S", action="append", default=[], help="only this stage; may be given several times")
    chosen.add_argument("--case", metavar="NAME", action="append", default=[], help="only cases of this name; several times")
    chosen.add_argument("--tag", metavar="T", help="only cases with this flag or this basis")
    check = commands.add_parser(
        "check", parents=[chosen], help="compare outputs with the expected ones",
        description="Exit code 0: all pass, 1: some fail, 2: the command is wrong.")
    by = check.add_mutually_exclusive_group(required=True)
    by.add_argument("--actual", metavar="DIR", type=Path, help="folder with STAGE/CASE/OUTPUT.npy")
    by.add_argument("--exec", metavar="CMD", help="program to start per case; {case} is the folder of the case, {out} the folder "
                    "for OUTPUT.npy, {stage} the stage. Exit code 77 says 'not this stage'. No shell is involved")
    check.add_argument("--allow-missing", action="store_true", help="outputs that are not there do not fail, nor cases without any")
    check.add_argument("--timeout", metavar="S", type=_seconds, default=60.0, help="with --exec: seconds per case")
    check.add_argument("--keep", metavar="DIR", type=Path, help="with --exec: keep what the port writes, as DIR/STAGE/CASE/OUTPUT.npy")
    check.add_argument("--json", metavar="FILE", type=Path, help="write every verdict as JSON")
    commands.add_parser("list", parents=[chosen], help="the cases: what goes in, what must come out")
    return parser


def _list(cases: Sequence[Case]) -> None:
    for case in cases:
        print(f"{case.name} · {case.basis} · {case.why}")
        for side, arrays in (("in ", case.inputs), ("out", case.outputs)):
            shapes = (f"{name} {array.dtype}{list(array.shape)}" for name, array in arrays.items())
            print(f"    {side}  {', '.join(shapes)}")
    print(f"{len(cases)} cases")


def _check(args: argparse.Namespace, cases: Sequence[Case]) -> list[CaseVerdict]:
    if args.exec is not None:
        words = port.split(args.exec)
        with tempfile.TemporaryDirectory(prefix="garad-golden-") as temporary:
            root = args.keep or Path(temporary)
            return [port.run(case, words, root, args.timeout, args.allow_missing) for case in cases]
    if not args.actual.is_dir():
        raise CaseError(f"{args.actual}: no such folder")
    folder: Path = args.actual
    verdicts = [judge(case, read_answers(case, folder / case.stage / case.case), args.allow_missing) for case in cases]
    if all(v.outcome == MISSING for v in verdicts):
        print(f"nothing found; expected files like {folder}/{cases[0].name}/OUTPUT.npy", file=sys.stderr)
    return verdicts


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; its exit code."""
    args = _parser().parse_args(argv)
    try:
        root = find_root(args.cases)
        table = load_table(root, args.tolerances)
        cases = load_cases(root, args.stage, args.case, args.tag, table)
        if args.command == "list":
            _list(cases)
            return PASSED
        verdicts = _check(args, cases)
        report = to_json(verdicts, table, args.allow_missing)
        if args.json is not None:
            args.json.write_text(json.dumps(report, indent=2, ensure_ascii=False), encoding="utf-8")
    except (CaseError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return WRONG
    print(to_text(verdicts, table))
    return PASSED if report["passed"] else FAILED
