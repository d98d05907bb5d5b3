"""What a mutation is: one deliberate fault in the program, and the tests that must fail because of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Mutation:
    """`old` occurs exactly once in `file`; with `new` in its place at least one of `tests` fails."""

    name: str
    file: str  # within `taichi_cloth/`
    old: str
    new: str
    tests: tuple[str, ...]  # pytest node ids, within `tests/`

    @property
    def path(self) -> Path:
        """The file, from the root of the repository."""
        return Path("taichi_cloth") / self.file

    @property
    def node_ids(self) -> list[str]:
        """The tests, from the root of the repository."""
        return [f"tests/{test}" for test in self.tests]

    def applied(self, text: str) -> str:
        """The file's text with the fault. Raises ValueError where `old` is not there exactly once."""
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.name}: {self.path} has {count} places for {self.old!r}, not one")
        return text.replace(self.old, self.new)
