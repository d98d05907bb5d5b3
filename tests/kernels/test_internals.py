"""What is taken from inside Taichi: where it is not there, or wrong, cloth moves as well, and one line says so."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import taichi as ti
from numpy.typing import NDArray

from taichi_cloth import runtime, source_cache
from taichi_cloth.errors import WrongUse
from taichi_cloth.kernels import internals, probe_simd
from taichi_cloth.kernels.internals import CACHE, GRAPHS, SIMD, SOURCES, Use
from taichi_cloth.scene.model import Cloth, Scene, Solver, Wind
from taichi_cloth.simulation import Simulation
from taichi_cloth.solvers import launches

SCENE = Scene(cloth=Cloth(rows=6, columns=10), wind=Wind(z=3.0), solver=Solver("verlet", substeps=3, iterations=4))


def moved(path: str | None, takes: str) -> NDArray[np.float64]:
    """Where the particles are after some frames; `takes`: on which path."""
    with Simulation(SCENE, path) as simulation:
        assert simulation.solver.path == takes
        for _ in range(3):
            simulation.advance_frame()
        return simulation.positions()


@pytest.fixture(scope="module")
def on_the_list() -> NDArray[np.float64]:
    return moved("list", "list")


@pytest.fixture
def anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing has been looked at yet."""
    monkeypatch.setattr(internals, "_checked", {})


def without(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    """Takes a name away. Taichi uses most of them itself, so it is hidden from this program only."""
    there = internals.find

    def find(name: str) -> object:
        if name == missing:
            raise AttributeError(name)
        return there(name)

    monkeypatch.setattr(internals, "find", find)


def names(use: Use) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("name", use.names)


@names(SIMD)
def test_grids_take_the_list(
    name: str,
    on_the_list: NDArray[np.float64],
    anew: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without(monkeypatch, name)
    for _ in range(2):
        assert (moved(None, "list") == on_the_list).all()
    line = f"taichi-cloth: Taichi has no {name}: grids take the path list, which is slower\n"
    assert capsys.readouterr().err == line  # once
    with pytest.raises(WrongUse, match=r"^path lanes does not work with this release of Taichi: take list or gather$"):
        Simulation(SCENE, "lanes")


@names(GRAPHS)
def test_launches_go_one_by_one(
    name: str,
    on_the_list: NDArray[np.float64],
    anew: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without(monkeypatch, name)
    monkeypatch.setattr(launches.Launches, "_graph", None)  # is not called
    assert moved("gather", "gather") == pytest.approx(on_the_list, abs=1e-5)
    line = f"taichi-cloth: Taichi has no {name}: kernels are launched one by one, which is slower\n"
    assert capsys.readouterr().err == line


def test_one_by_one_or_in_a_graph_is_the_same_motion(
    anew: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = [moved("gather", "gather")]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(internals, "_checked", {})
    monkeypatch.setattr(ti, "__version__", (1, 7, 5))
    ends.append(moved("gather", "gather"))
    assert (ends[0] == ends[1]).all()
    line = "taichi-cloth: Taichi is 1.7.5, and 1.7.4 was tried: kernels are launched one by one, which is slower\n"
    assert capsys.readouterr().err == line


@names(SOURCES)
def test_kernels_are_read_without_a_cache(
    name: str, anew: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source_cache.remove()
    there = [internals.find(n) for n in SOURCES.names]
    without(monkeypatch, name)
    source_cache.install()
    monkeypatch.undo()
    try:
        assert [internals.find(n) for n in SOURCES.names] == there
        line = f"taichi-cloth: Taichi has no {name}: a start takes a second longer\n"
        assert capsys.readouterr().err == line
    finally:
        source_cache.install()


@names(CACHE)
def test_compiled_kernels_are_kept_where_taichi_does(
    name: str, anew: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without(monkeypatch, name)
    monkeypatch.setattr(runtime, "sound_folder", None)  # is not called
    runtime.start()
    said = capsys.readouterr().err
    assert said.startswith(f"taichi-cloth: Taichi has no {name}: compiled kernels are kept in Taichi's own folder")
    assert said.count("\n") == 1
    moved("list", "list")


def wrong(*arguments: object) -> None:
    """A kernel that does nothing."""


def failing(*arguments: object) -> None:
    raise RuntimeError("two\nlines")


@pytest.mark.parametrize(
    ("kernel", "told"),
    [
        (wrong, "a kernel that was tried gives wrong numbers"),
        (failing, r"a kernel that was tried fails (RuntimeError: two\nlines)"),
    ],
)
def test_a_probe_that_fails(
    kernel: object,
    told: str,
    on_the_list: NDArray[np.float64],
    anew: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(probe_simd, "probe", kernel)
    monkeypatch.setattr(launches, "_dispatch", kernel)
    assert (moved(None, "list") == on_the_list).all()
    assert moved("gather", "gather") == pytest.approx(on_the_list, abs=1e-5)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"taichi-cloth: {told}: {use.without}" for use in (SIMD, GRAPHS)]


def test_all_of_it_is_there_in_the_release_that_is_asked_for(anew: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert ti.__version__ == internals.TESTED
    assert [internals.usable(use) for use in (SIMD, GRAPHS, SOURCES, CACHE)] == [True] * 4
    assert probe_simd.gives_right_numbers()
    assert launches._graph_gives_right_numbers()
    assert capsys.readouterr().err == ""


def test_the_release_that_was_tried_is_the_one_that_is_installed() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "taichi==" + ".".join(map(str, internals.TESTED)) in project["dependencies"]


REALLY_GONE = """
import sys
import taichi as ti
from taichi._lib import core
from taichi_cloth import runtime
del core.CompileConfig.fast_math, core.Program.delete_ndarray
runtime.start()
from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation
for path, takes in ((None, "list"), ("gather", "gather")):
    with Simulation(load_scene("curtain", rows=5, columns=9, substeps=2, iterations=2), path) as simulation:
        simulation.advance_frame()
        assert simulation.solver.path == takes
        assert simulation.measure().finite
"""


def test_names_that_are_really_gone() -> None:
    done = subprocess.run([sys.executable, "-c", REALLY_GONE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    gone = ((SIMD, "_lib.core.CompileConfig.fast_math"), (GRAPHS, "_lib.core.Program.delete_ndarray"))
    assert done.stderr.splitlines() == [f"taichi-cloth: Taichi has no {name}: {use.without}" for use, name in gone]
