"""A3.4 and A4: Euler's buckling strip, and strips that bend under their weight and other loads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import sqrt

import numpy as np

from ...kernels.conjugate_gradient import TOLERANCE
from ...scene.schema import Forces, Scene
from .check import (
    Check,
    Timed,
    advance,
    base,
    damped,
    order_lost,
    relative,
    rows_with_limit,
    run_with_limit,
    strip,
    structural,
)
from .exact import GRAVITY, Floats, buckled, cantilever, pear_loop

LINKS = 32
CUBIC = "springs to the particle after the next bend with the cube of the angle: 2^⅓"
LIGHTER = (
    f"conjugate gradients end at {100 * TOLERANCE:g} % of a step's first residual, at rest the weight: the drop with"
    f" {100 * TOLERANCE:g} % less of it"
)
DROOP = (5e-2, 1e-2)  # A4: 5 %, 1 %
DENSITY = 0.2  # [kg/m²] of `base`
DOUBLED = 0.1  # Γ from which the weight is doubled
BUCKLED = (2e-2, 5e-3)  # A3: 2 %, 0.5 %
GAMMAS = (0.1, 1.0, 3.0, 8.0, 10.0, 30.0, 100.0, 1000.0, 10000.0)
ORDER_GAMMA, ORDER_LINKS = 10.0, (8, 16, 32, 64)  # A4: second order
ORDER = (0.15, 0.05)  # that of a slope in A8
LINKS_A_BEND = 4.5  # in the bend at the clamp, Γ^(−1/3) of the length: fewer do not resolve the elastica
LOADS = (0.25, 1.0, 2.0, 5.0, 10.0)  # α = PL²/EI at the tip
LIGHT = 0.02  # [kg/m²] of a strip that carries ten times its own weight
WIDTH = 0.1  # [m] of all strips
COMPRESSIONS = (0.01, 0.05, 0.1, 0.2, 0.3, 0.5)
CLAMPED_LEVEL = 0.2  # [m] of a clamped strip at each end, at its start
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
    """Measure the droop of a slightly bent strip with twice the weight: it nearly doubles."""
    bending = DENSITY / DOUBLED  # [N·m] with a gravity of 1 m/s² the parameter Γ is `DOUBLED`
    droops = [-float(rest_column(beam(solver, 8, bending, gravity), 10.0)[-1, 1]) for gravity in (1.0, 2.0)]
    exact = cantilever(2 * DOUBLED)[0] / cantilever(DOUBLED)[0]
    yield relative("droop at twice the gravity over droop", exact, droops[1] / droops[0], *DROOP)


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
        yield from drooped(f"Γ = {gamma:g}", beam(solver, links, DENSITY * GRAVITY / gamma), cantilever(gamma))
    what = (
        f"order of the drop at Γ = {ORDER_GAMMA:g} in the length of a link, {ORDER_LINKS[0]} to {ORDER_LINKS[-1]} links"
    )
    yield run_with_limit(what, *ORDER, partial(order_of_drop, what, solver))


def order_of_drop(what: str, solver: str) -> Check:
    """Measure the order of convergence of a strip of more and more links, from the changes of its drop."""
    scenes = [beam(solver, links, DENSITY * GRAVITY / ORDER_GAMMA) for links in ORDER_LINKS]
    drops = [float(column[1, 1] - column[-1, 1]) for column in (rest_column(scene, 10.0) for scene in scenes)]
    changes = np.abs(np.diff(drops))
    orders = np.log2(changes[:-1] / changes[1:])
    worst = float(orders[np.abs(orders - 2).argmax()])
    row = Check(what, 2.0, worst, abs(worst - 2), *ORDER)
    if solver != "implicit":
        return row
    lighter = cantilever(ORDER_GAMMA)[0] - cantilever((1 - TOLERANCE) * ORDER_GAMMA)[0]
    return row.by_law(LIGHTER, order_lost(2.0, float(changes[-2]), lighter))


def tip_load(solver: str) -> Iterator[Check]:
    """Compare a strip that carries ten times its weight at its tip with the elastica under both loads."""
    for load in LOADS:
        pull = 10 * LIGHT * GRAVITY  # [N] per meter of width
        scene = beam(solver, LINKS // 2, pull / load)
        cloth = replace(scene.cloth, area_density=LIGHT, corner_mass=pull * WIDTH / GRAVITY / 2)  # both corners
        yield from drooped(f"α = {load:g}", replace(scene, cloth=cloth), cantilever(load / 10, load))


def drooped(name: str, scene: Scene, exact: tuple[float, float]) -> Iterator[Check]:
    """Measure drop and reach of a beam at rest."""
    whats = [f"{name}: drop over length", f"{name}: reach"]

    def measured() -> Iterator[Check]:
        column = rest_column(scene, 10.0)
        first = float(column[1, 2] - column[0, 2]) / 2  # the half link at the clamp
        yield relative(whats[0], exact[0], -float(column[-1, 1] - column[1, 1]), *DROOP)
        yield relative(whats[1], exact[1], abs(float(column[-1, 2] - column[1, 2]) + first), *DROOP)

    yield from rows_with_limit(whats, *DROOP, measured)


def buckling(solver: str) -> Iterator[Check]:
    """Measure a strip between two hinges that are closer than its length, and between two level clamps.

    A clamped strip consists of four quarters of hinged ones of half its length, and rises as high as a hinged one.
    Strips start as a V, whose rise differs by 11 to 21 % from the solution. One without bending stiffness stays a V.
    """
    for compression in COMPRESSIONS:
        scene = with_bending(strip(solver, LINKS, constant=BENDING_CONSTANT, pins=("top", "bottom")), BENDING, 0.0)
        start = tent(1 - compression, np.linspace(0.0, 1.0, LINKS + 1))
        rise = float(rest_column(scene, 12.0, start)[LINKS // 2, 1])
        yield relative(f"{100 * compression:g} % shorter: rise over length", buckled(compression), rise, *BUCKLED)
    for compression in COMPRESSIONS:
        scene, along = between_clamps(solver)
        # Without diagonals a compressed strip moves sideways between its clamps, which needs less energy.
        scene = replace(scene, fabric=replace(scene.fabric, shear=BENDING_CONSTANT))
        start = tent(1 - compression, along, CLAMPED_LEVEL)
        ends = [0, 1, -2, -1]
        start[ends, 0] = along[ends] - 0.5 - compression * np.array([-0.5, -0.5, 0.5, 0.5])
        start[ends, 1] = 0.0
        rise = float(rest_column(scene, 12.0, start)[LINKS // 2 + 1, 1])
        what = f"{100 * compression:g} % shorter, clamped: rise over length"
        yield relative(what, buckled(compression), rise, *BUCKLED)


def between_clamps(solver: str) -> tuple[Scene, Floats]:
    """Return a strip of one meter whose ends are clamped, and the distances of its rows from the first clamp [m].

    The outer halves of the first and the last link are inside the clamps.
    """
    cell = 1 / (LINKS + 1)
    particles = 3 * (LINKS + 3)
    pins = (*range(6), *range(particles - 6, particles))
    scene = base(solver, LINKS + 3, 3, width=WIDTH, height=1 + cell, pins=pins)
    distances = cell * (np.arange(LINKS + 3, dtype=np.float64) - 0.5)
    return with_bending(structural(scene, BENDING_CONSTANT), BENDING, 0.0), distances


def tent(span: float, distances: Floats, level: float = 0.0) -> Floats:
    """Return points of an inverted V of length 1 over `span` [m], at distances along it, (rows, 2).

    A piece of length `level` [m] at each of its ends is level.
    """
    side = 0.5 - level  # [m] length of each side of the V
    width = span / 2 - level  # [m] its extent
    from_middle = distances - 0.5
    on_side = np.minimum(np.abs(from_middle), side)
    along = np.sign(from_middle) * (on_side * width / side + np.maximum(np.abs(from_middle) - side, 0.0))
    return np.stack([along, (1 - on_side / side) * sqrt(side**2 - width**2)], axis=-1)


def loop(solver: str) -> Iterator[Check]:
    """Measure a loop whose ends are clamped side by side, pointing up. It starts as a circle."""
    scene, along = between_clamps(solver)
    cell, turn = along[1] - along[0], 2 * np.pi * along
    start = np.stack([np.sin(turn), 1 - np.cos(turn)], axis=-1) / (2 * np.pi)
    start[[0, 1, -2, -1]] = [[0.0, -cell / 2], [0.0, cell / 2], [0.0, cell / 2], [0.0, -cell / 2]]
    column = rest_column(scene, 12.0, start)
    yield relative("height over length", pear_loop(), float(column[LINKS // 2 + 1, 1]), *BUCKLED)
