"""`tolerances.json`: every tolerance with its reason, the rule for float32, the order of the stages."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

FILE = "tolerances.json"


@dataclass(frozen=True)
class Tolerance:
    """How far a right answer may be from the expected value.

    `rule` is the class (see `compare`), `numbers` its numbers by name, in the unit of the array where they have one.
    """

    name: str
    rule: str
    numbers: Mapping[str, float]
    reason: str = ""
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stage:
    """A stage, the part of the method it belongs to, and the stages whose results or formulas it takes."""

    name: str
    part: str
    needs: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """The file."""

    tolerances: Mapping[str, Tolerance]
    stages: tuple[Stage, ...]
    rules: Mapping[str, Any]

    @classmethod
    def load(cls, path: Path) -> Table:
        """Reads `tolerances.json`. Raises OSError, or ValueError if it is of another schema or has an unknown class."""
        from .compare import CLASSES

        data = json.loads(path.read_text(encoding="utf-8"))
        if data.get("schema") != 1:
            raise ValueError(f"{path}: schema {data.get('schema')}; expected 1")
        tolerances = {}
        for entry in data["tolerances"]:
            known = {"name", "class", "reason", "units"}
            numbers = {key: value for key, value in entry.items() if key not in known}
            if entry["class"] not in CLASSES:
                raise ValueError(f"{path}: {entry['name']}: this version does not know the class '{entry['class']}'")
            tolerances[entry["name"]] = Tolerance(
                entry["name"], entry["class"], MappingProxyType(numbers), entry["reason"], tuple(entry["units"]))
        stages = tuple(Stage(s["name"], s["part"], tuple(s["needs"])) for s in data["stages"])
        return cls(MappingProxyType(tolerances), stages, MappingProxyType(data))

    @property
    def limits(self) -> dict[str, int]:
        """Sizes of files and of whole numbers."""
        limits: dict[str, int] = self.rules["limits"]
        return limits

    def rank(self, stage: str) -> int:
        """Position in the order of the data; unknown stages come last."""
        return next((i for i, s in enumerate(self.stages) if s.name == stage), len(self.stages))

    def needs(self, stage: str) -> tuple[str, ...]:
        """The stages that one rests on."""
        return next((s.needs for s in self.stages if s.name == stage), ())

    def for_f32(self, stage: str, output: str, flags: Iterable[str], wide: Tolerance) -> Tolerance:
        """What an answer in float32 is held to where float64 is expected.

        By rows, the name of `wide` with f32 after its first point, if there is one. Else the first that there is of STAGE.f32.OUTPUT_FLAG for a flag of the case, STAGE.f32.OUTPUT, and the name of `wide`
        with f32 after its first point. Else, if `wide` counts roundings, that is max(abs, rel) <= at_most, abs and rel
        times factor = 2^29, the ratio of the unit roundoffs. Else `wide`.
        """
        renamed = wide.name.replace(".", ".f32.", 1)
        names = [renamed] if wide.rule == "rows" else []
        names += [f"{stage}.f32.{output}_{flag}" for flag in flags]
        names += [f"{stage}.f32.{output}", renamed]
        for name in names:
            if name in self.tolerances:
                return self.tolerances[name]
        rule = self.rules["f32"]
        if wide.rule in ("abs_rel", "vector") and max(wide.numbers.values()) <= rule["at_most"]:
            scaled = {key: value * rule["factor"] for key, value in wide.numbers.items()}
            return replace(wide, numbers=MappingProxyType(scaled))
        return wide

    def flips(self, stage: str, flags: Iterable[str]) -> Tolerance | None:
        """The budget for elements near a cut of answers in float32: STAGE.f32.flips_FLAG for a flag of the case, or without."""
        names = [f"{stage}.f32.flips_{flag}" for flag in flags]
        return next((self.tolerances[n] for n in [*names, f"{stage}.f32.flips"] if n in self.tolerances), None)

    def most_solutions(self, stage: str, flags: Iterable[str]) -> int:
        """How many solutions a row of an answer may hold: 1, or more where a problem has several."""
        flags = list(flags)
        rules = self.rules["several_solutions"]
        return next((r["most"] for r in rules if r["stage"] == stage and r["flag"] in flags), 1)
