"""B5 and B6: stiff strands at one substep, compared with the same implicit steps solved exactly by Newton's method.

The exact steps of a chain are in NumPy, float64.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from math import ceil, cos, radians, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.cloth_builder import spring_stiffness
from ...scene.schema import FRAME_SECONDS, Fabric, Forces, Scene, Solver, VerletSprings
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.simulation import Simulation
from ..bench.error_sweep import Curtain
from .check import REST_DAMPING, UNFINISHED_SOLVERS, Check, Timed, advance, at_most, base, effective_stiffness, relative
from .exact import GRAVITY, TWO_STAGE, Floats

GAMMA = 1 - sqrt(0.5)  # share of a substep that each of the two stages solves (Alexander 1977)
MAX_ITERATIONS = 50  # of Newton's method; it takes three to eight
CLOSE = 1e-12  # [m] largest displacement in the last round


@dataclass(frozen=True, eq=False)
class Chain:
    """N particles in a plane, (forward, up), joined by E springs. The first particle is pinned."""

    mass: Floats  # [kg] (N,)
    ends: NDArray[np.int64]  # (E, 2)
    rest: Floats  # [m] (E,)
    constant: Floats  # [N/m] (E,)
    gravity: float = GRAVITY  # [m/s²]

    def gaps(self, x: Floats) -> tuple[Floats, Floats]:
        """Return (unit vectors (E, 2), lengths [m] (E,)) of the springs."""
        gap = x[self.ends[:, 1]] - x[self.ends[:, 0]]
        length = np.hypot(*gap.T)
        return gap / length[:, None], length

    def strains(self, x: Floats) -> Floats:
        """Return length over rest length − 1 of every spring, (E,)."""
        strains: Floats = self.gaps(x)[1] / self.rest - 1
        return strains


class Step(NamedTuple):
    """The state at the end of an implicit step."""

    x: Floats  # [m] (N, 2)
    v: Floats  # [m/s] (N, 2)
    tension: Floats  # [N] (E,)


def inertial_target(chain: Chain, x: Floats, v: Floats, h: float) -> Floats:
    """Return y = x + h·v + h²·g [m], (N, 2). The pinned particle does not move."""
    y = x + h * v
    y[:, 1] -= h * h * chain.gravity
    y[0] = x[0]
    return y


def step_residual(chain: Chain, y: Floats, x: Floats, h: float) -> Floats:
    """Return |∇(½|x − y|²_M/h² + E(x))| [N] of every free particle, (N − 1,).

    It is zero if a step of length h is solved.
    """
    unit, length = chain.gaps(x)
    pull = (chain.constant * (length - chain.rest))[:, None] * unit
    gradient = chain.mass[:, None] * (x - y) / h**2
    np.add.at(gradient, chain.ends[:, 1], pull)
    np.add.at(gradient, chain.ends[:, 0], -pull)
    residual: Floats = np.hypot(*gradient[1:].T)
    return residual


def backward_euler_step(chain: Chain, x: Floats, v: Floats, h: float) -> Step:
    """Return the result of a backward Euler step.

    Newton's method on positions and multipliers, which does not slow down with stiff springs, solves

        M·(x − y) = Jᵀλ,    C + λ/(k·h²) = 0

    with the length errors C and their gradients J (Macklin 2016, eq. 8–9). Raises ArithmeticError if it does not
    converge: a chain under compression may fold in many ways.
    """
    y = inertial_target(chain, x, v, h)
    x_new, multiplier = y.copy(), np.zeros(len(chain.rest))
    compliance = 1 / (chain.constant * h * h)
    for _ in range(MAX_ITERATIONS):
        unit, length = chain.gaps(x_new)
        jacobian = _jacobian(chain, unit)
        constraint_force = jacobian.T @ multiplier
        residual = np.concatenate(
            [
                (chain.mass[:, None] * (x_new - y)).ravel() - constraint_force,
                length - chain.rest + compliance * multiplier,
            ]
        )
        matrix = np.block(
            [[_system_matrix(chain, unit, -multiplier / length), -jacobian.T], [jacobian, np.diag(compliance)]]
        )
        change = np.linalg.solve(matrix[2:, 2:], -residual[2:])  # the pinned particle has no equation
        x_new[1:] += change[: 2 * len(x) - 2].reshape(-1, 2)
        multiplier += change[2 * len(x) - 2 :]
        if np.abs(change[: 2 * len(x) - 2]).max() < CLOSE:
            return Step(x_new, (x_new - x) / h, -multiplier / h**2)
    raise ArithmeticError("Newton's method does not converge")


def _jacobian(chain: Chain, unit: Floats) -> Floats:
    """Return ∂C/∂x, (E, 2N)."""
    springs = np.arange(len(unit))
    jacobian = np.zeros((len(unit), len(chain.mass), 2))
    jacobian[springs, chain.ends[:, 0]] = -unit
    jacobian[springs, chain.ends[:, 1]] = unit
    return jacobian.reshape(len(unit), -1)


def _system_matrix(chain: Chain, unit: Floats, weight: Floats) -> Floats:
    """Return M + Σ weight·(1 − n·nᵀ) over the springs, (2N, 2N): mass and geometric stiffness."""
    count = len(chain.mass)
    transverse = weight[:, None, None] * (np.eye(2) - unit[:, :, None] * unit[:, None, :])
    blocks = np.zeros((count, count, 2, 2))
    blocks[np.arange(count), np.arange(count)] = chain.mass[:, None, None] * np.eye(2)
    a, b = chain.ends.T
    for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        np.add.at(blocks, (i, j), sign * transverse)
    return blocks.transpose(0, 2, 1, 3).reshape(2 * count, 2 * count)


def sdirk_step(chain: Chain, x: Floats, v: Floats, h: float) -> Step:
    """Return the result of a substep of `lines` or `implicit` (`solvers/two_stage.py`).

    It consists of two backward Euler steps of γh and a jump between them.
    """
    first = backward_euler_step(chain, x, v, GAMMA * h)
    return backward_euler_step(chain, x + (1 - GAMMA) * h * first.v, v + (first.v - v) * (1 - GAMMA) / GAMMA, GAMMA * h)


# -- hanging chains, for the laws of iterations that end too early (`check.py`) ----------------------------------------

MAX_PHASE = 0.5  # [rad] of the fastest vibration in a step of velocity Verlet, which is stable up to 2


def hanging_chain(links: int, squared: float, last: float = 1.0) -> Chain:
    """Return a chain of one meter with equal masses and springs, k/m = `squared` [1/s²].

    The last mass is `last` times the others.
    """
    mass = np.ones(links + 1)
    mass[-1] = last
    ends = np.stack([np.arange(links), np.arange(1, links + 1)], axis=-1)
    return Chain(mass, ends, np.full(links, 1 / links), np.full(links, squared))


def euler_run(links: int, squared: float, start: Floats, h: float, frames: int) -> Floats:
    """Return the positions after each frame, (frames, links + 1, 2), in exactly solved backward Euler steps."""
    chain, x, v = hanging_chain(links, squared), start, np.zeros_like(start)
    positions = []
    for _ in range(frames):
        for _ in range(round(FRAME_SECONDS / h)):
            x, v, _ = backward_euler_step(chain, x, v, h)
        positions.append(x)
    return np.array(positions)


@cache
def euler_curtain(cells: int, squared: float, h: float, frames: int = 60) -> Floats:
    """Return the swinging curtain in such steps, (frames, cells + 1, 2)."""
    return euler_run(cells, squared, Curtain(cells).start, h, frames)


@cache
def bottom_by_area(cells: int, squared: float, frames: int = 60) -> Floats:
    """Return the position of the curtain's bottom row, (2,), with masses by area: the last one is half.

    It is computed by velocity Verlet with short steps. The first-order error of steps of h is left out: it is nearly
    the same with twice as many cells.
    """
    chain, start = hanging_chain(cells, squared, last=0.5), Curtain(cells).start
    steps = ceil(2 * sqrt(squared) * FRAME_SECONDS / MAX_PHASE)
    h, x, v = FRAME_SECONDS / steps, start, np.zeros_like(start)

    def acceleration(x: Floats) -> Floats:
        unit, length = chain.gaps(x)
        pull = (chain.constant * (length - chain.rest))[:, None] * unit
        a = np.zeros_like(x)
        a[1:] -= pull
        a[1:-1] += pull[1:]
        a /= chain.mass[:, None]
        a[1:, 1] -= GRAVITY
        return a

    a = acceleration(x)
    for _ in range(frames * steps):
        v = v + h / 2 * a
        x = x + h * v
        a = acceleration(x)
        v = v + h / 2 * a
    bottom: Floats = x[-1]
    return bottom


def exact_change(solver: str, coarse: int, fine: int) -> float:
    """Return the distance between the bottoms in float64, with the stiffness that the iterations leave."""
    substeps, iterations = SOLVER_CATALOG[solver].defaults
    bottoms = []
    for cells in (coarse, fine):
        mass, stiffness = Curtain(cells).mass, Curtain(cells).stiffness
        if solver in UNFINISHED_SOLVERS:
            stiffness = effective_stiffness(solver, stiffness, mass, FRAME_SECONDS / substeps, iterations)
        bottoms.append(bottom_by_area(cells, stiffness / mass))
    return float(np.linalg.norm(bottoms[1] - bottoms[0]))


# -- strands -----------------------------------------------------------------------------------------------------------

CONSTANT = 1e8  # [N/m]
SWEEPS = ((50, 6e-2), (100, 2e-2), (1000, 5e-3))  # iterations, largest error of the force (Macklin 2016, 6.2)
FORCE_FRAMES = (75, 100)  # frames that are compared; at first there is hardly any force

# The strand of TinyVBD (A. Chen, `main.cpp`): 20 particles of 1 kg, the last one 1000 times as heavy, 100 iterations.
LINKS = 19
LINK = 0.05 / cos(radians(30))  # [m]
HEAVY = 1000.0  # [kg]
SKIP = 100.0  # [N/m] of springs to the second-next particle
STRAND_GRAVITY = 10.0  # [m/s²]
STRAND_ITERATIONS = 100
START_ANGLE = 30.0  # [degrees] below level at the start; above level it is compressed and could fold in many ways
STRAND_FRAMES = 60
STRAND = (2e-2, 1e-3)
RESIDUAL = (10.0, 2.0)  # weights of a particle


def strands(solver: str, links: int, link: float, iterations: int, below: float) -> Scene:
    """Return two parallel chains of particles of 1 kg, pinned at their upper ends and not joined to each other.

    They start straight, `below` degrees under level.
    """
    scene = base(
        solver,
        links + 1,
        2,
        width=link,
        height=links * link,
        mass_lumping="uniform",
        area_density=1 / link**2,
        pins=("top",),
        rotation=(below - 90.0, 0.0, 0.0),
    )
    return replace(
        scene,
        verlet=VerletSprings(shear=0.0, bend=0.0),
        fabric=Fabric(warp=CONSTANT, weft=0.0, shear=0.0, bend_spring=0.0),
        solver=Solver(solver, 1, iterations, damping=0.0),
    )


def heavy_strand(solver: str, below: float, skip: float) -> Scene:
    """Return TinyVBD's strand, except that its last link is as long as the others."""
    scene = strands(solver, LINKS, LINK, STRAND_ITERATIONS, below)
    return replace(
        scene,
        cloth=replace(scene.cloth, corner_mass=HEAVY - 1.0),
        verlet=replace(scene.verlet, bend=float(skip > 0)),
        fabric=replace(scene.fabric, bend_spring=skip),
        forces=Forces(gravity=STRAND_GRAVITY),
    )


