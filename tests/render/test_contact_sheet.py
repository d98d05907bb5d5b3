"""Contact sheets against images composed by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from taichi_cloth.render.image_files import contact_sheet


def plain(value: int, height: int = 2, width: int = 3) -> np.ndarray:
    return np.full((height, width, 3), value, np.uint8)


def test_images_are_placed_on_a_grid() -> None:
    sheet = contact_sheet([plain(k) for k in (10, 20, 30)], columns=2, gap=1, background=(1.0, 0.0, 0.2))
    assert sheet.dtype == np.uint8
    expected = np.full((7, 9, 3), (255, 0, 51))
    expected[1:3, 1:4], expected[1:3, 5:8], expected[4:6, 1:4] = 10, 20, 30
    np.testing.assert_array_equal(sheet, expected)


def test_images_are_reduced_by_means_over_squares() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    image[:2, :2, 0] = [[10, 20], [30, 43]]  # mean 25.75
    image[2:, 2:, 2] = 255
    sheet = contact_sheet([image], columns=1, factor=2, gap=0)
    np.testing.assert_array_equal(sheet, [[[26, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 255]]])


def test_leftover_rows_and_columns_are_cut_off() -> None:
    image = plain(7, height=5, width=8)
    image[3:], image[:, 6:] = 200, 200
    np.testing.assert_array_equal(contact_sheet([image], columns=1, factor=3, gap=0), plain(7, height=1, width=2))


@pytest.mark.parametrize(
    ("images", "columns", "options"),
    [
        ([], 1, {}),
        ([plain(0), plain(0, height=3)], 1, {}),
        ([plain(0)], 0, {}),
        ([plain(0)], 1, {"gap": -1}),
        ([plain(0)], 1, {"factor": 0}),
        ([plain(0)], 1, {"factor": 3}),
    ],
    ids=["none", "two sizes", "no columns", "negative gap", "factor 0", "factor larger than the image"],
)
def test_invalid_sheets_are_rejected(images: list[np.ndarray], columns: int, options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="contact sheet"):
        contact_sheet(images, columns, **options)
