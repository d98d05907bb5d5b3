"""The swept test: where ways meet bodies, and that no ball is too fast for it."""

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.contact.bodies import Body, distance, size_of
from taichi_cloth.contact.sweeps import MEETINGS, NEVER
from taichi_cloth.mesh.solid import distances_of
from taichi_cloth.scene.model import (
    SOLVER_NAMES,
    Box,
    Capsule,
    Cloth,
    Collider,
    Forces,
    Mesh,
    Plane,
    Scene,
    Solver,
    Sphere,
)
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import Stages
from taichi_cloth.state import distances

ORIGIN = (0.0, 0.0, 0.0)
KINDS = tuple(MEETINGS)
vectors = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def meet(
    k: ti.template(),
    stages: ti.template(),
    size: tm.vec3,
    margin: float,
    starts: vectors,
    ways: vectors,
    times: numbers,
    normals: vectors,
):
    for i in range(starts.shape[0]):
        time, normal = ti.static(MEETINGS[KINDS[k]])(stages, size, margin, starts[i], ways[i])
        times[i] = time
        normals[i] = normal


def meetings(kind: str, body: Body, starts: np.ndarray, ways: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    times, normals = np.zeros(len(starts), np.float32), np.zeros_like(starts, np.float32)
    size = ti.Vector([float(n) for n in body.size])
    grids = distances.take([distances_of(body.collider)] if isinstance(body.collider, Mesh) else [])
    stages = Stages(distances=grids)
    meet(KINDS.index(kind), stages, size, body.collider.margin, np.float32(starts), np.float32(ways), times, normals)
    distances.give_back(grids)
    return times, normals


BODIES: dict[str, Collider] = {
    "spheres": Sphere(center=ORIGIN, radius=0.3, margin=0.05),
    "capsules": Capsule(center=ORIGIN, length=0.6, radius=0.2, margin=0.05),
    "boxes": Box(center=ORIGIN, size=(0.5, 0.7, 0.4), margin=0.0),
    "planes": Plane(margin=0.05),
    "meshes": Mesh(center=ORIGIN, scale=1.2, resolution=24, margin=0.05),
}


@pytest.mark.parametrize("kind", BODIES)
def test_ways_stop_where_they_first_reach_the_margin(kind: str) -> None:
    """Against 2000 steps along each way."""
    collider = BODIES[kind]
    body = Body(collider, np.zeros(3), np.eye(3), size_of(collider))
    random = np.random.default_rng(7)
    starts = random.uniform(-1, 1, (600, 3))
    ways = random.uniform(-1.5, 1.5, (600, 3))
    ways[::2] = 0.3 * ways[::2] - 1.5 * starts[::2]  # towards the body
    times, normals = meetings(kind, body, starts, ways)
    steps = np.linspace(0, 1, 2001)
    margin = collider.margin
    if isinstance(collider, Mesh):
        margin -= distances_of(collider).spacing / 4
    along = np.array([distance(body, starts + t * ways) for t in steps]) - margin  # (steps, ways)
    outside = along[0] > 0
    reached = (along < 0).any(axis=0) & outside
    first = steps[(along < 0).argmax(axis=0)]
    clear = np.abs(along.min(axis=0)) > 1e-3  # a graze may be seen by one and not by the other
    assert reached.sum() > 40
    assert (outside & ~reached).sum() > 40
    assert times[reached & clear] == pytest.approx(first[reached & clear], abs=6e-4)
    assert (times[~reached & clear] > 1).all()
    assert (times[~outside] == NEVER).all()
    at = starts + times[:, None] * ways
    met = reached & clear
    assert np.linalg.norm(normals[met], axis=1) == pytest.approx(1, abs=1e-5)
    outwards = distance(body, at[met] + 1e-2 * normals[met])
    off = np.abs(outwards - margin - 1e-2)
    assert (off < 2e-3).mean() > (0.95 if isinstance(collider, Mesh) else 0.999)  # a bust has hollows with creases
    assert (np.einsum("ij,ij->i", normals[met], ways[met]) < 0).all()


def shot(solver: str, speed: float, *, swept: bool, friction: float = 0.0) -> Scene:
    """A ball of 0.1 m flies through a hung cloth, and reaches it within the third frame."""
    path = ((0.0, 0.0, 0.0, 0.0), (10.0, 0.0, 0.0, 10 * speed))
    center = (0.0, 0.5, -2.37 * speed / 60)
    ball = Sphere(center=center, radius=0.1, margin=0.01, friction=friction, swept=swept, path=path)
    return Scene(
        cloth=Cloth(rows=21, columns=21, width=1.0, height=1.0, center=(0.0, 0.5, 0.0), pins=("top",)),
        spheres=(ball,),
        solver=Solver(solver, 1, 12, damping=0.0),
        forces=Forces(gravity=0.0),
    )


def crossings(scene: Scene, path: str) -> int:
    """Particles whose way of one frame, seen from the ball, leads through it."""
    crossed: set[int] = set()
    with Simulation(scene, path) as simulation:
        assert simulation.substeps == 1
        before = simulation.positions() - simulation.bodies()[0].center
        for _ in range(6):
            simulation.advance_frame()
            after = simulation.positions() - simulation.bodies()[0].center
            way = after - before
            share = np.clip(-(before * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-30), 0, 1)
            nearest = np.linalg.norm(before + share[:, None] * way, axis=1)
            crossed |= {int(i) for i in np.flatnonzero((nearest < 0.1) & ~simulation.topology.pinned)}
            before = after
        assert simulation.measure().finite
    return len(crossed)


@pytest.mark.parametrize("speed", [5.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize(
    ("solver", "path"),
    [
        pytest.param(solver, path, marks=[pytest.mark.long] * (path != shown))
        for solver, shown in (("verlet", "lanes"), ("xpbd", "list"), ("projective", "list"))
        for path in ("lanes", "list")
    ],
)
def test_no_particle_gets_through_a_fast_ball_in_one_substep(solver: str, speed: float, path: str) -> None:
    assert crossings(shot(solver, speed, swept=True), path) == 0
    assert crossings(shot(solver, speed, swept=True, friction=0.4), path) == 0
    if speed >= 20:  # without it they do
        assert crossings(shot(solver, speed, swept=False), path) >= 9


@pytest.mark.parametrize(
    "solver", [pytest.param(s, marks=[pytest.mark.long] * (s not in ("verlet", "lines"))) for s in SOLVER_NAMES]
)
def test_what_the_ball_meets_head_on_stays_before_it(solver: str) -> None:
    """With as many substeps as a method needs."""
    with Simulation(shot(solver, 20.0, swept=True)) as simulation:
        for _ in range(3):
            simulation.advance_frame()
        middle = simulation.positions()[220] - simulation.bodies()[0].center
        assert middle[2] == pytest.approx(0.11, abs=0.02)


@pytest.mark.parametrize("solver", ["verlet", "spring", pytest.param("lines", marks=pytest.mark.long)])
def test_contact_that_lasts_is_the_same_with_and_without(solver: str) -> None:
    """A sheet that lies still on a slope does so with the swept test too."""
    places = []
    for swept in (False, True):
        slope = Plane(rotation=(0.0, 0.0, 15.0), friction=0.5, margin=0.01, swept=swept)
        cloth = Cloth(
            rows=8, columns=9, width=0.4, height=0.4, center=(0.0, 0.05, 0.0), rotation=(-90.0, 0.0, 15.0), pins=()
        )
        with Simulation(Scene(cloth=cloth, planes=(slope,), solver=Solver(solver)), "list") as simulation:
            for _ in range(60):
                simulation.advance_frame()
            assert simulation.measure().penetration == 0
            places.append(simulation.positions())
    assert np.abs(places[0] - places[1]).max() < 5e-4
