"""Every stage in strips with every solver: what a kernel of whole slots may not do ends the process (kernels/whole.py).

Stages that go together are in one scene: most of the time is that of compiling what they have in common.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.scene.model import (
    Box,
    Capsule,
    Cloth,
    Fabric,
    Grip,
    Limit,
    Mesh,
    Plane,
    Scene,
    SelfCollision,
    Solver,
    Sphere,
    Tethers,
    Wind,
)
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

TURNED = (10.0, 20.0, 30.0)
CLOTH = Cloth(rows=9, columns=20, width=1.0, height=0.5, center=(0, 2, 0), rotation=(-80, 0, 0), pins=("top",))
FABRIC = Fabric(warp=400.0, weft=400.0, shear=100.0, bend=2.0, bending=1e-4)
BODIES: dict[str, Any] = {
    "spheres": Sphere(center=(-0.3, 1.9, 0.1), radius=0.15, friction=0.3),
    "capsules": Capsule(center=(0.0, 1.9, 0.1), length=0.3, radius=0.1, rotation=TURNED, spin=(0, 50, 0), friction=0.3),
    "boxes": Box(center=(0.3, 1.9, 0.1), size=(0.2, 0.1, 0.2), rotation=TURNED, friction=0.3),
    "planes": Plane(center=(0.0, 1.8, 0.1), rotation=TURNED, friction=0.3),
    "meshes": Mesh(center=(0.3, 1.9, -0.1), scale=0.5, resolution=24, friction=0.3),
}


def bodies(**how: Any) -> dict[str, Any]:
    """One of each kind, all of which answer to contact in this way."""
    return {kind: (replace(body, **how),) for kind, body in BODIES.items()}


STAGES: dict[str, dict[str, Any]] = {
    "pushes": bodies(),
    "swept": bodies(swept=True),
    "reflects": bodies(response="reflection"),
    "repels": bodies(response="repulsion"),
    "particles, dashpots, limit, still air": {
        "self_collision": SelfCollision(thickness=0.02),
        "fabric": replace(FABRIC, damping_time=1e-3),
        "limit": Limit(0.02, sweeps=4),
        "wind": Wind(x=0.0, z=0.0),
    },
    "triangles, slack, tethers": {
        "self_collision": SelfCollision(thickness=0.02, contacts="triangles"),
        "fabric": replace(FABRIC, compression=0.0),
        "tethers": Tethers(1.01),
    },
    "heap, grip": {
        "self_collision": SelfCollision(thickness=0.02, untangle=True, stick=True),
        "cloth": replace(CLOTH, pins=()),
        "grips": (Grip(pins=("top",), sway=(0.2, 0, 0), spin=(0, 30, 0)),),
    },
}


# What stages compile to hangs on how a method keeps velocity and on what `lines` asks of contact in its own stages: the
# other methods call the same functions in the same way as `xpbd`. `make long` has them, but for what leads pins twice.
SHOWN = ("verlet", "xpbd", "lines")
CASES = [
    pytest.param(
        *(solver, stage),
        marks=[pytest.mark.long] * (solver not in SHOWN and (solver, stage) != ("spring", "heap, grip")),
    )
    for solver in SOLVERS
    for stage in STAGES
]


@pytest.mark.parametrize(("solver", "stage"), CASES)
def test_a_stage_runs_in_strips(solver: str, stage: str) -> None:
    scene = Scene(cloth=CLOTH, fabric=FABRIC, solver=Solver(name=solver, substeps=40, iterations=3))
    with Simulation(replace(scene, **STAGES[stage]), "lanes") as simulation:
        start = simulation.positions()
        simulation.advance_frame()
        held = simulation.topology.particle_count - 1
        simulation.grab(held, simulation.positions()[held] + 0.01)
        simulation.advance_frame()
        moved = np.linalg.norm(simulation.positions() - start, axis=1)
        assert 0.01 < moved.max() < 1.0
