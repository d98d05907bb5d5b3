"""The points as a table, as CSV, as JSON and as pictures; and which settings are worth their time."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from ..bench.cases import BUDGETS
from ..bench.report import machine, made, wide_console
from ..errors import WrongUse
from ..files import whole_file
from .sweep import Point, knee, pareto

HEADINGS = ("setting", "cells", "ms", "p95", "error rms", "largest", "stretch", "strain", "5 Hz kept", "")
LEGEND = (
    "Swinging curtain: pinned along its top, let go at 45°, one second. Error: distance of the particles from the\n"
    "converged motion, of the side · stretch: how much longer a column ends than it should · 5 Hz kept: of the\n"
    "amplitude of such a spring after a second · ← nothing is both faster and nearer"
)


def grids(points: Sequence[Point]) -> dict[int, list[Point]]:
    found: dict[int, list[Point]] = {}
    for point in points:
        found.setdefault(point.cells, []).append(point)
    return found


def words(points: Sequence[Point]) -> list[str]:
    """For each grid the best setting within each budget of time, and the knee."""
    lines = []
    for cells, some in grids(points).items():
        front = pareto(some)
        best = knee(front)
        lines.append(
            f"{cells} cells: {best.setting} is the knee, {best.median_ms:.2f} ms and {best.max_error:.2g} of the side"
        )
        for rate in BUDGETS:
            fit = [point for point in front if point.p95_ms <= 1000 / rate]
            if fit:
                lines.append(f"  at {rate} pictures a second the nearest is {fit[-1].setting}: {fit[-1].max_error:.2g}")
    return lines


def print_report(points: Sequence[Point]) -> None:
    console = wide_console()
    table = Table(*HEADINGS, box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
    for column in table.columns[1:-1]:
        column.justify = "right"
    for some in grids(points).values():
        front = pareto(some)
        for p in some:
            numbers = (f"{p.rms_error:.1e}", f"{p.max_error:.1e}", f"{p.stretch:+.2%}", f"{p.max_strain:.2%}")
            kept = "-" if p.kept is None else f"{p.kept:.4f}"
            mark = "←" if p in front else ""
            table.add_row(p.setting, str(p.cells), f"{p.median_ms:.3f}", f"{p.p95_ms:.3f}", *numbers, kept, mark)
    console.print(table)
    for line in (LEGEND, *words(points), " · ".join(machine().values())):
        console.print(line, soft_wrap=True)


def write_json(path: Path, points: Sequence[Point]) -> None:
    """All there is. Raises OSError."""
    everything = {**made(), "points": [asdict(point) for point in points], "words": words(points)}
    with whole_file(path) as file:
        file.write(json.dumps(everything, indent=1).encode())


def plotting() -> Any:
    """matplotlib, without a screen. Raises WrongUse where it is not installed."""
    try:
        import matplotlib
    except ImportError:
        raise WrongUse("--plot needs matplotlib: pip install 'taichi-cloth[plot]'") from None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def plot(folder: Path, points: Sequence[Point]) -> list[Path]:
    """One picture for each grid: error against time, both by their logarithm. Raises OSError."""
    pyplot = plotting()
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for cells, some in grids(points).items():
        figure, axes = pyplot.subplots(figsize=(8, 5), dpi=120)
        for solver in dict.fromkeys(point.solver for point in some):
            own = sorted((p for p in some if p.solver == solver), key=lambda p: p.median_ms)
            axes.plot([p.median_ms for p in own], [p.max_error for p in own], "o", label=solver)
        front = pareto(some)
        axes.plot([p.median_ms for p in front], [p.max_error for p in front], "-", color="0.6", zorder=0, label="front")
        for number, point in enumerate(front):  # above and below in turn: neighbours would write over each other
            away, side = (((5, 5), "left"), ((-5, -12), "right"))[number % 2]
            place = (point.median_ms, point.max_error)
            axes.annotate(point.setting, place, away, textcoords="offset points", ha=side, fontsize=8)
        for rate in BUDGETS:
            axes.axvline(1000 / rate, color="0.8", linestyle=":", zorder=0)
            axes.text(1000 / rate, 0.98, f" {rate}/s", transform=axes.get_xaxis_transform(), va="top", fontsize=8)
        axes.set(xscale="log", yscale="log", xlabel="milliseconds a frame", ylabel="largest error, of the side")
        axes.set_title(f"Swinging curtain, {cells} × {cells} cells, one second")
        axes.legend()
        figure.tight_layout()
        path = folder / f"error_{cells}.png"
        with whole_file(path) as file:
            figure.savefig(file, format="png", metadata={"Software": None})
        pyplot.close(figure)
        paths.append(path)
    return paths
