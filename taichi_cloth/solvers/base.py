"""What a solver is given, what it must offer, and the frame that all of them share."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..kernels.controls import Substep, row, table
from ..kernels.forces import forget_forces
from ..kernels.layout import load, store
from ..kernels.whole import kept_whole
from ..mesh.frequency import highest_frequency, longest_dashpot
from ..mesh.topology import Topology
from ..scene.model import COLLIDERS, FRAME_SECONDS
from ..state import ClothState, fields, lanes
from ..state.anchors import anchor
from ..state.bonds import bond
from ..state.distances import Distances
from ..state.gather import gathering
from ..state.leashes import leash
from ..state.near import come_near
from ..state.patches import patch
from ..state.ties import tie
from .launches import Launches

# Largest h·ω of a vibration under forces. Symplectic Euler alone is stable up to 2; with constraints beside the forces
# a compressed strip lies still at 0.7, shakes for ever with one iteration of `xpbd` at 0.9 and with all others at 1.2.
FORCED = 0.7
NONE = (0,) * len(COLLIDERS)


@dataclass(frozen=True)
class Stages:
    """The stages a scene names. Part of the compiled kernel: a stage that is False or 0 is not compiled."""

    wind: bool = False
    spheres: int = 0  # how many that push out
    capsules: int = 0
    boxes: int = 0
    planes: int = 0  # and the ground
    meshes: int = 0
    reflecting: tuple[int, ...] = NONE  # of each kind of collider that are not in the counts above
    repelling: tuple[int, ...] = NONE
    distances: Distances | None = None  # to the meshes
    swept: bool = False  # ways are tested too, of one of them at least
    triangles: bool = False  # whole triangles are kept out too, by one of them at least
    slack: bool = False  # springs resist being shortened by a share only
    spring_damping: bool = False
    strain_limit: int = 0  # sweeps
    tethers: bool = False
    leashes: bool = False
    grips: bool = False
    self_collision: bool = False
    self_triangles: bool = False  # between triangles and edges too, not particles alone
    untangles: bool = False  # contact lets go where the cloth is through itself
    sticks: bool = False  # friction of particles counts from where they met
    bending: bool = False
    own_velocity: bool = False  # the solver keeps velocity as a field and not as x − x_prev
    constrained: bool = True  # something needs to know where a particle was a substep ago

    @property
    def bodies(self) -> int:
        """How many colliders there are."""
        return sum(getattr(self, kind) for kind in COLLIDERS) + sum(self.reflecting) + sum(self.repelling)


@dataclass(frozen=True)
class FrameInput:
    """What steers one frame. Columns of the rows and tables: `kernels/controls.py`."""

    substeps: int
    iterations: int
    h: float  # [s] length of a substep
    held: int  # how many particles the hand holds
    controls: NDArray[np.float32]  # (controls.COUNT,)
    bodies: NDArray[np.float32]  # (colliders, BODY_COLUMNS)
    span: tuple[int, int] = (0, 0)  # from which substep up to which; all, if there are none in it

    @property
    def first(self) -> int:
        """The substep to begin with."""
        return self.span[0]

    @property
    def last(self) -> int:
        """The one not to run any more."""
        return self.span[1] or self.substeps

    def one_by_one(self) -> Iterator["FrameInput"]:
        """Its substeps, which give the same bits as all at once."""
        return (replace(self, span=(s, s + 1)) for s in range(self.substeps))

    @property
    def arguments(self) -> tuple[Any, ...]:
        """All of it in the order above but for the span, as `run_frame` takes it."""
        return tuple(getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "span")

    @property
    def steering(self) -> dict[str, Any]:
        """What is the same for every substep, by the names of `Substep`."""
        own = {"s", *Substep._field_defaults}
        return {name: getattr(self, name) for name in Substep._fields if name not in own}


@ti.func
def nothing(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """A part of a substep that a method does without."""


@ti.kernel
def run_frame(
    before: ti.template(),
    sweep: ti.template(),
    after: ti.template(),
    cloth: ti.template(),
    work: ti.template(),
    stages: ti.template(),
    first: int,
    last: int,
    substeps: int,
    iterations: int,
    h: float,
    held: int,
    controls: row,
    bodies: table,
):
    """A whole frame in one launch, serial: a launch for every colour of every iteration would cost 20 times as much.

    `work` is the layout that is moved: the cloth itself, or its strips. Substeps are those from `first` up to `last`;
    of one behind the frame's there is only `before`.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        load(work, cloth, stages)
        for s in range(first, last):
            now = ti.static(Substep(s, substeps, h, held, controls, bodies))
            before(work, stages, now)
            if s < substeps:
                for _k in range(iterations):
                    sweep(work, stages, now)
                after(work, stages, now)
        store(work, cloth, stages)


@ti.kernel
def start_without_forces(cloth: ti.template()):
    forget_forces(cloth)


