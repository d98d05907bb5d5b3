"""Results that the commands stored in the repository: benchmarks/results/*.json, and assets/error.csv.

Times are in a folder per machine; stability.json and validation.json may be of any machine, which they name. Functions
return None or nothing if no run is stored; documents then say so.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from statistics import median
from typing import Any

from taichi_cloth.evaluation.bench.gpu_report import GpuRun, read_run

TOP = Path(__file__).resolve().parents[1]
RESULTS = TOP / "benchmarks" / "results"
ERRORS = TOP / "assets" / "error.csv"

ALIVE, FAILED, SLOW, NOT_RUN = "alive", "failed", "too slow", "not run"  # states of a stress case with one setting
PASSED = ("excellent", "pass")  # verdicts of rows of `validate` that are within their tolerance

Words = dict[str, Any]


def load(name: str) -> Words | None:
    """Return the content of NAME.json: that of all machines, otherwise that of the first machine by name that has one.

    Returns None if there is none.
    """
    for path in (RESULTS / f"{name}.json", *sorted(RESULTS.glob(f"*/{name}.json"))):
        if not path.exists():
            continue
        words: Words = json.loads(path.read_text(encoding="utf-8"))
        return words
    return None


def machine_of(words: Words) -> str:
    """Return the machine and the versions of a result as one line."""
    found = words["machine"]
    return found if isinstance(found, str) else " · ".join(found.values())


BUSY = 2.0  # 95th percentile of a frame time over its median; 1.2 to 1.7 on an idle machine


def disturbed(rows: list[Words]) -> str:
    """Return a warning if frame times vary so much that other programs must have run, otherwise an empty string."""
    ratios = [row["p95_ms"] / row["median_ms"] for row in rows if row.get("median_ms")]
    if not ratios or median(ratios) <= BUSY:
        return ""
    return (
        f"**Other programs ran during this run**: the 95th percentile of a frame is {median(ratios):.1f} times its"
        " median. These times are too long, and the ratios are affected too.\n\n"
    )


# -- bench -------------------------------------------------------------------------------------------------------------


def bench_row(solver: str, grid: tuple[int, int], layout: str = "simd") -> Words | None:
    """Return a row of `bench`; `grid` is columns and rows."""
    for row in (load("bench") or {"rows": []})["rows"]:
        if (row["solver"], (row["columns"], row["rows"]), row["layout"]) == (solver, grid, layout):
            return dict(row)
    return None


def goal_figure(kind: str, key: str, name: str) -> Words | None:
    """Return a result of `bench --goals`: a command by its `what`, or a sheet by its `name`."""
    for row in (load("goals") or {kind: []})[kind]:
        if row[key] == name:
            return dict(row)
    return None


def gpu() -> GpuRun | None:
    """Return the stored run of `bench --gpu`."""
    words = load("gpu")
    return None if words is None else read_run(words)


def errors(cells: int, solver: str | None = None) -> list[Words]:
    """Return the settings of assets/error.csv on a grid, with numbers as float."""
    with ERRORS.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if int(row["cells"]) == cells and solver in (None, row["solver"])]
    texts = ("solver",)
    return [{name: text if name in texts else float(text or "nan") for name, text in row.items()} for row in rows]


def setting_of(row: Words) -> str:
    """Return `5×12`, or the number of substeps for a solver without iterations."""
    substeps, iterations = int(row["substeps"]), int(row["iterations"])
    return f"{substeps}" if row["solver"] in ("explicit", "rk4") else f"{substeps}×{iterations}"


def milliseconds(ms: float) -> str:
    digits = 2 if ms < 10 else 1 if ms < 100 else 0
    return f"{ms:.{digits}f}\N{NO-BREAK SPACE}ms"


def per_cent(share: float) -> str:
    """Return a share in % with two significant digits: errors span six orders of magnitude."""
    return f"{float(f'{100 * share:.2g}'):.10f}".rstrip("0").rstrip(".") + "\N{NO-BREAK SPACE}%"


def fastest(rows: list[Words], error: float) -> Words | None:
    """Return the fastest setting whose largest error is at most `error`. Cloth that is not finite is none."""
    return min(
        (row for row in rows if row["max_error"] <= error and isfinite(row["rms_error"])),
        key=lambda row: float(row["median_ms"]),
        default=None,
    )


def most_accurate(rows: list[Words]) -> Words | None:
    """Return the setting with the smallest largest error, of those whose cloth is finite."""
    finite = [row for row in rows if isfinite(row["max_error"]) and isfinite(row["rms_error"])]
    return min(finite, key=lambda row: float(row["max_error"]), default=None)


# -- stress ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CaseResult:
    """The result of a stress case with one setting."""

    number: int
    name: str
    setting: str
    state: str
    failures: tuple[Words, ...]
    """Results of the variants that failed."""


def hard_cases(words: Words) -> Iterator[CaseResult]:
    """Yield the state of each case with each setting.

    It is failed if one variant failed, else not run if one is missing, else too slow if one is, else alive.
    """
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
    """Return the number of cases in each state, by setting."""
    found: dict[str, Counter[str]] = {}
    for case in hard_cases(words):
        found.setdefault(case.setting, Counter())[case.state] += 1
    return found


# -- validate ----------------------------------------------------------------------------------------------------------


def verdicts(words: Words) -> dict[str, Counter[str]]:
    """Return the number of rows with each verdict, by solver, and of all rows as "all"."""
    found: dict[str, Counter[str]] = {"all": Counter()}
    for row in words["rows"]:
        for name in ("all", row["solver"]):
            found.setdefault(name, Counter())[row["verdict"]] += 1
    return found


def shortfalls(words: Words, solver: str) -> tuple[list[tuple[str, int, int, int, float | None]], int]:
    """Return the references that a solver does not reach, and the number of its references.

    Each is a tuple of name, number of rows that fall short, of rows that are too slow to be measured, of all rows, and
    the largest measured error of the former.
    """
    by_reference: dict[str, list[Words]] = {}
    for row in words["rows"]:
        if row["solver"] == solver:
            by_reference.setdefault(f"{row['reference']} {row['name']}", []).append(row)
    short = []
    for name, rows in by_reference.items():
        missed = [row for row in rows if row["verdict"] not in PASSED]
        slow = sum(row["verdict"] == SLOW for row in missed)
        if missed:
            worst = max((float(row["error"]) for row in missed if row["error"] is not None), default=None)
            short.append((name, len(missed) - slow, slow, len(rows), worst))
    return short, len(by_reference)
