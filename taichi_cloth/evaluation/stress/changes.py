"""Cases 30 and 31: invalid input, and changes while the simulation runs. Also maps and meshes for the other cases.

A scene reads values per particle, and cloth other than a rectangular sheet, only from files.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from ...geometry.scene_loader import load_scene
from ...scene import Scene
from ...scene.collider_schema import Sphere
from ...scene.fabric_schema import VerletSprings
from ...scene.schema import FRAME_SECONDS, SOLVER_NAMES
from ...simulation.simulation import Simulation
from ...solvers import SOLVERS
from .contact import MARGIN
from .invariants import EJECTED, ROUNDING
from .setup import CELLS, CONSTANT, DENSITY, MAX_SUBSTEPS, sheet, with_fabric
from .trial import Trial

Floats = NDArray[np.float64]


@cache
def folder() -> Path:
    """Create the temporary folder on the first call, and return its path."""
    temporary = TemporaryDirectory(prefix="taichi_cloth_stress_")
    atexit.register(temporary.cleanup)
    return Path(temporary.name)


def half_map(cells: int) -> str:
    """Write a map for a square sheet and return its file name.

    Particles in the left half and on the center line have 1, those in the right half 0.
    """
    column = np.tile(np.arange(cells + 1), cells + 1)
    numbers = np.where(column <= cells // 2, 1, 0)
    name = f"half_{cells}.csv"
    path = folder() / name
    if not path.exists():
        path.write_text("\n".join(map(str, numbers)) + "\n", encoding="utf-8")
    return name


def obj_file(name: str, points: Floats, faces: list[tuple[int, ...]]) -> Path:
    """Write an OBJ file of points [m], (N, 3), and faces of point indices from 0. Returns its path."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    path = folder() / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _triangles(cells: int, index: NDArray[np.int64]) -> list[tuple[int, ...]]:
    """Return two triangles per cell of a sheet. `index` has its point indices, (cells + 1, cells + 1)."""
    triangles: list[tuple[int, ...]] = []
    for row in range(cells):
        for column in range(cells):
            a, b = int(index[row, column]), int(index[row, column + 1])
            c, d = int(index[row + 1, column]), int(index[row + 1, column + 1])
            triangles += [(a, c, d), (a, d, b)]
    return triangles


def _sheet(cells: int) -> tuple[Floats, NDArray[np.int64]]:
    """Return the points [m] of a sheet with sides of 1 m, (N, 3), and their indices, (cells + 1, cells + 1)."""
    across = np.linspace(-0.5, 0.5, cells + 1)
    y, x = np.meshgrid(-across, across, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return points, np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)


def plain(cells: int) -> Path:
    """Write a sheet without a defect."""
    points, index = _sheet(cells)
    return obj_file("plain.obj", points, _triangles(cells, index))


