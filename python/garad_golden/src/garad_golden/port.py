"""A port as a program that is started once per case. No shell is involved."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

from .case import Case
from .judge import CRASH, TIMEOUT, UNSUPPORTED, CaseVerdict, judge, read_answers

#: Exit code by which a port says that it does not do a stage.
UNSUPPORTED_CODE = 77
_TAIL_BYTES = 400


def split(line: str) -> list[str]:
    """Splits a command line at blanks; quotes, single or double, hold a word together. Raises ValueError."""
    lexer = shlex.shlex(line, posix=True)
    lexer.whitespace_split, lexer.escape, lexer.commenters = True, "", ""
    try:
        words = list(lexer)
    except ValueError as error:
        raise ValueError(f"{line}: a quote without its end") from error
    if not words:
        raise ValueError("the command is empty")
    return words


def _tail(log: Path) -> str:
    """`: ...`, the end of what it printed, on one line."""
    text = log.read_bytes()[-_TAIL_BYTES:].decode("utf-8", "replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return f": {' | '.join(lines)}" if lines else ""


def run(case: Case, words: list[str], root: Path, timeout_s: float, allow_missing: bool = False) -> CaseVerdict:
    """Starts the port for one case and judges what it wrote to root/STAGE/CASE; what it prints goes to `port.log` there.

    {stage}, {case} and {out} in `words` are replaced. Raises OSError if it cannot be started.
    """
    out = (root / case.stage / case.case).absolute()
    out.mkdir(parents=True, exist_ok=True)
    for name in case.outputs:
        # What an earlier run left behind is no answer.
        (out / f"{name}.npy").unlink(missing_ok=True)
    fill = {"{stage}": case.stage, "{case}": str(case.folder.absolute()), "{out}": str(out)}
    command = []
    for word in words:
        for key, value in fill.items():
            word = word.replace(key, value)
        command.append(word)
    log = out / "port.log"
    outcome, reason = CRASH, ""
    with open(log, "wb") as file:
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT, timeout=timeout_s, check=False)
        except subprocess.TimeoutExpired:
            outcome, reason = TIMEOUT, f"still running after {timeout_s:g} s"
        else:
            if done.returncode == 0:
                return judge(case, read_answers(case, out), allow_missing)
            if done.returncode == UNSUPPORTED_CODE:
                return CaseVerdict(case.stage, case.case, case.basis, UNSUPPORTED)
            reason = f"exit status: {done.returncode}" if done.returncode > 0 else f"signal: {-done.returncode}"
    return CaseVerdict(case.stage, case.case, case.basis, outcome, reason=reason + _tail(log))
