"""Several layers as one cloth."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Scene
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import SceneError, UsageError

ONE = Cloth(rows=3, columns=4, width=0.3, height=0.2, center=(1.0, 2.0, 3.0), rotation=(-90.0, 0.0, 0.0), pins=())
THREE = replace(ONE, layers=3, layer_spacing=0.5, layer_rotation=90.0, pins=("top-left", 13))


def test_layers_are_stacked_and_rotated() -> None:
    one, three = build_topology(Scene(cloth=ONE), "verlet"), build_topology(Scene(cloth=THREE), "verlet")
    assert three.particle_count == 36
    for name in ("spring_count", "triangle_count"):
        assert getattr(three, name) == 3 * getattr(one, name)
    layers = three.start.reshape(3, 12, 3)
    assert layers[0] == pytest.approx(one.start)
    assert layers.mean(axis=1) == pytest.approx(np.array([[1, 2, 3], [1, 2.5, 3], [1, 3, 3]]), abs=1e-6)
    offset = layers[0] - [1.0, 2.0, 3.0]
    quarter = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # about y, the normal of a horizontal sheet
    assert layers[1] - [1.0, 2.5, 3.0] == pytest.approx(offset @ quarter.T, abs=1e-6)
    assert three.mass.sum() == pytest.approx(3 * one.mass.sum())
    assert three.longest_side == one.longest_side == pytest.approx(0.3)


def test_no_spring_link_or_triangle_connects_two_layers() -> None:
    three = build_topology(Scene(cloth=THREE, fabric=Fabric(bending_stiffness=1e-3)), "fabric")
    for corners in (three.ends, three.bending_links.ends, three.triangles, three.edges):
        assert len(corners)
        assert (np.ptp(corners // 12, axis=1) == 0).all()
    for batch in three.batches:  # of one color: no particle twice
        ends = three.ends[batch.first : batch.first + batch.count]
        assert len(np.unique(ends)) == ends.size
    distance = np.linalg.norm(three.flat[:12, None] - three.flat[None, 12:], axis=2)
    assert distance.min() > 0.3


def test_a_corner_pins_every_layer_and_an_index_one() -> None:
    pinned = build_topology(Scene(cloth=THREE), "verlet").pinned
    assert np.flatnonzero(pinned).tolist() == [0, 12, 13, 24]


def test_the_simd_layout_and_tethers_need_a_single_layer() -> None:
    with pytest.raises(UsageError, match=r"layout simd is not supported: cloth\.layers is"):
        Simulation(Scene(cloth=THREE), "simd")
    with pytest.raises(SceneError, match=r"tethers: require a single layer, but cloth\.layers is 2"):
        load_scene("curtain", cloth_layers=2, tethers_slack=1.01)


def test_stacked_layers_move_like_a_single_layer() -> None:
    alone = Scene(cloth=replace(THREE, layers=1, pins=("top-left",)))
    pile = Scene(cloth=replace(THREE, pins=("top-left",)))
    for solver in ("xpbd", "lines"):
        with Simulation(alone, "serial") as one, Simulation(pile, "serial") as three:
            one.switch_solver(solver)
            three.switch_solver(solver)
            for _ in range(10):
                one.step()
                three.step()
            assert three.positions()[:12] == pytest.approx(one.positions(), abs=1e-6)
