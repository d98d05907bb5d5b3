"""What `bench` measures: solvers at their default settings, on small to large grids, and the curtain's features.

Also the programs in C and JavaScript that compute the same frames: `benchmarks/floor`, not part of a wheel.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from types import ModuleType
from typing import Any

import taichi_cloth

from ...geometry.scene_loader import load_scene
from ...scene import Scene
from ...scene.collider_schema import RESPONSES
from ...scene.fabric_schema import Fabric
from ...scene.schema import Cloth, Forces, Solver, sections
from ...scene.solver_catalog import SOLVER_CATALOG
from ...solvers import LAYOUTS, SOLVERS

FLOOR = Path(taichi_cloth.__file__).parents[1] / "benchmarks" / "floor" / "floor.py"


class NativeTimer:
    """Times the native programs. `missing` names those that cannot run here, each with the reason."""

    def __init__(self, file: Path = FLOOR) -> None:
        self.missing: dict[str, str] = {}
        self._module = _load(file)

    def median_ms(
        self, program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int
    ) -> float | None:
        """Return the median frame time of a program [ms]; None, with the reason in `missing`, if it cannot run."""
        if self._module is None:
            self.missing["C, JavaScript"] = "benchmarks/floor is only in a checkout"
            return None
        try:
            result = self._module.time_floor(program, rows, columns, substeps, iterations, frames)
        except self._module.FloorError as error:
            self.missing[f"{program} {columns}×{rows}"] = str(error)
            return None
        if result is None:
            what, why = ("JavaScript", "no node") if program == "frame" else ("C", "no compiler ($CC, cc, gcc, clang)")
            self.missing[what] = why
            return None
        return float(result["median_ms"])


def _load(file: Path) -> ModuleType | None:
    """Return the module of a file, or None if it does not exist."""
    spec = importlib.util.spec_from_file_location("taichi_cloth_floor", file) if file.exists() else None
    if spec is None or spec.loader is None:
        return None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FRAME_RATES = (360, 144, 60)  # frame rates [1/s]: 2.8, 6.9 and 16.7 ms for a frame

DEMO_GRID = (24, 30)  # rows, columns of the browser demos
SQUARES = ((64, 64), (128, 128), (256, 256))
LARGEST = (512, 512)  # takes most solvers, and the serial layout, minutes: only for these, in their other layouts
LARGEST_FOR = ("verlet", "explicit", "lines")

FEATURES_REMOVED = ("wind", "sphere", "ground", "shear", "bend")
FEATURES_ADDED = ("strain_limit", "tethers")
OTHER_RESPONSES = RESPONSES[1:]  # of the sphere


@dataclass(frozen=True)
class Case:
    """One measurement. Cells are square on any grid."""

    scene: str
    """`curtain`, the frame of the browser demos, or `sheet`: horizontal, pinned at two corners, no wind, no sphere."""
    solver: str
    rows: int = DEMO_GRID[0]
    columns: int = DEMO_GRID[1]
    substeps: int = SOLVER_CATALOG["verlet"].substeps
    iterations: int = SOLVER_CATALOG["verlet"].iterations
    layout: str | None = None
    """Chosen by the grid if None."""
    change: str = "-ground"
    """A feature removed (`-wind`) or added (`+tethers`), or another response of the sphere (`=repulsion`).

    The browser demos have no ground.
    """

    @property
    def name(self) -> str:
        """Solver, columns × rows, and layout if it is set."""
        return " ".join(filter(None, [self.solver, f"{self.columns}×{self.rows}", self.layout]))


@dataclass(frozen=True)
class NativePrograms:
    """The programs of benchmarks/floor that compute the frame of a case, by name; None where there is none."""

    in_c: str | None
    in_javascript: str | None


def case_of(solver: str, grid: tuple[int, int] = DEMO_GRID, layout: str | None = None) -> Case:
    """Return the case of a solver at its default setting: on `sheet` for explicit solvers, else on `curtain`.

    These are the scenes that benchmarks/floor computes.
    """
    scene = "curtain" if not SOLVERS[solver].info.is_explicit else "sheet"
    return Case(scene, solver, *grid, *SOLVER_CATALOG[solver].defaults, layout)


def default_cases() -> list[Case]:
    """Return the cases of `bench` by default, which take a minute on two cores."""
    cases = [case_of(name) for name in SOLVERS]
    cases.insert(1, case_of("verlet", layout="serial"))
    larger = (("verlet", (64, 64)), ("verlet", (128, 128)), ("explicit", (96, 96)), ("lines", (128, 128)))
    return cases + [case_of(name, grid) for name, grid in larger if name in SOLVERS]


def all_cases() -> list[Case]:
    """Return the cases of `bench --all`: every solver in each layout, on every grid."""
    return [
        case_of(name, grid, layout)
        for name, kind in SOLVERS.items()
        for layout in LAYOUTS
        for grid in (DEMO_GRID, *SQUARES, *[LARGEST] * (name in LARGEST_FOR and layout != "serial"))
    ]


def feature_cases() -> list[Case]:
    """Return the curtain with all its features, then with one removed, one added, and other responses of its sphere."""
    added = [name for name in FEATURES_ADDED if name in sections()]
    changes = ["", *(f"-{name}" for name in FEATURES_REMOVED), *(f"+{name}" for name in added)]
    changes += [f"={name}" for name in OTHER_RESPONSES]
    return [replace(case_of("verlet"), change=change) for change in changes]


def native_programs_of(case: Case) -> NativePrograms:
    """Return the programs in C and JavaScript that compute the frame of a case.

    JavaScript only computes the grid of the browser demos: larger grids take it too long.
    """
    demo = case.solver == "verlet" and case.scene == "curtain"
    explicit = case.solver == "explicit" and case.scene == "sheet"
    in_javascript = "frame" if demo and (case.rows, case.columns) == DEMO_GRID else None
    return NativePrograms("relax" if demo else "explicit" if explicit else None, in_javascript)


def scene_of(case: Case) -> Scene:
    """Return the scene of a case."""
    settings = {"solver": case.solver, "substeps": case.substeps, "iterations": case.iterations}
    curtain = load_scene("curtain", rows=case.rows, columns=case.columns, **settings)
    if case.scene == "sheet":
        width = 1.45  # [m] all values of this scene are those of benchmarks/floor/explicit.c
        return Scene(
            name="sheet",
            cloth=Cloth(
                rows=case.rows,
                columns=case.columns,
                width=width,
                height=width * (case.rows - 1) / (case.columns - 1),
                rotation=(-90.0, 0.0, 0.0),
                area_density=0.2,
                pins=("top-left", "top-right"),
            ),
            fabric=Fabric(warp=2000, weft=2000, shear=1000, bend_spring=20),
            solver=Solver(case.solver, case.substeps, case.iterations, damping=1.0),
            forces=Forces(gravity=9.81),
        )
    top = curtain.cloth.center[1] + curtain.cloth.height / 2
    height = curtain.cloth.width * (case.rows - 1) / (case.columns - 1)
    cloth = replace(curtain.cloth, height=height, center=(0.0, top - height / 2, 0.0))
    return with_change(replace(curtain, cloth=cloth), case.change)


def with_change(scene: Scene, change: str) -> Scene:
    """Return a scene without a feature or spring family (`-wind`, `-bend`), with one more (`+tethers`), or with another
    contact response of its spheres (`=repulsion`).
    """
    sign, name = change[:1], change[1:]
    new: dict[str, Any] = {}
    if sign == "-" and name in ("shear", "bend"):
        fabric: dict[str, Any] = {"bend_spring" if name == "bend" else name: 0.0}
        new = {"verlet": replace(scene.verlet, **{name: 0.0}), "fabric": replace(scene.fabric, **fabric)}
    elif sign == "-":
        new = {f"{name}s": ()} if name == "sphere" else {name: None}
    elif sign == "=":
        new = {"spheres": tuple(replace(sphere, response=name) for sphere in scene.spheres)}
    elif sign == "+":
        new = {name: sections()[name].cls()}
    return replace(scene, **new)


def static_strain(scene: Scene) -> float:
    """Return the largest strain of the cloth at rest, hanging from its top edge: that part of the strain is no error.

    The top row carries the weight of the sheet, ρ·g·height [N] per meter of width. 0 for solvers without SI constants,
    whose cloth should not stretch. NaN for a cloth pinned at points, where the strain grows with the resolution.
    """
    if SOLVERS[scene.solver.name].info.stiffness_section == "verlet":
        return 0.0
    if "top" not in scene.cloth.pins:
        return float("nan")
    return scene.cloth.area_density * scene.forces.gravity * scene.cloth.height / (scene.fabric.warp or inf)


def highest_rate(ms: float) -> int:
    """Return the highest frame rate of `FRAME_RATES` that a frame time [ms] allows; 0 if none."""
    return next((rate for rate in FRAME_RATES if ms <= 1000 / rate), 0)


def filter_cases(cases: Sequence[Case], solver: str | None) -> list[Case]:
    """Return the cases of one solver, or all."""
    return [case for case in cases if solver in (None, case.solver)]
