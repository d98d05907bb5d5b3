"""Reports of `bench`: tables for a terminal and JSON files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path

from rich import box
from rich.table import Table

from ...system.console import LOG_WIDTH, commit_of, machine, milliseconds, new_file, number, wide_console
from .cases import Case

NOT_FINITE = "not finite"  # instead of a figure of a cloth that ended in NaN or infinity


def finite(value: float, form: str) -> str:
    """Return a value in a format such as ".1e", or `NOT_FINITE`."""
    return f"{value:{form}}" if isfinite(value) else NOT_FINITE


@dataclass(frozen=True)
class Row:
    """One measurement. A value that was not measured, or does not apply, is None."""

    scene: str
    solver: str
    layout: str
    columns: int
    rows: int
    substeps: int
    iterations: int
    springs: int | None = None
    frames: int | None = None
    """Number of frames timed."""
    median_ms: float | None = None
    """Median frame time [ms]."""
    p95_ms: float | None = None
    """95th percentile of the frame time [ms]."""
    max_frame_rate: int | None = None
    """Highest frame rate of `FRAME_RATES` that `p95_ms` allows [1/s]; 0 if it is below the lowest, 60."""
    ns_per_spring: float | None = None
    """Time of a spring in an iteration, for explicit solvers in a substep [ns]."""
    ratio_to_c: float | None = None
    """Our frame time ÷ that of C."""
    speedup_over_javascript: float | None = None
    """Frame time of JavaScript ÷ ours."""
    cold_s: float | None = None
    """Time to compile the first frame with an empty kernel cache [s]."""
    warm_s: float | None = None
    """Time to compile the first frame with a filled kernel cache [s]."""
    peak_mb: float | None = None
    """Peak memory of the process [MB]."""
    state_mb: float | None = None
    """Size of the fields [MB]."""
    max_strain: float | None = None
    """Largest strain after the last frame."""
    stretch: float | None = None
    """Artificial stretch: `max_strain` less the largest strain of the cloth at rest."""
    frame_error: float | None = None
    """Error of the frame after the last one [m] (`FrameError.error`)."""
    error: str | None = None
    """Why the measurement failed; None if it did not."""

    @classmethod
    def failed(cls, case: Case, error: str) -> Row:
        """Return the row of a measurement that failed."""
        return cls(
            case.scene,
            case.solver,
            case.layout or "-",
            case.columns,
            case.rows,
            case.substeps,
            case.iterations,
            error=error,
        )


@dataclass(frozen=True)
class FeatureRow:
    """Cost of the curtain with one feature removed, added or changed."""

    change: str
    """As in `Case.change`; empty for the curtain with its own features."""
    cold_s: float | None = None
    """Time to compile the first frame with an empty kernel cache [s]."""
    median_ms: float | None = None
    """Median frame time [ms]."""
    more_ms: float | None = None
    """Difference of the frame time from that of the unchanged curtain [ms]."""
    frames_per_second: float | None = None
    penetration: float | None = None
    """Largest penetration in the first frames [m]."""
    error: str | None = None
    """Why the measurement failed; None if it did not."""


def cells(row: Row) -> list[str]:
    """Return a row of the table as text."""
    return [
        row.scene,
        row.solver,
        row.layout,
        f"{row.columns}×{row.rows}",
        f"{row.substeps}×{row.iterations}",
        milliseconds(row.median_ms),
        milliseconds(row.p95_ms),
        "-" if row.max_frame_rate is None else str(row.max_frame_rate or "none"),
        number(row.ns_per_spring),
        number(row.ratio_to_c),
        number(row.speedup_over_javascript),
        number(row.cold_s, ".1f"),
        number(row.warm_s, ".1f"),
        number(row.peak_mb, ".0f"),
        number(row.state_mb, ".1f"),
        number(row.max_strain, ".1%"),
        number(row.stretch, ".1%"),
        number(None if row.frame_error is None else 1e3 * row.frame_error, ".2g"),
    ]


HEADINGS = (
    *("scene", "solver", "layout", "grid", "n×m"),
    *("ms", "p95", "fps", "ns", "÷ C", "JS ÷", "cold s", "warm s", "MB", "state", "strain", "stretch", "error"),
)
LEGEND = (
    "n×m: substeps × iterations · ms, p95: frame time, median and 95th percentile · fps: frame rate that p95 allows"
    " (60, 144, 360: 16.7, 6.9, 2.8 ms)\n"
    "ns: time of a spring in an iteration, or in a substep of an explicit solver · ÷ C: our time over that of C · JS ÷:"
    " JavaScript's over ours · cold, warm: compile time, cache empty and filled\n"
    "MB: peak memory of the process · state: its fields, MB · strain: the largest · stretch: the part of it that the"
    " weight of the cloth does not explain · error: of a frame, mm · -: not measured"
)


def print_report(rows: Sequence[Row], features: Sequence[FeatureRow], missing: dict[str, str]) -> None:
    """Print the tables, what is missing and why, and the machine in the last line."""
    console = wide_console()
    if rows:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for column, heading in enumerate(HEADINGS):
            table.add_column(heading, justify="left" if column < 3 else "right", no_wrap=console.width >= LOG_WIDTH)
        for row in rows:
            table.add_row(*cells(row))
        console.print(table)
        console.print(LEGEND, soft_wrap=True)
    if any(feature.error is None for feature in features):
        table = Table("feature", box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
        for heading in ("ms", "difference", "frames/s", "depth mm", "cold s"):
            table.add_column(heading, justify="right")
        for feature in features:
            change = feature.change or "curtain, all features"
            for sign, words in {"-": "without ", "+": "with ", "=": "sphere with "}.items():
                change = change.replace(sign, words)
            difference = number(feature.more_ms, "+.3f") if feature.change else ""
            depth = None if feature.penetration is None else 1e3 * feature.penetration
            rate = number(feature.frames_per_second, ".0f")
            table.add_row(
                change,
                milliseconds(feature.median_ms),
                difference,
                rate,
                number(depth, ".1f"),
                number(feature.cold_s, ".1f"),
            )
        console.print(table)
    for what, why in [*missing.items(), *failures(rows, features).items()]:
        console.print(f"{what}: {why}", soft_wrap=True)
    console.print(" · ".join(machine().values()), soft_wrap=True)


def failures(rows: Sequence[Row], features: Sequence[FeatureRow]) -> dict[str, str]:
    """Return what failed, each with the reason."""
    failed = {f"{r.solver} {r.columns}×{r.rows} {r.layout}, failed": r.error for r in rows if r.error}
    return failed | {f"feature {f.change or 'curtain'}, failed": f.error for f in features if f.error}


def run_info() -> dict[str, object]:
    """Return the machine, the date (UTC) and the program's commit of a run, for its JSON file."""
    return {"machine": machine(), "date": datetime.now(UTC).date().isoformat(), "commit": commit_of()}


def write_json(path: Path, rows: Sequence[Row], features: Sequence[FeatureRow], missing: dict[str, str]) -> None:
    """Write all results as JSON. Raises OSError."""
    results: dict[str, object] = {
        **run_info(),
        "rows": [asdict(row) for row in rows],
        "features": [asdict(feature) for feature in features],
        "missing": missing,
    }
    with new_file(path) as file:
        file.write(json.dumps(results, indent=1).encode())
