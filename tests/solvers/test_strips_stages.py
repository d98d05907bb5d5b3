"""Every stage in strips with every solver: what a kernel of whole slots may not do ends the process (kernels/whole.py).

`make long` has all; what is quick here is what no other test runs in strips.
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

TURNED, THERE = (10.0, 20.0, 30.0), (0.0, 1.9, 0.1)
CLOTH = Cloth(rows=9, columns=20, width=1.0, height=0.5, center=(0, 2, 0), rotation=(-80, 0, 0), pins=("top",))
FABRIC = Fabric(warp=400.0, weft=400.0, shear=100.0, bend=2.0, bending=1e-4)
BODIES: dict[str, Any] = {
    "spheres": Sphere(center=THERE, radius=0.15, friction=0.3),
    "capsules": Capsule(center=THERE, length=0.3, radius=0.1, rotation=TURNED, spin=(0, 50, 0), friction=0.3),
    "boxes": Box(center=THERE, size=(0.2, 0.1, 0.2), rotation=TURNED, friction=0.3),
    "planes": Plane(center=THERE, rotation=TURNED, friction=0.3),
    "meshes": Mesh(center=THERE, scale=0.5, resolution=24, friction=0.3),
}
WAYS = {
    "pushes": {},
    "swept": {"swept": True},
    "reflects": {"response": "reflection"},
    "repels": {"response": "repulsion"},
}
STAGES: dict[str, dict[str, Any]] = {
    **{f"{kind}, {way}": {kind: (replace(body, **how),)} for kind, body in BODIES.items() for way, how in WAYS.items()},
    "particles": {"self_collision": SelfCollision(thickness=0.02)},
    "triangles": {"self_collision": SelfCollision(thickness=0.02, contacts="triangles")},
    "heap": {"self_collision": SelfCollision(thickness=0.02, untangle=True, stick=True)},
    "slack": {"fabric": replace(FABRIC, compression=0.0)},
    "dashpots": {"fabric": replace(FABRIC, damping_time=1e-3)},
    "grip": {"cloth": replace(CLOTH, pins=()), "grips": (Grip(pins=("top",), sway=(0.2, 0, 0), spin=(0, 30, 0)),)},
    "limit": {"limit": Limit(0.02, sweeps=4)},
    "tethers": {"tethers": Tethers(1.01)},
    "still air": {"wind": Wind(x=0.0, z=0.0)},
}
QUICK = [("xpbd", "meshes, swept"), ("xpbd", "heap"), ("spring", "grip")]


@pytest.mark.parametrize(
    ("solver", "stage"),
    [
        pytest.param(solver, stage, marks=[] if (solver, stage) in QUICK else pytest.mark.long)
        for solver in SOLVERS
        for stage in STAGES
    ],
)
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
