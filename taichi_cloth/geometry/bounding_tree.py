"""A binary tree over the triangles of a cloth, for the broad phase of contact. NumPy only.

The tree is built once, on the flat sheet: what is close on the sheet stays close in space, so the boxes of its nodes
are refitted to the moving cloth and the tree itself never changes. It is perfectly balanced: every leaf has one or two
triangles, with the edges and particles that no earlier leaf has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .topology import Topology

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BoundingTree:
    """L leaves, a power of two, and 2·L − 1 nodes in depth-first order: the left child of node n is node n + 1.

    Elements are sorted by leaf: those of leaf k are `triangles[first_triangle[k]:first_triangle[k + 1]]`, and so on.
    """

    skip: Ints
    """The node after the last descendant of each node, (2·L − 1,): a traversal continues there if it misses a node."""
    leaf: Ints
    """Leaf of each node, −1 for inner nodes, (2·L − 1,)."""
    node: Ints
    """Node of each leaf, (L,)."""
    triangles: Ints
    """(T, 3)."""
    edges: Ints
    """(E, 2)."""
    particles: Ints
    """Every particle once, (N,)."""
    first_triangle: Ints
    """(L + 1,)."""
    first_edge: Ints
    """(L + 1,)."""
    first_particle: Ints
    """(L + 1,)."""
    leaves_of_particle: Ints
    """Leaves with an element that has the particle, particle by particle."""
    first_leaf_of_particle: Ints
    """First entry of every particle, (N + 1,)."""

    @property
    def levels(self) -> int:
        """Number of levels: 1 for a single node."""
        return len(self.node).bit_length()


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """A tree of L leaves, as `BoundingTree`, whose elements are the T triangles alone."""

    skip: Ints
    leaf: Ints
    node: Ints
    order: Ints
    """The triangles sorted by leaf, (T,)."""
    first_triangle: Ints
    """First entry of `order` of each leaf, (L + 1,)."""

    @property
    def levels(self) -> int:
        """Number of levels: 1 for a single node."""
        return len(self.node).bit_length()


def build_triangle_tree(centers: NDArray[np.float64]) -> TriangleTree:
    """Return the tree of triangles with these centers [m], (T, 3)."""
    depth = _depth(len(centers))
    leaf_of_triangle = _bisect(centers, depth)
    order = np.argsort(leaf_of_triangle, kind="stable")
    first = np.searchsorted(leaf_of_triangle[order], np.arange((1 << depth) + 1))
    skip, leaf = _depth_first(depth)
    return TriangleTree(skip, leaf, np.flatnonzero(leaf >= 0), order, first)


def _depth(triangles: int) -> int:
    """Return the depth of the tree with one or two triangles in each leaf."""
    return max(int(np.ceil(np.log2(triangles / 2))), 0)


def build_tree(topology: Topology) -> BoundingTree:
    """Return the tree of a cloth. A particle without triangles is a triangle without area."""
    triangles = topology.triangles.astype(np.int64)
    lone = np.setdiff1d(np.arange(topology.particle_count), triangles)
    triangles = np.concatenate([triangles, np.repeat(lone[:, None], 3, axis=1)])
    depth = _depth(len(triangles))
    leaf_of_triangle = _bisect(topology.flat[triangles].mean(axis=1), depth)
    order = np.argsort(leaf_of_triangle, kind="stable")
    triangles, leaf_of_triangle = triangles[order], leaf_of_triangle[order]
    leaves = 1 << depth
    sides = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, edge_leaf = _owned(sides, np.repeat(leaf_of_triangle, 3))
    real = edges[:, 0] != edges[:, 1]
    edges, edge_leaf = edges[real], edge_leaf[real]
    particles, particle_leaf = _owned(triangles.reshape(-1, 1), np.repeat(leaf_of_triangle, 3))
    pairs = np.unique(np.stack([triangles.ravel(), np.repeat(leaf_of_triangle, 3)], axis=1), axis=0)
    skip, leaf = _depth_first(depth)
    return BoundingTree(
        skip=skip,
        leaf=leaf,
        node=np.flatnonzero(leaf >= 0),
        triangles=triangles,
        edges=edges,
        particles=particles[:, 0],
        first_triangle=np.searchsorted(leaf_of_triangle, np.arange(leaves + 1)),
        first_edge=np.searchsorted(edge_leaf, np.arange(leaves + 1)),
        first_particle=np.searchsorted(particle_leaf, np.arange(leaves + 1)),
        leaves_of_particle=pairs[:, 1],
        first_leaf_of_particle=np.searchsorted(pairs[:, 0], np.arange(topology.particle_count + 1)),
    )


def _bisect(centers: NDArray[np.float64], depth: int) -> Ints:
    """Return the leaf of every point: groups are halved `depth` times, each across its longest side."""
    group = np.zeros(len(centers), np.int64)
    for _ in range(depth):
        count = np.bincount(group)
        low, high = np.full((len(count), 3), np.inf), np.full((len(count), 3), -np.inf)
        np.minimum.at(low, group, centers)
        np.maximum.at(high, group, centers)
        axis = (high - low).argmax(axis=1)
        along = centers[np.arange(len(centers)), axis[group]]
        order = np.lexsort((along, group))
        rank = np.empty_like(group)
        rank[order] = np.arange(len(group)) - np.repeat(np.cumsum(count) - count, count)
        group = 2 * group + (rank >= (count[group] + 1) // 2)
    return group


def _owned(elements: Ints, leaf: Ints) -> tuple[Ints, Ints]:
    """Return each element once, with the first leaf that has it, sorted by leaf."""
    unique, inverse = np.unique(elements, axis=0, return_inverse=True)
    owner = np.full(len(unique), np.iinfo(np.int64).max)
    np.minimum.at(owner, inverse.reshape(-1), leaf)
    order = np.argsort(owner, kind="stable")
    return unique[order], owner[order]


def _depth_first(depth: int) -> tuple[Ints, Ints]:
    """Return `skip` and `leaf` of a perfect binary tree."""
    skip, leaf = np.array([1]), np.array([0])
    for _ in range(depth):
        size, count = len(skip), int(leaf.max()) + 1
        skip = np.concatenate([[2 * size + 1], skip + 1, skip + 1 + size])
        leaf = np.concatenate([[-1], leaf, np.where(leaf >= 0, leaf + count, -1)])
    return skip, leaf
