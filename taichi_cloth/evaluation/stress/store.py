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
from ...system.console import count_noun, machine, new_file
from ...system.errors import UsageError
from .causes import Cause
from .setup import ROBUST, ROBUST_SLACK
from .trial import Measurement
from .unit import ALIVE, SLOW, Failure, Key, Result, Unit

PACKAGE = Path(__file__).parents[2]
JUDGING_MODULES = ("invariants", "setup", "trial", "unit")  # modules of this folder that judge
MINUTES = "%Y-%m-%d %H:%M"
DRAWING = "render/"  # a folder that changes no result
CASES = "evaluation/stress/"  # the folder of the judging modules and of those with cases
Symbol = tuple[str, str]  # a module with cases, and a name in it
PUBLIC_API = "__init__.py"  # it imports what scripts use, of which a result uses only what the other files import
SOLVER_SWITCH_CASES = "changes"  # the module whose cases switch solvers


def fingerprint(unit: Unit) -> str:
    """Return the fingerprint of a unit, 12 hex digits.

    It covers the sources of the physics and checks that the unit runs, its numbers, and versions. Of a module with
    cases only the functions and values count that the variant uses, and the module of a solver only for its own
    settings. The processor does not count, so that a run can continue on another machine; each result names its
    machine. Texts of a case do not count either: they change no result.
    """
    versions = [value for name, value in machine().items() if name not in ("cpu", "cores")]
    calls = list(called(unit.variant.run))
    functions = [call.split(".")[-2:] for call in calls if call.startswith(__package__)]
    words = [*versions, str(unit.case.number), unit.variant.name, repr(unit.setting), *calls]
    found = sources(unit.setting.solver.name, frozenset((module, name) for module, name in functions))
    words += [f"{name} {digest}" for name, digest in found]
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
def sources(solver: str, functions: frozenset[Symbol]) -> list[tuple[str, str]]:
    """Return the sources that a result depends on, by name, with digests of their contents.

    These are the judging modules, the solver and everything they import, each a file, and what the functions of a case
    use of the modules with cases.
    """
    used, files = symbols(functions)
    solvers = SOLVER_NAMES if any(module == SOLVER_SWITCH_CASES for module, _ in functions) else (solver,)
    roots = {f"{CASES}{name}.py" for name in JUDGING_MODULES}
    roots |= {f"solvers/{name}.py" for name in solvers}  # loaded by name, so not among the imports
    roots |= {path.relative_to(PACKAGE).as_posix() for path in files}
    parts = [(f"{module}.{name}", digest_of_nodes(nodes)) for (module, name), nodes in used.items()]
    return sorted([*parts, *files_behind(frozenset(roots))])


@cache
def files_behind(roots: frozenset[str]) -> list[tuple[str, str]]:
    """Return these files of the package and all that they import, by name, with digests of their contents."""
    found: set[str] = set()
    pending = set(roots)
    while pending:
        found |= pending
        names = {path.relative_to(PACKAGE).as_posix() for name in pending for path in imported(PACKAGE / name)}
        pending = {name for name in names - found if not name.startswith(DRAWING) and name != PUBLIC_API}
    return [(name, digest((PACKAGE / name).read_bytes())) for name in found]


def symbols(functions: Iterable[Symbol]) -> tuple[dict[Symbol, list[ast.stmt]], set[Path]]:
    """Return what functions of modules with cases use of these modules, and the files that they import from.

    A name stands for the statements that define or import it (`bound_names`).
    """
    used: dict[Symbol, list[ast.stmt]] = {}
    files: set[Path] = set()
    pending = {(module, name) for module, name in functions if module not in JUDGING_MODULES}
    while pending:
        module, name = symbol = pending.pop()
        path = PACKAGE / f"{CASES}{module}.py"
        nodes = [binding(node, name) for node in statements(path.read_bytes()) if name in bound_names(node)]
        used[symbol] = nodes
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module not in (None, *JUDGING_MODULES):
                pending.add((str(node.module), node.names[0].name))
            elif isinstance(node, ast.ImportFrom):
                files |= set(imported_by(path, node))
            else:
                names = {other.id for other in ast.walk(node) if isinstance(other, ast.Name)}
                pending |= {(module, other) for other in names}
        pending -= used.keys()
    return {symbol: nodes for symbol, nodes in used.items() if nodes}, files


