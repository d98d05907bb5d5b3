"""The charts of energy and strain, without a display."""

from __future__ import annotations

import numpy as np
import pytest

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.topology import ClothMetrics
from taichi_cloth.viewer import charts
from taichi_cloth.viewer.charts import CHART_GAP, CHART_SECONDS, CHART_SIZE, CHARTS, MAX_SAMPLES, SEGMENTS, History

ASPECT = 16 / 9
SHEET = build_topology(load_scene("drape15"), "verlet")


def metrics(kinetic: float, height: float, strain: float, finite: bool = True) -> ClothMetrics:
    return ClothMetrics(strain, strain / 4, kinetic, height, 0.0, finite, None)


def filled(samples: int) -> History:
    history = History(SHEET)
    for k in range(samples):
        history.add(k / 60, metrics(k, 100.0 - k, 0.01 * k))
    return history


def test_the_history_keeps_the_last_five_seconds() -> None:
    rows = filled(1000).rows
    assert rows[-1, 0] - rows[0, 0] == pytest.approx(CHART_SECONDS)
    assert len(rows) == 301 <= MAX_SAMPLES
    # Potential energy is relative to its lowest sample.
    assert rows[-1].tolist() == pytest.approx([999 / 60, 999, 0, 999, 999 / 4])


def test_a_time_is_stored_once_and_an_earlier_time_clears_the_history() -> None:
    history = filled(10)
    history.add(9 / 60, metrics(3.0, 3.0, 3.0))
    assert len(history.rows) == 10
    history.add(10 / 60, metrics(np.nan, 3.0, 3.0, finite=False))
    assert len(history.rows) == 10
    history.add(0.0, metrics(3.0, 3.0, 0.03))
    assert history.rows.tolist() == [[0.0, 3.0, 0.0, 3.0, 0.75]]


@pytest.mark.parametrize("samples", [0, 1, 2, 1000])
def test_segments_lie_in_their_chart_or_outside_the_window(samples: int) -> None:
    ends, colors = charts.line_segments(filled(samples), ASPECT)
    assert ends.shape == (2 * SEGMENTS, 2)
    assert colors.shape == (2 * SEGMENTS, 3)
    seen = ends[(ends >= 0).all(axis=1)]
    assert len(seen) == 2 * sum(4 + len(chart) * max(min(samples, 301) - 1, 0) for chart in CHARTS)
    assert (ends[(ends < 0).any(axis=1)] == -1).all()
    inside = np.zeros(len(seen), bool)
    for low, high in charts.chart_boxes(ASPECT):
        inside |= ((seen >= low - 1e-6) & (seen <= high + 1e-6)).all(axis=1)
    assert inside.all()


def test_a_chart_ends_at_the_current_time_and_is_scaled_to_its_maximum() -> None:
    ends, colors = charts.line_segments(filled(301), ASPECT)
    (left, bottom), (right, top) = charts.chart_boxes(ASPECT)[0]
    kinetic = ends[(colors == np.array(CHARTS[0][0].color, np.float32)).all(axis=1)]
    assert kinetic[0] == pytest.approx([left, bottom], abs=1e-6)
    assert kinetic[-1] == pytest.approx([right, top], abs=1e-6)
    assert (right - left) * ASPECT == pytest.approx(CHART_SIZE[0])
    assert (1 - right) * ASPECT == pytest.approx(CHART_GAP)


def test_the_legend_has_the_current_value_and_the_full_scale_of_each_curve() -> None:
    lines = [line for line, _ in charts.legend(filled(3))]
    assert lines == [
        "kinetic energy: 2 J (scale to 2)",
        "potential energy change: 0 J (scale to 2)",
        "max strain: 2 % (scale to 2)",
        "mean strain: 0.5 % (scale to 2)",
    ]
    assert len(charts.legend(History(SHEET))) == 4


def test_a_cloth_at_rest_has_flat_curves() -> None:
    """Rounding errors and creep do not fill the chart; a motion that is visible does."""
    energy = SHEET.mass.sum() * 9.81 * SHEET.longest_side
    history = History(SHEET)
    for k in range(100):
        history.add(k / 60, metrics(1e-8 * energy * (k % 2), 1e-6 * energy * (k % 2), 1e-6 * (k % 2)))
    ends, _ = charts.line_segments(history, ASPECT)
    for low, high in charts.chart_boxes(ASPECT):
        curves = ends[((ends > low + 1e-6) & (ends < high - 1e-6)).all(axis=1)]  # without the frame
        assert (curves[:, 1] - low[1]).max(initial=0.0) < 0.02 * (high - low)[1]
    assert history.limits == pytest.approx([1e-4 * energy, 0.1], rel=1e-3)
    assert charts.legend(history)[0][0].endswith(f" J (scale to {history.limits[0]:.3g})")
    history.add(100 / 60, metrics(0.0, 1e-3 * energy, 0.002))
    assert history.limits == pytest.approx([1e-3 * energy, 0.2])


@pytest.mark.parametrize(
    ("ms", "median"),
    [
        ([250.0] * 3, 0.0),  # not yet a second
        ([250.0] * 4, 250.0),
        ([10.0] * 60, 0.0),  # real time: a second of simulation takes less
        ([3000.0, 10.0, 10.0], 10.0),  # the first frame compiled
        ([3000.0], 0.0),
        ([400.0] * 20 + [30.0] * 40, 30.0),  # only the last second counts
        ([20.0, 30.0] * 40, 30.0),
    ],
)
def test_the_frame_time_is_the_median_over_the_last_second(ms: list[float], median: float) -> None:
    history = History(SHEET)
    history.add(0.0, metrics(0.0, 0.0, 0.0), 1e6)  # frames before the first sample are not known
    for k, time in enumerate(ms):
        history.add((k + 1) / 60, metrics(0.0, 0.0, 0.0), time)
    assert history.frame_ms == pytest.approx(median, abs=10 if median == 30 and 20.0 in ms else 1e-9)
    history.add(0.0, metrics(0.0, 0.0, 0.0))  # a reset
    assert history.frame_ms == 0.0


def test_the_background_covers_the_charts() -> None:
    background = charts.background(ASPECT).reshape(len(CHARTS), 6, 2)
    for corners, box in zip(background, charts.chart_boxes(ASPECT), strict=True):
        assert np.stack([corners.min(axis=0), corners.max(axis=0)]) == pytest.approx(box, abs=1e-6)
