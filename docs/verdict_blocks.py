"""Blocks of the documents about verdicts: references with known solutions, and hard cases."""

from __future__ import annotations

import re
from pathlib import Path

import stored
from error_blocks import default_row, errors_on_scenes, scene_rows, seconds_of_scenes
from tables import Rows, table, with_runs

from taichi_cloth.evaluation.stress.setup import ROBUST
from taichi_cloth.scene.fabric_schema import PRESET_NAMES
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG

PAGES = Path(__file__).parent  # of the documentation


def choosing() -> str:
    shown, lengths = ("curtain", "table", "denim"), seconds_of_scenes()
    rows = []
    for solver in SOLVER_CATALOG:
        measured = scene_rows(solver)
        cells = [error_at_default(solver, measured[scene]) if scene in measured else "" for scene in shown]
        rows.append([f"[`{solver}`](solvers/{solver}.md)", *cells, falls_short(solver), survives(solver)])
    found = table(
        [
            "solver",
            *(f"`{scene}`, first {lengths.get(scene, '-')}" for scene in shown),
            "references not reached",
            "stress cases survived",
        ],
        rows,
    )
    robust = f"Stress cases survived with the setting `{ROBUST.name}`: {survives(ROBUST.name)}."
    return with_runs(f"{found}\n\n{robust}", "bench --error --scene", "validate", "stress")


def error_at_default(solver: str, rows: Rows) -> str:
    setting, ms, error, *_ = default_row(solver, rows)
    return f"{setting.removeprefix(solver).strip()}: {ms}\N{NO-BREAK SPACE}ms, {error}"


ALWAYS_SHOWN = ("A3.1", "A2.5")  # references with sheets in equilibrium under their weight
# Words of reasons why a default setting does not reach the solution.
TOO_EARLY = "iterations end", "conjugate gradients end", "that the iterations leave"
OWN_SETTINGS = ("B3", "B4", "B5", "B6")  # references with substeps and iterations of their own


def unconverged() -> str:
    return "\n".join(f"- [`{name}`](solvers/{name}.md): {distance(name)}" for name in SOLVER_CATALOG)


def distance(solver: str) -> str:
    """Return the error of a solver's default setting as a sentence: the worst row of each of these references."""
    words = stored.load("validation")
    if words is None:
        return "difference of the default setting from exact values: no run is stored."
    parts = []
    for number in shown_references(words, solver):
        if rows := values_of(words, number, solver):
            parts.append(worst_row(rows))
    info = SOLVER_CATALOG[solver]
    setting = stored.setting_of({"solver": solver, "substeps": info.substeps, "iterations": info.iterations})
    more = ", or as many substeps as stability needs" if info.is_explicit else ""
    heading = f"with its default setting ({setting}{more}) it differs from exact values by"
    return f"{heading} {'; '.join(parts)}." if parts else f"{heading} nothing that these references measure."


def shown_references(words: stored.Words, solver: str) -> list[str]:
    """Return the references to compare a default setting with: with those for which its iterations end too early."""
    missed = [
        row
        for row in words["rows"]
        if row["solver"] == solver and row["verdict"] not in stored.PASSED and not is_order(row)
    ]
    early = [row for row in missed if any(words in (row.get("reason") or "") for words in TOO_EARLY)]
    of_default = [row["reference"] for row in early if not row["reference"].startswith(OWN_SETTINGS)]
    return list(dict.fromkeys([*ALWAYS_SHOWN, *of_default]))


def is_order(row: stored.Words) -> bool:
    """Return whether a row has an order of convergence, whose error is none of the solution."""
    return str(row["what"]).startswith("order ")


def values_of(words: stored.Words, number: str, solver: str) -> list[stored.Words]:
    """Return the rows of a reference and a solver with values of the solution."""
    rows = [row for row in words["rows"] if (row["reference"], row["solver"]) == (number, solver)]
    return [row for row in rows if not is_order(row)]


def worst_row(rows: list[stored.Words]) -> str:
    """Return the row of a reference with the largest relative error, and the number of rows without a result."""
    measured = [row for row in rows if row["measured"] is not None]
    title = f"{rows[0]['reference']} {rows[0]['name']}"
    parts = [title]
    if measured:
        row = max(measured, key=relative_error)
        passed = "" if row["verdict"] in stored.PASSED else ", falls short"
        what = re.sub(r" ?\[[^]]*\]$", "", row["what"])  # without its unit
        parts = [f"{difference(row)} in {title} (*{what}*{passed})"]
    if slow := len(rows) - len(measured):
        parts.append(f"{slow} of {len(rows)} rows too slow to be measured")
    return ", ".join(parts)


def relative_error(row: stored.Words) -> float:
    """Return how far the measured value is from the exact one, as a share of it, or as it is if the exact one is 0."""
    return abs(row["measured"] - row["exact"]) / (abs(row["exact"]) or 1.0)


