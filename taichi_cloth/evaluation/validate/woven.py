"""A9.8: a weave must have the curves that were typed in. Sheets that are pulled and sheared, and strips that are bent.

Edges are pinned where they are moved to, without gravity, and the inside comes to rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import asin, cos, radians, sin

import numpy as np

from ...scene.fabric_schema import Fabric, Weave
from ...scene.schema import Cloth, Forces, Scene
from .check import Check, Timed, base, damped, relative, rows_with_limit
from .continuum import CELLS, at_rest, deformed, mean_reactions
from .exact import Floats

TYPED = (1e-2, 2e-3)  # A9.8: 1 %, 0.2 %
# Each piece of a curve is measured, and where it continues after its end.
CURVES = Weave(
    warp=((0.01, 10.0), (0.03, 60.0), (0.06, 300.0)),
    weft=((0.02, 12.0), (0.05, 80.0)),
    shear=((2.0, 0.2), (20.0, 1.0), (40.0, 4.0)),
    bending_warp=((2.0, 0.02), (6.0, 0.1)),
    bending_weft=((3.0, 0.06), (6.0, 0.08)),
)
STRAINS = (0.005, 0.02, 0.045, 0.07)
ANGLES = (1.0, 10.0, 30.0, 45.0)  # [°]
CURVATURES = (1.0, 4.0)  # [1/m]
THREADS = ("warp", "weft")
LINKS, LINK = 16, 0.025  # of a strip that is bent; [m]
NUDGE = 1e-4  # [m] standard deviation of its start; one of 1 mm lets a shallow arc snap through


def curves(solver: str) -> Iterator[Check]:
    """Measure all curves of a weave."""
    for measured in (pulled, sheared, bent):
        yield from measured(solver)


def sheet(solver: str, cloth: Cloth) -> Scene:
    """Return a weave without gravity that comes to rest."""
    fabric = Fabric(model="weave", bending_stiffness=0.0, bend_spring=0.0)
    return damped(replace(base(solver), cloth=cloth, fabric=fabric, weave=CURVES, forces=Forces(gravity=0.0)))


def typed(curve: str, x: float) -> float:
    """Return a curve of `CURVES` at x; after its last point it continues in a straight line."""
    points = np.array([(0.0, 0.0), *getattr(CURVES, curve)])
    (x_before, y_before), (x_last, y_last) = points[-2:]
    if x > x_last:
        return float(y_last + (x - x_last) * (y_last - y_before) / (x_last - x_before))
    return float(np.interp(x, *points.T))


def square(*pins: str) -> Cloth:
    """Return a sheet of one meter."""
    return Cloth(rows=CELLS + 1, columns=CELLS + 1, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=pins)


# -- pulled and sheared ------------------------------------------------------------------------------------------------


def pulled(solver: str) -> Iterator[Check]:
    """Measure the force on an edge of sheets that are stretched along one thread."""
    for thread in THREADS:
        whats = [f"{thread} stretched by {100 * strain:g} %: tension [N/m]" for strain in STRAINS]
        yield from rows_with_limit(whats, *TYPED, partial(tensions, whats, solver, thread))


def tensions(whats: list[str], solver: str, thread: str) -> Iterator[Check]:
    """Measure the tensions of one thread, one after another."""
    axis, edges = (1, ("top", "bottom")) if thread == "warp" else (0, ("left", "right"))
    with Timed(sheet(solver, square(*edges))) as simulation:
        flat = simulation.topology.start
        for what, strain in zip(whats, STRAINS, strict=True):
            gradient = np.eye(2)
            gradient[axis, axis] += strain
            at_rest(simulation, deformed(gradient, flat))
            far = flat[:, axis] > 0.499
            tension = float(mean_reactions(simulation)[far, axis].sum())  # on an edge of one meter
            yield relative(what, typed(thread, strain), tension, *TYPED)


def sheared(solver: str) -> Iterator[Check]:
    """Measure the moment that turns the threads of a sheet against each other, in a frame of four rods."""
    whats = [f"sheared by {angle:g}°: moment per area [N/m]" for angle in ANGLES]
    yield from rows_with_limit(whats, *TYPED, partial(moments, whats, solver))


def moments(whats: list[str], solver: str) -> Iterator[Check]:
    """Measure all angles from the work of the reactions when the angle grows."""
    with Timed(sheet(solver, square("top", "bottom", "left", "right"))) as simulation:
        flat = simulation.topology.start
        for what, angle in zip(whats, ANGLES, strict=True):
            half = radians(angle) / 2
            turned = np.array([[cos(half), sin(half)], [sin(half), cos(half)]])
            growth = np.array([[-sin(half), cos(half)], [cos(half), -sin(half)]]) / 2  # per radian
            at_rest(simulation, deformed(turned, flat))
            moment = float((mean_reactions(simulation) * deformed(growth, flat)).sum())  # of one square meter
            yield relative(what, typed("shear", angle), moment, *TYPED)


# -- bent --------------------------------------------------------------------------------------------------------------


def bent(solver: str) -> Iterator[Check]:
    """Measure the moment at the clamp of strips whose two ends are held on a circle."""
    for thread in THREADS:
        whats = [f"{thread} bent by {curvature:g}/m: moment [N]" for curvature in CURVATURES]
        yield from rows_with_limit(whats, *TYPED, partial(couples, whats, solver, thread))


def couples(whats: list[str], solver: str, thread: str) -> Iterator[Check]:
    """Measure all curvatures of a strip along one thread.

    The two first and the two last particles of each thread are pinned. The moment is the force across the first link of
    a thread times the length of the link, and pulls at cos(θ/2) of it: κ = 2·sin(θ/2)/ℓ for a turn θ.
    """
    shape = (LINKS + 1, 3) if thread == "warp" else (3, LINKS + 1)
    indices = np.arange(3 * (LINKS + 1)).reshape(shape)
    along = indices if thread == "warp" else indices.T  # (links + 1, 3)
    height, width = ((n - 1) * LINK for n in shape)
    pins = tuple(np.concatenate([along[:2], along[-2:]]).ravel().tolist())
    cloth = Cloth(*shape, width=width, height=height, center=(0.0, 0.0, 0.0), pins=pins)
    with Timed(sheet(solver, cloth)) as simulation:
        flat = simulation.topology.start[along]
        for what, curvature in zip(whats, CURVATURES, strict=True):
            turn = 2 * asin(curvature * LINK / 2)
            x = np.empty((flat.size // 3, 3))
            x[along] = on_circle(flat, turn, curvature)
            at_rest(simulation, x, NUDGE)
            across = np.array([-sin(turn / 2), 0.0, cos(turn / 2)])  # of the first link
            force = mean_reactions(simulation)[along[0]].sum(axis=0)
            if thread == "warp":  # from top to bottom, along −y
                force = force[[1, 0, 2]] * [-1.0, 1.0, 1.0]
            moment = abs(float(force @ across)) * LINK / cos(turn / 2) / (2 * LINK)
            yield relative(what, typed(f"bending_{thread}", curvature), moment, *TYPED)


def on_circle(flat: Floats, turn: float, curvature: float) -> Floats:
    """Return the positions (links + 1, 3, 3) [m] of a strip whose links, as long as before, turn by an angle [rad]."""
    angle = turn * np.arange(len(flat))[:, None]
    direction = flat[1, 0] - flat[0, 0]
    direction /= np.linalg.norm(direction)
    ahead = np.sin(angle) / curvature
    bent: Floats = flat[:1] + ahead[..., None] * direction
    bent[..., 2] += (1 - np.cos(angle)) / curvature
    return bent
