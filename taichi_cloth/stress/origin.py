"""A fingerprint of what a result depends on: a run goes on with those that are as a new run would make them."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

from ..bench.report import machine
from ..scene.model import SOLVER_NAMES
from .unit import Unit

PACKAGE = Path(__file__).parents[1]
JUDGES = ("case", "setting", "trial", "unit", "watch")  # of this folder
DRAWING = ("view/", "interact/", "stress/picture.py")  # changes no result
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
    """Files, from the package's folder, with the digests of what they hold.

    Those of the judges, of the modules in which the case stands, and all that they import; what only another method
    imports is no part of it.
    """
    others = set() if OTHER_METHODS in rows else {f"solvers/{name}.py" for name in SOLVER_NAMES if name != solver}
    found: set[str] = set()
    left = {f"stress/{name}.py" for name in {*JUDGES, *rows}}
    while left:
        found |= left
        names = {path.relative_to(PACKAGE).as_posix() for name in left for path in imported(PACKAGE / name)}
        left = {name for name in names - found - others if not name.startswith(DRAWING)}
    return [(name, digest(PACKAGE / name)) for name in sorted(found)]


def imported(path: Path) -> Iterator[Path]:
    """The modules of the package that a file names in its relative imports."""
    for level, module, names in relative_imports(path.read_bytes()):
        folder = path.parents[level - 1].joinpath(*module.split("."))
        inside = [folder / f"{name}.py" for name in ("__init__", *names)]
        yield from (one for one in (folder.with_suffix(".py"), *inside) if one.is_file())


@cache
def relative_imports(source: bytes) -> list[tuple[int, str, list[str]]]:
    """Dots, module and names of each, wherever in the file it stands."""
    lines = [line for line in ast.walk(ast.parse(source)) if isinstance(line, ast.ImportFrom)]
    return [(line.level, line.module or "", [name.name for name in line.names]) for line in lines if line.level]


def digest(path: Path) -> str:
    """The same whatever ends a line."""
    return hashlib.sha256(path.read_bytes().replace(b"\r\n", b"\n")).hexdigest()
