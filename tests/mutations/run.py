#!/usr/bin/env python3
"""Do our tests notice? Puts one mutant after the other into a copy of the project and runs the crate's tests.

    tests/mutations/run.py --check                      every text of mutants/ is found exactly once; no build
    tests/mutations/run.py                              all of them, on one core
    tests/mutations/run.py --list optim 'half a pixel'  those of mutants/optim.toml that hold this in file or description
    tests/mutations/run.py --report FILE                those that FILE has no row of yet; rows are added as they come

The copy is made of HEAD (`--work`: of the working tree), in a temporary folder or in `--folder`, where a second run finds
what the first has built. Of each crate the unit tests are built, those of the mutant's module run first, then all of them;
only if they pass, the integration tests (of slam only the quick ones), then the golden cases of all stages; documentation
tests do not run. Mutants are tried crate by crate, dependents first, and file by file, so that each builds little: see the
seconds in results.csv. Before the first mutant of a crate its tests have to pass as they are.

results.csv beside this file is the report: `caught`: a test failed, or nothing came to an end in ten minutes. `missed`: all
passed. `broken`: does not compile, so the mutant proves nothing and has to be mended. `not run`: listed, but not tried since its
text or place changed. A row is of the code it was made with: after a change begin a new FILE. Exit code 1 if more than 5 % of
those tried are missed or anything is broken.

Needs Python 3.11 or newer, git and cargo.
"""

import argparse
import csv
import json
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


def mutants(root, only=(), lists=()):
    """Those asked for, if all of the lists are found in the code under `root`."""
    found = []
    for path in sorted(Path(__file__).with_name("mutants").glob("*.toml")):
        with open(path, "rb") as file:
            found += [mutant | {"list": path.stem} for mutant in tomllib.load(file)["mutant"]]
    unknown = set(lists) - {mutant["list"] for mutant in found}
    if unknown:
        sys.exit(f"no list {', '.join(sorted(unknown))} in mutants/")
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
    found = [mutant for mutant in found if not lists or mutant["list"] in lists]
    return sorted(found, key=lambda mutant: (ORDER.index(mutant["crate"]), mutant["file"]))


COLUMNS = ["crate", "file", "mutant", "verdict", "noticed by", "seconds"]


def key(mutant):
    """What a row of the report is known by."""
    return mutant["crate"], mutant["file"].split("/src/")[1], mutant["what"]


class Report:
    """Rows by mutant, written after each: a run that is ended loses nothing."""

    def __init__(self, path):
        self.path, self.rows = path, {}
        if path and path.exists():
            with open(path, newline="") as file:
                rows = [row for row in csv.DictReader(file) if row["verdict"] != "not run"]
            self.rows = {(row["crate"], row["file"], row["mutant"]): row for row in rows}

    def add(self, mutant, verdict, by, seconds, listed):
        self.rows[key(mutant)] = dict(zip(COLUMNS, [*key(mutant), verdict, by, f"{seconds:.0f}"]))
        self.write(listed)

    def write(self, listed):
        if not self.path:
            return
        fresh = self.path.with_suffix(".new")
        with open(fresh, "w", newline="") as out:
            writer = csv.DictWriter(out, COLUMNS, lineterminator="\n", restval="")
            writer.writeheader()
            for mutant in listed:
                not_run = dict(zip(COLUMNS, [*key(mutant), "not run"]))
                writer.writerow(self.rows.get(key(mutant), not_run))
        fresh.replace(self.path)


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


def environment(target):
    # Debug tables are for debuggers. Proptest is not to look for a smaller counter-example, nor to keep it and try it on the next mutant.
    return os.environ | {
        "CARGO_TARGET_DIR": str(target),
        "CARGO_TERM_COLOR": "never",
        "CARGO_PROFILE_DEV_DEBUG": "0",
        "PROPTEST_DISABLE_FAILURE_PERSISTENCE": "true",
        "PROPTEST_MAX_SHRINK_ITERS": "0",
    }


def output(command, root, target, limit_s):
    """(exit code, stdout, stderr); the exit code is None where nothing came to an end"""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "errors": "replace"}
    process = subprocess.Popen(command, cwd=root, env=environment(target), start_new_session=True, **pipes)
    try:
        said, errors = process.communicate(timeout=limit_s)
        return process.returncode, said, errors
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return None, "", ""


def build(root, target, package, which, jobs):
    """The test programs with the folders they run in; None if they do not compile."""
    command = ["cargo", "test", "--locked", "-q", f"-j{jobs}", "-p", package, *which]
    command += ["--no-run", "--message-format", "json"]
    _, said, errors = output(command, root, target, None)
    messages = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    if not any(message.get("reason") == "build-finished" and message["success"] for message in messages):
        rendered = [m["message"]["rendered"] for m in messages if m.get("reason") == "compiler-message"]
        print(("".join(rendered) + errors)[-3000:], file=sys.stderr)
        return None
    tests = [m for m in messages if m.get("reason") == "compiler-artifact" and m["executable"] and m["profile"]["test"]]
    return [(Path(m["executable"]), Path(m["manifest_path"]).parent) for m in tests]