def binding(node: ast.stmt, name: str) -> ast.stmt:
    """Return a statement that binds a name; of an import only what binds this name."""
    match node:
        case ast.ImportFrom():
            [one] = [alias for alias in node.names if name == (alias.asname or alias.name)]
            return ast.ImportFrom(node.module, [one], node.level)
    return node


def bound_names(node: ast.stmt) -> set[str]:
    """Return the names that a statement of a module defines or imports."""
    match node:
        case ast.FunctionDef() | ast.ClassDef():
            return {node.name}
        case ast.Assign():
            return {one.id for target in node.targets for one in ast.walk(target) if isinstance(one, ast.Name)}
        case ast.AnnAssign(target=ast.Name(id=name)):
            return {name}
        case ast.Import() | ast.ImportFrom():
            return {alias.asname or alias.name.partition(".")[0] for alias in node.names}
    return set()


def imported(path: Path) -> Iterator[Path]:
    """Yield the modules of the package that a file names in its relative imports."""
    for node in relative_imports(path.read_bytes()):
        yield from imported_by(path, node)


def imported_by(path: Path, node: ast.ImportFrom) -> Iterator[Path]:
    """Yield the modules of the package that a relative import in a file names; none if it is absolute."""
    if node.level:
        folder = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
        inside = [folder / f"{name}.py" for name in ("__init__", *(alias.name for alias in node.names))]
        yield from (one for one in (folder.with_suffix(".py"), *inside) if one.is_file())


@cache
def relative_imports(source: bytes) -> list[ast.ImportFrom]:
    """Return every relative import in a source."""
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom) and node.level]


@cache
def statements(source: bytes) -> list[ast.stmt]:
    """Return the statements of a module."""
    return ast.parse(source).body


@cache
def digest(source: bytes) -> str:
    """Return the digest of a module."""
    return digest_of_nodes(statements(source))


