"""A3 and B3: hanging, stretching and sagging."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..measure.convergence import artificial_stretch, unfinished_share
from ..scene.model import FRAME_SECONDS, USUAL, Forces, Scene, Solver, Springs
from .exact import GRAVITY, hanging_drop, relaxed_chain
from .exact import hammock as exact_hammock
from .laws import SOFTER, softened
from .row import Row, in_time, relative
from .setups import SETTLING, Timed, advance, base, bottom_middle, damped, strip, strip_constant, structural, substep

ELONGATION = (2e-2, 1e-3)  # A3: 2 %, 0.1 % of the elongation
CELLS = (16, 32, 64, 128)
CONSTANT = 1000.0  # [N/m] of the base cloth
SPANS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99)
SAG = (1e-2, 1e-3)  # A3: 1 %, 0.1 % of the discrete value
FINER_SPAN = TENSION_SPAN = 0.8
HAMMOCK_LINKS = 16
HAMMOCK_CONSTANT = 1000.0  # [N/m] of a spring
LAW_LINKS = 32
WITH_DIAGONALS = 0.338  # of a sheet of 33 × 33 particles, beside ½ without: 0.343 and 0.342 with 9 and 17, ⅓ with many
LAW = (0.05, 0.01)
INDEPENDENT = (1e-2, 1e-3)  # B3: within 1 % across iterations and h
INDEPENDENT_CELLS = 64
INDEPENDENT_SUBSTEPS, INDEPENDENT_ITERATIONS = (1, 10), (20, 40, 80, 160)
SPLIT_SECONDS = 4.0
SPLITS = ((400.0, 1), (100.0, 4), (25.0, 16), (12.5, 32))  # B4: steps a second, iterations: 400 sweeps a second
SPLIT = (1e-2, 1e-3)
UNFINISHED = "iterations end before a substep is solved: κ·(1 − ρ)·ρ^(i−1)/(1 − ρ^i), κ = kh²/m, ρ = 1/(1 + m/(2kh²))²"


def sheet(solver: str, cells: int) -> Scene:
    """The base cloth, pinned along its top, threads only and equal masses."""
    return damped(structural(base(solver, cells + 1, cells + 1, lumping="equal", pins=("top",)), CONSTANT))


def elongation(solver: str) -> Iterator[Row]:
    """A sheet pinned along its top is longer by the weight that each spring carries."""
    for cells in CELLS:
        what = f"{cells} rows below the pins: longer by [m]"
        yield in_time(what, *ELONGATION, partial(longer, what, sheet(solver, cells), cells, ELONGATION))


def independence(solver: str) -> Iterator[Row]:
    """The same length at every number of iterations and substeps: multipliers are kept over the sweeps of a substep."""
    for substeps in INDEPENDENT_SUBSTEPS:
        for iterations in INDEPENDENT_ITERATIONS:
            setting = Solver(name=solver, substeps=substeps, iterations=iterations, damping=SETTLING)
            scene = replace(sheet(solver, INDEPENDENT_CELLS), solver=setting)
            what = f"{INDEPENDENT_CELLS} rows, {substeps}×{iterations}: longer by [m]"
            run = partial(longer, what, scene, INDEPENDENT_CELLS, INDEPENDENT)
            yield in_time(what, *INDEPENDENT, run)


def longer(what: str, scene: Scene, cells: int, bounds: tuple[float, float]) -> Row:
    """How much longer a sheet hangs than it is; `xpbd` within the law of iterations that end too early."""
    with Timed(scene) as simulation:
        mass = float(simulation.topology.mass[0])
        advance(simulation, 10.0)
        measured = float(bottom_middle(simulation.topology.start - simulation.positions())[1])
        row = relative(what, hanging_drop(cells, mass, CONSTANT), measured, *bounds)
        if scene.solver.name != "xpbd":
            return row
        share = unfinished_share(CONSTANT, mass, substep(simulation), scene.solver.iterations)
        return row.by_law(UNFINISHED, share)


def split(solver: str) -> Iterator[Row]:
    """400 sweeps a second as steps or as iterations, on 32 links of a metre: as the method in float64 (B4).

    A frame has a whole number of substeps, so time runs faster: with h/f for h, gravity and stiffness are f² of theirs,
    and every place is the same.
    """
    for constant in (1e7, 1e3):  # [N/m] of a link
        for rate, iterations in SPLITS:
            substeps = max(1, round(rate * FRAME_SECONDS))
            faster = substeps / FRAME_SECONDS / rate
            # Columns are half a metre apart: a spring down one has half the constant of the sheet's metre.
            scene = strip(solver, LAW_LINKS, constant=2 * constant * faster**2)
            cloth = replace(scene.cloth, height=float(LAW_LINKS), width=1.0, area_density=2.0)  # 1 kg a particle
            setting = Solver(solver, substeps, iterations, damping=0.0)
            scene = replace(scene, cloth=cloth, solver=setting, forces=Forces(gravity=GRAVITY * faster**2))
            frames = round(SPLIT_SECONDS / faster / FRAME_SECONDS)
            lengths = []
            with Timed(scene) as simulation:
                for _ in range(frames):
                    simulation.advance_frame()
                    lengths.append(-float(simulation.positions()[-2, 1] - simulation.topology.start[1, 1]))
            measured = float(np.mean(lengths[frames // 2 :])) / LAW_LINKS
            each = relaxed_chain(LAW_LINKS, rate, iterations, 1 / constant, SPLIT_SECONDS)[substeps - 1 :: substeps]
            exact = float(np.mean(each[frames // 2 : frames]))
            what = f"{constant:g} N/m, {rate:g} steps/s × {iterations}: length over rest"
            yield relative(what, exact, measured, *SPLIT)


def stretch(solver: str) -> Iterator[Row]:
    """Relaxation to a length leaves c·N²·g·h²/iterations, whatever the fabric: c is ½, with diagonals about ⅓.

    It is a law of sweeps from spring to spring. `lines` solves a whole thread at once and `projective` all springs, so
    what they leave does not grow with N²·g·h²/iterations, and there is no c of theirs; A3.1 and B3 measure them.
    """
    bare = strip(solver, LAW_LINKS, constant=1e9)
    square = base(solver, LAW_LINKS + 1, LAW_LINKS + 1, lumping="equal", pins=("top",))
    rigid = replace(square.fabric, warp=1e9, weft=1e9, shear=1e9, bend=0.0)
    for name, scene, coefficient in (
        ("threads", replace(bare, springs=Springs(shear=0.0, bend=0.0)), 0.5),
        ("threads and diagonals", replace(square, springs=Springs(bend=0.0), fabric=rigid), WITH_DIAGONALS),
    ):
        with Timed(damped(scene)) as simulation:
            advance(simulation, 10.0)
            columns = simulation.scene.cloth.columns
            measured = float((simulation.topology.start - simulation.positions())[-(columns // 2) - 1, 1])
            unit = 2 * artificial_stretch(LAW_LINKS, substep(simulation), scene.solver.iterations)
            yield relative(f"stretch over N²·g·h²/iterations, {name}", coefficient, measured / unit, *LAW)


def hammock(solver: str) -> Iterator[Row]:
    """A strip held at two edges that are nearer than it is long."""
    for span in SPANS:
        exact, measured = hung(solver, span, HAMMOCK_LINKS)
        yield relative(f"sag at a span of {span:g} m [m]", exact.sag, measured.sag, *SAG)
        if span == TENSION_SPAN:
            what = f"tension of the last links over the weight at {span:g} m"
            yield relative(what, exact.tension, measured.tension, *SAG)


def finer_hammock(solver: str) -> Iterator[Row]:
    """The same strip in twice as many links hangs as low."""
    for coarse, fine in ((32, 64), (64, 128)):
        what = f"sag with {fine} links, against {coarse} [m]"
        yield in_time(what, *SAG, partial(against, what, solver, coarse, fine))


def against(what: str, solver: str, coarse: int, fine: int) -> Row:
    first, second = (hung(solver, FINER_SPAN, links)[1].sag for links in (coarse, fine))
    row = relative(what, first, second, *SAG)
    return row.by_law(SOFTER, partial(softer_sags, coarse, fine)) if solver == "verlet" else row


def softer_sags(coarse: int, fine: int) -> float:
    """The share by which the finer strip of `verlet` sags lower, in equilibrium, as soft as sweeps leave its links."""
    substeps, sweeps = USUAL["verlet"]
    first, second = (
        exact_hammock(FINER_SPAN, links, 1.0, 1.0, softened("verlet", 0.0, 1.0, FRAME_SECONDS / substeps, sweeps))[0]
        for links in (coarse, fine)
    )
    return abs(second / first - 1)


class Hung(NamedTuple):
    sag: float  # [m]
    tension: float  # of a last link, over the weight of all


def hung(solver: str, span: float, links: int) -> tuple[Hung, Hung]:
    """Exact and measured. The strip begins as a V.

    Masses are equal, not lumped by area: both ends are pinned, and the rows between them are equally heavy either way.
    All of them are a share of (N − 1)/(N + 1) of the weight, of which a strip that hardly stretches has the same sag.
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
        simulation.place(start.reshape(-1, 3))
        advance(simulation, 12.0)
        sag, tension = exact_hammock(span, links, 1.0, mass, constant)
        x = simulation.positions()
        long = np.linalg.norm(np.diff(x.reshape(links + 1, 3, 3), axis=0)[[0, -1]], axis=2)
        pulled = constant * (float(long.mean()) - 1.0 / links)
        return Hung(sag, tension / weight), Hung(-float(x[:, 1].min()), pulled / weight)
