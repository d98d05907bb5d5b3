"""A collider that appears around a cloth lets it out slowly, and one that is touched as usual does as ever."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.contact.bodies import body_table, leaps
from taichi_cloth.contact.release import ASKED, HELD, RATE, Release
from taichi_cloth.kernels import controls as c
from taichi_cloth.scene.model import USUAL, Box, Capsule, Cloth, Forces, Plane, Scene, Solver, Sphere
from taichi_cloth.simulation import Simulation

FRAME = 1 / 60
JUMP = ((0.5, 0.0, 0.0, 0.0), (0.500001, 0.0, 0.0, 5.0))  # within a microsecond


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

    def at(x: float) -> tuple[float, float]:
        def points() -> np.ndarray:
            asked.append(x)
            return np.array([[2.0, 0.0, 0.0], [x, 0.0, 0.0]])

        before, after = release.depths([ball], points, 0.0, FRAME)
        return float(before[0]), float(after[0])

    release, step = Release(1), RATE * FRAME
    assert at(1.1 - HELD / 2) == (0, 0)  # not deep enough to be held
    assert at(0.5) == (0, 0)  # and nobody asks again
    assert asked == [1.1 - HELD / 2]
    release.ask()
    assert release.depth[0] == ASKED
    assert at(0.5) == pytest.approx((0.6, 0.6 - step))
    assert at(0.4) == pytest.approx((0.6 - step, 0.6 - 2 * step))  # what has sunk in does not make it smaller
    assert at(0.9) == pytest.approx((0.2, 0.2 - step))  # what has come out by itself does not keep it small
    assert at(1.2) == (0, 0)
    assert len(asked) == 5


def test_the_table_has_the_margin_at_both_ends_of_the_frame() -> None:
    """Of the colliders; a grip behind them has none."""
    balls = [Sphere(margin=0.1), Sphere(margin=0.2)]
    table = body_table(balls, 0.0, FRAME, (np.array([0.3, 0.0]), np.array([0.25, 0.0])))
    assert table[:, c.BODY_MARGIN] == pytest.approx([-0.2, 0.2])
    assert table[:, c.BODY_GROWTH] == pytest.approx([0.05, 0.0])


def inside(solver: str) -> Scene:
    """A ball around all of a sheet."""
    ball = Sphere(center=(0.0, 0.0, -0.02), radius=0.25, margin=0.01)
    cloth = Cloth(rows=9, columns=9, width=0.3, height=0.3, center=(0.0, 0.0, 0.0), pins=())
    choice = Solver(solver, *USUAL[solver], damping=2.0)
    return Scene(cloth=cloth, spheres=(ball,), forces=Forces(gravity=0.0), solver=choice)


SNAP = 4.0  # [m/s] what is pushed about by springs that the growing ball has opened


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


AROUND = {
    "capsules": Capsule(center=(0.0, 0.0, -0.02), radius=0.25, length=0.3, margin=0.01),
    "boxes": Box(center=(0.0, 0.0, -0.02), size=(0.5, 0.6, 0.5), margin=0.01),
    "planes": Plane(center=(0.0, 0.0, 0.1), rotation=(90.0, 0.0, 0.0), margin=0.01),
}


@pytest.mark.parametrize("kind", AROUND)
def test_every_body_lets_out_slowly(kind: str) -> None:
    """One iteration a substep: springs that a box has opened and that are solved to the end snap at over 100 m/s, with
    `spring` too.
    """
    setting = Solver("xpbd", 30, 1, damping=2.0)
    scene = replace(inside("xpbd"), solver=setting, spheres=(), **{kind: (AROUND[kind],)})
    with Simulation(scene) as simulation:
        assert simulation.measure().penetration > 0.09
        most = 3 * SNAP if kind == "boxes" else SNAP  # a box lets its corners out by different faces
        assert fastest(simulation, 150) < most
        assert simulation.measure().penetration == 0


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
