"""Tethers: the pins that limit each particle."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.tethers import MAX_TETHERS, pin_runs, tethers_of
from taichi_cloth.geometry.topology import Topology, build_sheet


def make(rows: int, columns: int, pins: tuple[str | int, ...]) -> Topology:
    return build_sheet(
        rows=rows,
        columns=columns,
        width=0.2 * (columns - 1),
        height=0.1 * (rows - 1),
        center=(1.0, 2.0, 3.0),
        rotation=(-70.0, 20.0, 0.0),
        area_density=0.2,
        pins=pins,
        directions=[True] * 6,
    )


def test_a_pinned_edge_is_one_run_and_tethers_each_column_to_its_own_pin() -> None:
    pins, reach = tethers_of(make(4, 5, ("top",)))
    assert pins.tolist() == [list(range(5)) * 4]
    assert np.allclose(reach.reshape(4, 5), 0.1 * np.arange(4)[:, None], atol=1e-6)


def test_two_corners_are_two_runs_the_nearer_first() -> None:
    pins, reach = tethers_of(make(4, 5, ("top-left", "top-right")))
    assert pins.shape == reach.shape == (2, 20)
    assert pins[:, 11].tolist() == [0, 4]
    assert pins[:, 13].tolist() == [4, 0]
    assert np.allclose(reach[:, 11], [np.hypot(0.2, 0.2), np.hypot(0.6, 0.2)], atol=1e-6)


def test_a_cloth_without_pins_has_no_tethers() -> None:
    pins, reach = tethers_of(make(4, 5, ()))
    assert pins.shape == reach.shape == (0, 20)


def test_a_run_does_not_continue_in_the_next_row() -> None:
    assert [run.tolist() for run in pin_runs(np.array([[0, 0, 1], [1, 0, 0], [1, 1, 0]], bool))] == [[2], [3, 6, 7]]


@given(st.integers(2, 9), st.integers(2, 9), st.sets(st.integers(0, 3), max_size=3), st.sets(st.integers(0, 3)))
def test_tethers_connect_to_the_nearest_pins_of_the_nearest_runs(
    rows: int, columns: int, particles: set[int], edges: set[int]
) -> None:
    names = ("top", "left", "bottom-right", "right")
    topology = make(rows, columns, (*(names[e] for e in edges), *particles))
    pins, reach = tethers_of(topology)
    groups = pin_runs(topology.pinned.reshape(topology.shape))
    assert len(pins) == min(MAX_TETHERS, len(groups))
    distances = np.linalg.norm(topology.start[:, None] - topology.start, axis=2)
    nearest = np.array([distances[:, run].min(axis=1) for run in groups]).reshape(-1, rows * columns)
    assert np.allclose(reach, np.sort(nearest, axis=0)[:MAX_TETHERS], atol=1e-6)
    assert np.allclose(reach, distances[pins, np.arange(rows * columns)])
