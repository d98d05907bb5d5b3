"""A session with the scene of the demo, without a display."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from taichi_cloth.export.clip import export_snapshot
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.viewer.session import Session


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.chdir(tmp_path)  # meshes are exported there
    session = Session(load_scene("curtain"), export=export_snapshot)
    yield session
    session.close()
