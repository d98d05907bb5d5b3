"""A simulation's moving state as a NumPy .npz file."""

from __future__ import annotations

import zipfile
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .files import whole_file

Arrays = dict[str, NDArray[Any]]


def write_save(path: str | PathLike[str], scene_text: str, arrays: Arrays) -> None:
    """Writes the scene's text and the arrays; the file appears whole or not at all. Raises OSError."""
    with whole_file(path) as file:
        np.savez(file, allow_pickle=False, scene=np.array(scene_text), **arrays)


def read_save(path: str | PathLike[str], scene_text: str, like: Arrays) -> Arrays:
    """Reads what `write_save` wrote, for a simulation of the same scene whose present state is `like`.

    Raises OSError where the file cannot be read, and ValueError where it is no save, is damaged, or comes
    from another scene (the first line that differs is named).
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            saved = {name: archive[name] for name in ("scene", *like)}
    except (ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: not a save of this program ({error})") from None
    for ours, theirs in zip(scene_text.splitlines(), str(saved["scene"]).splitlines(), strict=False):
        if ours != theirs:
            raise ValueError(f"{path}: saved from another scene: it has {theirs!r}, this one {ours!r}")
    if str(saved.pop("scene")) != scene_text:
        raise ValueError(f"{path}: saved from another scene")
    for name, array in like.items():
        # Only the hand varies in length.
        if saved[name].shape[1:] != array.shape[1:] or (name != "hand" and saved[name].shape != array.shape):
            raise ValueError(f"{path}: damaged: {name} has shape {saved[name].shape}, not {array.shape}")
        if not np.isfinite(saved[name]).all():
            raise ValueError(f"{path}: damaged: {name} is not finite")
    return saved
