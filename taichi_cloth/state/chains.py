"""Fields of the chains of a grid (`mesh/chains.py`, `kernels/chains.py`)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..mesh import strips
from ..mesh.chains import CHAIN_COLUMNS, CHAINED, DIRECTION_COLUMNS, FIRST, LAYOUT_COLUMNS, chains
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
class ChainStrips:
    """The strips in which a grid's chains are solved, one layout after the other (`mesh/chains.py`)."""

    x: Any  # 4×8
    x_prev: Any
    moved: Any  # [m] by chains, since they were laid
    inverse_mass: Any  # row of eight
    rest: Any  # by direction
    multiplier: Any
    stiffness: Any  # by direction and kind of row
    normal: Any  # scratch of one direction
    share: Any
    coupling: Any
    change: Any
    layouts: Any  # (2, LAYOUT_COLUMNS)
    directions: Any  # (4, DIRECTION_COLUMNS)
    spring_count: Any  # 0-D slots of springs in all directions
    first_bend: Any  # 0-D the first pass of bend springs


def list_chains(cloth: Any, topology: Topology) -> None:
    """Gives a cloth its `chains`, filled."""
    found = attached(cloth, "chains", lambda: _allocate_list(cloth.rest.shape[0]))
    table, order = chains(topology)
    first = np.searchsorted(topology.direction[order[table[:, FIRST]]], [*CHAINED, len(CHAINED)])
    fields.put_all((found.table, table), (found.springs, order), (found.first, first))
    found.first_bend[None] = sum(batch.direction in CHAINED for batch in topology.batches)


def strip_chains(lanes: Any, topology: Topology, stiffness: NDArray[np.float64]) -> None:
    """The same for a grid in strips. `stiffness`: of every spring, (E,)."""
    found = attached(lanes, "chains", lambda: _allocate_strips(lanes.x.shape[0], lanes.has_cell.shape[0]))
    rest, stiff = topology.by_place(topology.rest), topology.by_place(stiffness)
    used = stiff.max(axis=(1, 2)) > 0
    rows, columns = topology.shape
    shapes = ((columns, strips.pitch(rows, 1)), (rows, lanes.pitch[None]))
    layouts = np.zeros((2, LAYOUT_COLUMNS), np.int32)
    directions: list[list[int]] = []
    masses = links = springs = kinds = 0
    all_rest: list[NDArray[np.float64]] = []
    all_kinds: list[NDArray[np.float64]] = []
    for upright, (height, pitch) in enumerate(shapes):
        start = len(directions)
        for d in CHAINED:
            _, down, along = DIRECTIONS[d]
            if used[d] and bool(down) == bool(upright):
                turned = (rest[d], stiff[d]) if upright else (rest[d].T, stiff[d].T)
                directions.append([along if upright else 0, springs, kinds])
                for values, into in ((turned[0], all_rest), (turned[1][strips.row_kinds(height)], all_kinds)):
                    into.append(strips.pack(values, pitch).reshape(-1, strips.STRIPS))
                springs, kinds = springs + height * pitch, kinds + strips.ROW_KINDS * pitch
        layouts[upright] = height, pitch, masses, links, start, len(directions)
        masses, links = masses + height * pitch, links + (height + 1) * (pitch + 2)
    nothing = np.zeros((0, strips.STRIPS))
    fields.put_all(
        (found.rest, np.concatenate([nothing, *all_rest])),
        (found.stiffness, np.concatenate([nothing, *all_kinds])),
        (found.layouts, layouts),
        (found.directions, np.array(directions, np.int32).reshape(-1, DIRECTION_COLUMNS)),
        # A row above and below the springs stays zero.
        *((scratch, nothing) for scratch in (found.share, found.coupling, found.change)),
        (found.normal, np.zeros((0, 3, strips.STRIPS))),
    )
    found.spring_count[None] = springs
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
    crossed = slots + 8 * pitch  # slots of strips of rows
    links = 3 * slots + slots // 8 + 32 * pitch + 16  # of both layouts, each with two columns and two rows more

    def places(count: int) -> Any:
        return fields.places(count, lanes=True)

    def numbers(count: int) -> Any:
        return fields.numbers(count, lanes=True)

    return ChainStrips(
        x=places(crossed + 1),
        x_prev=places(crossed + 1),
        moved=places(crossed),
        inverse_mass=numbers(slots + crossed + 1),
        rest=numbers(3 * slots + crossed),
        multiplier=numbers(3 * slots + crossed),
        stiffness=numbers(strips.ROW_KINDS * (3 * pitch + slots)),
        normal=places(links),
        share=numbers(links),
        coupling=numbers(links),
        change=numbers(links),
        layouts=fields.rows(LAYOUT_COLUMNS, 2),
        directions=fields.rows(DIRECTION_COLUMNS, len(CHAINED)),
        spring_count=fields.number(),
        first_bend=fields.number(),
    )
