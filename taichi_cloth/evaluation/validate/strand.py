"""B5 and B6: stiff strands at one substep, compared with the same implicit steps solved exactly by Newton's method.

The exact steps of a chain are in NumPy, float64.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import cos, radians, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...geometry.cloth_builder import spring_stiffness
from ...scene.fabric_schema import Fabric, VerletSprings
from ...scene.schema import FRAME_SECONDS, Forces, Scene, Solver
from ...simulation.simulation import Simulation
from .check import REST_DAMPING, SAME_ITERATIONS, Check, Timed, advance, at_most, base, relative
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
    return jacobian.reshape(len(unit), 2 * len(chain.mass))


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


def xpbd_step(chain: Chain, x: Floats, v: Floats, h: float, iterations: int) -> Step:
    """Return the result of a substep of `xpbd` in float64 (Macklin 2016, Algorithm 1).

    As in `solvers/xpbd.py`, springs to the particle after the next come first, and springs that share no particle are
    solved at once.
    """
    y, inverse_mass = inertial_target(chain, x, v, h), 1 / chain.mass
    inverse_mass[0] = 0.0
    multiplier, compliance = np.zeros(len(chain.rest)), 1 / (chain.constant * h * h)
    first, span = chain.ends[:, 0], chain.ends[:, 1] - chain.ends[:, 0]
    groups = [np.flatnonzero((span == n) & (first // n % 2 == half)) for n in (2, 1) for half in (0, 1)]
    for group in groups * iterations:
        a, b = chain.ends[group].T
        gap = y[b] - y[a]
        length = np.hypot(*gap.T)
        error = length - chain.rest[group] + compliance[group] * multiplier[group]
        change = -error / (inverse_mass[a] + inverse_mass[b] + compliance[group])
        multiplier[group] += change
        y[a] -= (inverse_mass[a] * change / length)[:, None] * gap
        y[b] += (inverse_mass[b] * change / length)[:, None] * gap
    return Step(y, (y - x) / h, -multiplier / h**2)


def lines_step(chain: Chain, x: Floats, v: Floats, h: float, iterations: int) -> Step:
    """Return the result of a backward Euler step of `lines` in float64.

    As in `kernels/line_solver.py`, all links are solved at once, linearized at the positions of the iteration; then
    the springs to the particle after the next, those that share no particle at once.
    """
    y, inverse_mass = inertial_target(chain, x, v, h), 1 / chain.mass
    inverse_mass[0] = 0.0
    multiplier, compliance = np.zeros(len(chain.rest)), 1 / (chain.constant * h * h)
    first, span = chain.ends[:, 0], chain.ends[:, 1] - chain.ends[:, 0]
    groups = [np.flatnonzero(span == 1), *(np.flatnonzero((span == 2) & (first // 2 % 2 == half)) for half in (0, 1))]
    for group in groups * iterations:
        part = replace(chain, ends=chain.ends[group], rest=chain.rest[group], constant=chain.constant[group])
        unit, length = part.gaps(y)
        jacobian = _jacobian(part, unit)
        move = np.repeat(inverse_mass, 2)[:, None] * jacobian.T
        error = length - part.rest + compliance[group] * multiplier[group]
        change = -np.linalg.solve(jacobian @ move + np.diag(compliance[group]), error)
        multiplier[group] += change
        y += (move @ change).reshape(-1, 2)
    return Step(y, (y - x) / h, -multiplier / h**2)


def sdirk_step(chain: Chain, x: Floats, v: Floats, h: float, step: Callable[..., Step] = backward_euler_step) -> Step:
    """Return the result of a substep of `lines` or `implicit` (`solvers/two_stage.py`).

    It consists of two backward Euler steps of γh and a jump between them. `step` takes one: exactly, or as a solver.
    """
    first = step(chain, x, v, GAMMA * h)
    return step(chain, x + (1 - GAMMA) * h * first.v, v + (first.v - v) * (1 - GAMMA) / GAMMA, GAMMA * h)


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
REST_SECONDS = 10.0
IN_FLOAT64 = {
    "xpbd": f"iterations end too early: {SAME_ITERATIONS} end as far from the solution",
    "lines": f"corrections keep the directions of their iterations: {SAME_ITERATIONS} end as far from the solution",
}
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


def run_in_float64(solver: str, chain: Chain, x: Floats, frames: int, damping: float = 0.0) -> list[Step]:
    """Return the states of the strand at its start, at rest, and after each frame of `xpbd` or `lines` in float64.

    `damping` is a rate [1/s].
    """
    step = partial(lines_step if solver in TWO_STAGE else xpbd_step, iterations=STRAND_ITERATIONS)
    if solver in TWO_STAGE:
        step = partial(sdirk_step, step=step)
    steps = [Step(x, np.zeros_like(x), np.zeros(len(chain.rest)))]
    for _ in range(frames):
        steps.append(step(chain, steps[-1].x, steps[-1].v / (1 + damping * FRAME_SECONDS), FRAME_SECONDS))
    return steps


def at_rest(solver: str) -> Iterator[Check]:
    """Measure the elongation of the hanging strand."""
    scene = heavy_strand(solver, 90.0, 0.0)
    with Timed(replace(scene, solver=replace(scene.solver, damping=REST_DAMPING))) as simulation:
        chain = chain_of(simulation)
        start = left_strand(simulation.positions())
        advance(simulation, REST_SECONDS)
        carried = chain.mass[::-1].cumsum()[-2::-1] * STRAND_GRAVITY  # [N] by each link, from the top
        exact = float((carried / CONSTANT).sum())
        measured = float((start - left_strand(simulation.positions()))[-1, 1])
        row = relative("longer by [m]", exact, measured, *STRAND)
        if solver == "xpbd":
            steps = run_in_float64(solver, chain, start, round(REST_SECONDS / FRAME_SECONDS), REST_DAMPING)
            row = row.by_law(IN_FLOAT64[solver], float((start - steps[-1].x)[-1, 1]) / exact - 1)
        yield row


def residual(solver: str) -> Iterator[Check]:
    """Measure the residual of the strand's steps, in weights of a particle.

    The strand carries 1000 of these weights, and float32 leaves a residual of about 2.
    """
    with Timed(heavy_strand(solver, START_ANGLE, SKIP)) as simulation:
        chain = chain_of(simulation)
        states = [(left_strand(simulation.positions()), left_strand(simulation.velocities()))]
        for _ in range(STRAND_FRAMES):
            simulation.step()
            states.append((left_strand(simulation.positions()), left_strand(simulation.velocities())))
        found = largest_residual(solver, chain, states)
        row = at_most(f"residual of a step, over {STRAND_GRAVITY:g} N", found / STRAND_GRAVITY, *RESIDUAL)
        if solver in IN_FLOAT64:
            row = row.by_law(IN_FLOAT64[solver], partial(residual_in_float64, solver, chain, states[0][0]))
        yield row


def residual_in_float64(solver: str, chain: Chain, x: Floats) -> float:
    """Return the largest residual of the strand's steps by the solver in float64, in weights of a particle."""
    steps = run_in_float64(solver, chain, x, STRAND_FRAMES)
    return largest_residual(solver, chain, [(step.x, step.v) for step in steps]) / STRAND_GRAVITY


