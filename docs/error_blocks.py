"""Blocks of the documents about speed and error: on scenes, on the swinging curtain, on sheets and on a GPU."""

from __future__ import annotations

from math import isfinite

import stored
from goals import GOALS
from tables import Rows, machine_and_date, runs_line, table, with_runs

from taichi_cloth.evaluation.bench import gpu_report, scene_error
from taichi_cloth.evaluation.bench.bench_report import NOT_FINITE
from taichi_cloth.evaluation.bench.scene_error import SceneErrors, ScenePoint
from taichi_cloth.scene.schema import FRAME_SECONDS
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG


def scenes() -> list[SceneErrors]:
    """Return the stored errors on the shipped scenes."""
    words = stored.load("scene_errors") or {"scenes": []}
    return [SceneErrors(**{**one, "points": [ScenePoint(**p) for p in one["points"]]}) for one in words["scenes"]]


def scene_rows(solver: str) -> dict[str, Rows]:
    """Return the rows of a solver by scene: setting, frame time, RMS error, largest error and strain."""
    found = {}
    for scene in scenes():
        rows = [[setting, ms, *errors] for setting, ms, _, _, *errors, _ in scene_error.lines(scene)[1:]]
        found[scene.scene] = [row for row in rows if row[0].split()[0] == solver]
    return {scene: rows for scene, rows in found.items() if rows}


def default_row(solver: str, rows: Rows) -> list[str]:
    """Return the row of a solver's default setting, or the first row if that was not measured."""
    substeps, iterations = SOLVER_CATALOG[solver].defaults
    return next((row for row in rows if row[0] == f"{solver} {substeps}×{iterations}"), rows[0])


def seconds_of_scenes() -> dict[str, str]:
    """Return how long the errors on each scene are measured, as text."""
    return {found.scene: f"{found.horizon * FRAME_SECONDS:.2g} s" for found in scenes()}


def errors_on_scenes(name: str) -> str:
    lengths = seconds_of_scenes()
    rows = [
        [f"`{scene}`", lengths.get(scene, ""), *default_row(name, rows)] for scene, rows in scene_rows(name).items()
    ]
    if not rows:
        return "Errors on the shipped scenes: no run is stored."
    errors = table(["scene", "over the first", "setting", "ms per frame", "RMS error", "max error", "max strain"], rows)
    return f"""\
Errors on the shipped scenes relative to the float64 reference solution, in % of the cloth's longer side
([all settings](../scene_errors_rows.md)). They are measured over the first part of the motion, which the table names:
until two seconds, or until the motion is chaotic and no solution can be compared. Errors grow beyond it.

{errors}"""


def scene_summary() -> str:
    """Return the smallest measured error of each solver on each scene, and the scenes without a reference."""
    words = stored.load("scene_errors")
    if words is None:
        return "No run is stored."
    by_solver = {name: scene_rows(name) for name in SOLVER_CATALOG}
    rows = []
    for found in scenes():
        cells = []
        for name in SOLVER_CATALOG:
            points = [point for point in found.points if point.setting.split()[0] == name]
            finite = [point for point in points if isfinite(point.rms_error)]  # NaN may be the smallest for `min`
            best = min(finite, key=lambda point: point.rms_error, default=None)
            row = next((row for row in by_solver[name].get(found.scene, []) if best and row[0] == best.setting), None)
            cells.append(
                NOT_FINITE * (len(points) > 0)
                if row is None
                else f"{row[2]} ({row[0].removeprefix(name).strip()}: {row[1]}\N{NO-BREAK SPACE}ms)"
            )
        rows.append([f"`{found.scene}`", f"{found.horizon}", *cells])
    reasons = [f"- `{name}`: {reason}." for name, reason in words["left_out"].items()]
    header = ["scene", "frames", *(f"`{name}`" for name in SOLVER_CATALOG)]
    return "\n\n".join([machine_and_date(words), table(header, rows), "No reference:", "\n".join(reasons)])


SHOWN_FEATURES = 3  # in each column of `feature_costs`


