"""The color scales of the views `strain` and `error`: labels and position."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth.render.colors import (
    BAR_HEIGHT,
    BAR_WIDTH,
    GLYPH_HEIGHT,
    GLYPHS,
    MARGIN,
    MAX_RECTANGLES,
    STRAIN_SCALE,
    TEXT_COLOR,
    Scale,
    WindowLegend,
    distance_scale,
    draw_legend,
    draw_legend_below,
    legend_rectangles,
    rounded_up,
    text_rectangles,
    text_width,
    unit_pixels,
)
from taichi_cloth.render.draw_list import DrawList
from taichi_cloth.render.shading import FULL_STRAIN
from taichi_cloth.render.split_view import SplitRenderer, camera_for_both
from taichi_cloth.viewer.charts import top


def test_glyphs_have_five_rows_of_one_width() -> None:
    for letter, rows in GLYPHS.items():
        assert [len(row) for row in rows.split()] == [{"m": 5, "%": 5, ".": 1}.get(letter, 3)] * 5


@pytest.mark.parametrize("height", [180, 480, 540, 720, 1080])
def test_all_pixels_of_glyphs_have_one_size_in_images_and_in_the_window(height: int) -> None:
    side = unit_pixels(height)
    image = draw_legend(np.full((height, 320, 3), 200, np.uint8), distance_scale(0.005, "frame 61"))
    ink = (image == np.rint(255 * np.array(TEXT_COLOR))).all(axis=2)
    rows = np.flatnonzero(ink.any(axis=1))
    caption = ink[rows[0] : rows[0] + GLYPH_HEIGHT * side]
    columns = np.flatnonzero(caption.any(axis=0))
    caption = caption[:, columns[0] : columns[0] + text_width("frame 61") * side]
    assert (np.kron(caption[::side, ::side], np.ones((side, side), bool)) == caption).all()
    legend, canvas = WindowLegend(), Canvas()
    legend.show(canvas, distance_scale(0.005, "frame 61"), (1280, height))
    triangles = legend._position.to_numpy().reshape(-1, 6, 2) * (1280, height)
    assert triangles == pytest.approx(np.rint(triangles), abs=1e-3), "an edge is between two pixels"


def test_text_is_drawn_as_glyphs_side_by_side() -> None:
    rows = text_rectangles("1 7", 10.0, 20.0)
    one, seven = rows[rows[:, 0] < 13], rows[rows[:, 0] >= 18]
    assert len(one) + len(seven) == len(rows)
    assert one[:, :2].tolist()[0] == [11.0, 20.0]
    assert seven[:3, :2].tolist() == [[18.0, 20.0], [19.0, 20.0], [20.0, 20.0]]
    assert text_width("1 7") == 11


def test_wide_glyphs_move_those_after_them() -> None:
    rows = text_rectangles("m7", 10.0, 20.0)
    assert rows[rows[:, 0] >= 15][:3, :2].tolist() == [[16.0, 20.0], [17.0, 20.0], [18.0, 20.0]]
    assert text_width("m7") == 9


@pytest.mark.parametrize("size", [(180, 320), (540, 960), (40, 30)])
def test_the_bar_runs_from_red_through_pale_to_blue(size: tuple[int, int]) -> None:
    plain = np.full((*size, 3), 200, np.uint8)
    image = draw_legend(plain.copy(), STRAIN_SCALE)
    unit = max(1, round(size[0] / 216))
    column = image[:, -unit * MARGIN - unit * BAR_WIDTH // 2]
    if size[0] < 100:  # smaller than the legend, which is cut off without an error
        return
    changed = np.flatnonzero((column != 200).any(axis=1))
    upper, middle, lower = column[changed[0]], column[len(column) // 2], column[changed[-1]]
    assert upper[0] > 2 * upper[2]
    assert lower[2] > 2 * lower[0]
    assert middle.min() > 150
    assert (image[:, : size[1] // 2] == 200).all()


def test_labels_are_beside_the_bar() -> None:
    rectangles, colors = legend_rectangles(STRAIN_SCALE)
    ink = (colors == TEXT_COLOR).all(axis=1)
    assert rectangles[ink][:, 0].max() < -MARGIN - BAR_WIDTH
    assert FULL_STRAIN == 0.1  # half of it is a whole number of percent
    assert ink.sum() > 60


class Canvas:
    """Stores the lowest and the highest point that would be drawn."""

    def triangles(self, position: Any, per_vertex_color: Any) -> None:
        heights = position.to_numpy()[:, 1]
        self.low, self.high = heights.min(), heights.max()


def test_the_window_legend_is_centered_or_above_the_charts() -> None:
    legend, canvas = WindowLegend(), Canvas()
    legend.show(canvas, STRAIN_SCALE, (1280, 720))
    assert (canvas.low + canvas.high) / 2 == pytest.approx(0.5, abs=1e-3)
    assert canvas.low < top()
    legend.show(canvas, STRAIN_SCALE, (1280, 720), top())
    assert canvas.low >= top() - 1e-6
    assert canvas.high < 1


@pytest.mark.parametrize(
    ("largest", "texts"),
    [(0.005, ["0", "2.5mm", "5mm"]), (1e-3, ["0", "0.5mm", "1mm"]), (2e-5, ["0", "10um", "20um"])],
)
def test_a_scale_of_distances_starts_at_zero(largest: float, texts: list[str]) -> None:
    scale = distance_scale(largest)
    assert list(scale.labels.values()) == texts
    rectangles, colors = legend_rectangles(scale)
    assert colors[0] == pytest.approx(legend_rectangles(STRAIN_SCALE)[1][0])  # red on top
    assert colors[39].min() > 0.85  # pale at the bottom
    assert len(rectangles) < MAX_RECTANGLES


@pytest.mark.parametrize(
    ("value", "rounded"), [(0.3, 0.3), (1.0, 1.0), (1.01, 1.5), (0.0021, 0.003), (3.1e-6, 5e-6), (7.1e-6, 1e-5)]
)
def test_full_scales_are_round_numbers(value: float, rounded: float) -> None:
    assert rounded_up(value) == pytest.approx(rounded)


def test_the_window_legend_changes_with_the_scale() -> None:
    legend, canvas = WindowLegend(), Canvas()
    legend.show(canvas, STRAIN_SCALE, (1280, 720))
    strain = legend._color.to_numpy()
    legend.show(canvas, distance_scale(0.002), (1280, 720))
    assert not np.array_equal(legend._color.to_numpy(), strain)
    assert len(legend_rectangles(STRAIN_SCALE)[0]) < MAX_RECTANGLES
    assert (legend._color.to_numpy()[:6] == 1).all(), "no white background"


def test_the_caption_is_above_the_bar() -> None:
    plain, captioned = (legend_rectangles(distance_scale(0.002, text))[0] for text in ("", "frame 61"))
    added = captioned[len(plain) :]
    assert np.array_equal(captioned[: len(plain)], plain)
    assert len(added) == len(text_rectangles("frame 61", 0.0, 0.0)) > 40
    assert (added[:, 1] + added[:, 3]).max() < plain[:, 1].min()
    assert (added[:, 0] + added[:, 2]).max() <= -MARGIN
    assert len(captioned) < MAX_RECTANGLES


@pytest.mark.parametrize("scale", [STRAIN_SCALE, distance_scale(0.05, "frame 2713   frame 157")])
def test_a_scale_of_two_images_lies_at_their_lower_edge(scale: Scale) -> None:
    """It covers as much of both, and less than a seventh of the height."""
    size = (216, 400)
    image = draw_legend_below(np.full((*size, 3), 200, np.uint8), scale)
    columns = np.flatnonzero((image != 200).any(axis=(0, 2)))
    assert abs((columns[0] + columns[-1] + 1) / 2 - 200) <= 4  # the labels at both ends may have other widths
    assert columns[-1] - columns[0] < 120
    rows = np.flatnonzero((image != 200).any(axis=(1, 2)))
    assert rows[0] > 216 * 6 // 7
    assert rows[-1] < 215
    bar = image[-MARGIN - GLYPH_HEIGHT - 3, 200 - BAR_HEIGHT // 2 : 200 + BAR_HEIGHT // 2].astype(int)
    assert bar[-1, 0] - bar[-1, 2] > 100, "the largest value is red, at the right"
    background = image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    assert not (background == 200).all(axis=2).any(), "the image is seen through the background"
    border = [background[0], background[-1], background[:, 0], background[:, -1]]
    assert all((line == 255).all() for line in border)


def test_two_halves_have_one_scale_of_their_largest_error_below_them() -> None:
    scene = tc.load_scene("drape15")
    with (
        tc.Simulation(scene) as a,
        tc.Simulation(scene) as b,
        closing(DrawList(a)) as left,
        closing(DrawList(b)) as right,
    ):
        left.errors, right.errors = np.full(225, 0.8e-3), np.full(225, 0.004)
        renderer = SplitRenderer(402, 216, samples=1)
        camera = camera_for_both(scene, renderer.aspect)
        image = renderer.draw((left, right), "error", camera)
        assert left.scale("error") == right.scale("error") == distance_scale(0.005)
    seam = draw_legend_below(image.copy(), distance_scale(0.005))
    assert (seam == image).all()


def test_a_cloth_whose_error_is_not_known_is_gray_beside_one_without_error() -> None:
    scene = tc.load_scene("drape15")
    with tc.Simulation(scene) as simulation, closing(DrawList(simulation)) as drawn:
        mesh = drawn.update("error", (0.0, 1.0, 4.0))
        cloth = slice(drawn._first_cloth, mesh.corners)
        unknown = mesh.albedo.to_numpy()[cloth]
        drawn.errors = np.zeros(225)
        drawn.update("error", (0.0, 1.0, 4.0))
        zero = mesh.albedo.to_numpy()[cloth]
    assert np.ptp(unknown) == 0.0
    assert np.abs(zero - unknown).min() > 0.3
