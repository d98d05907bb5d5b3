"""Lines for the user that are no errors."""

from __future__ import annotations

import sys


def note(line: str) -> None:
    """Prints one line on stderr, with the program's name."""
    print(f"taichi-cloth: {line}", file=sys.stderr, flush=True)
