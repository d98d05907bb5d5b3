"""A8: what must not change anything. No reference values are needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import sqrt

import numpy as np

from ..scene.model import Fabric, Forces, Scene
from ..simulation import Simulation
from .exact import Floats
from .row import Row, at_most
from .setups import advance, base

SHIFTS = (10.0, 100.0, 1000.0)  # [m]
SOON = 0.5  # [s] a fold has not amplified rounding yet


def at_rest(solver: str) -> Iterator[Row]:
    scene = replace(base(solver, rotation=(-37.0, 20.0, 0.0)), forces=Forces(gravity=0.0))
    with Simulation(scene) as simulation:
        for _ in range(max(1, 10_000 // simulation.substeps)):
            simulation.advance_frame()
        moved = float(np.abs(simulation.positions() - simulation.topology.start).max())
        yield at_most("displacement without forces in 10,000 substeps [m]", moved, 1e-6, 0.0)


def swinging(solver: str, **keys: object) -> Scene:
    """A fabric let go 60° off hanging, from its top edge."""
    scene = base(solver, 17, 17, **{"pins": ("top",), "rotation": (-60.0, 0.0, 0.0), **keys})
    return replace(scene, fabric=Fabric(warp=500.0, weft=500.0, shear=250.0, bend=5.0))


def moved(scene: Scene) -> Floats:
    """Where the particles are a little later [m], from where the middle of the sheet began."""
    with Simulation(scene) as simulation:
        advance(simulation, SOON)
        from_center: Floats = simulation.positions() - np.asarray(scene.cloth.center)
        return from_center


def turned(solver: str) -> Iterator[Row]:
    """Turned by 30° about the vertical, the sheet moves as before, turned."""
    plain, other = moved(swinging(solver)), moved(swinging(solver, rotation=(-60.0, 30.0, 0.0)))
    c, s = sqrt(3) / 2, 0.5
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    yield at_most("difference when turned by 30° [m]", float(np.abs(other - plain @ turn.T).max()), 1e-4, 1e-5)


def mirrored(solver: str) -> Iterator[Row]:
    """A sheet that is its own mirror image stays so."""
    x = moved(swinging(solver)).reshape(17, 17, 3)
    image = x[:, ::-1] * [-1.0, 1.0, 1.0]
    yield at_most("difference to its mirror image [m]", float(np.abs(image - x).max()), 1e-3, 1e-6)


def far_away(solver: str) -> Iterator[Row]:
    plain = moved(swinging(solver))
    for shift in SHIFTS:
        other = moved(swinging(solver, center=(shift, shift, 0.0)))
        yield at_most(f"difference {shift:g} m away, up and aside [m]", float(np.abs(other - plain).max()), 1e-2, 1e-4)
