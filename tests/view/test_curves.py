"""The curves of energy and strain, without a display."""

from __future__ import annotations

import numpy as np
import pytest

from taichi_cloth.measure.cloth import Measures
from taichi_cloth.view import curves
from taichi_cloth.view.curves import BOX, CHARTS, GAP, MOST, SEGMENTS, SPAN, History

ASPECT = 16 / 9


def measures(kinetic: float, height: float, strain: float, finite: bool = True) -> Measures:
    return Measures(strain, strain / 4, kinetic, height, 0.0, finite, None)


def filled(samples: int) -> History:
    history = History()
    for k in range(samples):
        history.add(k / 60, measures(k, 100.0 - k, 0.01 * k))
    return history


def test_the_last_five_seconds_are_kept() -> None:
    rows = filled(1000).rows
    assert rows[-1, 0] - rows[0, 0] == pytest.approx(SPAN)
    assert len(rows) == 301 <= MOST
    assert rows[-1].tolist() == pytest.approx([999 / 60, 999, 0, 999, 999 / 4])  # height from the lowest in sight


def test_one_moment_is_kept_once_and_a_reset_begins_anew() -> None:
    history = filled(10)
    history.add(9 / 60, measures(3.0, 3.0, 3.0))
    assert len(history.rows) == 10
    history.add(10 / 60, measures(np.nan, 3.0, 3.0, finite=False))
    assert len(history.rows) == 10
    history.add(0.0, measures(3.0, 3.0, 0.03))
    assert history.rows.tolist() == [[0.0, 3.0, 0.0, 3.0, 0.75]]


@pytest.mark.parametrize("samples", [0, 1, 2, 1000])
def test_everything_lies_in_its_box_or_outside_of_the_picture(samples: int) -> None:
    ends, colours = curves.lines(filled(samples).rows, ASPECT)
    assert ends.shape == (2 * SEGMENTS, 2)
    assert colours.shape == (2 * SEGMENTS, 3)
    seen = ends[(ends >= 0).all(axis=1)]
    assert len(seen) == 2 * sum(4 + len(chart) * max(min(samples, 301) - 1, 0) for chart in CHARTS)
    assert (ends[(ends < 0).any(axis=1)] == -1).all()
    inside = np.zeros(len(seen), bool)
    for low, high in curves.boxes(ASPECT):
        inside |= ((seen >= low - 1e-6) & (seen <= high + 1e-6)).all(axis=1)
    assert inside.all()


def test_a_chart_ends_now_and_is_as_high_as_its_largest_number() -> None:
    rows = filled(301).rows
    ends, colours = curves.lines(rows, ASPECT)
    (left, bottom), (right, top) = curves.boxes(ASPECT)[0]
    kinetic = ends[(colours == np.float32(CHARTS[0][0].colour)).all(axis=1)]
    assert kinetic[0] == pytest.approx([left, bottom], abs=1e-6)
    assert kinetic[-1] == pytest.approx([right, top], abs=1e-6)
    assert (right - left) * ASPECT == pytest.approx(BOX[0])
    assert (1 - right) * ASPECT == pytest.approx(GAP)


def test_the_legend_tells_every_curve_now_and_how_high_its_chart_is() -> None:
    lines = [line for line, _ in curves.legend(filled(3).rows)]
    assert lines == [
        "kinetic energy: 2 of 2 J",
        "energy of height: 0 of 2 J",
        "largest strain: 2 of 2 %",
        "mean strain: 0.5 of 2 %",
    ]
    assert len(curves.legend(History().rows)) == 4


def test_the_paper_lies_under_the_charts() -> None:
    paper = curves.paper(ASPECT).reshape(len(CHARTS), 6, 2)
    for corners, box in zip(paper, curves.boxes(ASPECT), strict=True):
        assert np.stack([corners.min(axis=0), corners.max(axis=0)]) == pytest.approx(box, abs=1e-6)
