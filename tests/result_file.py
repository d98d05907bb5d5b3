"""Small result files beside the tests: what a run of hours found, with the commit that was tried."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taichi_cloth.scene.writer import toml_value

ROOT = Path(__file__).parents[1]


def written(title: str, tables: Mapping[str, Mapping[str, Any]]) -> str:
    """The tables as TOML, below a comment."""
    lines = [title]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(f'"{key}" = {toml_value(value)}' for key, value in table.items())]
    return "\n".join([*lines, ""])


def commit() -> str:
    """The commit of the working tree, with a + where something is changed in it."""
    said = subprocess.run(["git", "describe", "--always", "--dirty=+"], cwd=ROOT, capture_output=True, text=True)
    return said.stdout.strip() if said.returncode == 0 else "unknown"
