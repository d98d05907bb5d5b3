"""The cloth as a mechanical system: masses, springs, bending links, and their forces, energy and stiffness in float64.

Vectors of the particles are stored by component, (3, N): gathers and sums then run over contiguous memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..mesh.from_scene import stiffness_of, topology_of
from ..mesh.topology import Topology
from ..scene.model import Scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SpringModel:
    """E springs and B linear bending links between N particles; pinned particles do not move by themselves."""

    topology: Topology
    ends: Ints  # (2, E + B) particles of each link: springs first, then bending links
    rest: Floats  # [m] (E,)
    stiffness: Floats  # [N/m] (E,)
    bending: Floats  # [N/m] (B,) a bending link pulls with this times its whole length
    compression: float  # share of its stiffness with which a spring resists being shortened
    damping_time: float  # [s] the dashpot of a spring is this times its stiffness
    gravity: float  # [m/s²] downwards

    @property
    def mass(self) -> Floats:
        """[kg] (N,)"""
        return self.topology.mass

    @cached_property
    def free(self) -> Bools:
        """Which particles move by themselves, (N,)."""
        return ~self.topology.pinned

    @cached_property
    def start(self) -> Floats:
        """[m] (3, N)"""
        return np.ascontiguousarray(self.topology.start.T, dtype=np.float64)

    @cached_property
    def _scatter(self) -> Ints:
        return np.ascontiguousarray(self.ends.reshape(-1))

    def gaps(self, x: Floats) -> Floats:
        """From the first to the second end of every link [m], (3, E + B)."""
        found: Floats = x.take(self.ends[1], axis=1) - x.take(self.ends[0], axis=1)
        return found

    def lengths(self, gap: Floats) -> Floats:
        """Of the springs [m], (E,)."""
        springs = gap[:, : len(self.rest)]
        found: Floats = np.sqrt(np.einsum("ij,ij->j", springs, springs))
        return found

    def active(self, length: Floats) -> Floats:
        """Stiffness with which each spring resists at this length [N/m], (E,)."""
        if self.compression == 1.0:
            return self.stiffness
        return np.where(length < self.rest, self.compression, 1.0) * self.stiffness

    def collect(self, pull: Floats) -> Floats:
        """Sum over the links at each particle of a force on the first end, its opposite on the second, (3, N)."""
        count = len(self.mass)
        both = np.concatenate([pull, -pull], axis=1)
        return np.stack([np.bincount(self._scatter, part, count) for part in both])

    def elastic(self, x: Floats) -> Floats:
        """Force of springs and bending links on every particle [N], (3, N)."""
        gap = self.gaps(x)
        length = self.lengths(gap)
        factor = np.concatenate([self.active(length) * (1 - self.rest / length), self.bending])
        return self.collect(gap * factor)

    def weight(self) -> Floats:
        """[N] (3, N)"""
        force = np.zeros((3, len(self.mass)))
        force[1] = -self.gravity * self.mass
        return force

    def energy(self, x: Floats) -> float:
        """Elastic and gravitational energy [J]."""
        gap = self.gaps(x)
        length = self.lengths(gap)
        stretched = 0.5 * float(self.active(length) @ (length - self.rest) ** 2)
        bent = gap[:, len(self.rest) :]
        bending = 0.5 * float(self.bending @ np.einsum("ij,ij->j", bent, bent))
        return stretched + bending + self.gravity * float(self.mass @ x[1])

    def stiffness_blocks(self, x: Floats, *, definite: bool = False) -> Floats:
        """Of every link the 3×3 matrix −∂(force on its first end)/∂(its first end) [N/m], (E + B, 3, 3).

        `definite` leaves out what a shortened spring contributes across its direction, which is negative: the matrix
        of the whole cloth is then positive semidefinite.
        """
        gap = self.gaps(x)
        length = self.lengths(gap)
        active = self.active(length)
        unit = gap[:, : len(self.rest)] / length
        across = active * (1 - self.rest / length)
        if definite:
            across = np.maximum(across, 0.0)
        blocks = np.zeros((gap.shape[1], 3, 3))
        blocks[: len(self.rest)] = (active - across)[:, None, None] * np.einsum("ie,je->eij", unit, unit)
        diagonal = np.concatenate([across, self.bending])
        blocks[:, range(3), range(3)] += diagonal[:, None]
        return blocks

    def strains(self, x: Floats) -> Floats:
        """Length over rest length − 1 of every spring, (E,)."""
        found: Floats = self.lengths(self.gaps(x)) / self.rest - 1
        return found


def spring_model(scene: Scene) -> SpringModel:
    """The cloth of a scene with the constants of its `[fabric]`."""
    topology = topology_of(scene, "fabric")
    bonds = topology.bonds
    return SpringModel(
        topology=topology,
        ends=np.concatenate([topology.ends, bonds.ends]).T.astype(np.int64),
        rest=topology.rest,
        stiffness=stiffness_of(scene, "fabric", topology) * scene.solver.stiffness,
        bending=bonds.constant * scene.solver.stiffness,
        compression=scene.fabric.compression,
        damping_time=scene.fabric.damping_time,
        gravity=scene.forces.gravity,
    )
