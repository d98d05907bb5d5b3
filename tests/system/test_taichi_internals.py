"""Taichi internals: if they are missing or wrong, cloth moves the same way, and one line is printed."""

import subprocess
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import taichi as ti
from numpy.typing import NDArray

from taichi_cloth.kernels import tensor_fields
from taichi_cloth.scene.schema import Cloth, Scene, Solver, Wind
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.solvers import graph_runner
from taichi_cloth.system import kernel_parsing, taichi_compat
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.errors import UsageError
from taichi_cloth.system.kernel_parsing import DECORATORS, LOOPS, SOURCES, USES_OF_PARSER
from taichi_cloth.system.taichi_compat import CACHE, GRAPHS, LAUNCHES, PROGRAM, SIMD, InternalUse, RepeatedLaunch

pytestmark = pytest.mark.bounds

USES = PROGRAM, SIMD, GRAPHS, LAUNCHES, DECORATORS, SOURCES, LOOPS, CACHE

SCENE = Scene(cloth=Cloth(rows=6, columns=10), wind=Wind(z=3.0), solver=Solver("verlet", substeps=3, iterations=4))


def moved(layout: str | None, expected: str) -> NDArray[np.float64]:
    """Return the positions after some frames; `expected` is the layout in use."""
    with Simulation(SCENE, layout) as simulation:
        assert simulation.solver.layout_name == expected
        for _ in range(3):
            simulation.step()
        return simulation.positions()


@pytest.fixture(scope="module")
def serial_positions() -> NDArray[np.float64]:
    return moved("serial", "serial")


