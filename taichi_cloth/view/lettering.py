"""Figures as rectangles: for a scale in a picture, where there is no font. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 3, 5  # of a letter, in units
LETTERS = {
    "0": "### #.# #.# #.# ###",
    "1": ".#. ##. .#. .#. ###",
    "2": "### ..# ### #.. ###",
    "3": "### ..# .## ..# ###",
    "4": "#.# #.# ### ..# ..#",
    "5": "### #.. ### ..# ###",
    "6": "### #.. ### #.# ###",
    "7": "### ..# ..# .#. .#.",
    "8": "### #.# ### #.# ###",
    "9": "### #.# ### ..# ###",
    "+": "... .#. ### .#. ...",
    "-": "... ... ### ... ...",
    ".": "... ... ... ... .#.",
    "%": "#.# ..# .#. #.. #.#",
    " ": "... ... ... ... ...",
}


def text_width(text: str) -> int:
    """In units, with a gap of one between letters."""
    return (WIDTH + 1) * len(text) - 1


def text_rectangles(text: str, left: float, top: float) -> NDArray[np.float64]:
    """Rows of left, top, width and height [units], one for each run of a letter's row; y goes down.

    Raises KeyError for a letter that is not in `LETTERS`.
    """
    found = []
    for k, letter in enumerate(text):
        for row, cells in enumerate(LETTERS[letter].split()):
            for column, cell in enumerate(cells):
                if cell == "#":
                    found.append((left + (WIDTH + 1) * k + column, top + row, 1.0, 1.0))
    return np.array(found).reshape(-1, 4)
