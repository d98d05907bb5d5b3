"""The scale of the view `strain`: its figures, and where it is drawn."""

from typing import Any

import numpy as np
import pytest

from taichi_cloth.view.curves import top
from taichi_cloth.view.fill import FULL_STRAIN
from taichi_cloth.view.legend import BAR_WIDTH, INK, MARGIN, WindowScale, rectangles, stamp
from taichi_cloth.view.lettering import LETTERS, WIDTH, text_rectangles, text_width


def test_letters_are_three_by_five() -> None:
    for rows in LETTERS.values():
        assert [len(row) for row in rows.split()] == [WIDTH] * 5


def test_a_text_is_its_letters_side_by_side() -> None:
    rows = text_rectangles("1 7", 10.0, 20.0)
    one, seven = rows[rows[:, 0] < 13], rows[rows[:, 0] >= 18]
    assert len(one) + len(seven) == len(rows)
    assert one[:, :2].tolist()[0] == [11.0, 20.0]
    assert seven[:3, :2].tolist() == [[18.0, 20.0], [19.0, 20.0], [20.0, 20.0]]
    assert text_width("1 7") == 11


@pytest.mark.parametrize("size", [(180, 320), (540, 960), (40, 30)])
def test_the_bar_goes_from_red_over_pale_to_blue(size: tuple[int, int]) -> None:
    plain = np.full((*size, 3), 200, np.uint8)
    picture = stamp(plain.copy())
    unit = max(1, round(size[0] / 216))
    column = picture[:, -unit * MARGIN - unit * BAR_WIDTH // 2]
    if size[0] < 100:  # smaller than the scale: cut off, and no error
        return
    changed = np.flatnonzero((column != 200).any(axis=1))
    top, middle, bottom = column[changed[0]], column[len(column) // 2], column[changed[-1]]
    assert top[0] > 2 * top[2]
    assert bottom[2] > 2 * bottom[0]
    assert middle.min() > 150
    assert (picture[:, : size[1] // 2] == 200).all()


def test_figures_stand_beside_the_bar() -> None:
    places, colours = rectangles()
    ink = (colours == INK).all(axis=1)
    assert places[ink][:, 0].max() < -MARGIN - BAR_WIDTH
    assert FULL_STRAIN == 0.1  # the figures are whole per cents at half of it
    assert ink.sum() > 60


class Canvas:
    """Takes note of what would be drawn: the lowest and the highest point."""

    def triangles(self, places: Any, per_vertex_color: Any) -> None:
        heights = places.to_numpy()[:, 1]
        self.low, self.high = heights.min(), heights.max()


def test_in_the_window_it_stands_in_the_middle_or_above_the_curves() -> None:
    scale, canvas = WindowScale(), Canvas()
    scale.show(canvas, (1280, 720))
    assert (canvas.low + canvas.high) / 2 == pytest.approx(0.5, abs=1e-3)
    assert canvas.low < top()
    scale.show(canvas, (1280, 720), top())
    assert canvas.low >= top() - 1e-6
    assert canvas.high < 1
