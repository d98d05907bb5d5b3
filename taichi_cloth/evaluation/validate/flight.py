"""A1 and A6: motion without deformation, and air.

A1: an undeformed sheet falls, flies and rotates as a rigid body does. A6: drag and lift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from math import exp, pi

import numpy as np

from ...geometry.topology import spring_strains
from ...scene.collider_schema import Ground, Sphere
from ...scene.fabric_schema import Fabric
from ...scene.schema import Cloth, Forces, Scene, SelfCollision, StrainLimit, Tethers, Wind
from ...simulation.convergence import unconverged_fraction
from ...simulation.frame_clock import FrameClock
from ...simulation.simulation import Simulation
from .check import (
    ELASTIC,
    EULER,
    SAME_ITERATIONS,
    SOFTER,
    Check,
    Timed,
    advance,
    at_most,
    base,
    center,
    default_solver,
    effective_stiffness,
    relative,
    strip,
    strip_constant,
    structural,
    substep,
)
from .exact import GRAVITY, Floats, euler_drop, fall_in_air, projected_spin_rate, sail_sag, sail_tension, terminal_speed
from .float64_steps import lines_in_float64, sweeps_in_float64

FALL = (1e-3, 1e-5)  # pass, excellent: share of the drop
STRAIN = (1e-4, 1e-6)
FALL_SINGLE = (1e-2, 1e-3)  # A1.3: 1 %, 0.1 % at the default step
HEIGHTS = (0.9, 3.0, 10.0, 100.0)  # [m]
SPIN_SECONDS = 10.0
MOMENTUM = (1e-5, 1e-6)  # A1.6: 1e-5 in float32
FLOAT64_STEPS: dict[str, Callable[[Simulation], Iterator[tuple[Floats, Floats]]]] = {
    "verlet": sweeps_in_float64,
    "xpbd": sweeps_in_float64,
    "lines": lines_in_float64,
}
MIN_RATE = 0.99  # A1.5
LINEARIZED = f"corrections keep the directions of their iterations: {SAME_ITERATIONS} lose as much at times"
SPIN_LAW = "each step goes along the tangent and is pulled back: φ' = atan(sin φ/(2 − cos φ)), to 1e-3"
ROUNDED_CORRECTIONS = (
    "float32 rounds a position at each correction by a spring, and velocities by that over h: √n·ulp/√12"
)
DAMPING = (1e-2, 1e-3)


def expected_drop(solver: str, seconds: float, h: float) -> float:
    """Return the distance [m] that a solver falls: Euler steps fall ½ght too far, the others are exact."""
    return euler_drop(seconds, h) if solver in EULER else GRAVITY * seconds**2 / 2


def free_fall(solver: str) -> Iterator[Check]:
    """Measure the drop and the strain after 1 s of free fall."""
    with Timed(base(solver)) as simulation:
        advance(simulation, 1.0)
        yield relative(
            "drop after 1 s [m]", expected_drop(solver, 1.0, substep(simulation)), -center(simulation)[1], *FALL
        )
        yield at_most("strain after 1 s of free fall", largest_strain(simulation), *STRAIN)


def largest_strain(simulation: Simulation) -> float:
    """Return the largest strain of any spring, stretched or compressed; that of `metrics` is of stretched threads."""
    return float(np.abs(spring_strains(simulation.topology, simulation.positions())).max())


def fall_with_all_features(solver: str) -> Iterator[Check]:
    """Measure drop and strain in free fall with all forces and constraints within the cloth, and colliders far below.

    None of them may slow the fall. Wind is left out because air does slow a fall (A6.1), and tearing because it can
    only remove springs: a sheet in free fall has no strain at which it could tear.
    """
    scene = Scene(
        cloth=Cloth(rows=33, columns=65, width=4.0, height=4.0, center=(0.0, 0.0, 0.0), pins=(), area_density=0.15),
        fabric=Fabric(damping_time=1e-3, bending_stiffness=1e-4),
        solver=default_solver(solver),
        strain_limit=StrainLimit(),
        tethers=Tethers(),
        spheres=(Sphere(center=(0.0, -40.0, 0.0), friction=0.5, margin=0.15),),
        ground=Ground(height=-60.0),
        self_collision=SelfCollision(),
    )
    with Timed(scene) as simulation:
        advance(simulation, 1.0)
        exact = expected_drop(solver, 1.0, substep(simulation))
        yield relative("drop after 1 s, every stage on [m]", exact, -center(simulation)[1], *FALL)
        yield at_most("strain after 1 s, every stage on", largest_strain(simulation), *STRAIN)


def fall_from_heights(solver: str) -> Iterator[Check]:
    """Measure free fall from several heights: far from 0, float32 has fewer digits and loses small steps."""
    for height in HEIGHTS:
        with Timed(base(solver, center=(0.0, height, 0.0))) as simulation:
            start = center(simulation)[1]
            advance(simulation, 0.4)
            exact = expected_drop(solver, 0.4, substep(simulation))
            yield relative(
                f"drop after 0.4 s from {height:g} m [m]", exact, start - center(simulation)[1], *FALL_SINGLE
            )


def parabola(solver: str) -> Iterator[Check]:
    """Measure the position of a sheet 1 s after a throw."""
    with Timed(base(solver)) as simulation:
        simulation.set_state(simulation.topology.start, (3.0, 4.0, 1.0))
        advance(simulation, 1.0)
        exact = np.array([3.0, 4.0 - expected_drop(solver, 1.0, substep(simulation)), 1.0])
        error = float(np.linalg.norm(center(simulation) - exact))
        length = float(np.linalg.norm(exact))
        yield Check("way after 1 s, thrown at (3, 4, 1) m/s [m]", length, length + error, error / length, *FALL)


def spin(solver: str) -> Iterator[Check]:
    """Measure a stiff plate that rotates in its plane at 1 turn/s.

    It must keep at least as much of its rate as position-based dynamics does.
    """
    scene = structural(base(solver, 2, 2), 2e4)
    scene = replace(scene, forces=Forces(gravity=0.0), fabric=replace(scene.fabric, shear=2e4))
    scene = replace(scene, verlet=replace(scene.verlet, shear=1.0))
    with Timed(scene) as simulation:
        x = simulation.topology.start
        simulation.set_state(x, 2 * pi * np.stack([-x[:, 1], x[:, 0], 0 * x[:, 0]], axis=1))
        advance(simulation, SPIN_SECONDS - 0.1)
        before = simulation.positions()[0]
        advance(simulation, 0.1)
        after = simulation.positions()[0]
        angle = np.arctan2(np.cross(before, after)[2], before @ after)
        kept = float(angle / (0.1 * 2 * pi))
        law = projected_spin_rate(1.0, substep(simulation), SPIN_SECONDS)
        row = Check("share of 1 turn/s kept for 10 s", 1.0, kept, abs(1 - kept), 1 - law, 1 - MIN_RATE)
        yield row.by_law(SPIN_LAW, 1 - law, 1e-3) if solver in EULER else row


def damping(solver: str) -> Iterator[Check]:
    """Measure a sheet that is thrown without gravity: damping alone slows it down, by e^(−ct)."""
    rate, speed = 1.5, 2.0
    scene = replace(base(solver), forces=Forces(gravity=0.0))
    with Timed(replace(scene, solver=replace(scene.solver, damping=rate))) as simulation:
        simulation.set_state(simulation.topology.start, (speed, 0.0, 0.0))
        advance(simulation, 1.0)
        left = float(simulation.velocities()[:, 0].mean())
        yield relative("speed left of 2 m/s after 1 s of 1.5/s [m/s]", speed * exp(-rate), left, *DAMPING)
        distance = speed / rate * (1 - exp(-rate))
        yield relative("way in that second [m]", distance, center(simulation)[0], *DAMPING)


def momentum(solver: str) -> Iterator[Check]:
    """Measure momentum and angular momentum after 1000 substeps from random velocities, without gravity.

    Momentum must not change, and angular momentum by no more than A1.5 explains.
    """
    scene = replace(base(solver), forces=Forces(gravity=0.0))
    with Timed(scene) as simulation:
        topology = simulation.topology
        mass = topology.mass[:, None]
        v = np.random.default_rng(5).normal(0.0, 0.2, topology.start.shape)
        simulation.set_state(topology.start, v)
        v = simulation.velocities()
        size = float((mass[:, 0] * np.linalg.norm(v, axis=1)).sum())
        before, angular_before = (mass * v).sum(axis=0), angular_momentum(simulation)
        frames = max(1, 1000 // simulation.substeps)
        for _ in range(frames):
            simulation.step()
        change = float(np.linalg.norm((mass * simulation.velocities()).sum(axis=0) - before))
        row = at_most("momentum lost in 1000 substeps, of all that moves", change / size, *MOMENTUM)
        rounded = rounded_momentum(simulation) / size if solver == "verlet" else None  # root mean square
        if rounded is not None:
            row = row.by_law(ROUNDED_CORRECTIONS, rounded, rounded)  # twice as much is rare
        yield row
        lost = float(np.linalg.norm(angular_momentum(simulation) - angular_before))
        radius = float(np.sqrt((topology.start**2).sum(axis=1).mean()))
        row = at_most("angular momentum lost in 1000 substeps, of all that moves", lost / size / radius, *MOMENTUM)
        if solver in FLOAT64_STEPS:
            simulation.set_state(topology.start, v)
            lost_in_float64 = partial(most_lost, simulation, frames * simulation.substeps, size * radius)
            row = row.by_law(LINEARIZED, lost_in_float64, rounded)
        yield row


def most_lost(simulation: Simulation, substeps: int, scale: float) -> float:
    """Return the most angular momentum over `scale` [kg·m²/s] that a solver loses in float64 after any of the substeps.

    A sheet without pins crumples. Rounding then soon decides what it has lost at one time, but not how much it is.
    """
    mass, before = simulation.topology.mass[:, None], angular_momentum(simulation)
    steps = islice(FLOAT64_STEPS[simulation.scene.solver.name](simulation), substeps)
    return max(float(np.linalg.norm((mass * np.cross(x, v)).sum(axis=0) - before)) for x, v in steps) / scale


def rounded_momentum(simulation: Simulation) -> float:
    """Return the momentum [kg·m/s] that rounding of positions to float32 adds in the substeps so far.

    A correction by a spring rounds a position by up to ½ulp, ½ulp/√3 root mean square. The position over the length of
    a substep is the velocity, and independent errors of n corrections add up to √n times as much.
    """
    topology, substeps = simulation.topology, round(simulation.seconds / substep(simulation))
    springs = np.bincount(topology.ends.ravel(), minlength=len(topology.mass))
    corrections = substeps * (simulation.scene.solver.iterations * springs + 1)
    ulp = np.spacing(np.abs(topology.start).astype(np.float32)).astype(float)
    variance = (topology.mass**2 * corrections)[:, None] * ulp**2 / 12
    return float(np.sqrt(variance.sum())) / substep(simulation)


def angular_momentum(simulation: Simulation) -> Floats:
    """Return the angular momentum about the origin, where the center of mass starts [kg·m²/s]."""
    total: Floats = (simulation.topology.mass[:, None] * np.cross(simulation.positions(), simulation.velocities())).sum(
        axis=0
    )
    return total


# -- air ---------------------------------------------------------------------------------------------------------------

STILL = Wind(turbulence=0.0)
DENSITIES = (0.1, 0.15, 0.2, 0.5)  # [kg/m²]
TIMES = (0.2, 1.0)  # [s]
RATES = (30, 120, 240)  # [1/s] frame rates of a window; all other rows have 60
EULER_FALL = "a step adds h·a to the speed, then h·v to the way: the sum of such steps in float64"
TERMINAL_FALL = (1e-2, 1e-3)  # A6: 1 %, 0.1 %
SAIL = (1e-2, 2e-3)  # A6: 1 %, 0.2 %
SAIL_LINKS = 32
SPANS = (0.6, 0.8, 0.9)  # [m]
TENSION_SPAN = 0.8
WIND = 2.0  # [m/s]


def falling(solver: str) -> Iterator[Check]:
    """Measure a level sheet in still air: its terminal speed, and its speed and distance on the way there."""
    for density in DENSITIES:
        terminal = terminal_speed(density, STILL.air_density, STILL.drag)
        with Timed(level(solver, density)) as simulation:
            done, start = 0.0, center(simulation)[1]
            for seconds in TIMES if density == 0.2 else ():
                advance(simulation, seconds - done)
                done = seconds
                speed, distance = fall_in_air(seconds, terminal)
                yield relative(
                    f"speed after {seconds:g} s of falling flat [m/s]", speed, mean_speed(simulation), *TERMINAL_FALL
                )
                row = relative(f"way after {seconds:g} s [m]", distance, start - center(simulation)[1], *TERMINAL_FALL)
                law = euler_fall(seconds, terminal, substep(simulation)) / distance - 1
                yield row.by_law(EULER_FALL, law) if solver in EULER else row
            advance(simulation, 3.0 - done)
            yield relative(
                f"terminal speed of {density:g} kg/m² [m/s]", terminal, mean_speed(simulation), *TERMINAL_FALL
            )
    exact = fall_in_air(1.0, terminal_speed(0.2, STILL.air_density, STILL.drag))[1]
    distances = [fall_at_frame_rate(solver, rate) for rate in RATES]
    worst = max(distances, key=lambda one: abs(one - exact))
    rates = ", ".join(map(str, RATES))
    yield relative(f"way after 1 s at {rates} pictures a second, the worst [m]", exact, worst, *TERMINAL_FALL)


def euler_fall(seconds: float, terminal: float, h: float) -> float:
    """Return the distance [m] that a sheet with a terminal speed [m/s] falls from rest in symplectic Euler steps."""
    speed = distance = 0.0
    for _ in range(round(seconds / h)):
        speed += h * GRAVITY * (1 - (speed / terminal) ** 2)
        distance += h * speed
    return distance


def fall_at_frame_rate(solver: str, rate: int) -> float:
    """Return the distance [m] that a sheet falls flat in 1 s, stepped as in a window with `rate` frames per second."""
    with Timed(level(solver, 0.2)) as simulation:
        clock, start = FrameClock(0.0), center(simulation)[1]
        for image in range(1, rate + 1):
            for _ in range(clock.due(image / rate)):
                simulation.step()
        distance: float = start - center(simulation)[1]
        return distance


def level(solver: str, density: float) -> Scene:
    """Return the scene of a level sheet with an area density [kg/m²] in still air."""
    return replace(base(solver, rotation=(-90.0, 0.0, 0.0), area_density=density), wind=STILL)


def sail(solver: str) -> Iterator[Check]:
    """Measure a strip that is pinned at two edges across a steady wind, without gravity.

    Its shape shows which drag law is implemented.
    """
    for name, lift in (
        ("lift and drag: pressure with the cosine", 1.0),
        ("drag alone: its square, along the wind", 0.0),
    ):
        for span in SPANS:
            scene = strip(solver, SAIL_LINKS, constant=5e3, pins=("top", "bottom"))
            scene = replace(scene, wind=replace(STILL, z=WIND, lift=lift), forces=Forces(gravity=0.0))
            scene = replace(scene, solver=replace(scene.solver, damping=3.0))
            with Timed(scene) as simulation:
                start = simulation.topology.start.reshape(SAIL_LINKS + 1, 3, 3).copy()
                along = np.linspace(0.5, -0.5, SAIL_LINKS + 1)
                start[:, :, 1] = span * along[:, None]
                start[:, :, 2] = (np.sqrt(1 - span**2) * (0.5 - np.abs(along)))[:, None]
                simulation.set_state(start.reshape(-1, 3))
                advance(simulation, 8.0)
                sag = float(simulation.positions()[:, 2].max())
                row = relative(f"sag at {span:g} m, {name} [m]", sail_sag(span, lift == 0.0), sag, *SAIL)
                if solver == "verlet":
                    mass, iterations = float(simulation.topology.mass[4]), scene.solver.iterations
                    soft = effective_stiffness(solver, 0.0, mass, substep(simulation), iterations)
                    row = row.by_law(SOFTER, partial(excess_sag, soft, span, lift == 0.0))
                yield row
                if span == TENSION_SPAN and solver in ELASTIC:
                    ratio = tension(simulation, across=lift == 0.0) / (
                        0.5 * STILL.air_density * STILL.drag * WIND**2 * 0.1
                    )
                    exact = sail_tension(span, lift == 0.0)
                    row = relative(f"tension in the middle over p·L at {span:g} m, {name}", exact, ratio, *SAIL)
                    yield row.by_law(SOFTER, partial(excess_elongation, simulation)) if solver == "xpbd" else row


def excess_sag(constant: float, span: float, drag_only: bool) -> float:
    """Return the excess sag of a sail whose springs have a constant [N/m], as a share.

    The middle column sags most. It carries half of the wind, and its length grows by its tension. With drag alone the
    tension along the wind is not constant; it is at least that across, over the mean cosine of the angle between.
    """
    force = sail_tension(span, drag_only) * 0.5 * STILL.air_density * STILL.drag * WIND**2 * 0.05  # [N]
    length = 1 + force / (span if drag_only else 1.0) * SAIL_LINKS / constant
    return sail_sag(span / length, drag_only) * length / sail_sag(span, drag_only) - 1


def excess_elongation(simulation: Simulation) -> float:
    """Return how much longer links are than their tension makes them, as a share: `tension` measures their lengths.

    The outer two of the three columns have half the stiffness of the middle one and carry half its wind, but masses are
    equal: each column has its own share.
    """
    constant, mass = strip_constant(simulation), float(simulation.topology.mass[4])
    h, iterations = substep(simulation), simulation.scene.solver.iterations
    outer, inner = (unconverged_fraction(part * constant, mass, h, iterations) for part in (0.25, 0.5))
    return (2 * outer + inner) / 3


def mean_speed(simulation: Simulation) -> float:
    """Return the mean downward speed [m/s]."""
    return -float(np.average(simulation.velocities()[:, 1], weights=simulation.topology.mass))


def tension(simulation: Simulation, across: bool) -> float:
    """Return the tension of the middle half of a strip [N], from the elongation of its links.

    `across` selects the component across the wind: with drag alone, only that one is constant along the strip. `verlet`
    has no spring constant in N/m, and so no tension.
    """
    x = simulation.positions().reshape(-1, 3, 3)
    quarter = (len(x) - 1) // 4
    gap = np.diff(x, axis=0)[quarter:-quarter]
    length = np.linalg.norm(gap, axis=2)
    share = np.abs(gap[:, :, 1]) / length if across else 1.0
    return strip_constant(simulation) * float(((length - 1.0 / (len(x) - 1)) * share).mean())
