"""pyPBD, the position-based dynamics library of Bender et al.: distance constraints on the edges of the triangles."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np
import pypbd as pbd
from cloth import FRAME, STIFFNESS, Array, arguments, run

DISTANCE, XPBD_DISTANCE = 1, 4  # cloth methods of `addClothConstraints`
DIHEDRAL, XPBD_ISOMETRIC = 1, 3  # methods of `addBendingConstraints`

# setting: method, stiffness, bending method, bending stiffness, substeps, iterations. Its demos use 3 × 3;
# 60 × 1 has as many iterations per frame as the 5 × 12 of the browser demos.
SETTINGS = {
    "xpbd 3x3": (XPBD_DISTANCE, STIFFNESS, XPBD_ISOMETRIC, 0.01, 3, 3),
    "distance 5x12": (DISTANCE, 1.0, DIHEDRAL, 0.01, 5, 12),
    "distance 60x1": (DISTANCE, 1.0, DIHEDRAL, 0.01, 60, 1),
}

sheet, frames, setting = arguments(list(SETTINGS))
method, stiffness, bending_method, bending, substeps, iterations = SETTINGS[setting]

simulation = pbd.Simulation.getCurrent()
simulation.initDefault()
model = simulation.getModel()
mesh = model.addTriangleModel(list(sheet.points[:, [0, 2, 1]]), list(sheet.triangles.ravel()))  # y is up here
particles = model.getParticles()
for i, mass in enumerate(sheet.masses):
    particles.setMass(i, 0.0 if i in sheet.pins else mass)
model.addClothConstraints(mesh, method, stiffness, stiffness, stiffness, stiffness, 0.3, 0.3, False, False)
model.addBendingConstraints(mesh, bending_method, bending)

stepper = simulation.getTimeStep()
stepper.setValueUInt(pbd.TimeStepController.NUM_SUB_STEPS, substeps)
stepper.setValueUInt(pbd.TimeStepController.MAX_ITERATIONS, iterations)
pbd.TimeManager.getCurrent().setTimeStepSize(FRAME)


def positions() -> Array:
    return np.array(particles.getVertices(), dtype=np.float64).reshape(-1, 3)[:, [0, 2, 1]]


run("pyPBD", version("pyPBD"), setting, sheet, frames, lambda: stepper.step(model), positions)
