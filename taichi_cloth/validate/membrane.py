"""A2.5 and A5.2: a sheet under tension, and one that is sheared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..scene.model import Fabric, Forces
from ..simulation import Simulation
from .exact import GRAVITY, drum_modes, drum_sag
from .row import Row, relative
from .setups import advance, base, damped, frequency, structural, swing_frames

CELLS = 16
SLACK = 0.9  # [m] side of the drum's sheet before it is drawn out to a metre
CONSTANT = 1000.0  # [N/m] of its springs; a tenth of it where it swings, or pictures at 60 a second could not follow
MODES = ((1, 1), (1, 2), (2, 2))
PANEL_ROWS, PANEL_CELLS, PANEL_WIDTH = 97, 16, 0.5  # six times as tall as wide: its free edges are far away
EDGES = ("top", "bottom", "left", "right")


def drum(solver: str) -> Iterator[Row]:
    """A square sheet held at all edges and drawn out sags under its weight, and swings in its modes."""
    flat = base(solver, CELLS + 1, CELLS + 1, lumping="equal", pins=EDGES, rotation=(-90.0, 0.0, 0.0))
    flat = structural(replace(flat, cloth=replace(flat.cloth, width=SLACK, height=SLACK)), CONSTANT)
    tension = CONSTANT * (1.0 - SLACK) / CELLS  # [N] of each spring
    middle = (CELLS // 2) * (CELLS + 2)
    with Simulation(damped(flat)) as simulation:
        mass = float(simulation.topology.mass[0])
        simulation.place(simulation.topology.start / SLACK)
        advance(simulation, 4.0)
        sag = -float(simulation.positions()[middle, 1])
        yield relative("sag of a taut square under its weight [m]", drum_sag(CELLS, tension, mass), sag, 1e-2, 1e-3)
    still = replace(structural(flat, CONSTANT / 10), forces=Forces(gravity=0.0))
    for mode in MODES:
        with Simulation(still) as simulation:
            omega = drum_modes(CELLS, tension / 10, mass, *mode)
            along, across = (np.sin(n * np.pi * np.arange(CELLS + 1) / CELLS) for n in mode)
            shape = np.outer(along, across).ravel()
            start = simulation.topology.start / SLACK
            start[:, 1] += 1e-3 * shape
            simulation.place(start)
            seen = []
            for _ in range(swing_frames(omega)):
                seen.append(float(simulation.positions()[:, 1] @ shape))
                simulation.advance_frame()
            yield relative(
                f"mode {mode[0]}, {mode[1]} of a taut square [rad/s]", omega, frequency(seen, omega), 1e-2, 1e-3
            )


def panel(solver: str) -> Iterator[Row]:
    """A tall sheet between two upright edges sags by its weight: only its diagonals resist, C66 = k_d."""
    for shear in (500.0, 1000.0):
        cloth = {"width": PANEL_WIDTH, "height": 6 * PANEL_WIDTH, "lumping": "equal", "pins": ("left", "right")}
        scene = base(solver, PANEL_ROWS, PANEL_CELLS + 1, **cloth)
        scene = replace(scene, fabric=Fabric(warp=1000.0, weft=1000.0, shear=shear, bend=0.0))
        with Simulation(damped(scene)) as simulation:
            mass = float(simulation.topology.mass[0])
            advance(simulation, 6.0)
            lower = (simulation.topology.start - simulation.positions())[:, 1].reshape(PANEL_ROWS, PANEL_CELLS + 1)
            measured = mass * GRAVITY * PANEL_CELLS**2 / (8 * float(lower[PANEL_ROWS // 2, PANEL_CELLS // 2]))
            yield relative(f"force per shear and width, diagonals of {shear:g} N/m [N/m]", shear, measured, 2e-2, 2e-3)
