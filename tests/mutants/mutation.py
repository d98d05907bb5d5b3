"""A mutation: one deliberate fault in the program, and the tests that must fail because of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Mutation:
    """Replaces `old`, which occurs exactly once in `file`, by `new`; at least one of `tests` must then fail."""

    name: str
    file: str  # relative to `taichi_cloth/`
    old: str
    new: str
    tests: tuple[str, ...]  # pytest node ids, relative to `tests/`

    @property
    def path(self) -> Path:
        """The file, relative to the root of the repository."""
        return Path("taichi_cloth") / self.file

    @property
    def node_ids(self) -> list[str]:
        """The node ids of the tests, relative to the root of the repository."""
        return [f"tests/{test}" for test in self.tests]

    def applied(self, text: str) -> str:
        """Return the text of the file with the fault. Raises ValueError if `old` does not occur exactly once."""
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.name}: {self.path} contains {self.old!r} {count} times, not once")
        return text.replace(self.old, self.new)
