"""A1: motion without deformation. A sheet at rest in itself must fall, fly and turn as a stone does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import exp, pi

import numpy as np

from ..scene.model import FRAME_SECONDS, Cloth, Fabric, Forces, Ground, Limit, Scene, SelfCollision, Sphere, Tethers
from ..simulation import Simulation
from .exact import GRAVITY, Floats, dumbbell_rate, euler_drop
from .row import Row, at_most, relative
from .setups import EULER, Timed, advance, base, center, structural, substep, usual

FALL = (1e-3, 1e-5)  # pass, excellent: of the drop
STRAIN = (1e-4, 1e-6)
FALL_SINGLE = (1e-2, 1e-3)  # A1.3: 1 %, 0.1 % at the default step
HEIGHTS = (0.9, 3.0, 10.0, 100.0)  # [m]
SPIN_SECONDS = 10.0
MOMENTUM = (1e-5, 1e-6)  # A1.6: 1e-5 in float32
KEPT = 0.99  # A1.5
SPIN_LAW = "each step goes along the tangent and is pulled back: φ' = atan(sin φ/(2 − cos φ)), to 1e-3"
DAMPING = (1e-2, 1e-3)


def drop(solver: str, seconds: float, h: float) -> float:
    """What the method itself should fall [m]: Euler steps go ½ght too far, the others are exact."""
    return euler_drop(seconds, h) if solver in EULER else GRAVITY * seconds**2 / 2


def free_fall(solver: str) -> Iterator[Row]:
    with Timed(base(solver)) as simulation:
        advance(simulation, 1.0)
        yield relative("drop after 1 s [m]", drop(solver, 1.0, substep(simulation)), -center(simulation)[1], *FALL)
        yield at_most("strain after 1 s of free fall", simulation.measure().max_strain, *STRAIN)


def fall_with_everything(solver: str) -> Iterator[Row]:
    """All that acts within a cloth is on, and bodies far below: nothing of it may slow the fall.

    Wind is left out because air does slow a fall (A6.1), and tear because it can only take springs away: a sheet that
    falls freely has no strain to tear at.
    """
    scene = Scene(
        cloth=Cloth(rows=33, columns=65, width=4.0, height=4.0, center=(0.0, 0.0, 0.0), pins=(), area_density=0.15),
        fabric=Fabric(damping_time=1e-3, bending=1e-4),
        solver=usual(solver),
        limit=Limit(),
        tethers=Tethers(),
        spheres=(Sphere(center=(0.0, -40.0, 0.0), friction=0.5),),
        ground=Ground(height=-60.0),
        self_collision=SelfCollision(),
    )
    with Timed(scene) as simulation:
        advance(simulation, 1.0)
        exact = drop(solver, 1.0, substep(simulation))
        yield relative("drop after 1 s, every stage on [m]", exact, -center(simulation)[1], *FALL)


def fall_from_heights(solver: str) -> Iterator[Row]:
    """float32 holds fewer digits of a place far from 0, and a small step falls between them."""
    for height in HEIGHTS:
        with Timed(base(solver, center=(0.0, height, 0.0))) as simulation:
            start = center(simulation)[1]
            advance(simulation, 0.4)
            exact = drop(solver, 0.4, substep(simulation))
            yield relative(
                f"drop after 0.4 s from {height:g} m [m]", exact, start - center(simulation)[1], *FALL_SINGLE
            )


def parabola(solver: str) -> Iterator[Row]:
    with Timed(base(solver)) as simulation:
        simulation.place(simulation.topology.start, (3.0, 4.0, 1.0))
        advance(simulation, 1.0)
        exact = np.array([3.0, 4.0 - drop(solver, 1.0, substep(simulation)), 1.0])
        miss = float(np.linalg.norm(center(simulation) - exact))
        length = float(np.linalg.norm(exact))
        yield Row("way after 1 s, thrown at (3, 4, 1) m/s [m]", length, length + miss, miss / length, *FALL)


def spin(solver: str) -> Iterator[Row]:
    """A stiff plate turns in its plane once a second. What is kept may not be less than for position-based dynamics."""
    scene = structural(base(solver, 2, 2), 2e4)
    scene = replace(scene, forces=Forces(gravity=0.0), fabric=replace(scene.fabric, shear=2e4))
    scene = replace(scene, springs=replace(scene.springs, shear=1.0))
    with Timed(scene) as simulation:
        x = simulation.topology.start
        simulation.place(x, 2 * pi * np.stack([-x[:, 1], x[:, 0], 0 * x[:, 0]], axis=1))
        advance(simulation, SPIN_SECONDS - 0.1)
        before = simulation.positions()[0]
        advance(simulation, 0.1)
        after = simulation.positions()[0]
        angle = np.arctan2(np.cross(before, after)[2], before @ after)
        kept = float(angle / (0.1 * 2 * pi))
        law = dumbbell_rate(1.0, substep(simulation), SPIN_SECONDS)
        row = Row("share of 1 turn/s kept for 10 s", 1.0, kept, abs(1 - kept), 1 - law, 1 - KEPT)
        yield row.by_law(SPIN_LAW, 1 - law, 1e-3) if solver in EULER else row


def damping(solver: str) -> Iterator[Row]:
    """Thrown without weight, a sheet slows down by its damping alone: e^(−ct)."""
    rate, speed = 1.5, 2.0
    scene = replace(base(solver), forces=Forces(gravity=0.0))
    with Timed(replace(scene, solver=replace(scene.solver, damping=rate))) as simulation:
        simulation.place(simulation.topology.start, (speed, 0.0, 0.0))
        advance(simulation, 1.0)
        left = float(simulation.velocities()[:, 0].mean())
        yield relative("speed left of 2 m/s after 1 s of 1.5/s [m/s]", speed * exp(-rate), left, *DAMPING)
        way = speed / rate * (1 - exp(-rate))
        yield relative("way in that second [m]", way, center(simulation)[0], *DAMPING)


def momentum(solver: str) -> Iterator[Row]:
    """Random velocities, no weight: 1000 substeps change neither momentum nor, but for A1.5, angular momentum."""
    scene = replace(base(solver), forces=Forces(gravity=0.0))
    with Timed(scene) as simulation:
        topology = simulation.topology
        mass = topology.mass[:, None]
        v = np.random.default_rng(5).normal(0.0, 0.2, topology.start.shape)
        simulation.place(topology.start, v)
        v = simulation.velocities()
        size = float((mass[:, 0] * np.linalg.norm(v, axis=1)).sum())
        before, turning = (mass * v).sum(axis=0), angular_momentum(simulation)
        frames = max(1, 1000 // simulation.substeps)
        for _ in range(frames):
            simulation.advance_frame()
        change = float(np.linalg.norm((mass * simulation.velocities()).sum(axis=0) - before))
        yield at_most("momentum lost in 1000 substeps, of all that moves", change / size, *MOMENTUM)
        turn = float(np.linalg.norm(angular_momentum(simulation) - turning))
        arm = float(np.sqrt((topology.start**2).sum(axis=1).mean()))
        rate = float(np.sqrt((v**2).sum(axis=1).mean())) / arm / (2 * pi)
        law = 1 - dumbbell_rate(rate, substep(simulation), frames * FRAME_SECONDS) if solver in EULER else 0.0
        what = "angular momentum lost in 1000 substeps, of all that moves"
        yield at_most(what, turn / size / arm, MOMENTUM[0] + law, MOMENTUM[1])


def angular_momentum(simulation: Simulation) -> Floats:
    """About the origin, where the centre of mass begins [kg·m²/s]."""
    about: Floats = (simulation.topology.mass[:, None] * np.cross(simulation.positions(), simulation.velocities())).sum(
        axis=0
    )
    return about
