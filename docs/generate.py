"""Write the generated blocks of the documents: `python docs/generate.py`, which `make docs` runs first.

The function NAME below returns the text between `<!-- generated: NAME -->` and `<!-- end -->`. Its sources are the
program, the fabric presets, and stored results (`stored.py`). `tests/test_documents.py` checks that all blocks are up
to date.
"""

from __future__ import annotations

import csv
import inspect
import re
import runpy
import sys
import textwrap
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # tests load this file by its path

import stored
from goals import GOALS

import taichi_cloth as tc
from taichi_cloth.evaluation.bench import gpu_report, scene_error
from taichi_cloth.evaluation.bench.bench_report import NOT_FINITE
from taichi_cloth.evaluation.bench.scene_error import SceneErrors, ScenePoint
from taichi_cloth.evaluation.stress.setup import ROBUST
from taichi_cloth.geometry.topology import Topology
from taichi_cloth.kernels.step_params import MAX_GRABS
from taichi_cloth.scene import key_table, schema
from taichi_cloth.scene.keys import KEYS_TITLE, keys_of
from taichi_cloth.scene.presets import load_preset
from taichi_cloth.scene.schema import PRESET_NAMES
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.viewer import input as controls

DOCS = Path(__file__).parent
BLOCK = re.compile(r"(<!-- generated: ([a-z_]+)(?: ([a-z0-9_-]+))? -->\n).*?(<!-- end -->)", re.DOTALL)

Rows = list[list[str]]