@pytest.fixture
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clear the results of earlier checks."""
    monkeypatch.setattr(taichi_compat, "_checked", {})


def without(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    """Hide a name from this package only: Taichi uses most of them itself."""
    original = taichi_compat.find_internal

    def find(name: str) -> object:
        if name == missing:
            raise AttributeError(name)
        return original(name)

    monkeypatch.setattr(taichi_compat, "find_internal", find)


def names(use: InternalUse) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("name", use.names)


@names(SIMD)
def test_grids_use_the_serial_layout(
    name: str,
    serial_positions: NDArray[np.float64],
    unchecked: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without(monkeypatch, name)
    for _ in range(2):
        assert (moved(None, "serial") == serial_positions).all()
    line = f"taichi-cloth: Taichi has no {name}: grids use the serial layout, which is slower\n"
    assert capsys.readouterr().err == line  # once
    with pytest.raises(
        UsageError, match=r"^layout simd does not work with this release of Taichi; use serial or parallel$"
    ):
        Simulation(SCENE, "simd")


@names(GRAPHS)
def test_kernels_are_launched_one_by_one(
    name: str,
    serial_positions: NDArray[np.float64],
    unchecked: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without(monkeypatch, name)
    monkeypatch.setattr(graph_runner.GraphRunner, "_build", None)  # must not be called
    assert moved("parallel", "parallel") == pytest.approx(serial_positions, abs=1e-5)
    line = f"taichi-cloth: Taichi has no {name}: kernels are launched one by one, which is slower\n"
    assert capsys.readouterr().err == line


def test_graphs_and_single_launches_give_the_same_motion(
    unchecked: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ends = [moved("parallel", "parallel")]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(taichi_compat, "_checked", {})
    monkeypatch.setattr(ti, "__version__", (1, 7, 5))
    ends.append(moved("parallel", "parallel"))
    assert (ends[0] == ends[1]).all()
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        f"taichi-cloth: Taichi is 1.7.5, but only 1.7.4 is tested: {use.fallback}" for use in (PROGRAM, GRAPHS)
    ]


@names(SOURCES)
def test_kernels_are_parsed_without_the_source_cache(
    name: str, unchecked: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kernel_parsing.restore_functions()
    originals = [taichi_compat.find_internal(n) for n in SOURCES.names]
    without(monkeypatch, name)
    kernel_parsing.replace_parser()
    monkeypatch.undo()
    try:
        assert [taichi_compat.find_internal(n) for n in SOURCES.names] == originals
        line = f"taichi-cloth: Taichi has no {name}: startup takes a second longer\n"
        assert capsys.readouterr().err == line
    finally:
        kernel_parsing.replace_parser()


@names(LAUNCHES)
def test_frames_are_launched_by_a_call(
    name: str,
    serial_positions: NDArray[np.float64],
    unchecked: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    without(monkeypatch, name)
    assert (moved("serial", "serial") == serial_positions).all()
    if not ti.cfg.debug:  # which calls kernels anyway
        line = f"taichi-cloth: Taichi has no {name}: each frame takes up to 0.4 ms longer\n"
        assert capsys.readouterr().err == line


f32_array = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def scale(out: ti.template(), count: int, factor: float, values: f32_array):
    for i in range(count):
        out[i] = factor * values[i]


def test_a_repeated_launch_gets_the_arguments_of_each_call() -> None:
    out, launch = ti.field(ti.f32, 4), RepeatedLaunch(scale)
    launch(out, 4, 2.0, np.array([1, 2, 3, 4], np.float32))
    launch(out, 2, 0.5, np.array([8, 6, 4, 2], np.float32))
    assert out.to_numpy().tolist() == [4, 3, 6, 8]


@pytest.mark.parametrize("values", [np.ones(4), np.ones((4, 2), np.float32)[:, 0], np.ones(4, np.int32)])
def test_a_repeated_launch_refuses_arrays_that_it_cannot_pass_on(values: NDArray[np.generic]) -> None:
    if ti.cfg.debug:
        pytest.skip("debug mode calls the kernel")
    out, launch = ti.field(ti.f32, 4), RepeatedLaunch(scale)
    launch(out, 4, 2.0, np.ones(4, np.float32))
    with pytest.raises(ValueError, match=r"^the kernel takes a C-contiguous array of float32, not of \w+$"):
        launch(out, 4, 3.0, values)
    assert out.to_numpy().tolist() == [2, 2, 2, 2]


def test_a_repeated_launch_is_prepared_anew_after_a_restart() -> None:
    launch, values = RepeatedLaunch(scale), np.array([1, 2, 3, 4], np.float32)
    for factor in (2.0, 3.0):
        runtime.start(cpu_max_num_threads=1)
        out = ti.field(ti.f32, 4)
        for _ in range(2):
            launch(out, 4, factor, values)
        assert (out.to_numpy() == factor * values).all()


@pytest.mark.parametrize("replaced", [False, True])
def test_decorators_know_whether_they_stand_in_a_class(replaced: bool) -> None:
    kernel_parsing.restore_functions()
    try:
        if replaced:
            kernel_parsing.replace_class_check()

        @ti.data_oriented
        class Counter:
            def __init__(self) -> None:
                self.total = ti.field(ti.i32, ())

            @ti.kernel
            def add(self, number: int):  # type: ignore[no-untyped-def]
                self.total[None] += self.twice(number)

            @ti.func
            def twice(self, number):  # type: ignore[no-untyped-def]
                return 2 * number

        @ti.func
        def thrice(number):  # type: ignore[no-untyped-def]
            return 3 * number

        @ti.kernel
        def in_a_function(number: int) -> int:
            return thrice(number)

        counter = Counter()
        counter.add(4)
        assert counter.total[None] == 8
        assert in_a_function(4) == 12
    finally:
        kernel_parsing.replace_class_check()
        kernel_parsing.replace_parser()


@names(LOOPS)
def test_one_thread_moves_cloth_the_same_way_through_the_pool(
    name: str, unchecked: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runtime.start(cpu_max_num_threads=1)
    positions = moved("parallel", "parallel")
    without(monkeypatch, name)
    monkeypatch.setattr(taichi_compat, "_checked", {})
    runtime.start(cpu_max_num_threads=1)
    assert moved("parallel", "parallel") == pytest.approx(positions, abs=1e-6)  # [m]; the compiler orders sums
    line = f"taichi-cloth: Taichi has no {name}: each loop that could be parallel takes 0.1 ms longer\n"
    assert capsys.readouterr().err == line


def count_up(length: int, launches: int, module: str) -> NDArray[np.int32]:
    """Add 1 in two loops of a module's kernel to all elements of a field, `launches` times. Return them."""
    values = ti.field(ti.i32, length)

    def count():  # type: ignore[no-untyped-def]
        for i in range(length):
            values[i] += 1
        for i, _ in ti.ndrange(length, 1):
            values[i] += 1

    count.__module__ = module
    kernel = ti.kernel(count)
    for _ in range(launches):
        kernel()
    return values.to_numpy()


