"""Whole triangles against balls and bars: nearest points, one stroke by hand, and no ball slips between particles."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm
from serially import run_serially

from taichi_cloth import state
from taichi_cloth.contact.bodies import body_table
from taichi_cloth.contact.nearest import NEAREST
from taichi_cloth.contact.push_out import push_out
from taichi_cloth.errors import WrongUse
from taichi_cloth.kernels import controls as c
from taichi_cloth.mesh.surface import nearest
from taichi_cloth.mesh.topology import Topology, sheet
from taichi_cloth.scene.model import Capsule, Cloth, Scene, Solver, Sphere
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import Stages
from taichi_cloth.state.patches import patch

KINDS = tuple(NEAREST)
FRAME = 1 / 60
vectors = ti.types.ndarray(dtype=tm.vec3, ndim=1)


@ti.kernel
def find(k: ti.template(), size: tm.vec3, a: vectors, b: vectors, c: vectors, shares: vectors, ways: vectors):
    for i in range(a.shape[0]):
        share, way = ti.static(NEAREST[KINDS[k]])(size, a[i], b[i], c[i])
        shares[i] = share
        ways[i] = way


@pytest.mark.parametrize("kind", KINDS)
def test_the_nearest_point_of_a_triangle_is_the_nearest(kind: str) -> None:
    """Against NumPy's for 401 places along the axis."""
    random = np.random.default_rng(8)
    corners = random.normal(size=(400, 3, 3)) + random.normal(size=(400, 1, 3))
    half = {"spheres": 0.0, "capsules": 0.8}[kind]
    shares, ways = np.zeros((2, 400, 3), np.float32)
    size = (half, 0.1, 0.0) if half else (0.1, 0.0, 0.0)
    find(KINDS.index(kind), tm.vec3(*size), *np.float32(corners).transpose(1, 0, 2).copy(), shares, ways)
    least = np.full(400, np.inf)
    for level in np.linspace(-half, half, 401 if half else 1):
        place = np.tile([0.0, level, 0.0], (400, 1))
        foot = np.einsum("ij,ijk->ik", nearest(place, corners), corners)
        least = np.minimum(least, np.linalg.norm(foot - place, axis=1))
    beside = least > 0.05  # an axis through a triangle is as near as the triangle's edge or the axis's end
    assert beside.sum() > 250
    assert shares.min() >= -1e-6
    assert shares.sum(axis=1) == pytest.approx(1, abs=1e-5)
    assert np.linalg.norm(ways, axis=1)[beside] == pytest.approx(least[beside], abs=5e-5 if half else 2e-6)
    at = np.einsum("ij,ijk->ik", shares, corners)
    at[:, 1] -= np.clip(at[:, 1], -half, half)
    assert at == pytest.approx(ways, abs=1e-5)


