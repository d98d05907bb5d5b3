"""Meshes as colliders: a ball of triangles against the ball itself, what files are refused, and all paths alike."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.contact.bodies import bodies_at, distance, first_hit, penetration
from taichi_cloth.mesh.solid import distances_of
from taichi_cloth.scene import SceneError, load_scene
from taichi_cloth.scene.model import Cloth, Forces, Mesh, Scene, Solver, Sphere
from taichi_cloth.simulation import Simulation

RADIUS, MARGIN = 0.2, 0.02
MIDDLE = (0.0, 0.5, 0.0)
OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
SIDES = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]


def write_ball(path: Path, cuts: int) -> float:
    """A unit ball of triangles, each cut into four again and again; returns how far the surface is within the ball."""
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
def ball(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mesh, float]:
    """A ball as a mesh, and how far it is at most from the sphere [m]: its faces, and distances between nodes."""
    folder = tmp_path_factory.mktemp("mesh")
    sag = RADIUS * write_ball(folder / "ball.obj", 4)
    found = Mesh(center=MIDDLE, margin=MARGIN, file="ball.obj", scale=RADIUS, resolution=40, folder=str(folder))
    return found, sag + distances_of(found).spacing ** 2 / 8 * 2 / RADIUS


# A sheet that is laid over what is in the middle, held at two corners.
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


def test_a_ball_of_triangles_is_as_far_as_the_ball(ball: tuple[Mesh, float]) -> None:
    mesh, off = ball
    [body], [sphere] = bodies_at([mesh], 0.0), bodies_at([Sphere(center=MIDDLE, radius=RADIUS)], 0.0)
    away = np.random.default_rng(6).normal(size=(500, 3))
    places = MIDDLE + away / np.linalg.norm(away, axis=1)[:, None] * np.linspace(0.1, 0.24, 500)[:, None]
    assert distance(body, places) == pytest.approx(distance(sphere, places), abs=2 * off)  # half way in it bends twice
    assert penetration([body], places) == pytest.approx(0.1, abs=2 * off)
    down = np.array([0.0, -1.0, 0.0])
    assert first_hit([body], np.array([0.05, 3.0, 0.0]), down) == pytest.approx(2.5 - (0.04 - 0.0025) ** 0.5, abs=off)
    assert first_hit([body], np.array([0.21, 3.0, 0.0]), down) == np.inf


def test_cloth_lies_on_a_ball_of_triangles_as_on_the_ball(ball: tuple[Mesh, float]) -> None:
    mesh, off = ball
    lying = []
    sphere = Sphere(center=MIDDLE, radius=RADIUS, margin=MARGIN, friction=0.3)
    for scene in (
        replace(HUNG, meshes=(replace(mesh, friction=0.3),)),
        replace(HUNG, spheres=(sphere,)),
    ):
        with Simulation(scene) as simulation:
            for _ in range(150):
                simulation.advance_frame()
            lying.append(np.linalg.norm(simulation.positions() - MIDDLE, axis=1))
            assert simulation.measure().penetration == 0
            assert simulation.stages[-1] in ("mesh", "sphere")
    for away in lying:
        assert away.min() == pytest.approx(RADIUS + MARGIN, abs=off)
    resting = [(np.abs(away - RADIUS - MARGIN) < off).sum() for away in lying]
    assert min(resting) > 20
    assert abs(resting[0] - resting[1]) < 10


@pytest.mark.parametrize("path", ["lanes", "gather"])
def test_a_path_equals_the_list_of_springs(ball: tuple[Mesh, float], path: str) -> None:
    moving = replace(ball[0], friction=0.3, spin=(0.0, 200.0, 90.0), sway=(0.0, 0.1, 0.0), period=(1.0, 1.0, 1.0))
    bust = Mesh(center=(0.25, 0.5, 0.0), scale=0.5, resolution=24)
    scene = replace(HUNG, meshes=(moving, bust))
    with Simulation(scene, "list") as plain, Simulation(scene, path) as other:
        for _ in range(20):
            plain.advance_frame()
            other.advance_frame()
            assert other.positions() == pytest.approx(plain.positions(), abs=1e-4)
            for name in ("x", "x_prev", "velocity"):
                getattr(other.cloth, name).copy_from(getattr(plain.cloth, name))
        bodies = plain.bodies()
        assert [(np.abs(distance(body, plain.positions()) - 0.02) < 1e-3).sum() > 3 for body in bodies] == [True, True]


@pytest.mark.parametrize("speed", [20.0, 100.0])
def test_no_particle_gets_through_a_fast_ball_of_triangles(ball: tuple[Mesh, float], speed: float) -> None:
    """As of a sphere (`test_sweeps.py`): seen from the ball, no way of one frame leads through it."""
    flight = ((0.0, 0.0, 0.0, 0.0), (10.0, 0.0, 0.0, 10 * speed))
    cloth = Cloth(rows=21, columns=21, width=1.0, height=1.0, center=(0.0, 0.5, 0.0))
    crossed = {}
    for swept in (True, False):
        center = (0.0, 0.5, -2.37 * speed / 60)
        mesh = replace(ball[0], center=center, scale=0.1, path=flight, swept=swept)
        scene = Scene(cloth=cloth, meshes=(mesh,), solver=Solver("verlet", 1, 12), forces=Forces(gravity=0.0))
        crossed[swept] = 0
        with Simulation(scene) as simulation:
            before = simulation.positions() - simulation.bodies()[0].center
            for _ in range(5):
                simulation.advance_frame()
                after = simulation.positions() - simulation.bodies()[0].center
                way = after - before
                share = np.clip(-(before * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-30), 0, 1)
                through = np.linalg.norm(before + share[:, None] * way, axis=1) < 0.098
                crossed[swept] += int((through & ~simulation.topology.pinned).sum())
                before = after
    assert crossed[True] == 0
    assert crossed[False] > 5


def test_a_mesh_file_is_looked_for_beside_the_scene(tmp_path: Path) -> None:
    (tmp_path / "solids").mkdir()
    write_ball(tmp_path / "solids" / "ball.obj", 0)
    scene_file = tmp_path / "mine.toml"
    for file, reason in (
        ("solids/ball.obj", ""),
        ("ball.obj", "ball.obj: cannot be read: No such file or directory"),
        ("boost", "'boost' is no shipped mesh: bust, disc, round, or the path of an OBJ file (did you mean 'bust'?)"),
        ("solids/open.obj", "open.obj: it is not closed: the edge from point 3 to 2 belongs to one face only"),
        ("solids/bad.obj", "bad.obj: line 2: 'y' is no number"),
    ):
        (tmp_path / "solids" / "open.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3")
        (tmp_path / "solids" / "bad.obj").write_text("v 0 0 0\nv 1 y 0")
        scene_file.write_text(f'[[meshes]]\nfile = "{file}"')
        if not reason:
            [body] = bodies_at(load_scene(scene_file).meshes, 0.0)
            assert distance(body, body.center[None]) == pytest.approx(-(3**-0.5), abs=0.01)
            continue
        with pytest.raises(SceneError) as caught:
            load_scene(scene_file)
        assert str(caught.value).startswith(f"{scene_file}: meshes[0].file: ")
        assert str(caught.value).endswith(reason)
