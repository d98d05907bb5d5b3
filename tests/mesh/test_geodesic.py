"""Distances along a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import shaken

from taichi_cloth.mesh import grid
from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.mesh.geodesic import distances_from, pieces_of
from taichi_cloth.mesh.tethers import tethers
from taichi_cloth.scene.model import Cloth, Scene


def test_on_a_flat_sheet_they_are_straight() -> None:
    for points, triangles in ((grid.flat_positions(9, 12, 2.0, 1.0), grid.triangles(9, 12)[0]), shaken(12, 0.3)):
        nearest, away = distances_from(np.array([5]), points, triangles)
        assert set(nearest.tolist()) == {5}
        assert away == pytest.approx(np.linalg.norm(points - points[5], axis=1), abs=1e-6)


def test_from_the_nearest_of_several() -> None:
    points, triangles = shaken(12, 0.3)
    sources = np.array([0, 40, 41, 90])
    nearest, away = distances_from(sources, points, triangles)
    straight = np.linalg.norm(points[:, None] - points[sources], axis=2)
    assert away == pytest.approx(straight.min(axis=1), abs=0.02)
    assert away.min() == 0
    assert (away >= np.linalg.norm(points - points[nearest], axis=1) - 1e-12).all()


def test_they_go_round_a_bend_and_not_through_the_air() -> None:
    flat, triangles = grid.flat_positions(5, 41, 2 * np.pi * 0.9, 0.5), grid.triangles(5, 41)[0]
    rolled = np.stack([np.sin(flat[:, 0]), flat[:, 1], np.cos(flat[:, 0])], axis=-1)
    _, away = distances_from(np.array([0]), rolled, triangles)
    assert away == pytest.approx(np.linalg.norm(flat - flat[0], axis=1), rel=2e-3)
    assert away.max() > 2 * np.linalg.norm(rolled - rolled[0], axis=1).max()


def test_a_piece_that_no_way_leads_to() -> None:
    points, triangles = shaken(5, 0.0)
    both = np.concatenate([points, points + [0, 0, 1]]), np.concatenate([triangles, triangles + len(points)])
    nearest, away = distances_from(np.array([0]), *both)
    assert (nearest[len(points) :] == np.arange(len(points), 2 * len(points))).all()
    assert (away[len(points) :] == 0).all()


def test_pieces_are_joined_by_edges() -> None:
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [5, 6]], np.int32)
    chosen = np.array([1, 1, 0, 1, 1, 1, 0], bool)
    assert [piece.tolist() for piece in pieces_of(edges, chosen)] == [[0, 1], [3, 4], [5]]


def test_tethers_of_a_mesh() -> None:
    """The middle of the round sheet and a point of its hem: two runs, each particle tied to both."""
    topology = topology_of(Scene(cloth=Cloth(file="round", scale=1.0, center=(0, 0, 0), pins=(0, 1500))), "fabric")
    pins, reach = tethers(topology)
    assert pins.shape == reach.shape == (2, topology.particle_count)
    assert set(np.unique(pins).tolist()) == {0, 1500}
    assert reach == pytest.approx(np.linalg.norm(topology.start - topology.start[pins], axis=2), abs=1e-5)
    assert (np.diff(reach, axis=0) >= 0).all()
