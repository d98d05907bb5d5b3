"""A2 and B1: oscillation and damping."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from math import pi, sqrt
from typing import Any

import numpy as np

from ..accuracy.truth import Curtain, truth
from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, USUAL, Forces, Scene
from ..simulation import Simulation
from ..solvers import SOLVERS
from .exact import (
    Floats,
    chain_modes,
    damped_swing,
    pendulum_period,
    projected_swing,
    spring_scheme,
    taut_modes,
    upright_modes,
    wave,
)
from .laws import SOFTER, SOFTER_EULER, bottom_of_area, euler_curtain, euler_run, softened
from .row import Row, at_most, in_time, relative
from .setups import (
    EULER,
    Timed,
    advance,
    base,
    bottom_middle,
    crossings,
    frequency,
    strip,
    strip_constant,
    structural,
    substep,
    swing_frames,
)

ANGLES = (10, 30, 60, 90, 120, 150, 170)  # [degrees] from hanging
SWING = (1e-2, 1e-3)  # A2: 1 %, 0.1 %
SCHEME = (1e-4, 1e-5)  # A2: its own scheme's number to 1e-4
HANGING_LINKS = (10, 20, 50, 100)
LINKS = 20
MODES = 3
TAUT_LINKS = (16, 32, 64)
TAUT_TENSION, TAUT_MASS = 10.0, 0.1  # [N], [kg] of a strip one metre long: waves of 10 m/s
TAUT_WIDTH = 0.1  # [m]
PULSE_FRAMES = 3  # 0.05 s, in which it goes half a metre
PULSE_START, PULSE_WIDTH = 0.25, 0.07  # [m] its middle, and the spread of a bell curve
TANGENT = "a step goes along the tangent and is pulled back to the rod: the swing of such steps in float64"
DASHPOT = (2e-2, 2e-3)
HEIGHT_DEGREES, HEIGHT_PERIODS = 30, 10
# Bottom row (forward, up) [m] of the swinging curtain after 0.25, 0.5 and 1 s, by cells a side: in float64, by Dormand
# and Prince's method of order 8, until it did not change any more.
CURTAIN = {
    16: ((0.5231750679, -0.8297375679), (-0.2103274487, -0.9759157740), (-0.6740654639, -0.7338234369)),
    32: ((0.5226717572, -0.8292342573), (-0.2309021056, -0.9685538124), (-0.6677511421, -0.7397831360)),
    64: ((0.5224470917, -0.8290095917), (-0.2433597394, -0.9621248437), (-0.6646460383, -0.7425699090)),
}
CURTAIN_SECONDS = (0.25, 0.5, 1.0)
CURTAIN_ERROR = (1e-2, 1e-3)  # B1: within 1 %, and 0.1 %, of the converged motion
FINER = ((32, 64), (64, 128))  # cells
FINER_ERROR = (1e-2, 1e-3)  # A8: less than 1 % past 32 cells, 0.1 % past 64


def pendulum(solver: str) -> Iterator[Row]:
    """A stiff strip of one cell, let go at rest; its period is twice the time between passes below."""
    for degrees in ANGLES:
        period = pendulum_period(degrees, 1.0)
        frames = round(period / FRAME_SECONDS) + 2
        with Timed(rod(solver, degrees)) as simulation:
            seen = angles_of(simulation, frames)
            row = relative(f"period from {degrees}° [s]", period, period_in(seen), *SWING)
            if solver in EULER:
                law = projected_swing(degrees, 1.0, substep(simulation), (frames - 1) * FRAME_SECONDS, FRAME_SECONDS)
                row = row.by_law(TANGENT, abs(period_in(law) / period - 1))
            yield row


def rod(solver: str, degrees: float) -> Scene:
    """One cell that swings about its top edge."""
    return structural(base(solver, 2, 2, width=0.1, pins=("top",), rotation=(float(degrees), 0.0, 0.0)), 1e4)


def angles_of(simulation: Simulation, frames: int) -> Floats:
    """From hanging [rad], before each frame."""
    pivot = simulation.topology.start[0]
    angles = []
    for _ in range(frames):
        below = simulation.positions()[2] - pivot
        angles.append(np.arctan2(below[2], -below[1]))
        simulation.advance_frame()
    return np.array(angles)


def period_in(angles: Floats) -> float:
    """[s] of angles seen once a frame."""
    times = crossings(angles)
    return 2 * FRAME_SECONDS * float(times[1] - times[0]) if len(times) > 1 else float("nan")


def pendulum_height(solver: str) -> Iterator[Row]:
    """How high the same strip still swings after ten periods."""
    degrees = HEIGHT_DEGREES
    period = pendulum_period(degrees, 1.0)
    frames, last = round((HEIGHT_PERIODS + 0.25) * period / FRAME_SECONDS), round(0.5 * period / FRAME_SECONDS)
    with Timed(rod(solver, degrees)) as simulation:
        left = float(np.degrees(np.abs(angles_of(simulation, frames)[-last:]).max()))
        row = relative(f"angle after ten periods from {degrees}° [°]", degrees, left, *SWING)
        if solver in EULER:
            law = projected_swing(degrees, 1.0, substep(simulation), (frames - 1) * FRAME_SECONDS, FRAME_SECONDS)
            row = row.by_law(TANGENT, 1 - float(np.degrees(np.abs(law[-last:]).max())) / degrees)
        yield row


def one_spring(solver: str) -> Iterator[Row]:
    """A spring of 1000 N/m and 1 kg, let go 1.5 times as long, follows the method's own discrete law for a second."""
    scene = structural(base(solver, 2, 2, pins=("top",), area_density=4.0), 2000.0)
    scene = replace(scene, forces=Forces(gravity=0.0), fabric=replace(scene.fabric, weft=0.0))
    with Timed(scene) as simulation:
        topology = simulation.topology
        constant = stiffness_of(scene, SOLVERS[solver].springs, topology)[0]
        omega = sqrt(constant / topology.mass[2])
        start = topology.start.copy()
        start[2:, 1] -= 0.5
        simulation.place(start)
        h, steps = substep(simulation), simulation.substeps
        law = spring_scheme(solver, omega, h, 60 * steps)[steps::steps]
        seen = []
        for _ in range(60):
            simulation.advance_frame()
            seen.append((topology.start[2, 1] - simulation.positions()[2, 1]) / 0.5)
        worst = int(np.abs(np.array(seen) - law).argmax())
        name = f"length over rest, of the first 0.5 m, at frame {worst + 1}"
        yield Row(name, float(law[worst]), seen[worst], float(abs(seen[worst] - law[worst])), *SCHEME)


