"""Wall time to frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.scene.model import FRAME_SECONDS
from taichi_cloth.view.clock import MOST_FRAMES, SNAP, FrameClock


@given(st.lists(st.floats(0.001, 0.05), min_size=1, max_size=200))
def test_the_cloth_keeps_step_with_the_wall(pictures: list[float]) -> None:
    clock, now, frames = FrameClock(0.0), 0.0, 0
    near_one_frame = 0
    for duration in pictures:
        now += duration
        frames += clock.due(now)
        near_one_frame += abs(duration / FRAME_SECONDS - 1) <= SNAP
    assert abs(frames - now / FRAME_SECONDS) <= 1 + SNAP * near_one_frame + 1e-6


@pytest.mark.parametrize(("rate", "pattern"), [(60, [1, 1, 1, 1]), (120, [0, 1, 0, 1]), (30, [2, 2, 2, 2])])
def test_common_displays_get_an_even_rhythm(rate: float, pattern: list[int]) -> None:
    clock = FrameClock(0.0)
    assert [clock.due((k + 1) / rate + 1e-9) for k in range(4)] == pattern


def test_a_display_of_60_hz_that_wobbles_gets_one_frame_a_picture() -> None:
    random = np.random.default_rng(0)
    times = np.arange(1, 500) / 60 + random.uniform(-0.0007, 0.0007, 499)
    clock = FrameClock(0.0)
    assert {clock.due(float(now)) for now in times} == {1}


def test_a_stall_is_dropped_and_leaves_no_debt() -> None:
    clock = FrameClock(0.0)
    assert clock.due(10.0) == MOST_FRAMES
    assert clock.due(10.0 + FRAME_SECONDS) == 1
    assert clock.elapsed == pytest.approx(FRAME_SECONDS)
