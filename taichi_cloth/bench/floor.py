"""The same frames in C and JavaScript: `benchmarks/floor` of a checkout. A wheel has none."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import taichi_cloth

NARROW = 4  # floats in a register: what every x86-64 and ARM has, and what Taichi takes on processors new to its LLVM
FLOOR = Path(taichi_cloth.__file__).parents[1] / "benchmarks" / "floor" / "floor.py"


class FloorTimer:
    """Times programs of the floor; those that cannot be had here are named with the reason in `missing`."""

    def __init__(self, file: Path = FLOOR) -> None:
        self.missing: dict[str, str] = {}
        self._lanes: dict[str, int] = {}  # floats that a program treats at once
        self._module = _load(file)

    def median_ms(
        self, program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int
    ) -> float | None:
        """Median milliseconds of a frame; None, with a reason in `missing`, where it cannot be had."""
        line = self._line(program, rows, columns, substeps, iterations, frames)
        if line is None:
            return None
        self._lanes[program] = line.get("lanes", 1)
        return float(line["median_ms"])

    def narrow_ms(
        self, program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int
    ) -> float | None:
        """The same in C with four floats at once, after `median_ms`; None where registers hold no more anyway."""
        if program not in self._lanes:
            return None
        if self._lanes[program] <= NARROW:
            self.missing["÷ C 4"] = f"C takes {NARROW} floats at once here anyway"
            return None
        line = self._line(program, rows, columns, substeps, iterations, frames, NARROW)
        return None if line is None else float(line["median_ms"])

    def _line(self, program: str, rows: int, columns: int, *numbers: int) -> dict[str, Any] | None:
        if self._module is None:
            self.missing["C, JavaScript"] = "benchmarks/floor is only in a checkout"
            return None
        try:
            line: dict[str, Any] | None = self._module.time_floor(program, rows, columns, *numbers)
        except self._module.FloorError as error:
            self.missing[f"{program} {columns}×{rows}"] = str(error)
            return None
        if line is None:
            what, why = ("JavaScript", "no node") if program == "frame" else ("C", "no compiler ($CC, cc, gcc, clang)")
            self.missing[what] = why
        return line


def _load(file: Path) -> ModuleType | None:
    spec = importlib.util.spec_from_file_location("taichi_cloth_floor", file) if file.exists() else None
    if spec is None or spec.loader is None:
        return None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
