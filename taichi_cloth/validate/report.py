"""The rows as a table, as JSON and as Markdown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from ..bench.report import machine, markdown_table, print_table
from ..files import whole_file
from .row import EXCELLENT, PASS, SHORT, Result

HEADINGS = ("reference", "solver", "what", "exact", "measured", "error", "verdict")


def cells(result: Result) -> tuple[str, ...]:
    """A row of the table."""
    row = result.row
    reference = f"{result.reference.number} {result.reference.name}"
    return (
        reference,
        result.solver,
        row.what,
        f"{row.exact:.6g}",
        f"{row.measured:.6g}",
        f"{row.error:.1e}",
        result.verdict,
    )


def reasons(results: Sequence[Result]) -> list[str]:
    """A line for each reference and reason: which solvers fall short, and why."""
    found: dict[tuple[str, str], list[str]] = {}
    for result in results:
        if result.verdict == SHORT:
            reference = f"{result.reference.number} {result.reference.name}"
            solvers = found.setdefault((reference, result.reason or "it should not"), [])
            if result.solver not in solvers:
                solvers.append(result.solver)
    return [f"{reference} falls short with {', '.join(who)}: {why}" for (reference, why), who in found.items()]


def count(results: Sequence[Result]) -> str:
    """The last line."""
    verdicts = [result.verdict for result in results]
    short = verdicts.count(SHORT)
    broken = sum(result.broken for result in results)
    return (
        f"{len(results)} rows: {verdicts.count(EXCELLENT)} excellent, {verdicts.count(PASS)} pass, {short} fall short"
        f" ({short - broken} for a known reason, {broken} broken)"
    )


def matrix(results: Sequence[Result]) -> list[list[str]]:
    """A line for each reference: the largest error with each solver, in bold where it falls short."""
    solvers = list(dict.fromkeys(result.solver for result in results))
    lines = [["reference", *solvers]]
    for reference in dict.fromkeys(f"{r.reference.number} {r.reference.name}" for r in results):
        line = [reference]
        for solver in solvers:
            rows = [
                r for r in results if f"{r.reference.number} {r.reference.name}" == reference and r.solver == solver
            ]
            worst = max(rows, key=lambda r: (r.verdict == SHORT, r.verdict == PASS, r.row.error), default=None)
            if worst is None:
                line.append("")
            else:
                mark = {SHORT: "**", PASS: "", EXCELLENT: "*"}[worst.verdict]
                line.append(f"{mark}{worst.row.error:.1e}{mark}")
        lines.append(line)
    return lines


def print_report(results: Sequence[Result]) -> None:
    notes = (*reasons(results), " · ".join(machine().values()), count(results))
    print_table(HEADINGS, map(cells, results), slice(3, 6), notes)


def write_json(path: Path, results: Sequence[Result]) -> None:
    """All there is. Raises OSError."""
    rows = [
        {
            "reference": result.reference.number,
            "name": result.reference.name,
            "solver": result.solver,
            "what": result.row.what,
            "exact": result.row.exact,
            "measured": result.row.measured,
            "error": result.row.error,
            "pass": result.row.good,
            "excellent": result.row.best,
            "verdict": result.verdict,
            "reason": result.reason,
            "source": result.reference.source,
        }
        for result in results
    ]
    with whole_file(path) as file:
        file.write(json.dumps({"machine": machine(), "rows": rows}, indent=1, ensure_ascii=False).encode())


def write_markdown(path: Path, results: Sequence[Result]) -> None:
    """Tables that documents can hold: the largest errors, why some fall short, and every row. Raises OSError."""
    lines = ["# Validation", "", count(results), "", " · ".join(machine().values()), ""]
    lines += ["## Largest errors", "", "*Excellent* · pass · **falls short**", ""]
    lines += markdown_table(matrix(results))
    lines += ["", "## Why", "", *(f"- {line}" for line in reasons(results)), "", "## All rows", ""]
    lines += markdown_table([[*HEADINGS, "source"], *([*cells(result), result.reference.source] for result in results)])
    with whole_file(path) as file:
        file.write("\n".join([*lines, ""]).encode())
