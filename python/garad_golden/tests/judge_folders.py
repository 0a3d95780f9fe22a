"""Judges every SET/STAGE/CASE/OUTPUT.npy below a folder and writes SET.json: for `tests/zoo/python.rs`, which compares these
verdicts with those of garad. Only stages that a set has a folder for are judged; sets named lenient_* may lack outputs.

    python3 judge_folders.py CASES FOLDER
"""

import json
import pathlib
import sys

from garad_golden import judge, load_cases, read_answers, to_json

cases = load_cases(sys.argv[1])
folder = pathlib.Path(sys.argv[2])
for path in sorted(p for p in folder.iterdir() if p.is_dir()):
    lenient = path.name.startswith("lenient_")
    chosen = [case for case in cases if (path / case.stage).is_dir()]
    verdicts = [judge(case, read_answers(case, path / case.stage / case.case), lenient) for case in chosen]
    report = to_json(verdicts, cases[0].table, lenient)
    folder.joinpath(f"{path.name}.json").write_text(json.dumps(report), encoding="utf-8")
