"""Cloth as a membrane: triangles of an orthotropic elastic continuum, in float64. NumPy only.

The deformation gradient F of a triangle has two columns f₁ and f₂, the derivatives of position along warp and weft, or
along axes from which these are turned. Green's strain is E = (FᵀF − 1)/2. With ε = (E₁₁, E₂₂, 2·E₁₂), the energy per
area is that of St. Venant–Kirchhoff,

    W = ½·εᵀ·C·ε = ½·(C₁₁·E₁₁² + C₂₂·E₂₂² + 2·C₁₂·E₁₁·E₂₂ + 4·C₆₆·E₁₂²)

and the stress is S = C·ε [N/m]. No root and no division is needed, and any positive definite C is possible, while
springs tie C₁₂ to C₆₆. In tension the membrane stiffens, as (3λ² − 1)/2 of the stretch λ along one direction.

A grid has four triangles in every cell, two for each of its diagonals, with half of their area: it has no preferred
diagonal. A mesh has its own triangles.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..scene.fabric_schema import Fabric
from ..scene.schema import Cloth
from .grid import NO_GRID

if TYPE_CHECKING:
    from .topology import Topology

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MAX_STRAIN = 0.1  # of tension for which explicit substeps are short enough


@dataclass(frozen=True, eq=False)
class ElasticTriangles(ABC):
    """M triangles between the particles of a cloth, whose energy depends on their deformation gradient."""

    corners: Ints
    """The three particles of every triangle, (M, 3)."""
    inverse_shape: Floats
    """Matrix B of every triangle [1/m], (M, 2, 2): F = (x₁ − x₀, x₂ − x₀)·B."""
    area: Floats
    """Area that every triangle represents [m²], times the factor of a stiffness map, (M,)."""

    @property
    def cells_per_meter(self) -> tuple[float, float]:
        """Rows and columns of cells of a grid per meter [1/m]."""
        down, along = self.inverse_shape[2]  # of the triangle of the corners a c b, where cells have a b over c d
        return float(np.hypot(*down)), float(np.hypot(*along))

    def gradient(self, x: Floats) -> tuple[Floats, Floats]:
        """Return f₁ and f₂ of every triangle, (3, M) each, at positions (3, N) [m]."""
        p, q = self._edges(x)
        b = self.inverse_shape
        return p * b[:, 0, 0] + q * b[:, 1, 0], p * b[:, 0, 1] + q * b[:, 1, 1]

    def strain(self, x: Floats) -> Floats:
        """Return E₁₁, E₂₂ and 2·E₁₂ of every triangle, (3, M)."""
        f1, f2 = self.gradient(x)
        return np.stack([0.5 * (dot(f1, f1) - 1), 0.5 * (dot(f2, f2) - 1), dot(f1, f2)])

    def scatter(self, x: Floats, stress: Floats) -> Floats:
        """Return the force of a stress, (3, M) [N/m], on every particle [N], (3, N)."""
        f1, f2 = self.gradient(x)
        p1, p2 = f1 * stress[0] + f2 * stress[2], f1 * stress[2] + f2 * stress[1]
        b = self.inverse_shape * self.area[:, None, None]
        on_1, on_2 = -(p1 * b[:, 0, 0] + p2 * b[:, 0, 1]), -(p1 * b[:, 1, 0] + p2 * b[:, 1, 1])
        force = np.concatenate([-(on_1 + on_2), on_1, on_2], axis=1)
        index, count = self.corners.T.reshape(-1), x.shape[1]
        return np.stack([np.bincount(index, component, count) for component in force])

    @abstractmethod
    def energy(self, x: Floats) -> float:
        """Return the elastic energy [J] at positions (3, N) [m]."""

    @abstractmethod
    def force(self, x: Floats) -> Floats:
        """Return the elastic force on every particle [N], (3, N)."""

    @abstractmethod
    def damper_force(self, x: Floats, v: Floats, damping_time: float) -> Floats:
        """Return the force of damping on every particle [N], (3, N): stress C·dε/dt times `damping_time` [s].

        `v`: velocities, (3, N) [m/s].
        """

    @abstractmethod
    def scaled(self, factor: float) -> ElasticTriangles:
        """Return the same triangles with stiffness times `factor`."""

    @abstractmethod
    def scalar_elements(self) -> tuple[Ints, Floats]:
        """Return groups of three particles, (K, 3), with matrices that bound their stiffness [N/m], (K, 3, 3).

        A motion δx of the particles changes the energy by at most ½·δxᵀ·K·δx, with K applied to each coordinate, in any
        shape of the cloth in which no tension exceeds `MAX_STRAIN`.
        """

    def _bounded_by(self, moduli: Floats) -> Floats:
        """Return the matrices of triangles whose energy per area changes by at most ½·(p·|δf₁|² + q·|δf₂|²), (M, 3, 3).

        `moduli`: p and q [N/m], (2,).
        """
        slopes = np.concatenate([-self.inverse_shape.sum(axis=1, keepdims=True), self.inverse_shape], axis=1)
        stiffness: Floats = np.einsum("mik,k,mjk,m->mij", slopes, moduli, slopes, self.area)
        return stiffness

    def _edges(self, x: Floats) -> tuple[Floats, Floats]:
        a, b, c = (x.take(corner, axis=1) for corner in self.corners.T)
        return b - a, c - a


@dataclass(frozen=True, eq=False)
class Membrane(ElasticTriangles):
    """Triangles of an orthotropic elastic continuum."""

    tensor: Floats
    """C [N/m], (3, 3)."""
    compression: float = 1.0
    """Stiffness of a direction that is compressed over that of one that is stretched."""

    def stress(self, strain: Floats) -> Floats:
        """Return S₁₁, S₂₂ and S₁₂ of every triangle [N/m], (3, M)."""
        share = self._shares(strain)
        stress: Floats = share * (self.tensor @ (share * strain))
        return stress

    def energy(self, x: Floats) -> float:
        strain = self.strain(x)
        return 0.5 * float(self.area @ (strain * self.stress(strain)).sum(axis=0))

    def force(self, x: Floats) -> Floats:
        return self.scatter(x, self.stress(self.strain(x)))

    def damper_force(self, x: Floats, v: Floats, damping_time: float) -> Floats:
        (f1, f2), (g1, g2) = self.gradient(x), self.gradient(v)
        rate = np.stack([dot(f1, g1), dot(f2, g2), dot(f1, g2) + dot(f2, g1)])
        share = self._shares(self.strain(x))
        return self.scatter(x, share * (self.tensor @ (share * rate)) * damping_time)

    def scaled(self, factor: float) -> Membrane:
        return replace(self, tensor=self.tensor * factor)

    def scalar_elements(self) -> tuple[Ints, Floats]:
        """Return the corners of all triangles, and matrices that bound their stiffness.

        The diagonal matrix of dᵢ = Σⱼ |Cᵢⱼ|·√(Cᵢᵢ/Cⱼⱼ) bounds C. With δf₁ and δf₂ the changes of f₁ and f₂, which are
        unit vectors at right angles, the energy per area changes by at most ½·(p·|δf₁|² + q·|δf₂|²), where
        p = max(d₁, 2·d₃) and q = max(d₂, 2·d₃).
        """
        diagonal = self.tensor.diagonal()
        d = (np.abs(self.tensor) * np.sqrt(diagonal[:, None] / diagonal)).sum(axis=1)
        bounds = np.maximum(d[:2], 2 * d[2])
        tension = (3 * (1 + MAX_STRAIN) ** 2 - 1) / 2
        return self.corners, self._bounded_by(bounds * tension)

    def _shares(self, strain: Floats) -> Floats:
        """Return the root of the share of its stiffness that each direction has, (3, M): less in compression."""
        share = np.where(strain < 0, np.sqrt(self.compression), 1.0)
        share[2] = 1.0
        return share


def dot(a: Floats, b: Floats) -> Floats:
    """Return the inner products of columns, (M,)."""
    product: Floats = np.einsum("ij,ij->j", a, b)
    return product


def tensor_of(fabric: Fabric, cloth: Cloth) -> Floats:
    """Return the tensor C of a fabric [N/m], (3, 3). If `c11` to `c66` are 0, it is that of a grid of its springs."""
    c11, c22, c12, c66 = fabric.c11, fabric.c22, fabric.c12, fabric.c66
    if not any((c11, c22, c12, c66)):
        c12 = c66 = fabric.shear * cloth.diagonals / 2
        c11, c22 = fabric.warp + c12, fabric.weft + c12
    return np.array([[c11, c12, 0.0], [c12, c22, 0.0], [0.0, 0.0, c66]])


def build_membrane(fabric: Fabric, cloth: Cloth, topology: Topology, factor: Floats | None) -> Membrane:
    """Return the membrane of a cloth.

    `factor`: on the stiffness at every particle, (N,); None if it is the same everywhere.
    """
    corners, share = triangles_of(topology)
    angle = fabric.warp_angle if fabric.compression < 1 else 0.0  # of the axes: compression acts along the yarns
    inverse_shape, area = shapes_of(topology.flat, corners, angle)
    weight = share * area if factor is None else share * area * factor[corners].mean(axis=1)
    tensor = turned(tensor_of(fabric, cloth), fabric.warp_angle - angle)
    return Membrane(corners, inverse_shape, weight, tensor, fabric.compression)


def turned(tensor: Floats, degrees: float) -> Floats:
    """Return the tensor along axes from which warp and weft are turned by an angle [degrees], counterclockwise."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    strains = np.array(
        [[cos**2, sin**2, -sin * cos], [sin**2, cos**2, sin * cos], [2 * sin * cos, -2 * sin * cos, cos**2 - sin**2]]
    )  # along warp and weft, from those along the axes
    result: Floats = strains.T @ tensor @ strains
    return result


