"""A2.5, A3.4, A4 and A5: taut squares, Euler's buckling strip, strips that bend, and the stiffness of a grid."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import sqrt
from pathlib import Path

import numpy as np

from ...kernels.conjugate_gradient import TOLERANCE
from ...scene.fabric_schema import Fabric
from ...scene.schema import FRAME_SECONDS, Forces, Maps, Scene
from .check import (
    SAME_ITERATIONS,
    SOFTER,
    Check,
    Timed,
    advance,
    base,
    damped,
    default_solver,
    effective_stiffness,
    frequency,
    order_lost,
    relative,
    rows_with_limit,
    run_with_limit,
    strip,
    structural,
    substep,
    swing_frames,
    unconverged_sag,
)
from .exact import GRAVITY, Floats, bias_modulus, buckled, cantilever, drum_modes, drum_sag, pear_loop, sheet_modulus
from .float64_steps import lines_after, sag_noise

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
    """Return the positions of the middle column at rest [m], (rows, 3), from `start` along z and up [m], (rows, 2)."""
    with Timed(scene) as simulation:
        if start is not None:
            positions = simulation.topology.start.reshape(-1, 3, 3).copy()
            positions[:, :, 2], positions[:, :, 1] = start[:, :1], start[:, 1:]
            simulation.set_state(positions.reshape(-1, 3))
        advance(simulation, seconds)
        return np.array(simulation.positions().reshape(-1, 3, 3)[:, 1])


def doubling(solver: str) -> Iterator[Check]:
    """Measure the droop of a slightly bent strip with twice the weight: it nearly doubles."""
    bending = DENSITY / DOUBLED  # [N·m] with a gravity of 1 m/s² the parameter Γ is `DOUBLED`
    droops = [-float(rest_column(beam(solver, 8, bending, gravity), 10.0)[-1, 1]) for gravity in (1.0, 2.0)]
    exact = cantilever(2 * DOUBLED)[0] / cantilever(DOUBLED)[0]
    yield relative("droop at twice the gravity over droop", exact, droops[1] / droops[0], *DROOP)


def doubling_by_springs(solver: str) -> Iterator[Check]:
    """Measure the same with bend springs, which join a particle to the second-next one, instead of bending links."""
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
    range_of_links = f"{ORDER_LINKS[0]} to {ORDER_LINKS[-1]} links"
    what = f"order of the drop at Γ = {ORDER_GAMMA:g} in the length of a link, {range_of_links}"
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


SAG_CELLS, MODE_CELLS = (16, 32, 64, 128), (16, 32, 64)
TAUT = (1e-2, 1e-3)  # A2: 1 %, 0.1 %
FLUTTER = f"waves pass more cells in a step than is stable: the sheet flutters, 3σ of it in {SAME_ITERATIONS}"
TOO_EARLY = f"iterations end too early: {SAME_ITERATIONS} are as soft"
SLACK = 0.9  # [m] side of the drum's sheet before it is stretched to 1 m
CONSTANT = 1000.0  # [N/m] of its springs; a tenth of it for its modes, which 60 samples per second must resolve
MODES = ((1, 1), (1, 2), (2, 2))
MODULUS = (2e-2, 2e-3)  # A5: 2 % at 0.1 % strain, 0.2 %
DIAGONALS = (500.0, 1000.0, 100.0)  # [N/m]
THREADS = 1000.0  # [N/m]
BIAS_CELLS = 64
BIAS_COLUMNS = (6, 14)  # of particles on each side of the middle of a strip that is cut at 45°
BIAS_TOP, BIAS_SEEN = 0.45, (-0.2, 0.1)  # [m] above the middle: pinned from there; range of the measured strain
PANEL_ROWS, PANEL_CELLS, PANEL_WIDTH = 97, 16, 0.5  # six times as tall as wide: its free edges are far away
PANEL_STRAIN = 1e-3  # A5: shear of 0.1 %, at the pinned edges


def drum(solver: str) -> Iterator[Check]:
    """Measure the sag and the modes of a square sheet that is stretched and pinned at all edges."""
    for cells in SAG_CELLS:
        what = f"sag of a taut square of {cells} cells under its weight [m]"
        yield run_with_limit(what, *TAUT, partial(sagging, what, solver, cells))
    for cells in MODE_CELLS:
        for mode in MODES:
            what = f"mode {mode[0]}, {mode[1]} of a taut square of {cells} cells [rad/s]"
            yield run_with_limit(what, *TAUT, partial(swinging, what, solver, cells, mode))


def drum_scene(solver: str, cells: int, constant: float) -> Scene:
    """Return the scene of the drum, before it is stretched to 1 m."""
    keys = {"mass_lumping": "uniform", "pins": ("top", "bottom", "left", "right"), "rotation": (-90.0, 0.0, 0.0)}
    return structural(base(solver, cells + 1, cells + 1, **keys, width=SLACK, height=SLACK), constant)


def tension(cells: int, constant: float) -> float:
    """Return the tension of each spring of the drum [N]."""
    return constant * (1.0 - SLACK) / cells


def sagging(what: str, solver: str, cells: int) -> Check:
    """Measure the sag of the middle of the drum under its weight: the worst of a second."""
    middle = (cells // 2) * (cells + 2)
    with Timed(damped(drum_scene(solver, cells, CONSTANT))) as simulation:
        mass, pull = float(simulation.topology.mass[0]), tension(cells, CONSTANT)
        simulation.set_state(simulation.topology.start / SLACK)
        advance(simulation, 6.0)
        exact = measured = drum_sag(cells, pull, mass)
        for _ in range(60):
            simulation.step()
            measured = max(measured, -float(simulation.positions()[middle, 1]), key=lambda sag: abs(sag - exact))
        row = relative(what, exact, measured, *TAUT)
        if solver == "lines":
            simulation.set_state(simulation.topology.start / SLACK)
            return row.by_law(FLUTTER, lambda: 3 * sag_noise(simulation, middle, exact))
        if solver != "xpbd":
            return row
        h, iterations = substep(simulation), simulation.scene.solver.iterations
        return row.by_law(SOFTER, partial(unconverged_sag, cells, pull, CONSTANT, mass, h, iterations))


def swinging(what: str, solver: str, cells: int, mode: tuple[int, int]) -> Check:
    """Measure the frequency of one mode of the drum, without gravity."""
    scene = replace(drum_scene(solver, cells, CONSTANT / 10), forces=Forces(gravity=0.0))
    with Timed(scene) as simulation:
        mass = float(simulation.topology.mass[0])
        omega = drum_modes(cells, tension(cells, CONSTANT / 10), mass, *mode)
        along, across = (np.sin(n * np.pi * np.arange(cells + 1) / cells) for n in mode)
        shape = np.outer(along, across).ravel()
        start = simulation.topology.start / SLACK
        start[:, 1] += 1e-3 * shape
        simulation.set_state(start)
        amplitudes = []
        for _ in range(swing_frames(omega)):
            amplitudes.append(float(simulation.positions()[:, 1] @ shape))
            simulation.step()
        return relative(what, omega, frequency(amplitudes, omega), *TAUT)


def modulus(solver: str) -> Iterator[Check]:
    """Measure the force per strain and width of a sheet, along the threads and at 45° to them."""
    for where, pull in (("along the warp", warp_pull), ("on the bias", bias_pull)):
        for shear in DIAGONALS:
            what = f"{where}, diagonals of {shear:g} N/m [N/m]"
            yield run_with_limit(what, *MODULUS, partial(pull, what, solver, shear))


def fabric_with_shear(shear: float) -> Fabric:
    """Return a fabric with diagonals of a stiffness [N/m]."""
    return Fabric(warp=THREADS, weft=THREADS, shear=shear, bend_spring=0.0)


def warp_pull(what: str, solver: str, shear: float) -> Check:
    """Measure a tall sheet that hangs by its top, after a time [s]."""
    scene, seconds, exact = base(solver, 33, 9, width=0.25, pins=("top",)), 8.0, sheet_modulus(THREADS, shear)
    scene = damped(replace(scene, fabric=fabric_with_shear(shear)))
    with Timed(scene) as simulation:
        advance(simulation, seconds)
        row = relative(what, exact, modulus_of(simulation.positions(), simulation.topology.mass), *MODULUS)
    if solver != "lines":
        return row
    mass = simulation.topology.mass
    return row.by_law(TOO_EARLY, lambda: abs(modulus_of(lines_after(scene, seconds), mass) / exact - 1))


def modulus_of(positions: Floats, mass: Floats) -> float:
    """Return stress over strain [N/m] of the middle third, away from the pins, under the weight below it."""
    carried = mass.reshape(33, 9).sum(axis=1)[::-1].cumsum()[::-1]  # [kg] below each link, and by each particle
    strain = -np.diff(positions.reshape(33, 9, 3)[:, 4, 1]) / (1.0 / 32) - 1
    return float((carried[1:] * GRAVITY / 0.25 / strain)[11:22].mean())


def bias_pull(what: str, solver: str, shear: float) -> Check:
    """Measure two strips that are cut at 45° and hang by their tops.

    The additional columns of the wider one carry the difference between their forces.
    """
    narrow, wide = (bias_strip(solver, shear, columns) for columns in BIAS_COLUMNS)
    wider = 2 * (BIAS_COLUMNS[1] - BIAS_COLUMNS[0]) / BIAS_CELLS / np.sqrt(2)
    row = relative(what, bias_modulus(THREADS, shear), float((wide - narrow) / wider), *MODULUS)
    return row.by_law(SOFTER, partial(unconverged_bias, shear)) if solver == "xpbd" else row


def unconverged_bias(shear: float) -> float:
    """Return the error of the bias modulus with the stiffness that the iterations of `xpbd` leave."""
    mass, setting = base("xpbd").cloth.area_density / (BIAS_CELLS + 1) ** 2, default_solver("xpbd")
    h = FRAME_SECONDS / setting.substeps
    threads, diagonals = (effective_stiffness("xpbd", k, mass, h, setting.iterations) for k in (THREADS, shear))
    return 1 - bias_modulus(threads, diagonals) / bias_modulus(THREADS, shear)


def bias_strip(solver: str, shear: float, columns: int) -> float:
    """Return the force over strain [N] of a strip with `columns` columns on each side of its middle.

    It is cut out of a square that stands on a corner: springs outside of it have no stiffness.
    """
    side = BIAS_CELLS + 1
    row, column = np.divmod(np.arange(side**2), side)
    across = row + column - BIAS_CELLS  # columns from the middle; upward, rows are half a diagonal apart
    up = (column - row) / BIAS_CELLS / np.sqrt(2)
    inside = np.abs(across) <= columns
    pins = tuple(int(n) for n in np.flatnonzero(inside & (up > BIAS_TOP)))
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "cut.csv").write_text("\n".join(str(int(one)) for one in inside), encoding="utf-8")
        scene = base(solver, side, side, pins=pins, rotation=(0.0, 0.0, 45.0), mass_lumping="uniform")
        scene = replace(scene, fabric=fabric_with_shear(shear), maps=Maps(stiffness="cut.csv", folder=folder))
        with Timed(damped(scene)) as simulation:
            advance(simulation, 6.0)
            ends = simulation.topology.ends
            hanging = inside.copy()  # including particles that springs of half the constant attach to it
            hanging[ends[inside[ends].any(axis=1)]] = True
            line = np.flatnonzero((across == 0) & (up > BIAS_SEEN[0]) & (up < BIAS_SEEN[1]))
            line = line[np.argsort(up[line])]
            mass = simulation.topology.mass
            carried = [mass[hanging & (up > up[n] - 1.0) & (up <= up[n] + 1e-9)].sum() for n in line[:-1]]
            y = simulation.positions()[line, 1]
            strain = (y[-1] - y[0]) / (up[line[-1]] - up[line[0]]) - 1
            # Between two particles of the line the strip carries the mass below their midpoint.
            half = [mass[hanging & (np.abs(up - (up[a] + up[b]) / 2) < 1e-9)].sum() for a, b in pairwise(line)]
            return float(np.mean(np.array(carried) + np.array(half) / 2)) * GRAVITY / float(strain)


def panel(solver: str) -> Iterator[Check]:
    """Measure the sag of a tall sheet between two vertical edges: only its diagonals resist, C66 = k_d."""
    for shear in (500.0, 1000.0):
        what = f"force per shear and width, diagonals of {shear:g} N/m [N/m]"
        yield run_with_limit(what, *MODULUS, partial(sheared, what, solver, shear))


def sheared(what: str, solver: str, shear: float) -> Check:
    """Measure the shear stiffness of one panel from the sag of its middle."""
    cloth = {"width": PANEL_WIDTH, "height": 6 * PANEL_WIDTH, "mass_lumping": "uniform", "pins": ("left", "right")}
    scene = base(solver, PANEL_ROWS, PANEL_CELLS + 1, **cloth)
    mass = scene.cloth.area_density * scene.cloth.width * scene.cloth.height / ((PANEL_ROWS - 1) * PANEL_CELLS)
    gravity = 2 * PANEL_STRAIN * PANEL_WIDTH * shear / (mass * PANEL_CELLS**2)
    scene = replace(scene, fabric=fabric_with_shear(shear), forces=Forces(gravity=gravity))
    with Timed(damped(scene)) as simulation:
        advance(simulation, 6.0)
        lower = (simulation.topology.start - simulation.positions())[:, 1].reshape(PANEL_ROWS, PANEL_CELLS + 1)
        measured = mass * gravity * PANEL_CELLS**2 / (8 * float(lower[PANEL_ROWS // 2, PANEL_CELLS // 2]))
        return relative(what, shear, measured, *MODULUS)