def digest_of_nodes(nodes: Iterable[ast.stmt]) -> str:
    """Return the SHA-256 of statements without their comments, docstrings and line breaks, which change no result."""
    tree = ast.Module(list(nodes), [])
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [line for line in body if not is_text(line)]  # type: ignore[attr-defined]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def is_text(line: ast.stmt) -> bool:
    """Return whether a statement is a docstring."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


def texts_of(unit: Unit) -> dict[str, Any]:
    """Return the texts of a unit's case, by the name of the field of `Result`."""
    case = unit.case
    return {"name": case.name, "parameters": case.parameters, "about": case.note}


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
    repeat_seconds: dict[Key, float] = field(default_factory=dict)
    """CPU time that a confirmed unit takes now [s], by the start that confirmed it."""
    origins: dict[Key, str] = field(default_factory=dict, compare=False)
    """Fingerprint of each unit if it ran now."""
    texts: dict[Key, dict[str, Any]] = field(default_factory=dict, compare=False)
    """What a result says of the case of each unit."""

    @classmethod
    def new(cls, path: Path | None, planned: Iterable[Unit]) -> Store:
        """Return a store for these units, without results, on this machine."""
        units = {unit.key: unit for unit in planned}
        origins = {key: fingerprint(unit) for key, unit in units.items()}
        texts = {key: texts_of(unit) for key, unit in units.items()}
        return cls(path, list(origins), {}, " · ".join(machine().values()), origins=origins, texts=texts)

    def add(self, result: Result) -> None:
        """Add or replace a result, with fingerprint, date and machine, and write the file. Raises OSError."""
        now = datetime.now(UTC).strftime(MINUTES)
        self.results[result.key] = replace(result, origin=self.origins[result.key], date=now, machine=self.machine)
        self.repeat_seconds.pop(result.key, None)
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

    def drop_unneeded(self) -> None:
        """Drop results that a run of all units does not include, and write the file. Raises OSError."""
        self.results = {key: result for key, result in self.results.items() if self.is_needed(key)}
        self.save()

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

        A result that is too slow depends on the speed of the program, which no digest tells. Those of `robust-slack`
        are left out if `robust` survived, by its results of any version.
        """
        as_read = replace(self, origins={})
        stored = [unit for unit in units if unit.key in self.results and as_read.is_needed(unit.key)]
        return [unit for unit in stored if self._is_repeatable(self.results[unit.key])]

    def _is_repeatable(self, result: Result) -> bool:
        return not self._is_new(result) and bool(result.digest) and result.state != SLOW

    def repeat(self, again: Result) -> bool:
        """Take over an earlier result if this version of the program repeated its last start bit by bit (`again`).

        The result keeps its times and its machine: equal digests show the same computation on any processor.

        Writes the file, and returns whether the digests are equal.
        Raises OSError.
        """
        earlier = self.results[again.key]
        if again.digest != earlier.digest:
            return False
        now, cause = datetime.now(UTC).strftime(MINUTES), self.cause(earlier)
        self.results[again.key] = self._renamed(replace(earlier, origin=self.origins[again.key], repeated=now))
        self.repeat_seconds[again.key] = again.opening + again.seconds * earlier.ran
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
        results = {key: self._renamed(older.results[key]) for key in self.planned if key in older.results}
        count = sum(not self._is_new(result) for result in results.values())
        return replace(self, results=results, causes=older.causes, older=count, repeat_seconds=older.repeat_seconds)

    def _renamed(self, result: Result) -> Result:
        """Return a result of this version with the present texts of its case, which are not in its fingerprint."""
        return replace(result, **self.texts[result.key]) if self._is_new(result) else result

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

    def untried(self, units: Iterable[Unit]) -> list[tuple[Unit, Failure, int]]:
        """Return failed units without a cause, their failures and how many experiments have run, if not all have."""
        found = []
        for unit in units:
            result = self.results.get(unit.key)
            if result is None or result.failure is None:
                continue
            cause = self.cause(result)
            if cause is None or not cause.is_final:
                found.append((unit, result.failure, 0 if cause is None else cause.experiments))
        return found

    def ordered(self) -> list[Result]:
        """Return all results in the order of the plan."""
        return [self.results[key] for key in self.planned if key in self.results]

    def of(self, units: Iterable[Unit]) -> list[Result]:
        """Return the results of these units, of those that have one."""
        return [self.results[unit.key] for unit in units if unit.key in self.results]

    def present_seconds(self) -> float:
        """Return the CPU time of all units [s], of each as it takes now if a start confirmed it."""
        return sum(self.repeat_seconds.get(result.key, result.seconds) for result in self.ordered())

    def save(self) -> None:
        """Write the file atomically, if there is a path. Raises OSError."""
        if self.path is None:
            return
        self.older = sum(not self._is_new(result) for result in self.results.values())
        as_read = replace(self, origins={})  # older results count until they are replaced
        planned = [key for key in self.planned if key in self.results or as_read.is_needed(key)]
        data: dict[str, object] = {"machine": self.machine, "older": self.older, "planned": planned}
        data["results"] = [asdict(result) for result in self.ordered()]
        data["repeat_seconds"] = [[*key, self.repeat_seconds[key]] for key in planned if key in self.repeat_seconds]
        data["causes"] = [[*result.key, asdict(cause)] for result in self.ordered() if (cause := self.cause(result))]
        with new_file(self.path) as file:
            file.write(json.dumps(data, indent=1, ensure_ascii=False).encode())


def load(path: Path) -> Store:
    """Read a file that `Store.save` wrote. Raises UsageError with one line for any other file."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        planned = [(int(case), str(variant), str(setting)) for case, variant, setting in data["planned"]]
        results = [read_result(row) for row in data["results"]]
        by_key = {result.key: result for result in results}
        causes = {(case, variant, setting): Cause(**row) for case, variant, setting, row in data["causes"]}
        seconds = {(case, variant, setting): float(s) for case, variant, setting, s in data.get("repeat_seconds", [])}
        return Store(path, planned, by_key, str(data["machine"]), causes, int(data["older"]), seconds)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path} is not a results file of `stress --json`") from None


def read_result(row: dict[str, Any]) -> Result:
    """Return the result that a JSON object describes."""
    failure = row["failure"] and Failure(**row["failure"])
    return Result(**row | {"failure": failure, "figures": [Measurement(**figure) for figure in row["figures"]]})
