"""Strain and energy, compared with numbers computed by hand. Without Taichi."""

import numpy as np
import pytest

from taichi_cloth.geometry.topology import build_sheet, energies, spring_strains

STRIP = build_sheet(
    rows=2,
    columns=2,
    width=2.0,
    height=0.5,
    center=(0.0, 0.0, 0.0),
    rotation=(0.0, 0.0, 0.0),
    area_density=3.0,
    pins=("top-left",),
    directions=(True, True, False, False, False, False),
)


def test_strain_is_length_over_rest_length_minus_one() -> None:
    assert np.abs(spring_strains(STRIP, STRIP.start)).max() == 0
    assert spring_strains(STRIP, STRIP.start * [1.1, 1.0, 1.0]).tolist() == pytest.approx([0.1, 0.1, 0, 0])
    assert spring_strains(STRIP, STRIP.start * 0.5).tolist() == pytest.approx([-0.5] * 4)


def test_energies_of_a_moving_sheet() -> None:
    # 3 kg in total; the alternating diagonals give the top left corner 1 kg, and it is pinned: 2 kg move at 2 m/s.
    assert STRIP.mass.tolist() == pytest.approx([1.0, 0.5, 0.5, 1.0])
    velocity = np.tile([0.0, 2.0, 0.0], (4, 1))
    kinetic, potential = energies(STRIP, STRIP.start + [0, 10, 0], velocity, 9.81)
    assert kinetic == pytest.approx(0.5 * 2.0 * 4.0)
    assert potential == pytest.approx(3.0 * 9.81 * 10.0)