def triangles_of(topology: Topology) -> tuple[Ints, float]:
    """Return the triangles of a cloth, (M, 3), and the share of their area that each represents."""
    if topology.shape == NO_GRID:
        return topology.triangles, 1.0
    rows, columns = topology.shape[0] // topology.layers, topology.shape[1]
    index = np.arange(topology.particle_count).reshape(topology.layers, rows, columns)
    a, b, c, d = index[:, :-1, :-1], index[:, :-1, 1:], index[:, 1:, :-1], index[:, 1:, 1:]  # a b over c d
    cut = np.stack([np.stack(corners, axis=-1) for corners in ((a, c, d), (a, d, b), (a, c, b), (b, c, d))], axis=-2)
    return cut.reshape(-1, 3).astype(np.int32), 0.5


def shapes_of(flat: Floats, corners: Ints, warp_angle: float) -> tuple[Floats, Floats]:
    """Return B [1/m], (M, 2, 2), and the area [m²], (M,), of triangles of the flat cloth, (N, 3) [m].

    Weft is along the x axis and warp at right angles to it, in the plane of the triangle, both turned by `warp_angle`
    [degrees] about z; in a triangle across the x axis, weft is along y.
    """
    a, b, c = (flat[corner] for corner in corners.T)
    p, q = b - a, c - a
    normal = np.cross(p, q)
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    twice = np.linalg.norm(normal, axis=1)
    normal /= twice[:, None]
    axis = np.where(np.abs(normal[:, :1]) > 0.999, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    across = axis - np.einsum("mi,mi->m", axis, normal)[:, None] * normal
    across /= np.linalg.norm(across, axis=1)[:, None]
    along: Floats = np.cross(normal, across)
    cos, sin = np.cos(np.radians(warp_angle)), np.sin(np.radians(warp_angle))
    warp, weft = cos * along - sin * across, cos * across + sin * along
    shape = np.stack([[dot(e.T, d.T) for e in (p, q)] for d in (warp, weft)]).transpose(2, 0, 1)
    return np.asarray(np.linalg.inv(shape), np.float64), twice / 2