def chain_of(simulation: Simulation) -> Chain:
    """Return the left one of two strands."""
    topology, scene = simulation.topology, simulation.scene
    is_left = (topology.ends % 2 == 0).all(axis=1)
    constant = spring_stiffness(scene, simulation.solver.info.stiffness_section, topology)
    return Chain(
        topology.mass[::2], topology.ends[is_left] // 2, topology.rest[is_left], constant[is_left], scene.forces.gravity
    )


def left_strand(vectors: Floats) -> Floats:
    """Return the vectors of the left strand, (forward, up)."""
    components: Floats = vectors[::2, [2, 1]]
    return components


def force(solver: str) -> Iterator[Check]:
    """Measure the force on the pin of a chain of 20 particles that is released level.

    It is the part of the chain's weight that does not change its momentum.
    """
    for iterations, tolerance in SWEEPS:
        with Timed(strands(solver, 20, 1.0, iterations, 0.0)) as simulation:
            chain = chain_of(simulation)
            x = left_strand(simulation.positions())
            v = before = left_strand(simulation.velocities())
            forces, exact = [], []
            for _ in range(FORCE_FRAMES[1]):
                simulation.step()
                after = left_strand(simulation.velocities())
                momentum_rate = chain.mass[1:] @ (after - before)[1:] / FRAME_SECONDS
                forces.append(float(np.hypot(momentum_rate[0], momentum_rate[1] + chain.mass[1:].sum() * GRAVITY)))
                before = after
                x, v, tension = backward_euler_step(chain, x, v, FRAME_SECONDS)
                exact.append(float(tension[0]))
        compared = slice(FORCE_FRAMES[0] - 1, None)
        errors = np.abs(np.array(forces) / np.array(exact) - 1)[compared]
        k = FORCE_FRAMES[0] - 1 + int(errors.argmax())
        name = f"{iterations} iterations: force on the pin at frame {k + 1} [N]"
        yield relative(name, exact[k], forces[k], tolerance, tolerance / 10)


