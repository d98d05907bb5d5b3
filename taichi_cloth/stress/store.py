"""Results in a JSON file that is whole after every unit, so that a run can be broken off and gone on with."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from ..bench.report import machine
from ..errors import WrongUse
from ..files import whole_file
from .trial import Figure
from .unit import ALIVE, Failure, Key, Result, Unit

PACKAGE = Path(__file__).parents[1]
SOURCES = ("scene", "mesh", "kernels", "state", "contact", "solvers", "measure", "reference", "stress")  # packages
FILES = ("simulation", "controls_row", "given", "hand", "hands", "scene_solver", "scene_stages", "runtime")
# What only chooses, runs side by side, stores and shows changes no result.
NOT_RESULTS = ("choose.py", "running.py", "store.py", "report.py", "page.py", "known.py", "picture.py")


@cache
def origin() -> str:
    """A fingerprint of what results depend on: sources of physics and judging, and versions.

    The processor is no part of it, so that a run can go on elsewhere; every result says where it was made.
    """
    versions = {name: value for name, value in machine().items() if name not in ("cpu", "cores")}
    digest = hashlib.sha256("\n".join(versions.values()).encode())
    paths = [path for name in SOURCES for path in (PACKAGE / name).rglob("*.py")]
    paths += [PACKAGE / f"{name}.py" for name in FILES]
    for path in sorted(paths):
        if path.parent.name != "stress" or path.name not in NOT_RESULTS:
            digest.update(path.relative_to(PACKAGE).as_posix().encode())
            digest.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()[:12]


@dataclass
class Store:
    """Results by unit, and all units that there are. `path` is where they are written after every one."""

    path: Path | None = None
    planned: list[Key] = field(default_factory=list)
    results: dict[Key, Result] = field(default_factory=dict)
    machine: str = ""

    @classmethod
    def new(cls, path: Path | None, planned: Iterable[Unit]) -> Store:
        return cls(path, [unit.key for unit in planned], {}, " · ".join(machine().values()))

    def add(self, result: Result) -> None:
        """Keeps a result, in place of an older one, with where it comes from. Raises OSError."""
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
        self.results[result.key] = replace(result, origin=origin(), date=now, machine=self.machine)
        self.save()

    def left(self, units: Iterable[Unit], starts: int) -> list[Unit]:
        """Those without a result of this origin and of so many starts, or more. A failure is final, and so is a frame
        that takes too long: more starts cannot change them.
        """
        return [unit for unit in units if not self._has(unit.key, starts)]

    def _has(self, key: Key, starts: int) -> bool:
        found = self.results.get(key)
        return found is not None and found.origin == origin() and (found.starts >= starts or found.state != ALIVE)

    def continued(self, older: Store) -> Store:
        """This plan, with the results of an older file that are still of it, whatever their origin."""
        kept = {key: older.results[key] for key in self.planned if key in older.results}
        return replace(self, results=kept)

    def ordered(self) -> list[Result]:
        """As planned."""
        return [self.results[key] for key in self.planned if key in self.results]

    def of(self, units: Iterable[Unit]) -> list[Result]:
        return [self.results[unit.key] for unit in units if unit.key in self.results]

    def save(self) -> None:
        if self.path is None:
            return
        words: dict[str, Any] = {"machine": self.machine, "planned": self.planned}
        words["results"] = [asdict(result) for result in self.ordered()]
        with whole_file(self.path) as file:
            file.write(json.dumps(words, indent=1, ensure_ascii=False).encode())


def load(path: Path) -> Store:
    """What `Store.save` wrote. Raises WrongUse, one line, for a file that is none."""
    try:
        words = json.loads(path.read_text(encoding="utf-8"))
        planned = [(int(case), str(variant), str(setting)) for case, variant, setting in words["planned"]]
        results = [read_result(row) for row in words["results"]]
        return Store(path, planned, {result.key: result for result in results}, str(words["machine"]))
    except OSError as error:
        raise WrongUse(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise WrongUse(f"{path} holds no results of stress: {error!r}") from None


def read_result(row: dict[str, Any]) -> Result:
    failure = row["failure"] and Failure(**row["failure"])
    return Result(**row | {"failure": failure, "figures": [Figure(**figure) for figure in row["figures"]]})
