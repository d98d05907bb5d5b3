"""A8: what must not change anything. No reference values are needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import sqrt

import numpy as np

from ..accuracy.truth import Curtain, truth
from ..measure.cloth import energies, spring_strains
from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, Fabric, Forces, Scene, Solver, Sphere
from .exact import GRAVITY, Floats
from .laws import ROUNDED, order_lost, rounding
from .row import Row, at_most
from .setups import Timed, advance, base, structural, usual

REST_FLAT, REST_TURNED = (0.0, 0.0), (1e-6, 0.0)  # A8: exactly, or < 1e-6·L
SAME = (1e-5, 1e-6)  # A8: 1e-5·L
ON_A_BALL = (1e-3, 1e-6)  # A8: 1e-3·L, 1e-6·L at 2 s
BALL_SECONDS = 2.0
SHIFTED = (1e-4, 1e-4)  # A8: unchanged to 1e-4·L; the text has no wider bound to pass
SHIFTS = (10.0, 100.0, 1000.0)  # [m]
ORDERS = {"spring": 2.0, "lines": 2.0, "rk4": 4.0}  # of all others 1
ORDER_SUBSTEPS = {"spring": (4, 8, 16, 32), "lines": (1, 2, 4, 8), "rk4": (1, 2, 4, 8)}
SLOPE = (0.15, 0.05)  # A8: ±0.15, here in each of three halvings
ORDER_CURTAIN = Curtain(cells=8, constant=6.0, degrees=60.0)  # soft: the largest steps are stable
CONSERVING = ("spring", "rk4")
BOUNDED = (1e-2, 1e-3)  # A8: 1 % over 10,000 steps
NEVER_RISING = (1e-5, 1e-6)  # A8: Euler's energy never rises without work done; float32 as in A1.6
BALL = Sphere(center=(0.0, -0.36, 0.0), radius=0.3, margin=0.05, friction=0.5)
SOON = 0.5  # [s] folds have not amplified rounding yet


def at_rest(solver: str) -> Iterator[Row]:
    """Without forces nothing moves. Turned, the sheet's lengths are rounded; flat along the axes they are exact."""
    for name, rotation in (("flat", (0.0, 0.0, 0.0)), ("turned", (-37.0, 20.0, 0.0))):
        scene = replace(base(solver, rotation=rotation), forces=Forces(gravity=0.0))
        with Timed(scene) as simulation:
            for _ in range(max(1, 10_000 // simulation.substeps)):
                simulation.advance_frame()
            moved = float(np.abs(simulation.positions() - simulation.topology.start).max())
            bounds = REST_FLAT if name == "flat" else REST_TURNED
            yield at_most(f"displacement without forces in 10,000 substeps, {name} [m]", moved, *bounds)


def swinging(solver: str, **keys: object) -> Scene:
    """A fabric let go 60° off hanging, from its top edge."""
    scene = base(solver, 17, 17, **{"pins": ("top",), "rotation": (-60.0, 0.0, 0.0), **keys})
    return replace(scene, fabric=Fabric(warp=500.0, weft=500.0, shear=250.0, bend=5.0))


def moved(scene: Scene) -> Floats:
    """Where the particles are a little later [m], from where the middle of the sheet began."""
    with Timed(scene) as simulation:
        advance(simulation, SOON)
        from_center: Floats = simulation.positions() - np.asarray(scene.cloth.center)
        return from_center


def turned(solver: str) -> Iterator[Row]:
    """Turned by 30° about the vertical, the sheet moves as before, turned."""
    plain, other = moved(swinging(solver)), moved(swinging(solver, rotation=(-60.0, 30.0, 0.0)))
    c, s = sqrt(3) / 2, 0.5
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    yield at_most("difference when turned by 30° [m]", float(np.abs(other - plain @ turn.T).max()), *SAME)


def mirrored(solver: str) -> Iterator[Row]:
    """A sheet that is its own mirror image stays so."""
    x = moved(swinging(solver)).reshape(17, 17, 3)
    image = x[:, ::-1] * [-1.0, 1.0, 1.0]
    yield at_most("difference to its mirror image [m]", float(np.abs(image - x).max()), *SAME)


def transposed(solver: str) -> Iterator[Row]:
    """With rows for columns, the sheet moves as before."""
    plain, other = swinging(solver), swinging(solver, pins=("left",))
    swapped = np.arange(17 * 17).reshape(17, 17).T.ravel()
    with Timed(other) as simulation:
        with Timed(plain) as first:
            start = first.positions()
        simulation.place(start[swapped])
        advance(simulation, SOON)
        x = simulation.positions()[swapped]
    difference = float(np.abs(x - moved(plain)).max())
    yield at_most("difference with rows for columns [m]", difference, *SAME)


def on_a_ball(solver: str) -> Iterator[Row]:
    """A square sheet that falls on a ball stays as symmetric as the two are."""
    scene = replace(base(solver, 17, 17, rotation=(-90.0, 0.0, 0.0), lumping="equal"), spheres=(BALL,))
    with Timed(scene) as simulation:
        advance(simulation, BALL_SECONDS)
        x = simulation.positions().reshape(17, 17, 3)
    images = (x[:, ::-1] * [-1.0, 1.0, 1.0], x[::-1] * [1.0, 1.0, -1.0], x.transpose(1, 0, 2)[:, :, [2, 1, 0]])
    worst = max(float(np.abs(image - x).max()) for image in images)
    yield at_most(f"difference to its mirror images {BALL_SECONDS:g} s after it fell on a ball [m]", worst, *ON_A_BALL)


def far_away(solver: str) -> Iterator[Row]:
    plain = moved(swinging(solver))
    for shift in SHIFTS:
        other = moved(swinging(solver, center=(shift, shift, 0.0)))
        yield at_most(f"difference {shift:g} m away, up and aside [m]", float(np.abs(other - plain).max()), *SHIFTED)


def order(solver: str) -> Iterator[Row]:
    """Half the substep, half the error, or a quarter, or a sixteenth: in each of three halvings.

    On a curtain whose columns move as chains, against one in float64 by another program (`accuracy/truth.py`).
    """
    cells = ORDER_CURTAIN.cells
    frames = round(SOON / FRAME_SECONDS)
    exact = truth(ORDER_CURTAIN, frames)[-1]
    turn = (-ORDER_CURTAIN.degrees, 0.0, 0.0)
    sheet = base(solver, cells + 1, cells + 1, lumping="equal", pins=("top",), rotation=turn)
    sheet = structural(sheet, ORDER_CURTAIN.constant)
    errors = []
    halvings = ORDER_SUBSTEPS.get(solver, (8, 16, 32, 64))
    for substeps in halvings:
        with Timed(replace(sheet, solver=Solver(solver, substeps, 50, damping=0.0))) as simulation:
            pivot = simulation.topology.start[0]
            advance(simulation, SOON)
            x = (simulation.positions() - pivot).reshape(cells + 1, cells + 1, 3)[:, cells // 2]
            errors.append(float(np.sqrt(((x[:, [2, 1]] - exact) ** 2).sum(axis=1).mean())))
    law = ORDERS.get(solver, 1.0)
    yield order_row(law, errors, [frames * substeps for substeps in halvings], exact)


def order_row(law: float, errors: list[float], steps: list[int], exact: Floats) -> Row:
    """The worst halving, or the worst that rounding does not explain; `exact`: where the chain ends [m]."""
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    missed = np.abs(orders - law)
    speed = sqrt(2 * GRAVITY * 1.0)  # [m/s] a fall of its length
    floors = [rounding(count, SOON, float(np.abs(exact).max()), speed) for count in steps[1:]]
    lost = np.array([order_lost(law, error, floor) for error, floor in zip(errors[:-1], floors, strict=True)])
    unexplained = missed > lost + SLOPE[0]
    k = int(np.where(unexplained | ~unexplained.any(), missed, -1.0).argmax())
    row = Row("order of convergence, the worst of three halvings", law, float(orders[k]), float(missed[k]), *SLOPE)
    return row.by_law(ROUNDED, partial(float, lost[k]))


def energy(solver: str) -> Iterator[Row]:
    """What nothing damps keeps its energy: gravity's, the springs' and that of motion, over 10,000 substeps.

    Explicit methods may neither lose nor win any. Implicit ones lose what they cannot follow, but win nothing.
    """
    scene = replace(swinging(solver), solver=usual(solver))
    with Timed(scene) as simulation:
        topology = simulation.topology
        stiffness = stiffness_of(scene, simulation.solver.springs, topology)
        totals, kinetic = [], []
        for _ in range(max(60, 10_000 // simulation.substeps)):
            x = simulation.positions()
            moving, lifted = energies(topology, x, simulation.velocities(), GRAVITY)
            stretched = 0.5 * float((stiffness * (spring_strains(topology, x) * topology.rest) ** 2).sum())
            totals.append(moving + lifted + stretched)
            kinetic.append(moving)
            simulation.advance_frame()
        over = np.array(totals) / max(kinetic)
        if solver in CONSERVING:
            change = float(np.abs(over - over[0]).max())
            yield at_most("energy lost or won, of the largest kinetic energy", change, *BOUNDED)
        else:
            risen = float((over - np.minimum.accumulate(over)).max())
            lost = float(over[0] - over[-1])
            what = f"energy won, of the largest kinetic energy ({100 * lost:.1f} % lost)"
            yield at_most(what, risen, *NEVER_RISING)
