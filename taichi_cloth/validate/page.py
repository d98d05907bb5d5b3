"""Two pages for documents, from a run: what passes and why not all does, and every row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..bench.report import markdown_table
from ..files import whole_file
from .report import HEADINGS, Measured, by_solver, cells, count, reasons, tally
from .row import EXCELLENT, PASS, SHORT, TOO_SLOW, Result

ROWS = "_rows"  # after the name of the page
MARKS = {EXCELLENT: "*", PASS: "", SHORT: "**", TOO_SLOW: "**"}
GOAL = (90.0, 60.0)  # [%] of rows that should pass, and be excellent


def write_pages(path: Path, run: Measured) -> None:
    """The page, and beside it the page of all rows. Raises OSError."""
    rows = path.with_name(f"{path.stem}{ROWS}{path.suffix}")
    for target, lines in ((path, main_page(run, rows.name)), (rows, rows_page(run, path.name))):
        with whole_file(target) as file:
            file.write("\n".join([*lines, ""]).encode())


def main_page(run: Measured, rows: str) -> list[str]:
    results = run.results
    n = tally(results)
    lines = ["# Validation", "", f"{count(results)}. [{rows}]({rows}) has them all.", ""]
    lines += [
        f"{n['pass or excellent [%]']:.1f} % pass (goal: {GOAL[0]:g} %), {n['excellent [%]']:.1f} % are excellent"
        f" (goal: {GOAL[1]:g} %).",
        "",
        *markdown_table(summary(results)),
        "",
        " · ".join([*run.machine.values(), *filter(None, (run.date, run.commit))]),
        "",
    ]
    lines += ["## Largest errors", "", "*Excellent* · pass · **falls short or too slow**", ""]
    lines += markdown_table(matrix(results))
    return [*lines, "", "## Why", "", *(f"- {line}" for line in reasons(results))]


def rows_page(run: Measured, main: str) -> list[str]:
    table = markdown_table([[*HEADINGS, "source"], *([*cells(result), result.source] for result in run.results)])
    return ["# Validation: every row", "", f"The results behind [{main}]({main}).", "", *table]


def summary(results: Sequence[Result]) -> list[list[str]]:
    """A table: all solvers, then each."""
    lines = [["solver", "rows", "excellent", "pass", "falls short", "too slow", "pass or excellent", "excellent"]]
    for name, n in {"all": tally(results), **by_solver(results)}.items():
        counts = [f"{n[key]:g}" for key in ("rows", "excellent", "pass", "falls short", "too slow")]
        lines.append([name, *counts, f"{n['pass or excellent [%]']:.1f} %", f"{n['excellent [%]']:.1f} %"])
    return lines


def matrix(results: Sequence[Result]) -> list[list[str]]:
    """A line for each reference: the largest error with each solver, in bold where it falls short."""
    solvers = list(dict.fromkeys(result.solver for result in results))
    order = (EXCELLENT, PASS, TOO_SLOW, SHORT)
    lines = [["reference", *solvers]]
    for reference in dict.fromkeys(result.reference for result in results):
        line = [reference]
        for solver in solvers:
            rows = [result for result in results if (result.reference, result.solver) == (reference, solver)]
            worst = max(rows, key=lambda r: (order.index(r.verdict), r.row.error), default=None)
            if worst is None:
                line.append("")
            else:
                mark = MARKS[worst.verdict]
                line.append(f"{mark}{'too slow' if worst.verdict == TOO_SLOW else f'{worst.row.error:.1e}'}{mark}")
        lines.append(line)
    return lines
