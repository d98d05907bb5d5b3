"""The moving data of one cloth, as Taichi fields."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from .mesh.topology import Topology
from .pool import Pool


@dataclass(eq=False)
class ClothState:
    """Fields of one cloth; capacities are powers of two, the counts in use stand in 0-D fields.

    Kernels take the counts at run time and the state itself as a template, so that two cloths of one
    capacity share every compiled kernel. Names and units as in `Topology`.
    """

    x: Any  # [m] vec3 (N,)
    x_prev: Any  # [m] vec3 (N,) where the particle was a substep ago
    acceleration: Any  # [m/s²] vec3 (N,) by external forces
    inverse_mass: Any  # [1/kg] (N,) 0 for pins and the held particle
    ends: Any  # ivec2 (E,)
    rest: Any  # [m] (E,)
    batch_first: Any  # (B + 1,) first spring of each batch, and the count of all springs
    batch_stiffness: Any  # (B,) share 0…1 of the batch's family
    triangles: Any  # ivec3 (T,)
    particle_count: Any  # 0-D
    batch_count: Any  # 0-D
    triangle_count: Any  # 0-D

    def upload(self, topology: Topology, families: dict[str, float]) -> None:
        """Fills every field for this cloth at its start, at rest."""
        self.ends.from_numpy(padded(topology.ends, self.ends.shape[0]))
        self.rest.from_numpy(padded(topology.rest.astype(np.float32), self.rest.shape[0]))
        self.triangles.from_numpy(padded(topology.triangles, self.triangles.shape[0]))
        first = [b.first for b in topology.batches] + [topology.spring_count]
        self.batch_first.from_numpy(padded(np.array(first, np.int32), self.batch_first.shape[0]))
        share = np.array([families[b.family] for b in topology.batches], np.float32)
        self.batch_stiffness.from_numpy(padded(share, self.batch_stiffness.shape[0]))
        self.particle_count[None] = topology.particle_count
        self.batch_count[None] = len(topology.batches)
        self.triangle_count[None] = topology.triangle_count
        self.put(topology.start, topology.start, inverse_mass(topology))

    def put(self, x: NDArray[Any], x_prev: NDArray[Any], inverse_mass: NDArray[Any]) -> None:
        """Sets the moving part: two (N, 3) arrays [m] and one (N,) array [1/kg]."""
        for field, values in ((self.x, x), (self.x_prev, x_prev), (self.inverse_mass, inverse_mass)):
            field.from_numpy(padded(values.astype(np.float32), field.shape[0]))

    def taken(self, field: Any) -> NDArray[np.float32]:
        """A field over the particles in use, as NumPy."""
        values: NDArray[np.float32] = field.to_numpy()[: self.particle_count[None]]
        return values


def inverse_mass(topology: Topology) -> NDArray[np.float32]:
    """1/mass [1/kg], and 0 where the particle is pinned; shape (N,)."""
    return np.where(topology.pinned, 0, 1 / topology.mass).astype(np.float32)


def padded(values: NDArray[Any], capacity: int) -> NDArray[Any]:
    """`values` with zeros behind them up to the field's length."""
    out = np.zeros((capacity, *values.shape[1:]), values.dtype)
    out[: len(values)] = values
    return out


def _allocate(particles: int, springs: int, triangles: int, batches: int) -> ClothState:
    def vectors() -> Any:
        return ti.Vector.field(3, ti.f32, particles)

    return ClothState(
        x=vectors(),
        x_prev=vectors(),
        acceleration=vectors(),
        inverse_mass=ti.field(ti.f32, particles),
        ends=ti.Vector.field(2, ti.i32, springs),
        rest=ti.field(ti.f32, springs),
        batch_first=ti.field(ti.i32, batches),
        batch_stiffness=ti.field(ti.f32, batches),
        triangles=ti.Vector.field(3, ti.i32, triangles),
        particle_count=ti.field(ti.i32, ()),
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
