"""PNG files, read by Pillow."""

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

from taichi_cloth.render.image_files import encode_png, write_png

images = arrays.arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(3)))


def decoded(png: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(png)) as image:
        assert image.mode == "RGB"
        return np.array(image)


@given(images)
def test_pillow_reads_the_same_pixels(rgb: np.ndarray) -> None:
    np.testing.assert_array_equal(decoded(encode_png(rgb)), rgb)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 1), (541, 959)])
def test_odd_sizes_are_written_correctly(tmp_path: Path, shape: tuple[int, int]) -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", rgb)
    np.testing.assert_array_equal(decoded((tmp_path / "a.png").read_bytes()), rgb)


def test_views_of_other_arrays_are_written_correctly() -> None:
    wide = np.random.default_rng(0).integers(0, 256, (8, 10, 4), dtype=np.uint8)
    flipped = wide[::-1, ::2, :3]
    np.testing.assert_array_equal(decoded(encode_png(flipped)), flipped)


@pytest.mark.parametrize(
    "rgb",
    [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4, 3), np.uint8), np.zeros((4, 4, 3))],
    ids=["gray", "alpha", "empty", "float"],
)
def test_other_arrays_are_rejected_with_one_line(tmp_path: Path, rgb: Any) -> None:
    with pytest.raises(ValueError, match=r"uint8 of shape \(height, width, 3\)") as error:
        write_png(tmp_path / "a.png", rgb)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_only_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    real_open = Path.open

    def full_disk(self: Path, *arguments: Any) -> Any:
        file = real_open(self, *arguments)
        file.write(b"partial")
        return _Full(file)

    monkeypatch.setattr(Path, "open", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_png(path, np.zeros((4, 4, 3), np.uint8))
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    assert path.read_bytes() == b"old"


class _Full:
    """A file on a full disk."""

    def __init__(self, file: Any) -> None:
        self.file = file

    def __enter__(self) -> _Full:
        return self

    def __exit__(self, *error: object) -> None:
        self.file.close()

    def write(self, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_missing_folder_raises_file_not_found(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_png(tmp_path / "missing" / "a.png", np.zeros((4, 4, 3), np.uint8))
