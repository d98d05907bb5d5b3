"""Colliders that are moved by calls: the cloth meets them as it meets colliders with keyframes."""

from __future__ import annotations

import io
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.collision.colliders import displaced, keyframe_offset, max_penetration, pose
from taichi_cloth.export.clip import replay
from taichi_cloth.scene.collider_schema import Box, Capsule, Ground, Plane, Sphere
from taichi_cloth.scene.schema import FRAME_SECONDS, SOLVER_NAMES, Cloth, Scene, SelfCollision, Solver
from taichi_cloth.simulation.checkpoint import checkpoint_bytes, read_checkpoint
from taichi_cloth.simulation.copies import FrameErrorMeter, FrameStart
from taichi_cloth.simulation.events import Event
from taichi_cloth.simulation.recording import Recorder
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout")

CLOTH = Cloth(rows=9, columns=9, width=0.8, height=0.8, center=(0.0, 1.0, 0.0), pins=("top",))
BALL = Sphere(name="ball", center=(0.1, 0.9, 0.3), radius=0.15, margin=0.02, friction=0.5)
SCENE = Scene(cloth=CLOTH, spheres=(BALL,), ground=Ground())
FRAMES = 12
PATH = np.array([[0.1, 0.9, 0.3 - 0.04 * k] for k in range(FRAMES + 1)])  # 2.4 m/s through the sheet


def keyframed(ball: Sphere) -> Sphere:
    offsets = PATH - PATH[0]
    return replace(ball, keyframes=tuple((k * FRAME_SECONDS, *offset) for k, offset in enumerate(offsets.tolist())))


@pytest.mark.parametrize("solver", SOLVER_NAMES)
@pytest.mark.parametrize("continuous", [False, True])
def test_cloth_meets_a_moved_ball_as_one_with_keyframes(solver: str, continuous: bool) -> None:
    """To rounding: keyframes are offsets from the center in the first frame, a call sets a center."""
    ball = replace(BALL, continuous=continuous)
    scene = replace(SCENE, spheres=(ball,), solver=Solver(solver))
    with Simulation(scene) as called, Simulation(replace(scene, spheres=(keyframed(ball),))) as keyed:
        for k in range(FRAMES):
            called.move_collider(0, PATH[k + 1])
            called.step()
            keyed.step()
            assert called.colliders()[0].center == pytest.approx(keyed.colliders()[0].center, abs=1e-12)
        moved = np.abs(called.positions() - called.topology.start)[:, 2].max()
        assert moved > 0.1
        assert called.positions() == pytest.approx(keyed.positions(), abs=1e-4)


def test_a_ball_stays_where_it_was_moved_and_its_own_motion_goes_on() -> None:
    ball = replace(BALL, oscillation=(0.0, 0.0, 0.2), period=(1.0, 1.0, 1.0))
    with Simulation(replace(SCENE, spheres=(ball, replace(BALL, name="")))) as simulation:
        simulation.move_collider("ball", (2.0, 1.0, 0.0))
        assert simulation.colliders()[0].center == pytest.approx(BALL.center)  # until the frame
        simulation.step()
        assert simulation.colliders()[0].center == pytest.approx((2.0, 1.0, 0.0), abs=1e-12)
        simulation.step(30)
        shift = np.subtract((2.0, 1.0, 0.0), pose(ball, FRAME_SECONDS)[0])
        assert simulation.colliders()[0].center == pytest.approx(pose(ball, 31 * FRAME_SECONDS)[0] + shift)
        assert simulation.colliders()[1].center == pytest.approx(BALL.center)


def test_a_reset_takes_it_back_bit_for_bit() -> None:
    with Simulation(SCENE) as simulation, Simulation(SCENE) as other:
        simulation.move_collider(0, (0.1, 0.9, 0.0))
        simulation.step(3)
        simulation.reset()
        assert simulation.colliders()[0].center.tolist() == list(BALL.center)
        simulation.step(5)
        other.step(5)
        assert np.array_equal(simulation.positions(), other.positions())