def curtain_modes(solver: str) -> Iterator[Row]:
    """A strip of links swings a little in each of its first modes."""
    for links in HANGING_LINKS:
        for mode in range(MODES):
            what = f"mode {mode + 1} of a hanging strip of {links} links [rad/s]"
            yield in_time(what, *SWING, partial(curtain_mode, what, solver, links, mode))


def curtain_mode(what: str, solver: str, links: int, mode: int) -> Row:
    omegas, shapes = chain_modes(links, 1.0, MODES)
    omega, shape = float(omegas[mode]), shapes[:, mode]
    with Timed(strip(solver, links, constant=1e4)) as simulation:
        start = simulation.topology.start.reshape(links + 1, 3, 3).copy()
        start[1:, :, 2] += 2e-3 * (shape / np.abs(shape).max())[:, None]
        simulation.place(start.reshape(-1, 3))
        seen = []
        for _ in range(swing_frames(omega)):
            seen.append(float(simulation.positions().reshape(links + 1, 3, 3)[1:, 1, 2] @ shape))
            simulation.advance_frame()
        row = relative(what, omega, frequency(seen, omega), *SWING)
        if solver != "verlet":
            return row
        h, sweeps = substep(simulation), simulation.scene.solver.iterations
        return row.by_law(SOFTER_EULER, partial(softer_mode, links, mode, sweeps / h**2, h))


