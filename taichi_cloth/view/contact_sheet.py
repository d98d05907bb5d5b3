"""Several pictures as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.model import Vec3
from .png import Pixels


def contact_sheet(
    pictures: Sequence[Pixels], columns: int, factor: int = 1, *, gap: int = 8, background: Vec3 = (1.0, 1.0, 1.0)
) -> Pixels:
    """Pictures of one size, each made `factor` times smaller, row by row on a grid of `columns`.

    `gap` [pixels] of `background` (factors 0…1) lies between and around them. Takes and returns uint8 of shape
    (height, width, 3); columns and rows left over by `factor` are cut off at the right and the bottom.
    Raises ValueError for no pictures, pictures that differ in size, and numbers too small or too large.
    """
    if len({picture.shape for picture in pictures}) != 1:
        raise ValueError("a contact sheet takes one or more pictures, all of the same size")
    if columns < 1 or gap < 0 or not 1 <= factor <= min(pictures[0].shape[:2]):
        raise ValueError(f"no contact sheet with {columns} columns, gap {gap} and pictures made {factor} times smaller")
    small = [_shrunk(picture, factor) for picture in pictures]
    height, width, _ = small[0].shape
    rows = -(-len(small) // columns)
    size = (gap + rows * (gap + height), gap + columns * (gap + width), 3)
    sheet = np.full(size, np.rint(255 * np.array(background)), np.uint8)
    for k, picture in enumerate(small):
        row, column = divmod(k, columns)
        top, left = gap + row * (gap + height), gap + column * (gap + width)
        sheet[top : top + height, left : left + width] = picture
    return sheet


def _shrunk(picture: Pixels, factor: int) -> Pixels:
    """Means over squares of `factor` × `factor` pixels."""
    height, width = (extent // factor for extent in picture.shape[:2])
    squares = picture[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
    means: Pixels = np.rint(squares.mean(axis=(1, 3))).astype(np.uint8)
    return means
