#!/usr/bin/env python3
"""Do our tests notice? Puts one mutant after the other into a copy of the project and runs the crate's tests.

    tests/mutations/run.py --check              every text of mutants/ is found exactly once; no build
    tests/mutations/run.py                      all of them, on one core
    tests/mutations/run.py optim 'half a pixel' those whose crate, file or description holds one of these

The copy is made of HEAD (`--work`: of the working tree), in a temporary folder or in `--folder`, where a
second run finds what the first has built. Of each crate the unit tests run first, then, if they all passed,
the integration tests (of slam only the quick ones), then the golden cases of all stages; documentation tests do not
run. Before the first mutant of a crate its tests have to pass as they are. results.csv beside this file is the
report of one run of all: 37 minutes on a busy machine.

`caught`: a test failed, or nothing came to an end in ten minutes. `missed`: all passed. `broken`: does not
compile, so the mutant proves nothing and has to be mended. Exit code 1 if more than 5 % are missed or
anything is broken. Results go to stdout and, as CSV, to `--report FILE`.

Needs Python 3.11 or newer, git and cargo.
"""

import argparse
import csv
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Dependents first: a crate that is put back to order would have them all built again.
ORDER = ["golden", "slam", "synth", "eval", "raster_cpu", "dataset", "crf", "features", "optim", "core"]
# Integration tests that run after the unit tests. Those of slam that take whole sequences through the system
# would take most of the time, and name no stage.
INTEGRATION = {"slam": ["labels", "stages"]}
# Every stage against its golden cases.
CONFORMANCE = ("garad-conformance", ["--lib", "--test", "stages"])
TIME_LIMIT_S = 600
MOST_MISSED = 0.05


def mutants(root, only):
    """Those asked for, if all of the lists are found in the code under `root`."""
    found = []
    for path in sorted(Path(__file__).with_name("mutants").glob("*.toml")):
        with open(path, "rb") as file:
            found += tomllib.load(file)["mutant"]
    for mutant in found:
        mutant["crate"] = mutant["file"].split("/")[1]
        text = (root / mutant["file"]).read_text()
        count = text.count(mutant["find"])
        if count != 1:
            sys.exit(f"{mutant['file']}: `{mutant['find']}` occurs {count} times; expected once ({mutant['what']})")
        if mutant["find"] == mutant["replace"]:
            sys.exit(f"{mutant['file']}: `{mutant['find']}` is replaced by itself")
        if mutant["crate"] not in ORDER:
            sys.exit(f"{mutant['file']}: crate `{mutant['crate']}`; expected one of {ORDER}")
    about = lambda mutant: f"{mutant['crate']} {mutant['file']} {mutant['what']}"
    found = [mutant for mutant in found if not only or any(word in about(mutant) for word in only)]
    return sorted(found, key=lambda mutant: ORDER.index(mutant["crate"]))


def copy(to, work):
    """HEAD, or the files git would commit, into a folder. Files that stay the same keep their time."""
    with tempfile.TemporaryDirectory() as fresh:
        if work:
            names = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
            pack = ["tar", "--null", "--ignore-failed-read", "-T-", "-cf-"]
            listed = subprocess.run(names, cwd=ROOT, check=True, capture_output=True).stdout
            packed = subprocess.run(pack, cwd=ROOT, check=True, capture_output=True, input=listed).stdout
        else:
            archive = ["git", "archive", "HEAD"]
            packed = subprocess.run(archive, cwd=ROOT, check=True, capture_output=True).stdout
        subprocess.run(["tar", "-xf-"], cwd=fresh, check=True, input=packed)
        for source in sorted(Path(fresh).rglob("*")):
            target = to / source.relative_to(fresh)
            if source.is_dir():
                target.mkdir(parents=True, exist_ok=True)
            elif not target.exists() or target.read_bytes() != source.read_bytes():
                target.write_bytes(source.read_bytes())


def package(root, crate):
    with open(root / "crates" / crate / "Cargo.toml", "rb") as file:
        return tomllib.load(file)["package"]["name"]


