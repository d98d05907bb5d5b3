"""A collider that appears around a cloth lets it out slowly, and one that is touched as usual does as ever."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.contact.bodies import body_table, leaps
from taichi_cloth.contact.push_out import held_back
from taichi_cloth.contact.release import HELD, RELEASED, Release
from taichi_cloth.kernels import controls as c
from taichi_cloth.scene.model import USUAL, Cloth, Forces, Scene, Solver, Sphere
from taichi_cloth.simulation import Simulation

FRAME = 1 / 60
JUMP = ((0.5, 0.0, 0.0, 0.0), (0.500001, 0.0, 0.0, 5.0))  # within a microsecond


@ti.kernel
def of_a_push(push: tm.vec3, before: tm.vec3, way: float) -> tm.vec3:
    return held_back(push, before, way)


def test_held_back_by_hand() -> None:
    push = tm.vec3(0.3, 0.0, 0.4)
    assert np.array(of_a_push(push, push, 0.1)) == pytest.approx([0.06, 0, 0.08])  # 0.5 m are left but for 0.1
    assert np.array(of_a_push(push, tm.vec3(0.0, 0.9, 0.0), 0.1)) == pytest.approx(0)  # came out by itself
    for before in (0.0, 0.0999):
        assert tuple(of_a_push(push, tm.vec3(before, 0.0, 0.0), 0.1)) == tuple(push)
    assert tuple(of_a_push(push * 0.0, push, 0.1)) == (0.0, 0.0, 0.0)


def test_a_path_beyond_sound_is_a_leap() -> None:
    ball = Sphere(center=(0.0, 0.0, -5.0), path=JUMP)
    assert [leaps(ball, k * FRAME, (k + 1) * FRAME) for k in (28, 29, 30, 31)] == [False, False, True, False]
    [row] = body_table([ball], 30 * FRAME, 31 * FRAME)
    assert row[c.BODY_FROM : c.BODY_FROM + 3] == pytest.approx([0, 0, 0])
    assert row[c.BODY_TO : c.BODY_TO + 3] == pytest.approx([0, 0, 0])
    fast = replace(ball, path=((0.0, 0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 3.0)))
    assert not leaps(fast, 0.0, FRAME)


def test_a_collider_is_asked_until_it_holds_nothing() -> None:
    ball = Sphere(center=(0.0, 0.0, 0.0), radius=1.0, margin=0.1)
    asked = []

    def at(x: float) -> float:
        def points() -> np.ndarray:
            asked.append(x)
            return np.array([[x, 0.0, 0.0]])

        return float(release.rates([ball], points, 0.0, FRAME)[0])

    release = Release(1)
    assert at(1.1 - HELD / 2) == 0  # not deep enough to be held
    assert at(0.5) == 0  # and nobody asks again
    assert asked == [1.1 - HELD / 2]
    release.ask()
    assert [at(0.5), at(1.1 - 2 * RELEASED), at(1.1 - RELEASED / 2), at(0.5)] == pytest.approx([0.2, 0.2, 0, 0])


def inside(solver: str) -> Scene:
    """A ball around all of a sheet."""
    ball = Sphere(center=(0.0, 0.0, -0.02), radius=0.25, margin=0.01)
    cloth = Cloth(rows=9, columns=9, width=0.3, height=0.3, center=(0.0, 0.0, 0.0), pins=())
    choice = Solver(solver, *USUAL[solver], damping=2.0)
    return Scene(cloth=cloth, spheres=(ball,), forces=Forces(gravity=0.0), solver=choice)


SNAP = 4.0  # [m/s] springs that were opened draw together again


@pytest.fixture(autouse=True)
def faster(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taichi_cloth.contact.release.RATE", 0.2)


def fastest(simulation: Simulation, frames: int) -> float:
    """The highest speed of any particle [m/s]."""
    speeds = []
    for _ in range(frames):
        simulation.advance_frame()
        speeds.append(np.linalg.norm(simulation.velocities(), axis=1).max())
    return float(max(speeds))


@pytest.mark.parametrize("solver", ["verlet", "xpbd"])
def test_a_cloth_within_a_ball_comes_out_slowly(solver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Simulation(inside(solver)) as simulation:
        assert fastest(simulation, 10) < SNAP
        simulation.save(tmp_path / "held.npz")
        assert fastest(simulation, 20) < SNAP
        later = simulation.positions()
        assert fastest(simulation, 150) < SNAP
        assert simulation.measure().penetration == 0
        simulation.load(tmp_path / "held.npz")
        fastest(simulation, 20)
        assert (simulation.positions() == later).all()
        monkeypatch.setattr("taichi_cloth.contact.release.HELD", np.inf)
        simulation.reset()
        assert fastest(simulation, 10) > 10 * SNAP  # at once


def test_a_ball_that_grows_into_the_cloth_or_leaps_into_it() -> None:
    """The same kernel as above; a pinned sheet beside a ball."""
    scene = inside("xpbd")
    scene = replace(scene, cloth=replace(scene.cloth, pins=("top",)))
    beside = Sphere(center=(0.0, 0.0, 0.02), radius=0.005, margin=0.01)
    far = Sphere(center=(0.0, 0.0, -4.98), radius=0.1, margin=0.01, path=JUMP)
    for ball in (beside, far):
        with Simulation(replace(scene, spheres=(ball,))) as simulation:
            assert fastest(simulation, 28) < 0.2
            if ball is beside:
                simulation.set("sphere_radius", 0.12)
            assert fastest(simulation, 50) < SNAP
            assert np.abs(simulation.positions()[:, 2]).max() > 0.04  # it was moved out
