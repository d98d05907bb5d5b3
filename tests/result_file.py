"""Small result files next to the tests: results of runs of hours, with the tested commit."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taichi_cloth.scene.keys import toml_value

ROOT = Path(__file__).parents[1]


def written(title: str, tables: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the tables as TOML, below a comment."""
    lines = [title]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(f'"{key}" = {toml_value(value)}' for key, value in table.items())]
    return "\n".join([*lines, ""])


def commit() -> str:
    """Return the commit of the working tree, with a + if files have changed."""
    done = subprocess.run(["git", "describe", "--always", "--dirty=+"], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else "unknown"
