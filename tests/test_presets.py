"""Fabrics side by side: which droops, which stretches, which shears, and by how much where a closed form says so."""

from __future__ import annotations

import numpy as np
import pytest

from taichi_cloth.scene import load_scene
from taichi_cloth.scene.presets import load_preset
from taichi_cloth.simulation import Simulation
from taichi_cloth.validate.exact import cantilever

G = 9.81


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory):
    """sheet(fabric, **overrides): how far each particle of a settled sheet has moved, (rows, columns, 3)."""
    path = tmp_path_factory.mktemp("fabric") / "sheet.toml"
    path.write_text("")

    def settled(fabric: str, seconds: int, **overrides: object) -> np.ndarray:
        scene = load_scene(path, preset=fabric, cloth_center=(0.0, 0.0, 0.0), **overrides)
        with Simulation(scene) as simulation:
            for _ in range(60 * seconds):
                simulation.advance_frame()
            moved = simulation.positions() - simulation.topology.start
            return moved.reshape(scene.cloth.rows, scene.cloth.columns, 3)

    return settled


@pytest.mark.parametrize("length", [0.105, 0.305])
def test_fabrics_droop_by_their_measured_bending_stiffness(sheet, length: float) -> None:
    """A strip 2 cm wide, level, clamped by its first two columns: half a link of those is behind the clamp."""
    cell, rows = 0.01, 3
    columns = round(length / cell - 0.5) + 2
    clamp = [row * columns + column for row in range(rows) for column in (0, 1)]
    found, exact = [], []
    for name in ("silk", "cotton", "denim"):
        moved = sheet(
            name,
            seconds=4,
            rows=rows,
            columns=columns,
            width=(columns - 1) * cell,
            cloth_height=(rows - 1) * cell,
            cloth_rotation=(-90.0, 0.0, 0.0),
            pins=clamp,
            solver="xpbd",
            substeps=20,
            iterations=30,
            damping=3.0,
        )[1, -1]
        fabric = load_preset(name)
        found.append((-moved[1] / length, 1 + moved[0] / length))
        exact.append(cantilever(fabric.area_density * G * length**3 / fabric.bending))
    droop, reach = np.transpose(found)
    assert found == pytest.approx(np.array(exact), rel=0.02, abs=0.01)
    assert (np.diff(droop) < 0).all()  # silk most, denim least …
    assert (np.diff(reach) > 0.002).all()  # … which stands out farthest from the clamp


def test_rubber_stretches_more_than_cotton_and_both_as_a_strip_of_their_stiffness_does(sheet) -> None:
    """A strip 1 m long hung by its top grows by σ·g·L²/(2·E). Dashpots do not count at rest, and without them the
    substeps are longer, of which rounding takes less."""
    grown = {}
    for name in ("rubber", "cotton", "denim"):
        strip = {"rows": 21, "columns": 3, "width": 0.1, "cloth_height": 1.0, "pins": ["top"]}
        moved = sheet(name, seconds=3, solver="spring", damping=5.0, damping_time=0.0, **strip)
        grown[name] = -moved[-1, 1, 1]
        fabric = load_preset(name)
        assert grown[name] == pytest.approx(fabric.area_density * G / (2 * fabric.warp), rel=0.03), name
    assert grown["rubber"] > 30 * grown["cotton"]


def test_leather_is_stiffer_than_denim_in_bias(sheet) -> None:
    """A sheet hung by its left edge shears under its own weight; it stays in its plane, for nothing pushes it out."""
    sagged = {}
    for name in ("leather", "denim"):
        square = {"rows": 11, "columns": 11, "width": 0.5, "cloth_height": 0.5, "pins": ["left"]}
        moved = sheet(name, seconds=3, solver="spring", damping=5.0, damping_time=0.0, **square)
        assert np.abs(moved[..., 2]).max() < 1e-6
        sagged[name] = -moved[5, -1, 1]
    assert sagged["denim"] > 30 * sagged["leather"] > 0
