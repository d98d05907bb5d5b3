"""A2 and B1: oscillation and damping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import pi, sqrt

import numpy as np

from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, Forces
from ..simulation import Simulation
from ..solvers import SOLVERS
from .exact import chain_modes, damped_swing, pendulum_period, spring_scheme, taut_modes, upright_modes
from .row import Row, relative
from .setups import advance, base, crossings, frequency, strip, strip_constant, structural, substep, swing_frames

ANGLES = (10, 30, 60, 90, 120, 150, 170)  # [degrees] from hanging
LINKS = 20
MODES = 3
# Bottom row (forward, up) [m] of the swinging curtain after 0.25, 0.5 and 1 s, by cells a side: in float64, by Dormand
# and Prince's method of order 8, until it did not change any more.
CURTAIN = {
    16: ((0.5231750679, -0.8297375679), (-0.2103274487, -0.9759157740), (-0.6740654639, -0.7338234369)),
    32: ((0.5226717572, -0.8292342573), (-0.2309021056, -0.9685538124), (-0.6677511421, -0.7397831360)),
    64: ((0.5224470917, -0.8290095917), (-0.2433597394, -0.9621248437), (-0.6646460383, -0.7425699090)),
}
CURTAIN_SECONDS = (0.25, 0.5, 1.0)


def pendulum(solver: str) -> Iterator[Row]:
    """A stiff strip of one cell, let go at rest; its period is twice the time between passes below."""
    for degrees in ANGLES:
        scene = structural(base(solver, 2, 2, width=0.1, pins=("top",), rotation=(float(degrees), 0.0, 0.0)), 1e4)
        period = pendulum_period(degrees, 1.0)
        with Simulation(scene) as simulation:
            pivot = simulation.topology.start[0]
            angles = []
            for _ in range(round(period / FRAME_SECONDS) + 2):
                below = simulation.positions()[2] - pivot
                angles.append(np.arctan2(below[2], -below[1]))
                simulation.advance_frame()
            times = crossings(np.array(angles))
            measured = 2 * FRAME_SECONDS * float(times[1] - times[0]) if len(times) > 1 else float("nan")
            yield relative(f"period from {degrees}° [s]", period, measured, 1e-2, 1e-3)


def pendulum_height(solver: str) -> Iterator[Row]:
    """How high the same strip still swings after ten periods."""
    degrees = 30
    scene = structural(base(solver, 2, 2, width=0.1, pins=("top",), rotation=(float(degrees), 0.0, 0.0)), 1e4)
    with Simulation(scene) as simulation:
        pivot = simulation.topology.start[0]
        period = pendulum_period(degrees, 1.0)
        advance(simulation, 9.75 * period)
        angles = []
        for _ in range(round(0.5 * period / FRAME_SECONDS)):
            simulation.advance_frame()
            below = simulation.positions()[2] - pivot
            angles.append(abs(float(np.degrees(np.arctan2(below[2], -below[1])))))
        yield relative(f"angle after ten periods from {degrees}° [°]", degrees, max(angles), 1e-2, 1e-3)


def one_spring(solver: str) -> Iterator[Row]:
    """A spring of 1000 N/m and 1 kg, let go 1.5 times as long, follows the method's own discrete law for a second."""
    scene = structural(base(solver, 2, 2, pins=("top",), area_density=4.0), 2000.0)
    scene = replace(scene, forces=Forces(gravity=0.0), fabric=replace(scene.fabric, weft=0.0))
    with Simulation(scene) as simulation:
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
        yield Row(name, float(law[worst]), seen[worst], float(abs(seen[worst] - law[worst])), 1e-3, 1e-4)


