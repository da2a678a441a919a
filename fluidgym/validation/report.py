"""Results as lines of a table, as JSON and as a page of documentation."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import date
from itertools import groupby
from pathlib import Path
from typing import Any

from fluidgym.files import replacing
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES
from fluidgym.validation.case import Case, Result

_COLUMNS = "{:<16}{:>4}{:>6}{:>11}{:>8}{:>9}   {:<16}{:>11}{:>11}{:>7}   {:<17}{:<17}"
TABLE_HEAD = _COLUMNS.format(
    "case", "dim", "dx", "particles", "steps", "time", "error", "value", "spread", "order", "target", "goal"
).rstrip()


def table_lines(result: Result, order: Mapping[str, float]) -> list[str]:
    """The lines of one run: one for each error, with its order of convergence by name where it is known."""
    rows = enumerate(_rows(as_json(result, order)))
    return [_COLUMNS.format("" if index else result.case, *row).rstrip() for index, row in rows]


def _rows(found: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """What the table says of a run, but for the name of the case: a row for each error, what they share in the first.

    Args:
        found: The run, `as_json`.
    """
    head = (
        f"{found['dim']}D",
        f"1/{found['resolution']}",
        str(found["particles"]),
        str(found["steps"]),
        f"{found['wall_s']:.2f} s",
    )
    rows = []
    for name, value in found["errors"].items():
        order = found["order"].get(name, math.nan)
        rows.append(
            (
                *(("",) * len(head) if rows else head),
                name,
                "nan" if value is None else f"{value:.3g}",
                known(found.get("spread", {}).get(name), ".2g"),
                known(order, ".1f"),
                _verdict(value, found["target"].get(name), ("pass", "MISS")),
                _verdict(value, found["goal"].get(name), ("met", "not met")),
            )
        )
    return rows


def known(value: float | None, form: str) -> str:
    """A number as text; nothing where it is not known."""
    return "" if value is None or not math.isfinite(value) else f"{value:{form}}"


def _verdict(value: float | None, limit: float | None, words: tuple[str, str]) -> str:
    if limit is None:
        return ""
    return f"{limit:g} {words[0] if value is not None and abs(value) <= limit else words[1]}"


def as_json(result: Result, order: Mapping[str, float]) -> dict[str, Any]:
    """A run as an object of plain values; a number that is not finite is null."""
    names = ("case", "resolution", "dim", "particles", "steps", "wall_s", "setup_s", "device", "errors", "target")
    found = {name: getattr(result, name) for name in names}
    found |= {"seeds": result.seeds, "spread": result.spread} if result.seeds > 1 else {}
    found |= {"goal": result.goal, "order": dict(order), "passed": result.passed, "times": result.times.tolist()}
    found["records"] = {name: values.tolist() for name, values in result.records.items()}
    return finite(found)


def write_json(path: Path, objects: Sequence[Mapping[str, Any]]) -> None:
    """Write a list of objects to a file: all of it, or none of it and the file stays as it was."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(list(objects), indent=1, allow_nan=False) + "\n", encoding="utf-8")


# -- as a page -------------------------------------------------------------------------------------------------------

_INTRO = """\
# Validation

What this command measured on {day}; {facts}:

```bash
{command}
```

Flows with a known answer, at resolutions that double. A file in `fluidgym/validation/` says at its head what the scene
and the reference of a case are, what its errors mean, and where they come from. At 1/n, n particles lie along the
length of the case. "Order" is the exponent of the particle spacing that an error follows from the resolution before.
"Target" is what a run has to keep, and the tests see to it that it does; "goal" is what is striven for, most of it at
the finer resolutions only. Times are of a single run, without compiling; other work on the machine lengthens them.
With `--seeds`, "value" is the mean of so many runs whose starts differ by a hundredth of the spacing, and "spread" the
standard deviation of one.
"""


def told(facts: Mapping[str, Any]) -> str:
    """Facts, such as those of a machine, in a line."""
    return ", ".join(f"{name} {value}" for name, value in facts.items())


def markdown(
    objects: Sequence[Mapping[str, Any]],
    cases: Mapping[str, Case],
    facts: Mapping[str, str],
    command: str,
    left_out: Sequence[str] = (),
) -> str:
    """Results as a page of documentation.

    Args:
        objects: The runs, `as_json`; those of a case stand together.
        cases: The cases by name.
        facts: What times belong to, by name.
        command: What makes the page anew.
        left_out: Runs that would have taken too long.
    """
    today = date.today()
    text = [_INTRO.format(command=command, day=f"{today.day} {today:%B %Y}", facts=told(facts))]
    text += [f"Left out, for they would take longer than the limit: {', '.join(left_out)}.\n"] if left_out else []
    for name, runs in groupby(objects, lambda run: run["case"]):
        runs = list(runs)
        rows = [row for run in runs for row in _rows(run)]
        table = markdown_table(
            ("", "dx", "particles", "steps", "time", "error", "value", "spread", "order", "target", "goal"), rows
        )
        about = f"{cases[name].title}. {_scheme(cases[name], runs[0].get('scheme'))}"
        text.append("\n".join([f"## {name}", "", about, "", *table, ""]))
    return "\n".join(text)


def _scheme(case: Case, named: str | None) -> str:
    """How a case is simulated, in words; one that is named is in place of its own."""
    if named:
        return f"The scheme `{named}`."
    schemes = {part.scheme for part in case.parts.values()} or {case.scheme}
    if schemes == {DEFAULT_SCHEME}:
        return "The default scheme."
    names = [name for name, scheme in FIDELITIES.items() if schemes == {scheme}]
    return f"The scheme `{names[0]}`." if names else "A scheme of its own."


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table of Markdown."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def write_page(path: Path, text: str) -> None:
    """Write a page: all of it, or none of it and the file stays as it was."""
    with replacing(path) as unfinished:
        unfinished.write_text(text.rstrip("\n") + "\n", encoding="utf-8")


# -- as JSON ---------------------------------------------------------------------------------------------------------


def finite(value: Any) -> Any:
    """A plain value, with null for each number in it that is not finite."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
