"""The cloth as a mechanical system in float64: masses, forces, energy and stiffness, and the wind on it. NumPy only.

The reference solutions and `Simulation.forces` use this model. Solvers and kernels do not, which a test checks.

Per-particle vectors are stored by component, (3, N): gathers and sums then access contiguous memory.

Wind acts on triangles. For a triangle of area A with unit normal n, past whose center the air moves at the relative
velocity u:

    drag = ½ρ·C_D·A·(n·u)²·u/|u|
    lift = ½ρ·C_L·A·(n·u)·(|u|·n − (n·u)·u/|u|)

Each corner carries a third. The mean wind blows along x and z; a gust adds three plane waves, one for each component.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..scene.schema import Scene
from .cloth_builder import build_topology, spring_stiffness
from .membrane_model import ElasticTriangles
from .topology import Topology

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

TINY = 1e-12  # [m] avoids division by zero


@dataclass(frozen=True, eq=False)
class SpringModel:
    """E springs and B linear bending links between N particles; pinned particles are not free to move."""

    topology: Topology
    ends: Ints
    """The two particles of every link, (2, E + B): springs first, then bending links."""
    rest: Floats  # [m] (E,)
    stiffness: Floats  # [N/m] (E,)
    bending: Floats
    """Constant of every bending link [N/m], (B,). Its force is this times its length."""
    compression: float
    """Share of its stiffness with which a spring resists being shortened."""
    damping_time: float
    """Damping coefficient of a spring over its stiffness [s]."""
    gravity: float  # [m/s²] downward
    membrane: ElasticTriangles | None = None

    @property
    def mass(self) -> Floats:
        """Mass of every particle [kg], (N,)."""
        return self.topology.mass

    @cached_property
    def free(self) -> Bools:
        """Whether each particle is free to move, (N,)."""
        return ~self.topology.pinned

    @cached_property
    def start(self) -> Floats:
        """Start positions [m], (3, N)."""
        return np.ascontiguousarray(self.topology.start.T, dtype=np.float64)

    @cached_property
    def _scatter(self) -> Ints:
        return np.ascontiguousarray(self.ends.reshape(-1))

    def link_vectors(self, x: Floats) -> Floats:
        """Return the vector from the first to the second end of every link [m], (3, E + B)."""
        gap: Floats = x.take(self.ends[1], axis=1) - x.take(self.ends[0], axis=1)
        return gap

    def lengths(self, gap: Floats) -> Floats:
        """Return the length of every spring [m], (E,)."""
        springs = gap[:, : len(self.rest)]
        length: Floats = np.sqrt(np.einsum("ij,ij->j", springs, springs))
        return length

    def effective_stiffness(self, length: Floats) -> Floats:
        """Return the stiffness of every spring at a length [N/m], (E,)."""
        if self.compression == 1.0:
            return self.stiffness
        return np.where(length < self.rest, self.compression, 1.0) * self.stiffness

    def scatter(self, pull: Floats) -> Floats:
        """Sum over the links at each particle, (3, N).

        `pull` is a force on the first end of every link; the second end gets the opposite force.
        """
        count = len(self.mass)
        both = np.concatenate([pull, -pull], axis=1)
        return np.stack([np.bincount(self._scatter, component, count) for component in both])

    def elastic_force(self, x: Floats) -> Floats:
        """Return the force of springs and bending links on every particle [N], (3, N)."""
        gap = self.link_vectors(x)
        length = self.lengths(gap)
        factor = np.concatenate(
            [self.effective_stiffness(length) * (1 - self.rest / np.maximum(length, TINY)), self.bending]
        )
        force = self.scatter(gap * factor)
        return force if self.membrane is None else force + self.membrane.force(x)

    def dampers(self, x: Floats) -> Floats:
        """Return the direction of every spring, times the root of its damping coefficient, (3, E)."""
        gap = self.link_vectors(x)[:, : len(self.rest)]
        length = np.sqrt((gap * gap).sum(axis=0))
        vectors: Floats = gap / np.maximum(length, TINY) * np.sqrt(self.effective_stiffness(length) * self.damping_time)
        return vectors

    def damper_force(self, dampers: Floats, v: Floats) -> Floats:
        """Return the force of all dampers on every particle [N], (3, N), at velocities [m/s], (3, N)."""
        ends = self.ends[:, : len(self.rest)]
        rate = ((v.take(ends[1], axis=1) - v.take(ends[0], axis=1)) * dampers).sum(axis=0)
        pull = dampers * rate
        both, ends_of_both = np.concatenate([pull, -pull], axis=1), ends.reshape(-1)
        return np.stack([np.bincount(ends_of_both, component, v.shape[1]) for component in both])

    def damping_force(self, x: Floats, v: Floats) -> Floats:
        """Return the force of damping on every particle [N], (3, N), at positions [m] and velocities [m/s], (3, N)."""
        force = self.damper_force(self.dampers(x), v)
        return force if self.membrane is None else force + self.membrane.damper_force(x, v, self.damping_time)

    def weight(self) -> Floats:
        """Return the weight of every particle [N], (3, N)."""
        force = np.zeros((3, len(self.mass)))
        force[1] = -self.gravity * self.mass
        return force

    def elastic_energy(self, x: Floats) -> float:
        """Return the energy of springs, bending links and membrane [J]."""
        gap = self.link_vectors(x)
        length = self.lengths(gap)
        stretching = 0.5 * float(self.effective_stiffness(length) @ (length - self.rest) ** 2)
        bending_gap = gap[:, len(self.rest) :]
        bending = 0.5 * float(self.bending @ np.einsum("ij,ij->j", bending_gap, bending_gap))
        membrane = 0.0 if self.membrane is None else self.membrane.energy(x)
        return stretching + bending + membrane

    def energy(self, x: Floats) -> float:
        """Return the elastic and gravitational energy [J]."""
        return self.elastic_energy(x) + self.gravity * float(self.mass @ x[1])

    def stiffness_blocks(self, x: Floats, *, definite: bool = False) -> Floats:
        """Return −∂f/∂x of every link [N/m], (E + B, 3, 3): f is the force on its first end, x that end's position.

        `definite` drops the transverse stiffness of shortened springs, which is negative: the matrix of the entire
        cloth is then positive semidefinite.
        """
        gap = self.link_vectors(x)
        length = self.lengths(gap)
        active = self.effective_stiffness(length)
        unit = gap[:, : len(self.rest)] / length
        transverse = active * (1 - self.rest / length)
        if definite:
            transverse = np.maximum(transverse, 0.0)
        blocks = np.zeros((gap.shape[1], 3, 3))
        blocks[: len(self.rest)] = (active - transverse)[:, None, None] * np.einsum("ie,je->eij", unit, unit)
        diagonal = np.concatenate([transverse, self.bending])
        blocks[:, range(3), range(3)] += diagonal[:, None]
        return blocks

    def strains(self, x: Floats) -> Floats:
        """Return length over rest length − 1 of every spring, (E,)."""
        strain: Floats = self.lengths(self.link_vectors(x)) / self.rest - 1
        return strain


def spring_model(scene: Scene, topology: Topology | None = None) -> SpringModel:
    """Return the model of a scene's cloth, with the constants of its `[fabric]`.

    `topology`: the cloth as it is now, with other pins and without torn springs; that of the scene if None.
    """
    topology = topology or build_topology(scene, "fabric")
    links, membrane = topology.bending_links, topology.membrane
    return SpringModel(
        topology=topology,
        ends=np.concatenate([topology.ends, links.ends]).T.astype(np.int64),
        rest=topology.rest,
        stiffness=spring_stiffness(scene, "fabric", topology) * scene.solver.stiffness,
        bending=links.stiffness * scene.solver.stiffness,
        compression=scene.fabric.compression,
        damping_time=scene.fabric.damping_time,
        gravity=scene.forces.gravity,
        membrane=membrane and membrane.scaled(scene.solver.stiffness),
    )


# -- wind --------------------------------------------------------------------------------------------------------------

# Gust waves of the x, y and z component: amplitude as a share of the gust, frequency [1/s], and wavenumbers [1/m] along
# x, y and z.
GUST_AMPLITUDES = np.array([0.6, 0.3, 1.0])
GUST_FREQUENCIES = np.array([0.43, 0.77, 0.32])
GUST_WAVENUMBERS = np.array([[0.31, 0.17, 0.11], [0.13, 0.37, 0.19], [0.23, -0.11, 0.29]])


def parabolic_wave(turns: Floats) -> Floats:
    """Return a wave of period 1 between −1 and 1, made of two parabolas: 0 at 0, −1 at ¼, 1 at ¾."""
    fraction = turns - np.floor(turns)
    return np.where(fraction < 0.5, -16 * fraction * (0.5 - fraction), 16 * (fraction - 0.5) * (1 - fraction))


@dataclass(frozen=True, eq=False)
class Wind:
    """The wind of a scene and the triangles that it acts on."""

    corners: Ints
    """The three particles of every triangle, (3, T)."""
    mean: Floats
    """Mean wind [m/s], (3, 1)."""
    gust: float
    """Scale of the gust waves [m/s]."""
    phases: Floats
    """Phase of every gust wave [turns], (3,)."""
    density: float  # [kg/m³]
    drag: float
    lift: float

    def velocity(self, x: Floats, seconds: float) -> Floats:
        """Return the air velocity [m/s] at positions [m], both (3, M)."""
        phase = GUST_WAVENUMBERS @ x - (self.phases + GUST_FREQUENCIES * seconds)[:, None]
        return self.mean + self.gust * GUST_AMPLITUDES[:, None] * parabolic_wave(phase)

    def force(self, x: Floats, v: Floats, seconds: float) -> Floats:
        """Return the wind force on every particle [N], (3, N)."""
        a, b, c = (x.take(corner, axis=1) for corner in self.corners)
        center_velocity = sum(v.take(corner, axis=1) for corner in self.corners) / 3
        u = self.velocity((a + b + c) / 3, seconds) - center_velocity
        p, q = b - a, c - a
        area_vector = 0.5 * np.stack([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]])
        area = np.sqrt((area_vector * area_vector).sum(axis=0))
        speed = np.sqrt((u * u).sum(axis=0))
        normal = area_vector / np.where(area > 0, area, 1.0)
        direction = u / np.where(speed > 0, speed, 1.0)
        normal_u = (normal * u).sum(axis=0)
        factor = 0.5 * self.density * area * normal_u
        force = factor * (self.drag * normal_u * direction + self.lift * (speed * normal - normal_u * direction))
        corners, count = self.corners.reshape(-1), x.shape[1]
        return np.stack([np.bincount(corners, np.tile(component, 3), count) for component in force / 3])


def wind_of(scene: Scene, model: SpringModel) -> Wind | None:
    """Return the wind of a scene, or None without `[wind]`."""
    wind = scene.wind
    if wind is None:
        return None
    return Wind(
        corners=np.ascontiguousarray(model.topology.triangles.T, dtype=np.int64),
        mean=np.array([[wind.x], [0.0], [wind.z]]),
        gust=wind.turbulence * float(np.hypot(wind.x, wind.z)),
        phases=np.random.default_rng(scene.seed).random(3),
        density=wind.air_density,
        drag=wind.drag,
        lift=wind.lift,
    )
