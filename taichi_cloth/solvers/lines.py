"""`lines`: XPBD that solves every row, column and diagonal of springs directly, in implicit steps of second order.

A pull passes through the whole sheet in one iteration instead of from neighbor to neighbor, so few iterations suffice
however stiff and fine the cloth is. Bend springs take one pass of plain XPBD. With `tethers` it is the solver for
pinned sheets that are to be stiff at few substeps.

XPBD's steps are backward Euler, of first order; `two_stage.py` combines two of them to one of second order. Bending is
explicit: its force is that at the positions after the drift.
"""

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.grid import MAX_BEND_COLORS
from ..geometry.stability_bounds import min_line_substeps
from ..geometry.topology import Topology
from ..kernels.line_solver import clear_line_multipliers, prepare_frame, solve_lines
from ..kernels.springs import DISTANCE_XPBD, add_bending_forces, for_each_spring_from
from ..scene.schema import FRAME_SECONDS
from ..state import ClothState
from ..state.solver_data import attach_line_packets, attach_lines
from .base import Features
from .two_stage import STAGE_LENGTH, TwoStageSolver, accelerate, begin_stage, move_with_velocity


@ti.func
def predict(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    if ctx.s == 0:
        prepare_frame(cloth)
    h = ctx.h * STAGE_LENGTH
    begin_stage(cloth, features, ctx)
    add_bending_forces(cloth, features, ctx.params, h)
    accelerate(cloth, ctx.params, h)
    clear_line_multipliers(cloth)


@ti.func
def iterate(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    h = ctx.h * STAGE_LENGTH
    solve_lines(cloth, features, ctx.params, h)
    first = cloth.lines.first_bend[None]
    for_each_spring_from(cloth, features, first, MAX_BEND_COLORS, DISTANCE_XPBD, ctx.params, h)
    move_with_velocity(cloth, h)


class Lines(TwoStageSolver):
    """XPBD with direct solution of lines of springs, in substeps of two stages."""

    predict = staticmethod(predict)
    iterate = staticmethod(iterate)
    needs_previous_positions = False  # the line solver changes velocities itself

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], features: Features, layout: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, features, layout)
        if self.layout.is_simd:
            attach_line_packets(self.layout, topology, stiffness)
        else:
            attach_lines(self.layout, topology)
        self.line_substeps = min_line_substeps(topology, topology.extent, FRAME_SECONDS)

    def min_stable_substeps(self, damping_time: float) -> int:
        return max(super().min_stable_substeps(damping_time), self.line_substeps)
