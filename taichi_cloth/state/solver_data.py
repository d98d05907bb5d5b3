"""Fields that single solvers add to a layout: lines, conjugate gradients, and copies of the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry import simd_layout
from ..geometry.grid import DIRECTIONS
from ..geometry.simd_layout import (
    DIRECTION_COLUMNS,
    LANES,
    LAYOUT_COLUMNS,
    LINE_COLUMNS,
    LINE_DIRECTIONS,
    LINE_FIRST,
    ROW_CLASSES,
    spring_lines,
)
from ..geometry.topology import Topology
from . import field_pool as fields
from .field_pool import build, vector_field_like

if TYPE_CHECKING:
    from .cloth_state import Layout
    from .layouts import SimdLayout


@dataclass(eq=False)
class LineList:
    """Lines of springs one after another. Scratch fields are in the order of the lines."""

    table: ti.MatrixField
    """Description of every line, (E, LINE_COLUMNS)."""
    springs: ti.ScalarField
    """Springs of the lines in order, (E,)."""
    normal: ti.MatrixField
    coupling: ti.ScalarField
    change: ti.ScalarField
    """Change of the multiplier [kg·m]."""
    first: ti.ScalarField
    """First line of every direction, and the number of all, (5,)."""
    first_bend: ti.ScalarField
    """First color of bend springs, 0-D."""


@dataclass(eq=False)
class LinePackets:
    """Lines of springs in the SIMD layout, eight at once: the lines of rows in a transposed layout of their own."""

    x: ti.MatrixField
    x_prev: ti.MatrixField
    moved: ti.MatrixField
    """Displacement by the line solver since the positions were copied here [m]."""
    inverse_mass: ti.ScalarField
    rest: ti.ScalarField
    """Rest length [m], by direction."""
    multiplier: ti.ScalarField
    stiffness: ti.ScalarField
    """Stiffness, by direction and row class."""
    normal: ti.MatrixField
    k_over_pivot: ti.ScalarField
    """k·h² over the pivot of every spring [kg]."""
    coupling: ti.ScalarField
    change: ti.ScalarField
    """Change of the multiplier [kg·m]."""
    layouts: ti.MatrixField
    """Description of the transposed layout and of the cloth's own, (2, LAYOUT_COLUMNS)."""
    directions: ti.MatrixField
    """Description of every direction, (4, DIRECTION_COLUMNS)."""
    spring_count: ti.ScalarField
    """Spring packets in all directions, 0-D."""
    first_bend: ti.ScalarField
    """First color pass of bend springs, 0-D."""


def attach_lines(layout: Layout, topology: Topology) -> None:
    """Set `layout.lines` of a serial or parallel layout."""
    lines = layout.lines
    if not isinstance(lines, LineList):
        lines = layout.lines = _allocate_list(layout.rest.shape[0])
    table, order = spring_lines(topology)
    first = np.searchsorted(topology.direction[order[table[:, LINE_FIRST]]], [*LINE_DIRECTIONS, len(LINE_DIRECTIONS)])
    fields.upload_all((lines.table, table), (lines.springs, order), (lines.first, first))
    lines.first_bend[None] = sum(batch.direction in LINE_DIRECTIONS for batch in topology.batches)


def attach_line_packets(layout: SimdLayout, topology: Topology, stiffness: NDArray[np.float64]) -> None:
    """Set `layout.lines` of a SIMD layout. `stiffness` of every spring, (E,)."""
    lines = layout.lines
    if not isinstance(lines, LinePackets):
        packets, stride = layout.x.shape[0], layout.has_cell.shape[0]
        lines = layout.lines = build(layout, lambda: _allocate_packets(packets, stride))
    rest, stiff = topology.as_grid(topology.rest), topology.as_grid(stiffness)
    used = stiff.max(axis=(1, 2)) > 0
    rows, columns = topology.shape
    shapes = ((columns, simd_layout.row_stride(rows, 1)), (rows, layout.row_stride[None]))
    layouts = np.zeros((2, LAYOUT_COLUMNS), np.int32)
    directions: list[list[int]] = []
    masses = links = springs = classes = 0
    all_rest: list[NDArray[np.float64]] = []
    all_stiffness: list[NDArray[np.float64]] = []
    for untransposed, (height, row_stride) in enumerate(shapes):
        start = len(directions)
        for d in LINE_DIRECTIONS:
            _, down, along = DIRECTIONS[d]
            if used[d] and bool(down) == bool(untransposed):
                oriented = (rest[d], stiff[d]) if untransposed else (rest[d].T, stiff[d].T)
                directions.append([along if untransposed else 0, springs, classes])
                by_class = oriented[1][simd_layout.row_classes(height)]
                for values, into in ((oriented[0], all_rest), (by_class, all_stiffness)):
                    into.append(simd_layout.pack(values, row_stride).reshape(-1, LANES))
                springs, classes = springs + height * row_stride, classes + ROW_CLASSES * row_stride
        layouts[untransposed] = height, row_stride, masses, links, start, len(directions)
        masses, links = masses + height * row_stride, links + (height + 1) * (row_stride + 2)
    nothing = np.zeros((0, LANES))
    fields.upload_all(
        (lines.rest, np.concatenate([nothing, *all_rest])),
        (lines.stiffness, np.concatenate([nothing, *all_stiffness])),
        (lines.layouts, layouts),
        (lines.directions, np.array(directions, np.int32).reshape(-1, DIRECTION_COLUMNS)),
        # The row above the springs and the row below them stay zero.
        *((scratch, nothing) for scratch in (lines.k_over_pivot, lines.coupling, lines.change)),
        (lines.normal, np.zeros((0, 3, LANES))),
    )
    lines.spring_count[None] = springs
    lines.first_bend[None] = 2 * int(used[list(LINE_DIRECTIONS)].sum())


