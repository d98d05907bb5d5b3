"""Colliders: where they are, how far points are from them, and that kernels push particles out of the same bodies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from serially import run_serially

from taichi_cloth import state
from taichi_cloth.contact.bodies import (
    Body,
    bodies_at,
    body_table,
    distance,
    first_hit,
    is_still,
    penetration,
    pose,
    size_of,
    turn_between,
    turned,
)
from taichi_cloth.contact.push_out import push_out
from taichi_cloth.kernels import controls as c
from taichi_cloth.mesh.solid import distances_of
from taichi_cloth.mesh.topology import Topology, sheet
from taichi_cloth.scene.model import Box, Capsule, Collider, Ground, Mesh, Plane, Sphere, Vec3, keys_of
from taichi_cloth.solvers import Stages
from taichi_cloth.state import distances

ORIGIN = (0.0, 0.0, 0.0)
DOWN = np.array([0.0, -1.0, 0.0])
FRAME = 1 / 60

angles = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


def free_sheet(rows: int, side: float, center: Vec3 = ORIGIN, rotation: Vec3 = ORIGIN) -> Topology:
    """A square with as many columns as rows."""
    return sheet(
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


def at(collider: Collider | Ground, seconds: float = 0.0) -> Body:
    return bodies_at([collider], seconds)[0]


def test_a_sway_a_path_and_a_spin_at_hand_times() -> None:
    sway = Sphere(center=(1.0, 2.0, 3.0), sway=(0.5, 0.0, 0.0), period=(4.0, 1.0, 1.0), phase=(90.0, 0.0, 0.0))
    assert pose(sway, 0.0)[0] == pytest.approx([1.5, 2, 3])
    assert pose(sway, 1.0)[0] == pytest.approx([1.0, 2, 3])
    path = ((1.0, 0.0, 0.0, 0.0), (3.0, 0.0, 4.0, 0.0, 0.0, 90.0, 0.0))
    box = Box(center=ORIGIN, path=path)
    for seconds, y, angle in ((0.0, 0.0, 0.0), (2.0, 2.0, 45.0), (9.0, 4.0, 90.0)):
        center, axes = pose(box, seconds)
        assert center == pytest.approx([0, y, 0])
        assert axes[:, 0] == pytest.approx([np.cos(np.radians(angle)), 0, -np.sin(np.radians(angle))], abs=1e-12)
    spinning = Capsule(rotation=(0.0, 0.0, 90.0), spin=(0.0, 30.0, 0.0))
    assert pose(spinning, 3.0)[1][:, 1] == pytest.approx([0, 0, 1], abs=1e-12)  # it lay along −x
    assert [is_still(one) for one in (sway, box, spinning, Box(), Ground(), Plane())] == [False] * 3 + [True] * 3


@given(angles, angles)
def test_the_turn_between_two_poses_leads_from_one_to_the_other(first: np.ndarray, by: np.ndarray) -> None:
    assume(np.linalg.norm(by) < 3.1)  # beyond half a turn there is a shorter way
    before = turned(first)
    assert before @ before.T == pytest.approx(np.eye(3), abs=1e-12)
    assert turn_between(before, turned(by) @ before) == pytest.approx(by, abs=1e-6)


def test_the_fastest_spin_a_scene_may_ask_for_is_seen_as_it_is() -> None:
    fastest = keys_of(Capsule)["spin"].high
    for spin in ((fastest,) * 3, (-fastest, 0.0, fastest)):
        body = Capsule(spin=spin)
        turn = turn_between(pose(body, 1.0)[1], pose(body, 1.0 + FRAME)[1])
        assert turn == pytest.approx(np.radians(spin) * FRAME, rel=1e-6)


POINTS = np.array([[0.0, 3.0, 0.0], [0.0, 0.1, 0.0], [2.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("collider", "distances"),
    [
        (Sphere(center=ORIGIN, radius=1.0), (2.0, -0.9, 1.0)),
        (Capsule(center=ORIGIN, length=2.0, radius=0.5), (1.5, -0.5, 1.5)),
        (Capsule(center=ORIGIN, length=2.0, radius=0.5, rotation=(0.0, 0.0, 90.0)), (2.5, -0.4, 0.5)),
        (Box(center=ORIGIN, size=(1.0, 2.0, 4.0)), (2.0, -0.5, 1.5)),
        (Box(center=ORIGIN, size=(1.0, 2.0, 4.0), rotation=(0.0, 0.0, 90.0)), (2.5, -0.4, 1.0)),
        (Plane(), (3.0, 0.1, 0.0)),
        (Plane(center=(0.0, 1.0, 0.0), rotation=(0.0, 0.0, -90.0)), (0.0, 0.0, 2.0)),
        (Ground(height=-1.0), (4.0, 1.1, 1.0)),
    ],
)
def test_distances_by_hand(collider: Collider | Ground, distances: tuple[float, ...]) -> None:
    assert distance(at(collider), POINTS) == pytest.approx(distances, abs=1e-12)
    assert penetration([at(collider)], POINTS) == pytest.approx(max(0.0, *(-d for d in distances)), abs=1e-12)


def test_nothing_is_in_no_body() -> None:
    assert penetration([], POINTS) == 0
    assert first_hit([], np.zeros(3), DOWN) == np.inf


@pytest.mark.parametrize(
    ("origin", "hit"),
    [((0, 3, 0), 2), ((0.6, 3, 0), 2.2), ((1.1, 3, 0), np.inf), ((0, -3, 0), np.inf), ((0, 0.2, 0), np.inf)],
    ids=["through the middle", "off the middle", "beside", "behind", "from inside"],
)
def test_a_ray_and_a_ball(origin: tuple[float, float, float], hit: float) -> None:
    assert first_hit([at(Sphere(center=ORIGIN, radius=1.0))], np.array(origin, float), DOWN) == pytest.approx(
        hit, abs=1e-4
    )


@pytest.mark.parametrize(
    ("origin", "hit"),
    [((0, 3, 0), 2.5), ((0.9, 3, 2.9), 2.5), ((1.1, 3, 0), np.inf), ((0, -3, 0), np.inf)],
    ids=["through the middle", "near a corner", "beside", "behind"],
)
def test_a_ray_and_a_box(origin: tuple[float, float, float], hit: float) -> None:
    box = at(Box(center=ORIGIN, size=(2.0, 1.0, 6.0)))
    assert first_hit([box], np.array(origin, float), DOWN) == pytest.approx(hit, abs=1e-4)
    assert first_hit([at(Ground(height=-5.0)), box], np.array(origin, float), DOWN) == pytest.approx(
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
def test_particles_leave_a_moving_and_turning_body_by_the_shortest_way(kind: str, substep: int) -> None:
    """The kernel's body at a substep is NumPy's body at that time."""
    still = SHAPES[kind]
    sway, period = (0.2, 0.1, 0.3), (0.5, 0.7, 0.9)
    moving = replace(still, rotation=(20.0, -30.0, 50.0), spin=(400.0, 90.0, -700.0), sway=sway, period=period)
    start, substeps = 0.4, 5
    body = at(moving, start)
    after = at(moving, start + FRAME)
    share = (substep + 1) / substeps
    now = Body(
        moving,
        body.center + share * (after.center - body.center),
        turned(share * turn_between(body.axes, after.axes)) @ body.axes,
        size_of(moving),
    )
    topology = free_sheet(12, 1.0)
    x = now.center + np.random.default_rng(3).uniform(-0.6, 0.6, topology.start.shape)
    cloth = state.take(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    cloth.put(x, x, state.inverse_mass(topology))
    bodies = body_table([moving], start, start + FRAME)
    controls = np.zeros(c.COUNT, np.float32)
    grids = distances.take([distances_of(still)] if isinstance(still, Mesh) else [])
    stages = Stages(**{kind: 1}, distances=grids)
    run_serially(push_out, cloth, stages, substep, substeps, 1 / 300, -1, controls, bodies)
    out = cloth.taken(cloth.x)
    state.give_back(cloth)
    distances.give_back(grids)
    before, behind = distance(now, x), distance(now, out)
    assert (before < still.margin).sum() > 10
    if kind == "meshes":  # from deep in a limb the gradient between nodes does not lead straight out
        assert behind.min() >= still.margin - 1e-3
        return
    assert behind.min() >= still.margin - 1e-5
    assert np.linalg.norm(out - x, axis=1) == pytest.approx(np.maximum(0.0, still.margin - before), abs=2e-5)


def test_a_turning_plate_carries_what_lies_on_it() -> None:
    """Friction sees the surface's velocity: 0.3 m from the axis, 90°/s is 0.47 m/s."""
    topology = free_sheet(2, 0.02, center=(0.3, 0.0, 0.0), rotation=(-90.0, 0.0, 0.0))
    cloth = state.take(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    low = topology.start - [0.0, 0.05, 0.0]
    cloth.put(low, topology.start, state.inverse_mass(topology))
    plate = Plane(center=ORIGIN, margin=0.0, friction=1.0, spin=(0.0, 90.0, 0.0))
    bodies = body_table([plate], 0.0, FRAME)
    run_serially(push_out, cloth, Stages(planes=1), 0, 1, FRAME, -1, np.zeros(c.COUNT, np.float32), bodies)
    moved = cloth.taken(cloth.x) - topology.start
    state.give_back(cloth)
    assert moved[:, 2] == pytest.approx(-topology.start[:, 0] * np.radians(90) / 60, rel=0.02)
    assert moved[:, 1] == pytest.approx(0.0, abs=1e-6)


ALONG = ((0.0, 0.0, 0.0, 0.0), (1.0, 0.6, 0.0, 0.0))  # [s, m]: 1 cm a frame
# Each with its level top at y = 0.
LEVEL: dict[str, Collider] = {
    "planes": Plane(center=ORIGIN),
    "boxes": Box(center=(0.0, -0.5, 0.0), size=(2.0, 1.0, 2.0)),
    "spheres": Sphere(center=(0.0, -5.0, 0.0), radius=5.0),
    "capsules": Capsule(center=(0.0, -5.2, 0.0), length=0.4, radius=5.0),
    "meshes": Mesh(center=(0.0, -0.5, 0.0), file="cube.obj", resolution=24),
}
CUBE = [
    *(f"v {x} {y} {z}" for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)),
    *("f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"),
]