def at_rest(solver: str) -> Iterator[Check]:
    """Measure the elongation of the hanging strand."""
    scene = heavy_strand(solver, 90.0, 0.0)
    with Timed(replace(scene, solver=replace(scene.solver, damping=REST_DAMPING))) as simulation:
        chain = chain_of(simulation)
        start = left_strand(simulation.positions())
        advance(simulation, 10.0)
        carried = chain.mass[::-1].cumsum()[-2::-1] * STRAND_GRAVITY  # [N] by each link, from the top
        exact = float((carried / CONSTANT).sum())
        yield relative("longer by [m]", exact, float((start - left_strand(simulation.positions()))[-1, 1]), *STRAND)


def residual(solver: str) -> Iterator[Check]:
    """Measure the residual of the strand's steps, in weights of a particle.

    The strand carries 1000 of these weights, and float32 leaves a residual of about 2.
    """
    with Timed(heavy_strand(solver, START_ANGLE, SKIP)) as simulation:
        chain = chain_of(simulation)
        x, v = left_strand(simulation.positions()), left_strand(simulation.velocities())
        residuals = []
        for _ in range(STRAND_FRAMES):
            simulation.step()
            x_new, v_new = left_strand(simulation.positions()), left_strand(simulation.velocities())
            h, y = FRAME_SECONDS, inertial_target(chain, x, v, FRAME_SECONDS)
            if solver in TWO_STAGE:
                h, y = second_stage(chain, x, v, x_new, v_new)
            residuals.append(float(step_residual(chain, y, x_new, h).max()))
            x, v = x_new, v_new
        yield at_most(f"residual of a step, over {STRAND_GRAVITY:g} N", max(residuals) / STRAND_GRAVITY, *RESIDUAL)


