"""A3, B3 and B4: hanging, stretching and sagging, and the forces that hold a sheet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from ...geometry.cloth_builder import spring_stiffness
from ...scene.fabric_schema import VerletSprings
from ...scene.schema import FRAME_SECONDS, Forces, Scene, Solver
from ...simulation.convergence import artificial_stretch, lines_excess, unconverged_fraction
from ...simulation.simulation import Simulation
from ..bench.error_sweep import Curtain
from .check import (
    FINER,
    GRIDS,
    REST_DAMPING,
    ROUNDED_WEIGHT,
    SOFTER,
    UNFINISHED_SOLVERS,
    Check,
    Timed,
    advance,
    base,
    bottom_middle,
    damped,
    effective_stiffness,
    relative,
    rows_with_limit,
    run_with_limit,
    strip,
    strip_constant,
    structural,
    substep,
)
from .exact import GRAVITY, Floats, hanging_drop
from .exact import hammock as exact_hammock
from .strand import Chain, backward_euler_step, sdirk_step, xpbd_step

ELONGATION = (2e-2, 1e-3)  # A3: 2 %, 0.1 % of the elongation
CELLS = (16, 32, 64, 128)
CONSTANT = 1000.0  # [N/m] of the base cloth
CHAIN_LINKS, CHAIN_MASS = 20, 0.01  # A3: links of `CONSTANT`, particles of 10 g
SPANS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99)
SAG = (1e-2, 1e-3)  # A3: 1 %, 0.1 % of the discrete value
FINER_SPAN = TENSION_SPAN = 0.8
HAMMOCK_LINKS, OTHER_LINKS = 16, (8, 32, 64, 128)  # A3
HAMMOCK_CONSTANT = 1000.0  # [N/m] of a spring
LAW_LINKS = 32
# c of `stretch` for 33 particles per side; 0.343 and 0.342 for 9 and 17, ⅓ for many, ½ without diagonals.
WITH_DIAGONALS = 0.338
LAW_SETTINGS = (  # A3: links, substeps, iterations
    (32, 10, 1),
    (64, 10, 1),
    (64, 30, 1),
    (128, 1, 20),
    (128, 1, 100),
    (128, 10, 1),
    (128, 20, 1),
    (128, 30, 1),
    (128, 100, 1),
    (256, 30, 1),
)
LAW = (0.05, 0.01)
INDEPENDENT = (1e-2, 1e-3)  # B3: within 1 % across iterations and h
INDEPENDENT_CELLS, HELD_CELLS = 64, 32
INDEPENDENT_SUBSTEPS, INDEPENDENT_ITERATIONS = (1, 10), (1, 5, 20, 40, 80, 160)  # A3: from 1 iteration, h to h/10
SPLIT_SECONDS = 4.0
SPLITS = ((400.0, 1), (100.0, 4), (25.0, 16), (12.5, 32))  # B4: steps per second, iterations: 400 sweeps per second
HELD = (1e-2, 1e-3)  # of the weight, as other forces: 1 %, 0.1 %
GRABBED = "one corner and a grab"
HELD_BY = {"its top edge": ("top",), "two corners": ("top-left", "top-right"), GRABBED: ("top-left",)}
LINES_UNFINISHED = (
    "iterations end before lines in different directions agree: (I − Mⁱ)·λ carries the weight, by linear theory"
)
UNFINISHED = "iterations end before a substep is solved: κ·(1 − ρ)·ρ^(i−1)/(1 − ρ^i), κ = kh²/m, ρ = 1/(1 + m/(2kh²))²"


def sheet(solver: str, cells: int) -> Scene:
    """Return the base cloth, pinned along its top, with structural springs only and equal masses."""
    return damped(structural(base(solver, cells + 1, cells + 1, mass_lumping="uniform", pins=("top",)), CONSTANT))


def elongation(solver: str) -> Iterator[Check]:
    """Measure the elongation of a sheet that is pinned along its top, under the weight that each spring carries."""
    for cells in CELLS:
        what = f"{cells} rows below the pins: longer by [m]"
        yield run_with_limit(
            what, *ELONGATION, partial(measure_elongation, what, sheet(solver, cells), cells, ELONGATION)
        )
    yield from chain(solver)


def chain(solver: str) -> Iterator[Check]:
    """Measure the links of a hanging chain: each is longer by the weight that it carries over its constant."""
    scene = strip(solver, CHAIN_LINKS, constant=CONSTANT)
    cell = scene.cloth.width / 2 * scene.cloth.height / CHAIN_LINKS  # [m²], which a particle weighs as much as
    cloth = replace(scene.cloth, area_density=CHAIN_MASS / cell)
    with Timed(damped(replace(scene, cloth=cloth))) as simulation:
        advance(simulation, 10.0)
        column = simulation.positions().reshape(CHAIN_LINKS + 1, 3, 3)[:, 1, 1]
        longer = -np.diff(column) - 1 / CHAIN_LINKS
        one = CHAIN_MASS * GRAVITY / CONSTANT  # [m] by which the last link is longer
        yield relative(
            f"{CHAIN_LINKS} links: longer by [m]", sum(range(CHAIN_LINKS + 1)) * one, longer.sum(), *ELONGATION
        )
        yield relative(f"top of {CHAIN_LINKS} links: longer by [m]", CHAIN_LINKS * one, longer[0], *ELONGATION)
        yield relative(f"bottom of {CHAIN_LINKS} links: longer by [m]", one, longer[-1], *ELONGATION)


def held(solver: str) -> Iterator[Check]:
    """Compare the reaction forces on a sheet at rest with its weight: of pins, and of a grab that holds a corner."""
    for name, pins in HELD_BY.items():
        whats = [f"held by {name}: all forces over the weight"]
        if name == GRABBED:
            whats.append("force of the grab over the weight")
        yield from rows_with_limit(whats, *HELD, partial(measure_forces, whats, solver, pins))


def measure_forces(whats: Sequence[str], solver: str, pins: tuple[str, ...]) -> list[Check]:
    """Measure all reaction forces, and with a second row that of a grab which holds the top right corner."""
    scene = base(solver, HELD_CELLS + 1, HELD_CELLS + 1, pins=pins)
    fabric = replace(scene.fabric, warp=CONSTANT, weft=CONSTANT, shear=CONSTANT)
    with Timed(damped(replace(scene, fabric=fabric))) as simulation:
        grabs = [simulation.grab(simulation.scene.cloth.columns - 1) for _ in whats[1:]]
        advance(simulation, 10.0)
        weight = float(simulation.topology.mass.sum()) * GRAVITY
        up = float(simulation.reaction_forces()[:, 1].sum())
        rows = [relative(whats[0], 1.0, up / weight, *HELD)]
        for what, grab in zip(whats[1:], grabs, strict=True):
            rows.append(relative(what, 0.5, float(grab.force[1]) / weight, *HELD))
        if solver != "lines":
            return rows
        h, iterations = substep(simulation), simulation.scene.solver.iterations
        return [row.by_law(LINES_UNFINISHED, partial(lines_excess, scene.cloth, fabric, h, iterations)) for row in rows]


def independence(solver: str) -> Iterator[Check]:
    """Measure the elongation at several numbers of iterations and substeps. It must not depend on them.

    Multipliers accumulate over the iterations of a substep.
    """
    for substeps in INDEPENDENT_SUBSTEPS:
        for iterations in INDEPENDENT_ITERATIONS:
            setting = Solver(name=solver, substeps=substeps, iterations=iterations, damping=REST_DAMPING)
            scene = replace(sheet(solver, INDEPENDENT_CELLS), solver=setting)
            what = f"{INDEPENDENT_CELLS} rows, {substeps}×{iterations}: longer by [m]"
            run = partial(measure_elongation, what, scene, INDEPENDENT_CELLS, INDEPENDENT)
            yield run_with_limit(what, *INDEPENDENT, run)


def measure_elongation(what: str, scene: Scene, cells: int, bounds: tuple[float, float]) -> Check:
    """Measure the elongation of a hanging sheet; `xpbd` may be off by the law of iterations that end too early."""
    with Timed(scene) as simulation:
        mass = float(simulation.topology.mass[0])
        advance(simulation, 10.0)
        measured = float(bottom_middle(simulation.topology.start - simulation.positions())[1])
        row = relative(what, hanging_drop(cells, mass, CONSTANT), measured, *bounds)
        if scene.solver.name != "xpbd":
            return row
        share = unconverged_fraction(CONSTANT, mass, substep(simulation), scene.solver.iterations)
        return row.by_law(UNFINISHED, share)


def split(solver: str) -> Iterator[Check]:
    """Compare 400 sweeps per second, as steps or as iterations, with the same method in float64 (B4).

    A row is the mean length of the second half of the run, over that of the chain at rest, minus 1. The chain has 32
    links of 1 m. A frame has an integer number of substeps, so time runs faster: with h/f for h, gravity and stiffness
    are multiplied by f², and every position is the same.
    """
    for constant in (1e7, 1e3):  # [N/m] of a link
        at_rest = 1 + GRAVITY * (LAW_LINKS + 1) / 2 / constant  # a link of 1 m carries all masses of 1 kg below it
        for rate, iterations in SPLITS:
            substeps = max(1, round(rate * FRAME_SECONDS))
            speedup = substeps / FRAME_SECONDS / rate
            # Columns are half a meter apart: a spring of a column has half the constant of one meter of the sheet.
            scene = strip(solver, LAW_LINKS, constant=2 * constant * speedup**2)
            cloth = replace(scene.cloth, height=float(LAW_LINKS), width=1.0, area_density=2.0)  # 1 kg per particle
            setting = Solver(solver, substeps, iterations, damping=0.0)
            scene = replace(scene, cloth=cloth, solver=setting, forces=Forces(gravity=GRAVITY * speedup**2))
            frames = round(SPLIT_SECONDS / speedup / FRAME_SECONDS)
            lengths = []
            with Timed(scene) as simulation:
                for _ in range(frames):
                    simulation.step()
                    lengths.append(-float(simulation.positions()[-2, 1] - simulation.topology.start[1, 1]))
            measured = float(np.mean(lengths[frames // 2 :])) / LAW_LINKS
            expected = released_chain(LAW_LINKS, rate, iterations, constant, SPLIT_SECONDS)[substeps - 1 :: substeps]
            exact = float(np.mean(expected[frames // 2 : frames]))
            what = f"{constant:g} N/m, {rate:g} steps/s × {iterations}: mean length over that at rest, minus 1"
            row = relative(what, exact / at_rest - 1, measured / at_rest - 1, *ELONGATION)
            yield row.by_law(ROUNDED_WEIGHT, rounded_length(rate, constant) / at_rest / abs(row.exact))


def rounded_length(rate: float, constant: float) -> float:
    """Return the change of a hanging chain's length, over its rest length, if each weight is wrong by the rounding.

    `rate` is in steps per second; the links are of 1 m and of `constant` [N/m], and coordinates begin in the middle.
    """
    below = np.arange(LAW_LINKS, 0, -1)  # particles of 1 kg
    x = np.cumsum(1 + GRAVITY * below / constant) - LAW_LINKS / 2
    share = np.spacing(np.abs(x).astype(np.float32)).astype(float) / 2 * rate**2 / GRAVITY
    forces = np.cumsum(GRAVITY * share[::-1])  # [N] in the links, from the bottom
    return float(forces.sum()) / constant / LAW_LINKS


def released_chain(links: int, rate: float, iterations: int, constant: float, seconds: float) -> Floats:
    """Return length over rest length of a hanging chain after every step from its release, by `xpbd` in float64.

    Masses are 1 kg, links 1 m long and of `constant` [N/m]; `rate` is in steps per second.
    """
    ends = np.stack([np.arange(links), np.arange(1, links + 1)], axis=-1)
    chain = Chain(np.ones(links + 1), ends, np.ones(links), np.full(links, constant))
    x = np.stack([np.zeros(links + 1), -np.arange(links + 1.0)], axis=-1)
    v, lengths = np.zeros_like(x), []
    for _ in range(round(seconds * rate)):
        x, v, _ = xpbd_step(chain, x, v, 1 / rate, iterations)
        lengths.append(-float(x[-1, 1]) / links)
    return np.array(lengths)


def stretch(solver: str) -> Iterator[Check]:
    """Measure the stretch c·N²·g·h²/iterations that position-based relaxation leaves, whatever the fabric.

    c is ½, and about ⅓ with diagonals. It is a law of iterations that solve one spring after the other. `lines` solves
    an entire row at once, and `implicit` all springs, so what they leave does not grow with N²·g·h²/iterations, and
    they have no c. A3.1 and B3 measure them.
    """
    square = base(solver, LAW_LINKS + 1, LAW_LINKS + 1, mass_lumping="uniform", pins=("top",))
    rigid = replace(square.fabric, warp=1e9, weft=1e9, shear=1e9, bend_spring=0.0)
    diagonals = replace(square, verlet=VerletSprings(bend=0.0), fabric=rigid)
    yield stretch_row("threads", threads(solver, LAW_LINKS), 0.5)
    yield stretch_row("threads and diagonals", diagonals, WITH_DIAGONALS)
    for links, substeps, iterations in LAW_SETTINGS:
        scene = threads(solver, links)
        scene = replace(scene, solver=replace(scene.solver, substeps=substeps, iterations=iterations))
        yield stretch_row(f"threads of {links} links, {substeps}×{iterations}", scene, 0.5)


def threads(solver: str, links: int) -> Scene:
    """Return a hanging strip whose springs do not stretch."""
    return replace(strip(solver, links, constant=1e9), verlet=VerletSprings(shear=0.0, bend=0.0))


def stretch_row(name: str, scene: Scene, coefficient: float) -> Check:
    """Compare the stretch of a hanging sheet at rest with c·N²·g·h²/iterations."""
    with Timed(damped(scene)) as simulation:
        advance(simulation, 10.0)
        rows, columns = simulation.scene.cloth.rows, simulation.scene.cloth.columns
        measured = float((simulation.topology.start - simulation.positions())[-(columns // 2) - 1, 1])
        unit = 2 * artificial_stretch(rows - 1, substep(simulation), scene.solver.iterations)
        return relative(f"stretch over N²·g·h²/iterations, {name}", coefficient, measured / unit, *LAW)


def hammock(solver: str) -> Iterator[Check]:
    """Measure a strip that is pinned at two edges which are closer than its length."""
    for span in SPANS:
        exact, measured = measure_hammock(solver, span, HAMMOCK_LINKS)
        yield relative(f"sag at a span of {span:g} m [m]", exact.sag, measured.sag, *SAG)
        if span == TENSION_SPAN:
            what = f"tension of the last links over the weight at {span:g} m"
            yield relative(what, exact.tension, measured.tension, *SAG)
    for links in OTHER_LINKS:
        what = f"sag with {links} links at a span of {FINER_SPAN:g} m [m]"
        yield run_with_limit(what, *SAG, partial(discrete_sag, what, solver, links))


def discrete_sag(what: str, solver: str, links: int) -> Check:
    """Measure the sag of a hammock of some links."""
    exact, measured = measure_hammock(solver, FINER_SPAN, links)
    row = relative(what, exact.sag, measured.sag, *SAG)
    return row.by_law(SOFTER, partial(unconverged_sag_of, solver, links))


def unconverged_sag_of(solver: str, links: int) -> float:
    """Return the relative error of the sag that the iterations of the solver leave."""
    own, left = exact_sags(solver, links)
    return abs(left / own - 1)


def finer_hammock(solver: str) -> Iterator[Check]:
    """Measure how much the sag of a hammock changes with twice as many links."""
    for (coarse, fine), bounds in FINER.items():
        what = f"sag with {fine} links, against {coarse} [m]"
        yield run_with_limit(what, *bounds, partial(compare_sag, what, solver, coarse, fine, bounds))


def compare_sag(what: str, solver: str, coarse: int, fine: int, bounds: tuple[float, float]) -> Check:
    """Measure the sag with `fine` links, compared with `coarse` links."""
    first, second = (measure_hammock(solver, FINER_SPAN, links)[1].sag for links in (coarse, fine))
    return relative(what, first, second, *bounds).by_law(GRIDS, partial(exact_sag_change, solver, coarse, fine))


def exact_sag_change(solver: str, coarse: int, fine: int) -> float:
    """Return the relative change of the sag at rest, with the stiffness that the iterations of the solver leave."""
    return abs(exact_sags(solver, fine)[1] / exact_sags(solver, coarse)[1] - 1)


def exact_sags(solver: str, links: int) -> tuple[float, float]:
    """Return the sag at rest [m] with the springs' own stiffness, and with that which the iterations leave."""
    with Simulation(hammock_strip(solver, links)) as simulation:
        mass, constant = row_mass(simulation), strip_constant(simulation)
        left = constant
        if solver in UNFINISHED_SOLVERS:
            iterations = simulation.scene.solver.iterations
            left = effective_stiffness(solver, constant, mass, substep(simulation), iterations)
        own_sag, left_sag = (exact_hammock(FINER_SPAN, links, 1.0, mass, k)[0] for k in (constant, left))
        return own_sag, left_sag


