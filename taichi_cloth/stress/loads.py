"""Cases of pins, gravity, wind, the hand and damping: 7, 8, 14, 26 to 29, 34, 37, 38."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ..mesh.grid import rotation_matrix
from ..scene import load_scene
from ..scene.model import FRAME_SECONDS, Forces, Ground, Limit, Wind
from .scenes import off_itself, sheet
from .trial import Trial

PULL_SECONDS, HOLD_SECONDS = 0.1, 1.0
TWIST_RATE, TWIST = 144.0, 720.0  # [degrees/s], [degrees] of each edge


def pins_apart(trial: Trial) -> None:
    """Both corners, to so many times their distance; back as fast."""
    times = trial.one_of((2.0, 5.0, 10.0))
    x = trial.open(sheet(trial.cells), far=2 * times)
    trial.start()
    home = x[trial.simulation.topology.pinned]
    trial.move_pins(home * [times, 1, 1], PULL_SECONDS)
    trial.run(HOLD_SECONDS)
    trial.move_pins(home, PULL_SECONDS)
    trial.settle()


def pins_together(trial: Trial) -> None:
    """To 10 % of their distance, to none, and past each other."""
    x = trial.open(sheet(trial.cells))
    trial.start()
    home = x[trial.simulation.topology.pinned]
    trial.move_pins(home * [trial.one_of((0.1, 0.0, -0.5)), 1, 1], 0.5)
    trial.run(HOLD_SECONDS)
    trial.move_pins(home, 0.5)
    trial.settle()


def twist(trial: Trial) -> None:
    """Two edges turn against each other, and back."""
    x = trial.open(sheet(trial.cells, pins=("left", "right"), self_collision=off_itself(1 / trial.cells)))
    trial.start()
    pins = x[trial.simulation.topology.pinned]
    right = pins[:, :1] > 0
    frames = round(TWIST / TWIST_RATE / FRAME_SECONDS)
    for k in [*range(1, frames + 1), *range(frames - 1, -1, -1)]:
        angle = TWIST * k / frames % 360
        turned = np.where(right, pins @ rotation_matrix((angle, 0, 0)).T, pins @ rotation_matrix((-angle, 0, 0)).T)
        trial.lead_pins(turned)
        trial.one_frame()
    trial.settle()


def gravity(trial: Trial) -> None:
    """Each way, strong, and of another sign in every frame."""
    size = trial.one_of((0.0, -9.81, 1e3, 1e5, 9.81))
    flips = size == 9.81
    scene = sheet(trial.cells, pins=("top",), forces=Forces(gravity=size))
    far = 4 * scene.cloth.area_density * abs(size) / scene.fabric.warp
    trial.open(scene, far)
    trial.start()
    if flips:
        for k in range(120):
            trial.act(partial(trial.simulation.set, "gravity", 9.81 * (-1) ** k))
            trial.one_frame()
    trial.settle()


def gusts(trial: Trial) -> None:
    """100 m/s for half a second, five times."""
    scene = sheet(trial.cells, pins=("top",), wind=Wind(z=100.0, turbulence=0.0))
    trial.open(scene, far=15.0, rest=sheet(trial.cells, pins=("top",)))
    trial.start()
    for k in range(10):
        trial.simulation.set("wind", k % 2 == 0)
        trial.run(0.5)
    trial.simulation.set("wind", False)
    trial.settle()


def edge_on_wind(trial: Trial) -> None:
    """Taut between two edges: a sheet that is pulled by less than σU² per metre (0.8 N/m here) flutters as flags do."""
    speed, pull = 2.0, trial.one_of((0.01, 0.02))
    wind = Wind(x=speed, turbulence=0.0)
    x = trial.open(sheet(trial.cells, pins=("left", "right"), forces=Forces(gravity=0.0), wind=wind), rest=np.inf)
    trial.start(x * [1 + pull, 1, 1])
    for k in range(120):  # through edge-on, to and fro
        trial.simulation.set("wind_z", 0.01 * speed * np.sin(k / 10))
        trial.one_frame()
    trial.simulation.set("wind_z", 0.0)
    trial.settle()
    trial.tell("speed edge-on [m/s]", trial.watch.speed, 1e-3)


def yank(trial: Trial) -> None:
    """A particle in the middle goes 10 m in a frame and comes back in the next."""
    trial.open(sheet(trial.cells, pins=("top",)), far=10.0, rest=0.05)
    trial.start()
    middle = trial.simulation.topology.particle_count // 2
    for away in (0.0, 10.0, 0.0):
        target = trial.simulation.topology.start[middle] + [0.0, 0.0, away]
        trial.act(partial(trial.simulation.grab, middle, target))
        trial.one_frame(driven=True)
    trial.act(trial.simulation.release)
    trial.settle()


def pins(trial: Trial) -> None:
    """None, all, and a hand that takes hold in every other frame."""
    kind = trial.one_of(("none", "all", "toggled"))
    if kind == "none":
        trial.open(sheet(trial.cells, pins=(), ground=Ground(height=-1.0), rotation=(-90.0, 0.0, 0.0)))
    elif kind == "all":
        count = (trial.cells + 1) ** 2
        trial.open(sheet(trial.cells, pins=tuple(range(count))))
    else:
        trial.open(sheet(trial.cells))
    trial.start()
    if kind == "toggled":
        corner = trial.simulation.topology.particle_count - 1
        for _ in range(60):
            trial.act(partial(trial.simulation.grab, corner, trial.simulation.positions()[corner]))
            trial.one_frame(driven=True)
            trial.act(trial.simulation.release)
            trial.one_frame()
    trial.settle()


def damping(trial: Trial) -> None:
    """None, as much as can be asked for, dashpots of a second, and a negative one."""
    kind = trial.one_of(("none", "most", "dashpots", "negative"))
    if kind == "negative":
        for key in ("damping", "damping_time"):
            trial.refuses(key, partial(load_scene, "curtain", **{key: -1.0}))
    if kind == "dashpots":
        scene = sheet(trial.cells, pins=(), damping=0.0)
        trial.open(replace(scene, fabric=replace(scene.fabric, damping_time=1.0)), rest=np.inf)
        trial.start()
        start = trial.simulation.positions()[:, 1].mean()
        trial.run(1.0)
        h = FRAME_SECONDS / trial.simulation.substeps
        fall = start - trial.simulation.positions()[:, 1].mean()
        trial.tell("fall in 1 s beside ½gt², share", abs(fall / (9.81 / 2) - 1), 0.01 + h)
        return
    trial.open(sheet(trial.cells, damping=1e6 if kind == "most" else 0.0 if kind == "none" else 1.5))
    trial.start()
    if kind == "none":
        trial.run(10.0)
    else:
        trial.settle()


def strain_cap(trial: Trial) -> None:
    """Under ten times its weight."""
    cap = trial.one_of((0.01, 0.001))
    trial.open(sheet(trial.cells, pins=("top",), forces=Forces(gravity=98.1), limit=Limit(strain=cap)))
    trial.start()
    trial.settle()
    trial.tell("strain above the cap, of the cap", trial.watch.strain / cap - 1, 0.1)
