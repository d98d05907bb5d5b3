"""Writes into the documents what they quote: `python docs/generate.py`, which `make docs` runs first.

What stands between `<!-- generated: NAME -->` and `<!-- end -->` comes from the function NAME below: from the
program, from the fabrics' files, or from stored results (`stored.py`). `tests/test_documents.py` compares.
"""

from __future__ import annotations

import csv
import inspect
import re
import runpy
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # tests load this file by its path

import stored
from goals import GOALS

import taichi_cloth as tc
from taichi_cloth.measure.cloth import Measures
from taichi_cloth.scene import key_table
from taichi_cloth.scene.model import PRESET_NAMES, USUAL, parts
from taichi_cloth.scene.presets import load_preset
from taichi_cloth.stress.setting import ROBUST

DOCS = Path(__file__).parent
BLOCK = re.compile(r"(<!-- generated: ([a-z_]+)(?: ([a-z0-9_-]+))? -->\n).*?(<!-- end -->)", re.DOTALL)

Rows = list[list[str]]


def table(header: list[str], rows: Rows) -> str:
    lines = [header, ["---"] * len(header), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


# -- what the measured tables say ----------------------------------------------------------------------


def read(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def rows_of(text: str) -> Rows:
    """The cells of the first table in a text, without its header."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def sections(text: str) -> dict[str, str]:
    """What stands under each heading of the second rank."""
    heads = re.split(r"^## (.+)$", text, flags=re.MULTILINE)
    return dict(zip(heads[1::2], heads[2::2], strict=True))


def scene_errors(solver: str) -> Iterator[tuple[str, list[str]]]:
    """Scene, and setting, ms, error, largest error and strain, for every measured setting of a solver."""
    for scene, text in sections(read("scene_errors.md")).items():
        for setting, ms, _, _, error, largest, strain in rows_of(text):
            if setting.split()[0] == solver:
                yield scene, [setting, ms, error, largest, strain]


def usual_row(scene: str, solver: str) -> list[str]:
    """What is measured of a solver on a scene: its usual setting, or the one that is there."""
    rows = [row for name, row in scene_errors(solver) if name == scene]
    substeps, iterations = USUAL[solver]
    usual = [row for row in rows if row[0] == f"{solver} {substeps}×{iterations}"]
    return (usual or rows)[0]


# -- where stored results were made ------------------------------------------------------------------------


NO_DATE = "date not stored"


def made(words: stored.Words) -> str:
    """The machine, the versions and the day of a run, in one line."""
    return f"{stored.machine_of(words)} · {words.get('date') or NO_DATE}"


def made_units(words: stored.Words) -> str:
    """The machines and the days of a run whose results each say so: it may go on elsewhere."""
    machines = dict.fromkeys(row["machine"] for row in words["results"] if row.get("machine"))
    days = sorted({row["date"][:10] for row in words["results"] if row.get("date")})
    told = " and ".join(machines or [stored.machine_of(words)])
    when = " to ".join(dict.fromkeys((days[0], days[-1]))) if days else NO_DATE
    return f"{told} · {when}" + (" (some results are of an older program)" if words.get("older") else "")


def made_curtains() -> str:
    """Of assets/error.csv, which has room for numbers only: what the JSON says that was written with it."""
    words = stored.load("error")
    with stored.ERRORS.open(encoding="utf-8", newline="") as file:
        rows = [float(row["median_ms"]) for row in csv.DictReader(file)]
    if words is None or [point["median_ms"] for point in words["points"]] != rows:
        return "machine and date not stored in assets/error.csv"
    return made(words)


def made_lines(*commands: str) -> str:
    """Where the runs of these commands were made, in one paragraph: what has no stored run is left out."""
    found = []
    for command in commands:
        if command == "bench --error":
            found.append(f"`{command}`: {made_curtains()}")
            continue
        name, tell = RUNS[command]
        words = stored.load(name)
        if words is not None:
            found.append(f"`{command}`: {tell(words)}")
    return f"Runs: {'; '.join(found)}." if found else ""


# The name of the file that a command writes, and how that file says where it was made.
RUNS: dict[str, tuple[str, Callable[[stored.Words], str]]] = {
    "bench": ("bench", made),
    "bench --goals": ("goals", made),
    "bench --error --scene": ("scene_errors", made),
    "validate": ("validation", made),
    "stress": ("stability", made_units),
}


def with_origin(text: str, *commands: str) -> str:
    """A block, and below it where its figures were measured."""
    return "\n\n".join(filter(None, (text, made_lines(*commands))))


# -- the blocks ----------------------------------------------------------------------------------------


def choosing() -> str:
    scenes = ("curtain", "table", "denim")
    rows = []
    for solver in USUAL:
        measured = [usual_row(scene, solver) for scene in scenes]
        cells = [f"{row[0].removeprefix(solver).strip()}: {row[1]}\N{NO-BREAK SPACE}ms, {row[2]}" for row in measured]
        rows.append([f"[`{solver}`](solvers/{solver}.md)", *cells, falls_short(solver), survives(solver)])
    found = table(
        ["solver", *(f"`{scene}`" for scene in scenes), "references it falls short of", "hard cases alive"], rows
    )
    robust = f"Hard cases that the recommended setting `{ROBUST.name}` survives: {survives(ROBUST.name)}."
    return with_origin(f"{found}\n\n{robust}", "bench --error --scene", "validate", "stress")


# -- how far a usual setting is from the answer --------------------------------------------------------

HELD = ("A3.1", "A2.5")  # sheets in equilibrium under their weight: told of every solver
BESIDE = ("A5.1", "A6.2")  # told where a solver falls short


def unfinished() -> str:
    return "\n".join(f"- [`{name}`](solvers/{name}.md): {distance(name)}" for name in USUAL)


def distance(solver: str) -> str:
    """One sentence: how far the usual setting of a solver is from exact values, by its worst row of each reference."""
    words = stored.load("validation")
    if words is None:
        return "how far the usual setting is from exact values: no run is stored."
    said = []
    for number in (*HELD, *BESIDE):
        rows = [row for row in words["rows"] if (row["reference"], row["solver"]) == (number, solver)]
        if rows and (number in HELD or any(row["verdict"] not in stored.PASSED for row in rows)):
            said.append(farthest(rows))
    setting = stored.setting_of({"solver": solver, "substeps": USUAL[solver][0], "iterations": USUAL[solver][1]})
    more = ", or as many substeps as stability asks for" if solver in EXPLICIT else ""
    heading = f"at its usual setting ({setting}{more}) it is off the exact values by"
    return f"{heading} {'; '.join(said)}." if said else f"{heading} nothing that these references measure."


EXPLICIT = ("spring", "rk4")


def farthest(rows: list[stored.Words]) -> str:
    """Of a reference: the row that is farthest from its exact value, and how many rows nobody knows."""
    known = [(row["measured"] / row["exact"] - 1, row) for row in rows if row["measured"] is not None]
    title = f"{rows[0]['reference']} {rows[0]['name']}"
    told = [title]
    if known:
        share, row = max(known, key=lambda one: abs(one[0]))
        passed = "" if row["verdict"] in stored.PASSED else ", falls short"
        what = re.sub(r" ?\[[^]]*\]$", "", row["what"])  # without its unit
        told = [f"{signed(share)} in {title} (*{what}*{passed})"]
    if slow := len(rows) - len(known):
        told.append(f"{slow} of {len(rows)} rows too slow to be known")
    return ", ".join(told)


def signed(share: float) -> str:
    return ("−" if share < 0 else "+") + stored.per_cent(abs(share))


def bar() -> str:
    """Which solvers hold too little on a bar: ends that slip at a smaller ratio than the capstan law has."""
    words = stored.load("validation")
    if words is None:
        return "Friction round a bar: no run is stored."
    rows = [row for row in words["rows"] if row["reference"] == "A7.4"]
    said = []
    for name in dict.fromkeys(row["solver"] for row in rows):
        own = [row for row in rows if row["solver"] == name]
        missed = [row for row in own if row["verdict"] not in stored.PASSED and row["measured"] is not None]
        short = [share for row in missed if (share := row["measured"] / row["exact"] - 1) < 0]
        if short:
            worst = min(short)
            said.append(f"`{name}` in {len(short)} of {len(own)} rows, by up to {signed(worst)}")
    return f"Too weak: {'; '.join(said) or 'none'}."


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
    told = f"{found[stored.ALIVE]} of {ran}" if ran else "not run"
    return f"{told}, {found[stored.NOT_RUN]} not run" if ran and found[stored.NOT_RUN] else told


def solver(name: str) -> str:
    rows = [[f"`{scene}`", *cells] for scene, cells in scene_errors(name)]
    errors = table(["scene", "setting", "ms a frame", "error rms", "largest", "strain"], rows)
    return f"""\
On the shipped scenes, against the float64 reference ([scene_errors.md](../scene_errors.md)); errors are in % of the
side:

{errors}

{made_lines("bench --error --scene", "validate", "stress")}

How far from converged: {distance(name)}

{references(name)}

{hard_cases(name)}"""


def references(name: str) -> str:
    """Of a solver: which references with known answers it falls short of, and by how much."""
    words = stored.load("validation")
    if words is None:
        return "References with known answers: no run is stored."
    short, count = stored.shortfalls(words, name)
    heading = f"Of {count} references with known answers ([validation](../validation.md)) it falls short of"
    if not short:
        return f"{heading} none."
    rows = [[what, f"{missed} of {rows}", f"{worst:.2g}"] for what, missed, rows, worst in short]
    return f"{heading} {len(short)}:\n\n" + table(["reference", "rows", "largest error"], rows)


def hard_cases(setting: str) -> str:
    """Of a setting: which cases that break cloth it does not survive, and what broke first."""
    words = stored.load("stability")
    found = [case for case in stored.hard_cases(words) if case.setting == setting] if words is not None else []
    if not found:
        return "Cases that break cloth: no run is stored."
    lines = [f"Cases that break cloth ([stability](../stability.md)) and that it survives: {survives(setting)}."]
    for case in found:
        if case.state == stored.FAILED:
            broken = case.failures[0]["failure"]
            variants = ", ".join(row["variant"] for row in case.failures)
            bounds = f"{broken['what']} {broken['value']:.4g}, not {broken['bound']:.4g}"
            lines.append(f"- {case.number} {case.name} fails ({variants}): {bounds}")
        elif case.state == stored.SLOW:
            lines.append(f"- {case.number} {case.name}: {case.state}")
    return lines[0] + "\n\n" + "\n".join(lines[1:]) if len(lines) > 1 else lines[0]


def nobody() -> str:
    """The hard cases that no solver survives at its usual setting, as far as all have run them."""
    words = stored.load("stability")
    if words is None:
        return "No run is stored."
    cases: dict[str, list[str]] = {}
    for case in stored.hard_cases(words):
        if case.setting in USUAL:
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
    return with_origin(table(["setting", *states], rows), "stress")


def validation_summary() -> str:
    words = stored.load("validation")
    if words is None:
        return "References with known answers: no run is stored."
    rows = []
    for name, found in stored.verdicts(words).items():
        passed = sum(found[verdict] for verdict in stored.PASSED)
        shares = [f"{passed / found.total():.1%}", f"{found['excellent'] / found.total():.1%}"]
        rows.append([name if name == "all" else f"`{name}`", f"{found.total()}", *shares])
    return with_origin(table(["solver", "rows", "pass", "excellent"], rows), "validate")


VERDICTS = {"falls short": "fall short"}  # of more rows than one


def validation_line() -> str:
    words = stored.load("validation")
    if words is None:
        return "No run is stored."
    found = stored.verdicts(words)["all"]
    passed = sum(found[verdict] for verdict in stored.PASSED)
    shares = f"{passed / found.total():.1%} pass, {found['excellent'] / found.total():.1%} are excellent"
    states = ", ".join(
        f"{count} {verdict if count == 1 else VERDICTS.get(verdict, verdict)}" for verdict, count in found.most_common()
    )
    return with_origin(f"{found.total()} rows: {shares} ({states}).", "validate")


def solvers() -> str:
    """What each solver costs and how wrong it is on the swinging curtain of 64 × 64 cells."""
    rows = []
    for name, what in METHODS.items():
        points = stored.errors(64, name)
        best = min(points, key=lambda row: float(row["max_error"]))
        cells = [at(stored.fastest(points, 0.01)), f"{at(best)}, {stored.per_cent(best['max_error'])}"]
        rows.append([f"[`{name}`](docs/solvers/{name}.md)", what, *cells])
    found = table(
        ["`--solver`", "method", "fastest that is 1 % wrong at most", "most accurate, and its largest error"], rows
    )
    return with_origin(found, "bench --error")


# As README puts them.
METHODS = {
    "verlet": "damped Verlet and position relaxation, stiffness 0…1: the demos' method",
    "xpbd": "compliant constraints with SI constants (Macklin 2016)",
    "spring": "explicit symplectic Verlet, as many substeps as stability needs",
    "lines": "rows, columns and diagonals solved exactly as chains",
    "rk4": "classical Runge–Kutta on the same forces",
    "projective": "backward Euler by local and global steps (Liu 2013)",
}


def at(row: stored.Words | None) -> str:
    """A setting of assets/error.csv with its time."""
    return "none" if row is None else f"{stored.setting_of(row)}: {stored.milliseconds(row['median_ms'])}"


def goals() -> str:
    timed = [*(stored.load("bench") or {"rows": []})["rows"], *(stored.load("goals") or {"sheets": []})["sheets"]]
    found = table(["goal", "good", "excellent", "stored figure", "reached"], [goal.cells() for goal in GOALS])
    return with_origin(stored.disturbed(timed) + found, "bench", "bench --goals", "bench --error")


BENCH_COLUMNS = {
    "median_ms": ("ms", ".2f"),
    "p95_ms": ("p95", ".2f"),
    "over_c": ("÷ C", ".1f"),
    "under_javascript": ("JS ÷", ".1f"),
    "cold_s": ("cold s", ".1f"),
    "warm_s": ("warm s", ".1f"),
    "peak_mb": ("MB", ".0f"),
    "max_strain": ("strain", ".1%"),
}


def frames() -> str:
    """The rows of `bench`."""
    words = stored.load("bench")
    if words is None:
        return "No run is stored."
    rows = []
    for row in words["rows"]:
        setting = f"{row['substeps']}×{row['iterations']}"
        figures = ["" if row[name] is None else f"{row[name]:{form}}" for name, (_, form) in BENCH_COLUMNS.items()]
        rows.append(
            [row["scene"], f"`{row['solver']}`", row["path"], f"{row['columns']}×{row['rows']}", setting, *figures]
        )
    header = ["scene", "solver", "path", "grid", "n×m", *(title for title, _ in BENCH_COLUMNS.values())]
    return f"{made(words)}\n\n{stored.disturbed(words['rows'])}{table(header, rows)}"


def sheets() -> str:
    """The sheets of `bench --goals`."""
    words = stored.load("goals")
    if words is None:
        return "No run is stored."
    rows = []
    for row in words["sheets"]:
        errors = [
            f"{row['rms_error']:.3%}",
            f"{row['max_error']:.2%}",
            f"{row['doubt']:.3%}",
            f"{row['max_strain']:.1%}",
        ]
        rows.append([row["name"], f"`{row['method']}`", f"{row['frames']}", f"{row['median_ms']:.1f}", *errors])
    header = ["sheet", "method", "frames", "ms", "error rms", "largest", "in doubt by", "strain"]
    return f"{made(words)}\n\n{stored.disturbed(words['sheets'])}{table(header, rows)}"


def knee() -> str:
    """The swinging curtain on every grid: the fastest settings for three errors."""
    rows = []
    for cells in (32, 64, 128, 256):
        for name in USUAL:
            points = stored.errors(cells, name)
            if points:
                best = min(points, key=lambda row: float(row["max_error"]))
                found = [at(stored.fastest(points, error)) for error in (1e-2, 1e-3, 1e-5)]
                rows.append(
                    [f"{cells}×{cells}", f"`{name}`", *found, f"{at(best)}, {stored.per_cent(best['max_error'])}"]
                )
    found = table(["cells", "solver", "1 %", "0.1 %", "0.001 %", "most accurate, and its largest error"], rows)
    return with_origin(found, "bench --error")


def keys() -> str:
    blocks = []
    docs = {f"[[{p.name}]]" if p.many else f"[{p.name}]": p.section.__doc__ for p in parts().values()}
    for section in dict.fromkeys(row[0] for row in key_table()):
        title = f"## {section}" if section else "## At the top of a file"
        says = inspect.cleandoc(docs[section]) if section else "Before all sections."
        rows = [
            [f"`{key}`", f"`{default}`", unit, bounds.removesuffix(f" {unit}"), text]
            for at, key, default, unit, bounds, text in key_table()
            if at == section
        ]
        blocks.append(f"{title}\n\n{says}\n\n" + table(["key", "default", "unit", "range", "what it is"], rows))
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
        rows.append(["shares for `verlet`", shares, fabric.sources["springs"]])
        blocks.append(f"### {fabric.name}\n\n{fabric.title}.\n\n" + table(["what", "value", "where it is from"], rows))
    return "\n\n".join(blocks)


def parameters() -> str:
    strips = runpy.run_path(str(DOCS.parent / "screenshots" / "parameters.py"))["STRIPS"]
    blocks = []
    for strip in strips:
        says = strip.says[0].upper() + strip.says[1:]
        values = " · ".join(strip.panels)
        title = strip.name.replace("_", " ").capitalize()
        picture = f"![{strip.name}: {values}](pictures/parameters/{strip.name}.png)"
        made = f"Scene `{strip.scene}`, {strip.frame} frames after the start."
        blocks.append(f"## {title}\n\n{says}.\n\n{picture}\n\n**{values}** · {made}")
    return "\n\n".join(blocks)


def api() -> str:
    """Every public name with its signature and docstring."""
    blocks = []
    for name in ("load_scene", "scene_names", "start", "picture"):
        blocks.append(entry("###", f"tc.{name}", getattr(tc, name)))
    blocks.append(f"### tc.Simulation\n\n{described(tc.Simulation)}\n\n{signature('tc.Simulation', tc.Simulation)}")
    for name, member in vars(tc.Simulation.__base__).items():
        if not name.startswith("_"):
            blocks.append(entry("####", f"simulation.{name}", member))
    fields = re.findall(r"^    (\w+): ([\w| ]+?)  # (.+)$", inspect.getsource(Measures), re.MULTILINE)
    rows = [[f"`{name}`", f"`{kind}`", what] for name, kind, what in fields]
    blocks.append(f"### Measures\n\nWhat `measure()` returns.\n\n{table(['name', 'type', 'what it is'], rows)}")
    blocks.append(f"### tc.Picture\n\n{described(tc.Picture)}")
    blocks.append(entry("####", "picture.save", tc.Picture.save))
    blocks.append(f"### tc.Scene\n\n{described(tc.Scene)} [All its keys](keys.md).")
    blocks.append(f"### tc.SceneError\n\n{described(tc.SceneError)}")
    return "\n\n".join(blocks)


def entry(rank: str, name: str, member: Any) -> str:
    if isinstance(member, property):
        kind = str(inspect.signature(member.fget).return_annotation).strip("'")
        return f"{rank} {name}\n\n`{kind}`. {described(member)}"
    return f"{rank} {name}\n\n{signature(name, member)}\n\n{described(member)}"


def signature(name: str, member: Any) -> str:
    """As a call is written: without `self`, annotations without quotes."""
    found = inspect.signature(member)
    asked = [p for p in found.parameters.values() if p.name != "self"]
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", str(found.replace(parameters=asked)))
    return f"```text\n{name}{text.removesuffix(' -> None')}\n```"


def described(member: Any) -> str:
    return textwrap.dedent(inspect.getdoc(member) or "").strip()


BLOCKS: dict[str, Callable[..., str]] = {
    f.__name__: f
    for f in (
        *(
            choosing,
            unfinished,
            bar,
            solver,
            nobody,
            stability_summary,
            validation_summary,
            validation_line,
            solvers,
            goals,
            frames,
            sheets,
            knee,
        ),
        *(keys, presets, sources, parameters, api),
    )
}


def brought_up_to_date(text: str) -> str:
    """A document with all its blocks written anew."""

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
            print(f"{path.relative_to(DOCS.parent)} is brought up to date")


if __name__ == "__main__":
    main()
