"""Every test module gets Taichi anew: the field trees of a whole suite would not fit into one process life.

Two processes share the tests (`pyproject.toml`). A module stays in one of them, so that a kernel is compiled once. The
dearest go first, so that both processes end at nearly the same time.
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


DEAREST = (
    *("scenes", "window", "pages", "strangers", "paths", "contract", "strips_stages", "cli", "triangles"),
    *("self_collision", "validate", "tearing", "examples", "bench", "session", "panel", "projective", "renders"),
    *("simulation", "compare", "lines"),
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        name = item.path.stem.removeprefix("test_")
        return DEAREST.index(name) if name in DEAREST else len(DEAREST)

    items.sort(key=place)


@pytest.fixture(autouse=True, scope="module")
def taichi(request: pytest.FixtureRequest) -> Iterator[None]:
    runtime.start("cpu", random_seed=0)
    yield
    runtime.stop()


@pytest.fixture
def on_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cloth takes the list of springs where strips are usual: half the time to compile, for what is above solvers.

    That the paths are equal is for `solvers/test_paths.py`.
    """
    from taichi_cloth.solvers.base import Solver

    monkeypatch.setattr(Solver, "paths", ("list", "lanes", "gather"))


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command goes on with the module's Taichi: started anew, it would compile again what the last one has."""
    monkeypatch.setattr(runtime, "start", lambda arch: arch)
