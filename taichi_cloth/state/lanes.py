"""The same cloth cut into eight strips that SIMD instructions work on side by side (`mesh/strips.py`).

A working copy for the length of a frame: loaded from the particles, moved, stored back. Whoever looks at a
cloth between frames sees the particles only.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..kernels.whole import placed
from ..mesh import strips
from ..mesh.grid import DIRECTIONS
from ..mesh.topology import Topology
from . import fields
from .held import Held, room_to_hold
from .pool import Pool


@dataclass(eq=False)
class LaneState:
    """Fields of one grid in strips; names and units as in `ClothState`. A slot holds eight particles."""

    in_lanes: ClassVar[bool] = True
    gathers: ClassVar[bool] = False

    x: Any  # 4×8 (S,)
    x_prev: Any
    velocity: Any
    force: Any
    inverse_mass: Any  # row of eight (S,)
    rest: Any  # row of eight (6·S,) by direction, then by the upper left of the spring's place
    multiplier: Any
    stiffness: Any  # row of eight (6·3·pitch,) by direction, kind of row, slot in the row; 0: no spring
    has_cell: Any  # row of eight (pitch,) 1 where a cell begins in this column
    used: Any  # (6,) 1 for each direction that has springs or bonds
    passes: Any  # (P, PASS_COLUMNS) a sweep colour by colour
    held: Held  # what the hand holds
    pass_count: Any  # 0-D
    rows: Any  # 0-D
    columns: Any  # 0-D
    pitch: Any  # 0-D slots in a row
    slot_count: Any  # 0-D
    spring_count: Any  # 0-D

    def upload(self, topology: Topology, stiffness: NDArray[np.float64], pitch: int, *, coloured: bool) -> None:
        """Fills all that a frame does not load. `stiffness`: of every spring, (E,)."""
        rows, columns = topology.shape
        by_place = topology.by_place(stiffness)
        sprung = by_place.max(axis=(1, 2)) > 0
        bonded = np.isin(np.arange(len(DIRECTIONS)), topology.bonds.direction)
        table = strips.passes(sprung & coloured, pitch)

        def packed(values: NDArray[Any]) -> NDArray[Any]:
            return strips.pack(values, pitch).reshape(-1, strips.STRIPS)

        fields.put_all(
            (self.rest, packed(topology.by_place(topology.rest))),
            (self.stiffness, packed(by_place[:, strips.row_kinds(rows)])),
            (self.has_cell, packed(np.arange(columns) < columns - 1)),
            (self.used, sprung | bonded),
            (self.passes, table),
        )
        self.pass_count[None] = len(table)
        self.rows[None], self.columns[None], self.pitch[None] = rows, columns, pitch
        self.slot_count[None] = rows * pitch
        self.spring_count[None] = len(DIRECTIONS) * rows * pitch


def _allocate(slots: int, pitch: int) -> LaneState:
    room = 2 * slots  # REACH more for each row, of REACH slots at least: kernels keep neighbours of another lane there

    def places() -> Any:
        return fields.places(room, lanes=True)

    def numbers(count: int) -> Any:
        return fields.numbers(count, lanes=True)

    return LaneState(
        x=places(),
        x_prev=places(),
        velocity=places(),
        force=places(),
        inverse_mass=numbers(room),
        rest=numbers(len(DIRECTIONS) * slots),
        multiplier=numbers(len(DIRECTIONS) * slots),
        stiffness=numbers(len(DIRECTIONS) * strips.ROW_KINDS * pitch),
        has_cell=numbers(pitch),
        used=fields.numbers(len(DIRECTIONS), kind=ti.i32),
        passes=fields.rows(strips.PASS_COLUMNS, 2 * len(DIRECTIONS)),
        held=room_to_hold(strips.STRIPS * room),
        pass_count=fields.number(),
        rows=fields.number(),
        columns=fields.number(),
        pitch=fields.number(),
        slot_count=fields.number(),
        spring_count=fields.number(),
    )


_pool = Pool(lambda *size: placed(lambda: _allocate(*size)))


def take(topology: Topology, stiffness: NDArray[np.float64], *, coloured: bool) -> LaneState:
    """A grid in strips, ready to be loaded. `coloured`: for sweeps that move particles as they go.

    Strips are no wider than their springs need: 33 columns without springs against bending stand in 48 instead of 64.
    """
    rows, columns = topology.shape
    reach = strips.reach(topology.by_place(stiffness).max(axis=(1, 2)) > 0) if coloured else 1
    pitch = strips.pitch(columns, 2 * reach)
    lanes = _pool.take(rows * pitch, pitch)
    lanes.upload(topology, stiffness, pitch, coloured=coloured)
    return lanes


def give_back(lanes: LaneState) -> None:
    """Keeps the fields for the next grid of its size."""
    _pool.give_back(lanes)