def hammock_strip(solver: str, links: int) -> Scene:
    """Return a damped strip that is pinned at both ends."""
    return damped(strip(solver, links, constant=HAMMOCK_CONSTANT, pins=("top", "bottom")))


def row_mass(simulation: Simulation) -> float:
    """Return the mass of a row of a strip between its ends [kg]."""
    return float(simulation.topology.mass.reshape(-1, 3)[1].sum())


class Hammock(NamedTuple):
    """Sag and tension of a hammock."""

    sag: float  # [m]
    tension: float  # of the last link, over the weight of all links


def measure_hammock(solver: str, span: float, links: int) -> tuple[Hammock, Hammock]:
    """Return the exact and the measured hammock. The strip starts as a V.

    Masses are equal, not lumped by area: both ends are pinned, and the rows between them are equally heavy in either
    case. All of them are a share of (N − 1)/(N + 1) of the weight, and a strip that hardly stretches has the same sag
    for any weight.
    """
    with Timed(hammock_strip(solver, links)) as simulation:
        topology = simulation.topology
        mass, constant = row_mass(simulation), strip_constant(simulation)
        weight = mass * GRAVITY * links
        along = np.linspace(-0.5, 0.5, links + 1)
        start = topology.start.reshape(links + 1, 3, 3).copy()
        start[:, :, 2] = (span * along)[:, None]
        start[:, :, 1] = (np.sqrt(1 - span**2) * (np.abs(along) - 0.5))[:, None]
        simulation.set_state(start.reshape(-1, 3))
        advance(simulation, 12.0)
        sag, tension = exact_hammock(span, links, 1.0, mass, constant)
        x = simulation.positions()
        lengths = np.linalg.norm(np.diff(x.reshape(links + 1, 3, 3), axis=0)[[0, -1]], axis=2)
        measured_tension = constant * (float(lengths.mean()) - 1.0 / links)
        return Hammock(sag, tension / weight), Hammock(-float(x[:, 1].min()), measured_tension / weight)


