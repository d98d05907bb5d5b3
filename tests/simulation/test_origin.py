"""The origin that positions in float32 are relative to follows a cloth that travels: it moves no particle."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import taichi_cloth as tc
from taichi_cloth.collision.colliders import collider_table
from taichi_cloth.geometry.topology import FAR, ORIGINS, origin_shift
from taichi_cloth.kernels import step_params as c
from taichi_cloth.scene.collider_schema import Plane, Sphere
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Maps, Scene, SelfCollision, Solver, Wind
from taichi_cloth.simulation import running_cloth
from taichi_cloth.simulation.checkpoint import checkpoint_bytes, read_checkpoint
from taichi_cloth.simulation.simulation import Simulation

SLOPE = Plane(rotation=(0.0, 0.0, -45.0), margin=0.01, friction=0.3)
SHEET = Cloth(rows=6, columns=6, width=0.5, height=0.5, center=(0.0, 0.05, 0.0), rotation=(-90.0, 0.0, -45.0), pins=())
pytestmark = pytest.mark.usefixtures("serial_layout")

FRAMES = 130  # a sheet slides about ten meters


def scene(name: str = "xpbd", **parts: Any) -> Scene:
    fabric = Fabric(warp=100.0, weft=100.0, shear=30.0, bend_spring=1.0)
    return Scene(
        **({"cloth": SHEET, "fabric": fabric, "solver": Solver(name, damping=0.1), "planes": (SLOPE,)} | parts)
    )


def unmoved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running_cloth, "origin_shift", lambda positions: np.zeros(3))


@pytest.mark.parametrize(
    ("corners", "shift"),
    [
        ([(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)], (0.0, 0.0, 0.0)),
        ([(FAR + 0.8, 0.0, 0.0), (FAR + 2.0, 1.0, 0.0)], (FAR + 0.5, 0.0, 0.0)),
        ([(FAR - 0.1, 0.0, 0.0), (FAR + 2.0, 1.0, 0.0)], (0.0, 0.0, 0.0)),  # part of it is near
        ([(-70.0, -3.3, 2.6), (-71.0, -2.6, 3.2)], (-70.0, -2.5, 2.5)),
        ([(-FAR, -FAR, 0.0), (FAR, FAR, 0.0)], (0.0, 0.0, 0.0)),  # it is all around
        ([(np.nan, 9.0, 9.0), (9.0, 9.0, 9.0)], (0.0, 0.0, 0.0)),
        ([(np.inf, 9.0, 9.0), (np.inf, 9.0, 9.0)], (0.0, 0.0, 0.0)),
    ],
)
def test_the_origin_moves_as_far_as_all_particles_are_away(corners: list[Any], shift: tuple[float, ...]) -> None:
    assert origin_shift(np.array(corners, np.float32)).tolist() == list(shift)


@given(
    arrays(np.float32, (4, 3), elements=st.floats(-1e4, 1e4, width=32)),
    arrays(np.float32, 3, elements=st.floats(-1e4, 1e4, width=32)),
)
def test_positions_relative_to_the_new_origin_are_exact_and_smaller(near: Any, away: Any) -> None:
    positions = near + away
    shift = origin_shift(positions)
    after = (positions - shift).astype(np.float32)
    assert (after == positions.astype(np.float64) - shift).all()
    assert (np.abs(after) <= np.abs(positions)).all()
    assert (np.mod(shift, ORIGINS) == 0).all()


def test_a_sheet_slides_far_as_a_block_does() -> None:
    with Simulation(scene()) as simulation:
        before = simulation.positions()
        simulation.step(FRAMES)
        slid = simulation.positions() - before
        assert np.linalg.norm(simulation.origin) > FAR
        assert np.abs(simulation.positions() - simulation.origin).max() < FAR + 1.5
        k, pull, t = 0.1, 9.81 * np.sqrt(0.5) * 0.7, FRAMES / 60  # damping [1/s], acceleration, time
        assert np.linalg.norm(slid.mean(axis=0)) == pytest.approx(pull / k * (t - (1 - np.exp(-k * t)) / k), rel=0.01)


FEATURES: dict[str, dict[str, Any]] = {
    "wind": {"wind": Wind(x=3.0, z=1.0, turbulence=0.5)},
    "ball": {"spheres": (Sphere(center=(6.0, -6.2, 0.0), radius=0.3, continuous=True),)},
    "self-collision": {"self_collision": SelfCollision(penetration_free=True)},
}


@pytest.mark.parametrize("feature", FEATURES)
def test_what_acts_on_the_cloth_does_not_depend_on_the_origin(feature: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With 10 substeps: those of the default are so short that rounding far from the origin changes gravity by 1 %."""
    ends = []
    coarse = {"solver": Solver("xpbd", 10, 4, damping=0.1)}
    for _ in range(2):
        with Simulation(scene(**FEATURES[feature], **coarse)) as simulation:
            simulation.step(112)
            grab = simulation.grab(0)
            simulation.step(5)
            ends.append((simulation.positions(), simulation.origin))
            assert grab.active
        unmoved(monkeypatch)
    (followed, origin), (reference, start) = ends
    assert np.linalg.norm(origin - start) > FAR
    with Simulation(scene(**coarse)) as simulation:
        simulation.step(112)
        simulation.grab(0)
        simulation.step(5)
        effect = 0.02 if feature == "self-collision" else np.abs(simulation.positions() - reference).max()
    assert effect > 0.01
    assert np.abs(followed - reference).max() < 0.1 * effect


