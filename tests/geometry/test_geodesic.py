"""Geodesic distances on a mesh, and tethers from them."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import irregular

from taichi_cloth.geometry import grid
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.tethers import connected_components, geodesic_distances, tethers_of
from taichi_cloth.scene.schema import Cloth, Scene


def test_distances_on_a_flat_sheet_are_straight() -> None:
    for points, triangles in ((grid.flat_positions(9, 12, 2.0, 1.0), grid.triangles(9, 12)[0]), irregular(12, 0.3)):
        nearest, distance = geodesic_distances(np.array([5]), points, triangles)
        assert set(nearest.tolist()) == {5}
        assert distance == pytest.approx(np.linalg.norm(points - points[5], axis=1), abs=1e-6)


def test_distances_are_from_the_nearest_of_several_sources() -> None:
    points, triangles = irregular(12, 0.3)
    sources = np.array([0, 40, 41, 90])
    nearest, distance = geodesic_distances(sources, points, triangles)
    straight = np.linalg.norm(points[:, None] - points[sources], axis=2)
    assert distance == pytest.approx(straight.min(axis=1), abs=0.02)
    assert distance.min() == 0
    assert (distance >= np.linalg.norm(points - points[nearest], axis=1) - 1e-12).all()


def test_distances_on_a_rolled_sheet_are_along_the_sheet() -> None:
    flat, triangles = grid.flat_positions(5, 41, 2 * np.pi * 0.9, 0.5), grid.triangles(5, 41)[0]
    rolled = np.stack([np.sin(flat[:, 0]), flat[:, 1], np.cos(flat[:, 0])], axis=-1)
    _, distance = geodesic_distances(np.array([0]), rolled, triangles)
    assert distance == pytest.approx(np.linalg.norm(flat - flat[0], axis=1), rel=2e-3)
    assert distance.max() > 2 * np.linalg.norm(rolled - rolled[0], axis=1).max()


def test_vertices_without_a_source_are_their_own() -> None:
    points, triangles = irregular(5, 0.0)
    both = np.concatenate([points, points + [0, 0, 1]]), np.concatenate([triangles, triangles + len(points)])
    nearest, distance = geodesic_distances(np.array([0]), *both)
    assert (nearest[len(points) :] == np.arange(len(points), 2 * len(points))).all()
    assert (distance[len(points) :] == 0).all()


def test_connected_components_are_joined_by_edges() -> None:
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [5, 6]], np.int32)
    chosen = np.array([1, 1, 0, 1, 1, 1, 0], bool)
    assert [component.tolist() for component in connected_components(edges, chosen)] == [[0, 1], [3, 4], [5]]


def test_tethers_of_a_mesh() -> None:
    """The center of the round sheet and a vertex on its edge are two runs; each particle is tethered to both."""
    topology = build_topology(Scene(cloth=Cloth(file="round", scale=1.0, center=(0, 0, 0), pins=(0, 1500))), "fabric")
    pins, reach = tethers_of(topology)
    assert pins.shape == reach.shape == (2, topology.particle_count)
    assert set(np.unique(pins).tolist()) == {0, 1500}
    assert reach == pytest.approx(np.linalg.norm(topology.start - topology.start[pins], axis=2), abs=1e-5)
    assert (np.diff(reach, axis=0) >= 0).all()
