"""Continuous collision detection: times of impact, and spheres at any speed."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.collision.colliders import PosedCollider, shape_of, signed_distance
from taichi_cloth.collision.shapes import NO_IMPACT, SHAPES
from taichi_cloth.geometry.signed_distance import collider_sdf
from taichi_cloth.scene.collider_schema import Box, Capsule, Collider, Mesh, Plane, Sphere
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS, Features, FrameInput
from taichi_cloth.solvers import Solver as BaseSolver
from taichi_cloth.solvers.two_stage import GAMMA, TwoStageSolver
from taichi_cloth.state.contact_data import acquire_sdf, release_sdf

ORIGIN = (0.0, 0.0, 0.0)
KINDS = tuple(shape.section for shape in SHAPES)
vectors = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
numbers = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def find_impacts(
    k: ti.template(),
    features: ti.template(),
    size: tm.vec3,
    margin: float,
    starts: vectors,
    paths: vectors,
    times: numbers,
    normals: vectors,
):
    for i in range(starts.shape[0]):
        time, normal = ti.static(SHAPES[k]).time_of_impact(features, size, margin, starts[i], paths[i])
        times[i] = time
        normals[i] = normal


def impacts(kind: str, posed: PosedCollider, starts: np.ndarray, paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    times, normals = np.zeros(len(starts), np.float32), np.zeros_like(starts, np.float32)
    size = ti.Vector([float(n) for n in posed.size])
    sdf = acquire_sdf([collider_sdf(posed.collider)] if isinstance(posed.collider, Mesh) else [])
    features = Features(sdf=sdf)
    margin = posed.collider.margin
    find_impacts(KINDS.index(kind), features, size, margin, np.float32(starts), np.float32(paths), times, normals)
    release_sdf(sdf)
    return times, normals


COLLIDERS: dict[str, Collider] = {
    "spheres": Sphere(center=ORIGIN, radius=0.3, margin=0.05, friction=0.0),
    "capsules": Capsule(center=ORIGIN, length=0.6, radius=0.2, margin=0.05),
    "boxes": Box(center=ORIGIN, size=(0.5, 0.7, 0.4), margin=0.0),
    "planes": Plane(margin=0.05),
    "meshes": Mesh(center=ORIGIN, scale=1.2, resolution=24, margin=0.05),
}


@pytest.mark.parametrize("kind", COLLIDERS)
def test_paths_stop_where_they_first_reach_the_margin(kind: str) -> None:
    """Compare with 2000 steps along each path."""
    collider = COLLIDERS[kind]
    posed = PosedCollider(collider, np.zeros(3), np.eye(3), np.array(shape_of(collider).size(collider)))
    random = np.random.default_rng(7)
    starts = random.uniform(-1, 1, (600, 3))
    paths = random.uniform(-1.5, 1.5, (600, 3))
    paths[::2] = 0.3 * paths[::2] - 1.5 * starts[::2]  # toward the collider
    times, normals = impacts(kind, posed, starts, paths)
    steps = np.linspace(0, 1, 2001)
    margin = collider.margin
    if isinstance(collider, Mesh):
        margin -= collider_sdf(collider).spacing / 4
    along = np.array([signed_distance(posed, starts + t * paths) for t in steps]) - margin  # (steps, paths)
    outside = along[0] > 0
    reached = (along < 0).any(axis=0) & outside
    first = steps[(along < 0).argmax(axis=0)]
    clear = np.abs(along.min(axis=0)) > 1e-3  # one method may detect a grazing contact that the other misses
    assert reached.sum() > 40
    assert (outside & ~reached).sum() > 40
    assert times[reached & clear] == pytest.approx(first[reached & clear], abs=6e-4)
    assert (times[~reached & clear] > 1).all()
    assert (times[~outside] == NO_IMPACT).all()
    at = starts + times[:, None] * paths
    hit = reached & clear
    assert np.linalg.norm(normals[hit], axis=1) == pytest.approx(1, abs=1e-5)
    outwards = signed_distance(posed, at[hit] + 1e-2 * normals[hit])
    off = np.abs(outwards - margin - 1e-2)
    assert (off < 2e-3).mean() > (0.95 if isinstance(collider, Mesh) else 0.999)  # the bust has concave creases
    assert (np.einsum("ij,ij->i", normals[hit], paths[hit]) < 0).all()


def shot(solver: str, speed: float, *, continuous: bool, friction: float = 0.0) -> Scene:
    """Return a sphere of 0.1 m that flies through a hanging cloth, which it reaches in the third frame."""
    keyframes = ((0.0, 0.0, 0.0, 0.0), (10.0, 0.0, 0.0, 10 * speed))
    center = (0.0, 0.5, -2.37 * speed / 60)
    sphere = Sphere(
        center=center, radius=0.1, margin=0.01, friction=friction, continuous=continuous, keyframes=keyframes
    )
    return Scene(
        cloth=Cloth(rows=21, columns=21, width=1.0, height=1.0, center=(0.0, 0.5, 0.0), pins=("top",)),
        spheres=(sphere,),
        solver=Solver(solver, 1, 12, damping=0.0),
        forces=Forces(gravity=0.0),
    )


def step_by_stage(simulation: Simulation) -> Iterator[np.ndarray]:
    """Advance by a frame of one substep. Yield positions relative to the sphere, after each stage of the solver."""
    solver = simulation.solver
    if not isinstance(solver, TwoStageSolver):
        simulation.step()
        yield simulation.positions() - simulation.colliders()[0].center
        return
    start, found = simulation.colliders()[0].center, []

    def by_stage(frame: FrameInput) -> None:
        for stage in (0, 1):  # damping is 0: it needs no factor
            BaseSolver.step(solver, replace(frame, substeps=2, h=frame.h / 2, span=(stage, stage + 1)))
            found.append(simulation.positions())

    solver.step = by_stage  # type: ignore[method-assign]
    simulation.step()
    del solver.step
    end = simulation.colliders()[0].center
    yield found[0] - (start + (end - start) * (1 - GAMMA))
    yield found[1] - end


def crossing_count(scene: Scene, layout: str) -> int:
    """Return the number of particles whose path in one stage or frame, relative to the sphere, passes through it."""
    crossed: set[int] = set()
    with Simulation(scene, layout) as simulation:
        assert simulation.substeps == 1
        before = simulation.positions() - simulation.colliders()[0].center
        for after in chain.from_iterable(step_by_stage(simulation) for _ in range(6)):
            move = after - before
            share = np.clip(-(before * move).sum(axis=1) / np.maximum((move * move).sum(axis=1), 1e-30), 0, 1)
            nearest = np.linalg.norm(before + share[:, None] * move, axis=1)
            crossed |= {int(i) for i in np.flatnonzero((nearest < 0.1) & ~simulation.topology.pinned)}
            before = after
        assert simulation.metrics().finite
    return len(crossed)


@pytest.mark.parametrize("speed", [5.0, 20.0, 50.0, 100.0])
@pytest.mark.parametrize(
    ("solver", "layout"),
    [
        pytest.param(solver, layout, marks=[pytest.mark.long] * (layout != shown))
        for solver, shown in (("verlet", "simd"), ("xpbd", "serial"), ("lines", "simd"), ("implicit", "serial"))
        for layout in ("simd", "serial")
    ],
)
def test_no_particle_passes_through_a_fast_sphere_in_one_substep(solver: str, speed: float, layout: str) -> None:
    assert crossing_count(shot(solver, speed, continuous=True), layout) == 0
    assert crossing_count(shot(solver, speed, continuous=True, friction=0.4), layout) == 0
    # Without continuous collision detection they do, if the sphere moves farther than its diameter between contacts.
    if speed >= (50 if issubclass(SOLVERS[solver], TwoStageSolver) else 20):
        assert crossing_count(shot(solver, speed, continuous=False), layout) >= 9


@pytest.mark.parametrize(
    "solver",
    [pytest.param(s, marks=[pytest.mark.long] * (s not in ("verlet", "lines", "implicit"))) for s in SOLVER_NAMES],
)
def test_particles_hit_head_on_stay_in_front_of_the_sphere(solver: str) -> None:
    """With as many substeps as the solver needs."""
    with Simulation(shot(solver, 20.0, continuous=True)) as simulation:
        for _ in range(3):
            simulation.step()
        middle = simulation.positions()[220] - simulation.colliders()[0].center
        assert middle[2] == pytest.approx(0.11, abs=0.02)


@pytest.mark.parametrize("solver", ["verlet", "explicit", pytest.param("lines", marks=pytest.mark.long)])
def test_continuous_collision_detection_does_not_change_resting_contact(solver: str) -> None:
    """A sheet at rest on a slope stays at rest."""
    positions = []
    for continuous in (False, True):
        slope = Plane(rotation=(0.0, 0.0, 15.0), friction=0.5, margin=0.01, continuous=continuous)
        cloth = Cloth(
            rows=8, columns=9, width=0.4, height=0.4, center=(0.0, 0.05, 0.0), rotation=(-90.0, 0.0, 15.0), pins=()
        )
        with Simulation(Scene(cloth=cloth, planes=(slope,), solver=Solver(solver, 5, 12)), "serial") as simulation:
            for _ in range(60):
                simulation.step()
            assert simulation.metrics().penetration == 0
            positions.append(simulation.positions())
    assert np.abs(positions[0] - positions[1]).max() < 5e-4
