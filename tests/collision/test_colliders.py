"""Colliders: their pose, distances to them, and that kernels move particles out of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from serial_kernels import run_serially

from taichi_cloth import state
from taichi_cloth.collision.colliders import (
    PosedCollider,
    collider_counts,
    collider_table,
    is_static,
    max_penetration,
    pose,
    pose_colliders,
    ray_cast,
    rotation_from_vector,
    rotation_vector_between,
    shape_of,
    signed_distance,
)
from taichi_cloth.collision.response import resolve_contacts
from taichi_cloth.geometry.signed_distance import collider_sdf
from taichi_cloth.geometry.topology import Topology, build_sheet
from taichi_cloth.kernels import step_params as c
from taichi_cloth.scene.collider_schema import Box, Capsule, Collider, Ground, Mesh, Plane, Sphere
from taichi_cloth.scene.keys import Vec3, keys_of
from taichi_cloth.solvers import Features
from taichi_cloth.state.contact_data import acquire_sdf, release_sdf

pytestmark = pytest.mark.bounds

ORIGIN = (0.0, 0.0, 0.0)
DOWN = np.array([0.0, -1.0, 0.0])
FRAME = 1 / 60

angles = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


def free_sheet(rows: int, side: float, center: Vec3 = ORIGIN, rotation: Vec3 = ORIGIN) -> Topology:
    """Return a square sheet with as many columns as rows."""
    return build_sheet(
        rows=rows,
        columns=rows,
        width=side,
        height=side,
        center=center,
        rotation=rotation,
        area_density=0.2,
        pins=(),
        directions=[True] * 6,
    )


def at(collider: Collider | Ground, seconds: float = 0.0) -> PosedCollider:
    return pose_colliders([collider], seconds)[0]


def test_oscillation_keyframes_and_spin_at_some_times() -> None:
    oscillating = Sphere(
        center=(1.0, 2.0, 3.0),
        oscillation=(0.5, 0.0, 0.0),
        period=(4.0, 1.0, 1.0),
        phase=(90.0, 0.0, 0.0),
        margin=0.15,
        friction=0.0,
    )
    assert pose(oscillating, 0.0)[0] == pytest.approx([1.5, 2, 3])
    assert pose(oscillating, 1.0)[0] == pytest.approx([1.0, 2, 3])
    keyframes = ((1.0, 0.0, 0.0, 0.0), (3.0, 0.0, 4.0, 0.0, 0.0, 90.0, 0.0))
    box = Box(center=ORIGIN, keyframes=keyframes)
    for seconds, y, angle in ((0.0, 0.0, 0.0), (2.0, 2.0, 45.0), (9.0, 4.0, 90.0)):
        center, axes = pose(box, seconds)
        assert center == pytest.approx([0, y, 0])
        assert axes[:, 0] == pytest.approx([np.cos(np.radians(angle)), 0, -np.sin(np.radians(angle))], abs=1e-12)
    spinning = Capsule(rotation=(0.0, 0.0, 90.0), spin=(0.0, 30.0, 0.0))
    assert pose(spinning, 3.0)[1][:, 1] == pytest.approx([0, 0, 1], abs=1e-12)  # initially along −x
    assert not any(is_static(one) for one in (oscillating, box, spinning))
    assert all(is_static(one) for one in (Box(), Ground(), Plane()))


@given(angles, angles)
def test_the_rotation_vector_between_two_poses(first: np.ndarray, by: np.ndarray) -> None:
    assume(np.linalg.norm(by) < 3.1)  # beyond half a turn there is a shorter rotation
    before = rotation_from_vector(first)
    assert before @ before.T == pytest.approx(np.eye(3), abs=1e-12)
    assert rotation_vector_between(before, rotation_from_vector(by) @ before) == pytest.approx(by, abs=1e-6)


def test_the_rotation_of_a_frame_is_exact_for_the_fastest_spin() -> None:
    fastest = keys_of(Capsule)["spin"].max
    assert fastest is not None
    for spin in ((fastest, fastest, fastest), (-fastest, 0.0, fastest)):
        capsule = Capsule(spin=spin)
        rotation = rotation_vector_between(pose(capsule, 1.0)[1], pose(capsule, 1.0 + FRAME)[1])
        assert rotation == pytest.approx(np.radians(spin) * FRAME, rel=1e-6)


POINTS = np.array([[0.0, 3.0, 0.0], [0.0, 0.1, 0.0], [2.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("collider", "distances"),
    [
        (Sphere(center=ORIGIN, radius=1.0, margin=0.15, friction=0.0), (2.0, -0.9, 1.0)),
        (Capsule(center=ORIGIN, length=2.0, radius=0.5), (1.5, -0.5, 1.5)),
        (Capsule(center=ORIGIN, length=2.0, radius=0.5, rotation=(0.0, 0.0, 90.0)), (2.5, -0.4, 0.5)),
        (Box(center=ORIGIN, size=(1.0, 2.0, 4.0)), (2.0, -0.5, 1.5)),
        (Box(center=ORIGIN, size=(1.0, 2.0, 4.0), rotation=(0.0, 0.0, 90.0)), (2.5, -0.4, 1.0)),
        (Plane(), (3.0, 0.1, 0.0)),
        (Plane(center=(0.0, 1.0, 0.0), rotation=(0.0, 0.0, -90.0)), (0.0, 0.0, 2.0)),
        (Ground(height=-1.0), (4.0, 1.1, 1.0)),
    ],
)
def test_signed_distances_by_hand(collider: Collider | Ground, distances: tuple[float, ...]) -> None:
    assert signed_distance(at(collider), POINTS) == pytest.approx(distances, abs=1e-12)
    assert max_penetration([at(collider)], POINTS) == pytest.approx(max(0.0, *(-d for d in distances)), abs=1e-12)


def test_without_colliders_nothing_is_hit() -> None:
    assert max_penetration([], POINTS) == 0
    assert ray_cast([], np.zeros(3), DOWN) == np.inf


@pytest.mark.parametrize(
    ("origin", "hit"),
    [((0, 3, 0), 2), ((0.6, 3, 0), 2.2), ((1.1, 3, 0), np.inf), ((0, -3, 0), np.inf), ((0, 0.2, 0), np.inf)],
    ids=["through the center", "off center", "beside", "behind", "from inside"],
)
def test_a_ray_and_a_sphere(origin: tuple[float, float, float], hit: float) -> None:
    assert ray_cast(
        [at(Sphere(center=ORIGIN, radius=1.0, margin=0.15, friction=0.0))], np.array(origin, float), DOWN
    ) == pytest.approx(hit, abs=1e-4)


@pytest.mark.parametrize(
    ("origin", "hit"),
    [((0, 3, 0), 2.5), ((0.9, 3, 2.9), 2.5), ((1.1, 3, 0), np.inf), ((0, -3, 0), np.inf)],
    ids=["through the center", "near a corner", "beside", "behind"],
)
def test_a_ray_and_a_box(origin: tuple[float, float, float], hit: float) -> None:
    box = at(Box(center=ORIGIN, size=(2.0, 1.0, 6.0)))
    assert ray_cast([box], np.array(origin, float), DOWN) == pytest.approx(hit, abs=1e-4)
    assert ray_cast([at(Ground(height=-5.0)), box], np.array(origin, float), DOWN) == pytest.approx(
        min(hit, origin[1] + 5 if origin[1] > 0 else 2.0), abs=1e-4
    )


SHAPES = {
    "spheres": Sphere(radius=0.3, margin=0.1, friction=0.0),
    "capsules": Capsule(length=0.5, radius=0.2, margin=0.05, friction=0.0),
    "boxes": Box(center=(0.0, 1.0, 0.0), size=(0.6, 0.9, 0.5), margin=0.03, friction=0.0),
    "planes": Plane(center=(0.0, 1.0, 0.0), margin=0.04, friction=0.0),
    "meshes": Mesh(file="bust", scale=2.0, resolution=48, margin=0.03, friction=0.0),
}


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("substep", [0, 3, 4])
def test_particles_leave_a_moving_and_rotating_collider_by_the_shortest_displacement(kind: str, substep: int) -> None:
    """The pose in the kernel at a substep is that of NumPy: centers follow a parabola in a frame."""
    still = SHAPES[kind]
    oscillation, period = (0.2, 0.1, 0.3), (0.5, 0.7, 0.9)
    moving = replace(
        still, rotation=(20.0, -30.0, 50.0), spin=(400.0, 90.0, -700.0), oscillation=oscillation, period=period
    )
    start, substeps = 0.4, 5
    before, middle, after = (at(moving, start + part * FRAME) for part in (0.0, 0.5, 1.0))
    share = (substep + 1) / substeps
    bend = middle.center - (before.center + after.center) / 2
    now = PosedCollider(
        moving,
        before.center + share * (after.center - before.center) + 4 * share * (1 - share) * bend,
        rotation_from_vector(share * rotation_vector_between(before.axes, after.axes)) @ before.axes,
        np.array(shape_of(moving).size(moving)),
    )
    topology = free_sheet(12, 1.0)
    x = now.center + np.random.default_rng(3).uniform(-0.6, 0.6, topology.start.shape)
    cloth = state.acquire_state(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    cloth.upload_positions(x, x, state.inverse_mass(topology))
    colliders = collider_table([moving], start, start + FRAME)
    params = np.zeros(c.PARAM_COUNT, np.float32)
    sdf = acquire_sdf([collider_sdf(still)] if isinstance(still, Mesh) else [])
    features = Features(colliders=collider_counts([still]), sdf=sdf)
    run_serially(resolve_contacts, cloth, features, substep, substeps, 1 / 300, -1, params, colliders)
    out = cloth.to_numpy(cloth.x).astype(np.float64)
    state.release_state(cloth)
    release_sdf(sdf)
    distance, distance_out = signed_distance(now, x), signed_distance(now, out)
    assert (distance < still.margin).sum() > 10
    if kind == "meshes":  # deep inside, the interpolated gradient does not point straight out
        assert distance_out.min() >= still.margin - 1e-3
        return
    assert distance_out.min() >= still.margin - 1e-5
    assert np.linalg.norm(out - x, axis=1) == pytest.approx(np.maximum(0.0, still.margin - distance), abs=2e-5)


def test_a_rotating_plate_drags_cloth_along() -> None:
    """Friction uses the velocity of the surface: 0.3 m from the axis, 90°/s is 0.47 m/s."""
    topology = free_sheet(2, 0.02, center=(0.3, 0.0, 0.0), rotation=(-90.0, 0.0, 0.0))
    cloth = state.acquire_state(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    low = topology.start - [0.0, 0.05, 0.0]
    cloth.upload_positions(low, topology.start, state.inverse_mass(topology))
    plate = Plane(center=ORIGIN, margin=0.0, friction=1.0, spin=(0.0, 90.0, 0.0))
    colliders = collider_table([plate], 0.0, FRAME)
    run_serially(
        resolve_contacts,
        cloth,
        Features(colliders=collider_counts([plate])),
        0,
        1,
        FRAME,
        -1,
        np.zeros(c.PARAM_COUNT, np.float32),
        colliders,
    )
    moved = cloth.to_numpy(cloth.x) - topology.start
    state.release_state(cloth)
    assert moved[:, 2] == pytest.approx(-topology.start[:, 0] * np.radians(90) / 60, rel=0.02)
    assert moved[:, 1] == pytest.approx(0.0, abs=1e-6)


ALONG = ((0.0, 0.0, 0.0, 0.0), (1.0, 0.6, 0.0, 0.0))  # [s, m]: 1 cm a frame
# Each with its top at y = 0.
LEVEL: dict[str, Collider] = {
    "planes": Plane(center=ORIGIN),
    "boxes": Box(center=(0.0, -0.5, 0.0), size=(2.0, 1.0, 2.0)),
    "spheres": Sphere(center=(0.0, -5.0, 0.0), radius=5.0, margin=0.15, friction=0.0),
    "capsules": Capsule(center=(0.0, -5.2, 0.0), length=0.4, radius=5.0),
    "meshes": Mesh(center=(0.0, -0.5, 0.0), file="cube.obj", resolution=24),
}
CUBE = [
    *(f"v {x} {y} {z}" for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)),
    *("f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"),
]


@pytest.mark.parametrize("continuous", [False, True])
@pytest.mark.parametrize("kind", LEVEL)
def test_a_moving_collider_drags_cloth_along(kind: str, continuous: bool, tmp_path: Path) -> None:
    """Cloth 5 cm inside, with a friction of 1, sticks to a surface that moves by 1 cm in the frame."""
    (tmp_path / "cube.obj").write_text("\n".join(CUBE))
    where: dict[str, Any] = {"folder": str(tmp_path)} if kind == "meshes" else {}
    collider = replace(LEVEL[kind], keyframes=ALONG, margin=0.0, friction=1.0, continuous=continuous, **where)
    topology = free_sheet(2, 0.02, rotation=(-90.0, 0.0, 0.0))
    cloth = state.acquire_state(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    cloth.upload_positions(topology.start - [0.0, 0.05, 0.0], topology.start, state.inverse_mass(topology))
    sdf = acquire_sdf([collider_sdf(collider)] if isinstance(collider, Mesh) else [])
    features = Features(colliders=collider_counts([collider]), continuous=continuous, sdf=sdf)
    params = np.zeros(c.PARAM_COUNT, np.float32)
    run_serially(resolve_contacts, cloth, features, 0, 1, FRAME, -1, params, collider_table([collider], 0.0, FRAME))
    moved = cloth.to_numpy(cloth.x) - topology.start
    state.release_state(cloth)
    release_sdf(sdf)
    assert moved[:, 0] == pytest.approx(0.01, rel=0.02)
    assert moved[:, [1, 2]] == pytest.approx(0.0, abs=2e-4)  # a round top is lower off center


def test_rocking_has_the_phase_of_the_oscillation() -> None:
    """After a quarter of its period angle and offset are at their amplitude, after half of it both are zero."""
    leg = Capsule(
        center=(0.0, 1.0, 0.0), oscillation=(0.0, 0.0, 0.2), rocking=(-30.0, 0.0, 0.0), period=(2.0, 1.0, 2.0)
    )
    center, axes = pose(leg, 0.5)
    assert center == pytest.approx([0.0, 1.0, 0.2])
    assert axes[:, 1] == pytest.approx([0.0, np.cos(np.pi / 6), -0.5])
    center, axes = pose(leg, 1.0)
    assert center == pytest.approx([0.0, 1.0, 0.0])
    assert axes == pytest.approx(np.eye(3))
    assert not is_static(Capsule(rocking=(0.0, 1.0, 0.0)))
