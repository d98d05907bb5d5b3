"""The moving data of one cloth, as Taichi fields: particle by particle, springs as a list."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..mesh.grid import MOST_BATCHES
from ..mesh.topology import Topology
from . import fields
from .held import Held, room_to_hold
from .pool import Pool, capacity


@dataclass(eq=False)
class ClothState:
    """Fields of one cloth; capacities are powers of two, the counts in use stand in 0-D fields.

    Kernels take the counts at run time and the state itself as a template, so that two cloths of one
    capacity share every compiled kernel. Names and units as in `Topology`. A slot holds one particle.
    """

    in_lanes: ClassVar[bool] = False
    gathers: ClassVar[bool] = False

    origin: Any  # [m] 0-D vec3: places are told from here
    x: Any  # [m] vec3 (N,)
    x_prev: Any  # [m] vec3 (N,) where the particle was a substep ago
    velocity: Any  # [m/s] vec3 (N,) of solvers that keep it; (x − x_prev)/h would lose small steps in float32
    force: Any  # [N] vec3 (N,) gathered in a substep, without gravity
    inverse_mass: Any  # [1/kg] (N,) 0 for pins and the held particle
    ends: Any  # ivec2 (E,)
    rest: Any  # [m] (E,)
    stiffness: Any  # (E,) in the solver's unit
    multiplier: Any  # [kg·m] (E,) λ of each spring, summed over the iterations of a substep
    batch_first: Any  # (batches + 1,) first spring of each batch, and the count of all springs
    triangles: Any  # ivec3 (T,)
    held: Held  # what the hand holds
    slot_count: Any  # 0-D
    spring_count: Any  # 0-D
    batch_count: Any  # 0-D
    triangle_count: Any  # 0-D

    def upload(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Fills every field for this cloth at its start, at rest. `stiffness`: of every spring, (E,)."""
        self.weave(topology, stiffness)
        self.slot_count[None] = topology.particle_count
        self.velocity.fill(0.0)
        start = topology.start - topology.origin
        self.origin[None] = topology.origin
        self.put(start, start, inverse_mass(topology))

    def weave(self, topology: Topology, stiffness: NDArray[np.float64]) -> None:
        """Fills what joins the particles: springs, their `stiffness`, (E,), and triangles."""
        first = np.full(self.batch_first.shape[0], topology.spring_count)  # batches that are not there are empty
        first[: len(topology.batches)] = [batch.first for batch in topology.batches]
        fields.put_all(
            (self.ends, topology.ends),
            (self.rest, topology.rest),
            (self.stiffness, stiffness),
            (self.triangles, topology.triangles),
            (self.batch_first, first),
        )
        self.spring_count[None] = topology.spring_count
        self.batch_count[None] = len(topology.batches)
        self.triangle_count[None] = topology.triangle_count

    def put(self, x: NDArray[Any], x_prev: NDArray[Any], inverse_mass: NDArray[Any]) -> None:
        """Sets the places from the origin: two (N, 3) arrays [m] and one (N,) array [1/kg]."""
        fields.put_all((self.x, x), (self.x_prev, x_prev), (self.inverse_mass, inverse_mass))

    def taken(self, field: Any) -> NDArray[np.float32]:
        """A field over the particles in use, as NumPy."""
        values: NDArray[np.float32] = field.to_numpy()[: self.slot_count[None]]
        return values


def inverse_mass(topology: Topology) -> NDArray[np.float32]:
    """1/mass [1/kg], and 0 where the particle is pinned; shape (N,)."""
    return np.where(topology.pinned, 0, 1 / topology.mass).astype(np.float32)


def _allocate(particles: int, springs: int, triangles: int, batches: int) -> ClothState:
    return ClothState(
        origin=ti.Vector.field(3, ti.f32, ()),
        x=fields.places(particles),
        x_prev=fields.places(particles),
        velocity=fields.places(particles),
        force=fields.places(particles),
        inverse_mass=fields.numbers(particles),
        ends=ti.Vector.field(2, ti.i32, springs),
        rest=fields.numbers(springs),
        stiffness=fields.numbers(springs),
        multiplier=fields.numbers(springs),
        batch_first=fields.numbers(batches - SPARE + 1, kind=ti.i32),
        triangles=ti.Vector.field(3, ti.i32, triangles),
        held=room_to_hold(particles),
        slot_count=fields.number(),
        spring_count=fields.number(),
        batch_count=fields.number(),
        triangle_count=fields.number(),
    )


_pool = Pool(_allocate)
SPARE = capacity(MOST_BATCHES) - MOST_BATCHES  # a grid has no room for batches that it cannot have: each is a launch


def take(topology: Topology) -> ClothState:
    """A state with room for this cloth; `upload` fills it."""
    batches = len(topology.batches) + SPARE
    return _pool.take(topology.particle_count, topology.spring_count, topology.triangle_count, batches)


def give_back(state: ClothState) -> None:
    """Keeps a state's fields for the next cloth of its size."""
    _pool.give_back(state)