# -- chains in exactly solved steps, for the laws of `check.py` and `swing.py` -----------------------------------------


def hanging_chain(links: int, squared: float) -> Chain:
    """Return a chain of one meter with equal masses and springs, k/m = `squared` [1/s²]."""
    ends = np.stack([np.arange(links), np.arange(1, links + 1)], axis=-1)
    return Chain(np.ones(links + 1), ends, np.full(links, 1 / links), np.full(links, squared))


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


def two_stage_loss(simulation: Simulation, degrees: float, frames: int, last: int) -> float:
    """Return the share of its amplitude that a pendulum loses in exactly solved steps of `lines` and `implicit`.

    It is the largest angle before the `last` of some frames, over the angle at the start. The pendulum is the cell of
    `swing.rod`: the springs from one of its free particles to the pins act as one.
    """
    topology, h = simulation.topology, substep(simulation)
    stiffness = spring_stiffness(simulation.scene, simulation.solver.info.stiffness_section, topology)
    upward = (topology.ends[:, 0] < 2) & (topology.ends[:, 1] == 2)
    squared = float((stiffness[upward] / topology.rest[upward] ** 2).sum() / topology.mass[2])
    chain, angle = hanging_chain(1, squared), np.radians(degrees)
    x, angles = np.array([[0.0, 0.0], [np.sin(angle), -np.cos(angle)]]), []
    v = np.zeros_like(x)
    for _ in range(frames):
        angles.append(abs(np.degrees(np.arctan2(x[1, 0], -x[1, 1]))))
        for _ in range(simulation.substeps):
            x, v, _ = sdirk_step(chain, x, v, h)
    return 1 - float(max(angles[-last:])) / degrees
