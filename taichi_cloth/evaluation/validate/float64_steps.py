"""The iterations of `verlet`, `xpbd` and `lines` in float64, on all springs of a scene.

A difference between two runs that these have too, or a distance from the exact solution, is none of rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from math import exp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.cloth_builder import spring_stiffness
from ...geometry.grid import DIRECTIONS
from ...geometry.simd_layout import LINE_DIRECTIONS
from ...geometry.topology import Topology
from ...scene import Scene
from ...scene.schema import FRAME_SECONDS
from ...simulation.simulation import Simulation
from ...solvers.two_stage import GAMMA
from .check import substep
from .exact import Floats


def swept_in_float64(
    scene: Scene, seconds: float, start: Floats | None = None, contact: Callable[[Floats, Floats], None] | None = None
) -> Floats:
    """Return the positions that `verlet` or `xpbd` reaches after some seconds in float64 [m], (N, 3).

    It begins at rest at `start`, (N, 3) [m]. For `contact` see `sweeps_in_float64`.
    """
    with Simulation(scene) as simulation:
        count = round(seconds / substep(simulation))
        steps = sweeps_in_float64(simulation, start, contact)
    x, _ = next(islice(steps, count - 1, None))
    return x


def sweeps_in_float64(
    simulation: Simulation, start: Floats | None = None, contact: Callable[[Floats, Floats], None] | None = None
) -> Iterator[tuple[Floats, Floats]]:
    """Return an iterator of positions [m] and velocities [m/s], (N, 3) each, after every substep of `verlet` or `xpbd`.

    They are the sweeps of `solvers/verlet.py` and `solvers/xpbd.py` in float64, with springs in the same order: a
    difference that float64 has too is none of rounding. They begin at rest at `start`, (N, 3) [m], or by default in the
    present state of the simulation. Only gravity, springs and `contact` act, which changes the positions of an
    iteration, (N, 3) [m], in place; it also gets those at the start of the substep.
    """
    scene, topology, h = simulation.scene, simulation.topology, substep(simulation)
    section = simulation.solver.info.stiffness_section
    stiffness, free = spring_stiffness(scene, section, topology), ~topology.pinned
    is_rigid = section == "verlet"  # a stiffness is then a share of the error
    share = stiffness if is_rigid else np.ones(len(stiffness))
    compliance = np.zeros(len(stiffness)) if is_rigid else 1 / (stiffness * h * h)
    weight = np.where(free, 1 / topology.mass, 0.0)
    batches = [slice(batch.first, batch.first + batch.count) for batch in topology.batches]
    x, v = (simulation.positions(), simulation.velocities()) if start is None else (start, np.zeros_like(start))

    def steps() -> Iterator[tuple[Floats, Floats]]:
        nonlocal x, v
        while True:
            y = x + h * exp(-scene.solver.damping * h) * v
            y[free, 1] -= h * h * scene.forces.gravity
            multiplier = np.zeros(len(stiffness))
            for k, one in enumerate(batches * scene.solver.iterations, 1):
                a, b = topology.ends[one].T
                gap = y[b] - y[a]
                length = np.linalg.norm(gap, axis=1)
                error = share[one] * (length - topology.rest[one] + compliance[one] * multiplier[one])
                inverse = weight[a] + weight[b] + compliance[one]
                change = np.where(weight[a] + weight[b] > 0, -error / np.maximum(inverse, 1e-12), 0.0)
                multiplier[one] += change
                pull = (change / length)[:, None] * gap
                y[a] -= weight[a, None] * pull
                y[b] += weight[b, None] * pull
                if contact is not None and k % len(batches) == 0:
                    contact(y, x)
            x, v = y, (y - x) / h
            yield x, v

    return steps()


def lines_of(topology: Topology) -> list[tuple[NDArray[Any], ...]]:
    """Return the lines of springs of every direction, in the order of `kernels/line_solver.py`.

    Of every spring: its index, its first and second particle, and whether it continues the line of the one before.
    """
    direction = np.repeat([batch.direction for batch in topology.batches], [batch.count for batch in topology.batches])
    found: list[tuple[NDArray[Any], ...]] = []
    for d in LINE_DIRECTIONS:
        springs = np.flatnonzero(direction == d)
        if len(springs):
            a, b = np.sort(topology.ends[springs], axis=1).T
            _, down, along = DIRECTIONS[d]
            row, column = np.divmod(a, topology.shape[1])
            order = np.lexsort((a, row * along - column * down))
            a, b = a[order], b[order]
            found.append((springs[order], a, b, np.append(False, a[1:] == b[:-1])))
    return found


def shifted(values: Floats, by: int, filler: float = 0.0) -> Floats:
    """Return values, each moved to an index higher by `by`, with `filler` at the free end."""
    moved = np.full_like(values, filler)
    if by > 0:
        moved[by:] = values[:-by]
    else:
        moved[:by] = values[-by:]
    return moved


def solve_tridiagonal(lower: Floats, diagonal: Floats, upper: Floats, right: Floats) -> Floats:
    """Return the solution of lower·x₋₁ + diagonal·x + upper·x₊₁ = right, all (N,), by cyclic reduction (Hockney 1965).

    Each round couples every unknown to those twice as far away. The matrix must be diagonally dominant.
    """
    reach = 1
    while lower.any() or upper.any():
        up, down = -lower / shifted(diagonal, reach, 1.0), -upper / shifted(diagonal, -reach, 1.0)
        diagonal = diagonal + up * shifted(upper, reach) + down * shifted(lower, -reach)
        right = right + up * shifted(right, reach) + down * shifted(right, -reach)
        lower, upper = up * shifted(lower, reach), down * shifted(upper, -reach)
        reach *= 2
    return right / diagonal


def lines_in_float64(
    simulation: Simulation, contact: Callable[[Floats, Floats | None], None] | None = None
) -> Iterator[tuple[Floats, Floats]]:
    """Return an iterator of positions [m] and velocities [m/s], (N, 3) each, after every substep of `lines` in float64.

    They are the steps of `solvers/lines.py`, from the present state of a simulation. Only gravity, springs and
    `contact` act, which changes positions, (N, 3) [m], in place. It also gets those before the stage, or None where
    there is no friction. The arrays may be changed: the next substep begins with them.
    """
    scene, topology, h = simulation.scene, simulation.topology, substep(simulation)
    constant = spring_stiffness(scene, simulation.solver.info.stiffness_section, topology) * (GAMMA * h) ** 2
    weight = np.where(topology.pinned, 0.0, 1 / topology.mass)
    passes = lines_of(topology)
    for batch in topology.batches:
        if batch.family == "bend":
            springs = np.arange(batch.first, batch.first + batch.count)
            passes.append((springs, *topology.ends[springs].T, np.zeros(batch.count, bool)))
    x, v = simulation.positions(), simulation.velocities()

    def steps() -> Iterator[tuple[Floats, Floats]]:
        nonlocal x, v
        while True:
            for velocity_factor, ahead in ((exp(-scene.solver.damping * h / 2), (1 - 2 * GAMMA) * h), (1.0, 0.0)):
                v *= velocity_factor
                before, start, multiplier = x.copy(), v.copy(), np.zeros(topology.spring_count)
                v[weight > 0, 1] -= GAMMA * h * scene.forces.gravity
                x += GAMMA * h * v
                for springs, a, b, continues in passes * scene.solver.iterations:
                    gap = x[b] - x[a]
                    length = np.sqrt((gap * gap).sum(axis=1))
                    unit, k = gap / length[:, None], constant[springs]
                    coupling = np.append(0.0, weight[a[1:]] * (unit[1:] * unit[:-1]).sum(axis=1)) * continues
                    residual = -k * (length - topology.rest[springs]) - multiplier[springs]
                    diagonal = 1 + k * (weight[a] + weight[b])
                    change = solve_tridiagonal(-k * coupling, diagonal, -k * shifted(coupling, -1), residual)
                    multiplier[springs] += change
                    move = np.zeros_like(x)
                    move[b] = change[:, None] * unit
                    move[a] -= change[:, None] * unit
                    x += weight[:, None] * move
                    v += weight[:, None] * move / (GAMMA * h)
                jump = (v - start) * ((1 - GAMMA) / GAMMA - 1)
                if contact is not None:
                    free = x.copy()
                    contact(x, before)
                    v += (x - free) / (GAMMA * h)
                if ahead:
                    x += ahead * v
                    v += jump
                    if contact is not None:
                        contact(x, None)
            v *= exp(-scene.solver.damping * h / 2)
            yield x, v

    return steps()


def lines_after(scene: Scene, seconds: float) -> Floats:
    """Return the positions that `lines` reaches after some seconds in float64 [m], (N, 3)."""
    with Simulation(scene) as simulation:
        count = round(seconds / substep(simulation))
        x, _ = next(islice(lines_in_float64(simulation), count - 1, None))
    return x


def sag_noise(simulation: Simulation, particle: int, exact: float, seconds: float = 6.0) -> float:
    """Return the error of the sag of a particle as a share of the exact one [m], in the same steps in float64.

    Root mean square over the last third of the time [s].
    """
    frames = islice(lines_in_float64(simulation), simulation.substeps - 1, None, simulation.substeps)
    sags = np.array([-float(x[particle, 1]) for x, _ in islice(frames, round(seconds / FRAME_SECONDS))])
    return float(np.sqrt(np.mean((sags / exact - 1)[-len(sags) // 3 :] ** 2)))