def test_one_thread_hands_no_loop_of_this_package_to_another(unchecked: None) -> None:
    """The loops of a user's kernels are compiled as Taichi compiles them."""
    resource = pytest.importorskip("resource", reason="Windows counts no context switches")
    launches, switches = 1000, []
    for threads, module in ((1, "taichi_cloth.kernels"), (2, "taichi_cloth.kernels"), (1, "notebook")):
        runtime.start(cpu_max_num_threads=threads)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw
        assert (count_up(100, launches, module) == 2 * launches).all()
        switches.append(resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw - before)
    assert switches[0] < 0.5 * launches < launches < min(switches[1:])


@names(CACHE)
def test_compiled_kernels_are_cached_in_taichis_own_folder(
    name: str, unchecked: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without(monkeypatch, name)
    monkeypatch.setattr(runtime, "usable_cache_folder", None)  # must not be called
    runtime.start()
    err = capsys.readouterr().err
    assert err.startswith(f"taichi-cloth: Taichi has no {name}: compiled kernels are cached in Taichi's own folder")
    assert err.count("\n") == 1
    moved("serial", "serial")


@names(PROGRAM)
def test_simulations_run_without_the_running_program(
    name: str, unchecked: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runtime.start()
    positions = moved("serial", "serial")
    without(monkeypatch, name)
    monkeypatch.setattr(taichi_compat, "_checked", {})
    runtime.stop()
    assert taichi_compat.running_program() is None
    runtime.start_if_needed()
    program = taichi_compat.ProgramRef()
    assert program.runs()
    assert (moved("serial", "serial") == positions).all()
    runtime.start()
    assert not program.runs()
    line = f"taichi-cloth: Taichi has no {name}: references to an ended program are not found\n"
    assert capsys.readouterr().err == line


def wrong(*arguments: object) -> None:
    """Stand in for a kernel, and do nothing."""


def failing(*arguments: object) -> None:
    raise RuntimeError("two\nlines")


@pytest.mark.parametrize(
    ("kernel", "problem"),
    [
        (wrong, "a probe kernel returns wrong numbers"),
        (failing, r"a probe kernel fails (RuntimeError: two\nlines)"),
    ],
)
def test_a_failing_probe_is_reported(
    kernel: object,
    problem: str,
    serial_positions: NDArray[np.float64],
    unchecked: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(tensor_fields, "probe", kernel)
    monkeypatch.setattr(graph_runner, "dispatch", kernel)
    assert (moved(None, "serial") == serial_positions).all()
    assert moved("parallel", "parallel") == pytest.approx(serial_positions, abs=1e-5)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"taichi-cloth: {problem}: {use.fallback}" for use in (SIMD, GRAPHS)]


@pytest.mark.parametrize(
    ("method", "problem"),
    [
        (lambda *_: None, "a probe kernel returns wrong numbers"),
        (failing, r"a probe kernel fails (RuntimeError: two\nlines)"),
    ],
)
def test_a_failing_probe_of_launches_is_reported(
    method: Callable[..., None],
    problem: str,
    serial_positions: NDArray[np.float64],
    unchecked: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if ti.cfg.debug:
        pytest.skip("debug mode calls the kernel")
    monkeypatch.setattr(RepeatedLaunch, "_launch", method)
    runtime.start()  # launches of the module that are prepared already are prepared anew
    assert (moved("serial", "serial") == serial_positions).all()
    assert capsys.readouterr().err == f"taichi-cloth: {problem}: {LAUNCHES.fallback}\n"


def test_a_launch_that_keeps_its_first_arguments_is_found(unchecked: None, monkeypatch: pytest.MonkeyPatch) -> None:
    original, first = RepeatedLaunch._launch, []

    def launch(self: RepeatedLaunch, values: Sequence[Any]) -> None:
        first.append(values)
        original(self, first[0])

    monkeypatch.setattr(RepeatedLaunch, "_launch", launch)
    assert not taichi_compat._launch_is_correct()


@pytest.mark.parametrize("wrong", USES_OF_PARSER)
def test_a_parser_with_which_a_probe_is_wrong_is_not_used(
    wrong: InternalUse, unchecked: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other replacement stays."""
    runtime.stop()
    originals = {use: [taichi_compat.find_internal(name) for name in use.names] for use in USES_OF_PARSER}
    probe = kernel_parsing.parsed_correctly

    def fails_for_one(use: int) -> bool:
        return probe(use) and USES_OF_PARSER[use] is not wrong

    monkeypatch.setattr(kernel_parsing, "parsed_correctly", fails_for_one)
    runtime.start(cpu_max_num_threads=1)
    for use in USES_OF_PARSER:
        replaced = [taichi_compat.find_internal(name) for name in use.names] != originals[use]
        assert replaced == (use is not wrong)
    runtime.start(cpu_max_num_threads=1)  # the check is remembered
    assert [taichi_compat.find_internal(name) for name in wrong.names] == originals[wrong]
    line = f"taichi-cloth: a probe kernel returns wrong numbers: {wrong.fallback}\n"
    assert capsys.readouterr().err == line
    runtime.stop()
    monkeypatch.undo()
    runtime.start()


@pytest.mark.parametrize("use", USES_OF_PARSER)
def test_the_probe_runs_with_the_replaced_parser(
    use: InternalUse, unchecked: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tree that is given out changed gives a wrong number, and so does a loop that is left out."""
    runtime.stop()
    if use is SOURCES:
        original = kernel_parsing.SyntaxTrees.parse

        def parse(self: Any, text: str) -> Any:
            return original(self, text.replace("i * i", "i"))

        monkeypatch.setattr(kernel_parsing.SyntaxTrees, "parse", parse)
    else:
        monkeypatch.setattr(kernel_parsing, "_serialized", lambda build: staticmethod(lambda context, node: None))
    runtime.start(cpu_max_num_threads=1)
    assert not taichi_compat._checked[use, str(ti.cfg.arch)]
    assert taichi_compat._checked[SOURCES if use is LOOPS else LOOPS, str(ti.cfg.arch)]
    runtime.stop()
    monkeypatch.undo()
    runtime.start()


def test_all_internals_are_usable_in_the_required_release(unchecked: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert ti.__version__ == taichi_compat.TESTED
    assert [taichi_compat.usable(use) for use in USES] == [True] * len(USES)
    assert tensor_fields.probe_is_correct()
    assert graph_runner._graph_is_correct()
    assert taichi_compat._launch_is_correct()
    assert [taichi_compat.parsed_correctly(k) for k in range(len(USES_OF_PARSER))] == [True, True]
    assert capsys.readouterr().err == ""


def test_the_tested_release_is_the_required_one() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "taichi==" + ".".join(map(str, taichi_compat.TESTED)) in project["dependencies"]


DELETED_NAMES = """
import sys
import taichi as ti
from taichi._lib import core
from taichi_cloth.system import taichi_runtime as runtime
del core.CompileConfig.fast_math, core.Program.delete_ndarray
runtime.start()
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.simulation.simulation import Simulation
for layout, expected in ((None, "serial"), ("parallel", "parallel")):
    with Simulation(load_scene("curtain", rows=5, columns=9, substeps=2, iterations=2), layout) as simulation:
        simulation.step()
        assert simulation.solver.layout_name == expected
        assert simulation.metrics().finite
"""


def test_deleted_internals_are_reported() -> None:
    done = subprocess.run([sys.executable, "-c", DELETED_NAMES], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    deleted = ((SIMD, "_lib.core.CompileConfig.fast_math"), (GRAPHS, "_lib.core.Program.delete_ndarray"))
    assert done.stderr.splitlines() == [f"taichi-cloth: Taichi has no {name}: {use.fallback}" for use, name in deleted]
