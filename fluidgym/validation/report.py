"""Results as lines of a table and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fluidgym.files import replacing
from fluidgym.validation.case import Result

_COLUMNS = "{:<16}{:>4}{:>6}{:>11}{:>8}{:>9}   {:<16}{:>11}{:>7}   {:<17}{:<17}"
TABLE_HEAD = _COLUMNS.format(
    "case", "dim", "dx", "particles", "steps", "time", "error", "value", "order", "target", "goal"
).rstrip()


def table_lines(result: Result, order: Mapping[str, float]) -> list[str]:
    """The lines of one run: one for each error, with its order of convergence by name where it is known."""
    lines = []
    head = (
        result.case,
        f"{result.dim}D",
        f"1/{result.resolution}",
        str(result.particles),
        str(result.steps),
        f"{result.wall_s:.2f} s",
    )
    for name, value in result.errors.items():
        line = _COLUMNS.format(
            *head,
            name,
            f"{value:.3g}",
            f"{order[name]:.1f}" if name in order else "",
            _verdict(result, name, result.target, ("pass", "MISS")),
            _verdict(result, name, result.goal, ("met", "not met")),
        )
        lines.append(line.rstrip())
        head = ("",) * len(head)
    return lines


def _verdict(result: Result, error: str, limits: Mapping[str, float], words: tuple[str, str]) -> str:
    kept = result.keeps(error, limits)
    return "" if kept is None else f"{limits[error]:g} {words[0] if kept else words[1]}"


def as_json(result: Result, order: Mapping[str, float]) -> dict[str, Any]:
    """A run as an object of plain values; a number that is not finite is null."""
    names = ("case", "resolution", "dim", "particles", "steps", "wall_s", "setup_s", "device", "errors", "target")
    found = {name: getattr(result, name) for name in names}
    found |= {"goal": result.goal, "order": dict(order), "passed": result.passed, "times": result.times.tolist()}
    found["records"] = {name: values.tolist() for name, values in result.records.items()}
    return finite(found)


def write_json(path: Path, objects: Sequence[Mapping[str, Any]]) -> None:
    """Write a list of objects to a file: all of it, or none of it and the file stays as it was."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(list(objects), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def finite(value: Any) -> Any:
    """A plain value, with null for each number in it that is not finite."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
