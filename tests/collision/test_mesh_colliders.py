"""Mesh colliders: a triangulated sphere compared with a sphere, files that are rejected, and agreement of layouts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.collision.colliders import max_penetration, pose_colliders, ray_cast, signed_distance
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.signed_distance import collider_sdf
from taichi_cloth.scene.collider_schema import Mesh, Sphere
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import SceneError

RADIUS, MARGIN = 0.2, 0.02
CENTER = (0.0, 0.5, 0.0)
OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
SIDES = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]


def write_sphere(path: Path, cuts: int) -> float:
    """Write a triangulated unit sphere, each triangle cut into four `cuts` times; return its largest error."""
    corners = OCTAHEDRON[SIDES]
    for _ in range(cuts):
        middles = (corners + np.roll(corners, -1, axis=1)) / 2
        a, b, c = corners.transpose(1, 0, 2)
        d, e, f = middles.transpose(1, 0, 2)
        corners = np.concatenate([np.stack(t, axis=1) for t in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    corners /= np.linalg.norm(corners, axis=2, keepdims=True)
    points, numbers = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    lines += [f"f {a} {b} {c}" for a, b, c in numbers.reshape(-1, 3) + 1]
    path.write_text("\n".join(lines))
    return float(1 - np.linalg.norm(corners.mean(axis=1), axis=1).min())


@pytest.fixture(scope="module")
def mesh_and_error(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mesh, float]:
    """Return a sphere as a mesh, and its largest error [m], of its faces and of interpolated distances."""
    folder = tmp_path_factory.mktemp("mesh")
    sag = RADIUS * write_sphere(folder / "sphere.obj", 4)
    found = Mesh(center=CENTER, margin=MARGIN, file="sphere.obj", scale=RADIUS, resolution=40, folder=str(folder))
    return found, sag + collider_sdf(found).spacing ** 2 / 8 * 2 / RADIUS


# A sheet that falls on what is in the center, pinned at two corners.
HUNG = Scene(
    cloth=Cloth(
        rows=20,
        columns=19,
        width=0.7,
        height=0.7,
        center=(0.0, 0.75, 0.0),
        rotation=(-90.0, 0.0, 0.0),
        pins=("top-left", "top-right"),
    ),
    solver=Solver(damping=4.0),
)


def test_distances_of_a_triangulated_sphere_match_the_sphere(mesh_and_error: tuple[Mesh, float]) -> None:
    mesh, error = mesh_and_error
    [posed], [sphere] = (
        pose_colliders([mesh], 0.0),
        pose_colliders([Sphere(center=CENTER, radius=RADIUS, margin=0.15, friction=0.0)], 0.0),
    )
    away = np.random.default_rng(6).normal(size=(500, 3))
    points = CENTER + away / np.linalg.norm(away, axis=1)[:, None] * np.linspace(0.1, 0.24, 500)[:, None]
    assert signed_distance(posed, points) == pytest.approx(
        signed_distance(sphere, points), abs=2 * error
    )  # halfway in its curvature is twice as high
    assert max_penetration([posed], points) == pytest.approx(0.1, abs=2 * error)
    down = np.array([0.0, -1.0, 0.0])
    assert ray_cast([posed], np.array([0.05, 3.0, 0.0]), down) == pytest.approx(2.5 - (0.04 - 0.0025) ** 0.5, abs=error)
    assert ray_cast([posed], np.array([0.21, 3.0, 0.0]), down) == np.inf


def test_cloth_rests_on_a_triangulated_sphere_as_on_a_sphere(mesh_and_error: tuple[Mesh, float]) -> None:
    mesh, error = mesh_and_error
    lying = []
    sphere = Sphere(center=CENTER, radius=RADIUS, margin=MARGIN, friction=0.3)
    for scene in (
        replace(HUNG, meshes=(replace(mesh, friction=0.3),)),
        replace(HUNG, spheres=(sphere,)),
    ):
        with Simulation(scene) as simulation:
            for _ in range(150):
                simulation.step()
            lying.append(np.linalg.norm(simulation.positions() - CENTER, axis=1))
            assert simulation.metrics().penetration == 0
            assert simulation.features[-1] in ("mesh", "sphere")
    for away in lying:
        assert away.min() == pytest.approx(RADIUS + MARGIN, abs=error)
    resting = [(np.abs(away - RADIUS - MARGIN) < error).sum() for away in lying]
    assert min(resting) > 20
    assert abs(resting[0] - resting[1]) < 10


@pytest.mark.parametrize("layout", ["simd", "parallel"])
def test_a_layout_matches_the_serial_layout(mesh_and_error: tuple[Mesh, float], layout: str) -> None:
    moving = replace(
        mesh_and_error[0], friction=0.3, spin=(0.0, 200.0, 90.0), oscillation=(0.0, 0.1, 0.0), period=(1.0, 1.0, 1.0)
    )
    bust = Mesh(center=(0.25, 0.5, 0.0), scale=0.5, resolution=24)
    scene = replace(HUNG, meshes=(moving, bust))
    with Simulation(scene, "serial") as serial, Simulation(scene, layout) as other:
        for _ in range(20):
            serial.step()
            other.step()
            assert other.positions() == pytest.approx(serial.positions(), abs=1e-4)
            for name in ("x", "x_prev", "velocity"):
                getattr(other.cloth, name).copy_from(getattr(serial.cloth, name))
        x = serial.positions()
        touching = [(np.abs(signed_distance(posed, x) - 0.02) < 1e-3).sum() > 3 for posed in serial.colliders()]
        assert touching == [True, True]


@pytest.mark.parametrize("speed", [20.0, 100.0])
def test_no_particle_passes_through_a_fast_triangulated_sphere(
    mesh_and_error: tuple[Mesh, float], speed: float
) -> None:
    """As with a sphere (`test_sweeps.py`): relative to it, no path of one frame passes through it."""
    keyframes = ((0.0, 0.0, 0.0, 0.0), (10.0, 0.0, 0.0, 10 * speed))
    cloth = Cloth(rows=21, columns=21, width=1.0, height=1.0, center=(0.0, 0.5, 0.0))
    crossed = {}
    for continuous in (True, False):
        center = (0.0, 0.5, -2.37 * speed / 60)
        mesh = replace(mesh_and_error[0], center=center, scale=0.1, keyframes=keyframes, continuous=continuous)
        scene = Scene(cloth=cloth, meshes=(mesh,), solver=Solver("verlet", 1, 12), forces=Forces(gravity=0.0))
        crossed[continuous] = 0
        with Simulation(scene) as simulation:
            before = simulation.positions() - simulation.colliders()[0].center
            for _ in range(5):
                simulation.step()
                after = simulation.positions() - simulation.colliders()[0].center
                move = after - before
                share = np.clip(-(before * move).sum(axis=1) / np.maximum((move * move).sum(axis=1), 1e-30), 0, 1)
                through = np.linalg.norm(before + share[:, None] * move, axis=1) < 0.098
                crossed[continuous] += int((through & ~simulation.topology.pinned).sum())
                before = after
    assert crossed[True] == 0
    assert crossed[False] > 5


def test_mesh_files_are_relative_to_the_scene_file(tmp_path: Path) -> None:
    (tmp_path / "solids").mkdir()
    write_sphere(tmp_path / "solids" / "sphere.obj", 0)
    scene_file = tmp_path / "mine.toml"
    for file, reason in (
        ("solids/sphere.obj", ""),
        ("sphere.obj", "sphere.obj: cannot be read: No such file or directory"),
        (
            "boost",
            "'boost' is not a shipped mesh; use bust, disc, knot, round, skirt, walker, walker_clothes, or the path of"
            " an OBJ file (did you mean 'bust'?)",
        ),
        (
            "solids/open.obj",
            "open.obj: the surface is not closed: the edge from vertex 3 to 2 belongs to only one face",
        ),
        ("solids/bad.obj", "bad.obj: line 2: 'y' is not a number"),
    ):
        (tmp_path / "solids" / "open.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3")
        (tmp_path / "solids" / "bad.obj").write_text("v 0 0 0\nv 1 y 0")
        scene_file.write_text(f'[[meshes]]\nfile = "{file}"')
        if not reason:
            [posed] = pose_colliders(load_scene(scene_file).meshes, 0.0)
            assert signed_distance(posed, posed.center[None]) == pytest.approx(-(3**-0.5), abs=0.01)
            continue
        with pytest.raises(SceneError) as caught:
            load_scene(scene_file)
        assert str(caught.value).startswith(f"{scene_file}: meshes[0].file: ")
        assert str(caught.value).endswith(reason)