def feature_costs() -> str:
    """Return the most expensive features of each scene, and those that change its motion most."""
    words = stored.load("ablation")
    if words is None:
        return "No run is stored."
    rows = []
    for scene in words["scenes"]:
        cost = {row["feature"]: row["saved_ms"] for row in scene["rows"]}  # [ms]
        change = {row["feature"]: 100 * row["change"] for row in scene["rows"]}  # [%]
        costs, changes = (sorted(found, key=lambda name: -found[name])[:SHOWN_FEATURES] for found in (cost, change))
        rows.append(
            [
                f"`{scene['scene']}`",
                f"{scene['ms']:.2f}",
                ", ".join(f"{name} {cost[name]:.2f} ms" for name in costs if cost[name] > 0),
                ", ".join(f"{name} {change[name]:.2g}%" for name in changes if change[name] > 0),
            ]
        )
    header = ["scene", "ms a frame", "cost", "change of positions, of the side"]
    return with_runs(table(header, rows), "ablate")


def solvers() -> str:
    """Return times and errors of each solver on the swinging curtain of 64 × 64 cells."""
    rows = []
    for name, what in METHODS.items():
        points = stored.errors(64, name)
        cells = [at(stored.fastest(points, 0.01)), most_accurate(points)]
        rows.append([f"[`{name}`](docs/solvers/{name}.md)", what, *cells])
    header = ["`--solver`", "method", "fastest with a max error of 1 %", "most accurate, with its max error"]
    return with_runs(table(header, rows), "bench --error")


# Descriptions in the table of the README.
METHODS = {
    "verlet": "position-based dynamics with Verlet integration, stiffness 0…1; the method of the browser demos",
    "xpbd": "extended position-based dynamics, SI constants (Macklin 2016)",
    "explicit": "explicit symplectic Verlet on spring forces; takes the substeps that stability needs",
    "lines": "XPBD with a direct solver along rows, columns and diagonals",
    "rk4": "classical Runge–Kutta method on spring forces",
    "implicit": "Newton's method with conjugate gradients (Baraff and Witkin 1998), in steps of second order",
}


def at(row: stored.Words | None) -> str:
    """Return a setting of assets/error.csv with its time."""
    return "none" if row is None else f"{stored.setting_of(row)}: {stored.milliseconds(row['median_ms'])}"


def most_accurate(rows: list[stored.Words]) -> str:
    """Return the most accurate of some settings of assets/error.csv, with its time and largest error."""
    best = stored.most_accurate(rows)
    return "none" if best is None else f"{at(best)}, {stored.per_cent(best['max_error'])}"


def goals() -> str:
    timed = [*(stored.load("bench") or {"rows": []})["rows"], *(stored.load("goals") or {"sheets": []})["sheets"]]
    found = table(["goal", "good", "excellent", "measured", "result"], [goal.cells() for goal in GOALS])
    return with_runs(stored.disturbed(timed) + found, "bench", "bench --goals", "bench --error", "bench --gpu")


BENCH_COLUMNS = {
    "median_ms": ("ms", ".2f"),
    "p95_ms": ("p95", ".2f"),
    "ratio_to_c": ("÷ C", ".1f"),
    "speedup_over_javascript": ("JS ÷", ".1f"),
    "cold_s": ("cold s", ".1f"),
    "warm_s": ("warm s", ".1f"),
    "peak_mb": ("MB", ".0f"),
    "max_strain": ("strain", ".1%"),
    "frame_error_mm": ("error mm", ".2g"),
}


def frames() -> str:
    """Return the table of the rows of `bench`."""
    words = stored.load("bench")
    if words is None:
        return "No run is stored."
    rows = []
    for row in words["rows"]:
        setting = f"{row['substeps']}×{row['iterations']}"
        error = row.get("frame_error")  # a run before it was measured has none
        row = row | {"frame_error_mm": error and 1e3 * error}
        figures = ["" if row[name] is None else f"{row[name]:{form}}" for name, (_, form) in BENCH_COLUMNS.items()]
        rows.append(
            [row["scene"], f"`{row['solver']}`", row["layout"], f"{row['columns']}×{row['rows']}", setting, *figures]
        )
    header = ["scene", "solver", "layout", "grid", "n×m", *(title for title, _ in BENCH_COLUMNS.values())]
    return f"{machine_and_date(words)}\n\n{stored.disturbed(words['rows'])}{table(header, rows)}"


