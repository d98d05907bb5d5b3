"""What is measured: the solvers with their usual settings, on grids from small to large, and the curtain's stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any

from ..scene import Scene, load_scene
from ..scene.model import RESPONSES, USUAL, Cloth, Fabric, Forces, Solver, parts
from ..solvers import SOLVERS

BUDGETS = (360, 144, 60)  # pictures a second: 2.8, 6.9 and 16.7 ms for a frame

SEED_GRID = (24, 30)  # rows, columns of the browser demos
SQUARES = ((64, 64), (128, 128), (256, 256))
LARGEST = (512, 512)  # minutes for most methods, and for springs one by one: only of these, on their other paths
LARGEST_FOR = ("verlet", "spring", "lines")

STAGES_LEFT_OUT = ("wind", "sphere", "ground", "shear", "bend")
STAGES_ADDED = ("limit", "tethers")
OTHER_RESPONSES = RESPONSES[1:]  # of the ball


@dataclass(frozen=True)
class Case:
    """One measurement. On `curtain` a frame is that of the browser demos; a `sheet` is let go level from two corners,
    without wind and sphere. Cells are square on any grid."""

    scene: str
    solver: str
    rows: int = SEED_GRID[0]
    columns: int = SEED_GRID[1]
    substeps: int = USUAL["verlet"][0]
    iterations: int = USUAL["verlet"][1]
    path: str | None = None  # None: the one that the grid decides for
    # A stage left out (-wind) or added (+limit), another response of the ball (=repulsion). The demos have no ground.
    change: str = "-ground"

    @property
    def name(self) -> str:
        return " ".join(filter(None, [self.solver, f"{self.columns}×{self.rows}", self.path]))


@dataclass(frozen=True)
class Floor:
    """The program of benchmarks/floor that computes the frame of a case."""

    in_c: str | None
    in_javascript: str | None


def case_of(solver: str, grid: tuple[int, int] = SEED_GRID, path: str | None = None) -> Case:
    """A solver at its usual setting, on the scene whose frame there is a floor for, if there is one."""
    scene = "curtain" if SOLVERS[solver].iterates else "sheet"
    return Case(scene, solver, *grid, *USUAL[solver], path)


def default_cases() -> list[Case]:
    """A minute on two cores."""
    cases = [case_of(name) for name in SOLVERS]
    cases.insert(1, case_of("verlet", path="list"))
    larger = (("verlet", (64, 64)), ("verlet", (128, 128)), ("spring", (96, 96)), ("lines", (128, 128)))
    return cases + [case_of(name, grid) for name, grid in larger if name in SOLVERS]


def all_cases() -> list[Case]:
    """Every solver on each of its paths, on every grid."""
    return [
        case_of(name, grid, path)
        for name, kind in SOLVERS.items()
        for path in kind.paths
        for grid in (SEED_GRID, *SQUARES, *[LARGEST] * (name in LARGEST_FOR and path != "list"))
    ]


def stage_cases() -> list[Case]:
    """The curtain with all it names, then with one stage left out, one added, and with other responses of its ball."""
    added = [name for name in STAGES_ADDED if name in parts()]
    changes = ["", *(f"-{name}" for name in STAGES_LEFT_OUT), *(f"+{name}" for name in added)]
    changes += [f"={name}" for name in OTHER_RESPONSES]
    return [replace(case_of("verlet"), change=change) for change in changes]


def floor_of(case: Case) -> Floor:
    """The frames that C and JavaScript compute as well. JavaScript: only the seed's grid, larger ones take too long."""
    seed = case.solver == "verlet" and case.scene == "curtain"
    explicit = case.solver == "spring" and case.scene == "sheet"
    in_javascript = "frame" if seed and (case.rows, case.columns) == SEED_GRID else None
    return Floor("relax" if seed else "explicit" if explicit else None, in_javascript)


def scene_of(case: Case) -> Scene:
    """The scene that a case runs."""
    settings = {"solver": case.solver, "substeps": case.substeps, "iterations": case.iterations}
    curtain = load_scene("curtain", rows=case.rows, columns=case.columns, **settings)
    if case.scene == "sheet":
        width = 1.45  # [m] this and all below as in benchmarks/floor/explicit.c
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
            fabric=Fabric(warp=2000, weft=2000, shear=1000, bend=20),
            solver=Solver(case.solver, case.substeps, case.iterations, damping=1.0),
            forces=Forces(gravity=9.81),
        )
    top = curtain.cloth.center[1] + curtain.cloth.height / 2
    height = curtain.cloth.width * (case.rows - 1) / (case.columns - 1)
    cloth = replace(curtain.cloth, height=height, center=(0.0, top - height / 2, 0.0))
    return changed(replace(curtain, cloth=cloth), case.change)


def changed(scene: Scene, change: str) -> Scene:
    """A scene without a stage or a family of springs (`-wind`, `-bend`), with one more (`+limit`), or with balls that
    answer to contact in another way (`=repulsion`).
    """
    sign, name = change[:1], change[1:]
    new: dict[str, Any] = {}
    if sign == "-" and name in ("shear", "bend"):
        new = {part: replace(getattr(scene, part), **{name: 0.0}) for part in ("springs", "fabric")}
    elif sign == "-":
        new = {f"{name}s": ()} if name == "sphere" else {name: None}
    elif sign == "=":
        new = {"spheres": tuple(replace(ball, response=name) for ball in scene.spheres)}
    elif sign == "+":
        new = {name: parts()[name].section()}
    return replace(scene, **new)


def static_strain(scene: Scene) -> float:
    """What of the strain is no error: that of a cloth that hangs still from its top edge, and is free to stretch.

    The top row carries the whole weight, ρ·g·height per metre of width. 0 for solvers whose cloth has no constants
    in N/m: theirs is to be inextensible. NaN for a cloth held at points, whose strain there grows with the grid.
    """
    if SOLVERS[scene.solver.name].springs == "springs":
        return 0.0
    if "top" not in scene.cloth.pins:
        return float("nan")
    return scene.cloth.area_density * scene.forces.gravity * scene.cloth.height / (scene.fabric.warp or inf)


def highest_rate(ms: float) -> int:
    """The most pictures a second, of `BUDGETS`, for which a frame of `ms` is fast enough; 0 for none."""
    return next((rate for rate in BUDGETS if ms <= 1000 / rate), 0)


def only(cases: Sequence[Case], solver: str | None) -> list[Case]:
    """The cases of one solver, or all."""
    return [case for case in cases if solver in (None, case.solver)]
