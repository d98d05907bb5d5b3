"""The moving data of one cloth, as Taichi fields: particle by particle, springs as a list."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from .mesh import strips
from .mesh.tethers import MOST, tethers
from .mesh.topology import Topology
from .pool import Pool


@dataclass(eq=False)
class ClothState:
    """Fields of one cloth; capacities are powers of two, the counts in use stand in 0-D fields.

    Kernels take the counts at run time and the state itself as a template, so that two cloths of one
    capacity share every compiled kernel. Names and units as in `Topology`. A slot holds one particle.
    """

    in_lanes: ClassVar[bool] = False
    gathers: ClassVar[bool] = False

    x: Any  # [m] vec3 (N,)
    x_prev: Any  # [m] vec3 (N,) where the particle was a substep ago
    velocity: Any  # [m/s] vec3 (N,) of solvers that keep it; (x − x_prev)/h would lose small steps in float32
    predicted: Any  # [m] vec3 (N,) where the particle would be without constraints
    force: Any  # [N] vec3 (N,) gathered in a substep, without gravity
    inverse_mass: Any  # [1/kg] (N,) 0 for pins and the held particle
    ends: Any  # ivec2 (E,)
    rest: Any  # [m] (E,)
    stiffness: Any  # (E,) in the solver's unit
    multiplier: Any  # [kg·m] (E,) λ of each spring, summed over the iterations of a substep
    batch_first: Any  # (B + 1,) first spring of each batch, and the count of all springs
    triangles: Any  # ivec3 (T,)
    slot_count: Any  # 0-D
    spring_count: Any  # 0-D
    batch_count: Any  # 0-D
    triangle_count: Any  # 0-D

    def upload(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Fills every field for this cloth at its start, at rest. `stiffness`: of every spring, (E,)."""
        self.ends.from_numpy(padded(topology.ends, self.ends.shape[0]))
        self.fill(self.rest, topology.rest)
        self.fill(self.stiffness, stiffness)
        self.triangles.from_numpy(padded(topology.triangles, self.triangles.shape[0]))
        first = [b.first for b in topology.batches] + [topology.spring_count]
        self.batch_first.from_numpy(padded(np.array(first, np.int32), self.batch_first.shape[0]))
        self.slot_count[None] = topology.particle_count
        self.spring_count[None] = topology.spring_count
        self.batch_count[None] = len(topology.batches)
        self.triangle_count[None] = topology.triangle_count
        self.velocity.fill(0.0)
        self.put(topology.start, topology.start, inverse_mass(topology))

    def put(self, x: NDArray[Any], x_prev: NDArray[Any], inverse_mass: NDArray[Any]) -> None:
        """Sets the places: two (N, 3) arrays [m] and one (N,) array [1/kg]."""
        for field, values in ((self.x, x), (self.x_prev, x_prev), (self.inverse_mass, inverse_mass)):
            self.fill(field, values)

    def fill(self, field: Any, values: NDArray[Any]) -> None:
        """Sets the beginning of one field."""
        field.from_numpy(padded(values.astype(np.float32), field.shape[0]))

    def taken(self, field: Any) -> NDArray[np.float32]:
        """A field over the particles in use, as NumPy."""
        values: NDArray[np.float32] = field.to_numpy()[: self.slot_count[None]]
        return values


def inverse_mass(topology: Topology) -> NDArray[np.float32]:
    """1/mass [1/kg], and 0 where the particle is pinned; shape (N,)."""
    return np.where(topology.pinned, 0, 1 / topology.mass).astype(np.float32)


def padded(values: NDArray[Any], capacity: int) -> NDArray[Any]:
    """`values` with zeros behind them up to the field's length."""
    out = np.zeros((capacity, *values.shape[1:]), values.dtype)
    out[: len(values)] = values
    return out


@dataclass(eq=False)
class Ties:
    """Fields of the tethers of one layout: first those to the nearest pins, slot by slot, then to the next."""

    pin: Any  # particle at the end; in strips slot·8 + lane
    reach: Any  # [m] distance on the flat sheet
    place: Any  # [m] where that particle is; in strips only
    count: Any  # 0-D tethers of a particle


def tie(work: Any, topology: Topology) -> None:
    """Gives a cloth or its strips their `ties`, filled. They stay with its fields, and so do compiled kernels."""
    lanes = work.in_lanes
    if not hasattr(work, "ties"):
        room = MOST * work.x.shape[0]
        work.ties = Ties(
            pin=ti.Vector.field(strips.STRIPS, ti.i32, room) if lanes else ti.field(ti.i32, room),
            reach=ti.Vector.field(strips.STRIPS, ti.f32, room) if lanes else ti.field(ti.f32, room),
            place=ti.Matrix.field(3, strips.STRIPS, ti.f32, room) if lanes else None,
            count=ti.field(ti.i32, ()),
        )
    pins, reach = tethers(topology)
    work.ties.count[None] = len(pins)
    reach = reach.astype(np.float32)
    if lanes:
        pitch = work.pitch[None]
        row, column = np.divmod(pins, topology.shape[1])
        pins = ((row * pitch + column % pitch) * strips.STRIPS + column // pitch).astype(np.int32)
        pins, reach = (
            strips.pack(v.reshape(-1, *topology.shape), pitch).reshape(-1, strips.STRIPS) for v in (pins, reach)
        )
    for field, values in ((work.ties.pin, pins), (work.ties.reach, reach)):
        field.from_numpy(padded(values if lanes else values.reshape(-1), field.shape[0]))


def _allocate(particles: int, springs: int, triangles: int, batches: int) -> ClothState:
    def vectors() -> Any:
        return ti.Vector.field(3, ti.f32, particles)

    return ClothState(
        x=vectors(),
        x_prev=vectors(),
        velocity=vectors(),
        predicted=vectors(),
        force=vectors(),
        inverse_mass=ti.field(ti.f32, particles),
        ends=ti.Vector.field(2, ti.i32, springs),
        rest=ti.field(ti.f32, springs),
        stiffness=ti.field(ti.f32, springs),
        multiplier=ti.field(ti.f32, springs),
        batch_first=ti.field(ti.i32, batches),
        triangles=ti.Vector.field(3, ti.i32, triangles),
        slot_count=ti.field(ti.i32, ()),
        spring_count=ti.field(ti.i32, ()),
        batch_count=ti.field(ti.i32, ()),
        triangle_count=ti.field(ti.i32, ()),
    )


_pool = Pool(_allocate)


def take(topology: Topology) -> ClothState:
    """A state with room for this cloth; `upload` fills it."""
    return _pool.take(
        topology.particle_count, topology.spring_count, topology.triangle_count, len(topology.batches) + 1
    )


def give_back(state: ClothState) -> None:
    """Keeps a state's fields for the next cloth of its size."""
    _pool.give_back(state)
