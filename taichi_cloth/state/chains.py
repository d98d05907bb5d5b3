"""Fields of the chains of a grid (`mesh/chains.py`, `kernels/chains.py`)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..mesh import strips
from ..mesh.chains import CHAIN_COLUMNS, CHAINED, FIRST, chains
from ..mesh.grid import DIRECTIONS
from ..mesh.topology import Topology
from . import fields
from .pool import attached


@dataclass(eq=False)
class ChainList:
    """The chains of a list of springs; scratch stands in the order of the chains."""

    table: Any  # (E, CHAIN_COLUMNS)
    springs: Any  # (E,) index of each spring of the chains
    normal: Any  # vec3 (E,)
    coupling: Any  # (E,)
    change: Any  # [kg·m] (E,)
    first: Any  # (5,) first chain of each direction, and the count of all
    first_bend: Any  # 0-D the first batch of bend springs


@dataclass(eq=False)
class Links:
    """Scratch of the chains in one set of strips, for one direction after another (`kernels.chains.solve_strips`)."""

    normal: Any  # 3×8
    share: Any  # row of eight
    coupling: Any
    change: Any


@dataclass(eq=False)
class Crossed:
    """The strips of rows: as `LaneState`, with rows and columns changed over, and one direction of springs."""

    x: Any
    x_prev: Any
    inverse_mass: Any
    rest: Any
    multiplier: Any
    stiffness: Any  # (ROW_KINDS·pitch,)
    links: Links
    rows: Any  # 0-D
    pitch: Any  # 0-D
    spring_count: Any  # 0-D


@dataclass(eq=False)
class ChainStrips:
    """What the strips of a grid need for their chains."""

    links: Links
    crossed: Crossed
    directions: Any  # (4,) direction of springs, and its step along the columns; those that go down the rows
    direction_count: Any  # 0-D
    has_rows: Any  # 0-D whether rows have springs
    first_bend: Any  # 0-D the first pass of bend springs


def list_chains(cloth: Any, topology: Topology) -> None:
    """Gives a cloth its `chains`, filled."""
    found = attached(cloth, "chains", lambda: _allocate_list(cloth.rest.shape[0]))
    table, order = chains(topology)
    fields.put(found.table, table)
    fields.put(found.springs, order)
    fields.put(found.first, np.searchsorted(topology.direction[order[table[:, FIRST]]], [*CHAINED, len(CHAINED)]))
    found.first_bend[None] = sum(batch.direction in CHAINED for batch in topology.batches)


def strip_chains(lanes: Any, topology: Topology, stiffness: NDArray[np.float64]) -> None:
    """The same for a grid in strips. `stiffness`: of every spring, (E,)."""
    rows, columns = topology.shape
    found = attached(lanes, "chains", lambda: _allocate_strips(lanes.x.shape[0], lanes.has_cell.shape[0]))
    crossed = found.crossed
    for links in (found.links, crossed.links):
        for scratch in vars(links).values():
            scratch.fill(0.0)
    pitch = strips.pitch(rows, 1)
    crossed.rows[None], crossed.pitch[None], crossed.spring_count[None] = columns, pitch, columns * pitch
    by_place = topology.by_place(stiffness)
    rest, kinds = topology.by_place(topology.rest)[0].T, by_place[0].T[strips.row_kinds(columns)]
    for field, values in ((crossed.rest, rest), (crossed.stiffness, kinds)):
        fields.put(field, strips.pack(values, pitch).reshape(-1, strips.STRIPS))
    used = by_place.max(axis=(1, 2)) > 0
    down = [(d, DIRECTIONS[d][2]) for d in CHAINED if used[d] and DIRECTIONS[d][1]]
    fields.put(found.directions, np.array(down).reshape(-1, 2))
    found.direction_count[None] = len(down)
    found.has_rows[None] = int(used[0])
    found.first_bend[None] = 2 * int(used[list(CHAINED)].sum())


def _allocate_list(room: int) -> ChainList:
    return ChainList(
        table=ti.Vector.field(CHAIN_COLUMNS, ti.i32, room),
        springs=fields.numbers(room, kind=ti.i32),
        normal=fields.places(room),
        coupling=fields.numbers(room),
        change=fields.numbers(room),
        first=fields.numbers(len(CHAINED) + 1, kind=ti.i32),
        first_bend=fields.number(),
    )


def _allocate_strips(slots: int, pitch: int) -> ChainStrips:
    room = slots + slots // 2 + 24 * pitch + 16  # for any grid of these slots, by row, with a margin, and crossed

    def places() -> Any:
        return fields.places(room, lanes=True)

    def numbers() -> Any:
        return fields.numbers(room, lanes=True)

    def links() -> Links:
        return Links(normal=places(), share=numbers(), coupling=numbers(), change=numbers())

    return ChainStrips(
        links=links(),
        crossed=Crossed(
            x=places(),
            x_prev=places(),
            inverse_mass=numbers(),
            rest=numbers(),
            multiplier=numbers(),
            stiffness=numbers(),
            links=links(),
            rows=fields.number(),
            pitch=fields.number(),
            spring_count=fields.number(),
        ),
        directions=ti.Vector.field(2, ti.i32, len(CHAINED)),
        direction_count=fields.number(),
        has_rows=fields.number(),
        first_bend=fields.number(),
    )
