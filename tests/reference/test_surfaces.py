"""Distances to colliders: exact ones to a mesh, also for moving particles."""

from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.reference.unilateral_contact import MeshDistance, distance_of, rotation_from_euler
from taichi_cloth.scene.collider_schema import Box, Capsule, Mesh, Sphere

CUBE = """v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nv 0 0 1\nv 2 0 1\nv 2 1 1\nv 0 1 1
f 1 4 3\nf 1 3 2\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 3 4 8\nf 3 8 7\nf 1 5 8\nf 1 8 4\nf 2 3 7\nf 2 7 6"""


def test_a_cuboid_mesh_has_the_distances_of_a_box(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    mesh = MeshDistance(Mesh(file="cube.obj", folder=str(tmp_path), margin=0.3))
    box = distance_of(Box(size=(2.0, 1.0, 1.0)))
    random = np.random.default_rng(1)
    x = random.uniform(-1.3, 1.3, (3, 400))
    for _ in range(6):
        distance, normal = mesh(x)
        exact, exact_normal = box(x)
        near = exact < 0.3
        assert distance[near] == pytest.approx(exact[near], abs=1e-12)
        assert (distance[~near] > 0.3 - 1e-12).all()
        outside = near & (exact > 1e-6)
        assert normal[:, outside] == pytest.approx(exact_normal[:, outside], abs=1e-9)
        x = x + random.normal(0, 0.004, x.shape)


def test_a_fine_mesh_has_the_distances_of_its_shape() -> None:
    """The shipped disc is a fine cylinder; the distance is negative inside."""
    mesh = MeshDistance(Mesh(file="disc", margin=0.05))
    half = mesh._half[:, 0]
    x = np.array([[0.0, 0.0, 0.0], [0.0, half[1] + 0.01, 0.0], [0.5 * half[0], -half[1] - 0.02, 0.0]]).T
    distance, normal = mesh(x)
    assert distance == pytest.approx([-half.min(), 0.01, 0.02], abs=1e-9)
    assert normal[:, 1] == pytest.approx([0, 1, 0])
    assert normal[:, 2] == pytest.approx([0, -1, 0])


@pytest.mark.parametrize(
    "shape", [Sphere(radius=0.4, margin=0.15, friction=0.0), Capsule(length=1.0, radius=0.2), Box(size=(1.0, 0.5, 0.3))]
)
def test_the_normal_is_the_gradient_of_the_distance(shape: Sphere | Capsule | Box) -> None:
    of, tiny = distance_of(shape), 1e-6
    x = np.random.default_rng(4).uniform(-0.8, 0.8, (3, 200))
    distance, normal = of(x)
    for k in range(3):
        step = tiny * np.eye(3)[:, [k]]
        assert (of(x + step)[0] - of(x - step)[0]) / (2 * tiny) == pytest.approx(normal[k], abs=1e-4)
    assert distance.min() < 0 < distance.max()


def test_angles_rotate_about_x_then_y_then_z() -> None:
    assert rotation_from_euler(np.array([90.0, 0.0, 90.0])) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert rotation_from_euler(np.array([0.0, 90.0, 90.0])) @ [0, 0, 1] == pytest.approx([0, 1, 0])
