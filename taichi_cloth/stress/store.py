"""Results in a JSON file that is whole after every unit, so that a run can be broken off and gone on with."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..bench.report import machine
from ..errors import WrongUse
from ..files import whole_file
from .causes import EXPERIMENTS, Cause
from .origin import origin
from .setting import ROBUST, ROBUST_SLACK
from .trial import Figure
from .unit import ALIVE, Failure, Key, Result, Unit


@dataclass
class Store:
    """Results by unit, and all units that there are. `path` is where they are written after every one."""

    path: Path | None = None
    planned: list[Key] = field(default_factory=list)
    results: dict[Key, Result] = field(default_factory=dict)
    machine: str = ""
    causes: dict[Key, Cause] = field(default_factory=dict)  # of failures
    older: int = 0  # results of an older program, when it was written
    origins: dict[Key, str] = field(default_factory=dict, compare=False)  # that a result has if it is run now

    @classmethod
    def new(cls, path: Path | None, planned: Iterable[Unit]) -> Store:
        origins = {unit.key: origin(unit) for unit in planned}
        return cls(path, list(origins), {}, " · ".join(machine().values()), origins=origins)

    def add(self, result: Result) -> None:
        """Keeps a result, in place of an older one, with where it comes from. Raises OSError."""
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
        self.results[result.key] = replace(result, origin=self.origins[result.key], date=now, machine=self.machine)
        self.save()

    def left(self, units: Iterable[Unit], starts: int) -> list[Unit]:
        """Those without a result of this program and of so many starts, or more. A failure is final, and so is a frame
        that takes too long: more starts cannot change them.
        """
        return [unit for unit in units if not self._has(unit.key, starts)]

    def is_needed(self, key: Key) -> bool:
        """Whether a unit belongs to a run of all: `robust-slack` shows what another material changes, and so it runs
        the cases that the same cloth did not survive with `robust`.
        """
        case, _, setting = key
        same = [other for other in self.planned if other[0] == case and other[2] == ROBUST.name]
        return setting != ROBUST_SLACK.name or not same or not all(map(self._survived, same))

    def _survived(self, key: Key) -> bool:
        """With the present program, as far as that is known: a store that was only read has no origins."""
        found = self.results.get(key)
        return found is not None and found.state == ALIVE and (not self.origins or self._is_new(found))

    def _has(self, key: Key, starts: int) -> bool:
        found = self.results.get(key)
        return found is not None and self._is_new(found) and (found.starts >= starts or found.state != ALIVE)

    def _is_new(self, result: Result) -> bool:
        return result.origin == self.origins[result.key]

    def continued(self, older: Store) -> Store:
        """This plan, with what an older file has of it, whatever its origin."""
        kept = {key: older.results[key] for key in self.planned if key in older.results}
        count = sum(not self._is_new(result) for result in kept.values())
        return replace(self, results=kept, causes=older.causes, older=count)

    def explain(self, key: Key, cause: Cause) -> None:
        """Keeps what experiments showed about a failure. Raises OSError."""
        self.causes[key] = replace(cause, origin=self.results[key].origin)
        self.save()

    def cause(self, result: Result) -> Cause | None:
        """What experiments showed, if it is still about this failure."""
        cause = self.causes.get(result.key)
        return cause if cause is not None and cause.is_of(result) else None

    def reason(self, result: Result) -> str:
        """Why it failed, as an experiment showed; empty where none did."""
        cause = self.cause(result)
        return cause.shown if cause else ""

    def unexplained(self, results: Iterable[Result]) -> list[Result]:
        return [result for result in results if result.failure and not self.reason(result)]

    def untried(self, units: Iterable[Unit]) -> list[tuple[Unit, Failure]]:
        """Those that failed, and on which not all experiments were made."""
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
        """As planned."""
        return [self.results[key] for key in self.planned if key in self.results]

    def of(self, units: Iterable[Unit]) -> list[Result]:
        return [self.results[unit.key] for unit in units if unit.key in self.results]

    def save(self) -> None:
        if self.path is None:
            return
        self.older = sum(not self._is_new(result) for result in self.results.values())
        planned = [key for key in self.planned if key in self.results or self.is_needed(key)]
        words: dict[str, Any] = {"machine": self.machine, "older": self.older, "planned": planned}
        words["results"] = [asdict(result) for result in self.ordered()]
        words["causes"] = [[*result.key, asdict(cause)] for result in self.ordered() if (cause := self.cause(result))]
        with whole_file(self.path) as file:
            file.write(json.dumps(words, indent=1, ensure_ascii=False).encode())


def load(path: Path) -> Store:
    """What `Store.save` wrote. Raises WrongUse, one line, for a file that is none."""
    try:
        words = json.loads(path.read_text(encoding="utf-8"))
        planned = [(int(case), str(variant), str(setting)) for case, variant, setting in words["planned"]]
        results = [read_result(row) for row in words["results"]]
        by_key = {result.key: result for result in results}
        causes = {(case, variant, setting): Cause(**row) for case, variant, setting, row in words["causes"]}
        return Store(path, planned, by_key, str(words["machine"]), causes, int(words["older"]))
    except OSError as error:
        raise WrongUse(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise WrongUse(f"{path} holds no results of stress: {error!r}") from None


def read_result(row: dict[str, Any]) -> Result:
    failure = row["failure"] and Failure(**row["failure"])
    return Result(**row | {"failure": failure, "figures": [Figure(**figure) for figure in row["figures"]]})