@pytest.mark.parametrize("swept", [False, True])
@pytest.mark.parametrize("kind", LEVEL)
def test_a_moving_body_drags_what_lies_on_it(kind: str, swept: bool, tmp_path: Path) -> None:
    """Pressed in by 5 cm with a friction of 1, it sticks to a surface that goes 1 cm along in the frame."""
    (tmp_path / "cube.obj").write_text("\n".join(CUBE))
    where = {"folder": str(tmp_path)} if kind == "meshes" else {}
    body = replace(LEVEL[kind], path=ALONG, margin=0.0, friction=1.0, swept=swept, **where)
    topology = free_sheet(2, 0.02, rotation=(-90.0, 0.0, 0.0))
    cloth = state.take(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    cloth.put(topology.start - [0.0, 0.05, 0.0], topology.start, state.inverse_mass(topology))
    grids = distances.take([distances_of(body)] if isinstance(body, Mesh) else [])
    stages = Stages(**{kind: 1}, swept=swept, distances=grids)
    controls = np.zeros(c.COUNT, np.float32)
    run_serially(push_out, cloth, stages, 0, 1, FRAME, -1, controls, body_table([body], 0.0, FRAME))
    moved = cloth.taken(cloth.x) - topology.start
    state.give_back(cloth)
    distances.give_back(grids)
    assert moved[:, 0] == pytest.approx(0.01, rel=0.02)
    assert moved[:, [1, 2]] == pytest.approx(0.0, abs=2e-4)  # a round top falls off


def test_a_body_rocks_in_time_with_its_sway() -> None:
    """A quarter of its period in it is turned by all of its reach, with its middle as far out; half in, by nothing."""
    leg = Capsule(center=(0.0, 1.0, 0.0), sway=(0.0, 0.0, 0.2), rock=(-30.0, 0.0, 0.0), period=(2.0, 1.0, 2.0))
    center, axes = pose(leg, 0.5)
    assert center == pytest.approx([0.0, 1.0, 0.2])
    assert axes[:, 1] == pytest.approx([0.0, np.cos(np.pi / 6), -0.5])
    center, axes = pose(leg, 1.0)
    assert center == pytest.approx([0.0, 1.0, 0.0])
    assert axes == pytest.approx(np.eye(3))
    assert not is_still(Capsule(rock=(0.0, 1.0, 0.0)))
