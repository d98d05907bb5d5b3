"""Cases 30 and 31: what a user does in mid run, and may not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import inf, nan

import numpy as np

from ..scene import load_scene
from ..scene.model import SOLVER_NAMES, Sphere
from ..solvers import SOLVERS
from .scenes import sheet
from .trial import Trial

MARGIN = 0.01  # [m]


def bad_input(trial: Trial) -> None:
    """All of it, at a frame in mid swing; then the cloth is as it was, to the last bit."""
    x = trial.open(sheet(trial.cells))
    trial.start()
    trial.run(0.5)
    simulation = trial.simulation
    before = simulation.positions(), simulation.velocities()
    hole = x.copy()
    hole[7, 1] = trial.one_of((nan, inf, -inf))
    attempts: dict[str, Callable[[], object]] = {
        "positions": lambda: simulation.place(hole),
        "velocities": lambda: simulation.place(x, hole),
        "target": lambda: simulation.grab(0, hole[7]),
        "particle": lambda: simulation.grab(len(x), x[0]),
        "gravity": lambda: simulation.set("gravity", hole[7, 1]),
        "substeps": lambda: simulation.set("substeps", -1),
        "gravty": lambda: simulation.set("gravty", 1.0),
        "weight": lambda: simulation.set("weight", 100.0),  # of no live parameter
        "spring_": lambda: simulation.change_solver("spring_"),
    }
    files: dict[str, object] = {
        "area_density": -0.2,
        "warp": -1.0,
        "substeps": 0,
        "center": [0.0, nan, 0.0],
        "width": inf,
        "pins": ["tpo"],
    }
    for key, value in files.items():
        attempts[key] = partial(load_scene, "curtain", **{key: value})
    for what, attempt in attempts.items():
        trial.refuses(what, attempt)
    after = simulation.positions(), simulation.velocities()
    changed = sum(int((a != b).sum()) for a, b in zip(before, after, strict=True))
    trial.tell("numbers that a refused input changed", changed, 0)
    trial.settle()


def mid_run(trial: Trial) -> None:
    """Constants a thousand times and a thousandth, substeps, gravity, method, and a ball's radius within the cloth."""
    kind = trial.one_of(("stiffer", "softer", "fewer", "more", "heavier", "method", "radius"))
    ball = Sphere(center=(0.0, -0.2, 0.08), radius=0.05, margin=MARGIN)
    scene = (
        sheet(trial.cells, pins=("top",), spheres=(ball,)) if kind == "radius" else sheet(trial.cells, pins=("top",))
    )
    if kind == "stiffer":
        scene = replace(scene, solver=replace(scene.solver, stiffness=1e-3))
    trial.open(scene, far=4.0, rest=0.05 if kind in ("stiffer", "more") else inf)
    trial.start()
    trial.run(1.0)
    simulation = trial.simulation
    able = [name for name in SOLVER_NAMES if trial.setting.tear is None or not SOLVERS[name].needs_rows]
    solver = able[(able.index(simulation.solver.name) + 1) % len(able)]
    changes: dict[str, tuple[Callable[[], object], ...]] = {
        "stiffer": (lambda: simulation.set("stiffness", 1.0),),
        "softer": (lambda: simulation.set("stiffness", 1e-3),),
        "fewer": (lambda: simulation.set("substeps", 20), lambda: simulation.set("substeps", 1)),
        "more": (lambda: simulation.set("substeps", 1), lambda: simulation.set("substeps", 20)),
        "heavier": (lambda: simulation.set("gravity", 98.1),),
        "method": (lambda: trial.change_solver(solver),),
        "radius": (lambda: simulation.set("sphere_radius", 0.4), lambda: simulation.set("sphere_radius", 0.05)),
    }
    for change in changes[kind]:
        x, v = simulation.positions(), simulation.velocities()
        trial.act(change)
        trial.tell("jump of a place [m]", float(np.abs(simulation.positions() - x).max()), 0)
        error = np.abs(simulation.velocities() - v).max() / max(1.0, float(np.abs(v).max()))
        trial.tell("jump of a velocity, share", float(error), 1e-3)
        trial.watch.springs_act_anew()
        trial.run(1.0)
    trial.settle()
