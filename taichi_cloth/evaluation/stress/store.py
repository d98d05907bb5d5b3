"""Results in a JSON file, each with a fingerprint of everything that it depends on.

A resumed run keeps the results whose fingerprint is that of a new run, and repeats the others. The file is complete
after every unit, so that a run can be interrupted.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any

from ...scene.schema import SOLVER_NAMES
from ...system.console import count_noun, machine
from ...system.errors import UsageError
from ...system.files import atomic_file
from .causes import EXPERIMENTS, Cause
from .setup import ROBUST, ROBUST_SLACK
from .trial import Measurement
from .unit import ALIVE, SLOW, Failure, Key, Result, Unit

PACKAGE = Path(__file__).parents[2]
JUDGING_MODULES = ("invariants", "setup", "trial", "unit")  # modules of this folder that judge
MINUTES = "%Y-%m-%d %H:%M"
DRAWING = "render/"  # a folder that changes no result
PUBLIC_API = "__init__.py"  # it imports what scripts use, of which a result uses only what the other files import
SOLVER_SWITCH_CASES = "changes"  # the module whose cases switch solvers


def fingerprint(unit: Unit) -> str:
    """Return the fingerprint of a unit, 12 hex digits.

    It covers the sources of the physics and checks that the unit runs, its numbers, and versions. The module of a case
    counts only for its own cases, that of a solver only for its own settings. The processor does not count, so that a
    run can continue on another machine; each result names its machine.
    """
    versions = [value for name, value in machine().items() if name not in ("cpu", "cores")]
    case, calls = unit.case, list(called(unit.variant.run))
    words = [*versions, case.name, case.parameters, case.note, unit.variant.name, repr(unit.setting), *calls]
    rows = {call.rpartition(".")[0].rpartition(".")[2] for call in calls if call.startswith(__package__)}
    words += [f"{name} {digest}" for name, digest in sources(unit.setting.solver.name, frozenset(rows))]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:12]


def called(run: Any) -> Iterator[str]:
    """Yield the functions and values that a variant is made of."""
    if isinstance(run, partial):
        for part in (run.func, *run.args, *run.keywords.values()):
            yield from called(part)
    elif callable(run):
        yield f"{run.__module__}.{run.__qualname__}"
    else:
        yield repr(run)


@cache
def sources(solver: str, rows: frozenset[str]) -> list[tuple[str, str]]:
    """Return the files that a result depends on, relative to the package's folder, with digests of their contents.

    These are the judging modules, the modules of the case (`rows`), the solver, and everything they import.
    """
    solvers = SOLVER_NAMES if SOLVER_SWITCH_CASES in rows else (solver,)  # loaded by name, so not among the imports
    found: set[str] = set()
    pending = {f"evaluation/stress/{name}.py" for name in {*JUDGING_MODULES, *rows}}
    pending |= {f"solvers/{name}.py" for name in solvers}
    while pending:
        found |= pending
        names = {path.relative_to(PACKAGE).as_posix() for name in pending for path in imported(PACKAGE / name)}
        pending = {name for name in names - found if not name.startswith(DRAWING) and name != PUBLIC_API}
    return [(name, digest((PACKAGE / name).read_bytes())) for name in sorted(found)]


def imported(path: Path) -> Iterator[Path]:
    """Yield the modules of the package that a file names in its relative imports."""
    for level, module, names in relative_imports(path.read_bytes()):
        folder = path.parents[level - 1].joinpath(*module.split("."))
        inside = [folder / f"{name}.py" for name in ("__init__", *names)]
        yield from (one for one in (folder.with_suffix(".py"), *inside) if one.is_file())


@cache
def relative_imports(source: bytes) -> list[tuple[int, str, list[str]]]:
    """Return the number of dots, the module and the names of every relative import in a source."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
    return [(node.level, node.module or "", [name.name for name in node.names]) for node in nodes if node.level]


@cache
def digest(source: bytes) -> str:
    """Return the SHA-256 of a module without its comments, docstrings and line breaks, which change no result."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [line for line in body if not is_text(line)]  # type: ignore[attr-defined]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def is_text(line: ast.stmt) -> bool:
    """Return whether a statement is a docstring."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