def softer_mode(links: int, mode: int, squared: float, h: float) -> float:
    """How far its frequency is off in backward Euler steps of a chain of k/m = `squared` [1/s²], that falls into it."""
    omegas, shapes = chain_modes(links, 1.0, MODES)
    omega, shape = float(omegas[mode]), shapes[:, mode]
    start = np.zeros((links + 1, 2))
    start[:, 1] = -np.arange(links + 1) / links
    start[1:, 0] = 2e-3 * shape / np.abs(shape).max()
    places = euler_run(links, squared, start, h, swing_frames(omega) - 1)
    seen = [float(x[1:, 0] @ shape) for x in (start, *places)]
    return abs(frequency(seen, omega) / omega - 1)


def taut_strip(solver: str) -> Iterator[Row]:
    """A strip a tenth longer than when slack, held at both ends, plucked in its first modes, and by a pulse."""
    for links in TAUT_LINKS:
        for mode in range(MODES):
            what = f"mode {mode + 1} of a taut strip of {links} links [rad/s]"
            yield in_time(what, *SWING, partial(taut_mode, what, solver, links, mode))
        what = f"speed of a pulse along a taut strip of {links} links [m/s]"
        yield in_time(what, *SWING, partial(taut_pulse, what, solver, links))


def taut(solver: str, links: int) -> Scene:
    """A strip that will be drawn out from 0.9 m to one, without weight."""
    constant = TAUT_TENSION / TAUT_WIDTH / 0.1 * 0.9  # [N/m] over its slack length; a tenth of a metre longer
    scene = strip(solver, links, constant=constant, pins=("top", "bottom"))
    cloth = replace(scene.cloth, height=0.9, area_density=TAUT_MASS / TAUT_WIDTH / 0.9)
    return replace(scene, cloth=cloth, forces=Forces(gravity=0.0))


def pluck(simulation: Simulation, shape: Floats, rate: Floats) -> tuple[float, float]:
    """Draws it out, with joints (links + 1,) that are so far aside [m] and as fast [m/s]: (tension [N], mass [kg])."""
    topology, links = simulation.topology, len(shape) - 1
    start = topology.start.reshape(links + 1, 3, 3) * [1.0, 1 / 0.9, 1.0]
    start[:, :, 2] += shape[:, None]
    velocities = np.zeros((links + 1, 3, 3))
    velocities[:, :, 2] = rate[:, None]
    simulation.place(start.reshape(-1, 3), velocities.reshape(-1, 3))
    return strip_constant(simulation) * 0.1 / links, float(topology.mass.reshape(-1, 3)[1].sum())


def taut_mode(what: str, solver: str, links: int, mode: int) -> Row:
    with Timed(taut(solver, links)) as simulation:
        shape = np.sin((mode + 1) * pi * np.arange(links + 1) / links)
        tension, mass = pluck(simulation, 1e-3 * shape, 0 * shape)
        omega = float(taut_modes(links, tension, mass, 1.0, MODES)[mode])
        seen = []
        for _ in range(swing_frames(omega)):
            seen.append(float(simulation.positions().reshape(links + 1, 3, 3)[:, 1, 2] @ shape))
            simulation.advance_frame()
        return relative(what, omega, frequency(seen, omega), *SWING)


