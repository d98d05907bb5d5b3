"""Bending links: energies of bent sheets compared with closed forms."""

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry import grid
from taichi_cloth.geometry.bending import grid_bending_links

B = 3e-5  # [N·m]


def energy(
    rows: int, columns: int, width: float, height: float, positions: np.ndarray, *, halved: bool = True
) -> float:
    """Return the bending energy [J] of a sheet at these positions, (rows·columns, 3)."""
    found = grid_bending_links(rows, columns, width, height, B, halved=halved)
    gap = positions[found.ends[:, 0]] - positions[found.ends[:, 1]]
    return float((found.stiffness * (gap * gap).sum(axis=1)).sum() / 2)


def flat(rows: int, columns: int, width: float, height: float) -> np.ndarray:
    return grid.flat_positions(rows, columns, width, height)


sizes = st.integers(3, 12)
lengths = st.floats(0.1, 2.0)


@given(sizes, sizes, lengths, lengths, st.floats(0, 2 * pi), st.floats(0.5, 2.0))
def test_a_flat_sheet_has_no_bending_energy(
    rows: int, columns: int, width: float, height: float, angle: float, stretch: float
) -> None:
    x = flat(rows, columns, width, height) * [stretch, 1.0, 1.0]
    rotated = x @ np.array([[cos(angle), 0, sin(angle)], [0, 1, 0], [-sin(angle), 0, cos(angle)]]).T + [3.0, -1.0, 2.0]
    scale = B * (1 + (columns / width) ** 2 + (rows / height) ** 2) ** 2
    assert energy(rows, columns, width, height, rotated) == pytest.approx(0, abs=1e-10 * scale)


# w = ½·(p·x² + q·y²) + t·x·y has the second derivatives p, q and t everywhere, so the sums are exact. A stencil has
# three particles in a line, so the stencils cover width − a along rows and height − b along columns.
@given(sizes, sizes, lengths, lengths, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_energy_of_bent_twisted_and_saddle_shaped_sheets(
    rows: int, columns: int, width: float, height: float, p: float, q: float, t: float
) -> None:
    x = flat(rows, columns, width, height)
    x[:, 2] = (p * x[:, 0] ** 2 + q * x[:, 1] ** 2) / 2 + t * x[:, 0] * x[:, 1]
    a, b = width / (columns - 1), height / (rows - 1)
    expected = B / 2 * (p**2 * (width - a) * height + q**2 * width * (height - b) + 2 * t**2 * width * height)
    assert energy(rows, columns, width, height, x) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_warp_and_weft_bend_with_their_own_stiffness() -> None:
    """Along columns B₁, along rows B₂, and twisted √(B₁·B₂)."""
    x, factor = flat(6, 9, 0.8, 0.5), np.sqrt(3.0)
    for z, expected in (
        (x[:, 1] ** 2 / 2, B / 2 * 0.8 * 0.4),
        (x[:, 0] ** 2 / 2, 3 * B / 2 * 0.7 * 0.5),
        (x[:, 0] * x[:, 1], factor * B * 0.8 * 0.5),
    ):
        found = grid_bending_links(6, 9, 0.8, 0.5, (B, 3 * B), halved=True)
        gap = np.subtract(z[found.ends[:, 0]], z[found.ends[:, 1]])
        assert (found.stiffness * gap**2).sum() / 2 == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("degrees", [0, 45, 90])
def test_a_roll_has_the_energy_of_a_plate_in_every_direction(degrees: float) -> None:
    """The energy is ½·B·κ²·area, up to the two threads at each edge and 1 − sin² of the angle between cells."""
    n, radius = 80, 0.5
    x = flat(n + 1, n + 1, 1.0, 1.0)
    along = np.array([cos(np.radians(degrees)), sin(np.radians(degrees)), 0])
    s = x @ along
    around, up = radius * np.sin(s / radius), radius * (1 - np.cos(s / radius))
    rolled = x + (around - s)[:, None] * along + up[:, None] * [0, 0, 1]
    assert energy(n + 1, n + 1, 1.0, 1.0, rolled) == pytest.approx(B / (2 * radius**2), rel=0.02)


def test_the_stiffness_matrix_is_positive_semidefinite() -> None:
    found = grid_bending_links(5, 7, 0.6, 0.3, B, halved=True)
    matrix = np.zeros((35, 35))
    for (i, j), c in zip(found.ends, found.stiffness, strict=True):
        matrix[[i, j], [i, j]] += c
        matrix[[i, j], [j, i]] -= c
    values = np.linalg.eigvalsh(matrix)
    assert values[0] > -1e-12 * values[-1]
    assert (np.abs(values) < 1e-9 * values[-1]).sum() == 3  # constants, x and y: the planes


def test_directions_are_those_of_the_grid() -> None:
    found = grid_bending_links(4, 5, 1.0, 1.0, B, halved=False)
    row, column = np.unravel_index(found.ends, (4, 5))
    steps = np.stack([row[:, 1] - row[:, 0], column[:, 1] - column[:, 0]], axis=-1)
    assert (steps == np.array([d[1:] for d in grid.DIRECTIONS])[found.direction]).all()


def test_uniform_lumping_has_full_stiffness_at_edges() -> None:
    x = flat(5, 5, 1.0, 1.0)
    x[:, 2] = x[:, 0] ** 2 / 2
    assert energy(5, 5, 1.0, 1.0, x, halved=False) == pytest.approx(B / 2 * 0.75 * 1.25)


def test_zero_stiffness_gives_no_links() -> None:
    assert len(grid_bending_links(5, 5, 1.0, 1.0, 0.0, halved=True).ends) == 0


def test_a_sheet_of_two_rows_bends_along_rows_and_twists() -> None:
    found = grid_bending_links(2, 6, 1.0, 0.2, B, halved=True)
    assert set(found.direction) == {0, 1, 2, 3, 4}