class Solver:
    """One method: the parts of its substep, and how velocity is kept.

    Positions, pins, forces and contact are the same for all; so is the frame. `path` names the layout that is worked
    on: `list` (springs one by one, any mesh), `lanes` (eight at a time, grids) or `gather` (a thread for each
    particle or spring of a colour, for GPUs).
    """

    name: ClassVar[str]
    springs: ClassVar[str]  # the scene's section that holds its spring constants by family
    before: ClassVar[Any] = staticmethod(nothing)  # a substep is `before`, then `sweep` once an iteration, then `after`
    sweep: ClassVar[Any] = staticmethod(nothing)
    after: ClassVar[Any] = staticmethod(nothing)
    paths: ClassVar[tuple[str, ...]] = ("lanes", "list", "gather")  # the first that fits a grid is taken
    needs_rows: ClassVar[bool] = False  # whole ones, of a grid
    own_velocity: ClassVar[bool] = True
    coloured: ClassVar[bool] = True  # a sweep moves particles as it goes
    constrains: ClassVar[bool] = True  # springs need to know where a particle was a substep ago
    iterates: ClassVar[bool] = True  # `iterations` means something
    closing: ClassVar[bool] = False  # a frame ends with one more `before`

    def __init__(
        self, cloth: ClothState, topology: Topology, stiffness: NDArray[np.float64], stages: Stages, path: str
    ) -> None:
        """`stiffness`: of every spring, (E,), in the unit of the section `springs`."""
        self.cloth = cloth
        self.path = path
        moved = stages.bodies or stages.strain_limit or stages.tethers or stages.leashes or stages.self_collision
        self.stages = replace(
            stages,
            own_velocity=self.own_velocity,
            constrained=self.constrains or bool(moved),
            bending=len(topology.bonds.ends) > 0,
        )
        coloured = self.coloured or stages.strain_limit > 0
        self.work: Any = cloth  # the layout that is worked on
        if path == "lanes":
            self.work = lanes.take(topology, stiffness, coloured=coloured)
        self._equip(topology)
        self.frequency = self._frequency(topology, stiffness)
        with kept_whole(self.work.in_lanes):
            start_without_forces(self.work)
        self.launches = Launches(self.work, self.stages)

    def _equip(self, topology: Topology) -> None:
        """Gives the layout what its stages need beside the cloth's own fields."""
        if self.path == "gather":
            self.work = gathering(self.cloth, topology)
        if self.stages.triangles:
            patch(self.work, topology)
        if self.stages.tethers:
            tie(self.work, topology)
        if self.stages.leashes:
            leash(self.work, topology)
        if self.stages.bending:
            bond(self.work, topology)
        if self.stages.self_collision:
            come_near(self.work, topology)
        if self.stages.sticks:
            anchor(self.work)

    def weave(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Goes on with other springs and triangles between the same particles, no more than it began with.

        `stiffness` of every spring, (E,). Not for strips, which keep that of whole rows.
        """
        self.cloth.weave(topology, stiffness)
        self._equip(topology)

    def advance_frame(self, frame: FrameInput) -> None:
        """Advances the cloth by `frame.substeps` substeps of `frame.h` seconds."""
        if self.work.gathers:
            self._advance_in_parallel(frame)
        else:
            parts = (self.before, self.sweep, self.after)
            last = frame.last + self._closes(frame)
            with kept_whole(self.work.in_lanes):
                run_frame(*parts, self.cloth, self.work, self.stages, frame.first, last, *frame.arguments)

    def _closes(self, frame: FrameInput) -> bool:
        """Whether one more `before` follows."""
        return self.closing and frame.last == frame.substeps

    def _advance_in_parallel(self, frame: FrameInput) -> None:
        """The same frame as one queue of launches."""
        sweeps = frame.iterations if self.iterates else 0
        parts: list[tuple[Any, int]] = []
        for s in range(frame.first, frame.last):
            parts += [(self.before, s), *[(self.sweep, s)] * sweeps, (self.after, s)]
        if self._closes(frame):
            parts.append((self.before, frame.substeps))
        self.launches.run(parts, frame.steering)

    def _frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        """Bound [rad/s] of what vibrates by forces that are taken at the start of a substep: bending, else nothing."""
        return highest_frequency(topology, 0 * stiffness) if self.stages.bending else 0.0

    def least_substeps(self, damping_time: float) -> int:
        """The fewest substeps of a frame with which the method is stable, with dashpots of this time [s]."""
        return max(1, ceil(FRAME_SECONDS * self.frequency / FORCED))

    def damping_time(self, asked: float) -> float:
        """The damping time [s] of the springs' dashpots that is taken where `asked` is wanted."""
        return asked

    def velocities(self, h: float) -> NDArray[np.float64]:
        """Velocity of every particle [m/s], shape (N, 3), after substeps of h seconds."""
        return self.cloth.taken(self.cloth.velocity).astype(np.float64)

    def set_velocities(self, velocities: NDArray[np.float64], h: float, of: Any = slice(None)) -> None:
        """Gives every particle, or those of some indices, a velocity [m/s] for substeps of h seconds.

        `velocities`: a row for each, or one for all; no bit of any other particle changes.
        """
        all_of_them = self.cloth.taken(self.cloth.velocity)
        all_of_them[of] = velocities
        fields.put(self.cloth.velocity, all_of_them)

    def change_substep(self, old: float, new: float) -> None:
        """Keeps every velocity when the length of a substep [s] changes."""

    def close(self) -> None:
        """Gives the fields back that are not the cloth's own, and frees what launches hold."""
        self.launches.close()
        if self.work.in_lanes:
            lanes.give_back(self.work)
        self.work = self.cloth


class ExplicitSolver(Solver):
    """A method whose substeps are bounded by the fastest vibration of the cloth's springs."""

    iterates = False
    coloured = False
    constrains = False

    def _frequency(self, topology: Topology, stiffness: NDArray[np.float64]) -> float:
        return highest_frequency(topology, stiffness)

    def damping_time(self, asked: float) -> float:
        """No more than what half as many substeps again can bear.

        Dashpots that follow the stiffness damp fast vibrations out of proportion: those of a fabric would take ten to
        forty times the substeps (64×64 denim 11246 instead of 280), for vibrations that nobody sees.
        """
        return min(asked, longest_dashpot(self.frequency))