def test_a_fast_move_puts_it_there_at_once_and_lets_cloth_out_slowly() -> None:
    with Simulation(replace(SCENE, spheres=(replace(BALL, center=(0.0, 0.9, -9.0), continuous=True),))) as simulation:
        simulation.move_collider(0, (0.0, 0.9, 0.01))  # 540 m/s
        simulation.step()
        assert simulation.colliders()[0].center == pytest.approx((0.0, 0.9, 0.01))
        assert np.abs(simulation.positions() - simulation.topology.start).max() < 0.02


@pytest.mark.parametrize(
    ("name", "collider"),
    [
        ("capsules", Capsule(center=(0.0, 0.9, 0.4), length=0.2, radius=0.1)),
        ("boxes", Box(center=(0.0, 0.9, 0.4), size=(0.2, 0.2, 0.2))),
        ("planes", Plane(center=(0.0, 0.9, 0.4), rotation=(-90.0, 0.0, 0.0))),
    ],
)
def test_every_shape_can_be_moved(name: str, collider: object) -> None:
    with Simulation(Scene(cloth=CLOTH, **{name: (collider,)})) as simulation:
        for z in np.linspace(0.4, -0.1, 20):
            simulation.move_collider(0, (0.0, 0.9, z))
            simulation.step()
        assert simulation.positions()[:, 2].min() < -0.1
        assert max_penetration(simulation.colliders(), simulation.free_positions()) < 0.02


def test_a_displaced_collider_has_its_own_keyframes_too() -> None:
    box = Box(center=(1.0, 2.0, 3.0), keyframes=((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0, 0.0, 90.0, 0.0)))
    assert keyframe_offset(box, 0.5) == pytest.approx([0.5, 0.0, 0.0, 0.0, 45.0, 0.0])
    moved = displaced(box, 0.5, 0.6, (np.array([0.0, 1.0, 0.0]), np.array([0.0, 2.0, 0.0])))
    for seconds, up in ((0.5, 1.0), (0.55, 1.5), (0.6, 2.0)):
        (center, axes), (own, own_axes) = pose(moved, seconds), pose(box, seconds)
        assert center == pytest.approx(own + [0.0, up, 0.0])
        assert axes == pytest.approx(own_axes)


def test_a_displaced_collider_at_rest_is_the_same_in_every_frame() -> None:
    """The table of colliders is cached by collider: one that changed in every frame would miss the cache."""
    keyframes = ((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0, 0.0, 90.0, 0.0), (1.1, 2.0, 0.0, 0.0))
    for box in (Box(center=(1.0, 2.0, 3.0), keyframes=keyframes), Box(oscillation=(0.0, 0.3, 0.0)), Box()):
        rest = (np.array([0.0, 1.0, 0.5]),) * 2
        moved = displaced(box, 0.5, 0.6, rest)
        assert displaced(box, 0.6, 0.7, rest) == moved
        for seconds in (0.0, 0.5, 1.05, 3.0):
            (center, axes), (own, own_axes) = pose(moved, seconds), pose(box, seconds)
            assert center == pytest.approx(own + [0.0, 1.0, 0.5])
            assert axes == pytest.approx(own_axes)


def test_a_checkpoint_has_where_it_is_and_where_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    with Simulation(SCENE) as simulation, Simulation(SCENE) as other:
        simulation.move_collider(0, PATH[1])
        simulation.step()
        simulation.move_collider(0, PATH[2])
        simulation.save(path)
        other.load(path)
        for running in (simulation, other):
            running.step(4)
        assert np.array_equal(other.positions(), simulation.positions())
        assert other.colliders()[0].center == pytest.approx(PATH[2])