def curtain_modes(solver: str) -> Iterator[Row]:
    """A strip of 20 links swings a little in each of its first modes."""
    omegas, shapes = chain_modes(LINKS, 1.0, MODES)
    for mode in range(MODES):
        omega = float(omegas[mode])
        with Simulation(strip(solver, LINKS, constant=1e4)) as simulation:
            topology = simulation.topology
            start = topology.start.reshape(LINKS + 1, 3, 3).copy()
            shape = shapes[:, mode]
            start[1:, :, 2] += 2e-3 * (shape / np.abs(shape).max())[:, None]
            simulation.place(start.reshape(-1, 3))
            seen = []
            for _ in range(swing_frames(omega)):
                seen.append(float(simulation.positions().reshape(LINKS + 1, 3, 3)[1:, 1, 2] @ shape))
                simulation.advance_frame()
            yield relative(f"mode {mode + 1} of a hanging strip [rad/s]", omega, frequency(seen, omega), 1e-2, 1e-3)


def taut_strip(solver: str) -> Iterator[Row]:
    """A strip a tenth longer than when slack, held at both ends, plucked in each of its first modes. No gravity."""
    links = 32
    for mode in range(MODES):
        scene = strip(solver, links, constant=100.0, pins=("top", "bottom"))
        scene = replace(scene, cloth=replace(scene.cloth, height=0.9), forces=Forces(gravity=0.0))
        with Simulation(scene) as simulation:
            topology = simulation.topology
            mass = float(topology.mass.reshape(-1, 3)[1].sum())
            tension = strip_constant(simulation) * 0.1 / links
            omega = float(taut_modes(links, tension, mass, 1.0, MODES)[mode])
            shape = np.sin((mode + 1) * pi * np.arange(links + 1) / links)
            start = topology.start.reshape(links + 1, 3, 3) * [1.0, 1 / 0.9, 1.0]
            start[:, :, 2] += 1e-3 * shape[:, None]
            simulation.place(start.reshape(-1, 3))
            seen = []
            for _ in range(swing_frames(omega)):
                seen.append(float(simulation.positions().reshape(links + 1, 3, 3)[:, 1, 2] @ shape))
                simulation.advance_frame()
            yield relative(f"mode {mode + 1} of a taut strip [rad/s]", omega, frequency(seen, omega), 1e-2, 1e-3)


def along_itself(solver: str) -> Iterator[Row]:
    """A soft strip swings along itself in each of its first modes, without weight."""
    for mode in range(MODES):
        scene = replace(strip(solver, LINKS, constant=20.0), forces=Forces(gravity=0.0))
        with Simulation(scene) as simulation:
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
            yield relative(f"mode {mode + 1} of a strip along itself", omega, frequency(seen, omega), 1e-2, 1e-3)


def dashpot(solver: str) -> Iterator[Row]:
    """A soft spring with a dashpot of about a tenth of critical damping, let go a tenth too long."""
    scene = structural(base(solver, 2, 2, pins=("top",), area_density=4.0), 200.0)
    fabric = replace(scene.fabric, weft=0.0, damping_time=0.02)
    with Simulation(replace(scene, forces=Forces(gravity=0.0), fabric=fabric)) as simulation:
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
        yield Row(name, float(law[worst]), seen[worst], float(abs(seen[worst] - law[worst])), 2e-2, 2e-3)


def swinging_curtain(solver: str) -> Iterator[Row]:
    """Pinned along its top, held flat at 45°, let go: 1000 N/m, 0.2 kg/m², equal masses, no damping."""
    for cells, exact in CURTAIN.items():
        scene = structural(
            base(solver, cells + 1, cells + 1, lumping="equal", pins=("top",), rotation=(-45.0, 0.0, 0.0)), 1000.0
        )
        with Simulation(scene) as simulation:
            pivot = simulation.topology.start[0]
            errors = []
            done = 0.0
            for seconds, place in zip(CURTAIN_SECONDS, exact, strict=True):
                advance(simulation, seconds - done)
                done = seconds
                bottom = simulation.positions()[-(cells // 2)] - pivot
                errors.append(np.hypot(bottom[2] - place[0], bottom[1] - place[1]))
            k = int(np.argmax(errors))
            length = float(np.hypot(*exact[k]))
            name = f"{cells} cells: bottom row after {CURTAIN_SECONDS[k]:g} s, error of the side"
            yield Row(name, length, length + float(errors[k]), float(errors[k]), 1e-2, 1e-3)