def sheets() -> str:
    """Return the table of the sheets of `bench --goals`."""
    words = stored.load("goals")
    if words is None:
        return "No run is stored."
    rows = []
    for row in words["sheets"]:
        errors = [
            f"{row['rms_error']:.3%}",
            f"{row['max_error']:.2%}",
            f"{row['uncertainty']:.3%}",
            f"{row['max_strain']:.1%}",
        ]
        rows.append([row["name"], f"`{row['method']}`", f"{row['frames']}", f"{row['median_ms']:.1f}", *errors])
    header = ["sheet", "method", "frames", "ms", "RMS error", "max error", "uncertainty", "max strain"]
    return f"{machine_and_date(words)}\n\n{stored.disturbed(words['sheets'])}{table(header, rows)}"


NO_GPU = "Not measured: no GPU was available, only Mesa's software Vulkan."


def gpu() -> str:
    """Return the tables of `bench --gpu`: motion, frames of the default settings, and real time."""
    run = stored.gpu()
    if run is None:
        return NO_GPU
    motion = table(
        ["scene", *(f"`{name}`" for name in SOLVER_CATALOG)],
        [[scene, *(same_motion(run, scene, name) for name in SOLVER_CATALOG)] for scene in scenes_of(run)],
    )
    defaults = [gpu_report.cells(row) for row in run.rows if row.is_default]
    frames = table([*gpu_report.HEADINGS, *gpu_report.MORE], [[f"`{row[0]}`", *row[1:]] for row in defaults])
    copied = "was not measured" if run.bandwidth is None else f"reads and writes {run.bandwidth / 1e9:,.0f} GB/s"
    bound = f"{1e3 * gpu_report.SAME_MOTION:g}\N{NO-BREAK SPACE}mm"
    return "\n\n".join(
        [
            f"Largest difference of a particle from the CPU after a few frames, passed up to {bound}:",
            motion,
            f"Frames of the swinging curtain with the default settings; a copy {copied}:",
            frames,
            gpu_report.LEGEND.replace("\n", " ") + ".",
            "The fastest setting of each grid that runs in real time with a largest error of 1 %:",
            real_time(run),
            runs_line("bench --gpu"),
        ]
    )


def scenes_of(run: gpu_report.GpuRun) -> list[str]:
    return list(dict.fromkeys(row.scene for row in run.comparisons))


def same_motion(run: gpu_report.GpuRun, scene: str, solver: str) -> str:
    """Return the difference between CPU and GPU, with the verdict if it is not passed."""
    for row in run.comparisons:
        if (row.scene, row.solver) == (scene, solver):
            found = "" if row.max_meters is None else f"{1e3 * row.max_meters:.2g}\N{NO-BREAK SPACE}mm"
            return ", ".join(filter(None, [found, "" if row.verdict == "pass" else row.verdict]))
    return "not measured"


def real_time(run: gpu_report.GpuRun) -> str:
    rows = []
    for cells in dict.fromkeys(row.cells for row in run.rows):
        best = gpu_report.largest_real_time([row for row in run.rows if row.cells == cells])
        if best is None:
            rows.append([f"{cells}×{cells}", "none", "", ""])
        else:
            ms, error = stored.milliseconds(best.median_ms), stored.per_cent(best.max_error)
            rows.append([f"{cells}×{cells}", f"`{best.solver}` {best.setting}", ms, error])
    return table(["cells", "setting", "ms", "max error"], rows)


def elbow() -> str:
    """Return the fastest settings for three errors of the swinging curtain, on two grids."""
    rows = []
    for cells in (64, 256):
        for name in SOLVER_CATALOG:
            points = stored.errors(cells, name)
            if points:
                found = [at(stored.fastest(points, error)) for error in (1e-2, 1e-3, 1e-5)]
                rows.append([f"{cells}×{cells}", f"`{name}`", *found, most_accurate(points)])
    header = ["cells", "solver", "1 %", "0.1 %", "0.001 %", "most accurate, with its max error"]
    return with_runs(table(header, rows), "bench --error")


BLOCKS = (solvers, scene_summary, feature_costs, goals, frames, sheets, elbow, gpu)