def test_a_checkpoint_of_an_earlier_version_has_moved_no_collider(tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    with Simulation(SCENE) as simulation:
        simulation.save(path)
        arrays = dict(np.load(path))
        del arrays["displacements"]
        np.savez(path, **arrays)
        simulation.move_collider(0, PATH[1])
        simulation.load(path)
        assert simulation.displacements == {}


@pytest.mark.parametrize("rows", [[0.0, 0.0], [5.0], [0.5], [-1.0]])
def test_a_damaged_checkpoint_is_refused(rows: list[float]) -> None:
    with Simulation(SCENE) as simulation:
        simulation.move_collider(0, PATH[1])
        good = checkpoint_bytes(simulation)
        simulation.displacements = {}
        arrays = dict(np.load(io.BytesIO(good)))
        arrays["displacements"] = np.array([[row, *np.zeros(6)] for row in rows])
        content = io.BytesIO()
        np.savez(content, **arrays)
        with pytest.raises(ValueError, match="damaged: displacements of colliders"):
            read_checkpoint(simulation, content.getvalue())
        assert simulation.displacements == {}


def test_a_recording_moves_it_again(tmp_path: Path) -> None:
    path = tmp_path / "clip.toml"
    with Simulation(SCENE) as simulation:
        recorder = Recorder(simulation)
        for target in PATH[1:]:
            simulation.move_collider("ball", target)
            simulation.step()
        recorder.save(path)
        positions = simulation.positions()
    with replay(path) as again:
        assert np.array_equal(again.positions(), positions)


def test_the_error_of_a_frame_is_measured_with_the_moved_ball() -> None:
    with Simulation(SCENE) as simulation, closing(FrameErrorMeter(SCENE)) as meter:
        for target in PATH[1:6]:
            simulation.move_collider(0, target)
            start = FrameStart.of(simulation)
            simulation.step()
        error = meter.measure(start, simulation.positions())
        with Simulation(SCENE) as other:  # the ball where it was
            other.set_state(start.positions, start.velocities)
            other.step()
            without = np.abs(other.positions() - simulation.positions()).max()
        assert error.error < without / 5


def test_a_solver_that_is_switched_to_keeps_where_it_is() -> None:
    with Simulation(SCENE) as simulation:
        simulation.move_collider(0, PATH[3])
        simulation.step()
        simulation.switch_solver("xpbd")
        assert simulation.colliders()[0].center == pytest.approx(PATH[3])


def test_nothing_passes_through_a_penetration_free_cloth_that_a_ball_presses() -> None:
    contact = SelfCollision(penetration_free=True, thickness=0.01)
    with Simulation(replace(SCENE, self_collision=contact)) as simulation:
        for target in PATH[1:]:
            simulation.move_collider(0, target)
            simulation.step()
            assert simulation.intersections() == 0


@pytest.mark.parametrize(
    ("collider", "said"),
    [
        (2, r"there is no collider 2: moved has 2, numbered from 0"),
        (-1, "there is no collider -1"),
        (1, "collider 1 is the ground, which cannot move: use a plane"),
        ("bal", "no collider is named 'bal': ball; did you mean 'ball'"),
        ("", "no collider is named ''"),
        (True, "a collider is an index or a name, not true"),
        (0.0, "a collider is an index or a name, not 0.0"),
    ],
)
def test_what_is_no_collider_is_refused(collider: object, said: str) -> None:
    with Simulation(replace(SCENE, name="moved")) as simulation:
        with pytest.raises(ValueError, match=said):
            simulation.move_collider(collider, (0.0, 0.0, 0.0))
        assert simulation.displacements == {}


@pytest.mark.parametrize("target", [(0.0, 1.0), (0.0, float("nan"), 0.0), (0.0, 2e6, 0.0), "up"])
def test_what_is_no_target_is_refused(target: object) -> None:
    with Simulation(SCENE) as simulation:
        with pytest.raises(ValueError, match=r"target|number"):
            simulation.move_collider(0, target)
        with pytest.raises(ValueError, match=r"argument|collider"):
            simulation.apply(Event("move_collider", (0.5, 0.0, 0.0, 0.0)))
        assert simulation.displacements == {}