def cargo_test(root, target, package, which, limit_s):
    """(verdict, first test that failed)"""
    command = ["cargo", "test", "--locked", "-q", "-j1", "-p", package, *which]
    command += ["--", "--test-threads=1"]
    # Debug tables are for debuggers. Proptest is not to look for a smaller counter-example, nor to keep
    # it and try it on the next mutant.
    environment = os.environ | {
        "CARGO_TARGET_DIR": str(target),
        "CARGO_TERM_COLOR": "never",
        "CARGO_PROFILE_DEV_DEBUG": "0",
        "PROPTEST_DISABLE_FAILURE_PERSISTENCE": "true",
        "PROPTEST_MAX_SHRINK_ITERS": "0",
    }
    process = subprocess.Popen(
        command,
        cwd=root,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return "caught", "does not come to an end"
    if process.returncode == 0:
        return "missed", ""
    failed = re.search(r"^---- (\S+) stdout ----", said, re.MULTILINE)
    if failed:
        return "caught", failed[1]
    if "test result: FAILED" in said or "SIGABRT" in said:
        return "caught", "the test program"
    print(said[-3000:], file=sys.stderr)
    return "broken", ""


def try_all(root, target, crate, unit, limit_s=None):
    own = package(root, crate)
    parts = [(own, ["--lib"])]
    if not unit:
        tests = INTEGRATION.get(crate) or sorted(path.stem for path in (root / "crates" / crate / "tests").glob("*.rs"))
        parts += [(own, [word for name in tests for word in ("--test", name)])] if tests else []
        parts += [CONFORMANCE]
    for name, which in parts:
        verdict, by = cargo_test(root, target, name, which, limit_s)
        if verdict != "missed":
            return verdict, by
    return "missed", ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("only", nargs="*", help="crates, files or words of the description")
    parser.add_argument("--check", action="store_true", help="only look for the texts")
    parser.add_argument("--unit", action="store_true", help="unit tests alone")
    parser.add_argument("--work", action="store_true", help="the working tree, not HEAD")
    parser.add_argument("--folder", type=Path, help="where the copy lies and is built; kept")
    parser.add_argument("--target", type=Path, help="build folder, if not inside --folder")
    parser.add_argument("--report", type=Path, help="CSV")
    args = parser.parse_args()
    if args.check:
        print(f"{len(mutants(ROOT, args.only))} mutants, every text found once")
        return 0

    with tempfile.TemporaryDirectory() as temporary:
        folder = (args.folder or Path(temporary)).resolve()
        root = folder / "tree"
        root.mkdir(parents=True, exist_ok=True)
        copy(root, args.work)
        target = (args.target or folder / "target").resolve()
        rows, sound, begun = [], set(), time.monotonic()
        for mutant in mutants(root, args.only):
            crate, file = mutant["crate"], root / mutant["file"]
            if crate not in sound:
                at = time.monotonic()
                verdict, by = try_all(root, target, crate, args.unit)   # builds all there is: no limit
                if verdict != "missed":
                    sys.exit(f"{crate}: the tests fail without any mutant: {by}")
                sound.add(crate)
                print(f"{'':8} {crate:10} built, and passes as it is ({time.monotonic() - at:.0f} s)", flush=True)
            at = time.monotonic()
            before = file.read_text()
            file.write_text(before.replace(mutant["find"], mutant["replace"]))
            try:
                verdict, by = try_all(root, target, crate, args.unit, TIME_LIMIT_S)
            finally:
                file.write_text(before)
            seconds = time.monotonic() - at
            where = mutant["file"].split("/src/")[1]
            print(f"{verdict:8} {crate:10} {where:22} {mutant['what']:55} {by} ({seconds:.0f} s)", flush=True)
            rows.append([crate, where, mutant["what"], verdict, by])

    if args.report:
        with open(args.report, "w", newline="") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(["crate", "file", "mutant", "verdict", "noticed by"])
            writer.writerows(rows)
    count = lambda verdict: sum(row[3] == verdict for row in rows)
    missed, broken = count("missed"), count("broken")
    minutes = (time.monotonic() - begun) / 60
    print(f"{count('caught')} of {len(rows)} caught, {missed} missed, {broken} broken; {minutes:.1f} min")
    return 1 if broken or missed > MOST_MISSED * len(rows) else 0


if __name__ == "__main__":
    sys.exit(main())
