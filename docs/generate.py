"""Writes into the documents what they quote: `python docs/generate.py`, which `make docs` runs first.

What stands between `<!-- generated: NAME -->` and `<!-- end -->` comes from the function NAME below: from the
program, from the fabrics' files, or from the measured tables beside this file. `tests/test_documents.py` compares.
"""

from __future__ import annotations

import inspect
import re
import runpy
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import taichi_cloth as tc
from taichi_cloth.measure.cloth import Measures
from taichi_cloth.scene import key_table
from taichi_cloth.scene.model import PRESET_NAMES, USUAL, parts
from taichi_cloth.scene.presets import load_preset

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


def references(solver: str) -> list[tuple[str, str]]:
    """Reference and largest error of a solver, in Markdown: **falls short**, pass, *excellent*."""
    text = sections(read("validation.md"))["Largest errors"]
    header = next(line for line in text.splitlines() if line.startswith("| reference"))
    column = [cell.strip() for cell in header.strip("|").split("|")].index(solver)
    return [(row[0], row[column]) for row in rows_of(text) if row[column]]


def survived(solver: str) -> tuple[str, str]:
    """How many hard cases a solver survives, and how many it does not."""
    found = re.search(rf"\b{solver} (\d+) alive, (\d+) failed", read("stability.md"))
    if found is None:
        raise ValueError(f"docs/stability.md does not tell of {solver}")
    return found[1], found[2]


def usual_row(scene: str, solver: str) -> list[str]:
    """What is measured of a solver on a scene: its usual setting, or the one that is there."""
    rows = [row for name, row in scene_errors(solver) if name == scene]
    substeps, iterations = USUAL[solver]
    usual = [row for row in rows if row[0] == f"{solver} {substeps}×{iterations}"]
    return (usual or rows)[0]


# -- the blocks ----------------------------------------------------------------------------------------


def choosing() -> str:
    scenes = ("curtain", "table", "denim")
    rows = []
    for solver in USUAL:
        measured = [usual_row(scene, solver) for scene in scenes]
        short = [name for name, error in references(solver) if error.startswith("**")]
        alive, failed = survived(solver)
        cells = [f"{row[0].removeprefix(solver).strip()}: {row[1]}\N{NO-BREAK SPACE}ms, {row[2]}" for row in measured]
        count = f"{len(short)} of {len(references(solver))}"
        rows.append([f"[`{solver}`](solvers/{solver}.md)", *cells, count, f"{alive} of {int(alive) + int(failed)}"])
    return table(
        ["solver", *(f"`{scene}`" for scene in scenes), "references it falls short of", "hard cases alive"], rows
    )


def solver(name: str) -> str:
    rows = [[f"`{scene}`", *cells] for scene, cells in scene_errors(name)]
    errors = table(["scene", "setting", "ms a frame", "error rms", "largest", "strain"], rows)
    whys = re.findall(r"^- (.+?) falls short with ([a-z0-9, ]+): (.+)$", read("validation.md"), re.MULTILINE)
    largest = dict(references(name))
    short = [[what, largest[what].strip("*"), why] for what, solvers, why in whys if name in solvers.split(", ")]
    falls = table(["falls short of", "largest error", "because"], short) if short else "It falls short of none."
    text = sections(read("stability.md"))["What fails, and why"]
    dies = re.findall(rf"^- (\d+ .+?) fails with {name} \(.*?; (.+)$", text, re.MULTILINE)
    alive, failed = survived(name)
    if len(dies) != int(failed):
        raise ValueError(f"docs/stability.md counts {failed} failures of {name} and tells of {len(dies)}")
    reasons: dict[str, list[str]] = {}
    for case, why in dies:
        reasons.setdefault(why, []).append(case)
    deaths = "\n".join(f"- {', '.join(cases)}: {why}" for why, cases in reasons.items())
    return f"""\
On the shipped scenes, against `spring` with many times the substeps ([scene_errors.md](../scene_errors.md)); errors are
in % of the side:

{errors}

Of {len(largest)} references with known answers ([validation.md](../validation.md)):

{falls}

It survives {alive} of {int(alive) + len(dies)} cases that break cloth ([stability.md](../stability.md)) and fails in:

{deaths}"""


def nobody() -> str:
    """The hard cases that no solver survives."""
    rows = rows_of(sections(read("stability.md"))["Starts alive"])
    lost = [f"- {case}: {what}" for case, what, *solvers, _ in rows if all(cell.startswith("**") for cell in solvers)]
    return "\n".join(lost)


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
    f.__name__: f for f in (choosing, solver, nobody, keys, presets, sources, parameters, api)
}


def brought_up_to_date(text: str) -> str:
    """A document with all its blocks written anew."""

    def write(found: re.Match[str]) -> str:
        begin, name, argument, end = found.groups()
        return f"{begin}\n{BLOCKS[name](*filter(None, [argument]))}\n\n{end}"

    return BLOCK.sub(write, text)


def main() -> None:
    for path in sorted(DOCS.rglob("*.md")):
        old = path.read_text(encoding="utf-8")
        new = brought_up_to_date(old)
        if new != old:
            path.write_text(new, encoding="utf-8")
            print(f"{path.relative_to(DOCS)} is brought up to date")


if __name__ == "__main__":
    main()
