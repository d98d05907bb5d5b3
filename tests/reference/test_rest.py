"""Strain of a cloth at rest, compared with closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.evaluation.reference import rest_strain
from taichi_cloth.evaluation.reference.static_solution import BlockSystem, rest_positions
from taichi_cloth.geometry.spring_model import spring_model
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import Cloth, Forces, Maps, Scene

WARP_ONLY = Fabric(warp=200.0, weft=0.0, shear=0.0, bend_spring=0.0)
STRIP = Scene(cloth=Cloth(rows=9, columns=3, width=0.25, height=1.0, pins=("top",)), fabric=WARP_ONLY)
LOWERED = replace(STRIP, fabric=Fabric(warp=200.0, weft=200.0, shear=100.0, bend_spring=1.0))


def test_the_top_spring_of_a_hanging_strip_carries_the_weight_below_it() -> None:
    """Without weft every column is a chain; those along the edges have half the constant."""
    below = spring_model(STRIP).mass.reshape(9, 3)[1:].sum(axis=0)
    strain = float((below / [100.0, 200.0, 100.0]).max()) * 9.81 / (1 / 8)
    assert below.sum() == pytest.approx(0.2 * 0.25 * (1 - 1 / 16), rel=0.01)
    assert rest_strain(STRIP) == pytest.approx(strain, rel=0.01)
    assert rest_strain(replace(STRIP, forces=Forces(gravity=2 * 9.81))) == pytest.approx(2 * strain, rel=0.01)


def test_the_strain_does_not_depend_on_the_start() -> None:
    level = replace(LOWERED, cloth=replace(LOWERED.cloth, rotation=(-80.0, 0.0, 0.0)))
    assert rest_strain(level) == pytest.approx(rest_strain(LOWERED), rel=0.02)


def test_the_strain_of_very_stiff_cloth_is_inversely_proportional_to_stiffness() -> None:
    stiff, stiffer = (replace(STRIP, fabric=replace(WARP_ONLY, warp=k)) for k in (2e5, 2e8))
    assert rest_strain(stiffer) == pytest.approx(rest_strain(stiff) / 1000, rel=5e-3)


def test_stiff_springs_beside_soft_ones_change_only_their_own_strain(tmp_path: Path) -> None:
    """Without weft every column is a chain: the soft springs below carry the same weight as without stiff ones."""
    factor = np.repeat([1000.0, 1.0], [4 * 3, 5 * 3])  # rows 0 to 3, and 4 to 8
    (tmp_path / "map.csv").write_text("\n".join(map(str, factor / 1000)), encoding="utf-8")
    maps = Maps(stiffness="map.csv", stiffness_max=1000.0, folder=str(tmp_path))
    mass = spring_model(STRIP).mass.reshape(9, 3)
    constant = np.array([100.0, 200.0, 100.0]) * np.array([1000.0] * 3 + [500.5] + [1.0] * 4)[:, None]
    below = mass[::-1].cumsum(axis=0)[::-1][1:]
    strain = below / constant * 9.81 / (1 / 8)
    assert strain.argmax() // 3 == 4
    assert rest_strain(replace(STRIP, maps=maps)) == pytest.approx(float(strain.max()), rel=0.01)
    for_all = replace(maps, stiffness_min=1000.0)
    assert rest_strain(replace(STRIP, maps=for_all)) == pytest.approx(rest_strain(STRIP) / 1000, rel=0.02)


def test_cloth_without_pins_or_gravity_has_no_strain() -> None:
    assert rest_strain(replace(STRIP, cloth=replace(STRIP.cloth, pins=()))) == 0
    assert rest_strain(replace(STRIP, forces=Forces(gravity=0.0))) == 0


def test_forces_on_the_pins_carry_the_weight() -> None:
    model = spring_model(LOWERED)
    total = model.elastic_force(rest_positions(model))[:, model.topology.pinned].sum(axis=1)
    assert total == pytest.approx([0, -(model.mass * model.free).sum() * 9.81, 0], abs=0.01)


@pytest.mark.parametrize("compression", [1.0, 0.3])
def test_force_is_the_gradient_of_energy_and_stiffness_that_of_force(compression: float) -> None:
    fabric = Fabric(
        warp=200.0, weft=150.0, shear=100.0, bend_spring=9.0, bending_stiffness=1e-2, compression=compression
    )
    model = spring_model(replace(STRIP, fabric=fabric))
    random = np.random.default_rng(2)
    x = model.start + 0.02 * random.standard_normal(model.start.shape)
    u, tiny = random.standard_normal(x.shape), 1e-6
    work = (model.energy(x + tiny * u) - model.energy(x - tiny * u)) / (2 * tiny)
    assert -((model.elastic_force(x) + model.weight()) * u).sum() == pytest.approx(work, rel=1e-5)
    change = (model.elastic_force(x + tiny * u) - model.elastic_force(x - tiny * u)) / (2 * tiny)
    blocks = model.stiffness_blocks(x)
    across = np.einsum("eij,je->ie", blocks, u[:, model.ends[1]] - u[:, model.ends[0]])
    assert np.abs(model.scatter(across) - change).max() < 1e-5 * np.abs(change).max()


def test_the_block_solver_solves_its_system() -> None:
    model = spring_model(LOWERED)
    x = model.start * 1.1
    blocks, inertia = model.stiffness_blocks(x, definite=True), model.mass / 1e-4
    right = np.random.default_rng(3).standard_normal(x.shape) * model.free
    u = BlockSystem(model).solve(inertia, blocks, right)
    across = np.einsum("eij,je->ie", blocks, u[:, model.ends[1]] - u[:, model.ends[0]])
    left = (inertia * u - model.scatter(across)) * model.free
    assert np.abs(left - right).max() < 1e-9
    assert not u[:, model.topology.pinned].any()
