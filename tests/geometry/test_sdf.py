"""Signed distance grids, compared with exact distances."""

from __future__ import annotations

import numpy as np
import pytest

from taichi_cloth.geometry import signed_distance as distances
from taichi_cloth.geometry.closed_surface import Surface, closed_surface, closest_point_on_triangle
from taichi_cloth.geometry.signed_distance import MAX_NODES, DistanceGrid, check_size, distance_grid

RING, TUBE = 0.4, 0.15  # [m] radii of a torus
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SQUARES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def torus(around: int, across: int) -> Surface:
    u, v = np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in (around, across)), indexing="ij")
    wide = RING + TUBE * np.cos(v)
    points = np.stack([wide * np.cos(u), TUBE * np.sin(v), wide * np.sin(u)], axis=-1).reshape(-1, 3)
    a = np.arange(around * across).reshape(around, across)
    b, c, d = np.roll(a, -1, 0), np.roll(np.roll(a, -1, 0), -1, 1), np.roll(a, -1, 1)
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return closed_surface(points, faces.astype(np.int32))


def cube() -> Surface:
    return closed_surface(CUBE, np.concatenate([SQUARES[:, [0, 1, 2]], SQUARES[:, [0, 2, 3]]]).astype(np.int32))


def nodes_of(grid: DistanceGrid) -> np.ndarray:
    axes = [np.linspace(-h, h, n) for h, n in zip(grid.half, grid.values.shape, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def exact(surface: Surface, positions: np.ndarray) -> np.ndarray:
    """Return the unsigned distance of each position [m], from all faces."""
    corners = surface.corners
    found = []
    for position in positions:
        shares = closest_point_on_triangle(np.tile(position, (len(corners), 1)), corners)
        found.append(np.linalg.norm(np.einsum("ij,ijk->ik", shares, corners) - position, axis=1).min())
    return np.array(found)


def test_distances_to_a_cube_are_exact_at_nodes() -> None:
    grid = distance_grid(cube(), 10, 0.2)
    positions = nodes_of(grid)
    beyond = np.abs(positions) - 0.5
    expected = np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
    assert grid.values.shape == (19, 19, 19)
    assert grid.values.ravel() == pytest.approx(expected, abs=1e-6)


def test_distances_to_a_torus_are_exact_at_nodes() -> None:
    surface = torus(40, 20)
    grid = distance_grid(surface, 32, 0.05)
    positions = nodes_of(grid)
    some = np.random.default_rng(2).choice(len(positions), 600, replace=False)
    assert np.abs(grid.values.ravel()[some]) == pytest.approx(exact(surface, positions[some]), abs=1e-6)
    smooth = np.hypot(np.hypot(positions[:, 0], positions[:, 2]) - RING, positions[:, 1]) - TUBE
    clear = np.abs(smooth) > 0.003  # the polygons lie up to 2 mm inside the torus
    assert (np.sign(grid.values.ravel()[clear]) == np.sign(smooth[clear])).all()


@pytest.mark.parametrize("cells", [24, 48])
def test_between_nodes_the_error_is_that_of_linear_interpolation(cells: int) -> None:
    """The error is at most h²/8 times the curvatures of the offset surfaces, which are largest inside."""
    deep = 0.03
    surface = torus(80, 40)
    grid = distance_grid(surface, cells, deep)
    u, v, off = np.random.default_rng(3).uniform([0, 0, -deep], [2 * np.pi, 2 * np.pi, deep], (400, 3)).T
    wide = RING + (TUBE + off) * np.cos(v)
    positions = np.stack([wide * np.cos(u), (TUBE + off) * np.sin(v), wide * np.sin(u)], axis=1)
    error = np.abs(np.abs(grid.at(positions)) - exact(surface, positions))
    deepest = deep + grid.spacing  # of the surrounding nodes
    assert error.max() < grid.spacing**2 / 8 * (1 / (TUBE - deepest) + 1 / (RING - TUBE - deepest))


def test_outside_the_grid_the_distance_is_a_lower_bound() -> None:
    grid = distance_grid(cube(), 10, 0.0)
    positions = np.random.default_rng(5).normal(size=(500, 3)) * 3
    beyond = np.maximum(np.abs(positions) - 0.5, 0)
    true = np.linalg.norm(beyond, axis=1)
    far = (np.abs(positions) > grid.half).any(axis=1)
    assert far.sum() > 300
    found = grid.at(positions[far])
    assert (found <= true[far] + 1e-6).all()
    # It is too low by at most the distance from the cube to the outermost nodes.
    assert (found > true[far] - 2 * 3**0.5 * grid.spacing).all()


def test_too_large_grids_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for cells, reach in ((256, 0.1), (10, 1e4)):
        with pytest.raises(ValueError, match=f"nodes, more than {MAX_NODES}"):
            check_size(cube(), cells, reach)
    monkeypatch.setattr(distances, "MAX_PAIRS", 1000)
    with pytest.raises(ValueError, match="its 12 faces span too many grid cells"):
        check_size(cube(), 10, 0.1)
