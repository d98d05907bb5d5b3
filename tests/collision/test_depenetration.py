"""Depenetration: a collider that appears around a cloth lets it out slowly; usual contact does not change."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.collision.colliders import collider_table, teleports
from taichi_cloth.collision.response import GROWTH_RATE, UNKNOWN, Depenetration
from taichi_cloth.kernels import step_params as c
from taichi_cloth.scene.collider_schema import Box, Capsule, Ground, Plane, Sphere
from taichi_cloth.scene.schema import SOLVER_NAMES, Cloth, Forces, Scene, Solver
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation

FRAME = 1 / 60
JUMP = ((0.5, 0.0, 0.0, 0.0), (0.500001, 0.0, 0.0, 5.0))  # within a microsecond


def test_keyframes_faster_than_sound_are_a_teleport() -> None:
    sphere = Sphere(center=(0.0, 0.0, -5.0), keyframes=JUMP, margin=0.15, friction=0.0)
    assert [teleports(sphere, k * FRAME, (k + 1) * FRAME) for k in (28, 29, 30, 31)] == [False, False, True, False]
    [row] = collider_table([sphere], 30 * FRAME, 31 * FRAME)
    assert row[c.COLLIDER_START : c.COLLIDER_START + 3] == pytest.approx([0, 0, 0])
    assert row[c.COLLIDER_END : c.COLLIDER_END + 3] == pytest.approx([0, 0, 0])
    fast = replace(sphere, keyframes=((0.0, 0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 3.0)))
    assert not teleports(fast, 0.0, FRAME)


def no_triangles() -> np.ndarray:
    raise AssertionError("corners of triangles are needed only for colliders that collide with them")


def test_triangles_within_a_margin_count_for_colliders_that_collide_with_them() -> None:
    """All particles are outside, and a triangle passes the sphere at half its margin."""
    corners = np.array([[[-1.0, 1.05, -1.0], [1.0, 1.05, -1.0], [0.0, 1.05, 2.0]], [[9.0, 9.0, 9.0]] * 3])
    sphere = Sphere(center=(0.0, 0.0, 0.0), radius=1.0, margin=0.1, collide_with="triangles", friction=0.0)
    for one, expected in ((sphere, 0.05), (replace(sphere, collide_with="particles"), 0.0)):
        before, after = Depenetration(1).advance([one], lambda: corners.reshape(-1, 3), lambda: corners, 0.0, FRAME)
        assert before == pytest.approx([expected])
        assert after == pytest.approx([max(expected - GROWTH_RATE * FRAME, 0.0)])


@pytest.mark.parametrize("kind", ["spheres", "capsules"])
@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_triangles_that_start_within_a_margin_are_not_shot_away(solver: str, kind: str) -> None:
    """A bar between two rows of particles, 5 mm deep in its margin; in short substeps too."""
    cloth = Cloth(rows=7, columns=7, width=0.24, height=0.24, center=(0.0, 1.0, 0.0), pins=())
    shape = {"spheres": Sphere, "capsules": Capsule}[kind]
    length = {"length": 0.5} if kind == "capsules" else {}
    bar = shape(
        center=(0.02, 1.02, -0.015),
        rotation=(0.0, 0.0, 90.0),
        radius=0.01,
        margin=0.01,
        collide_with="triangles",
        friction=0.0,
        **length,
    )
    choice = Solver(solver, 60, 2)
    colliders: dict[str, Any] = {kind: (bar,)}
    with Simulation(Scene(cloth=cloth, forces=Forces(gravity=0.0), solver=choice, **colliders)) as simulation:
        assert fastest(simulation, 10) < 5 * GROWTH_RATE
        assert np.abs(simulation.positions()[:, 2]).max() > 0.004


def test_the_depth_of_a_collider_is_tracked_until_it_is_zero() -> None:
    sphere = Sphere(center=(0.0, 0.0, 0.0), radius=1.0, margin=0.1, friction=0.0)
    queried: list[float] = []

    def at(x: float) -> tuple[float, float]:
        def points() -> np.ndarray:
            queried.append(x)
            return np.array([[2.0, 0.0, 0.0], [x, 0.0, 0.0]])

        before, after = depenetration.advance([sphere], points, no_triangles, 0.0, FRAME)
        return float(before[0]), float(after[0])

    depenetration, step = Depenetration(1), GROWTH_RATE * FRAME
    assert at(1.1) == (0, 0)  # not inside
    assert at(0.5) == (0, 0)  # not queried again
    assert queried == [1.1]
    depenetration.invalidate()
    assert depenetration.reduction[0] == UNKNOWN
    assert at(0.5) == pytest.approx((0.6, 0.6 - step))
    assert at(0.4) == pytest.approx((0.6 - step, 0.6 - 2 * step))  # deeper particles do not reduce it further
    assert at(0.9) == pytest.approx((0.2, 0.2 - step))  # particles that have come out do not keep it reduced
    assert at(1.2) == (0, 0)
    assert len(queried) == 5


def test_the_table_has_the_margin_at_both_ends_of_the_frame() -> None:
    """The reduction applies to colliders only; attachments, in the rows after them, have no margin."""
    spheres = [Sphere(margin=0.1, friction=0.0), Sphere(margin=0.2, friction=0.0)]
    table = collider_table(spheres, 0.0, FRAME, (np.array([0.3, 0.0]), np.array([0.25, 0.0])))
    assert table[:, c.COLLIDER_MARGIN] == pytest.approx([-0.2, 0.2])
    assert table[:, c.COLLIDER_MARGIN_CHANGE] == pytest.approx([0.05, 0.0])


def inside(solver: str) -> Scene:
    """Return a sheet inside a sphere."""
    sphere = Sphere(center=(0.0, 0.0, -0.02), radius=0.25, margin=0.01, friction=0.0)
    cloth = Cloth(rows=9, columns=9, width=0.3, height=0.3, center=(0.0, 0.0, 0.0), pins=())
    choice = Solver(solver, *SOLVER_CATALOG[solver].defaults, damping=2.0)
    return Scene(cloth=cloth, spheres=(sphere,), forces=Forces(gravity=0.0), solver=choice)


SNAP = 4.0  # [m/s] of particles moved by springs that the growing sphere has stretched


def fastest(simulation: Simulation, frames: int) -> float:
    """Return the highest speed of any particle in some frames [m/s]."""
    speeds = []
    for _ in range(frames):
        simulation.step()
        speeds.append(np.linalg.norm(simulation.velocities(), axis=1).max())
    return float(max(speeds))


@pytest.mark.parametrize("solver", ["verlet", "xpbd"])
def test_a_cloth_inside_a_sphere_comes_out_slowly(solver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Simulation(inside(solver)) as simulation:
        assert fastest(simulation, 10) < SNAP
        simulation.save(tmp_path / "held.npz")
        assert fastest(simulation, 20) < SNAP
        later = simulation.positions()
        assert fastest(simulation, 150) < SNAP
        assert simulation.metrics().penetration == 0
        simulation.load(tmp_path / "held.npz")
        fastest(simulation, 20)
        assert (simulation.positions() == later).all()
        monkeypatch.setattr(Depenetration, "advance", lambda self, *_: (0 * self.reduction, 0 * self.reduction))
        simulation.reset()
        assert fastest(simulation, 10) > 10 * SNAP  # at once


AROUND: dict[str, Any] = {
    "capsules": Capsule(center=(0.0, 0.0, -0.02), radius=0.25, length=0.3, margin=0.01),
    "boxes": Box(center=(0.0, 0.0, -0.02), size=(0.5, 0.6, 0.5), margin=0.01),
    "planes": Plane(center=(0.0, 0.0, 0.1), rotation=(90.0, 0.0, 0.0), margin=0.01),
}


@pytest.mark.parametrize("kind", AROUND)
def test_every_shape_lets_cloth_out_slowly(kind: str) -> None:
    """One iteration per substep: springs stretched by a box and solved to convergence snap at over 100 m/s, also with
    `explicit`.
    """
    setting = Solver("xpbd", 30, 1, damping=2.0)
    colliders: dict[str, Any] = {kind: (AROUND[kind],)}
    scene = replace(inside("xpbd"), solver=setting, spheres=(), **colliders)
    with Simulation(scene) as simulation:
        assert simulation.metrics().penetration > 0.09
        most = 3 * SNAP if kind == "boxes" else SNAP  # the corners of the cloth leave a box through different faces
        assert fastest(simulation, 150) < most
        assert simulation.metrics().penetration == 0


def test_a_sphere_that_grows_or_teleports_into_the_cloth() -> None:
    """With the same kernel as above, a pinned sheet beside a sphere."""
    scene = inside("xpbd")
    scene = replace(scene, cloth=replace(scene.cloth, pins=("top",)))
    beside = Sphere(center=(0.0, 0.0, 0.02), radius=0.005, margin=0.01, friction=0.0)
    far = Sphere(center=(0.0, 0.0, -4.98), radius=0.1, margin=0.01, keyframes=JUMP, friction=0.0)
    for sphere in (beside, far):
        with Simulation(replace(scene, spheres=(sphere,))) as simulation:
            assert fastest(simulation, 28) < 0.2
            if sphere is beside:
                simulation.params["sphere_radius"] = 0.12
            assert fastest(simulation, 50) < SNAP
            assert np.abs(simulation.positions()[:, 2]).max() > 0.04  # it was moved out of the sphere


@pytest.mark.parametrize("solver", SOLVER_NAMES)
@pytest.mark.parametrize("depth", [1e-3, 0.02, 0.04])
def test_cloth_that_starts_within_a_margin_is_not_shot_away(solver: str, depth: float) -> None:
    """It rises by the rate at which the margin grows, also if it is less deep than that rate moves it in a frame."""
    cloth = Cloth(rows=9, columns=9, center=(0.0, 0.02 - depth, 0.0), rotation=(-90.0, 0.0, 0.0), pins=())
    choice = Solver(solver, *SOLVER_CATALOG[solver].defaults)
    with Simulation(Scene(cloth=cloth, ground=Ground(margin=0.02), solver=choice)) as simulation:
        for _ in range(20):
            simulation.step()
            assert simulation.positions()[:, 1].max() < 0.02 + 2 * GROWTH_RATE * FRAME
        assert simulation.positions()[:, 1] == pytest.approx(0.02, abs=1e-4)
