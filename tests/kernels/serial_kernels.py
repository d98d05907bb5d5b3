"""Runs one phase of a substep in a launch of its own, on one thread, as `run_frame` runs all of them."""

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.kernels.springs import add_elastic_forces
from taichi_cloth.kernels.step_params import COLLIDER_COLUMNS, StepContext, collider_array, param_array
from taichi_cloth.simulation.builder import StepRow
from taichi_cloth.simulation.simulation import Simulation

NO_COLLIDER = np.zeros((1, COLLIDER_COLUMNS), np.float32)


@ti.kernel
def run_serially(
    phase: ti.template(),
    cloth: ti.template(),
    features: ti.template(),
    s: int,
    substeps: int,
    h: float,
    grabbed_count: int,
    params: param_array,
    colliders: collider_array,
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        phase(cloth, features, ti.static(StepContext(s, substeps, h, grabbed_count, params, colliders)))


def frame_params(simulation: Simulation) -> np.ndarray:
    """Return the parameter row of a frame, with the constants of a membrane or the curves of a weave."""
    row = StepRow(simulation.scene, simulation.topology, simulation.scene.fabric.damping_time)
    values = {name: simulation.params[name] for name in simulation.params}
    return row.at(values, wind_on=False, grabs={}, origin=simulation.origin, seconds=0.0, h=1e-3)


@ti.func
def elastic_forces(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    add_elastic_forces(cloth, features, ctx.params, ctx.h)


def check_elastic_forces(simulation: Simulation) -> None:
    """Compare the forces of the cloth in the serial layout with those of its float64 model."""
    layout, params = simulation.solver.layout, frame_params(simulation)
    run_serially(elastic_forces, layout, simulation.solver.features, 0, 1, 1e-3, 0, params, NO_COLLIDER)
    found = simulation.solver.cloth.to_numpy(layout.force)
    model, velocities = spring_model(simulation.scene, simulation.topology), simulation.velocities().T
    expected = model.elastic_force(simulation.positions().T)
    expected += model.damping_force(simulation.positions().T, velocities)
    assert found == pytest.approx(expected.T, abs=2e-4 * np.abs(expected).max())
