"""Cases 35, 36, 39: friction."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np

from ..scene.model import FRAME_SECONDS, Box, Ground, Keyframes, Plane, Sphere
from .scenes import DAMPING, DENSITY, FLAT, SIDE, pile, sheet, thin
from .setting import CELLS
from .shots import MARGIN
from .trial import CALM_SPEED, SHAKE, SHIFT, Trial
from .watch import Floats

GRAVITY = 9.81  # [m/s²]
CREEP = 1e-3  # [m] of a sheet that friction holds, in a minute
REST_SECONDS, SLIDE_SECONDS = 60.0, 10.0
SPIN, SPIN_SECONDS = 180.0, 8.0  # [degrees/s] of a ball, and how long it turns
FASTER = 1e-3  # by how much a sheet may turn faster than the ball that carries it, as a share
TABLE_CELLS = 16  # along a side of each of two sheets that lie on each other
TWO_SHEETS_MS = 400.0
HEAVIER = 0.01  # by how much friction may be more than μ times the weight, as a share


def slope(trial: Trial, how: tuple[float, float]) -> None:
    """A sheet lies on a slope: μ, and its degrees. Where μ > tan it stays for a minute; else it slides for ten seconds.

    One that slides is never at rest: with damping it comes to g(sin − μ·cos) over the rate of damping. No particle may
    be faster by more than any may move at rest, nor the sheet slower.
    """
    mu, degrees = how
    plane = Plane(center=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, -degrees), margin=MARGIN, friction=mu)
    angle = radians(degrees)
    up, down = np.array([sin(angle), cos(angle), 0.0]), np.array([cos(angle), -sin(angle), 0.0])
    middle = MARGIN * up
    scene = sheet(
        CELLS,
        pins=(),
        rotation=(-90.0, 0.0, -degrees),
        planes=(plane,),
        center=(float(middle[0]), float(middle[1]), 0.0),
    )
    x = trial.open(scene, rest=sheet(CELLS))  # it lies
    along, across = trial.random.uniform(-SHIFT, SHIFT, 2)
    before = x + along * down + across * np.array([0.0, 0.0, 1.0])
    start_there(trial, before, up)
    pull = GRAVITY * (sin(angle) - mu * cos(angle))
    if pull <= 0:
        for _ in range(round(REST_SECONDS / FRAME_SECONDS)):
            trial.one_frame()
            moved = np.linalg.norm(trial.simulation.positions() - before, axis=1).max()
            trial.tell("creep [m]", float(moved), CREEP)
        trial.settle()
    else:
        trial.run(SLIDE_SECONDS)
        speed = pull / float(trial.simulation.get("damping"))
        trial.settle(most_speed=speed + CALM_SPEED)
        behind = speed - float((trial.simulation.velocities() @ down).mean())
        trial.tell("slower than a sliding block by [m/s]", behind, CALM_SPEED)


def start_there(trial: Trial, places: Floats, up: Floats) -> None:
    """As `Trial.start`, but along the slope alone: what leaves one of 89° by 2 cm/s falls 0.2 m before it is back."""
    shake = trial.random.uniform(-SHAKE, SHAKE, places.shape)
    trial.simulation.place(places, shake - np.outer(shake @ up, up))
    trial.watch.begin()


def turns_of(x: Floats, v: Floats, mass: Floats) -> float:
    """How fast a cloth turns about the y axis, in the direction of a positive `spin` [radians/s]."""
    spin = (x[:, 2] * v[:, 0] - x[:, 0] * v[:, 2]) @ mass
    return float(spin / ((x[:, 0] ** 2 + x[:, 2] ** 2) @ mass))


def rotating_ball(trial: Trial) -> None:
    """A sheet falls on a ball that turns about its upright axis, never turns faster than it, and stops with it."""
    path: Keyframes = ((0.0, 0, 0, 0, 0, 0, 0), (SPIN_SECONDS, 0, 0, 0, 0, SPIN * SPIN_SECONDS, 0))
    ball = Sphere(center=(0.0, -0.35, 0.0), radius=0.3, margin=MARGIN, friction=0.4, path=path)
    trial.open(sheet(CELLS, pins=(), rotation=FLAT, spheres=(ball,), ground=Ground(height=-1.2)))
    trial.start()
    for _ in range(round(SPIN_SECONDS / FRAME_SECONDS)):
        trial.one_frame()
        simulation = trial.simulation
        rate = turns_of(simulation.positions(), simulation.velocities(), simulation.topology.mass)
        trial.tell("rate of the sheet, of the ball's", rate / radians(SPIN), 1 + FASTER)
    trial.run(3.0)
    trial.settle()


def tablecloth(trial: Trial) -> None:
    """A sheet is pulled by an edge at 1 m/s over a smooth table, from under another that lies loose on it.

    Bodies in a scene are led and weigh nothing, so a sheet takes the place of the ball that the list has on the
    tablecloth: friction is the only force along the table on it, and what it does to its momentum is measured without
    damping. In the mean of any tenth of a second it may not be more than μ times the weight of that sheet.
    """
    mu = 0.3
    apart = replace(thin(), friction=mu)
    table = Box(center=(0.0, -0.1, 0.0), size=(3.6, 0.2, 1.6), margin=MARGIN, friction=0.0)
    edge = tuple((TABLE_CELLS + 1) * row + TABLE_CELLS for row in range(TABLE_CELLS + 1))  # the right, of the lower one
    scene = sheet(TABLE_CELLS, pins=edge, rotation=FLAT, damping=0.0, boxes=(table,), center=(0.0, MARGIN, 0.0))
    scene = replace(pile(scene, 2, 1.05 * apart.thickness), self_collision=apart)
    x = trial.open(scene, rest=sheet(TABLE_CELLS))  # both lie
    trial.frame_limit_ms(TWO_SHEETS_MS, "two sheets that lie on each other")
    trial.start()
    trial.simulation.set("damping", DAMPING)
    trial.run(1.0)
    trial.simulation.set("damping", 0.0)
    pins = x[trial.simulation.topology.pinned]
    upper = slice(len(x) // 2, None)
    mass = trial.simulation.topology.mass[upper]
    momentum = [float(trial.simulation.velocities()[upper, 0] @ mass)]
    for k in range(1, 31):
        trial.lead_pins(pins + [k * FRAME_SECONDS, 0, 0])
        trial.one_frame()
        momentum.append(float(trial.simulation.velocities()[upper, 0] @ mass))
    window = 6  # frames: a tenth of a second
    forces = (np.array(momentum[window:]) - momentum[:-window]) / (window * FRAME_SECONDS)
    weight = DENSITY * SIDE**2 * GRAVITY
    trial.tell("friction, of μ times the weight", float(np.abs(forces).max()) / (mu * weight), 1 + HEAVIER)
    trial.simulation.set("damping", DAMPING)
    trial.run(1.0)
    trial.settle()