def largest_residual(solver: str, chain: Chain, states: Sequence[tuple[Floats, Floats]]) -> float:
    """Return the largest residual [N] of the steps from state to state, each (positions [m], velocities [m/s])."""
    residuals = []
    for (x, v), (x_new, v_new) in pairwise(states):
        h, y = FRAME_SECONDS, inertial_target(chain, x, v, FRAME_SECONDS)
        if solver in TWO_STAGE:
            h, y = second_stage(chain, x, v, x_new, v_new)
        residuals.append(float(step_residual(chain, y, x_new, h).max()))
    return max(residuals)


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
        start = x = left_strand(simulation.positions())
        v = left_strand(simulation.velocities())
        errors, exact = [], []
        for _ in range(STRAND_FRAMES):
            simulation.step()
            x, v, _ = step(chain, x, v, FRAME_SECONDS)
            exact.append(chain.strains(x)[links])
            errors.append(np.abs(chain.strains(left_strand(simulation.positions()))[links] - exact[-1]).max())
        largest = float(np.abs(exact).max())
        row = Check("largest error of a strain", largest, largest + max(errors), max(errors) / largest, *STRAND)
        if solver in IN_FLOAT64:
            strains = [chain.strains(step.x)[links] for step in run_in_float64(solver, chain, start, STRAND_FRAMES)[1:]]
            row = row.by_law(IN_FLOAT64[solver], float(np.abs(np.array(strains) - exact).max()) / largest)
        yield row
