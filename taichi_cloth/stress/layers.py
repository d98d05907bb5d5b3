"""Cases 14 to 16: cloth that touches itself."""

from __future__ import annotations

import numpy as np

from ..mesh.grid import rotation_matrix
from ..scene.model import FRAME_SECONDS, Capsule, Ground, Keyframes, Sphere
from .gaps import is_stacked, least_gap
from .scenes import FLAT, SIDE, off_itself, pile, sheet
from .setting import CELLS
from .shots import MARGIN
from .trial import Trial
from .watch import Floats

TWIST_RATE, TWIST = 72.0, 720.0  # [degrees/s], [degrees] of each edge
SHAPE = 0.01 * SIDE  # [m] from where a particle hung before, once the sheet is turned back
LOOK_EVERY = 30  # frames between two counts of crossings, or measurements of gaps
SHEETS, GAP, TURN = 10, 0.1, 9.0  # [m], [degrees] from one to the next
LAYER_CELLS = 16  # along a side of each
HALF = 0.5  # of the thickness, that must be left between two sheets
MANY_SHEETS, MANY_CELLS, MANY_SIDE, MANY_GAP = 50, 8, 0.25, 0.04  # cells and sides [m] of each
# OGC's authors give 210 to 550 ms a step on a processor for 50 layers of 246 thousand particles, several steps a frame:
# a frame of ours, of four thousand, may take as long as one of their steps.
MANY_MS = 550.0


def twist(trial: Trial) -> None:
    """Two edges turn against each other at 72°/s, by 720° each, and back: it hangs as it did, and crosses nothing."""
    trial.open(sheet(CELLS, pins=("left", "right"), self_collision=off_itself(SIDE / CELLS)))
    trial.start()
    trial.settle()
    simulation = trial.simulation
    home, crossed = simulation.positions(), 0
    pins = home[simulation.topology.pinned]
    frames = round(TWIST / TWIST_RATE / FRAME_SECONDS)
    for k in [*range(1, frames + 1), *range(frames - 1, -1, -1)]:
        trial.lead_pins(twisted(pins, TWIST * k / frames))
        trial.one_frame()
        if k % LOOK_EVERY == 0:
            crossed = max(crossed, simulation.crossings())
    trial.tell("crossings in the worst frame", crossed)
    trial.settle()
    away = float(np.linalg.norm(simulation.positions() - home, axis=1).max())
    trial.tell("crossings at the end", simulation.crossings(), 0)
    trial.tell("distance from the shape before [m]", away, SHAPE)


def twisted(pins: Floats, degrees: float) -> Floats:
    """Places of two edges, right ones turned by an angle about the x axis and left ones by as much the other way."""
    turned = [pins @ rotation_matrix((sign * (degrees % 360), 0, 0)).T for sign in (1, -1)]
    return np.where(pins[:, :1] > 0, *turned)


class Stack:
    """Sheets that lie on each other, and the least gap between two that are next to each other."""

    def __init__(self, trial: Trial, sheets: int, thickness: float) -> None:
        self._trial, self._sheets, self._thickness = trial, sheets, thickness
        topology = trial.simulation.topology
        self._triangles = topology.triangles[: len(topology.triangles) // sheets]

    def run(self, seconds: float) -> None:
        for k in range(round(seconds / FRAME_SECONDS)):
            self._trial.one_frame()
            if k % LOOK_EVERY == LOOK_EVERY - 1:
                self.look()

    def look(self) -> None:
        """The gap may not be less than half a thickness."""
        self._trial.tell("gap missing, of half a thickness", self.missing(), 0.0)

    def missing(self) -> float:
        """How much of half a thickness the least gap is short of, as a share."""
        x = self._trial.simulation.positions()
        return 1 - least_gap(x, self._triangles, self._sheets, self._thickness) / (HALF * self._thickness)

    def end(self) -> None:
        self.look()
        simulation = self._trial.simulation
        self._trial.tell("crossings at the end", simulation.crossings(), 0)
        self._trial.tell("stacks out of order", float(not is_stacked(simulation.positions(), self._sheets)), 0)


def layers(trial: Trial) -> None:
    """Ten level sheets, each turned by 9° against the one below, fall on the ground from 0.1 m apart.

    Then a ball comes down on them and rests a thickness deep in the pile: bodies in a scene are led, and weigh nothing.
    """
    off = off_itself(SIDE / LAYER_CELLS)
    ground = Ground(height=-GAP, friction=0.4)
    top = ground.height + ground.margin + (SHEETS - 1) * off.thickness  # [m] of the pile
    radius, from_above = 0.3, SHEETS * GAP + 0.5
    rest = top + MARGIN + radius - off.thickness
    path: Keyframes = ((1.0, 0, 0, 0), (2.0, 0, rest - from_above, 0))
    ball = Sphere(center=(0.0, from_above, 0.0), radius=radius, margin=MARGIN, friction=0.4, path=path)
    scene = sheet(LAYER_CELLS, pins=(), rotation=FLAT, spheres=(ball,), ground=ground, self_collision=off)
    trial.open(pile(scene, SHEETS, GAP, TURN), rest=sheet(CELLS))
    trial.frame_limit_ms(MANY_MS, "ten sheets at once")
    trial.start()
    stack = Stack(trial, SHEETS, off.thickness)
    stack.run(2.5)
    trial.settle()
    stack.end()


def many_layers(trial: Trial) -> None:
    """Fifty small sheets fall on a bar. Their gaps and crossings are told: the list asks for the time alone."""
    off = off_itself(MANY_SIDE / MANY_CELLS)
    bar = Capsule(center=(0.0, -0.2, 0.0), rotation=(0.0, 0.0, 90.0), length=1.0, radius=0.1, margin=MARGIN)
    scene = sheet(
        MANY_CELLS,
        pins=(),
        size=(MANY_SIDE, MANY_SIDE),
        rotation=FLAT,
        capsules=(bar,),
        ground=Ground(height=-1.0),
        self_collision=off,
    )
    trial.open(pile(scene, MANY_SHEETS, MANY_GAP), far=2.0, rest=sheet(CELLS))
    trial.frame_limit_ms(MANY_MS, "fifty sheets at once, which a published method takes 210 to 550 ms a step for")
    trial.start()
    stack = Stack(trial, MANY_SHEETS, off.thickness)
    trial.run(5.0)
    trial.tell("gap missing, of half a thickness", stack.missing())
    trial.settle()
    trial.tell("crossings at the end", trial.simulation.crossings())