def taut_pulse(what: str, solver: str, links: int) -> Row:
    """How fast the middle of a bell curve goes: of the squares of its heights, as of the same string in float64."""
    along = np.arange(links + 1) / links
    with Timed(taut(solver, links)) as simulation:
        shape = 1e-3 * np.exp(-(((along - PULSE_START) / PULSE_WIDTH) ** 2) / 2)
        shape[[0, -1]] = 0.0
        speed = sqrt(TAUT_TENSION / TAUT_MASS)
        rate = shape * (along - PULSE_START) / PULSE_WIDTH**2 * speed  # it goes one way only
        tension, mass = pluck(simulation, shape, rate)
        seconds = PULSE_FRAMES * FRAME_SECONDS
        advance(simulation, seconds)
        seen = simulation.positions().reshape(links + 1, 3, 3)[:, 1, 2]
        exact = wave(links, tension, mass, shape[1:-1], rate[1:-1], seconds)
        first, last, law = (middle(along, np.square(one)) for one in (shape, seen, np.pad(exact, 1)))
        return relative(what, (law - first) / seconds, (last - first) / seconds, *SWING)


def middle(along: Floats, weights: Floats) -> float:
    return float(np.average(along, weights=weights))


def along_itself(solver: str) -> Iterator[Row]:
    """A soft strip swings along itself in each of its first modes, without weight."""
    for mode in range(MODES):
        scene = replace(strip(solver, LINKS, constant=20.0), forces=Forces(gravity=0.0))
        with Timed(scene) as simulation:
            topology = simulation.topology
            mass = float(topology.mass.reshape(-1, 3)[1].sum())
            omega = float(upright_modes(LINKS, strip_constant(simulation), mass, MODES)[mode])
            shape = np.sin((2 * mode + 1) * pi * np.arange(LINKS + 1) / (2 * LINKS + 1))
            start = topology.start.reshape(LINKS + 1, 3, 3).copy()
            start[:, :, 1] += 2e-3 * shape[:, None]
            rest = topology.start.reshape(LINKS + 1, 3, 3)[:, 1, 1]
            simulation.place(start.reshape(-1, 3))
            seen = []
            for _ in range(swing_frames(omega)):
                seen.append(float((simulation.positions().reshape(LINKS + 1, 3, 3)[:, 1, 1] - rest) @ shape))
                simulation.advance_frame()
            yield relative(f"mode {mode + 1} of a strip along itself", omega, frequency(seen, omega), *SWING)


def dashpot(solver: str) -> Iterator[Row]:
    """A soft spring with a dashpot of about a tenth of critical damping, let go a tenth too long."""
    scene = structural(base(solver, 2, 2, pins=("top",), area_density=4.0), 200.0)
    fabric = replace(scene.fabric, weft=0.0, damping_time=0.02)
    with Timed(replace(scene, forces=Forces(gravity=0.0), fabric=fabric)) as simulation:
        topology = simulation.topology
        omega = sqrt(stiffness_of(scene, SOLVERS[solver].springs, topology)[0] / topology.mass[2])
        start = topology.start.copy()
        start[2:, 1] -= 0.1
        simulation.place(start)
        seen = []
        for _ in range(60):
            simulation.advance_frame()
            seen.append((topology.start[2, 1] - simulation.positions()[2, 1]) / 0.1)
        law = damped_swing(omega, fabric.damping_time * omega / 2, np.arange(1, 61) / 60.0)
        worst = int(np.abs(np.array(seen) - law).argmax())
        name = f"length over rest, of the first 0.1 m, at frame {worst + 1}"
        yield Row(name, float(law[worst]), seen[worst], float(abs(seen[worst] - law[worst])), *DASHPOT)


def curtain(solver: str, cells: int, **keys: Any) -> Scene:
    """Pinned along its top, held flat at 45°, let go: 1000 N/m, 0.2 kg/m², no damping."""
    cloth = {"lumping": "equal", "pins": ("top",), "rotation": (-45.0, 0.0, 0.0), **keys}
    return structural(base(solver, cells + 1, cells + 1, **cloth), 1000.0)


