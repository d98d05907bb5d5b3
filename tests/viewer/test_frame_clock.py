"""The number of frames due for the wall time that has passed, and when memory is reported."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.scene.schema import FRAME_SECONDS
from taichi_cloth.simulation.frame_clock import INTERVAL_TOLERANCE, MAX_FRAMES, FrameClock
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.viewer.window import MemoryWatch


@given(st.lists(st.floats(0.001, 0.05), min_size=1, max_size=200))
def test_the_number_of_frames_follows_wall_time(durations: list[float]) -> None:
    clock, now, frames = FrameClock(0.0), 0.0, 0
    near_one_frame = 0
    for duration in durations:
        now += duration
        frames += clock.due(now)
        near_one_frame += abs(duration / FRAME_SECONDS - 1) <= INTERVAL_TOLERANCE
    assert abs(frames - now / FRAME_SECONDS) <= 1 + INTERVAL_TOLERANCE * near_one_frame + 1e-6


@pytest.mark.parametrize(("rate", "pattern"), [(60, [1, 1, 1, 1]), (120, [0, 1, 0, 1]), (30, [2, 2, 2, 2])])
def test_common_refresh_rates_get_an_even_pattern_of_frames(rate: float, pattern: list[int]) -> None:
    clock = FrameClock(0.0)
    assert [clock.due((k + 1) / rate + 1e-9) for k in range(4)] == pattern


@pytest.mark.parametrize(("speed", "pattern"), [(0.5, [0, 1, 0, 1]), (0.25, [0, 0, 0, 1])])
def test_slow_motion_gets_an_even_pattern_of_frames(speed: float, pattern: list[int]) -> None:
    clock = FrameClock(0.0)
    assert [clock.due((k + 1) / 60 + 1e-9, speed) for k in range(8)] == 2 * pattern


def test_a_60_hz_display_with_jitter_gets_one_frame_per_displayed_frame() -> None:
    random = np.random.default_rng(0)
    times = np.arange(1, 500) / 60 + random.uniform(-0.0007, 0.0007, 499)
    clock = FrameClock(0.0)
    assert {clock.due(float(now)) for now in times} == {1}


def test_frames_missed_in_a_stall_are_dropped() -> None:
    clock = FrameClock(0.0)
    assert clock.due(10.0) == MAX_FRAMES
    assert clock.due(10.0 + FRAME_SECONDS) == 1
    assert clock.elapsed == pytest.approx(FRAME_SECONDS)


def test_the_window_warns_once_for_every_gigabyte_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    used = [10**9]
    monkeypatch.setattr(runtime, "peak_bytes", lambda: used[0])
    watch = MemoryWatch()
    assert watch.warning() == ""
    used[0] = 2 * 10**9
    assert watch.warning().startswith("memory has grown to 2.0 GB. ")
    assert watch.warning() == ""
    used[0] = 3 * 10**9
    assert watch.warning().startswith("memory has grown to 3.0 GB. ")