def test_images_show_the_cloth_where_it_is() -> None:
    with Simulation(scene()) as simulation:
        simulation.step(FRAMES)
        target = simulation.positions().mean(axis=0)
        look = {"eye": tuple(target + [0.0, 1.5, 1.5]), "target": tuple(target)}
        before = tc.render_image(simulation, (160, 120), **look).pixels.astype(int)
        simulation.set_origin(simulation.topology.origin)
        away = tc.render_image(simulation, (160, 120), **look).pixels.astype(int)
    cloth = np.abs(before - away).sum(axis=2) > 60
    rows, columns = np.nonzero(cloth)
    assert 0.02 < cloth.mean() < 0.6
    assert abs(rows.mean() - 60) < 10  # the camera looks at its middle
    assert abs(columns.mean() - 80) < 10


def test_checkpoints_have_the_origin() -> None:
    with Simulation(scene()) as simulation:
        simulation.step(FRAMES)
        origin, content = simulation.origin, checkpoint_bytes(simulation)
        simulation.step(15)
        end = simulation.positions()
        simulation.reset()
        assert (simulation.origin == simulation.topology.origin).all()
        read_checkpoint(simulation, content)
        assert (simulation.origin == origin).all()
        simulation.step(15)
        assert (simulation.positions() == end).all()


def test_a_checkpoint_of_an_earlier_version_has_the_origin_of_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    unmoved(monkeypatch)
    with Simulation(scene()) as simulation:
        simulation.step(FRAMES)
        x, older = simulation.positions(), io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(checkpoint_bytes(simulation))) as archive, zipfile.ZipFile(older, "w") as copy:
            for name in archive.namelist():
                if name != "origin.npy":
                    copy.writestr(name, archive.read(name))
        monkeypatch.undo()
        simulation.step(40)
        assert (simulation.origin != simulation.topology.origin).any()
        read_checkpoint(simulation, older.getvalue())
        assert (simulation.origin == simulation.topology.origin).all()
        assert (simulation.positions() == x).all()


def test_a_reset_returns_to_the_first_origin() -> None:
    with Simulation(scene()) as simulation:
        simulation.step(30)
        first = simulation.positions()
        simulation.step(FRAMES)
        simulation.reset()
        simulation.step(30)
        assert (simulation.positions() == first).all()


def test_cloth_with_max_distances_keeps_its_origin(tmp_path: Path) -> None:
    """They are distances from start positions, which the fields have relative to the first origin."""
    (tmp_path / "ones.csv").write_text("\n".join(["1"] * SHEET.rows * SHEET.columns))
    maps = Maps(folder=str(tmp_path), max_distance="ones.csv", max_distance_max=30.0)
    with Simulation(scene(maps=maps)) as simulation:
        simulation.step(FRAMES)
        assert simulation.positions()[:, 0].min() > FAR
        assert (simulation.origin == simulation.topology.origin).all()


def test_a_plane_far_away_has_its_center_below_the_cloth() -> None:
    """A point 70 m from the center of a slope is at the same height above it as one at its center, to 0.1 µm."""
    origin = np.array([50.0, -50.0, 3.0])
    row = collider_table([SLOPE], 0.0, 1 / 60, origin=tuple(origin))[0]
    center, axes = row[c.COLLIDER_START : c.COLLIDER_START + 3], row[c.COLLIDER_AXES : c.COLLIDER_AXES + 9]
    assert np.abs(center).max() < 1e-5
    turning = replace(SLOPE, spin=(0.0, 10.0, 0.0))
    (moving,) = collider_table([turning], 0.0, 1 / 60, origin=tuple(origin))
    assert moving[c.COLLIDER_START : c.COLLIDER_START + 3].tolist() == pytest.approx((-origin).tolist())
    up = axes.reshape(3, 3)[:, 1]
    assert up == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0])
