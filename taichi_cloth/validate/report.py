"""The rows as a table and as JSON; and the rows of an earlier run, read from its JSON."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from math import isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple

from ..bench.report import machine, print_table
from ..errors import WrongUse, why
from ..files import whole_file
from .row import EXCELLENT, PASS, SHORT, TOO_SLOW, Limit, Result, Row

HEADINGS = ("reference", "solver", "what", "exact", "measured", "error", "verdict")
UNEXPLAINED = "no law explains it"
PACKAGE = Path(__file__).parents[1]
BROKEN = "more than its law explains"


class Measured(NamedTuple):
    """A run: the machine that it ran on, every row, and when and with which program, where that is known."""

    machine: Mapping[str, str]
    results: Sequence[Result]
    date: str | None = None  # UTC
    commit: str | None = None  # or the version of the package, where it is no clone


def cells(result: Result) -> tuple[str, ...]:
    """A row of the table."""
    row = result.row
    if result.verdict == TOO_SLOW:
        return (result.reference, result.solver, row.what, "-", "-", "-", f"too slow: over {row.seconds:.0f} s")
    numbers = (f"{row.exact:.6g}", f"{row.measured:.6g}", f"{row.error:.1e}")
    return (result.reference, result.solver, row.what, *numbers, result.verdict)


def reason(result: Result) -> str:
    """Why a row does not pass; nothing for one that does."""
    row = result.row
    if result.verdict == TOO_SLOW:
        return "its set-ups take too long"
    if result.verdict != SHORT:
        return ""
    if row.limit is None:
        return UNEXPLAINED
    return BROKEN if row.broken else row.limit.law


def reasons(results: Sequence[Result]) -> list[str]:
    """A line for each reference and reason: which solvers fall short, and why."""
    found: dict[tuple[str, str], list[str]] = {}
    for result in results:
        because = reason(result)
        if because:
            solvers = found.setdefault((result.reference, because), [])
            if result.solver not in solvers:
                solvers.append(result.solver)
    return [f"{reference} falls short with {', '.join(who)}: {because}" for (reference, because), who in found.items()]


def tally(results: Sequence[Result]) -> dict[str, float]:
    """How many rows there are of each kind, and the shares [%] that pass and are excellent."""
    verdicts = [result.verdict for result in results]
    excellent, passed = verdicts.count(EXCELLENT), verdicts.count(PASS)
    rows = max(len(results), 1)
    return {
        "rows": len(results),
        "excellent": excellent,
        "pass": passed,
        "falls short": verdicts.count(SHORT),
        "too slow": verdicts.count(TOO_SLOW),
        "broken": sum(result.row.broken for result in results),
        "pass or excellent [%]": round(100 * (excellent + passed) / rows, 1),
        "excellent [%]": round(100 * excellent / rows, 1),
    }


def count(results: Sequence[Result]) -> str:
    """The last line."""
    n = tally(results)
    explained = sum(result.row.explained for result in results)
    return (
        f"{n['rows']} rows: {n['excellent']} excellent, {n['pass']} pass, {n['falls short']} fall short"
        f" ({explained} as a law says, {n['broken']} broken), {n['too slow']} too slow"
    )


def by_solver(results: Sequence[Result]) -> dict[str, dict[str, float]]:
    solvers = dict.fromkeys(result.solver for result in results)
    return {solver: tally([result for result in results if result.solver == solver]) for solver in solvers}


def print_report(run: Measured) -> None:
    notes = (*reasons(run.results), " · ".join(run.machine.values()), count(run.results))
    print_table(HEADINGS, map(cells, run.results), slice(3, 6), notes)


def as_number(value: float) -> float | None:
    """JSON has no word for what is no number."""
    return value if isfinite(value) else None


def as_float(value: float | None) -> float:
    return nan if value is None else float(value)


def write_json(path: Path, run: Measured) -> None:
    """All there is. Raises OSError."""
    rows = [
        {
            "reference": result.number,
            "name": result.name,
            "solver": result.solver,
            "what": result.row.what,
            "exact": as_number(result.row.exact),
            "measured": as_number(result.row.measured),
            "error": as_number(result.row.error),
            "pass": as_number(result.row.good),
            "excellent": as_number(result.row.best),
            "verdict": result.verdict,
            "reason": reason(result),
            "law": None
            if result.row.limit is None
            else {"formula": result.row.limit.law, "most": result.row.limit.most},
            "seconds": result.row.seconds,
            "source": result.source,
        }
        for result in run.results
    ]
    everything = {
        "machine": dict(run.machine),
        "date": run.date,
        "commit": run.commit,
        "summary": {"all": tally(run.results), **by_solver(run.results)},
        "rows": rows,
    }
    with whole_file(path) as file:
        file.write(json.dumps(everything, indent=1, ensure_ascii=False, allow_nan=False).encode())


def read_json(path: Path) -> Measured:
    """A run that `write_json` wrote. Raises WrongUse for another file, and for none."""
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        results = [result_of(row) for row in read["rows"]]
        return Measured(read["machine"], results, read["date"], read["commit"])
    except OSError as error:
        raise WrongUse(why(error)) from None
    except (ValueError, KeyError, TypeError) as error:
        raise WrongUse(f"{path} is not what `validate --json` writes: {error!r}") from None


def result_of(row: Mapping[str, Any]) -> Result:
    limit = None if row["law"] is None else Limit(row["law"]["formula"], float(row["law"]["most"]))
    exact, measured, error, good, best = (
        as_float(row[key]) for key in ("exact", "measured", "error", "pass", "excellent")
    )
    measured_row = Row(row["what"], exact, measured, error, good, best, limit, float(row["seconds"]))
    return Result(row["reference"], row["name"], row["source"], row["solver"], measured_row)


def this_machine(results: Sequence[Result]) -> Measured:
    return Measured(machine(), results, datetime.now(UTC).strftime("%Y-%m-%d %H:%M"), commit_of(PACKAGE.parent))


def commit_of(folder: Path) -> str:
    """That of the clone which holds this program, `+` where files of it were changed since; else the version."""

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True).stdout

    try:
        if Path(git("rev-parse", "--show-toplevel").strip()).resolve() == folder.resolve():
            changed = git("status", "--porcelain", "--untracked-files=no", "--", PACKAGE.name)
            return git("rev-parse", "HEAD").strip() + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        pass
    return version("taichi-cloth")
