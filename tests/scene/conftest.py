"""Fixtures: a scene file with a given text, and the error of loading an invalid one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.system.errors import SceneError

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


@pytest.fixture(scope="module")
def write(tmp_path_factory: pytest.TempPathFactory) -> Write:
    """Return a function that writes a text to the scene file `mine.toml` and returns its path."""
    path = tmp_path_factory.mktemp("scene") / "mine.toml"

    def to_file(text: str | bytes) -> Path:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return to_file


@pytest.fixture(scope="session")
def refuse() -> Refuse:
    """Return a function that loads a scene and returns the error, after checking that it is one line."""

    def error_of(scene: str | Path, /, **overrides: Any) -> SceneError:
        with pytest.raises(SceneError) as caught:
            load_scene(scene, **overrides)
        assert str(caught.value).isprintable()  # so it has no line end
        return caught.value

    return error_of
