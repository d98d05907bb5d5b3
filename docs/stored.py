"""Results that lie in the repository, written by the commands: benchmarks/results/*.json, and assets/error.csv.

Times are in a folder with the name of their machine; stability.json and validation.json are of any machine, and say
which.

Everything returns None or nothing where no run is stored, and documents then say so.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

TOP = Path(__file__).resolve().parents[1]
RESULTS = TOP / "benchmarks" / "results"
ERRORS = TOP / "assets" / "error.csv"

ALIVE, FAILED, SLOW, NOT_RUN = "alive", "failed", "too slow", "not run"  # a hard case, with one setting
PASSED = ("excellent", "pass")  # verdicts of a row of `validate` that reaches its tolerance

Words = dict[str, Any]


def load(name: str) -> Words | None:
    """What a command wrote: the file for all machines, else, where several have one, that of the first by name."""
    for path in (RESULTS / f"{name}.json", *sorted(RESULTS.glob(f"*/{name}.json"))):
        if not path.exists():
            continue
        words: Words = json.loads(path.read_text(encoding="utf-8"))
        return words
    return None


def machine_of(words: Words) -> str:
    """The machine and the versions a result belongs to, in one line."""
    found = words["machine"]
    return found if isinstance(found, str) else " · ".join(found.values())


BUSY = 2.0  # p95 over median; 1.2 to 1.7 where little else runs


def disturbed(rows: list[Words]) -> str:
    """A warning, where times vary so much that other programs must have run; else nothing."""
    ratios = [row["p95_ms"] / row["median_ms"] for row in rows if row.get("median_ms")]
    if not ratios or median(ratios) <= BUSY:
        return ""
    return (
        f"**Other programs ran during this run**: the 95th percentile of a frame is {median(ratios):.1f} times its"
        " median. Do not take these times for those of the program; ratios suffer as well.\n\n"
    )


# -- bench -------------------------------------------------------------------------------------------------------


def bench_row(solver: str, grid: tuple[int, int], path: str = "lanes") -> Words | None:
    """A row of `bench`: `grid` is columns and rows."""
    for row in (load("bench") or {"rows": []})["rows"]:
        if (row["solver"], (row["columns"], row["rows"]), row["path"]) == (solver, grid, path):
            return dict(row)
    return None


def goal_figure(kind: str, key: str, name: str) -> Words | None:
    """Of `bench --goals`: a command by its `what`, or a sheet by its `name`."""
    for row in (load("goals") or {kind: []})[kind]:
        if row[key] == name:
            return dict(row)
    return None


def errors(cells: int, solver: str | None = None) -> list[Words]:
    """Settings of assets/error.csv on a grid, with numbers as numbers."""
    with ERRORS.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if int(row["cells"]) == cells and solver in (None, row["solver"])]
    texts = ("solver",)
    return [{name: text if name in texts else float(text or "nan") for name, text in row.items()} for row in rows]


def setting_of(row: Words) -> str:
    """`5×12`; of methods that do not iterate the substeps alone."""
    substeps, iterations = int(row["substeps"]), int(row["iterations"])
    return f"{substeps}" if row["solver"] in ("spring", "rk4") else f"{substeps}×{iterations}"


def milliseconds(ms: float) -> str:
    digits = 2 if ms < 10 else 1 if ms < 100 else 0
    return f"{ms:.{digits}f}\N{NO-BREAK SPACE}ms"


def per_cent(share: float) -> str:
    """Two digits, however small: errors span six powers of ten."""
    return f"{float(f'{100 * share:.2g}'):.10f}".rstrip("0").rstrip(".") + "\N{NO-BREAK SPACE}%"


def fastest(rows: list[Words], error: float) -> Words | None:
    """The fastest setting with a largest error of at most so much."""
    return min(
        (row for row in rows if row["max_error"] <= error), key=lambda row: float(row["median_ms"]), default=None
    )


# -- stress ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CaseResult:
    """A hard case with a setting."""

    number: int
    name: str
    setting: str
    state: str
    failures: tuple[Words, ...]  # results of variants that failed


def hard_cases(words: Words) -> Iterator[CaseResult]:
    """One variant that fails fails a case. Otherwise all must have run, and one that is too slow makes it too slow."""
    results = {(row["case"], row["variant"], row["setting"]): row for row in words["results"]}
    names = {row["case"]: row["name"] for row in words["results"]}
    units: dict[tuple[int, str], list[Words | None]] = {}
    for case, variant, setting in words["planned"]:
        units.setdefault((case, setting), []).append(results.get((case, variant, setting)))
    for (case, setting), rows in units.items():
        ran = [row for row in rows if row is not None]
        failures = tuple(row for row in ran if row["failure"] is not None)
        slow = any(row["slow_ms"] is not None for row in ran)
        state = FAILED if failures else NOT_RUN if len(ran) < len(rows) else SLOW if slow else ALIVE
        yield CaseResult(case, names.get(case, ""), setting, state, failures)


def survival(words: Words) -> dict[str, Counter[str]]:
    """How many cases are in which state, by setting."""
    found: dict[str, Counter[str]] = {}
    for case in hard_cases(words):
        found.setdefault(case.setting, Counter())[case.state] += 1
    return found


# -- validate ----------------------------------------------------------------------------------------------------


def verdicts(words: Words) -> dict[str, Counter[str]]:
    """How many rows have which verdict, by solver; all of them under "all"."""
    found: dict[str, Counter[str]] = {"all": Counter()}
    for row in words["rows"]:
        for name in ("all", row["solver"]):
            found.setdefault(name, Counter())[row["verdict"]] += 1
    return found


def shortfalls(words: Words, solver: str) -> tuple[list[tuple[str, int, int, float]], int]:
    """References that a solver does not pass: name, rows that do not, all rows, largest error; and how many it has."""
    by_reference: dict[str, list[Words]] = {}
    for row in words["rows"]:
        if row["solver"] == solver:
            by_reference.setdefault(f"{row['reference']} {row['name']}", []).append(row)
    short = []
    for name, rows in by_reference.items():
        missed = [row for row in rows if row["verdict"] not in PASSED]
        if missed:
            worst = max((float("inf") if row["error"] is None else float(row["error"])) for row in missed)
            short.append((name, len(missed), len(rows), worst))
    return short, len(by_reference)
