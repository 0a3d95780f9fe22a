#!/usr/bin/env python3
"""Do the figures of README.md hold?

    tools/readme_figures.py                     those that the tree itself tells, in a second
    tools/readme_figures.py --data DIR [WORD]   runs the commands behind the tables on the recordings in DIR (of rows that hold
                                                one of the words) and prints the README's value beside the measured one

A figure of the tree that is not the README's is an error, exit code 1; so is a sentence that is no longer found, since then
nothing is compared. Of a run an error is what rounds to another value at the README's decimals; times are only printed.
Recordings are folders of DIR named as in RUNS; those that are absent are left out with a line. Synthetic scenes are made in a
temporary folder. `--garad` is the program, target/release/garad unless given.

Needs Python 3.11 or newer; a run needs `cargo build --release`.
"""

import argparse
import ast
import csv
import json
import re
import subprocess
import sys
import tempfile
import tomllib
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def text(path):
    return (ROOT / path).read_text()


def number(pattern, path):
    """The number that a pattern finds in a file, once."""
    found = re.findall(pattern, text(path))
    if len(found) != 1:
        sys.exit(f"{path}: `{pattern}` found {len(found)} times; expected once")
    return int(found[0])


def dictionary_size(path, name):
    """Entries of a dictionary in a Python file."""
    for node in ast.parse(text(path)).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == name:
            return len(node.value.keys)
    sys.exit(f"{path}: no {name}")


def mutants():
    lists = sorted((ROOT / "tests/mutations/mutants").glob("*.toml"))
    return sum(len(tomllib.loads(path.read_text())["mutant"]) for path in lists)


def tried(verdict=None):
    with open(ROOT / "tests/mutations/results.csv") as file:
        rows = list(csv.DictReader(file))
    return sum(verdict in (None, row["verdict"]) for row in rows)


# What the README says, with its number in brackets, and what the tree has.
COUNTS = [
    (r"port in numpy, with (\d+) mutants", lambda: dictionary_size("examples/adapter_numpy/mutants.py", "MUTANTS")),
    (r"`tests/zoo` has (\d+) faulty\s+ports", lambda: number(r"reports\.len\(\) [>=]= (\d+)", "tests/zoo/main.rs")),
    (r"faulty\s+ports, (\d+) taken from reports", lambda: number(r"real [>=]= (\d+)", "tests/zoo/main.rs")),
    (r"`tests/mutations` lists (\d+)\s+mutants", mutants),
    (r"Rust toolchain \(1\.(\d+) or newer\)", lambda: number(r'(?m)^rust-version = "1\.(\d+)"', "Cargo.toml")),
]


def first_cells(heading):
    """First column of the table under a head, without the head and the line below it."""
    start = README.find(heading)
    if start < 0:
        sys.exit(f"README.md: no table `{heading}`")
    rows = README[start:].split("\n\n")[0].splitlines()[2:]
    return [row.strip("| ").split(" | ")[0].strip("` ") for row in rows]


def of_map():
    """Golden stages in the last column of the map."""
    start = README.find("| paper | what | code | tests | golden cases |")
    rows = README[start:].split("\n\n")[0].splitlines()[2:]
    return {stage for row in rows for stage in re.findall(r"`(\w+)`", row.rstrip(" |").rsplit("|", 1)[1])}


def folders(path):
    return {case.parents[1].name for case in (ROOT / path).glob("*/*/case.json")}


def fuzz_targets():
    return set(re.findall(r"(?m)^\| `(\w+)` \|", text("fuzz/README.md")))


# Names that two places must agree on: what, README or another document, tree.
NAMES = [
    ("profiles", lambda: set(first_cells("| profile | what it is |")), lambda: {p.stem for p in (ROOT / "profiles").glob("*.toml")}),
    ("golden stages in the map", of_map, lambda: folders("tests/golden")),
    ("targets in fuzz/README.md", fuzz_targets, lambda: {p.stem for p in (ROOT / "fuzz/fuzz_targets").glob("*.rs")}),
    (
        "commands",
        lambda: set(re.findall(r"(?m)^garad (\w+)", README)),
        lambda: set(re.findall(r"(?m)^    (\w+)\(commands::", text("src/main.rs").lower())) - {"demo"},
    ),
]


def check_tree():
    wrong = 0
    for sentence, of_tree in COUNTS:
        found = re.findall(sentence, README)
        if len(found) != 1:
            print(f"WRONG  README.md: `{sentence}` found {len(found)} times; expected once")
            wrong += 1
            continue
        stated, actual = int(found[0]), of_tree()
        mark = "ok    " if stated == actual else "WRONG "
        print(f"{mark} {sentence}: README {stated}, tree {actual}")
        wrong += stated != actual
    for what, of_readme, of_tree in NAMES:
        stated, actual = of_readme(), of_tree()
        mark = "ok    " if stated == actual else "WRONG "
        print(f"{mark} {what}: {len(actual)}" + "".join(f", only {where}: {sorted(names)}" for where, names in [
            ("stated", stated - actual), ("in the tree", actual - stated)] if names))
        wrong += stated != actual
    return wrong


