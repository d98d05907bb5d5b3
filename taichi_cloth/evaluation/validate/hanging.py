"""A3, A4, B3 and B4: hanging, stretching, sagging and bending, and the forces that hold a sheet.

Euler's buckling strip is part of A3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ...scene.schema import FRAME_SECONDS, Forces, Scene, Solver, VerletSprings
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.error_estimate import artificial_stretch, unconverged_fraction
from .check import (
    REST_DAMPING,
    SOFTER,
    Check,
    Timed,
    advance,
    base,
    bottom_middle,
    damped,
    effective_stiffness,
    relative,
    run_with_limit,
    strip,
    strip_constant,
    structural,
    substep,
)
from .exact import GRAVITY, Floats, buckled, cantilever, hanging_drop, pear_loop, xpbd_chain
from .exact import hammock as exact_hammock

ELONGATION = (2e-2, 1e-3)  # A3: 2 %, 0.1 % of the elongation
CELLS = (16, 32, 64, 128)
CONSTANT = 1000.0  # [N/m] of the base cloth
SPANS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99)
SAG = (1e-2, 1e-3)  # A3: 1 %, 0.1 % of the discrete value
FINER_SPAN = TENSION_SPAN = 0.8
HAMMOCK_LINKS = 16
HAMMOCK_CONSTANT = 1000.0  # [N/m] of a spring
LAW_LINKS = 32
# c of `stretch` for 33 particles per side; 0.343 and 0.342 for 9 and 17, ⅓ for many, ½ without diagonals.
WITH_DIAGONALS = 0.338
LAW = (0.05, 0.01)
INDEPENDENT = (1e-2, 1e-3)  # B3: within 1 % across iterations and h
INDEPENDENT_CELLS = 64
INDEPENDENT_SUBSTEPS, INDEPENDENT_ITERATIONS = (1, 10), (20, 40, 80, 160)
SPLIT_SECONDS = 4.0
SPLITS = ((400.0, 1), (100.0, 4), (25.0, 16), (12.5, 32))  # B4: steps per second, iterations: 400 sweeps per second
SPLIT = (1e-2, 1e-3)
HELD_CELLS = 32
HELD = (1e-2, 1e-3)  # of the weight, as other forces: 1 %, 0.1 %
HELD_BY = {"its top edge": ("top",), "two corners": ("top-left", "top-right"), "one corner and a grab": ("top-left",)}
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


def held(solver: str) -> Iterator[Check]:
    """Compare the reaction forces on a sheet at rest with its weight: of pins, and of a grab that holds a corner."""
    for name, pins in HELD_BY.items():
        scene = base(solver, HELD_CELLS + 1, HELD_CELLS + 1, pins=pins)
        fabric = replace(scene.fabric, warp=CONSTANT, weft=CONSTANT, shear=CONSTANT)
        with Timed(damped(replace(scene, fabric=fabric))) as simulation:
            corner = simulation.scene.cloth.columns - 1
            grab = None if simulation.topology.pinned[corner] else simulation.grab(corner)
            advance(simulation, 10.0)
            weight = float(simulation.topology.mass.sum()) * GRAVITY
            up = float(simulation.reaction_forces()[:, 1].sum())
            yield relative(f"held by {name}: all forces over the weight", 1.0, up / weight, *HELD)
            if grab is not None:
                yield relative("force of the grab over the weight", 0.5, float(grab.force[1]) / weight, *HELD)


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

    The chain has 32 links of 1 m. A frame has an integer number of substeps, so time runs faster: with h/f for h,
    gravity and stiffness are multiplied by f², and every position is the same.
    """
    for constant in (1e7, 1e3):  # [N/m] of a link
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
            expected = xpbd_chain(LAW_LINKS, rate, iterations, 1 / constant, SPLIT_SECONDS)[substeps - 1 :: substeps]
            exact = float(np.mean(expected[frames // 2 : frames]))
            what = f"{constant:g} N/m, {rate:g} steps/s × {iterations}: length over rest"
            yield relative(what, exact, measured, *SPLIT)


def stretch(solver: str) -> Iterator[Check]:
    """Measure the stretch c·N²·g·h²/iterations that position-based relaxation leaves, whatever the fabric.

    c is ½, and about ⅓ with diagonals. It is a law of iterations that solve one spring after the other. `lines` solves
    an entire row at once, and `projective` all springs, so what they leave does not grow with N²·g·h²/iterations, and
    they have no c. A3.1 and B3 measure them.
    """
    bare = strip(solver, LAW_LINKS, constant=1e9)
    square = base(solver, LAW_LINKS + 1, LAW_LINKS + 1, mass_lumping="uniform", pins=("top",))
    rigid = replace(square.fabric, warp=1e9, weft=1e9, shear=1e9, bend_spring=0.0)
    for name, scene, coefficient in (
        ("threads", replace(bare, verlet=VerletSprings(shear=0.0, bend=0.0)), 0.5),
        ("threads and diagonals", replace(square, verlet=VerletSprings(bend=0.0), fabric=rigid), WITH_DIAGONALS),
    ):
        with Timed(damped(scene)) as simulation:
            advance(simulation, 10.0)
            columns = simulation.scene.cloth.columns
            measured = float((simulation.topology.start - simulation.positions())[-(columns // 2) - 1, 1])
            unit = 2 * artificial_stretch(LAW_LINKS, substep(simulation), scene.solver.iterations)
            yield relative(f"stretch over N²·g·h²/iterations, {name}", coefficient, measured / unit, *LAW)


def hammock(solver: str) -> Iterator[Check]:
    """Measure a strip that is pinned at two edges which are closer than its length."""
    for span in SPANS:
        exact, measured = measure_hammock(solver, span, HAMMOCK_LINKS)
        yield relative(f"sag at a span of {span:g} m [m]", exact.sag, measured.sag, *SAG)
        if span == TENSION_SPAN:
            what = f"tension of the last links over the weight at {span:g} m"
            yield relative(what, exact.tension, measured.tension, *SAG)


def finer_hammock(solver: str) -> Iterator[Check]:
    """Measure how much the sag of a hammock changes with twice as many links."""
    for coarse, fine in ((32, 64), (64, 128)):
        what = f"sag with {fine} links, against {coarse} [m]"
        yield run_with_limit(what, *SAG, partial(compare_sag, what, solver, coarse, fine))


def compare_sag(what: str, solver: str, coarse: int, fine: int) -> Check:
    """Measure the sag with `fine` links, compared with `coarse` links."""
    first, second = (measure_hammock(solver, FINER_SPAN, links)[1].sag for links in (coarse, fine))
    row = relative(what, first, second, *SAG)
    return row.by_law(SOFTER, partial(unconverged_sag_change, coarse, fine)) if solver == "verlet" else row


def unconverged_sag_change(coarse: int, fine: int) -> float:
    """Return the relative change of the sag at rest with `verlet`, with the stiffness that its iterations leave."""
    substeps, iterations = SOLVER_CATALOG["verlet"].defaults
    first, second = (
        exact_hammock(
            FINER_SPAN, links, 1.0, 1.0, effective_stiffness("verlet", 0.0, 1.0, FRAME_SECONDS / substeps, iterations)
        )[0]
        for links in (coarse, fine)
    )
    return abs(second / first - 1)


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
    scene = strip(solver, links, constant=HAMMOCK_CONSTANT, pins=("top", "bottom"))
    with Timed(damped(scene)) as simulation:
        topology = simulation.topology
        mass, constant = float(topology.mass.reshape(-1, 3)[1].sum()), strip_constant(simulation)
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


# -- bending -----------------------------------------------------------------------------------------------------------

LINKS = 32
CUBIC = "springs to the particle after the next bend with the cube of the angle: 2^⅓"
DROOP = (5e-2, 1e-2)  # A4: 5 %, 1 %
BUCKLED = (2e-2, 5e-3)  # A3: 2 %, 0.5 %
GAMMAS = (0.1, 1.0, 3.0, 8.0, 10.0, 30.0, 100.0, 1000.0, 10000.0)
LINKS_A_BEND = 4.5  # in the bend at the clamp, Γ^(−1/3) of the length: fewer do not resolve the elastica
LOADS = (0.25, 1.0, 2.0, 5.0, 10.0)  # α = PL²/EI at the tip
LIGHT = 0.02  # [kg/m²] of a strip that carries ten times its own weight
WIDTH = 0.1  # [m] of all strips
COMPRESSIONS = (0.01, 0.05, 0.1, 0.2, 0.3, 0.5)
BENDING = 0.02  # [N·m] of strips without weight, whose shape does not depend on it
BENDING_CONSTANT = 5000.0  # [N/m] of springs: a strip of one meter stretches by 0.02 %


def with_bending(scene: Scene, bending: float, gravity: float = GRAVITY) -> Scene:
    """Return the scene with a bending stiffness [N·m] and the damping that brings it to rest."""
    fabric = replace(scene.fabric, bending_stiffness=bending)
    return damped(replace(scene, fabric=fabric, forces=Forces(gravity=gravity)))


def beam(solver: str, links: int, bending: float, gravity: float = GRAVITY) -> Scene:
    """Return a strip of one meter, clamped level by its first two rows.

    The link between these rows cannot rotate; half of it belongs to the length.
    """
    height = (links + 1) / (links + 0.5)
    scene = base(solver, links + 2, 3, width=WIDTH, height=height, pins=tuple(range(6)), rotation=(-90.0, 0.0, 0.0))
    return with_bending(structural(scene, BENDING_CONSTANT), bending, gravity)


def rest_column(scene: Scene, seconds: float, start: Floats | None = None) -> Floats:
    """Return the positions of the middle column at rest [m], (rows, 3).

    `start`: its start positions along z and up [m], (rows, 2).
    """
    with Timed(scene) as simulation:
        if start is not None:
            positions = simulation.topology.start.reshape(-1, 3, 3).copy()
            positions[:, :, 2], positions[:, :, 1] = start[:, :1], start[:, 1:]
            simulation.set_state(positions.reshape(-1, 3))
        advance(simulation, seconds)
        column: Floats = simulation.positions().reshape(-1, 3, 3)[:, 1]
        return column


def doubling(solver: str) -> Iterator[Check]:
    """Measure the droop of a slightly bent strip with twice the weight: it doubles."""
    droops = [-float(rest_column(beam(solver, 8, 10.0, gravity), 10.0)[-1, 1]) for gravity in (1.0, 2.0)]
    yield relative("droop at twice the gravity over droop", 2.0, droops[1] / droops[0], *DROOP)


def doubling_by_springs(solver: str) -> Iterator[Check]:
    """Measure the droop of a slightly bent strip with twice the weight, for bend springs instead of bending links.

    Bend springs join a particle to the second-next one.
    """
    droops = []
    for gravity in (1.0, 2.0):
        scene = strip(solver, 8, constant=5e4, pins=tuple(range(6)))
        scene = with_bending(scene, 0.0, gravity)
        scene = replace(scene, cloth=replace(scene.cloth, rotation=(-90.0, 0.0, 0.0)))
        scene = replace(scene, fabric=replace(scene.fabric, bend_spring=5e4))
        droops.append(-float(rest_column(scene, 20.0)[-1, 1]))
    row = relative("droop at twice the gravity over droop", 2.0, droops[1] / droops[0], *DROOP)
    yield row.by_law(CUBIC, 1 - 2 ** (1 / 3) / 2)


def droop(solver: str) -> Iterator[Check]:
    """Compare the droop of strips of various stiffness with the elastica."""
    for gamma in GAMMAS:
        links = max(LINKS, round(LINKS_A_BEND * gamma ** (1 / 3)))
        yield from drooped(f"Γ = {gamma:g}", beam(solver, links, 0.2 * GRAVITY / gamma), cantilever(gamma))


def tip_load(solver: str) -> Iterator[Check]:
    """Compare a strip that carries ten times its weight at its tip with the elastica under both loads."""
    for load in LOADS:
        pull = 10 * LIGHT * GRAVITY  # [N] per meter of width
        scene = beam(solver, LINKS // 2, pull / load)
        cloth = replace(scene.cloth, area_density=LIGHT, corner_mass=pull * WIDTH / GRAVITY / 2)  # both corners
        yield from drooped(f"α = {load:g}", replace(scene, cloth=cloth), cantilever(load / 10, load))


def drooped(name: str, scene: Scene, exact: tuple[float, float]) -> Iterator[Check]:
    """Measure drop and reach of a beam at rest."""
    column = rest_column(scene, 10.0)
    first = float(column[1, 2] - column[0, 2]) / 2  # the half link at the clamp
    yield relative(f"{name}: drop over length", exact[0], -float(column[-1, 1] - column[1, 1]), *DROOP)
    yield relative(f"{name}: reach", exact[1], abs(float(column[-1, 2] - column[1, 2]) + first), *DROOP)


def buckling(solver: str) -> Iterator[Check]:
    """Measure a strip between two hinges that are closer than its length."""
    for compression in COMPRESSIONS:
        scene = with_bending(strip(solver, LINKS, constant=BENDING_CONSTANT, pins=("top", "bottom")), BENDING, 0.0)
        rise = float(rest_column(scene, 12.0, arch(1 - compression))[LINKS // 2, 1])
        yield relative(f"{100 * compression:g} % shorter: rise over length", buckled(compression), rise, *BUCKLED)


def arch(span: float) -> Floats:
    """Return a half sine wave of length 1 over `span`, divided into links of equal length, (links + 1, 2)."""
    fine = np.linspace(-0.5, 0.5, 1000)
    low, high = 0.0, 0.5
    while high - low > 1e-12:
        height = (low + high) / 2
        wave = np.stack([span * fine, height * np.cos(np.pi * fine)], axis=-1)
        along = np.append(0.0, np.linalg.norm(np.diff(wave, axis=0), axis=1).cumsum())
        low, high = (height, high) if along[-1] < 1 else (low, height)
    even = np.linspace(0.0, along[-1], LINKS + 1)
    return np.stack([np.interp(even, along, wave[:, c]) for c in (0, 1)], axis=-1)


def loop(solver: str) -> Iterator[Check]:
    """Measure a loop whose ends are clamped side by side, pointing up. It starts as a circle."""
    cell = 1 / (LINKS + 1)  # the outer halves of the first and the last link are inside the clamp
    particles = 3 * (LINKS + 3)
    pins = (*range(6), *range(particles - 6, particles))
    scene = base(solver, LINKS + 3, 3, width=WIDTH, height=1 + cell, pins=pins)
    scene = with_bending(structural(scene, BENDING_CONSTANT), BENDING, 0.0)
    turn = 2 * np.pi * cell * (np.arange(LINKS + 3) - 0.5)
    start = np.stack([np.sin(turn), 1 - np.cos(turn)], axis=-1) / (2 * np.pi)
    start[[0, 1, -2, -1]] = [[0.0, -cell / 2], [0.0, cell / 2], [0.0, cell / 2], [0.0, -cell / 2]]
    column = rest_column(scene, 12.0, start)
    yield relative("height over length", pear_loop(), float(column[LINKS // 2 + 1, 1]), *BUCKLED)
