"""`lines`: XPBD in which every row, every column and every diagonal of springs is solved exactly as a chain.

A pull then passes through the whole sheet in one iteration and not from neighbour to neighbour, so that one iteration
in a substep is enough however stiff and fine the cloth is. Bend springs take one pass of plain XPBD. With `tethers` it
is the method for pinned sheets that are to be stiff at few substeps.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..contact.push_out import push_out
from ..kernels.chains import begin_frame, forget_chains, solve_chains
from ..kernels.controls import KEPT
from ..kernels.forces import add_air, forget_forces
from ..kernels.grab import lead_held
from ..kernels.motion import drift, kick, take_up_corrections
from ..kernels.places import LANES
from ..kernels.springs import for_springs_from, limit_strain, relax_compliant
from ..kernels.tethers import pull_tethers
from ..mesh import strips
from ..mesh.chains import CHAIN_COLUMNS, CHAINED, chains
from ..mesh.grid import DIRECTIONS
from ..mesh.topology import Topology
from ..state import ClothState, padded
from .base import Solver, Stages


@ti.func
def before(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    if s == 0:
        begin_frame(cloth)
    forget_forces(cloth)
    add_air(cloth, stages, controls, h, s * h)
    kick(cloth, controls, h, controls[KEPT])
    drift(cloth, h)
    lead_held(cloth, stages, held, controls, (s + 1) / substeps, h * substeps)
    forget_chains(cloth)


@ti.func
def sweep(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    solve_chains(cloth, stages, controls, h)
    for_springs_from(cloth, stages, cloth.chains.first_bend[None], relax_compliant, controls, h)


@ti.func
def after(
    cloth: ti.template(),
    stages: ti.template(),
    s: int,
    substeps: int,
    h: float,
    held: int,
    controls: ti.template(),
    spheres: ti.template(),
    boxes: ti.template(),
    ground: ti.template(),
):
    pull_tethers(cloth, stages, s, held, controls)
    push_out(cloth, stages, spheres, boxes, ground, (s + 1) / substeps, 1.0 / substeps)
    limit_strain(cloth, stages, controls, h)
    take_up_corrections(cloth, h)


@dataclass(eq=False)
class ChainList:
    """Fields of the chains of a list of springs; scratch stands in the order of the chains."""

    table: Any  # (E, CHAIN_COLUMNS)
    springs: Any  # (E,) index of each spring of the chains
    normal: Any  # vec3 (E,)
    coupling: Any  # (E,)
    change: Any  # [kg·m] (E,)
    count: Any  # 0-D
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


def number() -> Any:
    return ti.field(ti.i32, ())


def list_chains(cloth: ClothState, topology: Topology) -> None:
    """Gives a cloth its `chains`, filled. They stay with its fields, which are used again, like their kernels."""
    if not hasattr(cloth, "chains"):
        room = cloth.rest.shape[0]
        cloth.chains = ChainList(  # type: ignore[attr-defined]
            table=ti.Vector.field(CHAIN_COLUMNS, ti.i32, room),
            springs=ti.field(ti.i32, room),
            normal=ti.Vector.field(3, ti.f32, room),
            coupling=ti.field(ti.f32, room),
            change=ti.field(ti.f32, room),
            count=number(),
            first_bend=number(),
        )
    found: ChainList = cloth.chains  # type: ignore[attr-defined]
    table, order = chains(topology)
    found.table.from_numpy(padded(table, found.table.shape[0]))
    found.springs.from_numpy(padded(order, found.springs.shape[0]))
    found.count[None] = len(table)
    found.first_bend[None] = sum(batch.direction in CHAINED for batch in topology.batches)


def strip_chains(lanes: Any, topology: Topology, stiffness: NDArray[np.float64]) -> None:
    """The same for a grid in strips."""
    rows, columns = topology.shape
    if not hasattr(lanes, "chains"):
        slots, pitch = lanes.x.shape[0], lanes.has_cell.shape[0]
        room = slots + slots // 2 + 24 * pitch + 16  # for any grid of these slots, by row, with a margin, and crossed

        def places() -> Any:
            return ti.Matrix.field(3, LANES, ti.f32, room)

        def numbers() -> Any:
            return ti.Vector.field(LANES, ti.f32, room)

        def made_links() -> Links:
            return Links(normal=places(), share=numbers(), coupling=numbers(), change=numbers())

        lanes.chains = ChainStrips(
            links=made_links(),
            crossed=Crossed(
                x=places(),
                x_prev=places(),
                inverse_mass=numbers(),
                rest=numbers(),
                multiplier=numbers(),
                stiffness=numbers(),
                links=made_links(),
                rows=number(),
                pitch=number(),
                spring_count=number(),
            ),
            directions=ti.Vector.field(2, ti.i32, len(CHAINED)),
            direction_count=number(),
            has_rows=number(),
            first_bend=number(),
        )
    found: ChainStrips = lanes.chains
    crossed = found.crossed
    for links in (found.links, crossed.links):
        for scratch in vars(links).values():
            scratch.fill(0.0)
    pitch = strips.pitch(rows, 1)
    crossed.rows[None], crossed.pitch[None], crossed.spring_count[None] = columns, pitch, columns * pitch
    rest = topology.by_place(topology.rest)[0].T.astype(np.float32)
    by_place = topology.by_place(stiffness)
    kinds = by_place[0].T[strips.row_kinds(columns)].astype(np.float32)
    for field, values in ((crossed.rest, rest), (crossed.stiffness, kinds)):
        packed = strips.pack(values, pitch).reshape(-1, strips.STRIPS)
        field.from_numpy(padded(packed, field.shape[0]))
    used = by_place.max(axis=(1, 2)) > 0
    down = [(d, DIRECTIONS[d][2]) for d in CHAINED if used[d] and DIRECTIONS[d][1]]
    found.directions.from_numpy(padded(np.array(down, np.int32).reshape(-1, 2), len(CHAINED)))
    found.direction_count[None] = len(down)
    found.has_rows[None] = int(used[0])
    found.first_bend[None] = 2 * int(used[list(CHAINED)].sum())


class Lines(Solver):
    """Advances a cloth by XPBD on chains."""

    name = "lines"
    springs = "fabric"
    before = staticmethod(before)
    sweep = staticmethod(sweep)
    after = staticmethod(after)

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        super().__init__(cloth, topology, stiffness, stages, path)
        if self._lanes is not None:
            strip_chains(self._lanes, topology, stiffness)
        else:
            list_chains(cloth, topology)
