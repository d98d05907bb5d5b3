"""Runs one part of a substep in a launch of its own, on one thread, as `run_frame` runs all of them."""

import taichi as ti

from taichi_cloth.kernels.controls import Substep, row, table


@ti.kernel
def run_serially(
    part: ti.template(),
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: row,
    bodies: table,
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        part(cloth, stages, ti.static(Substep(s, substeps, h, held, controls, bodies)))
