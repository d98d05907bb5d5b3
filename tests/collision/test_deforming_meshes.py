"""Contact with meshes that deform: carried, pushed and let go as by the moving surface, for all solvers and layouts."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from taichi_cloth.geometry.signed_distance import collider_surface, distances_to_surface
from taichi_cloth.geometry.spring_model import Floats
from taichi_cloth.scene.collider_schema import Mesh
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

MARGIN = 0.01
BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
BOX = trimesh.creation.box((1.0, 0.2, 1.0))
SHEET = Scene(
    cloth=Cloth(rows=9, columns=9, width=0.4, height=0.4, center=(0.0, 0.25, 0.0), rotation=(-90.0, 0.0, 0.0), pins=()),
    fabric=Fabric(warp=30.0, weft=30.0, shear=10.0, bend_spring=0.3),
)

MakeMesh = Callable[..., Mesh]


@pytest.fixture
def make_mesh(tmp_path: Path) -> MakeMesh:
    """make_mesh(shape, samples, rate): a mesh with a clip of these samples, (samples, points, 3)."""

    def make(shape: trimesh.Trimesh, samples: Floats, rate: float = 30.0, **keys: object) -> Mesh:
        shape.export(tmp_path / "body.obj")
        header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, samples.shape[1], 0.0, 1.0, len(samples))
        (tmp_path / "body.pc2").write_bytes(header + samples.astype("<f4").tobytes())
        all_keys = {"center": (0.0, 0.0, 0.0), "margin": MARGIN, "clip_loop": False} | keys
        return Mesh(file="./body.obj", folder=str(tmp_path), clip="body.pc2", clip_rate=rate, **all_keys)  # type: ignore[arg-type]

    return make


def with_mesh(mesh: Mesh, solver: str = "xpbd", **sections: object) -> Scene:
    substeps = {"verlet": 6, "xpbd": 10, "lines": 4, "implicit": 4}.get(solver, 1)
    scene = replace(SHEET, meshes=(mesh,), solver=Solver(name=solver, substeps=substeps, iterations=6, damping=0.0))
    return replace(scene, **sections)  # type: ignore[arg-type]


def distances(simulation: Simulation) -> Floats:
    """Return the distance of every particle to the mesh as it is now [m]."""
    (posed,) = simulation.colliders()
    assert isinstance(posed.collider, Mesh)
    surface = collider_surface(posed.collider)
    return distances_to_surface(surface, (simulation.positions() - posed.center) @ posed.axes)


def growing(shape: trimesh.Trimesh) -> Floats:
    """Return a body that grows by half in a second."""
    return np.array(shape.vertices) * np.linspace(1.0, 1.5, 31)[:, None, None]


LAYOUTS = ["serial", "simd", "parallel"]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_a_growing_body_pushes_cloth_to_its_margin(make_mesh: MakeMesh, solver: str, layout: str) -> None:
    if layout == "parallel" and solver not in ("verlet", "explicit"):
        pytest.skip("contact is the same for all solvers; a launch for each of its loops takes long to compile")
    with Simulation(with_mesh(make_mesh(BALL, growing(BALL)), solver), layout) as simulation:
        for _ in range(12):
            simulation.step(5)
            # The margin is kept but for edges: a plane of the step before cuts a corner of the mesh.
            assert distances(simulation).min() > 0.75 * MARGIN
        assert np.sort(distances(simulation))[5] < 1.2 * MARGIN, "it does not rest on the body"
        assert simulation.metrics().penetration == 0.0


@pytest.mark.parametrize("layout", ["serial", "simd"])
@pytest.mark.parametrize(("friction", "seconds"), [(1.0, 0.5), (0.1, 0.25)])
def test_a_moving_floor_drags_a_sheet_by_coulombs_law(
    make_mesh: MakeMesh, friction: float, seconds: float, layout: str
) -> None:
    """It accelerates by μ·g until it moves as the floor does."""
    speed = 0.5
    samples = np.array(BOX.vertices) + np.arange(31)[:, None, None] / 30 * speed * np.array([1.0, 0.0, 0.0])
    mesh = make_mesh(BOX, samples, friction=friction)
    scene = with_mesh(mesh, cloth=replace(SHEET.cloth, center=(0.0, 0.1 + MARGIN, 0.0)))
    with Simulation(scene, layout) as simulation:
        simulation.step(round(60 * seconds))
        velocities = simulation.velocities()
        assert velocities[:, 0] == pytest.approx(min(friction * 9.81 * seconds, speed), rel=0.02)
        assert np.abs(velocities[:, [1, 2]]).max() < 0.01
        assert distances(simulation) == pytest.approx(MARGIN, abs=1e-4)


def test_cloth_on_a_body_does_not_creep(make_mesh: MakeMesh) -> None:
    """Friction is bounded by the normal corrections of all iterations (`static_friction.py`)."""
    shape = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    mesh = make_mesh(shape, np.array([shape.vertices] * 2), center=(0.0, -0.35, 0.0), margin=0.02, friction=1.5)
    cloth = Cloth(17, 17, 1.0, 1.0, center=(0.0, 0.0, 0.0), rotation=(-90.0, 0.0, 0.0), pins=())
    scene = Scene(cloth=cloth, solver=Solver("xpbd", substeps=60, iterations=4, damping=5.0), meshes=(mesh,))
    with Simulation(scene) as simulation:
        simulation.step(240)
        before, touching = simulation.positions(), distances(simulation) < 0.021
        simulation.step(60)
        assert touching.sum() > 20
        assert np.linalg.norm(simulation.positions() - before, axis=1)[touching].max() < 1e-4


def test_particles_near_any_feature_get_out_to_the_margin_or_stay(make_mesh: MakeMesh) -> None:
    """Particles without springs, at rest around a body with bumps, inside and outside, near faces and edges."""
    random = np.random.default_rng(3)
    bumpy = BALL.copy()
    bumpy.vertices *= random.uniform(0.9, 1.1, (len(bumpy.vertices), 1))
    mesh = make_mesh(bumpy, np.array([bumpy.vertices] * 2))
    loose = replace(
        SHEET, fabric=Fabric(warp=0.0, weft=0.0, shear=0.0, bend_spring=0.0), forces=Forces(gravity=0.0), meshes=(mesh,)
    )
    loose = replace(loose, solver=Solver(name="xpbd", substeps=4, iterations=1, damping=1000.0))
    with Simulation(loose) as simulation:
        count = simulation.topology.particle_count
        directions = random.normal(size=(count, 3))
        x = directions / np.linalg.norm(directions, axis=1, keepdims=True) * random.uniform(0.18, 0.26, (count, 1))
        simulation.set_state(x)
        before, x = distances(simulation), simulation.positions()
        simulation.step(20)
        after = distances(simulation)
        apart = before > MARGIN + 1e-6
        assert 20 < apart.sum() < count - 20
        assert (before < -0.005).sum() > 5
        assert np.array_equal(simulation.positions()[apart], x[apart])
        # In a valley a particle that leaves one face may come within the margin of another.
        assert after.min() > 0.7 * MARGIN
        assert np.quantile(np.abs(after[~apart] - MARGIN), 0.9) < 1e-3


def test_a_mesh_that_does_not_move_acts_as_the_rigid_one(make_mesh: MakeMesh) -> None:
    mesh = make_mesh(BALL, np.array([BALL.vertices] * 2), friction=0.3)
    with Simulation(with_mesh(mesh)) as clip, Simulation(with_mesh(replace(mesh, clip=""))) as rigid:
        for simulation in (clip, rigid):
            simulation.step(20)
        assert np.abs(clip.positions() - rigid.positions()).max() < 0.004


def test_a_thrown_sheet_does_not_get_through(make_mesh: MakeMesh) -> None:
    """At 6 m/s, much farther in a frame than the balls of particles at rest reach."""
    mesh = make_mesh(BOX, np.array([BOX.vertices] * 2))
    with Simulation(with_mesh(mesh, cloth=replace(SHEET.cloth, center=(0.0, 0.5, 0.0)))) as simulation:
        simulation.set_state(simulation.positions(), (0.0, -6.0, 0.0))
        for _ in range(20):
            simulation.step()
            assert distances(simulation).min() > 0.9 * MARGIN


def test_substeps_one_by_one_give_the_same_bits(make_mesh: MakeMesh) -> None:
    scene = with_mesh(make_mesh(BALL, growing(BALL)))
    with Simulation(scene) as whole, Simulation(scene) as parts:
        for _ in range(12):
            whole.step()
            parts.step_by_substep(lambda _: None)
        assert np.array_equal(whole.positions(), parts.positions())


def test_each_body_has_its_own_margin_and_pose(make_mesh: MakeMesh) -> None:
    """A sheet falls on two bodies and a rigid mesh; one body moves up by its keyframes."""
    first = make_mesh(BALL, np.array([BALL.vertices] * 2), center=(-0.25, 0.0, 0.0))
    second = replace(first, margin=0.03, center=(0.25, 0.0, 0.0), keyframes=((0.0, 0, 0, 0), (0.5, 0, 0.1, 0)))
    rigid = replace(first, clip="", center=(0.0, -0.3, 0.0))
    wide = replace(SHEET.cloth, columns=21, width=0.8)
    with Simulation(with_mesh(first, cloth=wide, meshes=(first, rigid, second))) as simulation:
        simulation.step(64)
        posed = simulation.colliders()
        assert [tuple(one.center.round(6)) for one in posed] == [(-0.25, 0, 0), (0, -0.3, 0), (0.25, 0.1, 0)]
        x = simulation.positions()
        for one, margin in ((posed[0], 0.01), (posed[2], 0.03)):
            assert isinstance(one.collider, Mesh)
            found = distances_to_surface(collider_surface(one.collider), x - one.center)
            assert 0.8 * margin < found.min() < 2 * margin


def test_penetration_tells_the_depth_in_a_body(make_mesh: MakeMesh) -> None:
    mesh = make_mesh(BOX, np.array([BOX.vertices] * 2), margin=0.0)
    with Simulation(with_mesh(mesh)) as simulation:
        x = simulation.positions()
        simulation.set_state(x - [0.0, 0.25 - 0.08, 0.0])
        assert simulation.metrics().penetration == pytest.approx(0.02, abs=1e-6)


@pytest.mark.parametrize("layout", ["simd", "serial", "parallel"])
def test_penetration_is_the_depth_of_the_deepest_particle(make_mesh: MakeMesh, layout: str) -> None:
    random = np.random.default_rng(4)
    bumpy = BALL.copy()
    bumpy.vertices *= random.uniform(0.8, 1.2, (len(bumpy.vertices), 1))
    with Simulation(with_mesh(make_mesh(bumpy, growing(bumpy)), "verlet"), layout) as simulation:
        simulation.step(17)
        for inner, outer in ((0.0, 0.1), (0.1, 0.4), (0.25, 0.35), (0.5, 2.0)):
            x = random.normal(size=(simulation.topology.particle_count, 3))
            x *= random.uniform(inner, outer, (len(x), 1)) / np.linalg.norm(x, axis=1, keepdims=True)
            simulation.set_state(x)
            depth = max(0.0, -distances(simulation).min())
            assert simulation.metrics().penetration == pytest.approx(depth, abs=1e-6)


@pytest.mark.parametrize("speed", [30.0, 80.0])
def test_a_sheet_shot_at_a_thick_body_stops_at_its_surface(make_mesh: MakeMesh, speed: float) -> None:
    """In a frame it flies farther than the path for which triangles are listed, in a substep less than the margin."""
    mesh = make_mesh(BOX, np.array([BOX.vertices] * 2), margin=0.05)
    shot = with_mesh(mesh, cloth=replace(SHEET.cloth, center=(0.0, 2.0, 0.0)))
    with Simulation(replace(shot, solver=Solver(name="xpbd", substeps=40, iterations=1, damping=0.0))) as simulation:
        simulation.set_state(simulation.positions(), (0.0, -speed, 0.0))
        for _ in range(8):
            simulation.step()
            assert distances(simulation).min() > 0.9 * 0.05


def test_a_sheet_that_begins_to_fall_within_a_frame_stops_at_the_surface(make_mesh: MakeMesh) -> None:
    """At the start of the frame it rests, and nothing is in its way; its gravity is 40 times that of the earth."""
    mesh = make_mesh(BOX, np.array([BOX.vertices] * 2), margin=0.02)
    still = with_mesh(mesh, cloth=replace(SHEET.cloth, center=(0.0, 0.15, 0.0)), forces=Forces(gravity=400.0))
    with Simulation(still) as simulation:
        for _ in range(3):
            simulation.step()
            assert distances(simulation).min() > 0.9 * 0.02