@dataclass
class Store:
    """Planned units, their results, and the causes of failures."""

    path: Path | None = None
    """File to write after every result; None writes nothing."""
    planned: list[Key] = field(default_factory=list)
    results: dict[Key, Result] = field(default_factory=dict)
    machine: str = ""
    causes: dict[Key, Cause] = field(default_factory=dict)
    """Causes of failures."""
    older: int = 0
    """Number of results of an older version of the program, when the file was written."""
    origins: dict[Key, str] = field(default_factory=dict, compare=False)
    """Fingerprint of each unit if it ran now."""

    @classmethod
    def new(cls, path: Path | None, planned: Iterable[Unit]) -> Store:
        """Return a store for these units, without results, on this machine."""
        origins = {unit.key: fingerprint(unit) for unit in planned}
        return cls(path, list(origins), {}, " · ".join(machine().values()), origins=origins)

    def add(self, result: Result) -> None:
        """Add or replace a result, with fingerprint, date and machine, and write the file. Raises OSError."""
        now = datetime.now(UTC).strftime(MINUTES)
        self.results[result.key] = replace(result, origin=self.origins[result.key], date=now, machine=self.machine)
        self.save()

    def left(self, units: Iterable[Unit], starts: int) -> list[Unit]:
        """Return the units without a result of this version of the program that has at least `starts` starts.

        A failed or too slow result is final: more starts cannot change it.
        """
        return [unit for unit in units if not self._has(unit.key, starts)]

    def is_needed(self, key: Key) -> bool:
        """Return whether a run of all units includes this one.

        `robust-slack` shows the effect of another material. It is needed only for the cases that the scene's own cloth
        does not survive with `robust`.
        """
        case, _, setting = key
        same = [other for other in self.planned if other[0] == case and other[2] == ROBUST.name]
        return setting != ROBUST_SLACK.name or not same or not all(map(self._survived, same))

    def _survived(self, key: Key) -> bool:
        """Return whether a unit is alive with this version of the program.

        A store that was only read has no fingerprints: its results count whatever their version.
        """
        found = self.results.get(key)
        return found is not None and found.state == ALIVE and (not self.origins or self._is_new(found))

    def _has(self, key: Key, starts: int) -> bool:
        found = self.results.get(key)
        return found is not None and self._is_new(found) and (found.starts >= starts or found.state != ALIVE)

    def repeatable(self, units: Iterable[Unit]) -> list[Unit]:
        """Return the units with a result of an earlier version of the program that one start can confirm.

        A result that is too slow depends on the speed of the program, which no digest tells.
        """
        return [unit for unit in units if unit.key in self.results and self._is_repeatable(self.results[unit.key])]

    def _is_repeatable(self, result: Result) -> bool:
        return bool(result.digest) and result.state != SLOW and not self._is_new(result)

    def repeat(self, again: Result) -> bool:
        """Take over an earlier result if this version of the program repeated its last start bit by bit (`again`).

        The texts of the case are those of this version. Writes the file, and returns whether the digests are equal.
        Raises OSError.
        """
        earlier = self.results[again.key]
        if again.digest != earlier.digest:
            return False
        now, cause = datetime.now(UTC).strftime(MINUTES), self.cause(earlier)
        renamed = replace(earlier, name=again.name, parameters=again.parameters, about=again.about)
        self.results[again.key] = replace(renamed, origin=self.origins[again.key], repeated=now)
        if cause is not None:
            self.explain(again.key, cause)
        self.save()
        return True

    def _is_new(self, result: Result) -> bool:
        return result.origin == self.origins[result.key]

    def continued(self, older: Store, *, drop: bool = False) -> Store:
        """Return this store with the results and causes of another, whatever their fingerprints.

        The file is written without results that are not planned: raises UsageError if there are any, unless `drop`.
        """
        others = [result for key, result in older.results.items() if key not in self.origins]
        if others and not drop:
            one, there = others[0], count_noun(len(others), "result")
            example = f"{one.case} {one.name}, {one.variant}, {one.setting}"
            raise UsageError(f"{older.path} has {there} that this run does not include ({example}): use another file")
        results = {key: older.results[key] for key in self.planned if key in older.results}
        count = sum(not self._is_new(result) for result in results.values())
        return replace(self, results=results, causes=older.causes, older=count)

    def explain(self, key: Key, cause: Cause) -> None:
        """Add or replace the cause of a failure, and write the file. Raises OSError."""
        self.causes[key] = replace(cause, origin=self.results[key].origin)
        self.save()

    def cause(self, result: Result) -> Cause | None:
        """Return the cause stored for the unit of a result, if it explains this failure."""
        cause = self.causes.get(result.key)
        return cause if cause is not None and cause.is_of(result) else None

    def reason(self, result: Result) -> str:
        """Return the cause of a failure in words; empty if no experiment found one."""
        cause = self.cause(result)
        return cause.shown if cause else ""

    def unexplained(self, results: Iterable[Result]) -> list[Result]:
        """Return the failed results without a cause, examined or not."""
        return [result for result in results if result.failure and not self.reason(result)]

    def untried(self, units: Iterable[Unit]) -> list[tuple[Unit, Failure]]:
        """Return failed units without a cause, and their failures, for which not all experiments have run."""
        found = []
        for unit in units:
            result = self.results.get(unit.key)
            if result is None or result.failure is None:
                continue
            cause = self.cause(result)
            if cause is None or not (cause.shown or cause.experiments == len(EXPERIMENTS)):
                found.append((unit, result.failure))
        return found

    def ordered(self) -> list[Result]:
        """Return all results in the order of the plan."""
        return [self.results[key] for key in self.planned if key in self.results]

    def of(self, units: Iterable[Unit]) -> list[Result]:
        """Return the results of these units, of those that have one."""
        return [self.results[unit.key] for unit in units if unit.key in self.results]

    def save(self) -> None:
        """Write the file atomically, if there is a path. Raises OSError."""
        if self.path is None:
            return
        self.older = sum(not self._is_new(result) for result in self.results.values())
        as_read = replace(self, origins={})  # older results count until they are replaced
        planned = [key for key in self.planned if key in self.results or as_read.is_needed(key)]
        data: dict[str, object] = {"machine": self.machine, "older": self.older, "planned": planned}
        data["results"] = [asdict(result) for result in self.ordered()]
        data["causes"] = [[*result.key, asdict(cause)] for result in self.ordered() if (cause := self.cause(result))]
        with atomic_file(self.path) as file:
            file.write(json.dumps(data, indent=1, ensure_ascii=False).encode())


def load(path: Path) -> Store:
    """Read a file that `Store.save` wrote. Raises UsageError with one line for any other file."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        planned = [(int(case), str(variant), str(setting)) for case, variant, setting in data["planned"]]
        results = [read_result(row) for row in data["results"]]
        by_key = {result.key: result for result in results}
        causes = {(case, variant, setting): Cause(**row) for case, variant, setting, row in data["causes"]}
        return Store(path, planned, by_key, str(data["machine"]), causes, int(data["older"]))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path} is not a results file of `stress --json`") from None


def read_result(row: dict[str, Any]) -> Result:
    """Return the result that a JSON object describes."""
    failure = row["failure"] and Failure(**row["failure"])
    return Result(**row | {"failure": failure, "figures": [Measurement(**figure) for figure in row["figures"]]})
