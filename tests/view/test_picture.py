"""One picture of a running simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import taichi_cloth as tc


@pytest.fixture(scope="module")
def pictures(taichi: None) -> dict[str, tc.Picture]:
    with tc.Simulation(tc.load_scene("drape15", rows=5, columns=5)) as simulation:
        return {view: tc.picture(simulation, 96, 54, view) for view in ("shaded", "strain")}


def test_it_shows_the_cloth(pictures: dict[str, tc.Picture]) -> None:
    pixels = pictures["shaded"].pixels
    assert pixels.shape == (54, 96, 3)
    assert pixels.dtype == np.uint8
    cloth = np.abs(pixels.astype(int) - (0x2F, 0x6F, 0x73)).sum(axis=2) < 60  # the scene's colour, lit
    assert 50 < cloth.sum() < 2000
    assert not np.array_equal(pixels, pictures["strain"].pixels)


def test_a_notebook_and_a_file_get_the_same_pixels(pictures: dict[str, tc.Picture], tmp_path: Path) -> None:
    picture = pictures["shaded"]
    picture.save(tmp_path / "cloth.png")
    assert (tmp_path / "cloth.png").read_bytes() == picture._repr_png_()
    with Image.open(tmp_path / "cloth.png") as read:
        assert np.array_equal(np.asarray(read), picture.pixels)


def test_what_cannot_be_drawn_is_refused(taichi: None) -> None:
    with tc.Simulation(tc.load_scene("drape15", rows=5, columns=5)) as simulation:
        with pytest.raises(ValueError, match="no view 'wire': shaded"):
            tc.picture(simulation, view="wire")
        with pytest.raises(ValueError, match="1 x 1"):
            tc.picture(simulation, 0, 54)


def test_a_notebook_shows_a_simulation_as_it_is(taichi: None) -> None:
    simulation = tc.Simulation(tc.load_scene("drape15", rows=5, columns=5))
    first = simulation._repr_png_()
    assert first == tc.picture(simulation)._repr_png_()
    for _ in range(20):
        simulation.advance_frame()
    assert simulation._repr_png_() not in (None, first)
    simulation.close()
    assert simulation._repr_png_() is None
