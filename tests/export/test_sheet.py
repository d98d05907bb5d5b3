"""Parts common to all formats: normals, texture coordinates, and the up axis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from taichi_cloth.export.mesh_files import export_mesh_of, rotate_to_up, vertex_normals
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.schema import Cloth, Scene

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)


def volume(x: np.ndarray) -> float:
    """Return the volume of a closed surface, negative if its triangles point inward."""
    a, b, c = (x[OUTWARD[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


@given(arrays(np.float64, (4, 3), elements=st.floats(-1e3, 1e3)))
def test_z_up_is_a_proper_rotation(x: np.ndarray) -> None:
    z_up = rotate_to_up(x, "z")
    assert (z_up == np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1)).all()
    assert volume(z_up) == pytest.approx(volume(x), rel=1e-9, abs=1e-3)
    assert np.linalg.norm(z_up, axis=1) == pytest.approx(np.linalg.norm(x, axis=1))
    assert rotate_to_up(x, "y") is x


def test_z_up_maps_up_to_up_without_mirroring() -> None:
    assert (rotate_to_up(np.eye(3), "z") == [[1, 0, 0], [0, 0, 1], [0, -1, 0]]).all()
    assert volume(rotate_to_up(TETRAHEDRON, "z")) == pytest.approx(1 / 6)


def test_normals_point_outward_and_are_weighted_by_area() -> None:
    normals = vertex_normals(TETRAHEDRON, OUTWARD)
    assert normals == pytest.approx(
        np.array([[-1, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) / [[3**0.5], [1], [1], [1]]
    )
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1)


def test_a_particle_without_area_has_a_zero_normal() -> None:
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0], [5, 5, 5]])
    assert (vertex_normals(line, np.array([[0, 1, 2]], np.int32)) == 0).all()


def test_every_layer_covers_the_texture_from_the_lower_left_corner() -> None:
    cloth = Cloth(rows=3, columns=5, width=2.0, height=0.5, layers=2, layer_spacing=0.1)
    mesh = export_mesh_of(Scene(cloth=cloth), build_topology(Scene(cloth=cloth), "verlet"))
    first, second = mesh.uv.reshape(2, 3, 5, 2)
    assert (first == second).all()
    assert first[0, 0] == pytest.approx([0, 1])
    assert first[2, 4] == pytest.approx([1, 0])
    assert first[1, 1] == pytest.approx([0.25, 0.5])


def test_a_horizontal_mesh_covers_the_texture_too() -> None:
    scene = load_scene("round")  # a disc in the plane y = 0
    mesh = export_mesh_of(scene, build_topology(scene, "fabric"))
    assert mesh.uv.min(axis=0) == pytest.approx([0, 0])
    assert mesh.uv.max(axis=0) == pytest.approx([1, 1])
    assert np.linalg.norm(2 * mesh.uv - 1, axis=1).max() == pytest.approx(1, abs=1e-3)