def doubled_points(cells: int) -> Path:
    """Write a sheet with a vertical slit of half its height in the middle.

    Every position along the slit has two points, one for each side.
    """
    points, index = _sheet(cells)
    left, middle = index.copy(), cells // 2
    slit = index[cells // 4 : 3 * cells // 4, middle]
    left[cells // 4 : 3 * cells // 4, middle] = len(points) + np.arange(len(slit))
    points = np.concatenate([points, points[slit]])
    faces: list[tuple[int, ...]] = []
    for k, face in enumerate(_triangles(cells, index)):
        column = k // 2 % cells
        faces.append(_triangles(cells, left)[k] if column < middle else face)
    return obj_file("doubled_points.obj", points, faces)


def zero_length(cells: int) -> Path:
    """Write a sheet with a triangle edge whose two ends coincide."""
    points, index = _sheet(cells)
    middle = cells // 2
    points[index[middle, middle + 1]] = points[index[middle, middle]]
    return obj_file("zero_length.obj", points, _triangles(cells, index))


def zero_area(cells: int) -> Path:
    """Write a sheet with a triangle whose three corners are distinct but collinear."""
    points, index = _sheet(cells)
    middle = cells // 2
    a, d = points[index[middle, middle]], points[index[middle + 1, middle + 1]]
    points[index[middle, middle + 1]] = (a + d) / 2
    return obj_file("zero_area.obj", points, _triangles(cells, index))


def slivers(cells: int) -> Path:
    """Write a sheet with a row of triangles in the middle that are ten thousand times as long as high."""
    points, index = _sheet(cells)
    rows = points.reshape(cells + 1, cells + 1, 3)
    middle = cells // 2
    rows[middle + 1, :, 1] = rows[middle, :, 1] - 1 / cells / 1e4
    return obj_file("slivers.obj", points, _triangles(cells, index))


SLIVERS = "1:1e4 triangles"
MESHES: dict[str, Callable[[int], Path]] = {
    "doubled points": doubled_points,
    "zero-length springs": zero_length,
    "zero-area triangles": zero_area,
    SLIVERS: slivers,
}


SPEED_ROUNDING = 1e-3  # [m/s] of a velocity computed from two float32 positions, for either substep length


def bad_input(trial: Trial, wrong: float) -> None:
    """Try every kind of invalid input while the cloth swings. Its state must stay the same to the last bit."""
    x = trial.open(sheet(CELLS))
    trial.start()
    trial.run(0.5)
    simulation = trial.simulation
    before = simulation.positions(), simulation.velocities()
    attempts: dict[str, Callable[[], object]] = {
        "particle": lambda: simulation.grab(len(x)),
        "gravity": lambda: simulation.params.update({"gravity": wrong}),
        "substeps": lambda: simulation.params.update({"substeps": -1}),
        "gravty": lambda: simulation.params.update({"gravty": 1.0}),
        "corner_mass": lambda: simulation.params.update({"corner_mass": 100.0}),  # not a runtime parameter
        "spring_": lambda: simulation.switch_solver("spring_"),
    }
    files: dict[str, object] = {
        "area_density": -0.2,
        "corner_mass": -1.0,
        "warp": -1.0,
        "bending_stiffness": wrong,
        "substeps": 0,
        "center": [0.0, wrong, 0.0],
        "width": inf,
        "pins": ["tpo"],
    }
    for key, value in files.items():
        attempts[f"{key} of a scene"] = partial(load_scene, "curtain", **{key: value})
    for what, attempt in attempts.items():
        trial.expect_error(what.removesuffix(" of a scene"), attempt)
    for particle in (0, 7, len(x) - 1):
        for axis in range(3):
            hole = x.copy()
            hole[particle, axis] = wrong
            trial.expect_error("positions", partial(simulation.set_state, hole))
            trial.expect_error("velocities", partial(simulation.set_state, x, hole))
            trial.expect_error("target", partial(grab_and_move, simulation, hole[particle]))
    after = simulation.positions(), simulation.velocities()
    changed = sum(int((a != b).sum()) for a, b in zip(before, after, strict=True))
    trial.record("numbers that a refused input changed", changed, 0)
    trial.settle()


def grab_and_move(simulation: Simulation, target: Floats) -> None:
    """Grab a pinned particle, so that releasing it changes no velocity, move the grab to `target`, and release it."""
    grab = simulation.grab(0)
    try:
        grab.move_to(target)
    finally:
        grab.release()


def base() -> Scene:
    return sheet(CELLS, pins=("top",))


def begin(trial: Trial, scene: Scene, last: Scene, far: float = 0.0) -> None:
    """Run one second of `scene`. When the case ends, the cloth must be at rest in the scene `last`."""
    trial.open(scene, far=far, rest=last)
    trial.start()
    trial.run(1.0)


def without_a_jump(trial: Trial, change: Callable[[], object]) -> None:
    """Make a change. No position may jump, and no velocity by more than float32 rounding.

    The change adds the energy of the new springs, masses and weights at the current positions; the monitor allows no
    more.
    """
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    change()
    h = 1 / 60 / trial.simulation.substeps
    error = float(np.abs(trial.simulation.velocities() - v).max())
    trial.record("jump of a place [m]", float(np.abs(trial.simulation.positions() - x).max()), 0)
    trial.record("jump of a velocity [m/s]", error, SPEED_ROUNDING + 2 * ROUNDING / h)


def without_an_ejection(trial: Trial, change: Callable[[], object]) -> None:
    """Make a change as `without_a_jump`, and run a frame, in which a collider ejects the cloth that it encloses.

    No particle may move farther in it than at the largest speed before, plus the largest speed of an ejection, plus the
    speed that it gains by falling.
    """
    x = trial.simulation.positions()
    fastest = float(np.linalg.norm(trial.simulation.velocities(), axis=1).max())
    without_a_jump(trial, change)
    trial.one_frame()
    speed = fastest + EJECTED + abs(float(trial.simulation.params["gravity"])) * FRAME_SECONDS  # [m/s]
    moved = float(np.linalg.norm(trial.simulation.positions() - x, axis=1).max())
    trial.record("displacement in the next frame, of its bound", moved / (speed * FRAME_SECONDS), 1)


def shares(share: float) -> VerletSprings:
    """Return the springs of `verlet` that have this share of the base sheet's stiffness."""
    usual = base().verlet
    return VerletSprings(share * usual.structural, share * usual.shear, share * usual.bend)


def stiffer(trial: Trial, times: float) -> None:
    """Multiply the constant of all springs by `times`.

    `verlet` has shares instead, up to 1: they change by the same factor, and the bound stays that of the base sheet.
    """
    first, last = base(), with_fabric(base(), constant=CONSTANT * times)
    if trial.setting.solver.name == "verlet":
        first, last = (replace(base(), verlet=shares(min(share, 1.0))) for share in (1 / times, times))
    begin(trial, first, last, far=8 * DENSITY * 9.81 / (CONSTANT * min(times, 1.0)))
    without_a_jump(trial, partial(trial.change_scene, last))
    trial.settle()


def heavier(trial: Trial, times: float) -> None:
    """Multiply the mass by `times`."""
    last = with_fabric(base(), density=DENSITY * times)
    begin(trial, base(), last, far=8 * DENSITY * times * 9.81 / CONSTANT)
    without_a_jump(trial, partial(trial.change_scene, last))
    trial.settle()


def substeps(trial: Trial, numbers: tuple[int, ...]) -> None:
    """Run one second with each number of substeps. The sheet must come to rest with the last.

    An explicit solver has that many times the substeps that it needs to be stable, as far as a frame may have so many:
    it would raise fewer.
    """
    begin(trial, base(), base())
    simulation = trial.simulation
    factor = simulation.min_stable_substeps if simulation.solver.info.is_explicit else 1
    for number in (min(factor * number, MAX_SUBSTEPS) for number in numbers):
        without_a_jump(trial, partial(trial.change, partial(simulation.params.update, substeps=number)))
        if simulation.substeps != number:
            trial.note(f"{simulation.substeps} substeps instead of {number}, which would be unstable")
        trial.run(1.0)
    trial.settle()


def toggled_collider(trial: Trial) -> None:
    """Add and remove a ball of 0.3 m in the middle of the sheet every half second. It ends removed."""
    ball = Sphere(center=(0.0, 0.0, 0.01), radius=0.3, margin=MARGIN, friction=0.0)
    begin(trial, base(), base())
    for k in range(6):
        spheres = (ball,) if k % 2 == 0 else ()
        without_an_ejection(trial, partial(trial.change_scene, replace(base(), spheres=spheres)))
        trial.run(0.5 - FRAME_SECONDS)
    trial.settle()


def other_solver(trial: Trial) -> None:
    """Switch to the next solver that supports this cloth."""
    begin(trial, base(), base())
    able = [name for name in SOLVER_NAMES if trial.setting.tear is None or not SOLVERS[name].info.grid_only]
    name = able[(able.index(trial.simulation.solver.name) + 1) % len(able)]
    without_a_jump(trial, partial(trial.change_solver, name))
    trial.settle()
