"""Adjacency: the rows that contain each particle."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.topology import adjacency


@given(st.integers(1, 12), st.integers(2, 3), st.integers(0, 30), st.integers(0, 2**31))
def test_every_row_is_listed_at_each_of_its_particles(count: int, width: int, rows: int, seed: int) -> None:
    corners = np.random.default_rng(seed).integers(0, count, (rows, width)).astype(np.int32)
    first, found = adjacency(corners, count)
    assert len(first) == count + 1
    for particle in range(count):
        expected = [row for row in range(rows) for corner in corners[row] if corner == particle]
        assert found[first[particle] : first[particle + 1]].tolist() == expected
