"""A8: what must not change anything. No reference values are needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import sqrt

import numpy as np

from ..measure.cloth import energies, spring_strains
from ..mesh.from_scene import stiffness_of
from ..scene.model import Fabric, Forces, Scene, Solver, Sphere
from ..simulation import Simulation
from .exact import GRAVITY, Floats
from .row import Row, at_most
from .setups import advance, base, usual

SHIFTS = (10.0, 100.0, 1000.0)  # [m]
ORDERS = {"spring": 2.0, "lines": 2.0, "rk4": 4.0}  # of all others 1
ORDER_SUBSTEPS = {"spring": (4, 8, 16), "lines": (2, 4, 8), "rk4": (1, 2, 4)}
BALL = Sphere(center=(0.0, -0.36, 0.0), radius=0.3, margin=0.05, friction=0.5)
SOON = 0.5  # [s] a fold has not amplified rounding yet


def at_rest(solver: str) -> Iterator[Row]:
    """Without forces nothing moves. Turned, the sheet's lengths are rounded; flat along the axes they are exact."""
    for name, rotation in (("flat", (0.0, 0.0, 0.0)), ("turned", (-37.0, 20.0, 0.0))):
        scene = replace(base(solver, rotation=rotation), forces=Forces(gravity=0.0))
        with Simulation(scene) as simulation:
            for _ in range(max(1, 10_000 // simulation.substeps)):
                simulation.advance_frame()
            moved = float(np.abs(simulation.positions() - simulation.topology.start).max())
            yield at_most(f"displacement without forces in 10,000 substeps, {name} [m]", moved, 1e-6, 0.0)


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


def on_a_ball(solver: str) -> Iterator[Row]:
    """A square sheet that falls on a ball stays as symmetric as the two are, until folds amplify rounding."""
    scene = replace(base(solver, 17, 17, rotation=(-90.0, 0.0, 0.0), lumping="equal"), spheres=(BALL,))
    with Simulation(scene) as simulation:
        advance(simulation, 0.2)
        x = simulation.positions().reshape(17, 17, 3)
    images = (x[:, ::-1] * [-1.0, 1.0, 1.0], x[::-1] * [1.0, 1.0, -1.0], x.transpose(1, 0, 2)[:, :, [2, 1, 0]])
    worst = max(float(np.abs(image - x).max()) for image in images)
    yield at_most("difference to its mirror images 0.2 s after it fell on a ball [m]", worst, 1e-3, 1e-6)


def far_away(solver: str) -> Iterator[Row]:
    plain = moved(swinging(solver))
    for shift in SHIFTS:
        other = moved(swinging(solver, center=(shift, shift, 0.0)))
        yield at_most(f"difference {shift:g} m away, up and aside [m]", float(np.abs(other - plain).max()), 1e-2, 1e-4)


def order(solver: str) -> Iterator[Row]:
    """Half the substep, half the error, or a quarter, or a sixteenth: by the slope over two halvings."""
    scene = replace(
        base(solver, 3, 3, width=0.6, height=0.6, pins=("top",), rotation=(-50.0, 0.0, 0.0), area_density=0.3),
        fabric=Fabric(warp=30.0, weft=30.0, shear=12.0, bend=3.0),
    )
    fine = after(replace(scene, solver=Solver(name="rk4", substeps=32, damping=0.0)))
    errors = []
    for substeps in ORDER_SUBSTEPS.get(solver, (8, 16, 32)):
        setting = Solver(name=solver, substeps=substeps, iterations=50, damping=0.0)
        errors.append(float(np.sqrt(((after(replace(scene, solver=setting)) - fine) ** 2).mean())))
    yield Row(
        "order of convergence",
        exact := ORDERS.get(solver, 1.0),
        measured := float(np.log2(errors[0] / errors[2]) / 2),
        abs(measured - exact),
        0.15,
        0.05,
    )


def after(scene: Scene) -> Floats:
    with Simulation(scene) as simulation:
        advance(simulation, SOON)
        return simulation.positions()


def energy(solver: str) -> Iterator[Row]:
    """A sheet that nothing damps keeps its energy: gravity's, the springs' and that of motion, over 10,000 substeps."""
    scene = replace(swinging(solver), solver=usual(solver))
    with Simulation(scene) as simulation:
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
        change = float(np.abs(np.array(totals) - totals[0]).max()) / max(kinetic)
        yield at_most("energy lost or won, of the largest kinetic energy", change, 1e-2, 1e-3)
