"""What was measured, as a table, as CSV and as JSON."""

from __future__ import annotations

import csv
import io
import json
import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from ..errors import OutputInUse, WrongUse
from ..files import whole_file
from ..machine import cpu_model
from .cases import Case

LOG_WIDTH = 132  # characters, where there is no terminal


@dataclass(frozen=True)
class Row:
    """One measurement; None where there is nothing to tell."""

    scene: str
    solver: str
    path: str
    columns: int
    rows: int
    substeps: int
    iterations: int
    springs: int | None = None
    frames: int | None = None  # that were timed
    median_ms: float | None = None
    p95_ms: float | None = None
    fits: int | None = None  # pictures a second that 95 of 100 frames are fast enough for, 0 for less than 60
    ns_per_spring: float | None = None  # in a sweep; explicit methods: in a substep
    over_c: float | None = None  # our time ÷ that of C
    under_javascript: float | None = None  # that of JavaScript ÷ our time
    cold_s: float | None = None  # to compile the first frame with an empty cache
    warm_s: float | None = None  # the same with the cache filled
    peak_mb: float | None = None  # memory of the whole process
    state_mb: float | None = None  # of the fields
    max_strain: float | None = None  # after the last frame
    stretch: float | None = None  # of it, what is not the elastic strain of a cloth that hangs still
    error: str | None = None

    @classmethod
    def failed(cls, case: Case, error: str) -> Row:
        return cls(
            case.scene,
            case.solver,
            case.path or "-",
            case.columns,
            case.rows,
            case.substeps,
            case.iterations,
            error=error,
        )


@dataclass(frozen=True)
class StageRow:
    """The curtain with one stage less or more."""

    change: str  # "" for the curtain as it is, -wind, +limit, =repulsion
    cold_s: float | None = None
    median_ms: float | None = None
    more_ms: float | None = None  # than the curtain as it is
    frames_per_second: float | None = None
    penetration: float | None = None  # [m] the deepest in the first frames
    error: str | None = None


