"""The speed goals of the project, and the stored results to compare with; `generate.py` writes the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import stored

from taichi_cloth.evaluation.bench.gpu_report import largest_real_time
from taichi_cloth.evaluation.stress.case_catalog import CASES


@dataclass(frozen=True)
class Missed:
    """Why a goal is not reached at any speed, or why there is no result."""

    why: str
    verdict: str = "not measured"


NOT_STORED = Missed("no run is stored")


@dataclass(frozen=True)
class Goal:
    what: str
    unit: str
    good: float
    excellent: float
    figure: Callable[[], float | Missed]
    more_is_better: bool = False

    def cells(self) -> list[str]:
        sign = "≥" if self.more_is_better else "≤"
        bounds = [f"{sign} {bound:,g}\N{NO-BREAK SPACE}{self.unit}" for bound in (self.good, self.excellent)]
        figure = self.figure()
        if isinstance(figure, Missed):
            return [self.what, *bounds, figure.why, figure.verdict]
        return [self.what, *bounds, f"{figure:.3g}\N{NO-BREAK SPACE}{self.unit}".strip(), verdict(self, figure)]


def verdict(goal: Goal, figure: float) -> str:
    """Return the level that a figure reaches, and the factor by which it misses the next."""

    def off(bound: float) -> float:
        return bound / figure if goal.more_is_better else figure / bound

    if off(goal.excellent) <= 1:
        return "excellent"
    if off(goal.good) <= 1:
        return f"good; {off(goal.excellent):.3g} times off excellent"
    return f"**missed** by {off(goal.good):.3g} times"


def too_large(factor: float) -> str:
    """Return the verdict on the closest setting, whose error is larger than the goal by a factor."""
    return f"**missed**: error {factor:.3g} times too large"


def bench(solver: str, grid: tuple[int, int], column: str) -> Callable[[], float | Missed]:
    def figure() -> float | Missed:
        row = stored.bench_row(solver, grid)
        if row is None:
            return NOT_STORED
        return NOT_STORED if row[column] is None else float(row[column])

    return figure


def curtain(cells: int, error: float) -> Callable[[], float | Missed]:
    """Return the frame time [ms] of the fastest setting on the swinging curtain with at most this largest error."""

    def figure() -> float | Missed:
        rows = stored.errors(cells)
        found = stored.fastest(rows, error)
        if found is not None:
            return float(found["median_ms"])
        best = min(rows, key=lambda row: float(row["max_error"]))
        setting = f"`{best['solver']}` {stored.setting_of(best)}"
        nearest, ms = stored.per_cent(best["max_error"]), stored.milliseconds(best["median_ms"])
        return Missed(f"none; {setting} is closest: {nearest} in {ms}", too_large(float(best["max_error"]) / error))

    return figure


def sheet(name: str, error: float) -> Callable[[], float | Missed]:
    """Return the frame time [ms] of a sheet of `bench --goals`.

    Its error and the uncertainty of the reference together must be at most `error`.
    """

    def figure() -> float | Missed:
        row = stored.goal_figure("sheets", "name", name)
        if row is None:
            return NOT_STORED
        most = row["rms_error"] + row["uncertainty"]
        if most > error:
            return Missed(
                f"{stored.per_cent(most)} in {stored.milliseconds(row['median_ms'])}", too_large(most / error)
            )
        return float(row["median_ms"])

    return figure


def command(what: str, column: str = "seconds") -> Callable[[], float | Missed]:
    def figure() -> float | Missed:
        row = stored.goal_figure("commands", "what", what)
        return NOT_STORED if row is None or row[column] is None else float(row[column])

    return figure


def growth() -> float | Missed:
    """Return the cost of `explicit` per particle and substep on 256 × 256 cells, over that on 64 × 64."""

    def cost(cells: int) -> float:
        least = min(stored.errors(cells, "explicit"), key=lambda row: float(row["substeps"]))
        return float(least["median_ms"]) / (float(least["substeps"]) * (cells + 1) ** 2)

    return cost(256) / cost(64)


def gpu() -> float | Missed:
    """Return the particles [thousand] of the largest curtain that a GPU runs in real time within 1 %."""
    run = stored.gpu()
    if run is None:
        return Missed("no GPU was available")
    best = largest_real_time(run.rows)
    if best is None or best.particles is None:
        return Missed(f"none on {run.device}", "**missed**")
    return best.particles / 1e3


def alive() -> float | Missed:
    """Return the largest number of hard cases that one of the settings survives that ran all of them."""
    words = stored.load("stability")
    if words is None:
        return NOT_STORED
    complete = [states for states in stored.survival(words).values() if states.total() == len(CASES)]
    return float(max(states[stored.ALIVE] for states in complete)) if complete else NOT_STORED


DEMO_GRID = (30, 24)  # columns and rows of the browser demos
GOALS = (
    Goal("demo frame, 30×24, 5×12, over C", "times", 4, 1.5, bench("verlet", DEMO_GRID, "ratio_to_c")),
    Goal(
        "demo frame, JavaScript over ours",
        "times",
        2.5,
        6,
        bench("verlet", DEMO_GRID, "speedup_over_javascript"),
        more_is_better=True,
    ),
    Goal("explicit step, 30×24, over C", "times", 3, 1.2, bench("explicit", DEMO_GRID, "ratio_to_c")),
    Goal("explicit step, 96×96, over C", "times", 3, 1.2, bench("explicit", (96, 96), "ratio_to_c")),
    Goal("swinging curtain, 64×64 cells, within 0.001 %", "ms", 6, 1.5, curtain(64, 1e-5)),
    Goal("swinging curtain, 128×128, within 0.001 %", "ms", 33, 9, curtain(128, 1e-5)),
    Goal("swinging curtain, 256×256, within 0.01 %", "ms", 150, 33, curtain(256, 1e-4)),
    Goal("swinging curtain, 64×64, within 0.1 %", "ms", 4, 4, curtain(64, 1e-3)),
    Goal("swinging curtain, 128×128, within 1 %", "ms", 16.7, 16.7, curtain(128, 1e-2)),
    Goal("hard cases alive with one setting", "cases", 40, 40, alive, more_is_better=True),
    Goal("whole fabric, wind, sphere, 128×128, within 0.1 %", "ms", 33, 16.7, sheet("whole fabric 128", 1e-3)),
    Goal("denim, 64×64, within 0.1 %", "ms", 25, 8, sheet("denim 64", 1e-3)),
    Goal("pinned fabric, `lines` and tethers, 128×128, within 0.5 %", "ms", 8, 3.4, sheet("pinned fabric 128", 5e-3)),
    Goal("pinned fabric, `lines` and tethers, 256×256, within 0.5 %", "ms", 60, 27, sheet("pinned fabric 256", 5e-3)),
    Goal("substep per particle, 256×256 over 64×64", "times", 1.5, 1.05, growth),
    Goal("`render`, first frame, kernel cache filled", "s", 3, 1.5, command("first frame, cache filled")),
    Goal("`render`, first frame, kernel cache empty", "s", 10, 5, command("first frame, cache empty")),
    Goal("`import taichi_cloth`", "s", 0.15, 0.08, command("import taichi_cloth")),
    Goal("`taichi-cloth --help`", "s", 0.15, 0.08, command("taichi-cloth --help")),
    Goal("memory of `render`, 30×24", "MB", 400, 250, command("first frame, cache filled", "peak_mb")),
    Goal("particles in real time on a GPU, within 1 %", "thousand", 66, 1049, gpu, more_is_better=True),
)
