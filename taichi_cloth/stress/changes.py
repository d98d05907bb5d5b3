"""Cases 30 and 31: what a user does in mid run, and may not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import inf

import numpy as np

from ..scene import Scene, load_scene
from ..scene.model import SOLVER_NAMES, Sphere
from ..solvers import SOLVERS
from .scenes import CONSTANT, DENSITY, of_fabric, sheet
from .setting import CELLS
from .shots import MARGIN
from .trial import Trial
from .watch import ROUNDING

SPEED_ROUNDING = 1e-3  # [m/s] of a velocity that is read off two places in float32, of either length of substep


def bad_input(trial: Trial, wrong: float) -> None:
    """All of it, at a frame in mid swing; then the cloth is as it was, to the last bit."""
    x = trial.open(sheet(CELLS))
    trial.start()
    trial.run(0.5)
    simulation = trial.simulation
    before = simulation.positions(), simulation.velocities()
    hole = x.copy()
    hole[7, 1] = wrong
    attempts: dict[str, Callable[[], object]] = {
        "positions": lambda: simulation.place(hole),
        "velocities": lambda: simulation.place(x, hole),
        "target": lambda: simulation.grab(0, hole[7]),
        "particle": lambda: simulation.grab(len(x), x[0]),
        "gravity": lambda: simulation.set("gravity", wrong),
        "substeps": lambda: simulation.set("substeps", -1),
        "gravty": lambda: simulation.set("gravty", 1.0),
        "weight": lambda: simulation.set("weight", 100.0),  # of no live parameter
        "spring_": lambda: simulation.change_solver("spring_"),
    }
    files: dict[str, object] = {
        "area_density": -0.2,
        "weight": -1.0,
        "warp": -1.0,
        "bending": wrong,
        "substeps": 0,
        "center": [0.0, wrong, 0.0],
        "width": inf,
        "pins": ["tpo"],
    }
    for key, value in files.items():
        attempts[f"{key} of a scene"] = partial(load_scene, "curtain", **{key: value})
    for what, attempt in attempts.items():
        trial.refuses(what.removesuffix(" of a scene"), attempt)
    after = simulation.positions(), simulation.velocities()
    changed = sum(int((a != b).sum()) for a, b in zip(before, after, strict=True))
    trial.tell("numbers that a refused input changed", changed, 0)
    trial.settle()


def base() -> Scene:
    return sheet(CELLS, pins=("top",))


def begin(trial: Trial, scene: Scene, last: Scene, far: float = 0.0) -> None:
    """A second in the first scene; at the end the cloth must be at rest as in the `last` one."""
    trial.open(scene, far=far, rest=last)
    trial.start()
    trial.run(1.0)


def without_a_jump(trial: Trial, change: Callable[[], object]) -> None:
    """Changes something: no place may jump, and no velocity by more than float32 rounds it.

    The energy that comes with it is that of the new springs, masses and weights in the places that the cloth has, and
    the watch lets it have no more.
    """
    x, v = trial.simulation.positions(), trial.simulation.velocities()
    change()
    h = 1 / 60 / trial.simulation.substeps
    error = float(np.abs(trial.simulation.velocities() - v).max())
    trial.tell("jump of a place [m]", float(np.abs(trial.simulation.positions() - x).max()), 0)
    trial.tell("jump of a velocity [m/s]", error, SPEED_ROUNDING + 2 * ROUNDING / h)


def end(trial: Trial) -> None:
    trial.run(5.0)
    trial.settle()


def stiffer(trial: Trial, times: float) -> None:
    """Springs of so many times their constant."""
    last = of_fabric(base(), constant=CONSTANT * times)
    begin(trial, base(), last, far=8 * DENSITY * 9.81 / (CONSTANT * min(times, 1.0)))
    without_a_jump(trial, partial(trial.change_scene, last))
    end(trial)


def heavier(trial: Trial, times: float) -> None:
    """So many times the mass."""
    last = of_fabric(base(), density=DENSITY * times)
    begin(trial, base(), last, far=8 * DENSITY * times * 9.81 / CONSTANT)
    without_a_jump(trial, partial(trial.change_scene, last))
    end(trial)


def substeps(trial: Trial, numbers: tuple[int, ...]) -> None:
    """One number of substeps after another, a second each; the last is what the sheet comes to rest with."""
    begin(trial, base(), base())
    for number in numbers:
        without_a_jump(trial, partial(trial.act, partial(trial.simulation.set, "substeps", number)))
        trial.run(1.0)
    end(trial)


def toggled_collider(trial: Trial) -> None:
    """A ball of 0.3 m is in the middle of the sheet and is not, by turns, half a second each, and stays away."""
    ball = Sphere(center=(0.0, 0.0, 0.01), radius=0.3, margin=MARGIN)
    begin(trial, base(), base())
    for k in range(6):
        without_a_jump(trial, partial(trial.change_scene, replace(base(), spheres=(ball,) if k % 2 == 0 else ())))
        trial.run(0.5)
    end(trial)


def other_solver(trial: Trial) -> None:
    """The next of the methods that can go on with this cloth."""
    begin(trial, base(), base())
    able = [name for name in SOLVER_NAMES if trial.setting.tear is None or not SOLVERS[name].needs_rows]
    name = able[(able.index(trial.simulation.solver.name) + 1) % len(able)]
    without_a_jump(trial, partial(trial.change_solver, name))
    end(trial)
