"""A3, A5 and B3: hanging, stretching and sagging."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..scene.model import Fabric, Solver, Springs
from ..simulation import Simulation
from .exact import GRAVITY, hammock_sag, hanging_drop, relaxed_chain, sheet_modulus
from .row import Row, relative
from .setups import SETTLING, advance, base, damped, strip, strip_constant, structural, substep

CELLS = (16, 32)
SPANS = (0.4, 0.8, 0.95)
HAMMOCK_LINKS = 16
HAMMOCK_CONSTANT = 1000.0  # [N/m] of a spring
LAW_LINKS = 32
SPLIT_FRAMES = 240
ITERATIONS = (20, 40, 80)


def elongation(solver: str) -> Iterator[Row]:
    """A sheet pinned along its top is longer by the weight that each spring carries."""
    for cells in CELLS:
        scene = structural(base(solver, cells + 1, cells + 1, lumping="equal", pins=("top",)), 1000.0)
        with Simulation(damped(scene)) as simulation:
            mass = float(simulation.topology.mass[0])
            advance(simulation, 10.0)
            longer = float((simulation.topology.start - simulation.positions())[-(cells // 2), 1])
            exact = hanging_drop(cells, mass, 1000.0)
            yield relative(f"{cells} rows below the pins: longer by [m]", exact, longer, 2e-2, 1e-3)


def independence(solver: str) -> Iterator[Row]:
    """The same length at every number of iterations: multipliers must be kept over those of a substep (B3)."""
    scene = structural(base(solver, 17, 17, lumping="equal", pins=("top",)), 100.0)
    with Simulation(scene) as simulation:
        exact = hanging_drop(16, float(simulation.topology.mass[0]), 100.0)
    for iterations in ITERATIONS:
        settled = Solver(name=solver, substeps=5, iterations=iterations, damping=SETTLING)
        with Simulation(replace(scene, solver=settled)) as simulation:
            advance(simulation, 10.0)
            longer = float((simulation.topology.start - simulation.positions())[-8, 1])
            yield relative(f"100 N/m, 5×{iterations}: longer by [m]", exact, longer, 1e-2, 1e-3)


def split(solver: str) -> Iterator[Row]:
    """480 sweeps a second as substeps or as iterations, on 32 links of a metre: as the method in float64 (B4)."""
    for constant in (1e8, 1e3):  # [N/m] of a link
        for substeps, iterations in ((8, 1), (4, 2), (2, 4), (1, 8)):
            # Columns are half a metre apart: a spring down one has half the constant of the sheet's metre.
            scene = strip(solver, LAW_LINKS, constant=2 * constant)
            cloth = replace(scene.cloth, height=float(LAW_LINKS), width=1.0, area_density=2.0)  # 1 kg a particle
            scene = replace(scene, cloth=cloth, solver=Solver(solver, substeps, iterations, damping=0.0))
            lengths = []
            with Simulation(scene) as simulation:
                for _ in range(SPLIT_FRAMES):
                    simulation.advance_frame()
                    lengths.append(-float(simulation.positions()[-2, 1] - simulation.topology.start[1, 1]))
            measured = float(np.mean(lengths[SPLIT_FRAMES // 2 :])) / LAW_LINKS
            exact = relaxed_chain(LAW_LINKS, substeps, iterations, 1 / constant, SPLIT_FRAMES / 60)
            yield relative(f"{constant:g} N/m, {substeps}×{iterations}: length over rest", exact, measured, 1e-2, 1e-3)


def stretch(solver: str) -> Iterator[Row]:
    """Relaxation to a length leaves ½·N²·g·h²/iterations of stretch, whatever the fabric: the law it is judged by."""
    scene = strip(solver, LAW_LINKS, constant=1e9)
    with Simulation(damped(replace(scene, springs=Springs(shear=0.0, bend=0.0)))) as simulation:
        advance(simulation, 10.0)
        h = substep(simulation)
        stretch = float((simulation.topology.start - simulation.positions())[-2, 1])
        unit = LAW_LINKS**2 * GRAVITY * h * h / scene.solver.iterations
        yield relative("stretch over N²·g·h²/iterations", 0.5, stretch / unit, 0.05, 0.01)


def hammock(solver: str) -> Iterator[Row]:
    """A strip held at two edges that are nearer than it is long."""
    for span in SPANS:
        exact, sag = sags(solver, span, HAMMOCK_LINKS)
        yield relative(f"sag at a span of {span:g} m [m]", exact, sag, 1e-2, 1e-3)


def finer_hammock(solver: str) -> Iterator[Row]:
    """The same strip in twice as many links hangs as low."""
    coarse, fine = (sags(solver, 0.8, links)[1] for links in (32, 64))
    yield relative("sag with 64 links, against 32 [m]", coarse, fine, 1e-2, 1e-3)


def sags(solver: str, span: float, links: int) -> tuple[float, float]:
    """Exact and measured sag [m]. The strip begins as a V."""
    scene = strip(solver, links, constant=HAMMOCK_CONSTANT, pins=("top", "bottom"))
    with Simulation(damped(scene)) as simulation:
        topology = simulation.topology
        mass = float(topology.mass.reshape(-1, 3)[1].sum())
        along = np.linspace(-0.5, 0.5, links + 1)
        start = topology.start.reshape(links + 1, 3, 3).copy()
        start[:, :, 2] = (span * along)[:, None]
        start[:, :, 1] = (np.sqrt(1 - span**2) * (np.abs(along) - 0.5))[:, None]
        simulation.place(start.reshape(-1, 3))
        advance(simulation, 12.0)
        exact = hammock_sag(span, links, 1.0, mass, strip_constant(simulation))
        return exact, -float(simulation.positions()[:, 1].min())


def modulus(solver: str) -> Iterator[Row]:
    """A tall sheet hangs by its top; its middle third, away from the pins, stretches by the weight below it."""
    for shear in (500.0, 1000.0, 100.0):
        scene = base(solver, 33, 9, width=0.25, pins=("top",))
        fabric = Fabric(warp=1000.0, weft=1000.0, shear=shear, bend=0.0)
        with Simulation(damped(replace(scene, fabric=fabric))) as simulation:
            advance(simulation, 8.0)
            rows = slice(11, 22)
            carried = simulation.topology.mass.reshape(33, 9).sum(axis=1)[::-1].cumsum()[::-1]  # by the row above [kg]
            y = simulation.positions().reshape(33, 9, 3)[:, 4, 1]
            strain = -np.diff(y) / (1.0 / 32) - 1
            stress = carried[1:] * GRAVITY / 0.25
            measured = float((stress[rows] / strain[rows]).mean())
            exact = sheet_modulus(1000.0, shear)
            yield relative(f"force per strain and width, diagonals of {shear:g} N/m [N/m]", exact, measured, 2e-2, 2e-3)
