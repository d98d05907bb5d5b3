"""Cases of pins, gravity, wind, the hand, damping and the limit of strain: 7, 8, 26 to 29, 34, 37, 38."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ..scene import load_scene
from ..scene.model import FRAME_SECONDS, Forces, Ground, Limit, Wind
from .rest import static_strain, taut_strain
from .scenes import CONSTANT, DAMPING, DENSITY, FLAT, sheet
from .setting import CELLS
from .trial import CALM_STRAIN, Trial
from .watch import ROUNDING

GRAVITY = 9.81  # [m/s²]
PULL_SECONDS, HOLD_SECONDS = 0.1, 1.0
RECOVERED = 1e-3  # strain by which a sheet that was pulled apart may differ from its static one
CHATTER = 1e-3  # [m/s] of a sheet in edge-on wind
YANKED_STRAIN = 0.05
CAP_ROUNDING = 4 * ROUNDING * CELLS  # of a strain: places of a metre in float32, over a thread of a cell
FALLS = 0.01  # of ½gt²: how exactly a damped cloth falls


def pins_apart(trial: Trial, times: float) -> None:
    """Both corners, to so many times their distance in a tenth of a second; held, and back as fast."""
    scene = sheet(CELLS)
    x = trial.open(scene, far=2 * times)
    trial.start()
    home = x[trial.simulation.topology.pinned]
    trial.move_pins(home * [times, 1, 1], PULL_SECONDS)
    trial.run(HOLD_SECONDS)
    trial.move_pins(home, PULL_SECONDS)
    trial.settle()
    static = static_strain(trial.setting.of(scene))
    trial.tell("strain beside the static one", abs(trial.watch.strain - static), RECOVERED)


def pins_together(trial: Trial, span: float) -> None:
    """To a share of their distance, and back; a negative one has them pass each other."""
    x = trial.open(sheet(CELLS))
    trial.start()
    home = x[trial.simulation.topology.pinned]
    trial.move_pins(home * [span, 1, 1], 0.5)
    trial.run(HOLD_SECONDS)
    trial.move_pins(home, 0.5)
    trial.settle()


def gravity(trial: Trial, size: float) -> None:
    """A constant acceleration [m/s²]. Upwards, a sheet rests as downwards, but for a mirror."""
    scene, down = (sheet(CELLS, pins=("top",), forces=Forces(gravity=g)) for g in (size, abs(size)))
    trial.open(scene, far=4 * DENSITY * abs(size) / CONSTANT, rest=down)
    trial.start()
    trial.run(5.0)
    trial.settle()


def gravity_flips(trial: Trial) -> None:
    """Gravity has another sign in every frame for two seconds; it ends downwards."""
    trial.open(sheet(CELLS, pins=("top",)))
    trial.start()
    for k in range(121):
        trial.act(partial(trial.simulation.set, "gravity", GRAVITY * (-1) ** k))
        trial.one_frame()
    trial.settle()


def gusts(trial: Trial) -> None:
    """100 m/s on for half a second and off for another, five times."""
    still = sheet(CELLS, pins=("top",))
    trial.open(replace(still, wind=Wind(z=100.0, turbulence=0.0)), far=15.0, rest=still)
    trial.start()
    for k in range(10):
        trial.simulation.set("wind", k % 2 == 0)
        trial.run(0.5)
    trial.simulation.set("wind", False)
    trial.settle()


def edge_on_wind(trial: Trial, cross: float) -> None:
    """Wind of 2 m/s in the plane of a sheet, and across it now one way, now the other.

    `cross` is how much of it at most blows across [share]: with none, n·v is 0 on every triangle. The sheet is pulled
    by 1 % between two edges, some 15 N/m: one that is pulled by less than σU² (0.8 N/m here) flutters as flags do, and
    one that hangs has free edges, which flutter in any wind. That is motion, and no chatter.
    """
    speed, pull = 2.0, 0.01  # [m/s], strain
    scene = sheet(CELLS, pins=("left", "right"), forces=Forces(gravity=0.0), wind=Wind(x=speed, turbulence=0.0))
    x = trial.open(scene, rest_strain=taut_strain(trial.setting.of(scene), pull) + CALM_STRAIN)
    trial.start(x * [1 + pull, 1, 1])
    for k in range(120):
        trial.simulation.set("wind_z", cross * speed * np.sin(k / 10))
        trial.one_frame()
    trial.simulation.set("wind_z", 0.0)
    trial.run(5.0)
    trial.settle()
    for _ in range(60):
        trial.one_frame()
        trial.tell("speed edge-on [m/s]", trial.watch.speed, CHATTER)


def yank(trial: Trial, way: float) -> None:
    """A particle in the middle goes so many metres in a frame and comes back in the next."""
    trial.open(sheet(CELLS, pins=("top",)), far=way, rest_strain=YANKED_STRAIN)
    trial.start()
    middle = trial.simulation.topology.particle_count // 2
    for away in (0.0, way, 0.0):
        target = trial.simulation.topology.start[middle] + [0.0, 0.0, away]
        trial.act(partial(trial.simulation.grab, middle, target))
        trial.one_frame(driven=True)
    trial.act(trial.simulation.release)
    trial.settle()


def no_pins(trial: Trial) -> None:
    """A level sheet falls on the ground."""
    trial.open(sheet(CELLS, pins=(), ground=Ground(height=-1.0), rotation=FLAT))
    trial.start()
    trial.run(5.0)
    trial.settle()


def all_pins(trial: Trial) -> None:
    count = (CELLS + 1) ** 2
    x = trial.open(sheet(CELLS, pins=tuple(range(count))))
    trial.start()
    trial.settle()
    trial.tell("way of a pin [m]", float(np.abs(trial.simulation.positions() - np.float32(x)).max()), 0)


def toggled_pin(trial: Trial) -> None:
    """A free corner is pinned where it is, and let go in the next frame, for two seconds."""
    trial.open(sheet(CELLS))
    trial.start()
    corner = trial.simulation.topology.particle_count - 1
    for k in range(120):
        trial.act(partial(trial.simulation.pin, corner, k % 2 == 0))
        trial.watch.pins_are_at(trial.simulation.positions()[trial.simulation.topology.pinned])
        trial.one_frame()
    trial.settle()


def refuses_negative(trial: Trial) -> None:
    """Negative rates and times are refused by name, in a scene and while it runs."""
    for key in ("damping", "damping_time"):
        trial.refuses(key, partial(load_scene, "curtain", **{key: -1.0}))
    trial.open(sheet(CELLS))
    trial.start()
    trial.refuses("damping", partial(trial.simulation.set, "damping", -1.0))
    trial.settle()


def undamped(trial: Trial) -> None:
    """Without damping for five seconds; then damped, so that it comes to rest."""
    trial.open(sheet(CELLS, damping=0.0))
    trial.start()
    trial.run(5.0)
    trial.simulation.set("damping", DAMPING)
    trial.run(5.0)
    trial.settle()


def overdamped(trial: Trial, rate: float) -> None:
    """A rate at which nothing can move [1/s]."""
    trial.open(sheet(CELLS, damping=rate))
    trial.start()
    trial.run(5.0)
    trial.settle()


def falls_with_dashpots(trial: Trial, damping_time: float) -> None:
    """Dashpots of the springs [s] do not slow a fall: it is ½gt², to 1 % and the first substep. Then it lands."""
    scene = sheet(CELLS, pins=(), damping=0.0, rotation=FLAT, ground=Ground(height=-6.0))
    trial.open(replace(scene, fabric=replace(scene.fabric, damping_time=damping_time)))
    trial.start()
    start, speed = (values[:, 1].mean() for values in (trial.simulation.positions(), trial.simulation.velocities()))
    trial.run(1.0)
    h = FRAME_SECONDS / trial.simulation.substeps
    fall = start + speed - trial.simulation.positions()[:, 1].mean()
    trial.tell("fall in 1 s beside ½gt², share", abs(fall / (GRAVITY / 2) - 1), FALLS + h)
    trial.simulation.set("damping", DAMPING)
    trial.run(3.0)
    trial.settle()


def strain_cap(trial: Trial, cap: float) -> None:
    """Under ten times its weight no thread may be longer than the cap, in any frame."""
    scene = sheet(CELLS, pins=("top",), forces=Forces(gravity=10 * GRAVITY), limit=Limit(strain=cap))
    trial.open(scene, rest_strain=cap + CAP_ROUNDING)
    trial.start()
    for _ in range(300):
        trial.one_frame()
        trial.tell("strain above the cap", trial.watch.strain - cap, CAP_ROUNDING)
    trial.settle()
