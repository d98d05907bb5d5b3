"""A2 and B1: oscillation and damping."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from math import pi, sqrt

import numpy as np

from ...geometry.cloth_builder import spring_stiffness
from ...scene.schema import FRAME_SECONDS, Forces, Scene
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.simulation import Simulation
from ...solvers import SOLVERS
from ..bench.error_sweep import Curtain, curtain_solution
from .check import (
    EULER,
    FLOAT32_EPSILON,
    POSITION_ROUNDED,
    SOFTER_EULER,
    Check,
    Timed,
    advance,
    base,
    frequency,
    relative,
    run_with_limit,
    strip,
    strip_constant,
    structural,
    substep,
    swing_frames,
    zero_crossings,
)
from .exact import (
    CURTAIN,
    TWO_STAGE,
    Floats,
    chain_modes,
    damped_swing,
    longitudinal_modes,
    pendulum_period,
    projected_swing,
    spring_amplitude,
    spring_scheme,
    string_displacement,
    taut_modes,
)
from .hanging import euler_curtain, euler_run, two_stage_loss

ANGLES = (10, 30, 60, 90, 120, 150, 170)  # [degrees] from hanging
SWING = (1e-2, 1e-3)  # A2: 1 %, 0.1 %
SCHEME = (1e-4, 1e-5)  # A2: to 1e-4 of the scheme's own value
SPRING_CONSTANT, SPRING_SUBSTEPS = 1000.0, (1, 4, 16, 100)  # A2: [N/m]; h = 1/60, 1/240, 1/960, 1/6000 s
STRETCH = 0.5  # [m] A2: from 1 m to 1.5 m
DAMPED_HERTZ, DAMPED_SUBSTEPS = (2.0, 5.0), (1, 10, 100)  # A2: h = 1/60, 1/600, 1/6000 s
HANGING_LINKS = (10, 20, 50, 100)
LINKS, MODES = 20, 3
TAUT_LINKS = (16, 32, 64)
TAUT_TENSION, TAUT_MASS, TAUT_WIDTH = 10.0, 0.1, 0.1  # [N], [kg], [m] of a strip of one meter: waves of 10 m/s
PULSE_FRAMES = 3  # 0.05 s, in which the pulse travels half a meter
PULSE_START, PULSE_WIDTH = 0.25, 0.07  # [m] center and standard deviation of a Gaussian
TANGENT = "a step goes along the tangent and is pulled back to the rod: the swing of such steps in float64"
STIFF_BAR = "steps of two stages damp a stiff bar that turns: the same steps in float64, solved exactly"
DAMPER_TOLERANCES = (2e-2, 2e-3)
HEIGHT_PERIODS = 10
CURTAIN_SECONDS = (0.25, 0.5, 1.0)
CURTAIN_ERROR = (1e-2, 1e-3)  # B1: within 1 %, and 0.1 %, of the converged motion


def pendulum(solver: str) -> Iterator[Check]:
    """Measure the period of a stiff strip of one cell that is released at rest.

    It is twice the time between passes through the lowest point.
    """
    for degrees in ANGLES:
        period = pendulum_period(degrees, 1.0)
        frames = round(period / FRAME_SECONDS) + 2
        with Timed(rod(solver, degrees)) as simulation:
            angles = angles_of(simulation, frames)
            row = relative(f"period from {degrees}° [s]", period, period_in(angles), *SWING)
            if solver in EULER:
                law = projected_swing(degrees, 1.0, substep(simulation), (frames - 1) * FRAME_SECONDS, FRAME_SECONDS)
                row = row.by_law(TANGENT, abs(period_in(law) / period - 1))
            yield row


def rod(solver: str, degrees: float) -> Scene:
    """Return the scene of one cell that swings about its top edge.

    Equal masses and diagonals make it a rigid body: with unequal ones it twists, and without the others a cell above
    its hinge falls sideways. The cell is square: in a long one the diagonals carry the load instead of the columns, and
    `lines` converges slowly.
    """
    rotation = (float(degrees), 0.0, 0.0)
    scene = structural(base(solver, 2, 2, pins=("top",), mass_lumping="uniform", rotation=rotation), 1e5)
    diagonals = replace(scene.fabric, shear=1e5)
    return replace(scene, fabric=diagonals, verlet=replace(scene.verlet, shear=1.0))


def angles_of(simulation: Simulation, frames: int) -> Floats:
    """Return the angle from hanging before each frame [rad], (frames,)."""
    pivot = simulation.topology.start[0]
    angles = []
    for _ in range(frames):
        below = simulation.positions()[2] - pivot
        angles.append(np.arctan2(below[2], -below[1]))
        simulation.step()
    return np.array(angles)


def period_in(angles: Floats) -> float:
    """Return the period [s] of angles that were sampled once per frame."""
    times = zero_crossings(angles)
    return 2 * FRAME_SECONDS * float(times[1] - times[0]) if len(times) > 1 else float("nan")


def pendulum_height(solver: str) -> Iterator[Check]:
    """Measure the amplitude of the pendulum after ten periods."""
    for degrees in ANGLES:
        period = pendulum_period(degrees, 1.0)
        frames, last = round((HEIGHT_PERIODS + 0.25) * period / FRAME_SECONDS), round(0.5 * period / FRAME_SECONDS)
        with Timed(rod(solver, degrees)) as simulation:
            amplitude = float(np.degrees(np.abs(angles_of(simulation, frames)[-last:]).max()))
            row = relative(f"angle after ten periods from {degrees}° [°]", degrees, amplitude, *SWING)
            if solver in EULER:
                law = projected_swing(degrees, 1.0, substep(simulation), (frames - 1) * FRAME_SECONDS, FRAME_SECONDS)
                row = row.by_law(TANGENT, 1 - float(np.degrees(np.abs(law[-last:]).max())) / degrees)
            elif solver in TWO_STAGE:
                row = row.by_law(STIFF_BAR, partial(two_stage_loss, simulation, degrees, frames, last))
            yield row


def one_spring(solver: str) -> Iterator[Check]:
    """Compare a spring with a mass of 1 kg with the discrete law of the method: its motion for 1 s, and its damping."""
    with released_spring(spring_scene(solver, SPRING_CONSTANT), STRETCH) as simulation:
        steps = simulation.substeps
        law = spring_scheme(solver, sqrt(SPRING_CONSTANT), substep(simulation), 60 * steps)[steps::steps]
        samples = []
        for _ in range(60):
            simulation.step()
            samples.append((simulation.topology.start[2, 1] - simulation.positions()[2, 1]) / STRETCH)
        worst = int(np.abs(np.array(samples) - law).argmax())
        name = f"length over rest, of the first {STRETCH:g} m, at frame {worst + 1}"
        yield Check(name, float(law[worst]), samples[worst], float(abs(samples[worst] - law[worst])), *SCHEME)
    for substeps in SPRING_SUBSTEPS:
        yield numerical_damping(solver, f"{SPRING_CONSTANT:g} N/m", SPRING_CONSTANT, substeps)
    if solver in EULER:
        for hertz in DAMPED_HERTZ:
            for substeps in DAMPED_SUBSTEPS:
                yield numerical_damping(solver, f"{hertz:g} Hz", (2 * pi * hertz) ** 2, substeps)


def numerical_damping(solver: str, name: str, constant: float, substeps: int) -> Check:
    """Measure which share of the amplitude of a spring, `constant` [N/m], survives a second."""
    scene, omega = spring_scene(solver, constant), sqrt(constant)
    with released_spring(replace(scene, solver=replace(scene.solver, substeps=substeps)), STRETCH) as simulation:
        steps = round(simulation.substeps / FRAME_SECONDS)
        exact = spring_amplitude(solver, omega, substep(simulation), steps)
        advance(simulation, 1.0)
        displacement = simulation.topology.start[2, 1] - simulation.positions()[2, 1]
        left = float(np.hypot(displacement, simulation.velocities()[2, 1] / omega)) / STRETCH
        row = relative(f"share of the amplitude after 1 s, {name}, {steps} steps/s", exact, left, *SCHEME)
        return row.by_law(POSITION_ROUNDED, FLOAT32_EPSILON / 2 / (STRETCH * exact))


def spring_scene(solver: str, constant: float) -> Scene:
    """Return the scene of two springs side by side, each of `constant` [N/m] with a mass of 1 kg, without gravity."""
    sheet = base(solver, 2, 2, pins=("top",), area_density=1.0, mass_lumping="uniform")
    scene = structural(sheet, constant)
    return replace(scene, forces=Forces(gravity=0.0), fabric=replace(scene.fabric, weft=0.0))


def released_spring(scene: Scene, stretch: float) -> Timed:
    """Return a simulation of `spring_scene` whose springs are stretched by some length [m]."""
    simulation = Timed(scene)
    simulation.set_state(simulation.topology.start - np.outer([0.0, 0.0, stretch, stretch], [0.0, 1.0, 0.0]))
    return simulation


def curtain_modes(solver: str) -> Iterator[Check]:
    """Measure the first modes of hanging strips, at small amplitude."""
    for links in HANGING_LINKS:
        for mode in range(MODES):
            what = f"mode {mode + 1} of a hanging strip of {links} links [rad/s]"
            yield run_with_limit(what, *SWING, partial(curtain_mode, what, solver, links, mode))


def curtain_mode(what: str, solver: str, links: int, mode: int) -> Check:
    """Measure the frequency of one mode of a hanging strip."""
    omegas, shapes = chain_modes(links, 1.0, MODES)
    omega, shape = float(omegas[mode]), shapes[:, mode]
    with Timed(strip(solver, links, constant=1e4)) as simulation:
        start = simulation.topology.start.reshape(links + 1, 3, 3).copy()
        start[1:, :, 2] += 2e-3 * (shape / np.abs(shape).max())[:, None]
        simulation.set_state(start.reshape(-1, 3))
        amplitudes = []
        for _ in range(swing_frames(omega)):
            amplitudes.append(float(simulation.positions().reshape(links + 1, 3, 3)[1:, 1, 2] @ shape))
            simulation.step()
        row = relative(what, omega, frequency(amplitudes, omega), *SWING)
        if solver != "verlet":
            return row
        h, iterations = substep(simulation), simulation.scene.solver.iterations
        return row.by_law(SOFTER_EULER, partial(unconverged_mode, links, mode, iterations / h**2, h))


def unconverged_mode(links: int, mode: int, squared: float, h: float) -> float:
    """Return the error of the mode's frequency in backward Euler steps, for a chain of k/m = `squared` [1/s²].

    The chain starts unstretched, in the shape of the mode.
    """
    omegas, shapes = chain_modes(links, 1.0, MODES)
    omega, shape = float(omegas[mode]), shapes[:, mode]
    start = np.zeros((links + 1, 2))
    start[:, 1] = -np.arange(links + 1) / links
    start[1:, 0] = 2e-3 * shape / np.abs(shape).max()
    positions = euler_run(links, squared, start, h, swing_frames(omega) - 1)
    amplitudes = [float(x[1:, 0] @ shape) for x in (start, *positions)]
    return abs(frequency(amplitudes, omega) / omega - 1)


def taut_strip(solver: str) -> Iterator[Check]:
    """Measure a strip that is stretched from 0.9 m to 1 m and pinned at both ends: its first modes, and a pulse."""
    for links in TAUT_LINKS:
        for mode in range(MODES):
            what = f"mode {mode + 1} of a taut strip of {links} links [rad/s]"
            yield run_with_limit(what, *SWING, partial(taut_mode, what, solver, links, mode))
        what = f"speed of a pulse along a taut strip of {links} links [m/s]"
        yield run_with_limit(what, *SWING, partial(taut_pulse, what, solver, links))


def taut(solver: str, links: int) -> Scene:
    """Return a strip of 0.9 m without weight, which `pluck` stretches to 1 m."""
    constant = TAUT_TENSION / TAUT_WIDTH / 0.1 * 0.9  # [N/m] for an elongation of 0.1 m from 0.9 m
    scene = strip(solver, links, constant=constant, pins=("top", "bottom"))
    cloth = replace(scene.cloth, height=0.9, area_density=TAUT_MASS / TAUT_WIDTH / 0.9)
    return replace(scene, cloth=cloth, forces=Forces(gravity=0.0))


def pluck(simulation: Simulation, shape: Floats, rate: Floats) -> tuple[float, float]:
    """Stretch the strip and set its joints' displacements [m] and velocities [m/s], both (links + 1,).

    Returns (tension [N], mass [kg]).
    """
    topology, links = simulation.topology, len(shape) - 1
    start = topology.start.reshape(links + 1, 3, 3) * [1.0, 1 / 0.9, 1.0]
    start[:, :, 2] += shape[:, None]
    velocities = np.zeros((links + 1, 3, 3))
    velocities[:, :, 2] = rate[:, None]
    simulation.set_state(start.reshape(-1, 3), velocities.reshape(-1, 3))
    return strip_constant(simulation) * 0.1 / links, float(topology.mass.reshape(-1, 3)[1].sum())


def taut_mode(what: str, solver: str, links: int, mode: int) -> Check:
    """Measure the frequency of one mode of a taut strip."""
    with Timed(taut(solver, links)) as simulation:
        shape = np.sin((mode + 1) * pi * np.arange(links + 1) / links)
        tension, mass = pluck(simulation, 1e-3 * shape, 0 * shape)
        omega = float(taut_modes(links, tension, mass, 1.0, MODES)[mode])
        amplitudes = []
        for _ in range(swing_frames(omega)):
            amplitudes.append(float(simulation.positions().reshape(links + 1, 3, 3)[:, 1, 2] @ shape))
            simulation.step()
        return relative(what, omega, frequency(amplitudes, omega), *SWING)


def taut_pulse(what: str, solver: str, links: int) -> Check:
    """Measure the speed of a Gaussian pulse, compared with the same string in float64.

    Its position is the mean position, weighted by the square of the displacement.
    """
    along = np.arange(links + 1) / links
    with Timed(taut(solver, links)) as simulation:
        shape = 1e-3 * np.exp(-(((along - PULSE_START) / PULSE_WIDTH) ** 2) / 2)
        shape[[0, -1]] = 0.0
        speed = sqrt(TAUT_TENSION / TAUT_MASS)
        rate = shape * (along - PULSE_START) / PULSE_WIDTH**2 * speed  # it travels in one direction only
        tension, mass = pluck(simulation, shape, rate)
        seconds = PULSE_FRAMES * FRAME_SECONDS
        advance(simulation, seconds)
        measured = simulation.positions().reshape(links + 1, 3, 3)[:, 1, 2]
        exact = string_displacement(links, tension, mass, shape[1:-1], rate[1:-1], seconds)
        first, last, law = (weighted_mean(along, np.square(one)) for one in (shape, measured, np.pad(exact, 1)))
        return relative(what, (law - first) / seconds, (last - first) / seconds, *SWING)


def weighted_mean(along: Floats, weights: Floats) -> float:
    """Return the weighted mean position [m]."""
    return float(np.average(along, weights=weights))


def longitudinal_swing(solver: str) -> Iterator[Check]:
    """Measure the first longitudinal modes of a soft strip without weight."""
    for mode in range(MODES):
        scene = replace(strip(solver, LINKS, constant=20.0), forces=Forces(gravity=0.0))
        with Timed(scene) as simulation:
            topology = simulation.topology
            mass = float(topology.mass.reshape(-1, 3)[1].sum())
            omega = float(longitudinal_modes(LINKS, strip_constant(simulation), mass, MODES)[mode])
            shape = np.sin((2 * mode + 1) * pi * np.arange(LINKS + 1) / (2 * LINKS + 1))
            start = topology.start.reshape(LINKS + 1, 3, 3).copy()
            start[:, :, 1] += 2e-3 * shape[:, None]
            rest = topology.start.reshape(LINKS + 1, 3, 3)[:, 1, 1]
            simulation.set_state(start.reshape(-1, 3))
            amplitudes = []
            for _ in range(swing_frames(omega)):
                amplitudes.append(float((simulation.positions().reshape(LINKS + 1, 3, 3)[:, 1, 1] - rest) @ shape))
                simulation.step()
            yield relative(f"mode {mode + 1} of a strip along itself", omega, frequency(amplitudes, omega), *SWING)


def damped_spring(solver: str) -> Iterator[Check]:
    """Compare a soft spring with about a tenth of critical damping, released a tenth too long, with the exact law."""
    scene = structural(base(solver, 2, 2, pins=("top",), area_density=4.0), 200.0)
    fabric = replace(scene.fabric, weft=0.0, damping_time=0.02)
    with Timed(replace(scene, forces=Forces(gravity=0.0), fabric=fabric)) as simulation:
        topology = simulation.topology
        omega = sqrt(spring_stiffness(scene, SOLVERS[solver].info.stiffness_section, topology)[0] / topology.mass[2])
        start = topology.start.copy()
        start[2:, 1] -= 0.1
        simulation.set_state(start)
        samples = []
        for _ in range(60):
            simulation.step()
            samples.append((topology.start[2, 1] - simulation.positions()[2, 1]) / 0.1)
        law = damped_swing(omega, fabric.damping_time * omega / 2, np.arange(1, 61) / 60.0)
        worst = int(np.abs(np.array(samples) - law).argmax())
        name = f"length over rest, of the first 0.1 m, at frame {worst + 1}"
        yield Check(
            name, float(law[worst]), samples[worst], float(abs(samples[worst] - law[worst])), *DAMPER_TOLERANCES
        )


# -- swinging curtain --------------------------------------------------------------------------------------------------


def curtain(solver: str, cells: int, **keys: object) -> Scene:
    """Return a sheet that is pinned along its top and released flat at 45°: 1000 N/m, 0.2 kg/m², no damping."""
    cloth = {"mass_lumping": "uniform", "pins": ("top",), "rotation": (-45.0, 0.0, 0.0), **keys}
    return structural(base(solver, cells + 1, cells + 1, **cloth), 1000.0)


def swinging_curtain(solver: str) -> Iterator[Check]:
    """Compare the bottom row of the curtain, and every row, with the motion of its columns."""
    for cells, bottom in CURTAIN.items():

        @cache
        def seen(cells: int = cells) -> Floats:
            return curtain_rows(solver, cells)

        rows = curtain_solution(Curtain(cells))[[round(seconds / FRAME_SECONDS) - 1 for seconds in CURTAIN_SECONDS]]
        for what, exact in (
            (f"{cells} cells: bottom row", np.array(bottom)[:, None]),
            (f"{cells} cells: every row", rows),
        ):
            what = f"{what}, error of the side"

            def judged(what: str = what, cells: int = cells, exact: Floats = exact) -> Check:
                row = curtain_error(what, seen, exact)
                law = partial(unconverged_curtain, cells, exact)
                return row.by_law(SOFTER_EULER, law) if solver == "verlet" else row

            yield run_with_limit(what, *CURTAIN_ERROR, judged)


def unconverged_curtain(cells: int, exact: Floats) -> float:
    """Return the error of exactly solved steps in float64 with the stiffness that iterations of `verlet` leave."""
    substeps, iterations = SOLVER_CATALOG["verlet"].defaults
    h = FRAME_SECONDS / substeps
    positions = euler_curtain(cells, iterations / h**2, h)
    seen = positions[[round(seconds / FRAME_SECONDS) - 1 for seconds in CURTAIN_SECONDS]]
    return float(np.linalg.norm(seen[:, -exact.shape[1] :] - exact, axis=2).max())


def curtain_rows(solver: str, cells: int) -> Floats:
    """Return the rows at the three times [m], (3, cells + 1, columns, 3): forward, up, and moved along the top edge."""
    with Timed(curtain(solver, cells)) as simulation:
        start, done, positions = simulation.topology.start, 0.0, []
        for seconds in CURTAIN_SECONDS:
            advance(simulation, seconds - done)
            done = seconds
            x = simulation.positions()
            moved = np.column_stack([x[:, [2, 1]] - start[0, [2, 1]], x[:, 0] - start[:, 0]])
            positions.append(moved.reshape(cells + 1, cells + 1, 3))
        return np.array(positions)


def curtain_error(what: str, seen: Callable[[], Floats], exact: Floats) -> Check:
    """Return the row of the time with the largest error. `exact`, (3, rows, 2), has the last rows, or all.

    No particle should move along the top edge, which is the third component of `seen`.
    """
    in_space = np.pad(exact, ((0, 0), (0, 0), (0, 1)))
    errors = np.linalg.norm(seen()[:, -exact.shape[1] :] - in_space[:, :, None], axis=3).max(axis=(1, 2))
    k = int(np.argmax(errors))
    length, error = float(np.linalg.norm(exact[k, -1])), float(errors[k])
    return Check(f"{what} after {CURTAIN_SECONDS[k]:g} s", length, length + error, error, *CURTAIN_ERROR)