def table(header: list[str], rows: Rows) -> str:
    lines = [header, ["---"] * len(header), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


# -- errors on scenes --------------------------------------------------------------------------------------------------


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


# -- machine and date of stored results --------------------------------------------------------------------------------


NO_DATE = "date not stored"
NO_COMMIT = "commit not stored"


def machine_and_date(words: stored.Words) -> str:
    """Return the machine, the versions, the date and the commit of a run as one line."""
    parts = stored.machine_of(words), words.get("date") or NO_DATE, short_commit(words)
    return " · ".join(parts)


def short_commit(words: stored.Words) -> str:
    """Return the first digits of a run's commit, with a + if files had changed since."""
    commit = words.get("commit")
    return f"commit {commit[:8]}" + "+" * commit.endswith("+") if commit else NO_COMMIT


def machines_and_dates(words: stored.Words) -> str:
    """Return the machines and the dates of a run that was continued: each of its results has its own."""
    machines = dict.fromkeys(row["machine"] for row in words["results"] if row.get("machine"))
    days = sorted({row["date"][:10] for row in words["results"] if row.get("date")})
    names = " and ".join(machines or [stored.machine_of(words)])
    dates = " to ".join(dict.fromkeys((days[0], days[-1]))) if days else NO_DATE
    count = words.get("older")
    older = f" ({count} of {len(words['results'])} results are of an older version)" if count else ""
    return f"{names} · {dates}{older}"


def machine_and_date_of_curtain() -> str:
    """Return the machine and date of assets/error.csv, from the JSON that was written with it.

    The CSV contains only the measurements. The JSON belongs to it if all its times are equal.
    """
    words = stored.load("error")
    with stored.ERRORS.open(encoding="utf-8", newline="") as file:
        times = [float(row["median_ms"]) for row in csv.DictReader(file)]
    if words is None or [point["median_ms"] for point in words["points"]] != times:
        return "machine and date not stored in assets/error.csv"
    return machine_and_date(words)


def gpu_and_date(words: stored.Words) -> str:
    """Return the GPU, and the machine and the date of a run on it."""
    return f"{words['device']} ({words['arch']}) · {machine_and_date(words)}"


# For each command: the name of its stored file, and the function that returns the machine and date of that file.
RUNS: dict[str, tuple[str, Callable[[stored.Words], str]]] = {
    "bench": ("bench", machine_and_date),
    "bench --goals": ("goals", machine_and_date),
    "bench --gpu": ("gpu", gpu_and_date),
    "bench --error --scene": ("scene_errors", machine_and_date),
    "validate": ("validation", machine_and_date),
    "ablate": ("ablation", machine_and_date),
    "stress": ("stability", machines_and_dates),
}


def runs_line(*commands: str) -> str:
    """Return the machines and dates of the stored runs of these commands, as one paragraph."""
    found = []
    for command in commands:
        if command == "bench --error":
            found.append(f"`{command}`: {machine_and_date_of_curtain()}")
            continue
        name, describe = RUNS[command]
        words = stored.load(name)
        if words is not None:
            found.append(f"`{command}`: {describe(words)}")
    return f"Runs: {'; '.join(found)}." if found else ""


def with_runs(text: str, *commands: str) -> str:
    """Return a block with the machines and dates of its results below it."""
    return "\n\n".join(filter(None, (text, runs_line(*commands))))


# -- the blocks --------------------------------------------------------------------------------------------------------


def choosing() -> str:
    shown = ("curtain", "table", "denim")
    rows = []
    for solver in SOLVER_CATALOG:
        measured = scene_rows(solver)
        cells = [error_at_default(solver, measured[scene]) if scene in measured else "" for scene in shown]
        rows.append([f"[`{solver}`](solvers/{solver}.md)", *cells, falls_short(solver), survives(solver)])
    found = table(
        ["solver", *(f"`{scene}`" for scene in shown), "references not reached", "stress cases survived"], rows
    )
    robust = f"Stress cases survived with the recommended setting `{ROBUST.name}`: {survives(ROBUST.name)}."
    return with_runs(f"{found}\n\n{robust}", "bench --error --scene", "validate", "stress")


def error_at_default(solver: str, rows: Rows) -> str:
    setting, ms, error, *_ = default_row(solver, rows)
    return f"{setting.removeprefix(solver).strip()}: {ms}\N{NO-BREAK SPACE}ms, {error}"


# References to compare the default setting of each solver with.
ALWAYS_SHOWN = ("A3.1", "A2.5")  # sheets in equilibrium under their weight
SHOWN_IF_MISSED = ("A5.1", "A6.2")


def unconverged() -> str:
    return "\n".join(f"- [`{name}`](solvers/{name}.md): {distance(name)}" for name in SOLVER_CATALOG)


def distance(solver: str) -> str:
    """Return the error of a solver's default setting as a sentence: the worst row of each of these references."""
    words = stored.load("validation")
    if words is None:
        return "difference of the default setting from exact values: no run is stored."
    parts = []
    for number in (*ALWAYS_SHOWN, *SHOWN_IF_MISSED):
        rows = [row for row in words["rows"] if (row["reference"], row["solver"]) == (number, solver)]
        if rows and (number in ALWAYS_SHOWN or any(row["verdict"] not in stored.PASSED for row in rows)):
            parts.append(worst_row(rows))
    info = SOLVER_CATALOG[solver]
    setting = stored.setting_of({"solver": solver, "substeps": info.substeps, "iterations": info.iterations})
    more = ", or as many substeps as stability needs" if info.is_explicit else ""
    heading = f"with its default setting ({setting}{more}) it differs from exact values by"
    return f"{heading} {'; '.join(parts)}." if parts else f"{heading} nothing that these references measure."


def worst_row(rows: list[stored.Words]) -> str:
    """Return the row of a reference with the largest relative error, and the number of rows without a result."""
    measured = [(row["measured"] / row["exact"] - 1, row) for row in rows if row["measured"] is not None]
    title = f"{rows[0]['reference']} {rows[0]['name']}"
    parts = [title]
    if measured:
        share, row = max(measured, key=lambda one: abs(one[0]))
        passed = "" if row["verdict"] in stored.PASSED else ", falls short"
        what = re.sub(r" ?\[[^]]*\]$", "", row["what"])  # without its unit
        parts = [f"{signed(share)} in {title} (*{what}*{passed})"]
    if slow := len(rows) - len(measured):
        parts.append(f"{slow} of {len(rows)} rows too slow to be measured")
    return ", ".join(parts)


def signed(share: float) -> str:
    return ("−" if share < 0 else "+") + stored.per_cent(abs(share))


def bar_friction() -> str:
    """Return the solvers whose friction on a bar is too weak: ends slip at a smaller ratio than by the capstan law."""
    words = stored.load("validation")
    if words is None:
        return "Friction around a bar: no run is stored."
    rows = [row for row in words["rows"] if row["reference"] == "A7.4"]
    parts = []
    for name in dict.fromkeys(row["solver"] for row in rows):
        own = [row for row in rows if row["solver"] == name]
        missed = [row for row in own if row["verdict"] not in stored.PASSED and row["measured"] is not None]
        weaker = [share for row in missed if (share := row["measured"] / row["exact"] - 1) < 0]
        if weaker:
            parts.append(f"`{name}` in {len(weaker)} of {len(own)} rows, by up to {signed(min(weaker))}")
    return f"Too weak: {'; '.join(parts) or 'none'}."


def falls_short(solver: str) -> str:
    words = stored.load("validation")
    if words is None:
        return "no run is stored"
    short, count = stored.shortfalls(words, solver)
    return f"{len(short)} of {count}"


def survives(setting: str) -> str:
    words = stored.load("stability")
    found = stored.survival(words).get(setting) if words is not None else None
    if found is None:
        return "no run is stored"
    ran = found.total() - found[stored.NOT_RUN]
    text = f"{found[stored.ALIVE]} of {ran}" if ran else "not run"
    return f"{text}, {found[stored.NOT_RUN]} not run" if ran and found[stored.NOT_RUN] else text


def solver(name: str) -> str:
    """Return the errors on scenes, the errors of the default setting, and missed references and stress cases."""
    errors = with_runs(errors_on_scenes(name), "bench --error --scene", "validate", "stress")
    return "\n\n".join([errors, f"Convergence: {distance(name)}", references(name), hard_cases(name)])


def errors_on_scenes(name: str) -> str:
    rows = [[f"`{scene}`", *default_row(name, rows)] for scene, rows in scene_rows(name).items()]
    if not rows:
        return "Errors on the shipped scenes: no run is stored."
    errors = table(["scene", "setting", "ms per frame", "RMS error", "max error", "max strain"], rows)
    return f"""\
Errors on the shipped scenes relative to the float64 reference solution, in % of the cloth's longer side
([all settings](../scene_errors_rows.md)):

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


def references(name: str) -> str:
    """Return the references with known solutions that a solver does not reach, and its largest errors."""
    words = stored.load("validation")
    if words is None:
        return "References with known solutions: no run is stored."
    short, count = stored.shortfalls(words, name)
    heading = (
        "References with known solutions ([validation](../validation.md)) of which rows fall short or are too slow to"
        " be measured"
    )
    if not short:
        return f"{heading}: none of {count}."
    rows = [
        [what, f"{missed} of {rows}", f"{slow} of {rows}", "-" if worst is None else f"{worst:.2g}"]
        for what, missed, slow, rows, worst in short
    ]
    columns = ["reference", "rows that fall short", "rows too slow to be measured", "largest measured error"]
    return f"{heading}: {len(short)} of {count}. The error of a row is in its unit.\n\n" + table(columns, rows)


def hard_cases(setting: str) -> str:
    """Return the stress cases that a setting does not survive, with the first violated limit of each."""
    words = stored.load("stability")
    found = [case for case in stored.hard_cases(words) if case.setting == setting] if words is not None else []
    if not found:
        return "Cases that break cloth: no run is stored."
    lines = [f"Cases that break cloth ([stability](../stability.md)) and that it survives: {survives(setting)}."]
    for case in found:
        if case.state == stored.FAILED:
            violated = case.failures[0]["failure"]
            variants = ", ".join(row["variant"] for row in case.failures)
            bounds = f"{violated['what']} {violated['value']:.4g}, bound {violated['bound']:.4g}"
            lines.append(f"- {case.number} {case.name} fails ({variants}): {bounds}")
        elif case.state == stored.SLOW:
            lines.append(f"- {case.number} {case.name}: {case.state}")
    return lines[0] + "\n\n" + "\n".join(lines[1:]) if len(lines) > 1 else lines[0]


def nobody() -> str:
    """Return the stress cases that no solver survives at its default setting, among those that all solvers have run."""
    words = stored.load("stability")
    if words is None:
        return "No run is stored."
    cases: dict[str, list[str]] = {}
    for case in stored.hard_cases(words):
        if case.setting in SOLVER_CATALOG:
            cases.setdefault(f"{case.number} {case.name}", []).append(case.state)
    known = {name: states for name, states in cases.items() if stored.ALIVE in states or stored.NOT_RUN not in states}
    lost = [f"- {name}" for name, states in known.items() if stored.ALIVE not in states]
    if missing := len(cases) - len(known):
        lost.append(f"- Not known of {missing} cases: no solver that ran them survives them, and not all have.")
    return "\n".join(lost) or "None."


def stability_summary() -> str:
    words = stored.load("stability")
    if words is None:
        return "Hard cases: no run is stored."
    found = stored.survival(words)
    states = [stored.ALIVE, stored.FAILED, stored.SLOW, stored.NOT_RUN]
    order = sorted(found, key=lambda name: not name.startswith("robust"))
    rows = [[f"`{name}`", *(f"{found[name][state]}" for state in states)] for name in order]
    return with_runs(table(["setting", *states], rows), "stress")


def validation_summary() -> str:
    words = stored.load("validation")
    if words is None:
        return "References with known solutions: no run is stored."
    rows = []
    for name, found in stored.verdicts(words).items():
        passed = sum(found[verdict] for verdict in stored.PASSED)
        shares = [f"{passed / found.total():.1%}", f"{found['excellent'] / found.total():.1%}"]
        rows.append([name if name == "all" else f"`{name}`", f"{found.total()}", *shares])
    return with_runs(table(["solver", "rows", "pass", "excellent"], rows), "validate")


PLURALS = {"falls short": "fall short", "pass": "more pass"}  # "pass" does not count excellent rows


def validation_line() -> str:
    words = stored.load("validation")
    if words is None:
        return "No run is stored."
    found = stored.verdicts(words)["all"]
    passed = sum(found[verdict] for verdict in stored.PASSED)
    shares = f"{passed / found.total():.1%} pass, {found['excellent'] / found.total():.1%} are excellent"
    states = ", ".join(
        f"{count} {verdict if count == 1 else PLURALS.get(verdict, verdict)}" for verdict, count in found.most_common()
    )
    return with_runs(f"{found.total()} rows: {shares} ({states}).\n{unfinished(words)}".strip(), "validate")


def unfinished(words: stored.Words) -> str:
    """Return which default settings leave a hanging sheet or a taut square too soft, and by how much."""
    parts = []
    for solver in SOLVER_CATALOG:
        worst = []
        for number in ALWAYS_SHOWN:
            rows = [row for row in words["rows"] if (row["reference"], row["solver"]) == (number, solver)]
            missed = [row for row in rows if row["verdict"] not in stored.PASSED and row["measured"] is not None]
            shares = [row["measured"] / row["exact"] - 1 for row in missed]
            worst += [f"{signed(max(shares))} in {number}"] if max(shares, default=0.0) > 0 else []
        parts += [f"`{solver}` ({', '.join(worst)})"] if worst else []
    return f"Defaults that leave fine grids too soft: {', '.join(parts)}." if parts else ""


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


def keys() -> str:
    blocks = []
    docs = {"": "These keys come before all sections."}
    sliders: dict[tuple[str, str], str] = {}
    for part in schema.sections().values():
        name = f"[[{part.name}]]" if part.is_array else f"[{part.name}]"
        docs[name] = described(part.cls)
        sliders |= {
            (name, key): "{:g} to {:g}".format(*about.slider)
            for key, about in keys_of(part.cls).items()
            if about.slider
        }
    for section in dict.fromkeys(row[0] for row in key_table()):
        title = f"## {section}" if section else "## Top level"
        rows = [
            [f"`{key}`", f"`{default}`", unit, bounds.removesuffix(f" {unit}"), sliders.get((at, key), ""), text]
            for at, key, default, unit, bounds, text in key_table()
            if at == section
        ]
        blocks.append(
            f"{title}\n\n{docs[section]}\n\n" + table(["key", "default", "unit", "range", "slider", "meaning"], rows)
        )
    return "\n\n".join(blocks)


UNITS = {"area_density": "kg/m²", "warp": "N/m", "weft": "N/m", "bias": "N/m", "bending": "N·m", "damping": "s"}


def presets() -> str:
    header = ["preset", "fabric", *(f"{name.replace('_', ' ')} [{unit}]" for name, unit in UNITS.items())]
    fabrics = [load_preset(name) for name in PRESET_NAMES]
    rows = [[f"[`{f.name}`](#{f.name})", f.title, *(f"{getattr(f, name):g}" for name in UNITS)] for f in fabrics]
    return table(header, rows)


def sources() -> str:
    blocks = []
    for fabric in map(load_preset, PRESET_NAMES):
        shares = f"structural {fabric.structural:g}, shear {fabric.shear:g}, bend {fabric.bend:g}"
        rows = [
            [name.replace("_", " "), f"{getattr(fabric, name):g} {unit}", fabric.sources[name]]
            for name, unit in UNITS.items()
        ]
        rows.append(["stiffness for `verlet`", shares, fabric.sources["verlet"]])
        blocks.append(f"### {fabric.name}\n\n{fabric.title}.\n\n" + table(["property", "value", "source"], rows))
    return "\n\n".join(blocks)


def parameters() -> str:
    strips = runpy.run_path(str(DOCS.parent / "screenshots" / "parameters.py"))["STRIPS"]
    blocks = []
    for strip in strips:
        says = strip.says[0].upper() + strip.says[1:]
        values = " · ".join(strip.panels)
        title = strip.name.replace("_", " ").capitalize()
        picture = f"![{strip.name}: {values}](pictures/parameters/{strip.name}.png)"
        caption = f"Scene `{strip.scene}` after {strip.frame} frames."
        blocks.append(f"## {title}\n\n{says}.\n\n{picture}\n\n**{values}** · {caption}")
    return "\n\n".join(blocks)


# Public members of `Simulation` by subject.
SIMULATION_MEMBERS = {
    "Time": ("step", "step_by_substep", "reset", "seconds", "substeps", "min_stable_substeps", "close", "closed"),
    "State": ("positions", "velocities", "triangles", "set_state", "save", "load", "torn", "untear"),
    "Export": ("export", "export_clip"),
    "Metrics": ("metrics", "frame_error", "intersections", "colliders", "features", "method", "warnings"),
    "Forces": ("forces", "reaction_forces"),
    "Grabs and pins": ("grab", "grab_handles", "grabbed", "pin", "unpin", "added_pins"),
    "Changes": ("switch_solver", "switch_fabric", "switch_scene", "apply"),
    "Internals": ("solver", "cloth"),
}
SIMULATION_ATTRIBUTES = {
    "params": "runtime parameters by name, and the switch `wind`: `params[name]` reads one, `params[name] = value` sets"
    " it for the next frame, `params.info(name)` has its range, unit and help",
    "frame": "number of the current frame; 0 at the start and after `reset`",
    "penetration_free_since": "with `self_collision.penetration_free`, the first frame from which no part of the cloth"
    " passes through another; None without it, and while there are intersections",
    "scene": "the running `Scene`",
    "original_scene": "the `Scene` that the simulation was opened with",
    "topology": "the [particles, springs and triangles](#simulationtopology), without those that tore",
    "listeners": "functions that are called with every `Event`, after it was carried out",
}


def bindings() -> str:
    """Return the table of mouse and keys."""
    return "\n".join(controls.table())


def api() -> str:
    """Return every public name with its signature and docstring."""
    functions = ("init", "list_scenes", "load_scene", "render_image", "export_mesh", "replay")
    blocks = [entry("###", f"tc.{name}", getattr(tc, name)) for name in functions]
    blocks += [
        f"### tc.Simulation\n\n{described(tc.Simulation)}\n\n{signature('tc.Simulation', tc.Simulation)}",
        described(tc.Simulation.__init__),
        table(["attribute", "meaning"], [[f"`{name}`", what] for name, what in SIMULATION_ATTRIBUTES.items()]),
    ]
    for subject, names in SIMULATION_MEMBERS.items():
        blocks.append(f"**{subject}**")
        blocks += [entry("####", f"simulation.{name}", getattr(tc.Simulation, name)) for name in names]
    blocks.append(f"### tc.GrabHandle\n\nThe result of `simulation.grab`. There are at most {MAX_GRABS} at a time.")
    blocks += members("grab", tc.GrabHandle)
    blocks.append(f"### tc.ClothMetrics\n\nThe result of `simulation.metrics`.\n\n{fields_of(tc.ClothMetrics)}")
    remaining = (
        "N particles, E springs and T triangles. Springs and triangles that tore are missing; particles are all there."
    )
    blocks.append(f"### simulation.topology\n\n{remaining}\n\n{fields_of(Topology)}")
    measured = (
        "What `simulation.frame_error` is after `simulation.step(measure_error=True)` ([explained](frame_error.md))."
    )
    blocks.append(f"### tc.FrameError\n\n{measured}\n\n{fields_of(tc.FrameError)}")
    colliders = "One of the list that `simulation.colliders` returns."
    blocks.append(f"### tc.PosedCollider\n\n{colliders}\n\n{fields_of(tc.PosedCollider)}")
    blocks.append(f"### tc.Event\n\n{described(tc.Event)}\n\n{fields_of(tc.Event)}")
    blocks.append(f"### tc.Recorder\n\n{described(tc.Recorder)}\n\n{signature('tc.Recorder', tc.Recorder)}")
    blocks += [entry("####", f"recorder.{name}", getattr(tc.Recorder, name)) for name in ("save", "restart", "frames")]
    pixels = "`pixels`: red, green and blue, uint8 (height, width, 3), top row first."
    blocks.append(f"### tc.Image\n\n{described(tc.Image)} {pixels}")
    blocks.append(entry("####", "image.save", tc.Image.save))
    blocks.append(f"### tc.Scene\n\n{described(tc.Scene)} Its fields are the sections of a scene file.")
    for section in schema.sections().values():
        title = f"[[{section.name}]]" if section.is_array else f"[{section.name}]"
        link = f"Keys of `{title}`: [{section.name}](keys.md#{section.name})."
        blocks.append(f"### tc.{section.cls.__name__}\n\n{described(section.cls)}\n\n{link}")
    blocks += [f"### tc.{name}\n\n{described(getattr(tc, name))}" for name in ("SceneError", "UsageError")]
    return "\n\n".join(blocks)


def fields_of(cls: type) -> str:
    """Return the table of the fields of a class, which have their meaning in a comment or in the docstring below."""
    line = r'^    (\w+): (.+?)(?: = .+?)?(?:  # (.+)|\n    """(.+?)(?:"""|$))'
    found = re.findall(line, inspect.getsource(cls), re.MULTILINE)
    rows = [[f"`{name}`", f"`{kind}`", comment or text] for name, kind, comment, text in found]
    return table(["name", "type", "meaning"], rows)


def members(name: str, cls: type) -> list[str]:
    """Return the entries of all public members of a class."""
    return [entry("####", f"{name}.{key}", value) for key, value in vars(cls).items() if not key.startswith("_")]


def entry(rank: str, name: str, member: Any) -> str:
    """Return heading, signature or type, and docstring of a member."""
    if isinstance(member, property):
        kind = str(inspect.signature(member.fget).return_annotation).strip("'")
        return f"{rank} {name}\n\n`{kind}`. {described(member)}"
    return f"{rank} {name}\n\n{signature(name, member)}\n\n{described(member)}"


def signature(name: str, member: Any) -> str:
    """Return a signature as a code block, without `self` and without quotes around annotations."""
    found = inspect.signature(member)
    parameters = [p for p in found.parameters.values() if p.name != "self"]
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(found.replace(parameters=parameters)))
    return f"```text\n{name}{text.removesuffix(' -> None')}\n```"


def described(member: Any) -> str:
    text, _, _ = textwrap.dedent(inspect.getdoc(member) or "").partition(f"\n\n{KEYS_TITLE}")
    return text.strip()


BLOCKS: dict[str, Callable[..., str]] = {
    f.__name__: f
    for f in (
        *(
            choosing,
            unconverged,
            bar_friction,
            solver,
            scene_summary,
            feature_costs,
            nobody,
            stability_summary,
            validation_summary,
            validation_line,
            solvers,
            goals,
            frames,
            sheets,
            elbow,
            gpu,
        ),
        *(keys, presets, sources, parameters, bindings, api),
    )
}


def brought_up_to_date(text: str) -> str:
    """Return a document with all blocks up to date."""

    def write(found: re.Match[str]) -> str:
        begin, name, argument, end = found.groups()
        return f"{begin}\n{BLOCKS[name](*filter(None, [argument]))}\n\n{end}"

    return BLOCK.sub(write, text)


def main() -> None:
    for path in [DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))]:
        old = path.read_text(encoding="utf-8")
        new = brought_up_to_date(old)
        if new != old:
            path.write_text(new, encoding="utf-8")
            print(f"updated {path.relative_to(DOCS.parent)}")


if __name__ == "__main__":
    main()
