"""Images of a running simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.system.errors import UsageError


@pytest.fixture(scope="module")
def images(taichi: None) -> dict[str, tc.Image]:
    with tc.Simulation(tc.load_scene("drape15", rows=5, columns=5)) as simulation:
        return {view: tc.render_image(simulation, (96, 54), view) for view in ("shaded", "strain")}


def test_the_image_shows_the_cloth(images: dict[str, tc.Image]) -> None:
    pixels = images["shaded"].pixels
    assert pixels.shape == (54, 96, 3)
    assert pixels.dtype == np.uint8
    cloth = np.abs(pixels.astype(int) - (0x2F, 0x6F, 0x73)).sum(axis=2) < 60  # the scene's color, lit
    assert 50 < cloth.sum() < 2000
    assert not np.array_equal(pixels, images["strain"].pixels)


def test_a_notebook_and_a_file_have_the_same_pixels(images: dict[str, tc.Image], tmp_path: Path) -> None:
    image = images["shaded"]
    image.save(tmp_path / "cloth.png")
    assert (tmp_path / "cloth.png").read_bytes() == image._repr_png_()
    with Image.open(tmp_path / "cloth.png") as read:
        assert np.array_equal(np.asarray(read), image.pixels)


def test_an_image_is_an_array_for_numpy(images: dict[str, tc.Image]) -> None:
    image = images["shaded"]
    np.testing.assert_array_equal(np.asarray(image), image.pixels)
    assert np.array(image, float).dtype == np.float64
    assert repr(image) == "<Image 96×54>"


@pytest.mark.parametrize("name", ["x.jpg", "x.PNG.jpeg", "x", "png"])
def test_a_name_that_is_not_that_of_a_png_file_is_refused(
    images: dict[str, tc.Image], tmp_path: Path, name: str
) -> None:
    with pytest.raises(UsageError, match=f"{name}: images are saved as PNG files: the name must end in .png"):
        images["shaded"].save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    images["shaded"].save(tmp_path / "x.PNG")


def test_unknown_views_and_empty_sizes_are_rejected(taichi: None) -> None:
    with tc.Simulation(tc.load_scene("drape15", rows=5, columns=5)) as simulation:
        with pytest.raises(ValueError, match="unknown view 'wire': shaded"):
            tc.render_image(simulation, view="wire")
        with pytest.raises(ValueError, match="1 to 8192 pixels each"):
            tc.render_image(simulation, (0, 54))


def test_the_camera_can_be_moved(taichi: None) -> None:
    scene = tc.load_scene("drape15", rows=5, columns=5)
    with tc.Simulation(scene) as simulation:
        own = tc.render_image(simulation, (96, 54))
        same = tc.render_image(simulation, (96, 54), eye=scene.camera.eye, target=scene.camera.target)
        assert np.array_equal(own.pixels, same.pixels)
        near = tuple((np.array(scene.camera.eye) + scene.camera.target) / 2)

        def size_of(image: tc.Image) -> int:
            return int((np.abs(image.pixels.astype(int) - (0x2F, 0x6F, 0x73)).sum(axis=2) < 60).sum())

        assert size_of(tc.render_image(simulation, (96, 54), eye=near)) > 2 * size_of(own)
        assert size_of(tc.render_image(simulation, (96, 54), fov=scene.camera.fov / 2)) > 2 * size_of(own)
        above = [0.0, 30.0, 0.0]
        assert size_of(tc.render_image(simulation, (96, 54), target=above)) == 0


@pytest.mark.parametrize(
    ("places", "line"),
    [
        ({"eye": (1.0, 2.0)}, "drape15: camera.eye: must be three numbers, as in [0.0, 1.0, 0.0], got (1.0, 2.0)"),
        ({"eye": (0.0, np.nan, 1.0)}, "drape15: camera.eye[1]: must be a finite number, got nan"),
        ({"eye": [0, 5, 0], "target": np.zeros(3)}, "drape15: camera.eye: must not be straight above or below camera."),
    ],
)
def test_an_invalid_camera_is_refused_by_one_line(taichi: None, places: dict[str, Any], line: str) -> None:
    with tc.Simulation(tc.load_scene("drape15", rows=5, columns=5)) as simulation:
        with pytest.raises(tc.SceneError) as caught:
            tc.render_image(simulation, (96, 54), **places)
        assert str(caught.value).startswith(line)


def test_a_notebook_shows_the_current_frame(taichi: None) -> None:
    simulation = tc.Simulation(tc.load_scene("drape15", rows=5, columns=5))
    first = simulation._repr_png_()
    assert first == tc.render_image(simulation)._repr_png_()
    for _ in range(20):
        simulation.step()
    assert simulation._repr_png_() not in (None, first)
    simulation.close()
    assert simulation._repr_png_() is None
