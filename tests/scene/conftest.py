"""Scene files that a test writes, and the one line that refuses them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taichi_cloth.scene import SceneError, load_scene

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


@pytest.fixture(scope="module")
def write(tmp_path_factory: pytest.TempPathFactory) -> Write:
    """write(text): the path of a scene file `mine.toml` with that text."""
    path = tmp_path_factory.mktemp("scene") / "mine.toml"

    def to_file(text: str | bytes) -> Path:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return to_file


@pytest.fixture(scope="session")
def refuse() -> Refuse:
    """refuse(name_or_path, **overrides): the error of loading it, which is a single line."""

    def error_of(scene: str | Path, /, **overrides: Any) -> SceneError:
        with pytest.raises(SceneError) as caught:
            load_scene(scene, **overrides)
        assert str(caught.value).isprintable()  # so it has no line end either
        return caught.value

    return error_of
