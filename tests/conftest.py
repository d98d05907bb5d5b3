"""Every test module gets Taichi anew: the field trees of a whole suite would not fit into one process life.

Two processes share the tests (`pyproject.toml`). A module stays in one of them, so that a kernel is compiled once; the
long modules about every solver are cut by solver, and those about every scene by scene.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

from taichi_cloth import runtime

# How long an example takes says nothing where machines are shared.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


def pytest_configure() -> None:
    # A suite that a shell starts in the background ignores Ctrl-C, and so would every program it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        call = getattr(item, "callspec", None)  # of a parametrized test
        part = (call.params.get("solver") or call.params.get("scene_name", "")) if call else ""
        item.add_marker(pytest.mark.xdist_group(f"{item.path.name} {part}"))


@pytest.fixture(autouse=True, scope="module")
def taichi(request: pytest.FixtureRequest) -> Iterator[None]:
    runtime.start("cpu", random_seed=0)
    yield
    runtime.stop()


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command goes on with the module's Taichi: started anew, it would compile again what the last one has."""
    monkeypatch.setattr(runtime, "start", lambda arch: arch)
