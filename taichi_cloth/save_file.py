"""A simulation's moving state as a NumPy .npz file."""

from __future__ import annotations

import io
import zipfile
from math import prod
from os import PathLike
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .errors import one_line
from .files import whole_file
from .scene.errors import shown

Arrays = dict[str, NDArray[Any]]

OF_HANDS = ("held", "taken", "hands", "ways")
MOST_BYTES = 1 << 24  # of what may vary: a scene's text, four a character, and the hands


def write_save(path: str | PathLike[str], scene_text: str, arrays: Arrays) -> None:
    """Writes the scene's text and the arrays; the file appears whole or not at all. Raises OSError."""
    with whole_file(path) as file:
        file.write(packed(scene_text, arrays))


def packed(scene_text: str, arrays: Arrays) -> bytes:
    """What is in such a file."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, scene=np.array(scene_text), **arrays)
    return content.getvalue()


def read_save(path: str | PathLike[str], scene_text: str, like: Arrays) -> Arrays:
    """Reads what `write_save` wrote, for a simulation of the same scene whose present state is `like`.

    Raises OSError where the file cannot be read, and ValueError where it is no save, is damaged, or comes
    from another scene (the first line that differs is named). No memory is taken for what is too large.
    """
    most = 2 * (MOST_BYTES + sum(array.nbytes for array in like.values()))
    saved = {}
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
        if len(content) > most:
            raise ValueError(f"it is larger than {most} bytes")
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            theirs = str(_entry(archive, "scene", np.array("")))
            if theirs == scene_text:
                saved = {name: _entry(archive, name, array) for name, array in like.items()}
    except OSError:
        raise
    except Exception as error:  # the readers of zip, of deflate and of NumPy's headers have a dozen kinds
        raise ValueError(f"{path}: not a save of this program ({one_line(str(error))})") from None
    for ours, other in zip(scene_text.splitlines(), theirs.splitlines(), strict=False):
        if ours != other:
            raise ValueError(f"{path}: saved from another scene: it has {shown(other)}, this one {shown(ours)}")
    if theirs != scene_text:
        raise ValueError(f"{path}: saved from another scene")
    for name, array in saved.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{path}: damaged: {name} is not finite")
    return saved


def _entry(archive: zipfile.ZipFile, name: str, like: NDArray[Any]) -> NDArray[Any]:
    """One array, read only if its header says that it is of the kind and shape of `like`. Raises ValueError and others.

    A text and what tells of hands vary in length.
    """
    with archive.open(f"{name}.npy") as stream:
        header = npy.read_array_header_1_0 if npy.read_magic(stream) == (1, 0) else npy.read_array_header_2_0
        shape, _, kind = header(stream)
    same_kind = kind == like.dtype or kind.kind == like.dtype.kind == "U"
    varies = name in OF_HANDS and len(shape) == like.ndim
    same_shape = shape == like.shape or (varies and shape[1:] == like.shape[1:])
    if not (same_kind and same_shape) or prod(shape) * kind.itemsize > max(like.nbytes, MOST_BYTES):
        raise ValueError(f"{name} is {kind} of shape {shape}, not {like.dtype} of shape {like.shape}")
    with archive.open(f"{name}.npy") as stream:
        array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
    return array
