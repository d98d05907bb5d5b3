"""A8: symmetry, order of convergence, conservation of energy, and a finer mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from ...geometry.cloth_builder import spring_stiffness
from ...geometry.topology import energies, spring_strains
from ...scene.fabric_schema import Fabric
from ...scene.schema import FRAME_SECONDS, Forces, Scene, Solver
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.simulation import Simulation
from ..bench.error_sweep import Curtain, curtain_solution, verlet
from .check import (
    FAIL,
    FINER,
    GRIDS,
    ROUNDED,
    SAME_ITERATIONS,
    UNFINISHED_SOLVERS,
    VELOCITY_ROUNDED,
    Check,
    Timed,
    advance,
    at_most,
    base,
    bottom_middle,
    default_solver,
    effective_stiffness,
    largest_of,
    order_lost,
    rounding_error,
    run_with_limit,
    structural,
    velocity_rounding_error,
)
from .exact import GRAVITY, Floats
from .float64_steps import swept_in_float64
from .hanging import hanging_chain
from .strand import xpbd_step
from .swing import curtain

REST_FLAT, REST_TURNED = (0.0, 0.0), (1e-6, 0.0)  # A8: exactly, or < 1e-6·L
EQUAL = (1e-5, 1e-6)  # A8: 1e-5·L
SHIFTED = (1e-4, 1e-4)  # A8: unchanged to 1e-4·L; no wider bound is defined to pass
SHIFTS = (10.0, 100.0, 777.7, 1000.0)  # [m] A8, and one that is no multiple of the distance of local origins
ORDER_SUBSTEPS = {"explicit": (4, 8, 16, 32), "lines": (1, 2, 4, 8), "rk4": (1, 2, 4, 8), "implicit": (1, 2, 4, 8)}
SLOPE = (0.15, 0.05)  # A8: ±0.15, here in each of three halvings
ORDER_CURTAIN = Curtain(cells=8, stiffness=6.0, degrees=60.0)  # soft: the largest steps are stable
CONSERVING = ("explicit", "rk4")
BOUNDED = (1e-2, 1e-3)  # A8: 1 % over 10,000 steps
NEVER_RISING = (1e-5, 1e-6)  # A8: Euler's energy never rises without work done; float32 as in A1.6
CURTAIN_SECONDS, CURTAIN_SPEED = 1.0, sqrt(2 * GRAVITY)  # [s]; [m/s] of a fall of one side
MAX_PHASE = 0.5  # [rad] of the fastest vibration in a step of velocity Verlet, which is stable up to 2
DISTURBANCE = 1e-9  # [m]
GRIDS_ROUNDED = f"the exact solutions of the two grids differ, and {ROUNDED}, grows as a disturbance of the start does"
GRIDS_SWEPT = f"iterations end too early, on two grids: {SAME_ITERATIONS} differ as much"
ROUNDED_AND_GROWN = f"{ROUNDED}, times the growth of a disturbance of the start"
ORDER_OF_SPRINGS = f"a sweep meets the springs in another order: {SAME_ITERATIONS} differ as much"
SIDE = 1.0  # [m]
SHORT_SECONDS = 0.5  # [s] before folds amplify rounding errors


def at_rest(solver: str) -> Iterator[Check]:
    """Measure the displacement of a sheet without forces.

    The rest lengths of a rotated sheet are rounded; those of a sheet along the axes are exact.
    """
    for name, rotation in (("flat", (0.0, 0.0, 0.0)), ("turned", (-37.0, 20.0, 0.0))):
        scene = replace(base(solver, rotation=rotation), forces=Forces(gravity=0.0))
        with Timed(scene) as simulation:
            for _ in range(max(1, 10_000 // simulation.substeps)):
                simulation.step()
            final_positions = float(np.abs(simulation.positions() - simulation.topology.start).max())
            bounds = REST_FLAT if name == "flat" else REST_TURNED
            yield at_most(f"displacement without forces in 10,000 substeps, {name} [m]", final_positions, *bounds)


def swinging(solver: str, **keys: object) -> Scene:
    """Return the scene of a sheet that is released from its top edge, 60° off hanging."""
    scene = base(solver, 17, 17, **{"pins": ("top",), "rotation": (-60.0, 0.0, 0.0), **keys})
    return replace(scene, fabric=Fabric(warp=500.0, weft=500.0, shear=250.0, bend_spring=5.0))


def final_positions(scene: Scene) -> Floats:
    """Return the positions of the particles after `SHORT_SECONDS` [m], relative to the initial middle of the sheet."""
    with Timed(scene) as simulation:
        advance(simulation, SHORT_SECONDS)
        from_center: Floats = simulation.positions() - np.asarray(scene.cloth.center)
        return from_center


def rotated(solver: str) -> Iterator[Check]:
    """Compare a sheet that is rotated by 30° about the vertical with the rotated motion of the original."""
    plain, other = final_positions(swinging(solver)), final_positions(swinging(solver, rotation=(-60.0, 30.0, 0.0)))
    c, s = sqrt(3) / 2, 0.5
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    row = at_most("difference when turned by 30° [m]", float(np.abs(other - plain @ rotation.T).max()), *EQUAL)
    yield explain_rounding(row, swinging(solver))


def mirrored(solver: str) -> Iterator[Check]:
    """Compare a symmetric sheet with its mirror image."""
    x = final_positions(swinging(solver)).reshape(17, 17, 3)
    image = x[:, ::-1] * [-1.0, 1.0, 1.0]
    row = at_most("difference to its mirror image [m]", float(np.abs(image - x).max()), *EQUAL)
    if solver in UNFINISHED_SOLVERS and row.verdict == FAIL:
        x = swept_in_float64(swinging(solver), SHORT_SECONDS).reshape(17, 17, 3)
        row = explain_order(row, swinging(solver), float(np.abs(x[:, ::-1] * [-1.0, 1.0, 1.0] - x).max()))
    yield row


def transposed(solver: str) -> Iterator[Check]:
    """Compare a sheet with the same sheet whose rows are columns."""
    plain, other = swinging(solver), swinging(solver, pins=("left",))
    transposition = np.arange(17 * 17).reshape(17, 17).T.ravel()
    with Timed(other) as simulation:
        with Timed(plain) as first:
            start = first.positions()
        simulation.set_state(start[transposition])
        advance(simulation, SHORT_SECONDS)
        x = simulation.positions()[transposition]
    difference = float(np.abs(x - final_positions(plain)).max())
    row = at_most("difference with rows for columns [m]", difference, *EQUAL)
    if solver in UNFINISHED_SOLVERS and row.verdict == FAIL:
        x = swept_in_float64(other, SHORT_SECONDS, start[transposition])[transposition]
        row = explain_order(row, plain, float(np.abs(x - swept_in_float64(plain, SHORT_SECONDS)).max()))
    yield row


def explain_order(row: Check, scene: Scene, difference: float) -> Check:
    """Return the row of a difference of two runs with its law. `difference` [m] is that of the runs in float64."""
    if difference <= row.tolerance:
        return explain_rounding(row, scene)
    return row.by_law(ORDER_OF_SPRINGS, difference, row.tolerance + rounding_of_sheet(scene))


def explain_rounding(row: Check, scene: Scene) -> Check:
    """Return the row of a difference of two runs with its law."""
    solver = scene.solver.name
    if row.verdict != FAIL or solver not in UNFINISHED_SOLVERS:
        return row
    return row.by_law(VELOCITY_ROUNDED if solver == "verlet" else ROUNDED_AND_GROWN, rounding_of_sheet(scene))


def rounding_of_sheet(scene: Scene) -> float:
    """Return the largest difference [m] that rounding to float32 makes between two runs of `swinging`."""
    steps = round(SHORT_SECONDS / FRAME_SECONDS) * scene.solver.substeps
    count = 3 * scene.cloth.rows * scene.cloth.columns
    if scene.solver.name == "verlet":
        error = velocity_rounding_error(steps, SIDE)
    else:
        moved = swept_in_float64(scene, SHORT_SECONDS, disturbed(scene)) - swept_in_float64(scene, SHORT_SECONDS)
        growth = float(np.abs(moved).max()) / DISTURBANCE
        error = growth * rounding_error(steps, SHORT_SECONDS, SIDE, sqrt(2 * GRAVITY * SIDE))
    return sqrt(2) * largest_of(count) * error  # both runs are rounded


def disturbed(scene: Scene) -> Floats:
    """Return the start of a sheet whose free particles are up to about `DISTURBANCE` [m] away, at random, (N, 3)."""
    with Simulation(scene) as simulation:
        topology = simulation.topology
        shift = DISTURBANCE * np.random.default_rng(1).standard_normal(topology.start.shape)
        return topology.start + np.where(topology.pinned[:, None], 0.0, shift)


def far_away(solver: str) -> Iterator[Check]:
    """Compare a sheet far from the origin with one at the origin."""
    plain = final_positions(swinging(solver))
    for shift in SHIFTS:
        other = final_positions(swinging(solver, center=(shift, shift, 0.0)))
        yield at_most(f"difference {shift:g} m away, up and aside [m]", float(np.abs(other - plain).max()), *SHIFTED)


def order(solver: str) -> Iterator[Check]:
    """Measure the order of convergence in each of three halvings of the substep.

    The scene is a curtain whose columns move as chains, and the exact motion is that of an independent program in
    float64 (`evaluation/bench/error_sweep.py`).
    """
    cells = ORDER_CURTAIN.cells
    frames = round(SHORT_SECONDS / FRAME_SECONDS)
    exact = curtain_solution(ORDER_CURTAIN, frames)[-1]
    rotation = (-ORDER_CURTAIN.degrees, 0.0, 0.0)
    sheet = base(solver, cells + 1, cells + 1, mass_lumping="uniform", pins=("top",), rotation=rotation)
    sheet = structural(sheet, ORDER_CURTAIN.stiffness)
    errors = []
    halvings = ORDER_SUBSTEPS.get(solver, (8, 16, 32, 64))
    for substeps in halvings:
        with Timed(replace(sheet, solver=Solver(solver, substeps, 50, damping=0.0))) as simulation:
            pivot = simulation.topology.start[0]
            advance(simulation, SHORT_SECONDS)
            x = (simulation.positions() - pivot).reshape(cells + 1, cells + 1, 3)[:, cells // 2]
            errors.append(float(np.sqrt(((x[:, [2, 1]] - exact) ** 2).sum(axis=1).mean())))
    law = float(SOLVER_CATALOG[solver].order)
    yield order_row(law, errors, [frames * substeps for substeps in halvings], exact)


def order_row(law: float, errors: list[float], steps: list[int], exact: Floats) -> Check:
    """Return the row of the worst halving, or of the worst that rounding does not explain, if there is one.

    `exact` are the final positions of the chain [m].
    """
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    missed = np.abs(orders - law)
    speed = sqrt(2 * GRAVITY * 1.0)  # [m/s] after a fall of the chain's length
    floors = [rounding_error(count, SHORT_SECONDS, float(np.abs(exact).max()), speed) for count in steps[1:]]
    lost = np.array([order_lost(law, error, floor) for error, floor in zip(errors[:-1], floors, strict=True)])
    unexplained = missed > lost + SLOPE[0]
    k = int(np.where(unexplained | ~unexplained.any(), missed, -1.0).argmax())
    row = Check("order of convergence, the worst of three halvings", law, float(orders[k]), float(missed[k]), *SLOPE)
    return row.by_law(ROUNDED, partial(float, lost[k]))


def energy(solver: str) -> Iterator[Check]:
    """Measure how well an undamped sheet conserves its energy over 10,000 substeps: gravitational, elastic and kinetic.

    Explicit methods may neither lose nor gain energy. Implicit methods lose the energy of motion that they cannot
    resolve, but must not gain any.
    """
    scene = replace(swinging(solver), solver=default_solver(solver))
    with Timed(scene) as simulation:
        topology = simulation.topology
        stiffness = spring_stiffness(scene, simulation.solver.info.stiffness_section, topology)
        totals, kinetic = [], []
        for _ in range(max(60, 10_000 // simulation.substeps)):
            x = simulation.positions()
            kinetic_now, gravitational = energies(topology, x, simulation.velocities(), GRAVITY)
            elastic = 0.5 * float((stiffness * (spring_strains(topology, x) * topology.rest) ** 2).sum())
            totals.append(kinetic_now + gravitational + elastic)
            kinetic.append(kinetic_now)
            simulation.step()
        relative = np.array(totals) / max(kinetic)
        if solver in CONSERVING:
            change = float(np.abs(relative - relative[0]).max())
            yield at_most("energy lost or won, of the largest kinetic energy", change, *BOUNDED)
        else:
            gain = float((relative - np.minimum.accumulate(relative)).max())
            lost = float(relative[0] - relative[-1])
            what = f"energy won, of the largest kinetic energy ({100 * lost:.1f} % lost)"
            yield at_most(what, gain, *NEVER_RISING)


# -- a finer mesh ------------------------------------------------------------------------------------------------------


def finer_curtain(solver: str) -> Iterator[Check]:
    """Measure how much the bottom position after 1 s changes with twice as many cells, for masses by area."""
    bottoms: dict[int, Bottom] = {}

    def bottom(cells: int) -> Bottom:
        if cells not in bottoms:
            with Timed(curtain(solver, cells, mass_lumping="area")) as simulation:
                advance(simulation, CURTAIN_SECONDS)
                steps = round(CURTAIN_SECONDS / FRAME_SECONDS) * simulation.substeps
                bottoms[cells] = Bottom(bottom_middle(simulation.positions()), steps)
        return bottoms[cells]

    for (coarse, fine), bounds in FINER.items():
        what = f"bottom row of {fine} cells after 1 s, against {coarse}, of the side"

        def difference(
            what: str = what, coarse: int = coarse, fine: int = fine, bounds: tuple[float, float] = bounds
        ) -> Check:
            row = at_most(what, float(np.linalg.norm(bottom(fine).position - bottom(coarse).position)), *bounds)
            rounding = partial(rounding_of_curtain, fine, bottom(fine).steps)
            return explain_finer(row, solver, coarse, fine, rounding)

        yield run_with_limit(what, *bounds, difference)


class Bottom(NamedTuple):
    """The bottom of the curtain after `CURTAIN_SECONDS`."""

    position: Floats  # [m] (3,)
    steps: int  # taken until then


def explain_finer(row: Check, solver: str, coarse: int, fine: int, rounding: Callable[[], float]) -> Check:
    """Return the row of `finer_curtain` with its law: the exact bottoms differ, and `rounding` [m] adds to it."""
    if row.verdict != FAIL:
        return row
    if solver == "xpbd":
        return row.by_law(GRIDS_SWEPT, float(np.linalg.norm(swept_bottom(fine) - swept_bottom(coarse))))
    if solver == "verlet":
        return row.by_law(GRIDS, partial(exact_change, solver, coarse, fine))
    return row.by_law(GRIDS_ROUNDED, exact_change(solver, coarse, fine), row.tolerance + rounding())


def rounding_of_curtain(cells: int, steps: int) -> float:
    """Return how far the bottom of the curtain moves by rounding to float32 in these steps [m]."""
    stiffness = Curtain().stiffness
    moved = bottom_by_area(cells, stiffness, disturbance=DISTURBANCE) - bottom_by_area(cells, stiffness)
    growth = float(np.linalg.norm(moved)) / DISTURBANCE
    return growth * rounding_error(steps, CURTAIN_SECONDS, 1.0, CURTAIN_SPEED)


@dataclass(frozen=True)
class HalfLastRow(Curtain):
    """The curtain with masses by area: its last row is half as heavy as the others."""

    disturbance: float = 0.0
    """Standard deviation of random displacements of the start [m]."""

    @property
    def start(self) -> Floats:
        """Initial position of every row [m], (cells + 1, 2)."""
        shift = self.disturbance * np.random.default_rng(1).standard_normal((self.cells + 1, 2))
        shift[0] = 0.0
        positions: Floats = super().start + shift
        return positions

    def acceleration(self, x: Floats) -> Floats:
        """Return the acceleration of every row [m/s²], (cells + 1, 2)."""
        a = super().acceleration(x)
        a[-1] = 2 * a[-1] + [0.0, GRAVITY]  # twice that of its spring, and its weight
        return a


@cache
def bottom_by_area(cells: int, stiffness: float, disturbance: float = 0.0) -> Floats:
    """Return the position of the bottom row of `HalfLastRow`, (2,), by velocity Verlet with short steps.

    All rows start up to about `disturbance` [m] away, at random. The first-order error of steps of h is left out: it is
    nearly the same with twice as many cells.
    """
    sheet = HalfLastRow(cells, stiffness, disturbance=disturbance)
    steps = ceil(sheet.max_frequency * FRAME_SECONDS / MAX_PHASE)
    bottom: Floats = verlet(sheet, round(CURTAIN_SECONDS / FRAME_SECONDS), steps)[-1, -1]
    return bottom


@cache
def swept_bottom(cells: int) -> Floats:
    """Return the position of the bottom row (2,) with the iterations of `xpbd` in float64."""
    substeps, iterations = SOLVER_CATALOG["xpbd"].defaults
    sheet = HalfLastRow(cells)
    chain = hanging_chain(cells, sheet.stiffness / sheet.mass)
    chain.mass[-1] /= 2
    x, v = sheet.start, np.zeros_like(sheet.start)
    for _ in range(round(CURTAIN_SECONDS / FRAME_SECONDS) * substeps):
        x, v, _ = xpbd_step(chain, x, v, FRAME_SECONDS / substeps, iterations)
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
        bottoms.append(bottom_by_area(cells, stiffness))
    return float(np.linalg.norm(bottoms[1] - bottoms[0]))
