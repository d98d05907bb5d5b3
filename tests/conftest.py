"""One Taichi runs the tests of many modules, because a restart would compile all kernels again.

Two processes share the tests (`pyproject.toml`). A module stays in one of them, so that a kernel is compiled once. The
modules that took longest in the last run start first, so that both processes end at nearly the same time.
"""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

# Two processes run tests: BLAS threads of one would wait for the other's. NumPy reads this once, when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from taichi_cloth.system import taichi_runtime as runtime

if TYPE_CHECKING:
    from taichi_cloth.system.taichi_compat import ProgramRef

# The time of an example has no meaning on a shared machine.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--arch", default="cpu", help="backend of Taichi: cpu, cuda, vulkan, metal or gpu")


def pytest_configure() -> None:
    # A suite started by a shell in the background ignores Ctrl-C, and so would every program that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)


DURATIONS = "taichi_cloth/seconds_by_module"  # key in pytest's cache
LONGEST = 1e9  # [s] of modules that wait for windows, until their time is known
_seconds: Counter[str] = Counter()


def module_of(node_id: str) -> str:
    return node_id.partition("::")[0]


def last_durations(config: pytest.Config) -> dict[str, float]:
    cache = cache_of(config)
    return cache.get(DURATIONS, {}) if cache is not None else {}


def cache_of(config: pytest.Config) -> pytest.Cache | None:
    """Return pytest's cache; with `-p no:cacheprovider` there is none, and no attribute."""
    return getattr(config, "cache", None)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    last = last_durations(config)
    windows = dict.fromkeys((m for item in items if "/window/" in (m := module_of(item.nodeid))), LONGEST)
    items.sort(key=lambda item: -(windows | last).get(module_of(item.nodeid), 0.0))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _seconds[module_of(report.nodeid)] += report.duration


def pytest_sessionfinish(session: pytest.Session) -> None:
    cache = cache_of(session.config)
    if cache is not None and not hasattr(session.config, "workerinput"):  # not in the workers, which report to this one
        cache.set(DURATIONS, last_durations(session.config) | _seconds)


SHOWN = 40  # modules


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if len(_seconds) > SHOWN:
        terminalreporter.write_sep("=", f"slowest modules of {sum(_seconds.values()):.0f} s")
        for module, seconds in _seconds.most_common(SHOWN):
            terminalreporter.write_line(f"{seconds:7.1f} s  {module}")


FIELD_TREES = 128  # restart Taichi above it: a process holds 512 trees, and a module needs less than half of them
_kept: tuple[tuple[str, int], ProgramRef] | None = None  # options of the Taichi of the last module, and its program


@pytest.fixture(autouse=True, scope="module")
def taichi(request: pytest.FixtureRequest) -> None:
    """Run the tests of a module in a Taichi on one thread.

    Two processes run tests, and two threads in each would wait for the other process's: twice the time on two cores. On
    one thread, loops of the parallel layout are serial. A module that defines `CPU_THREADS` gets so many.
    """
    from taichi_cloth.system.taichi_compat import ProgramRef, running_program

    global _kept
    options = request.config.getoption("--arch"), getattr(request.module, "CPU_THREADS", 1)
    same = _kept is not None and _kept[0] == options and _kept[1].runs()
    if not same or running_program().get_snode_tree_size() > FIELD_TREES:
        runtime.start(options[0], random_seed=0, cpu_max_num_threads=options[1])
        _kept = options, ProgramRef()


@pytest.fixture(autouse=True, scope="session")
def end_of_taichi() -> Iterator[None]:
    yield
    runtime.stop()


@pytest.fixture
def serial_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulations that name no layout take the serial one instead of SIMD: it compiles in half the time.

    `solvers/test_layouts.py` tests that all layouts give equal results.
    """
    from taichi_cloth.solvers import layout_choice

    monkeypatch.setattr(layout_choice, "LANES", 1 << 20)  # `choose_layout` then finds no grid wide enough for SIMD


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands use the running Taichi of the module: a restart would compile all kernels again."""
    monkeypatch.setattr(runtime, "start", lambda arch: arch)
