"""Several sheets as one cloth."""

import numpy as np
import pytest

from taichi_cloth.errors import WrongUse
from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.errors import SceneError
from taichi_cloth.scene.model import Cloth, Fabric, Scene
from taichi_cloth.simulation import Simulation

ONE = Cloth(rows=3, columns=4, width=0.3, height=0.2, center=(1.0, 2.0, 3.0), rotation=(-90.0, 0.0, 0.0), pins=())
THREE = Cloth(**{**vars(ONE), "sheets": 3, "gap": 0.5, "turn": 90.0, "pins": ("top-left", 13)})


def test_every_sheet_is_the_one_above_the_other_and_turned() -> None:
    one, three = topology_of(Scene(cloth=ONE), "springs"), topology_of(Scene(cloth=THREE), "springs")
    assert three.particle_count == 36
    for name in ("spring_count", "triangle_count"):
        assert getattr(three, name) == 3 * getattr(one, name)
    sheets = three.start.reshape(3, 12, 3)
    assert sheets[0] == pytest.approx(one.start)
    assert sheets.mean(axis=1) == pytest.approx(np.array([[1, 2, 3], [1, 2.5, 3], [1, 3, 3]]), abs=1e-6)
    away = sheets[0] - [1.0, 2.0, 3.0]
    quarter = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # about y: a level sheet's own normal
    assert sheets[1] - [1.0, 2.5, 3.0] == pytest.approx(away @ quarter.T, abs=1e-6)
    assert three.mass.sum() == pytest.approx(3 * one.mass.sum())
    assert three.side == one.side == pytest.approx(0.3)


def test_no_spring_bond_or_triangle_goes_from_one_sheet_to_another() -> None:
    three = topology_of(Scene(cloth=THREE, fabric=Fabric(bending=1e-3)), "fabric")
    for corners in (three.ends, three.bonds.ends, three.triangles, three.edges):
        assert len(corners)
        assert (np.ptp(corners // 12, axis=1) == 0).all()
    for batch in three.batches:  # a colour: no particle twice
        ends = three.ends[batch.first : batch.first + batch.count]
        assert len(np.unique(ends)) == ends.size
    apart = np.linalg.norm(three.flat[:12, None] - three.flat[None, 12:], axis=2)
    assert apart.min() > 0.3


def test_a_corner_is_a_pin_of_every_sheet_and_an_index_of_one() -> None:
    pinned = topology_of(Scene(cloth=THREE), "springs").pinned
    assert np.flatnonzero(pinned).tolist() == [0, 12, 13, 24]


def test_strips_and_tethers_are_for_one_sheet() -> None:
    with pytest.raises(WrongUse, match=r"path lanes is for one even grid, and cloth\.sheets is"):
        Simulation(Scene(cloth=THREE), "lanes")
    with pytest.raises(SceneError, match=r"tethers: are for one sheet, and cloth\.sheets is 2"):
        load_scene("curtain", cloth_sheets=2, tethers_slack=1.01)


def test_a_pile_falls_as_each_sheet_alone() -> None:
    alone = Scene(cloth=Cloth(**{**vars(THREE), "sheets": 1, "pins": ("top-left",)}))
    pile = Scene(cloth=Cloth(**{**vars(THREE), "pins": ("top-left",)}))
    for solver in ("xpbd", "lines"):
        with Simulation(alone, "list") as one, Simulation(pile, "list") as three:
            one.change_solver(solver)
            three.change_solver(solver)
            for _ in range(10):
                one.advance_frame()
                three.advance_frame()
            assert three.positions()[:12] == pytest.approx(one.positions(), abs=1e-6)
