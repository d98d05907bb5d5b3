"""Triangle collision with spheres and capsules: closest points, one correction by hand, and small colliders."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from serial_kernels import run_serially

from taichi_cloth import state
from taichi_cloth.collision.colliders import collider_counts, collider_table, pose_colliders, triangle_distance
from taichi_cloth.collision.response import resolve_contacts
from taichi_cloth.collision.shapes import SHAPES
from taichi_cloth.geometry.closed_surface import closest_point_on_triangle
from taichi_cloth.geometry.topology import Topology, build_sheet
from taichi_cloth.kernels import step_params as c
from taichi_cloth.scene.collider_schema import Capsule, Sphere
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import Features
from taichi_cloth.state.contact_data import attach_colored_triangles
from taichi_cloth.system.errors import UsageError

KINDS = tuple(shape.section for shape in SHAPES if shape.closest_on_triangle)
FRAME = 1 / 60
vectors = ti.types.ndarray(dtype=tm.vec3, ndim=1)


@ti.kernel
def find(k: ti.template(), size: tm.vec3, a: vectors, b: vectors, c: vectors, weights: vectors, offsets: vectors):
    for i in range(a.shape[0]):
        weight, offset = ti.static(SHAPES[k]).closest_on_triangle(size, a[i], b[i], c[i])
        weights[i] = weight
        offsets[i] = offset


@pytest.mark.parametrize("kind", KINDS)
def test_closest_point_of_a_triangle_to_a_collider(kind: str) -> None:
    """Compare with NumPy for 401 points along the axis."""
    random = np.random.default_rng(8)
    corners = random.normal(size=(400, 3, 3)) + random.normal(size=(400, 1, 3))
    half = {"spheres": 0.0, "capsules": 0.8}[kind]
    weights, offsets = np.zeros((2, 400, 3), np.float32)
    size = (half, 0.1, 0.0) if half else (0.1, 0.0, 0.0)
    find(KINDS.index(kind), tm.vec3(*size), *corners.astype(np.float32).transpose(1, 0, 2).copy(), weights, offsets)
    least = np.full(400, np.inf)
    for level in np.linspace(-half, half, 401 if half else 1):
        point = np.tile([0.0, level, 0.0], (400, 1))
        foot = np.einsum("ij,ijk->ik", closest_point_on_triangle(point, corners), corners)
        least = np.minimum(least, np.linalg.norm(foot - point, axis=1))
    apart = least > 0.05  # for an axis through a triangle, edge and axis end may be equally close
    assert apart.sum() > 250
    assert weights.min() >= -1e-6
    assert weights.sum(axis=1) == pytest.approx(1, abs=1e-5)
    assert np.linalg.norm(offsets, axis=1)[apart] == pytest.approx(least[apart], abs=5e-5 if half else 2e-6)
    at = np.einsum("ij,ijk->ik", weights, corners)
    at[:, 1] -= np.clip(at[:, 1], -half, half)
    assert at == pytest.approx(offsets, abs=1e-5)


@pytest.mark.parametrize("half", [0.0, 0.7])
def test_distances_of_triangles_are_those_of_their_closest_points(half: float) -> None:
    """Compare with 2001 points along the axis, also where it passes through a triangle."""
    random = np.random.default_rng(9)
    corners = random.normal(size=(300, 3, 3)) + random.normal(size=(300, 1, 3))
    corners[:10, 2] = corners[:10, 1]  # triangles of no area
    corners[10:20, :, 0] = 0.3  # parallel to the axis
    least = np.full(300, np.inf)
    for level in np.linspace(-half, half, 2001 if half else 1):
        point = np.tile([0.0, level, 0.0], (300, 1))
        foot = np.einsum("ij,ijk->ik", closest_point_on_triangle(point, corners), corners)
        least = np.minimum(least, np.linalg.norm(foot - point, axis=1))
    collider = Capsule(length=2 * half, radius=0.2) if half else Sphere(radius=0.2)
    (posed,) = pose_colliders([replace(collider, center=(0.0, 3.0, 0.0), rotation=(0.0, 0.0, 90.0))], 0.0)
    found = triangle_distance(posed, corners @ posed.axes.T + posed.center)
    assert found == pytest.approx(least - 0.2, abs=1e-3)
    assert (found > -0.1999).sum() > 250
    assert (found < -0.1999).any() == bool(half)


def one_cell() -> Topology:
    """Return two triangles (0, 2, 3) and (0, 3, 1): particle 0 at the origin, 1 at x = 1 m, 2 at y = −1 m."""
    return build_sheet(
        rows=2,
        columns=2,
        width=1.0,
        height=1.0,
        center=(0.5, -0.5, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=6.0,
        pins=(),
        directions=[True] * 6,
    )


def pushed(collider: Sphere | Capsule, pins: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the cell before and after contact resolution, and its inverse masses."""
    topology = replace(one_cell(), pinned=np.isin(np.arange(4), pins))
    cloth = state.acquire_state(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    attach_colored_triangles(cloth, topology)
    features = Features(colliders=collider_counts([collider]), triangles=True)
    colliders = collider_table([collider], 0.0, FRAME, origin=tuple(topology.origin))
    run_serially(resolve_contacts, cloth, features, 0, 1, FRAME, -1, np.zeros(c.PARAM_COUNT, np.float32), colliders)
    after, inverse_masses = (
        cloth.to_numpy(cloth.x) + topology.origin,
        cloth.inverse_mass.to_numpy()[: topology.particle_count],
    )
    state.release_state(cloth)
    return topology.start, after, inverse_masses


def test_one_triangle_and_a_sphere_by_hand() -> None:
    """The sphere touches (0, 3, 1) at its centroid: weights ⅓. Masses are 2, 1, 1 and 2 kg, so the corners move as
    1 : 2 : 1, and the centroid moves by the missing 0.06 m."""
    sphere = Sphere(center=(2 / 3, -1 / 3, -0.05), radius=0.1, margin=0.01, friction=0.0, collide_with="triangles")
    before, after, inverse_masses = pushed(sphere)
    assert 1 / inverse_masses == pytest.approx([2, 1, 1, 2])
    moved = after - before
    assert moved[[0, 1, 3]] == pytest.approx(0.06 * np.array([[0, 0, 0.75], [0, 0, 1.5], [0, 0, 0.75]]), abs=1e-6)
    assert moved[2] == pytest.approx(np.zeros(3), abs=1e-6)
    assert moved[[0, 1, 3]].mean(axis=0) == pytest.approx([0, 0, 0.06], abs=1e-6)


@pytest.mark.parametrize(
    "collider",
    [Sphere(radius=0.05, margin=0.15, friction=0.0), Capsule(length=0.3, radius=0.03, rotation=(10.0, 0.0, 70.0))],
)
def test_corrections_equal_an_impulse_at_the_contact_point(collider: Sphere | Capsule) -> None:
    """The sum of all impulses acts through that point."""
    center = np.array([0.62, -0.21, -0.035])
    before, after, inverse_masses = pushed(
        replace(collider, center=(0.62, -0.21, -0.035), margin=0.01, friction=0.0, collide_with="triangles")
    )
    impulses = (after - before) / inverse_masses[:, None]
    total = impulses.sum(axis=0)
    assert total[2] > 0.005
    torque = np.cross(before, impulses).sum(axis=0) - np.cross(center, total)
    # A point x of the plane z = 0 with (x − center) × total = torque; here total is along z.
    offset = np.array([-torque[1], torque[0], 0.0]) / total[2]
    assert total[:2] == pytest.approx(np.zeros(2), abs=1e-5)
    assert np.linalg.norm(offset) < (1e-4 if isinstance(collider, Sphere) else 0.16)


def test_pins_do_not_move_and_the_other_corners_move_farther() -> None:
    sphere = Sphere(center=(2 / 3, -1 / 3, -0.05), radius=0.1, margin=0.01, friction=0.0, collide_with="triangles")
    before, after, _ = pushed(sphere, pins=(0, 3))
    assert (after[[0, 3]] == before[[0, 3]].astype(np.float32)).all()
    assert after[1, 2] == pytest.approx(3 * 0.06, abs=1e-6)
    before, after, _ = pushed(sphere, pins=(0, 1, 3))
    assert (after == before.astype(np.float32)).all()


def test_friction_drags_the_contact_point_along() -> None:
    """The sphere moves by 0.03 m along x in the frame: with high friction so does the centroid, with low friction by μ
    times the push."""
    for friction, along in ((5.0, 0.03), (0.2, 0.2 * 0.06)):
        keyframes = ((0.0, -0.03, 0.0, 0.0), (FRAME, 0.0, 0.0, 0.0))
        sphere = Sphere(
            center=(2 / 3, -1 / 3, -0.05),
            radius=0.1,
            margin=0.01,
            friction=friction,
            keyframes=keyframes,
            collide_with="triangles",
        )
        before, after, _ = pushed(sphere)
        assert (after - before)[[0, 1, 3]].mean(axis=0) == pytest.approx([along, 0, 0.06], abs=1e-5)


# -- colliders smaller than a cell --------------------------------------------------------------------------------

CELL = 0.03


def solid_angle(corners: np.ndarray, eye: np.ndarray) -> float:
    """Return the solid angle of triangles (T, 3, 3) seen from a point (van Oosterom and Strackee 1983).

    It jumps by 4π where the point passes through a triangle.
    """
    a, b, c = (corners - eye).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = ((p * q).sum(axis=1) for p, q in ((a, b), (b, c), (c, a)))
    triple = (a * np.cross(b, c)).sum(axis=1)
    return float(2 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum())


def poked(
    solver: str, speed: float, collider: Sphere | Capsule, *, substeps: int, beyond: float, at: float = 0.35
) -> Scene:
    """Return a collider that flies at a cell of a hanging cloth at `speed` [m/s] and stops `beyond` [m] behind it.

    `at`: position in the cell, as a fraction of both sides.
    """
    side = 12 * CELL
    cloth = Cloth(rows=13, columns=13, width=side, height=side, center=(0.0, 0.5, 0.0), pins=("top",))
    keyframes = ((0.0, 0.0, 0.0, 0.0), ((0.1 + beyond) / speed, 0.0, 0.0, 0.1 + beyond))
    moving = replace(collider, center=(at * CELL, 0.5 - at * CELL, -0.1), keyframes=keyframes)
    own: dict[str, Any] = {"spheres" if isinstance(collider, Sphere) else "capsules": (moving,)}
    return Scene(cloth=cloth, solver=Solver(solver, substeps, 12), **own)


def passes(scene: Scene) -> bool:
    """Return whether the collider ends on the other side of the cloth."""
    with Simulation(scene) as simulation:
        triangles = simulation.topology.triangles
        sides = []
        [collider] = [*scene.spheres, *scene.capsules]
        for _ in range(int(60 * collider.keyframes[-1][0]) + 8):
            sides.append(solid_angle(simulation.positions()[triangles], simulation.colliders()[0].center))
            simulation.step()
        assert simulation.metrics().finite
        assert ("triangles" in simulation.features) is (collider.collide_with == "triangles")
    return sides[0] * sides[-1] < 0


BEAD = Sphere(radius=CELL / 5, margin=0.002, friction=0.3)
NEEDLE = Capsule(radius=CELL / 10, length=0.05, margin=0.002, rotation=(90.0, 0.0, 0.0))


@pytest.mark.parametrize("collider", [BEAD, NEEDLE], ids=["bead", "needle"])
def test_a_slow_collider_smaller_than_a_cell_passes_between_particles_but_not_through_triangles(
    collider: Sphere | Capsule,
) -> None:
    assert passes(poked("verlet", 0.5, collider, substeps=5, beyond=0.2))
    assert not passes(poked("verlet", 0.5, replace(collider, collide_with="triangles"), substeps=5, beyond=0.2))


@pytest.mark.parametrize("solver", ["verlet", pytest.param("lines", marks=pytest.mark.long)])
def test_continuous_collision_detection_stops_a_bead_at_20_meters_per_second(solver: str) -> None:
    """Radius 1 cm, 0.33 m per frame, one substep: with particles alone it passes through. (0.2 m behind the cloth, then
    stretched to five times its length, it would pass through in the end.)"""
    bead = Sphere(radius=0.01, margin=0.002, friction=0.0, continuous=True)
    assert passes(poked(solver, 20.0, bead, substeps=1, beyond=0.1))
    for at in (0.35, 0.5, 0.0):
        shot = poked(solver, 20.0, replace(bead, collide_with="triangles"), substeps=1, beyond=0.1, at=at)
        assert not passes(shot)
    assert solver == "lines" or passes(
        poked(solver, 20.0, replace(bead, collide_with="triangles", continuous=False), substeps=1, beyond=0.1)
    )


def test_the_parallel_layout_is_bit_reproducible_and_close_to_the_serial_layout() -> None:
    scene = poked("verlet", 4.0, replace(BEAD, collide_with="triangles"), substeps=2, beyond=0.05)
    ends = []
    for layout in ("parallel", "parallel", "serial"):
        with Simulation(scene, layout) as simulation:
            for _ in range(3):
                simulation.step()
            ends.append(simulation.positions())
    assert (ends[0] == ends[1]).all()
    assert ends[0] == pytest.approx(ends[2], abs=1e-3)


def test_the_simd_layout_is_rejected_in_one_line_and_not_chosen() -> None:
    scene = poked("verlet", 1.0, replace(BEAD, collide_with="triangles"), substeps=5, beyond=0.1)
    with pytest.raises(UsageError, match='layout simd is not supported: a collider has collide_with = "triangles"'):
        Simulation(scene, "simd")
    with Simulation(scene) as simulation:
        assert simulation.method.endswith("serial")
