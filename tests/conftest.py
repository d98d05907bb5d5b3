"""Every test module gets Taichi anew: the field trees of a whole suite would not fit into one process life."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from taichi_cloth import runtime


@pytest.fixture(autouse=True, scope="module")
def taichi(request: pytest.FixtureRequest) -> Iterator[None]:
    runtime.start("cpu", random_seed=0)
    yield
    runtime.stop()
