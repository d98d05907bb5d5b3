"""Newton: its solvers VBD and Style3D, on the CPU."""

from __future__ import annotations

from importlib.metadata import version

import newton
import numpy as np
import warp as wp
from cloth import AREA_DENSITY, FRAME, GRAVITY, STIFFNESS, Array, Sheet, arguments, run
from newton.solvers import SolverStyle3D, SolverVBD, style3d

# Substeps and iterations. Newton's example of hanging cloth uses Style3D with two substeps and ten iterations.
SETTINGS = {"vbd 10x4": (10, 4), "style3d 2x10": (2, 10), "style3d 1x2": (1, 2)}


def build(sheet: Sheet, setting: str, iterations: int) -> tuple[newton.Model, object]:
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
    shape = {
        "pos": wp.vec3(0.0, 0.0, 0.0),
        "rot": wp.quat_identity(),
        "vel": wp.vec3(0.0, 0.0, 0.0),
        "scale": 1.0,
        "vertices": [wp.vec3(*point) for point in sheet.points],
        "indices": sheet.triangles.ravel().tolist(),
        "density": AREA_DENSITY,
        "particle_radius": 0.001,
    }
    if setting.startswith("style3d"):
        SolverStyle3D.register_custom_attributes(builder)
        stretch = wp.vec3(STIFFNESS, STIFFNESS, STIFFNESS / 2)  # weft, warp, shear
        style3d.add_cloth_mesh(builder, **shape, tri_aniso_ke=stretch, edge_aniso_ke=wp.vec3(2e-6, 1e-6, 5e-6))
    else:
        builder.add_cloth_mesh(**shape, tri_ke=STIFFNESS, tri_ka=STIFFNESS, tri_kd=0.0, edge_ke=1e-3, edge_kd=0.0)
    for pin in sheet.pins:
        builder.particle_mass[pin] = 0.0
        builder.particle_flags[pin] &= ~newton.ParticleFlags.ACTIVE
    if setting.startswith("style3d"):
        model = builder.finalize()
        return model, SolverStyle3D(model, config=SolverStyle3D.Config(iterations=iterations))
    builder.color(include_bending=True)
    model = builder.finalize()
    return model, SolverVBD(model, iterations=iterations)


wp.config.quiet = True
wp.set_device("cpu")
sheet, frames, setting = arguments(list(SETTINGS))
substeps, iterations = SETTINGS[setting]
model, solver = build(sheet, setting, iterations)
states = [model.state(), model.state()]
control = model.control()
contacts = newton.CollisionPipeline(model).contacts()  # empty, but Style3D requires it


def advance() -> None:
    for _ in range(substeps):
        states[0].clear_forces()
        solver.step(states[0], states[1], control, contacts, FRAME / substeps)
        states.reverse()


def positions() -> Array:
    return states[0].particle_q.numpy().astype(np.float64)


run("Newton", version("newton"), setting, sheet, frames, advance, positions)