def one_cell() -> Topology:
    """Two triangles: (0, 2, 3) and (0, 3, 1); particle 0 is at (0, 0, 0), 1 along x, 2 down −y, 1 m apart."""
    return sheet(
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


def pushed(body: Sphere | Capsule, pins: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cell before and after one stage of contact, and its inverse masses."""
    topology = replace(one_cell(), pinned=np.isin(np.arange(4), pins))
    cloth = state.take(topology)
    cloth.upload(topology, np.ones(topology.spring_count))
    patch(cloth, topology)
    stages = Stages(spheres=int(isinstance(body, Sphere)), capsules=int(isinstance(body, Capsule)), triangles=True)
    bodies = body_table([body], 0.0, FRAME)
    run_serially(push_out, cloth, stages, 0, 1, FRAME, -1, np.zeros(c.COUNT, np.float32), bodies)
    after, weights = cloth.taken(cloth.x), cloth.taken(cloth.inverse_mass)
    state.give_back(cloth)
    return topology.start, after, weights


def test_one_triangle_and_a_ball_by_hand() -> None:
    """The ball touches (0, 3, 1) in its middle: shares ⅓. Masses are 2, 1, 1 and 2 kg, so that the corners' strokes are
    as 1 : 2 : 1, and the middle goes the 0.06 m that are missing."""
    ball = Sphere(center=(2 / 3, -1 / 3, -0.05), radius=0.1, margin=0.01, friction=0.0, against="triangles")
    before, after, weights = pushed(ball)
    assert 1 / weights == pytest.approx([2, 1, 1, 2])
    moved = after - before
    assert moved[[0, 1, 3]] == pytest.approx(0.06 * np.array([[0, 0, 0.75], [0, 0, 1.5], [0, 0, 0.75]]), abs=1e-6)
    assert moved[2] == pytest.approx(np.zeros(3), abs=1e-6)
    assert moved[[0, 1, 3]].mean(axis=0) == pytest.approx([0, 0, 0.06], abs=1e-6)


@pytest.mark.parametrize("body", [Sphere(radius=0.05), Capsule(length=0.3, radius=0.03, rotation=(10.0, 0.0, 70.0))])
def test_what_a_body_gives_is_a_push_at_the_point_it_touches(body: Sphere | Capsule) -> None:
    """So the sum of the strokes goes through that point: no momentum and no spin but that of the push."""
    center = np.array([0.62, -0.21, -0.035])
    before, after, weights = pushed(replace(body, center=tuple(center), margin=0.01, friction=0.0, against="triangles"))
    given = (after - before) / weights[:, None]
    total = given.sum(axis=0)
    assert total[2] > 0.005
    [touched] = np.cross(before, given).sum(axis=0)[None] - np.cross([center], total)
    # A point x of the plane z = 0 with (x − center) × total = touched; here total is along z.
    offset = np.array([-touched[1], touched[0], 0.0]) / total[2]
    assert total[:2] == pytest.approx(np.zeros(2), abs=1e-5)
    assert np.linalg.norm(offset) < (1e-4 if isinstance(body, Sphere) else 0.16)


def test_pins_hold_and_the_others_go_the_whole_way() -> None:
    ball = Sphere(center=(2 / 3, -1 / 3, -0.05), radius=0.1, margin=0.01, friction=0.0, against="triangles")
    before, after, _ = pushed(ball, pins=(0, 3))
    assert (after[[0, 3]] == before[[0, 3]].astype(np.float32)).all()
    assert after[1, 2] == pytest.approx(3 * 0.06, abs=1e-6)
    before, after, _ = pushed(ball, pins=(0, 1, 3))
    assert (after == before.astype(np.float32)).all()


def test_friction_takes_the_point_that_is_touched_along() -> None:
    """The ball goes 0.03 m along x in the frame: with much friction so does the triangle's middle, with little by
    μ times the push."""
    for friction, along in ((5.0, 0.03), (0.2, 0.2 * 0.06)):
        path = ((0.0, -0.03, 0.0, 0.0), (FRAME, 0.0, 0.0, 0.0))
        ball = Sphere(
            center=(2 / 3, -1 / 3, -0.05), radius=0.1, margin=0.01, friction=friction, path=path, against="triangles"
        )
        before, after, _ = pushed(ball)
        assert (after - before)[[0, 1, 3]].mean(axis=0) == pytest.approx([along, 0, 0.06], abs=1e-5)


# -- a body smaller than a cell ------------------------------------------------------------------------------------

CELL = 0.03


def solid_angle(corners: np.ndarray, eye: np.ndarray) -> float:
    """Of triangles (T, 3, 3) as seen from a place; it jumps by 4π where the place goes through one
    (van Oosterom and Strackee 1983)."""
    a, b, c = (corners - eye).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = ((p * q).sum(axis=1) for p, q in ((a, b), (b, c), (c, a)))
    triple = (a * np.cross(b, c)).sum(axis=1)
    return float(2 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum())


def poked(
    solver: str, speed: float, body: Sphere | Capsule, *, substeps: int, beyond: float, at: float = 0.35
) -> Scene:
    """A body flies at a cell of a hung cloth, at `speed` [m/s], and stops so far behind it [m]. `at`: where in the
    cell, as a share of both its sides."""
    side = 12 * CELL
    cloth = Cloth(rows=13, columns=13, width=side, height=side, center=(0.0, 0.5, 0.0), pins=("top",))
    path = ((0.0, 0.0, 0.0, 0.0), ((0.1 + beyond) / speed, 0.0, 0.0, 0.1 + beyond))
    moving = replace(body, center=(at * CELL, 0.5 - at * CELL, -0.1), path=path)
    kind = "spheres" if isinstance(body, Sphere) else "capsules"
    return Scene(cloth=cloth, solver=Solver(solver, substeps, 12), **{kind: (moving,)})


def passes(scene: Scene) -> bool:
    """Whether the body is on the other side of the cloth at last."""
    with Simulation(scene) as simulation:
        triangles = simulation.topology.triangles
        sides = []
        [body] = [*scene.spheres, *scene.capsules]
        for _ in range(int(60 * body.path[-1][0]) + 8):
            sides.append(solid_angle(simulation.positions()[triangles], simulation.bodies()[0].center))
            simulation.advance_frame()
        assert simulation.measure().finite
        assert ("triangles" in simulation.stages) is (body.against == "triangles")
    return sides[0] * sides[-1] < 0


BEAD = Sphere(radius=CELL / 5, margin=0.002, friction=0.3)
NEEDLE = Capsule(radius=CELL / 10, length=0.05, margin=0.002, rotation=(90.0, 0.0, 0.0))


@pytest.mark.parametrize("body", [BEAD, NEEDLE], ids=["bead", "needle"])
def test_a_slow_body_smaller_than_a_cell_slips_between_particles_but_not_through_triangles(
    body: Sphere | Capsule,
) -> None:
    assert passes(poked("verlet", 0.5, body, substeps=5, beyond=0.2))
    assert not passes(poked("verlet", 0.5, replace(body, against="triangles"), substeps=5, beyond=0.2))


@pytest.mark.parametrize("solver", ["verlet", pytest.param("lines", marks=pytest.mark.long)])
def test_a_bead_at_20_metres_a_second_is_stopped_with_the_swept_test(solver: str) -> None:
    """Radius 1 cm, 0.33 m a frame, one substep: with particles alone it is through at once. (It does not hold a cloth
    for ever that it stretches to five times its length, 0.2 m behind it.)"""
    bead = Sphere(radius=0.01, margin=0.002, friction=0.0, swept=True)
    assert passes(poked(solver, 20.0, bead, substeps=1, beyond=0.1))
    for at in (0.35, 0.5, 0.0):
        shot = poked(solver, 20.0, replace(bead, against="triangles"), substeps=1, beyond=0.1, at=at)
        assert not passes(shot)
    assert solver == "lines" or passes(
        poked(solver, 20.0, replace(bead, against="triangles", swept=False), substeps=1, beyond=0.1)
    )


def test_threads_side_by_side_give_the_same_bits_and_nearly_those_of_the_list() -> None:
    scene = poked("verlet", 4.0, replace(BEAD, against="triangles"), substeps=2, beyond=0.05)
    ends = []
    for path in ("gather", "gather", "list"):
        with Simulation(scene, path) as simulation:
            for _ in range(3):
                simulation.advance_frame()
            ends.append(simulation.positions())
    assert (ends[0] == ends[1]).all()
    assert ends[0] == pytest.approx(ends[2], abs=1e-3)


def test_strips_are_refused_in_one_line_and_not_chosen() -> None:
    scene = poked("verlet", 1.0, replace(BEAD, against="triangles"), substeps=5, beyond=0.1)
    with pytest.raises(WrongUse, match="path lanes is for one even grid, and a body is kept from triangles"):
        Simulation(scene, "lanes")
    with Simulation(scene) as simulation:
        assert simulation.method.endswith("list")