def run_tests(programs, target, filters, jobs, limit_s):
    """(verdict, first test that failed)"""
    for program, folder in programs:
        command = [str(program), f"--test-threads={jobs}", *filters]
        code, said, _ = output(command, folder, target, limit_s)
        if code is None:
            return "caught", "does not come to an end"
        if code != 0:
            failed = re.search(r"^---- (\S+) stdout ----", said, re.MULTILINE)
            return "caught", failed[1] if failed else "the test program"
    return "missed", ""


def module(file):
    """Path of a file's module: crates/slam/src/map/landmark.rs is map::landmark."""
    parts = Path(file.split("/src/")[1]).with_suffix("").parts
    return "::".join(part for part in parts if part not in ("mod", "lib")) + "::"


def try_all(root, target, crate, args, limit_s=None, file=None):
    own = package(root, crate)
    parts = [(own, ["--lib"])]
    if not args.unit:
        tests = INTEGRATION.get(crate) or sorted(path.stem for path in (root / "crates" / crate / "tests").glob("*.rs"))
        tests += sorted(path.parent.name for path in (root / "crates" / crate / "tests").glob("*/main.rs") if not INTEGRATION.get(crate))
        parts += [(own, [word for name in tests for word in ("--test", name)])] if tests else []
        parts += [CONFORMANCE]
    for number, (name, which) in enumerate(parts):
        programs = build(root, target, name, which, args.jobs)
        if programs is None:
            return "broken", ""
        near = [[module(file)]] if file and number == 0 and module(file) != "::" else []
        for filters in [*near, []]:
            verdict, by = run_tests(programs, target, filters, args.jobs, limit_s)
            if verdict != "missed":
                return verdict, by
    return "missed", ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("only", nargs="*", help="crates, files or words of the description")
    parser.add_argument("--list", action="append", default=[], metavar="NAME", help="mutants/NAME.toml alone; may be repeated")
    parser.add_argument("--check", action="store_true", help="only look for the texts")
    parser.add_argument("--unit", action="store_true", help="unit tests alone")
    parser.add_argument("--work", action="store_true", help="the working tree, not HEAD")
    parser.add_argument("--folder", type=Path, help="where the copy lies and is built; kept")
    parser.add_argument("--target", type=Path, help="build folder, if not inside --folder")
    parser.add_argument("--jobs", type=int, default=1, help="of cargo, and threads of a test program")
    parser.add_argument("--report", type=Path, help="CSV: mutants with a row are left out, rows are added")
    args = parser.parse_args()
    if args.check:
        print(f"{len(mutants(ROOT, args.only, args.list))} mutants, every text found once")
        return 0

    with tempfile.TemporaryDirectory() as temporary:
        folder = (args.folder or Path(temporary)).resolve()
        root = folder / "tree"
        root.mkdir(parents=True, exist_ok=True)
        copy(root, args.work)
        target = (args.target or folder / "target").resolve()
        report, listed, tried, sound, begun = Report(args.report), mutants(root), [], set(), time.monotonic()
        report.write(listed)
        for mutant in mutants(root, args.only, args.list):
            crate, file = mutant["crate"], root / mutant["file"]
            if key(mutant) in report.rows:
                continue
            if crate not in sound:
                at = time.monotonic()
                verdict, by = try_all(root, target, crate, args)   # builds all there is: no limit
                if verdict != "missed":
                    sys.exit(f"{crate}: the tests fail without any mutant: {by}")
                sound.add(crate)
                print(f"{'':8} {crate:10} built, and passes as it is ({time.monotonic() - at:.0f} s)", flush=True)
            at = time.monotonic()
            before = file.read_text()
            file.write_text(before.replace(mutant["find"], mutant["replace"]))
            try:
                verdict, by = try_all(root, target, crate, args, TIME_LIMIT_S, mutant["file"])
            finally:
                file.write_text(before)
            seconds = time.monotonic() - at
            print(f"{verdict:8} {crate:10} {key(mutant)[1]:22} {mutant['what']:55} {by} ({seconds:.0f} s)", flush=True)
            tried.append(verdict)
            report.add(mutant, verdict, by, seconds, listed)

    missed, broken = tried.count("missed"), tried.count("broken")
    minutes = (time.monotonic() - begun) / 60
    print(f"{tried.count('caught')} of {len(tried)} caught, {missed} missed, {broken} broken; {minutes:.1f} min")
    return 1 if broken or missed > MOST_MISSED * len(tried) else 0


if __name__ == "__main__":
    sys.exit(main())
