"""Fabrics compared: droop, stretch and shear, with closed-form values where they exist."""

from __future__ import annotations

import numpy as np
import pytest

from taichi_cloth.evaluation.validate.exact import cantilever
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.presets import load_preset
from taichi_cloth.simulation.simulation import Simulation

G = 9.81


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory):
    """sheet(fabric, **overrides): the displacement of each particle of a settled sheet, (rows, columns, 3)."""
    path = tmp_path_factory.mktemp("fabric") / "sheet.toml"
    path.write_text("")

    def settled(fabric: str, seconds: int, **overrides: object) -> np.ndarray:
        scene = load_scene(path, preset=fabric, cloth_center=(0.0, 0.0, 0.0), **overrides)
        with Simulation(scene) as simulation:
            for _ in range(60 * seconds):
                simulation.step()
            moved = simulation.positions() - simulation.topology.start
            return moved.reshape(scene.cloth.rows, scene.cloth.columns, 3)

    return settled


@pytest.mark.parametrize(("length", "cells"), [(0.105, 14.5), (0.305, 30.5)])  # silk bends within 1.3 cm
def test_fabrics_droop_by_their_measured_bending_stiffness(sheet, length: float, cells: float) -> None:
    """A horizontal strip of two cells, clamped by its first two columns: the clamp is half a cell before the second."""
    cell, rows = length / cells, 3
    columns = round(cells - 0.5) + 2
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
    assert (np.diff(droop) < 0).all()  # silk most, denim least
    assert (np.diff(reach) > 0.002).all()  # denim reaches farthest from the clamp


def test_hanging_strips_stretch_by_their_stiffness(sheet) -> None:
    """A strip 1 m long pinned at its top grows by σ·g·L²/(2·E). Damping has no effect at rest, and without it the
    substeps are longer, so that rounding errors are smaller."""
    grown = {}
    for name in ("rubber", "cotton", "denim"):
        strip = {"rows": 21, "columns": 3, "width": 0.1, "cloth_height": 1.0, "pins": ["top"]}
        moved = sheet(name, seconds=3, solver="explicit", damping=5.0, damping_time=0.0, **strip)
        grown[name] = -moved[-1, 1, 1]
        fabric = load_preset(name)
        assert grown[name] == pytest.approx(fabric.area_density * G / (2 * fabric.warp), rel=0.03), name
    assert grown["rubber"] > 30 * grown["cotton"]


def test_leather_is_stiffer_than_denim_in_shear(sheet) -> None:
    """A sheet pinned at its left edge shears under its weight, and stays in its plane."""
    sagged = {}
    for name in ("leather", "denim"):
        square = {"rows": 11, "columns": 11, "width": 0.5, "cloth_height": 0.5, "pins": ["left"]}
        moved = sheet(name, seconds=3, solver="explicit", damping=5.0, damping_time=0.0, **square)
        assert np.abs(moved[..., 2]).max() < 1e-6
        sagged[name] = -moved[5, -1, 1]
    assert sagged["denim"] > 30 * sagged["leather"] > 0