def number(value: float | None, form: str = ".2f", unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"


def milliseconds(value: float | None) -> str:
    return number(value, ".3f" if value is not None and value < 10 else ".1f")


def cells(row: Row) -> list[str]:
    """A row of the table."""
    return [
        row.scene,
        row.solver,
        row.path,
        f"{row.columns}×{row.rows}",
        f"{row.substeps}×{row.iterations}",
        milliseconds(row.median_ms),
        milliseconds(row.p95_ms),
        "-" if row.fits is None else str(row.fits or "none"),
        number(row.ns_per_spring),
        number(row.over_c),
        number(row.under_javascript),
        number(row.cold_s, ".1f"),
        number(row.warm_s, ".1f"),
        number(row.peak_mb, ".0f"),
        number(row.state_mb, ".1f"),
        number(row.max_strain, ".1%"),
        number(row.stretch, ".1%"),
    ]


HEADINGS = (
    *("scene", "solver", "path", "grid", "n×m"),
    *("ms", "p95", "per s", "ns", "÷ C", "JS ÷", "cold s", "warm s", "MB", "state", "strain", "stretch"),
)
LEGEND = (
    "n×m substeps × iterations · ms, p95 a frame, median and 95th percentile · per s pictures a second it keeps up with"
    " (60, 144, 360: 16.7, 6.9, 2.8 ms at p95)\n"
    "ns of a spring in a sweep, or in a substep of an explicit method · ÷ C our time over that of C · JS ÷ JavaScript's"
    " over ours · cold, warm compiling, cache empty and filled\n"
    "MB peak of the process · state its fields, MB · strain the largest · stretch of it, more than the cloth's own"
    " weight explains · - not known here"
)


def wide_console() -> Console:
    """A console that plain tables fit on where there is no terminal."""
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = LOG_WIDTH
    return console


def print_table(
    headings: Sequence[str], lines: Iterable[Sequence[str]], figures: slice, notes: Iterable[str] = ()
) -> None:
    """A table whose columns `figures` are numbers, and what is to be said below it."""
    console = wide_console()
    table = Table(*headings, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for column in table.columns[figures]:
        column.justify = "right"
    for line in lines:
        table.add_row(*line)
    console.print(table)
    for note in notes:
        console.print(note, soft_wrap=True)


def print_report(rows: Sequence[Row], stages: Sequence[StageRow], missing: dict[str, str]) -> None:
    """The tables, what is missing and why, and the machine in the last line."""
    console = wide_console()
    if rows:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for number_of, heading in enumerate(HEADINGS):
            table.add_column(heading, justify="left" if number_of < 3 else "right", no_wrap=console.width >= LOG_WIDTH)
        for row in rows:
            table.add_row(*cells(row))
        console.print(table)
        console.print(LEGEND, soft_wrap=True)
    if any(stage.error is None for stage in stages):
        table = Table("stage", box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
        for heading in ("ms", "more than all", "frames/s", "deepest mm", "cold s"):
            table.add_column(heading, justify="right")
        for stage in stages:
            change = stage.change or "curtain, all it names"
            for sign, words in {"-": "without ", "+": "with ", "=": "ball with "}.items():
                change = change.replace(sign, words)
            more = number(stage.more_ms, "+.3f") if stage.change else ""
            depth = None if stage.penetration is None else 1e3 * stage.penetration
            speed = number(stage.frames_per_second, ".0f")
            table.add_row(
                change, milliseconds(stage.median_ms), more, speed, number(depth, ".1f"), number(stage.cold_s, ".1f")
            )
        console.print(table)
    for what, why in [*missing.items(), *failures(rows, stages).items()]:
        console.print(f"{what}: {why}", soft_wrap=True)
    console.print(" · ".join(machine().values()), soft_wrap=True)


def printed_table(lines: Sequence[Sequence[str]]) -> Table:
    """Lines of text as a table for a terminal, the first as its heading: numbers to the right, behind a name."""
    head, *body = lines
    table = Table(*head, box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for line in body:
        table.add_row(*line)
    return table


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Lines of Markdown; the first is the heading."""
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return [head, f"|{'---|' * len(lines[0])}", *body]


def failures(rows: Sequence[Row], stages: Sequence[StageRow]) -> dict[str, str]:
    """What failed, and why."""
    found = {f"{r.solver} {r.columns}×{r.rows} {r.path}, failed": r.error for r in rows if r.error}
    return found | {f"stage {s.change or 'curtain'}, failed": s.error for s in stages if s.error}


def machine() -> dict[str, str]:
    """What the numbers belong to."""
    return {
        "cpu": cpu_model(),
        "cores": f"{os.cpu_count()} cores",
        "python": f"Python {platform.python_version()}",
        "taichi": f"Taichi {version('taichi')}",
        "taichi_cloth": f"taichi_cloth {version('taichi-cloth')}",
    }


def made() -> dict[str, Any]:
    """Where and when a run is made, for its JSON."""
    return {"machine": machine(), "date": datetime.now(UTC).date().isoformat()}


def check_free(path: Path, *, force: bool) -> None:
    """Says what would go wrong before minutes are spent. Raises OutputInUse and WrongUse."""
    if path.is_dir():
        raise OutputInUse(f"{path} is a folder, not a file")
    if path.exists() and not force:
        raise OutputInUse(f"{path} exists already: use --force to replace it")
    if not path.parent.is_dir():
        raise WrongUse(f"{path.parent} is no folder to write {path.name} into")


def write_csv(path: Path, rows: Sequence[Any], kind: type = Row) -> None:
    """Dataclasses of one kind, a line each, an empty cell where nothing is known. Raises OSError."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(kind)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    with whole_file(path) as file:
        file.write(text.getvalue().encode())


def write_json(path: Path, rows: Sequence[Row], stages: Sequence[StageRow], missing: dict[str, str]) -> None:
    """All there is. Raises OSError."""
    everything: dict[str, Any] = {
        **made(),
        "rows": [asdict(row) for row in rows],
        "stages": [asdict(stage) for stage in stages],
        "missing": missing,
    }
    with whole_file(path) as file:
        file.write(json.dumps(everything, indent=1).encode())
