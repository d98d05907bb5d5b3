"""The bounding tree of a cloth: every element in one leaf, and a depth-first order that can be traversed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.bounding_tree import BoundingTree, build_tree
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.topology import Topology
from taichi_cloth.scene.schema import Cloth, Scene


def topology_of(rows: int, columns: int, layers: int = 1) -> Topology:
    return build_topology(Scene(cloth=Cloth(rows=rows, columns=columns, layers=layers)), "verlet")


CLOTHS = {
    "smallest": topology_of(2, 2),
    "odd": topology_of(5, 7),
    "layers": topology_of(4, 3, layers=3),
    "mesh": build_topology(load_scene("sphere", cloth={"file": "disc"}), "verlet"),
}


@pytest.fixture(params=CLOTHS)
def topology(request: pytest.FixtureRequest) -> Topology:
    return CLOTHS[request.param]


def descendants(tree: BoundingTree, node: int) -> list[int]:
    """Return the leaves below a node."""
    return [int(leaf) for leaf in tree.leaf[node : tree.skip[node]] if leaf >= 0]


def test_every_element_is_in_one_leaf(topology: Topology) -> None:
    tree = build_tree(topology)
    assert sorted(map(sorted, tree.triangles.tolist())) == sorted(map(sorted, topology.triangles.tolist()))
    assert sorted(tree.edges.tolist()) == topology.edges.tolist()
    assert sorted(tree.particles.tolist()) == list(range(topology.particle_count))
    for first, elements in ((tree.first_triangle, tree.triangles), (tree.first_edge, tree.edges)):
        assert (first[0], first[-1]) == (0, len(elements))
        assert (np.diff(first) >= 0).all()
    assert set(np.diff(tree.first_triangle).tolist()) <= {1, 2}


def test_a_leaf_has_only_edges_and_particles_of_its_triangles(topology: Topology) -> None:
    tree = build_tree(topology)
    for leaf in range(len(tree.node)):
        corners = set(tree.triangles[tree.first_triangle[leaf] : tree.first_triangle[leaf + 1]].ravel().tolist())
        edges = tree.edges[tree.first_edge[leaf] : tree.first_edge[leaf + 1]]
        particles = tree.particles[tree.first_particle[leaf] : tree.first_particle[leaf + 1]]
        assert set(edges.ravel().tolist()) | set(particles.tolist()) <= corners
        for particle in corners:
            first, last = tree.first_leaf_of_particle[particle : particle + 2]
            assert leaf in tree.leaves_of_particle[first:last]


def test_the_order_is_depth_first(topology: Topology) -> None:
    tree = build_tree(topology)
    leaves = len(tree.node)
    assert len(tree.leaf) == len(tree.skip) == 2 * leaves - 1
    assert leaves == 1 << (tree.levels - 1)
    assert tree.leaf[tree.node].tolist() == list(range(leaves))
    assert descendants(tree, 0) == list(range(leaves))
    for node in np.flatnonzero(tree.leaf < 0).tolist():
        left, right = node + 1, int(tree.skip[node + 1])
        assert tree.skip[right] == tree.skip[node]
        assert descendants(tree, left) + descendants(tree, right) == descendants(tree, node)


def test_leaves_are_compact_on_the_sheet() -> None:
    topology = topology_of(17, 17)
    tree = build_tree(topology)
    cell = topology.flat[1, 0] - topology.flat[0, 0]
    for leaf in range(len(tree.node)):
        corners = topology.flat[tree.triangles[tree.first_triangle[leaf] : tree.first_triangle[leaf + 1]]]
        assert np.ptp(corners.reshape(-1, 3), axis=0).max() <= 2.01 * abs(cell)


def test_a_particle_without_triangles_is_a_triangle_without_area(topology: Topology) -> None:
    alone = int(topology.triangles[0, 0])
    kept = ~(topology.triangles == alone).any(axis=1)
    torn = replace(topology, triangles=topology.triangles[kept], cells=topology.cells[kept])
    if not kept.any():
        pytest.skip("all triangles have this particle")
    tree = build_tree(torn)
    assert [alone] * 3 in tree.triangles.tolist()
    assert sorted(tree.particles.tolist()) == list(range(topology.particle_count))
    assert (tree.edges[:, 0] != tree.edges[:, 1]).all()
