"""Runs one phase of a substep in a launch of its own, on one thread, as `run_frame` runs all of them."""

import taichi as ti

from taichi_cloth.kernels.step_params import StepContext, collider_array, param_array


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
