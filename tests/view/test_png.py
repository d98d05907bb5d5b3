"""PNG files, read back by Pillow."""

from __future__ import annotations

import errno
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from taichi_cloth.view.png import encode_png, write_png

pictures = arrays.arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(3)))


def decoded(png: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(png)) as image:
        assert image.mode == "RGB"
        return np.array(image)


@given(pictures)
def test_round_trip(rgb: np.ndarray) -> None:
    np.testing.assert_array_equal(decoded(encode_png(rgb)), rgb)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 1), (541, 959)])
def test_odd_sizes(tmp_path: Path, shape: tuple[int, int]) -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", rgb)
    np.testing.assert_array_equal(decoded((tmp_path / "a.png").read_bytes()), rgb)


def test_views_of_other_arrays() -> None:
    wide = np.random.default_rng(0).integers(0, 256, (8, 10, 4), dtype=np.uint8)
    flipped = wide[::-1, ::2, :3]
    np.testing.assert_array_equal(decoded(encode_png(flipped)), flipped)


@pytest.mark.parametrize(
    "rgb",
    [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4, 3), np.uint8), np.zeros((4, 4, 3))],
    ids=["grey", "alpha", "empty", "float"],
)
def test_other_arrays_are_refused_in_one_line(tmp_path: Path, rgb: Any) -> None:
    with pytest.raises(ValueError, match=r"uint8 of shape \(height, width, 3\)") as error:
        write_png(tmp_path / "a.png", rgb)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    whole_open = Path.open

    def full_disk(self: Path, *arguments: Any) -> Any:
        file = whole_open(self, *arguments)
        file.write(b"as much as fits")
        return _Full(file)

    monkeypatch.setattr(Path, "open", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_png(path, np.zeros((4, 4, 3), np.uint8))
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    assert path.read_bytes() == b"old"


class _Full:
    """A file that takes no more."""

    def __init__(self, file: Any) -> None:
        self.file = file

    def __enter__(self) -> _Full:
        return self

    def __exit__(self, *error: object) -> None:
        self.file.close()

    def write(self, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_png(tmp_path / "missing" / "a.png", np.zeros((4, 4, 3), np.uint8))