COLUMNS = {
    "ATE RMSE [m]": "ate_rmse_m", "STD [m]": "ate_std_m", "tracked": "tracked", "keypoint F1": "keypoint_f1",
    "mask IoU": "mask_iou", "static PSNR [dB]": "static_psnr_db", "ghosts [%]": "ghosts",
    "dynamic Gaussians": "dynamic_gaussians", "CPU [ms/frame]": "processor_ms_per_frame",
}
# Tables that one command writes: the line above which they stand, the command, the file it leaves.
TABLES = [
    ("bonn_crowd_130_419", "| | ATE RMSE [m] | STD [m] | tracked |", ["compare"], "compare.json"),
    ("bonn_crowd_130_419", "| without | ATE RMSE [m] | STD [m] | keypoint F1 |", ["ablate", "--profile", "paper_tuned"], "ablate.json"),
]
BONN = "bonn_crowd_130_419"
# Rows of "Results": first words of the row, recording or scene, options of `run`. The third column is the ATE.
RUNS = [
    ("BONN crowd 130-419, full system", BONN, []),
    ("the same, true masks", BONN, ["--oracle-labels", "mask"]),
    ("the same, without labels", BONN, ["--without", "crf"]),
    ("BONN crowd 130-216, without people", BONN, ["--max-frames", "87"]),
    ("7-Scenes redkitchen 600-699", "sevenscenes_a", []),
    ("TUM freiburg1_xyz, first 300", "tum_fr1_xyz_300", []),
    ("TUM freiburg1_desk, 9 frames", "tum_fr1_desk_9", []),
    *[(f"`synth {name} --noise`, full", f"synth {name} --noise", []) for name in "walking in_step crowd huddle hall".split()],
]


def same(stated, measured):
    """Whether a number rounds to what is stated, at its decimals."""
    stated = Decimal(stated)
    return Decimal(repr(measured)).quantize(stated, ROUND_HALF_EVEN) == stated


def table(head):
    start = README.find(head)
    if start < 0:
        sys.exit(f"README.md: no table `{head}`")
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in README[start:].split("\n\n")[0].splitlines()]
    return [dict(zip(rows[0], row)) for row in rows[2:]]


def run(garad, *args):
    done = subprocess.run([garad, *args, "--quiet"], capture_output=True, text=True)
    if done.returncode:
        print(f"FAILED {' '.join(map(str, args))}: {done.stderr.strip().splitlines()[-1:]}")
    return done.returncode == 0


def report(what, column, stated, measured, times=False):
    """Prints both values; 1 if they differ."""
    number = re.match(r"[\d.]+", stated)
    if not number:
        return 0
    right = measured is not None and same(number[0], measured)
    mark = "ok    " if right else "      " if times else "WRONG "
    print(f"{mark} {what}, {column}: README {stated}, measured {measured}", flush=True)
    return int(not right and not times)


def check_runs(garad, data, words):
    wrong = 0
    wanted = lambda what: not words or any(word in what for word in words)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for recording, head, command, file in TABLES:
            if not wanted(f"{recording} {command[0]}"):
                continue
            if not (data / recording).exists():
                print(f"absent {recording}: {command[0]}")
                continue
            rows = [row for row in table(head) if not next(iter(row.values())).startswith("published")]
            names = [next(iter(row.values())) for row in rows]
            chosen = ["--profiles", ",".join(names)] if command[0] == "compare" else []
            out = folder / command[0]
            if not run(garad, *command, str(data / recording), *chosen, "-o", str(out)):
                wrong += 1
                continue
            measured = {row["name"].removeprefix("without "): row for row in json.loads((out / file).read_text())["rows"]}
            for name, row in zip(names, rows):
                found = measured["full" if name == "nothing" else name]
                for column, stated in list(row.items())[1:]:
                    value = found[COLUMNS[column]]
                    scale = 100 if column == "ghosts [%]" else 1e-3 if stated.endswith(" k") else 1
                    value = value if value is None else scale * value
                    wrong += report(f"{command[0]} {name}", column, stated, value, column.startswith("CPU"))
        rows = table("| recording | frames | ATE rmse [m] | for comparison |")
        for start, recording, options in RUNS:
            row = next((row for row in rows if row["recording"].startswith(start)), None)
            if row is None:
                print(f"WRONG  README.md: no row `{start}`")
                wrong += 1
                continue
            if not wanted(start):
                continue
            path = data / recording
            if recording.startswith("synth"):
                path = folder / recording.replace(" ", "_")
                if not run(garad, *recording.split(), "-o", str(path)):
                    wrong += 1
                    continue
            elif not path.exists():
                print(f"absent {recording}: {start}")
                continue
            if not run(garad, "run", str(path), *options, "-o", str(folder / "out")):
                wrong += 1
                continue
            metrics = json.loads((folder / "out/metrics.json").read_text())
            wrong += report(start, "frames", row["frames"], metrics["frames"])
            wrong += report(start, "ATE rmse [m]", row["ATE rmse [m]"], metrics["ate"]["rmse_m"])
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="of rows to be run")
    parser.add_argument("--data", type=Path, help="folder of recordings")
    parser.add_argument("--garad", type=Path, default=ROOT / "target/release/garad")
    args = parser.parse_args()
    wrong = check_tree()
    if args.data:
        wrong += check_runs(args.garad, args.data, args.words)
    if wrong:
        print(f"{wrong} figures of README.md are wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