def _allocate_list(count: int) -> LineList:
    return LineList(
        table=ti.Vector.field(LINE_COLUMNS, ti.i32, count),
        springs=fields.scalar_field(count, dtype=ti.i32),
        normal=fields.vector_field(count),
        coupling=fields.scalar_field(count),
        change=fields.scalar_field(count),
        first=fields.scalar_field(len(LINE_DIRECTIONS) + 1, dtype=ti.i32),
        first_bend=fields.count_field(),
    )


def _allocate_packets(packets: int, row_stride: int) -> LinePackets:
    transposed = packets + 8 * row_stride  # packets of the layout of rows
    links = 3 * packets + packets // 8 + 32 * row_stride + 16  # of both, each with two more columns and two more rows

    def vectors(count: int) -> ti.MatrixField:
        return fields.vector_field(count, simd=True)

    def scalars(count: int) -> ti.ScalarField:
        return fields.scalar_field(count, simd=True)

    return LinePackets(
        x=vectors(transposed + 1),
        x_prev=vectors(transposed + 1),
        moved=vectors(transposed),
        inverse_mass=scalars(packets + transposed + 1),
        rest=scalars(3 * packets + transposed),
        multiplier=scalars(3 * packets + transposed),
        stiffness=scalars(ROW_CLASSES * (3 * row_stride + packets)),
        normal=vectors(links),
        k_over_pivot=scalars(links),
        coupling=scalars(links),
        change=scalars(links),
        layouts=fields.soa_vector_field(LAYOUT_COLUMNS, 2),
        directions=fields.soa_vector_field(DIRECTION_COLUMNS, len(LINE_DIRECTIONS)),
        spring_count=fields.count_field(),
        first_bend=fields.count_field(),
    )


if TYPE_CHECKING:
    from .cloth_state import ClothState, Layout


@dataclass(eq=False)
class StageSums:
    """What the four stages of a Runge–Kutta substep accumulate (`rk4`)."""

    velocity: ti.MatrixField
    """Weighted sum of the stages' velocities [m/s]."""
    acceleration: ti.MatrixField
    """Weighted sum of the stages' accelerations [m/s²]."""
    first_velocity: ti.MatrixField
    """Velocity at the start of the substep [m/s]."""


@dataclass(eq=False)
class StageStart:
    """The start of a stage (`lines`), beside the position `x_prev`."""

    velocity: ti.MatrixField
    """Velocity at the start [m/s]; after the first solve, what the extrapolation adds to it."""


@dataclass(eq=False)
class StateSnapshot:
    """A copy of all that moves."""

    x: ti.MatrixField
    x_prev: ti.MatrixField
    velocity: ti.MatrixField


def attach_stage_sums(layout: Layout) -> None:
    """Allocate `layout.stage_sums`."""
    if layout.stage_sums is None:
        layout.stage_sums = build(layout, lambda: StageSums(*(vector_field_like(layout) for _ in range(3))))


def attach_stage_start(layout: Layout) -> None:
    """Allocate `layout.stage_start`."""
    if layout.stage_start is None:
        layout.stage_start = build(layout, lambda: StageStart(vector_field_like(layout)))


def attach_correction(layout: Layout) -> None:
    """Allocate `layout.correction`."""
    if layout.correction is None:
        layout.correction = build(layout, lambda: vector_field_like(layout))


def snapshots_of(cloth: ClothState) -> tuple[StateSnapshot, StateSnapshot]:
    """Return room for two copies of the cloth's state."""
    if cloth.snapshots is None:
        first, second = (StateSnapshot(*(vector_field_like(cloth) for _ in range(3))) for _ in range(2))
        cloth.snapshots = first, second
    return cloth.snapshots
