"""Attachments: pins that move as a rigid body."""

from dataclasses import replace
from math import exp, sin, sqrt
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.collider_schema import Attachment
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, Tethers
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import SOLVERS
from taichi_cloth.system.errors import SceneError

CLOTH = Cloth(rows=6, columns=9, width=0.8, height=0.5, center=(0.0, 1.0, 0.0), pins=())
TURNING = Attachment(pins=("left",), center=(-0.4, 1.0, 0.0), spin=(0.0, 90.0, 0.0))
GOING = Attachment(pins=("right",), center=(0.0, 0.0, 0.0), keyframes=((0.0, 0.0, 0.0, 0.0), (1.0, 0.3, 0.0, 0.6)))


def scene(solver: str, *attachments: Attachment) -> Scene:
    return Scene(
        cloth=CLOTH,
        solver=Solver(solver, *SOLVER_CATALOG[solver].defaults),
        attachments=attachments,
        forces=Forces(gravity=0.0),
    )


def edges_after(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the expected positions of both edges [m]."""
    left = np.stack([np.full(6, -0.4), np.linspace(1.25, 0.75, 6), np.zeros(6)], axis=1)
    return left, left + [0.8 + 0.3 * seconds, 0.0, 0.6 * seconds]


@pytest.mark.parametrize("solver", SOLVERS)
def test_attached_pins_move_with_their_body(solver: str) -> None:
    """An edge on the axis of rotation stays, the other moves straight; a grab overrides the attachment."""
    with Simulation(scene(solver, TURNING, GOING)) as simulation:
        for _ in range(6):
            simulation.step()
        x = simulation.positions().reshape(6, 9, 3)
        left, right = edges_after(0.1)
        assert x[:, 0] == pytest.approx(left, abs=1e-6)
        assert x[:, 8] == pytest.approx(right, abs=1e-6)
        grab = simulation.grab(8)
        grab.move_to([0.5, 1.3, 0.1])
        simulation.step()
        assert simulation.positions()[8] == pytest.approx([0.5, 1.3, 0.1], abs=1e-6)
        grab.release()
        simulation.step()
        assert simulation.positions()[8] == pytest.approx(edges_after(8 / 60)[1][0], abs=1e-6)


def test_an_attachment_without_pins_is_named() -> None:
    for other, line in ((GOING, ""), (replace(GOING, pins=()), "an attachment without pins moves nothing")):
        with Simulation(scene("explicit", TURNING, other)) as simulation:
            assert line in simulation.warnings
            assert ("attachment" in simulation.warnings) == bool(line)


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
def test_only_changes_of_the_pose_since_the_start_move_attached_particles(layout: str) -> None:
    """By one rule for offsets and rotations: a trajectory need not begin with zeros."""
    axis = {"pins": ("right",), "center": (-0.4, 1.0, 0.0)}
    moves = [
        (axis | {"keyframes": ((0.0, 0.5, 0.0, 0.0, 0.0, 90.0, 0.0),)}, [0.0, 0.0, 0.0]),
        (axis | {"keyframes": ((0.0, 0.5, 0.0, 0.0), (0.1, 0.6, 0.2, 0.0))}, [0.1, 0.2, 0.0]),
        (axis | {"rocking": (0.0, 30.0, 0.0), "phase": (0.0, 90.0, 0.0), "period": (0.1, 0.1, 0.1)}, [0.0, 0.0, 0.0]),
        # From 90° to 180° about y through x = −0.4 + 0.5, the edge at x = 0.4 turns by a right angle, from x to −z.
        (axis | {"keyframes": ((0.0, 0.5, 0, 0, 0, 90, 0), (0.1, 0.5, 0, 0, 0, 180, 0))}, [-0.3, 0.0, -0.3]),
    ]
    for keys, moved in moves:
        with Simulation(scene("explicit", Attachment(**keys)), layout) as simulation:
            start = simulation.topology.start.reshape(6, 9, 3)
            simulation.step()
            assert np.abs(simulation.positions().reshape(6, 9, 3)[:, 8] - start[:, 8]).max() < 0.4
            simulation.step(5)  # 0.1 s, a period of the rocking
            assert simulation.positions().reshape(6, 9, 3)[:, 8] - start[:, 8] == pytest.approx(
                np.tile(moved, (6, 1)), abs=1e-5
            )


@pytest.mark.parametrize("layout", ["serial", "simd"])
@pytest.mark.parametrize("solver", ["xpbd", "explicit", "rk4", "implicit"])
def test_attached_and_grabbed_particles_have_the_velocity_of_their_motion(solver: str, layout: str) -> None:
    """Spring damping and drag use it: ω × r plus the velocity of the body, or that of the grab."""
    center, spin, going = np.array([-0.4, 1.0, 0.0]), (0.0, 90.0, 0.0), np.array([0.3, 0.0, 0.6])
    both = Attachment(pins=("right",), center=tuple(center), spin=spin, keyframes=((0.0, 0.0, 0.0, 0.0), (1.0, *going)))
    with Simulation(scene(solver, both), layout) as simulation:
        grab = simulation.grab(20)
        for k in range(1, 4):
            grab.move_to(simulation.topology.start[20] + [0.02 * k, 0.0, 0.0])
            simulation.step()
        seconds = simulation.seconds
        away = simulation.positions().reshape(6, 9, 3)[:, 8] - center - going * seconds
        # Within a frame the center moves straight, and the body rotates about it at a constant rate.
        expected = going + np.cross([0.0, np.radians(90.0), 0.0], away)
        assert simulation.velocities().reshape(6, 9, 3)[:, 8] == pytest.approx(expected, abs=2e-3)
        assert np.linalg.norm(expected - going, axis=1).min() > 1.0
        assert simulation.velocities()[20] == pytest.approx([1.2, 0.0, 0.0], abs=1e-4)  # 2 cm a frame


def test_attached_pins_follow_a_curve_within_the_frame() -> None:
    """On a chord between the ends of the frame they would be up to 2.6 mm beside it."""
    waved = Attachment(pins=("right",), center=(0.0, 1.0, 0.0), oscillation=(0.0, 0.3, 0.0), period=(1.0, 0.4, 1.0))
    with Simulation(scene("explicit", waved)) as simulation:
        start, distances = simulation.topology.start[8], []

        def look(share: float) -> None:
            seconds = simulation.seconds + share / 60
            exact = start + [0.0, 0.3 * sin(2 * np.pi * seconds / 0.4), 0.0]
            distances.append(np.linalg.norm(simulation.positions()[8] - exact))

        for _ in range(3):
            simulation.step_by_substep(look)
        assert len(distances) >= 12
        assert max(distances) < 1e-4


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
def test_an_edge_rotates_with_its_attachment_in_every_layout(layout: str) -> None:
    """A quarter turn about the vertical through the left edge brings the right edge to z = −0.8."""
    turning = Attachment(pins=("left", "right"), center=(-0.4, 1.0, 0.0), spin=(0.0, 90.0, 0.0))
    with Simulation(scene("verlet", turning), layout) as simulation:
        for _ in range(60):
            simulation.step()
        x = simulation.positions().reshape(6, 9, 3)
        assert x[:, 8] == pytest.approx(edges_after(0.0)[0] + [0.0, 0.0, -0.8], abs=1e-5)
        simulation.reset()
        assert simulation.positions() == pytest.approx(simulation.topology.start)


def test_tethers_follow_the_attachments() -> None:
    tethered = Scene(cloth=CLOTH, attachments=(GOING,), tethers=Tethers(1.0), forces=Forces(gravity=0.0))
    with Simulation(tethered) as simulation:
        for _ in range(60):
            simulation.step()
        x = simulation.positions().reshape(6, 9, 3)
        distance = np.linalg.norm(x[:, 0] - x[:, 8], axis=1)
        assert distance.max() <= 0.8 + 1e-5


@pytest.mark.parametrize("layout", ["serial", "simd"])
def test_tethers_follow_an_attachment_within_the_frame(layout: str) -> None:
    """Particles tethered to a corner that rises 20 cm in one frame follow it without a lag of a substep."""
    rising = Attachment(
        pins=("top-left",), center=(0.0, 0.0, 0.0), keyframes=((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 12.0, 0.0))
    )
    loose = Fabric(1e-9, 1e-9, 1e-9, 0.0)
    tethered = replace(
        scene("xpbd", rising), fabric=loose, tethers=Tethers(1.0), solver=Solver("xpbd", 4, 1, damping=0.0)
    )
    with Simulation(tethered, layout) as simulation:
        simulation.step()
        x, start = simulation.positions(), simulation.topology.start
        assert x[0] - start[0] == pytest.approx([0.0, 0.2, 0.0], abs=1e-5)
        assert (np.linalg.norm(x - x[0], axis=1) <= np.linalg.norm(start - start[0], axis=1) + 1e-5).all()


def test_an_attachment_with_an_invalid_particle_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "twist.toml"
    file.write_text('[[attachments]]\npins = ["left", 720]\n', encoding="utf-8")
    with pytest.raises(
        SceneError, match=r"attachments\[0\]\.pins\[1\]: 720 is not a particle: indices run from 0 to 719"
    ):
        load_scene(file)


@pytest.mark.parametrize(("solver", "substeps"), [("xpbd", 200), ("explicit", 200), ("lines", 50), ("rk4", 100)])
def test_spring_damping_uses_the_velocity_of_an_attachment(solver: str, substeps: int) -> None:
    """A mass on a damped spring whose upper end rises at 0.2 m/s: its initial velocity relative to it is −0.2 m/s."""
    speed, tau, seconds = 0.2, 0.02, 0.2
    scene = Scene(
        cloth=Cloth(rows=2, columns=2, width=1.0, height=1.0, pins=(), mass_lumping="uniform"),
        fabric=Fabric(warp=5.0, weft=0.0, shear=0.0, bend_spring=0.0, damping_time=tau),
        solver=Solver(solver, substeps, 1, damping=0.0),
        forces=Forces(gravity=0.0),
        attachments=(Attachment(pins=("top",), keyframes=((0, 0, 0, 0), (10, 0, 10 * speed, 0))),),
    )
    with Simulation(scene) as simulation:
        for _ in range(round(60 * seconds)):
            simulation.step()
        moved = (simulation.positions() - simulation.topology.start)[2:, 1]
    omega = sqrt(5.0 / 0.2)
    zeta = tau * omega / 2
    damped = omega * sqrt(1 - zeta**2)
    exact = speed * (seconds - exp(-zeta * omega * seconds) * sin(damped * seconds) / damped)
    assert moved == pytest.approx([exact, exact], rel=2e-3)