def swinging_curtain(solver: str) -> Iterator[Row]:
    """Its bottom row against the motion of its columns, and every particle."""
    for cells, bottom in CURTAIN.items():

        @cache
        def seen(cells: int = cells) -> Floats:
            return swung(solver, cells)

        rows = truth(Curtain(cells))[[round(seconds / FRAME_SECONDS) - 1 for seconds in CURTAIN_SECONDS]]
        for what, exact in (
            (f"{cells} cells: bottom row", np.array(bottom)[:, None]),
            (f"{cells} cells: every row", rows),
        ):
            what = f"{what}, error of the side"

            def judged(what: str = what, cells: int = cells, exact: Floats = exact) -> Row:
                row = curtain_error(what, seen, exact)
                return row.by_law(SOFTER_EULER, partial(softer_curtain, cells, exact)) if solver == "verlet" else row

            yield in_time(what, *CURTAIN_ERROR, judged)


def softer_curtain(cells: int, exact: Floats) -> float:
    """How wrong the same curtain of `verlet` is in float64, solved to the end, with springs as soft as sweeps leave."""
    substeps, sweeps = USUAL["verlet"]
    h = FRAME_SECONDS / substeps
    places = euler_curtain(cells, sweeps / h**2, h)
    seen = places[[round(seconds / FRAME_SECONDS) - 1 for seconds in CURTAIN_SECONDS]]
    return float(np.linalg.norm(seen[:, -exact.shape[1] :] - exact, axis=2).max())


def swung(solver: str, cells: int) -> Floats:
    """Where rows are at the three times, forward and up from the top edge, (3, cells + 1, columns, 2) [m]."""
    with Timed(curtain(solver, cells)) as simulation:
        pivot, done, places = simulation.topology.start[0], 0.0, []
        for seconds in CURTAIN_SECONDS:
            advance(simulation, seconds - done)
            done = seconds
            x = (simulation.positions() - pivot).reshape(cells + 1, cells + 1, 3)
            places.append(x[:, :, [2, 1]])
        return np.array(places)


def curtain_error(what: str, seen: Callable[[], Floats], exact: Floats) -> Row:
    """The largest of the three times; `exact`, (3, rows, 2), are the last rows, or all."""
    errors = np.linalg.norm(seen()[:, -exact.shape[1] :] - exact[:, :, None], axis=3).max(axis=(1, 2))
    k = int(np.argmax(errors))
    length, error = float(np.linalg.norm(exact[k, -1])), float(errors[k])
    return Row(f"{what} after {CURTAIN_SECONDS[k]:g} s", length, length + error, error, *CURTAIN_ERROR)


def finer_curtain(solver: str) -> Iterator[Row]:
    """With twice as many cells, and masses by area, its bottom is at the same place after a second."""
    bottoms: dict[int, Floats] = {}

    def bottom(cells: int) -> Floats:
        if cells not in bottoms:
            with Timed(curtain(solver, cells, lumping="area")) as simulation:
                advance(simulation, 1.0)
                bottoms[cells] = bottom_middle(simulation.positions())
        return bottoms[cells]

    for coarse, fine in FINER:
        what = f"bottom row of {fine} cells after 1 s, against {coarse}, of the side"

        def apart(what: str = what, coarse: int = coarse, fine: int = fine) -> Row:
            row = at_most(what, float(np.linalg.norm(bottom(fine) - bottom(coarse))), *FINER_ERROR)
            return row.by_law(SOFTER, partial(softer_apart, solver, coarse, fine)) if solver == "verlet" else row

        yield in_time(what, *FINER_ERROR, apart)


def softer_apart(solver: str, coarse: int, fine: int) -> float:
    """How far apart the bottoms are in float64, with springs that seem as soft as sweeps leave them."""
    substeps, sweeps = USUAL[solver]
    bottoms = []
    for cells in (coarse, fine):
        mass = Curtain(cells).mass
        soft = softened(solver, Curtain(cells).constant, mass, FRAME_SECONDS / substeps, sweeps)
        bottoms.append(bottom_of_area(cells, soft / mass))
    return float(np.linalg.norm(bottoms[1] - bottoms[0]))
