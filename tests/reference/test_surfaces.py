"""Distances to colliders: exact ones to a mesh, also for moving particles."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.reference.collider_distance import ClipDistance, MeshDistance, distance_of
from taichi_cloth.evaluation.reference.solution import Motion
from taichi_cloth.evaluation.reference.unilateral_contact import obstacles_of, pose, rotation_from_euler
from taichi_cloth.scene.collider_schema import Box, Capsule, Mesh, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver

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


# -- meshes with a clip ------------------------------------------------------------------------------------------------

WALKER = Mesh(file="walker", clip="walker.pc2", clip_rate=20.0, margin=0.008, friction=0.3)


def test_a_mesh_with_a_clip_has_the_distances_of_its_shape_at_a_time() -> None:
    """Also if lists of triangles that may be nearest are kept from one time to the next."""
    moving, random = distance_of(WALKER), np.random.default_rng(2)
    assert isinstance(moving, ClipDistance)
    first = MeshDistance(replace(WALKER, clip_time=0.0))
    surface = first._corners.mean(axis=0)
    x = surface[:, ::40] + random.normal(0, 0.01, surface[:, ::40].shape)
    for seconds in (0.0, 0.004, 0.008, 0.05, 0.052, 0.4):
        moving.move_to(seconds)
        distance, normal = moving(x)
        exact, exact_normal = MeshDistance(replace(WALKER, clip_time=seconds))(x)
        near = np.abs(exact) < WALKER.margin
        assert near.sum() > 10
        assert distance[near] == pytest.approx(exact[near], abs=1e-9)
        assert normal[:, near] == pytest.approx(exact_normal[:, near], abs=1e-6)
        assert (distance[exact > moving.reach] > WALKER.margin).all()


@pytest.fixture
def growing(tmp_path: Path) -> Mesh:
    """A cuboid that moves by 0.2 m along y in 0.1 s, as it becomes three times as long along x. Its center is at 0."""
    points = [line.split()[1:] for line in CUBE.splitlines() if line.startswith("v")]
    faces = "\n".join(line for line in CUBE.splitlines() if line.startswith("f"))
    for k in range(3):
        rows = [(1 + (float(x) - 1) * (1 + k), float(y) + 0.2 * k, float(z)) for x, y, z in points]
        text = "\n".join(f"v {x} {y} {z}" for x, y, z in rows)
        (tmp_path / f"step_{k}.obj").write_text(f"{text}\n{faces}")
    (tmp_path / "cube.obj").write_text(CUBE)
    keys = {"clip": "step_*.obj", "clip_rate": 10.0, "center": (0.0, 0.0, 0.0), "margin": 0.1, "friction": 0.5}
    return Mesh(file="cube.obj", folder=str(tmp_path), **keys)


def test_the_material_of_a_mesh_with_a_clip_has_a_velocity(growing: Mesh) -> None:
    """Its end moves at 10 m/s, and its middle only with it, along y."""
    [obstacle] = obstacles_of(Scene(meshes=(growing,)))
    assert obstacle.still is None
    at = obstacle.pose(0.05)
    x = np.array([[1.55, 0.1, 0.0], [0.0, 0.65, 0.0], [0.75, 0.65, 0.1], [0.0, 3.0, 0.0]]).T
    gap, normal = obstacle.gap(x, at)
    assert gap[:3] == pytest.approx([-0.05, -0.05, -0.05])
    assert normal[:, 0] == pytest.approx([1, 0, 0])
    velocity = obstacle.surface_velocity(x, at)
    assert pytest.approx(np.array([[10, 2, 0], [0, 2, 0], [5, 2, 0], [0, 0, 0]]), abs=1e-3) == velocity.T
    assert pose(growing, 0.05).velocity == pytest.approx([0, 0, 0])


def test_a_mesh_with_a_clip_carries_and_lifts_cloth(growing: Mesh) -> None:
    """A patch on its top rises with it. Friction would take it along the top, whose middle does not move that way."""
    cloth = Cloth(
        rows=3, columns=3, width=0.1, height=0.1, center=(0.0, 0.6001, 0.0), rotation=(-90.0, 0.0, 0.0), pins=()
    )
    scene = Scene(
        cloth=cloth,
        fabric=Fabric(warp=1.0, weft=1.0, shear=0.5, bend_spring=0.0),
        meshes=(growing,),
        forces=Forces(gravity=50.0),
        solver=Solver(damping=0.0),
    )
    motion = Motion(scene, 20)
    for _ in range(6):
        x = motion.step_frame()
    assert x[:, 1] == pytest.approx(np.full(9, 0.8), abs=1e-3)
    assert motion.v[1] == pytest.approx(np.full(9, 2.0), abs=1e-3)
    assert x.mean(axis=0)[[0, 2]] == pytest.approx([0, 0], abs=1e-6)
    assert np.ptp(x[:, 0]) > 0.11  # its edges are taken along
