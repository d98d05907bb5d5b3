"""PyBullet: a deformable of mass–spring type, from an OBJ file, hung by anchors."""

from __future__ import annotations

import math
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pybullet
from cloth import AREA_DENSITY, FRAME, GRAVITY, SIDE, STIFFNESS, Array, arguments, run

sheet, frames, setting = arguments(["40 N/m", "2000 N/m"])

# 40 N/m and 1/240 s are what its own examples have, a far softer cloth. Spring forces are explicit, so stiff ones
# need short steps: 2.2 a frame for each column was found to be enough at 2000 N/m.
stiffness, steps = (40.0, 4) if setting == "40 N/m" else (STIFFNESS, math.ceil(2.2 * sheet.columns))
DAMPING = 0.1  # as in its examples

pybullet.connect(pybullet.DIRECT)
pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD)
pybullet.setGravity(0, 0, -GRAVITY)
pybullet.setTimeStep(FRAME / steps)
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "sheet.obj"
    points = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in sheet.points)
    file.write_text(points + "".join(f"f {a} {b} {c}\n" for a, b, c in sheet.triangles + 1))
    body = pybullet.loadSoftBody(
        str(file),
        mass=AREA_DENSITY * SIDE**2,
        useMassSpring=1,
        useBendingSprings=1,
        springElasticStiffness=stiffness,
        springDampingStiffness=DAMPING,
        springBendingStiffness=0.01,
        collisionMargin=0.001,
        useSelfCollision=0,
    )


def vertices() -> Array:
    return np.array(pybullet.getMeshData(body, -1, flags=pybullet.MESH_DATA_SIMULATION_MESH)[1])


order = sheet.order_of(vertices())
for pin in sheet.pins:
    pybullet.createSoftBodyAnchor(body, int(order[pin]), -1, -1)


def advance() -> None:
    for _ in range(steps):
        pybullet.stepSimulation()


run("PyBullet", version("pybullet"), f"{setting}, {steps} steps", sheet, frames, advance, lambda: vertices()[order])
