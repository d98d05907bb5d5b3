"""A fingerprint of what a result depends on: a run goes on with those that are as a new run would make them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

from ..bench.report import machine
from ..scene.model import SOLVER_NAMES
from .unit import Unit

PACKAGE = Path(__file__).parents[1]
PHYSICS = ("scene", "mesh", "kernels", "state", "contact", "solvers", "measure", "reference")  # folders
FILES = ("simulation", "controls_row", "given", "hand", "hands", "scene_solver", "scene_stages", "runtime")
JUDGES = ("case", "setting", "trial", "unit", "watch")  # of this folder, and what they and a case's module import
PICTURE = "picture"  # it draws, and changes no result
IMPORTED = re.compile(r"^from \.(\w+) import", re.MULTILINE)
OTHER_METHODS = "changes"  # the module of cases that go on with other methods


def origin(unit: Unit) -> str:
    """Of the sources of physics and judging that this unit runs, of its numbers, and of versions.

    A case's module counts for its own cases, a method's for its own settings. The processor is no part of it, so that
    a run can go on elsewhere; every result says where it was made.
    """
    versions = [value for name, value in machine().items() if name not in ("cpu", "cores")]
    case, calls = unit.case, list(called(unit.variant.run))
    words = [*versions, case.name, case.parameters, case.note, unit.variant.name, repr(unit.setting), *calls]
    rows = {call.rpartition(".")[0].rpartition(".")[2] for call in calls if call.startswith(__package__)}
    words += [f"{name} {digest}" for name, digest in sources(unit.setting.solver.name, frozenset(rows))]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:12]


def called(run: Any) -> Iterator[str]:
    """The functions and numbers that a variant is made of."""
    if isinstance(run, partial):
        for part in (run.func, *run.args, *run.keywords.values()):
            yield from called(part)
    elif callable(run):
        yield f"{run.__module__}.{run.__qualname__}"
    else:
        yield repr(run)


@cache
def sources(solver: str, rows: frozenset[str]) -> list[tuple[str, str]]:
    """Files, from the package's folder, with the digests of what they hold."""
    others = set() if OTHER_METHODS in rows else {f"solvers/{name}.py" for name in SOLVER_NAMES if name != solver}
    paths = [path for folder in PHYSICS for path in (PACKAGE / folder).rglob("*.py")]
    paths += [PACKAGE / f"{name}.py" for name in FILES]
    paths += [PACKAGE / "stress" / f"{name}.py" for name in imported({*JUDGES, *rows})]
    named = {path.relative_to(PACKAGE).as_posix(): path for path in paths}
    return [(name, digest(path)) for name, path in sorted(named.items()) if name not in others]


def imported(names: Iterable[str]) -> set[str]:
    """These modules of this folder, and all those that they import."""
    found: set[str] = set()
    left = set(names)
    while left:
        found |= left
        texts = [(PACKAGE / "stress" / f"{name}.py").read_text(encoding="utf-8") for name in left]
        left = {name for text in texts for name in IMPORTED.findall(text)} - found - {PICTURE}
    return found


def digest(path: Path) -> str:
    """The same whatever ends a line."""
    return hashlib.sha256(path.read_bytes().replace(b"\r\n", b"\n")).hexdigest()
