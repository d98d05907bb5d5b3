"""Every feature in the SIMD layout with every solver: operations that tensor fields do not support end the process
(kernels/tensor_fields.py).

Several features share a scene: most of the time is spent on compiling what they have in common.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taichi_cloth.scene.collider_schema import Attachment, Box, Capsule, Mesh, Plane, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene, SelfCollision, Solver, StrainLimit, Tethers, Wind
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS

TURNED = (10.0, 20.0, 30.0)
CLOTH = Cloth(rows=9, columns=20, width=1.0, height=0.5, center=(0, 2, 0), rotation=(-80, 0, 0), pins=("top",))
FABRIC = Fabric(warp=400.0, weft=400.0, shear=100.0, bend_spring=2.0, bending_stiffness=1e-4)
COLLIDERS: dict[str, Any] = {
    "spheres": Sphere(center=(-0.3, 1.9, 0.1), radius=0.15, friction=0.3, margin=0.15),
    "capsules": Capsule(center=(0.0, 1.9, 0.1), length=0.3, radius=0.1, rotation=TURNED, spin=(0, 50, 0), friction=0.3),
    "boxes": Box(center=(0.3, 1.9, 0.1), size=(0.2, 0.1, 0.2), rotation=TURNED, friction=0.3),
    "planes": Plane(center=(0.0, 1.8, 0.1), rotation=TURNED, friction=0.3),
    "meshes": Mesh(center=(0.3, 1.9, -0.1), scale=0.5, resolution=24, friction=0.3),
}


def colliders(**properties: Any) -> dict[str, Any]:
    """Return one collider of each shape, with these contact properties."""
    return {section: (replace(collider, **properties),) for section, collider in COLLIDERS.items()}


FEATURES: dict[str, dict[str, Any]] = {
    "projection": colliders(),
    "continuous": colliders(continuous=True),
    "reflection": colliders(response="reflection"),
    "repulsion": colliders(response="repulsion"),
    "particles, damping, strain limit, still air": {
        "self_collision": SelfCollision(thickness=0.02),
        "fabric": replace(FABRIC, damping_time=1e-3),
        "strain_limit": StrainLimit(0.02, iterations=4),
        "wind": Wind(x=0.0, z=0.0),
    },
    "triangles, slack, tethers": {
        "self_collision": SelfCollision(thickness=0.02, primitives="triangles"),
        "fabric": replace(FABRIC, compression=0.0),
        "tethers": Tethers(1.01),
    },
    "untangling, static friction, attachments": {
        "self_collision": SelfCollision(thickness=0.02, untangle=True, static_friction=True),
        "cloth": replace(CLOTH, pins=()),
        "attachments": (Attachment(pins=("top",), oscillation=(0.2, 0, 0), spin=(0, 30, 0)),),
    },
}


# What a feature compiles to depends on how a solver stores velocity, and on the stages of `lines`: the other solvers
# call the same functions as `xpbd`. `make long` runs them, except for the one that moves pins twice.
SHOWN = ("verlet", "xpbd", "lines")
CASES = [
    pytest.param(
        *(solver, feature),
        marks=[pytest.mark.long]
        * (solver not in SHOWN and (solver, feature) != ("explicit", "untangling, static friction, attachments")),
    )
    for solver in SOLVERS
    for feature in FEATURES
]


@pytest.mark.parametrize(("solver", "feature"), CASES)
def test_a_feature_runs_in_the_simd_layout(solver: str, feature: str) -> None:
    scene = Scene(cloth=CLOTH, fabric=FABRIC, solver=Solver(name=solver, substeps=40, iterations=3))
    with Simulation(replace(scene, **FEATURES[feature]), "simd") as simulation:
        start = simulation.positions()
        simulation.step()
        particle = simulation.topology.particle_count - 1
        simulation.grab(particle).move_to(simulation.positions()[particle] + 0.01)
        simulation.step()
        moved = np.linalg.norm(simulation.positions() - start, axis=1)
        assert 0.01 < moved.max() < 1.0
