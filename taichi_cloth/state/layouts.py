"""The layouts other than serial: packets of eight particles for SIMD, and adjacency for one thread a particle."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry import simd_layout
from ..geometry.grid import DIRECTIONS
from ..geometry.simd_layout import LANES
from ..geometry.topology import Topology, adjacency
from ..kernels.tensor_fields import materialized
from . import field_pool as fields
from .cloth_state import ClothState, Layout
from .constraint_data import allocate_grabbed
from .field_pool import Pool


@dataclass(eq=False, kw_only=True)
class SimdLayout(Layout):
    """A grid in packets of eight particles (`geometry/simd_layout.py`).

    It is a working copy for one frame: packed from the serial state, moved, and unpacked. Between frames only the
    serial state is valid. Springs are stored by direction, then by their upper left particle.
    """

    is_simd: ClassVar[bool] = True

    has_cell: ti.ScalarField
    """1 where a cell begins in this column, else 0, (row_stride,)."""
    used: ti.ScalarField
    """1 for every direction that has springs or bending links, (6,)."""
    passes: ti.MatrixField
    """The color passes of a sweep, (passes, PASS_COLUMNS)."""
    pass_count: ti.ScalarField
    rows: ti.ScalarField
    columns: ti.ScalarField
    row_stride: ti.ScalarField
    """Packets in a row, 0-D."""

    def upload(self, topology: Topology, stiffness: NDArray[np.float64], row_stride: int, *, colored: bool) -> None:
        """Set all that a frame does not pack. `stiffness` of every spring, (E,)."""
        rows, columns = topology.shape
        on_grid = topology.as_grid(stiffness)
        with_springs = on_grid.max(axis=(1, 2)) > 0
        with_links = np.isin(np.arange(len(DIRECTIONS)), topology.bending_links.direction)
        table = simd_layout.color_passes(with_springs & colored, row_stride)

        def packed(values: NDArray[np.generic]) -> NDArray[np.generic]:
            return simd_layout.pack(values, row_stride).reshape(-1, LANES)

        fields.upload_all(
            (self.rest, packed(topology.as_grid(topology.rest))),
            (self.stiffness, packed(on_grid[:, simd_layout.row_classes(rows)])),
            (self.has_cell, packed(np.arange(columns) < columns - 1)),
            (self.used, with_springs | with_links),
            (self.passes, table),
        )
        self.pass_count[None] = len(table)
        self.rows[None], self.columns[None], self.row_stride[None] = rows, columns, row_stride
        self.packet_count[None] = rows * row_stride
        self.spring_count[None] = len(DIRECTIONS) * rows * row_stride


def _allocate(packets: int, row_stride: int) -> SimdLayout:
    with_halo = 2 * packets  # the halo has MAX_REACH packets a row, and a row has at least as many

    def vectors() -> ti.MatrixField:
        return fields.vector_field(with_halo, simd=True)

    def scalars(count: int) -> ti.ScalarField:
        return fields.scalar_field(count, simd=True)

    return SimdLayout(
        x=vectors(),
        x_prev=vectors(),
        velocity=vectors(),
        force=vectors(),
        inverse_mass=scalars(with_halo),
        rest=scalars(len(DIRECTIONS) * packets),
        multiplier=scalars(len(DIRECTIONS) * packets),
        stiffness=scalars(len(DIRECTIONS) * simd_layout.ROW_CLASSES * row_stride),
        has_cell=scalars(row_stride),
        used=fields.scalar_field(len(DIRECTIONS), dtype=ti.i32),
        passes=fields.soa_vector_field(simd_layout.PASS_COLUMNS, 2 * len(DIRECTIONS)),
        grabbed=allocate_grabbed(LANES * with_halo),
        pass_count=fields.count_field(),
        rows=fields.count_field(),
        columns=fields.count_field(),
        row_stride=fields.count_field(),
        packet_count=fields.count_field(),
        spring_count=fields.count_field(),
    )


_pool = Pool(lambda *capacities: materialized(lambda: _allocate(*capacities)))


def acquire_simd(topology: Topology, stiffness: NDArray[np.float64], *, colored: bool) -> SimdLayout:
    """Return a SIMD layout for a grid, ready to be packed. `colored`: for solvers that move particles in a sweep.

    Strips are no wider than springs need: 33 columns without bend springs take 48 columns of packets instead of 64.
    """
    rows, columns = topology.shape
    reach = simd_layout.column_reach(topology.as_grid(stiffness).max(axis=(1, 2)) > 0) if colored else 1
    row_stride = simd_layout.row_stride(columns, 2 * reach)
    layout = _pool.acquire(rows * row_stride, row_stride)
    layout.upload(topology, stiffness, row_stride, colored=colored)
    return layout


def release_simd(layout: SimdLayout) -> None:
    """Make the fields available for the next grid of their size."""
    _pool.release(layout)


@dataclass(eq=False, kw_only=True)
class ParallelLayout(ClothState):
    """The serial state's own fields, with the springs and triangles of every particle: each thread gathers its own.

    Springs of particle i are `spring_rows[spring_first[i]:spring_first[i + 1]]`, and likewise for triangles. Nothing is
    copied for a frame.
    """

    is_parallel: ClassVar[bool] = True

    spring_first: ti.ScalarField
    spring_rows: ti.ScalarField
    triangle_first: ti.ScalarField
    triangle_rows: ti.ScalarField

    def upload_adjacency(self, topology: Topology) -> None:
        """Set what the serial state does not have."""
        spring_first, spring_rows = adjacency(topology.ends, topology.particle_count)
        triangle_first, triangle_rows = adjacency(topology.triangles, topology.particle_count)
        fields.upload_all(
            (self.spring_first, spring_first),
            (self.spring_rows, spring_rows),
            (self.triangle_first, triangle_first),
            (self.triangle_rows, triangle_rows),
        )


def acquire_parallel(cloth: ClothState, topology: Topology) -> ParallelLayout:
    """Return the parallel layout of a cloth. It stays with the cloth's fields."""
    if not isinstance(cloth.parallel, ParallelLayout):
        shared = {field.name: getattr(cloth, field.name) for field in dataclasses.fields(cloth)}
        particles, springs, triangles = (f.shape[0] for f in (cloth.x, cloth.rest, cloth.triangles))
        cloth.parallel = ParallelLayout(
            **shared,
            spring_first=fields.scalar_field(particles + 1, dtype=ti.i32),
            spring_rows=fields.scalar_field(2 * springs, dtype=ti.i32),
            triangle_first=fields.scalar_field(particles + 1, dtype=ti.i32),
            triangle_rows=fields.scalar_field(3 * triangles, dtype=ti.i32),
        )
    cloth.parallel.upload_adjacency(topology)
    return cloth.parallel
