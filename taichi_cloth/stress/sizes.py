"""Cases 24, 25, 33, 40: cells of no area, grids of next to nothing and of a million, and places far away."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import WrongUse
from ..mesh.obj import ObjError
from ..scene import Scene, SceneError, load_scene
from ..scene.model import FRAME_SECONDS, Ground
from .files import MESHES, SLIVERS, plain
from .scenes import CORNERS, DAMPING, FLAT, sheet
from .setting import CELLS
from .starts import grid_of
from .trial import Trial

CELL = 1 / CELLS  # [m]
GRAVITY = 9.81  # [m/s²]
SAG = 0.01  # by how much it may differ far away, as a share
FALL_SECONDS, FALL = 0.4, 0.01  # [s], and by how much a fall may differ there
LARGE_MS = 600_000.0  # of a million particles


def together(trial: Trial) -> None:
    """Particles that start at the places of others, and whole rows at those of the next: threads of no length now."""
    x = trial.open(sheet(CELLS))
    places, middle = grid_of(trial, x.copy()), CELLS // 2
    places[middle, middle] = places[middle, middle + 1]
    places[middle - 2, middle] = places[middle - 1, middle + 1]
    places[middle + 3 : middle + 6] = places[middle + 3]
    trial.start(places.reshape(-1, 3))
    trial.run(5.0)
    trial.settle()


def degenerate(trial: Trial, kind: str) -> None:
    """A mesh file with something that no cloth has: refused by the file's name, or alive."""
    path = MESHES[kind](CELLS)
    # No solver in float64 brings a mesh of slivers to rest: it is held against the same mesh without them.
    rest = of_mesh(plain(CELLS)) if kind == SLIVERS else None
    open_or_refused(trial, of_mesh(path), path.name, rest)


def of_mesh(path: Path) -> Scene:
    """The base sheet of the file's points and faces."""
    scene = sheet(CELLS)
    keys = type(scene.cloth)()  # keys of a grid have no part in a mesh
    cloth = replace(keys, file=path.name, folder=str(path.parent), center=(0.0, 0.0, 0.0), pins=(0, CELLS))
    return replace(scene, cloth=replace(cloth, area_density=scene.cloth.area_density))


def open_or_refused(trial: Trial, scene: Scene, name: str, rest: Scene | None) -> None:
    """Alive; or refused with a line that has this name in it, the substeps that the springs would take, or that the
    method needs another cloth.
    """
    try:
        trial.open(scene, rest=rest)
    except (SceneError, ObjError, WrongUse) as error:
        words = name, "substeps", f"{trial.setting.solver.name} needs"
        named = any(word in str(error) for word in words)
        trial.demand("refusals that name nothing", not named, 0)
        trial.tell("refused", 1)
        return
    trial.start()
    trial.run(5.0)
    trial.settle()


def flat_cells(trial: Trial) -> None:
    """A sheet of cells ten thousand times as wide as they are high; sides of no length are refused by name.

    Its strain at rest is a few millionths, σ·g·height/k; a sheet a metre high has all that more.
    """
    for key in ("width", "height"):
        trial.refuses(key, partial(load_scene, "curtain", **{key: 0.0}))
    flat = sheet(CELLS, pins=("top",), size=(10.0, 1e-3))
    open_or_refused(trial, flat, "width", rest=sheet(CELLS, pins=("top",)))


def tiny(trial: Trial, shape: tuple[int, int]) -> None:
    """So many rows and columns of particles, in cells of the usual size, hung by the top edge."""
    rows, columns = shape
    size = (CELL * (columns - 1), CELL * (rows - 1))
    trial.open(sheet((rows - 1, columns - 1), pins=("top",), size=size), far=2.0)
    trial.start()
    trial.run(5.0)
    trial.settle()


def too_small(trial: Trial, shape: tuple[int, int]) -> None:
    """Less than two particles a side are refused by name."""
    rows, columns = shape
    short = "rows" if rows < 2 else "columns"
    trial.refuses(short, lambda: load_scene("curtain", rows=rows, columns=columns))
    trial.tell("refused", 1)


def far_away(trial: Trial, away: float) -> None:
    """So many metres from the origin along x and y a sheet falls and sags as near it."""
    sags = []
    for x in (0.0, away):
        scene = sheet(CELLS, center=(x, x, 0.0))
        trial.open(scene)
        trial.start()
        trial.run(5.0)
        trial.settle()
        sags.append(x + 0.5 - float(trial.simulation.positions()[:, 1].min()))
    trial.tell("sag beside that near the origin, share", abs(sags[1] / sags[0] - 1), SAG)

    ground = Ground(height=away - 2.0)
    trial.open(sheet(CELLS, pins=(), damping=0.0, rotation=FLAT, center=(away, away, 0.0), ground=ground))
    trial.start()
    simulation = trial.simulation
    start, speed = (values[:, 1].mean() for values in (simulation.positions(), simulation.velocities()))
    trial.run(FALL_SECONDS)
    fall = start + speed * FALL_SECONDS - float(simulation.positions()[:, 1].mean())
    first = FRAME_SECONDS / simulation.substeps / FALL_SECONDS  # of the fall: a substep's
    trial.tell("fall beside ½gt², share", abs(fall / (GRAVITY * FALL_SECONDS**2 / 2) - 1), FALL + first)
    simulation.set("damping", DAMPING)
    trial.run(3.0)
    trial.settle()


def large(trial: Trial) -> None:
    """A million particles, one frame."""
    side = 1024
    size = CELL * (side - 1)
    trial.open(sheet(side - 1, pins=CORNERS, size=(size, size)), rest_strain=1.0)
    trial.frame_limit_ms(LARGE_MS, "a million particles, of which one frame is asked for")
    trial.start()
    trial.one_frame()
    trial.tell("stretch in the first frame", trial.watch.strain)
    trial.demand("places that are not finite", int((~np.isfinite(trial.simulation.positions())).sum()), 0)
    trial.only_frames("one frame is all that the list asks for")