def second_stage(chain: Chain, x: Floats, v: Floats, x_new: Floats, v_new: Floats) -> tuple[float, Floats]:
    """Return (length [s], y) of the second stage of a substep of two stages, from the states before and after it."""
    h = GAMMA * FRAME_SECONDS
    middle = x_new - h * v_new
    first = (middle - x) / ((1 - GAMMA) * FRAME_SECONDS)  # velocity after the first stage
    jumped = v + (first - v) * (1 - GAMMA) / GAMMA
    return h, inertial_target(chain, middle, jumped, h)


def strains(solver: str) -> Iterator[Check]:
    """Compare the strains of the links with those of exactly solved steps."""
    step = sdirk_step if solver in TWO_STAGE else backward_euler_step
    with Timed(heavy_strand(solver, START_ANGLE, SKIP)) as simulation:
        chain = chain_of(simulation)
        links = chain.constant == CONSTANT
        x, v = left_strand(simulation.positions()), left_strand(simulation.velocities())
        errors, exact = [], []
        for _ in range(STRAND_FRAMES):
            simulation.step()
            x, v, _ = step(chain, x, v, FRAME_SECONDS)
            exact.append(chain.strains(x)[links])
            errors.append(np.abs(chain.strains(left_strand(simulation.positions()))[links] - exact[-1]).max())
        largest = float(np.abs(exact).max())
        yield Check("largest error of a strain", largest, largest + max(errors), max(errors) / largest, *STRAND)
