"""A4, and Euler's strip of A3: bending."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..scene.model import Forces, Scene
from .exact import GRAVITY, Floats, buckled, cantilever, pear_loop
from .row import Row, relative
from .setups import Timed, advance, base, damped, strip, structural

LINKS = 32
CUBIC = "springs to the particle after the next bend with the cube of the angle: 2^⅓"
DROOP = (5e-2, 1e-2)  # A4: 5 %, 1 %
BUCKLED = (2e-2, 5e-3)  # A3: 2 %, 0.5 %
GAMMAS = (0.1, 1.0, 3.0, 8.0, 10.0, 30.0, 100.0, 1000.0, 10000.0)
LINKS_A_BEND = 4.5  # in the bend beside the clamp, which is Γ^(−1/3) of the length: fewer are no elastica any more
LOADS = (0.25, 1.0, 2.0, 5.0, 10.0)  # α = PL²/EI at the tip
LIGHT = 0.02  # [kg/m²] of a strip that carries ten times its own weight
WIDTH = 0.1  # [m] of all strips
COMPRESSIONS = (0.01, 0.05, 0.1, 0.2, 0.3, 0.5)
BENDING = 0.02  # [N·m] of strips without weight, whose shape does not depend on it
CONSTANT = 5000.0  # [N/m] of springs: a strip one metre long stretches by 0.02 %


def limp(scene: Scene, bending: float, gravity: float = GRAVITY) -> Scene:
    """The scene with a bending stiffness [N·m], damped so that it comes to rest."""
    fabric = replace(scene.fabric, bending=bending)
    return damped(replace(scene, fabric=fabric, forces=Forces(gravity=gravity)))


def beam(solver: str, links: int, bending: float, gravity: float = GRAVITY) -> Scene:
    """A strip one metre long, clamped level by its first two rows.

    Between them it cannot turn, so half a link less than a whole one belongs to its length.
    """
    height = (links + 1) / (links + 0.5)
    scene = base(solver, links + 2, 3, width=WIDTH, height=height, pins=tuple(range(6)), rotation=(-90.0, 0.0, 0.0))
    return limp(structural(scene, CONSTANT), bending, gravity)


def settled(scene: Scene, seconds: float, start: Floats | None = None) -> Floats:
    """Places of the middle column at rest, (rows, 3) [m]. `start`: of the middle column, (rows, 2) along z and up."""
    with Timed(scene) as simulation:
        if start is not None:
            places = simulation.topology.start.reshape(-1, 3, 3).copy()
            places[:, :, 2], places[:, :, 1] = start[:, :1], start[:, 1:]
            simulation.place(places.reshape(-1, 3))
        advance(simulation, seconds)
        column: Floats = simulation.positions().reshape(-1, 3, 3)[:, 1]
        return column


def doubling(solver: str) -> Iterator[Row]:
    """Twice the weight, twice the droop of a strip that is bent a little."""
    droops = [-float(settled(beam(solver, 8, 10.0, gravity), 10.0)[-1, 1]) for gravity in (1.0, 2.0)]
    yield relative("droop at twice the gravity over droop", 2.0, droops[1] / droops[0], *DROOP)


def doubling_by_springs(solver: str) -> Iterator[Row]:
    """The same with springs to the particle after the next instead of bonds."""
    droops = []
    for gravity in (1.0, 2.0):
        scene = strip(solver, 8, constant=5e4, pins=tuple(range(6)))
        scene = limp(scene, 0.0, gravity)
        scene = replace(scene, cloth=replace(scene.cloth, rotation=(-90.0, 0.0, 0.0)))
        scene = replace(scene, fabric=replace(scene.fabric, bend=5e4))
        droops.append(-float(settled(scene, 20.0)[-1, 1]))
    row = relative("droop at twice the gravity over droop", 2.0, droops[1] / droops[0], *DROOP)
    yield row.by_law(CUBIC, 1 - 2 ** (1 / 3) / 2)


def droop(solver: str) -> Iterator[Row]:
    """A strip of any stiffness droops as the elastica."""
    for gamma in GAMMAS:
        links = max(LINKS, round(LINKS_A_BEND * gamma ** (1 / 3)))
        yield from drooped(f"Γ = {gamma:g}", beam(solver, links, 0.2 * GRAVITY / gamma), cantilever(gamma))


def tip_load(solver: str) -> Iterator[Row]:
    """A strip that carries ten times its own weight at its tip droops as the elastica under both."""
    for load in LOADS:
        pull = 10 * LIGHT * GRAVITY  # [N] a metre of width
        scene = beam(solver, LINKS // 2, pull / load)
        cloth = replace(scene.cloth, area_density=LIGHT, weight=pull * WIDTH / GRAVITY / 2)  # both corners
        yield from drooped(f"α = {load:g}", replace(scene, cloth=cloth), cantilever(load / 10, load))


def drooped(name: str, scene: Scene, exact: tuple[float, float]) -> Iterator[Row]:
    """Drop and reach of a beam at rest."""
    column = settled(scene, 10.0)
    first = float(column[1, 2] - column[0, 2]) / 2  # the half link that is clamped
    yield relative(f"{name}: drop over length", exact[0], -float(column[-1, 1] - column[1, 1]), *DROOP)
    yield relative(f"{name}: reach", exact[1], abs(float(column[-1, 2] - column[1, 2]) + first), *DROOP)


def buckling(solver: str) -> Iterator[Row]:
    """A strip between two hinges that are nearer than it is long."""
    for compression in COMPRESSIONS:
        scene = limp(strip(solver, LINKS, constant=CONSTANT, pins=("top", "bottom")), BENDING, 0.0)
        rise = float(settled(scene, 12.0, arch(1 - compression))[LINKS // 2, 1])
        yield relative(f"{100 * compression:g} % shorter: rise over length", buckled(compression), rise, *BUCKLED)


def arch(span: float) -> Floats:
    """A half wave of a sine of length 1 over `span`, cut into links of one length, (links + 1, 2)."""
    fine = np.linspace(-0.5, 0.5, 1000)
    low, high = 0.0, 0.5
    while high - low > 1e-12:
        height = (low + high) / 2
        wave = np.stack([span * fine, height * np.cos(np.pi * fine)], axis=-1)
        along = np.append(0.0, np.linalg.norm(np.diff(wave, axis=0), axis=1).cumsum())
        low, high = (height, high) if along[-1] < 1 else (low, height)
    even = np.linspace(0.0, along[-1], LINKS + 1)
    return np.stack([np.interp(even, along, wave[:, c]) for c in (0, 1)], axis=-1)


def loop(solver: str) -> Iterator[Row]:
    """A loop whose ends leave their clamp side by side, upwards. It begins as a circle."""
    cell = 1 / (LINKS + 1)  # the outer half of the first and of the last link are behind the clamp
    particles = 3 * (LINKS + 3)
    pins = (*range(6), *range(particles - 6, particles))
    scene = base(solver, LINKS + 3, 3, width=WIDTH, height=1 + cell, pins=pins)
    scene = limp(structural(scene, CONSTANT), BENDING, 0.0)
    turn = 2 * np.pi * cell * (np.arange(LINKS + 3) - 0.5)
    start = np.stack([np.sin(turn), 1 - np.cos(turn)], axis=-1) / (2 * np.pi)
    start[[0, 1, -2, -1]] = [[0.0, -cell / 2], [0.0, cell / 2], [0.0, cell / 2], [0.0, -cell / 2]]
    column = settled(scene, 12.0, start)
    yield relative("height over length", pear_loop(), float(column[LINKS // 2 + 1, 1]), *BUCKLED)
