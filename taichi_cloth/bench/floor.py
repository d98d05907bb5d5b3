"""The same frames in C and JavaScript: `benchmarks/floor` of a checkout. A wheel has none."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import taichi_cloth

FLOOR = Path(taichi_cloth.__file__).parents[1] / "benchmarks" / "floor" / "floor.py"


class FloorTimer:
    """Times programs of the floor; those that cannot be had here are named with the reason in `missing`."""

    def __init__(self, file: Path = FLOOR) -> None:
        self.missing: dict[str, str] = {}
        self._module = _load(file)

    def median_ms(
        self, program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int
    ) -> float | None:
        """Median milliseconds of a frame; None, with a reason in `missing`, where it cannot be had."""
        if self._module is None:
            self.missing["C, JavaScript"] = "benchmarks/floor is only in a checkout"
            return None
        try:
            line = self._module.time_floor(program, rows, columns, substeps, iterations, frames)
        except self._module.FloorError as error:
            self.missing[f"{program} {columns}×{rows}"] = str(error)
            return None
        if line is None:
            what, why = ("JavaScript", "no node") if program == "frame" else ("C", "no compiler ($CC, cc, gcc, clang)")
            self.missing[what] = why
            return None
        return float(line["median_ms"])


def _load(file: Path) -> ModuleType | None:
    spec = importlib.util.spec_from_file_location("taichi_cloth_floor", file) if file.exists() else None
    if spec is None or spec.loader is None:
        return None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