def difference(row: stored.Words) -> str:
    """Return the difference of the measured value from the exact one in words."""
    if row["exact"]:
        return signed(row["measured"] / row["exact"] - 1)
    return f"{row['measured']:.2g} instead of 0"


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


def fabric_rows() -> str:
    """Return the rows of references that measure a shipped fabric, with the result of each solver."""
    words = stored.load("validation")
    if words is None:
        return "Rows with shipped fabrics: no run is stored."
    named = re.compile(f"({'|'.join(PRESET_NAMES)}): ")
    rows: dict[str, dict[str, str]] = {}
    for row in words["rows"]:
        if named.match(row["what"]):
            verdict = "" if row["verdict"] in stored.PASSED else f", {row['verdict']}"
            value = "-" if row["measured"] is None else f"{row['measured']:.3g}"
            rows.setdefault(f"{row['reference']} {row['what']}", {})[row["solver"]] = value + verdict
    solvers = list(dict.fromkeys(solver for row in rows.values() for solver in row))
    lines = [[what, *(row.get(solver, "") for solver in solvers)] for what, row in rows.items()]
    return with_runs(table(["row", *(f"`{solver}`" for solver in solvers)], lines), "validate")


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
    rows = [[f"`{name}`", f"{found[name].total()}", *(f"{found[name][state]}" for state in states)] for name in order]
    return with_runs(table(["setting", "cases", *states], rows), "stress")


LONG_RUNS = ("hanging", "swinging")


def soak() -> str:
    """Return how the long run of each setting ended: the variants of case 32 with a million frames."""
    words = stored.load("soak")
    if words is None:
        return "The long run of case 32 (`taichi-cloth stress --filter 32 --soak`): no run is stored."
    found = {(row["setting"], row["variant"]): row for row in words["results"]}
    settings = dict.fromkeys(setting for _, _, setting in words["planned"])
    rows = [[f"`{name}`", *(long_run(found.get((name, variant))) for variant in LONG_RUNS)] for name in settings]
    return with_runs(
        f"{words['results'][0]['parameters']}:\n\n" + table(["setting", *LONG_RUNS], rows), "stress --soak"
    )


def long_run(row: stored.Words | None) -> str:
    """Return how a long run ended, and the largest drift if it was measured."""
    if row is None:
        return stored.NOT_RUN
    if row["failure"] is not None:
        failure = row["failure"]
        return f"{failure['what']} {failure['value']:.2g} after {failure['frame']:,} frames (≤ {failure['bound']:.2g})"
    if row["slow_ms"] is not None:
        return f"{stored.SLOW}: {stored.milliseconds(row['slow_ms'])} a frame"
    drift = [f", {figure['what']} {figure['value']:.2g}" for figure in row["figures"] if figure["what"] == "drift [m]"]
    return f"{stored.ALIVE} after {row['frames']:,} frames" + "".join(drift)


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


def quoted(page: str, end: str) -> str:
    """Return what a page of results says between its title and the first line that matches `end`, without links."""
    lines = (PAGES / page).read_text(encoding="utf-8").splitlines()
    last = next(k for k, line in enumerate(lines) if re.match(end, line))
    return re.sub(r" \[[^]]*\]\([^)]*\) has them all\.", "", "\n".join(lines[2:last]).strip())


def validation_page() -> str:
    """Return the summary of docs/validation.md as it is, and how far defaults are from the solution."""
    lines = [line for line in quoted("validation.md", r"\| solver").splitlines() if line]
    return with_runs("\n".join([*lines, unfinished()]), "validate")


def stability_page() -> str:
    """Return the summary of docs/stability.md as it is, with the lines below its table as one paragraph."""
    rows, _, below = quoted("stability.md", r"\d+ starts per variant").partition("\n\n")
    return with_runs(f"{rows}\n\n{' '.join(below.split())}", "stress")


def unfinished() -> str:
    """Return the default settings that miss references because iterations end too early, and by how much."""
    words, parts = stored.load("validation"), []
    if words is None:
        return "Defaults whose iterations end too early: no run is stored."
    for solver in SOLVER_CATALOG:
        worst = []
        for number in shown_references(words, solver):
            rows = values_of(words, number, solver)
            missed = [row for row in rows if row["verdict"] not in stored.PASSED and row["measured"] is not None]
            worst += [f"{difference(max(missed, key=relative_error))} in {number}"] if missed else []
        parts += [f"`{solver}` ({', '.join(worst)})"] if worst else []
    return f"Defaults whose iterations end too early: {', '.join(parts) or 'none'}."


BLOCKS = (
    choosing,
    unconverged,
    solver,
    validation_page,
    stability_page,
    unfinished,
    validation_summary,
    bar_friction,
    fabric_rows,
    nobody,
    soak,
    stability_summary,
)
