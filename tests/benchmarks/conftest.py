"""These tests do not need Taichi: the fixture that starts it for every test module is replaced by an empty one."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    pass
