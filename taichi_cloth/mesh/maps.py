"""Numbers 0…1 for every particle from a picture or a list. NumPy only, and Pillow for pictures."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import WrongUse
from ..scene.errors import shown

MOST_BYTES = 64_000_000
MOST_PIXELS = 100_000_000

Floats = NDArray[np.float64]


def read_map(path: Path, count: int, spots: Floats | None, cloth: str) -> Floats:
    """The numbers of `count` particles, (N,), that stand at `spots` of a picture, (N, 2) from the left and the bottom.

    `cloth` is what messages call it. Raises ValueError, one line.
    """
    kind = path.suffix.lower()
    try:
        size = path.stat().st_size
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise ValueError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if size > MOST_BYTES:
        raise ValueError(f"{path} is larger than {MOST_BYTES} bytes")
    if kind not in (".csv", ".npy"):
        if spots is None:
            raise ValueError(f"{cloth} has no `vt` for some of its points, which tells where they are on a picture")
        return sampled(_grey(path), spots)
    numbers = _listed(path) if kind == ".csv" else _array(path)
    if numbers.shape != (count,):
        raise ValueError(f"{path} has numbers of shape {numbers.shape}, not one for each of {count} particles")
    wrong = np.flatnonzero(~((numbers >= 0) & (numbers <= 1)))  # NaN is neither
    if len(wrong):
        raise ValueError(f"{path}: number {wrong[0] + 1} is {numbers[wrong[0]]:g}, not 0 to 1")
    return numbers


def sampled(grey: Floats, spots: Floats) -> Floats:
    """Between the nearest four pixels of a picture (height, width); the outermost lie on its edges. A picture repeats
    itself beyond 0…1, as textures do.
    """
    beyond = (spots < 0) | (spots > 1)
    u, v = np.where(beyond, spots % 1, spots).T
    height, width = grey.shape
    x, y = u * (width - 1), (1 - v) * (height - 1)
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = x - left, y - top
    upper = grey[top, left] * (1 - x) + grey[top, right] * x
    lower = grey[bottom, left] * (1 - x) + grey[bottom, right] * x
    found: Floats = upper * (1 - y) + lower * y
    return found


def _grey(path: Path) -> Floats:
    """The brightness of a picture, 0…1, (height, width)."""
    try:
        from PIL import Image
    except ImportError:
        raise WrongUse("pictures as maps need Pillow: pip install 'taichi-cloth[maps]'") from None
    try:
        with warnings.catch_warnings(action="ignore"):  # Pillow's of a large picture: ours is the error
            opened = Image.open(path)
        with opened as picture:
            if picture.width * picture.height > MOST_PIXELS:
                raise ValueError(f"it has more than {MOST_PIXELS} pixels")
            if picture.mode.startswith("I"):  # 16 bits
                return np.clip(np.asarray(picture, np.float64) / 65535, 0.0, 1.0)
            return np.asarray(picture.convert("L"), np.float64) / 255
    except Exception as error:  # Pillow has errors of all kinds for a broken file
        raise ValueError(f"{path} is no picture: {shown(str(error))}") from None


def _listed(path: Path) -> Floats:
    numbers = []
    for line, text in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), 1):
        try:
            if text.strip():
                numbers.append(float(text))
        except ValueError:
            raise ValueError(f"{path}: line {line}: {shown(text)} is no number; one a line is needed") from None
    return np.array(numbers)


def _array(path: Path) -> Floats:
    try:
        found = np.load(path, allow_pickle=False)
        return np.asarray(found, np.float64)
    except Exception as error:
        raise ValueError(f"{path} is no NumPy array of numbers: {shown(str(error))}") from None
