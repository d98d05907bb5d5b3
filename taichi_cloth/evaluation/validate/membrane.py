"""A2.5 and A5: a sheet under tension, one that is pulled along its threads or on the bias, and one in shear."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...scene.schema import FRAME_SECONDS, Fabric, Forces, Maps, Scene
from .check import (
    SOFTER,
    Check,
    Timed,
    advance,
    base,
    damped,
    default_solver,
    effective_stiffness,
    frequency,
    relative,
    run_with_limit,
    structural,
    substep,
    swing_frames,
    unconverged_sag,
)
from .exact import GRAVITY, bias_modulus, drum_modes, drum_sag, sheet_modulus

SAG_CELLS = (16, 32, 64, 128)
MODE_CELLS = (16, 32, 64)
TAUT = (1e-2, 1e-3)  # A2: 1 %, 0.1 %
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
EDGES = ("top", "bottom", "left", "right")


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
    flat = base(solver, cells + 1, cells + 1, mass_lumping="uniform", pins=EDGES, rotation=(-90.0, 0.0, 0.0))
    return structural(replace(flat, cloth=replace(flat.cloth, width=SLACK, height=SLACK)), constant)


def tension(cells: int, constant: float) -> float:
    """Return the tension of each spring of the drum [N]."""
    return constant * (1.0 - SLACK) / cells


def sagging(what: str, solver: str, cells: int) -> Check:
    """Measure the sag of the middle of the drum under its weight."""
    middle = (cells // 2) * (cells + 2)
    with Timed(damped(drum_scene(solver, cells, CONSTANT))) as simulation:
        mass = float(simulation.topology.mass[0])
        simulation.set_state(simulation.topology.start / SLACK)
        advance(simulation, 6.0)
        sag = -float(simulation.positions()[middle, 1])
        pull = tension(cells, CONSTANT)
        row = relative(what, drum_sag(cells, pull, mass), sag, *TAUT)
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
    for shear in DIAGONALS:
        what = f"along the warp, diagonals of {shear:g} N/m [N/m]"
        yield run_with_limit(what, *MODULUS, partial(warp_pull, what, solver, shear))
    for shear in DIAGONALS:
        what = f"on the bias, diagonals of {shear:g} N/m [N/m]"
        yield run_with_limit(what, *MODULUS, partial(bias_pull, what, solver, shear))


def fabric_with_shear(shear: float) -> Fabric:
    """Return a fabric with diagonals of a stiffness [N/m]."""
    return Fabric(warp=THREADS, weft=THREADS, shear=shear, bend_spring=0.0)


def warp_pull(what: str, solver: str, shear: float) -> Check:
    """Measure a tall sheet that hangs by its top.

    Its middle third, away from the pins, stretches under the weight below it.
    """
    scene = base(solver, 33, 9, width=0.25, pins=("top",))
    with Timed(damped(replace(scene, fabric=fabric_with_shear(shear)))) as simulation:
        advance(simulation, 8.0)
        rows = slice(11, 22)
        carried = simulation.topology.mass.reshape(33, 9).sum(axis=1)[::-1].cumsum()[::-1]  # [kg] above each row
        y = simulation.positions().reshape(33, 9, 3)[:, 4, 1]
        strain = -np.diff(y) / (1.0 / 32) - 1
        stress = carried[1:] * GRAVITY / 0.25
        measured = float((stress[rows] / strain[rows]).mean())
        return relative(what, sheet_modulus(THREADS, shear), measured, *MODULUS)


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
            force = float(np.mean(np.array(carried) + np.array(half) / 2)) * GRAVITY
            return force / float(strain)


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
