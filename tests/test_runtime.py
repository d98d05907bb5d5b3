"""Starting Taichi on what the machine has, and saying what it has not."""

from __future__ import annotations

import subprocess
import sys

import pytest
import taichi as ti

from taichi_cloth import runtime, source_cache
from taichi_cloth.errors import WrongUse
from taichi_cloth.scene import load_scene
from taichi_cloth.simulation import Simulation

HERE = [a for a in ("cuda", "vulkan", "metal") if ti.lang.misc.is_arch_supported(getattr(ti, a))]
AWAY = [a for a in ("cuda", "vulkan", "metal") if a not in HERE]


@pytest.mark.parametrize("arch", AWAY)
def test_an_arch_that_is_not_there_is_refused_and_never_replaced(arch: str) -> None:
    with pytest.raises(WrongUse, match=f"arch {arch} is not there: this machine has cpu"):
        runtime.start(arch)
    done = subprocess.run(
        [sys.executable, "-m", "taichi_cloth", "render", "curtain", "--frames", "1", "--arch", arch],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [f"taichi-cloth: arch {arch} is not there: this machine has {told()}"]


def told() -> str:
    return ", ".join(["cpu", *HERE])


@pytest.mark.parametrize(
    "solver",
    ["verlet", "lines", *(pytest.param(s, marks=pytest.mark.long) for s in ("xpbd", "spring", "rk4", "projective"))],
)
@pytest.mark.parametrize("arch", HERE)
def test_every_arch_that_is_there_moves_the_same_cloth(arch: str, solver: str) -> None:
    """Whatever it is: here Mesa's software Vulkan, elsewhere a GPU."""
    scene = load_scene("curtain", rows=8, columns=10, substeps=2, iterations=3, solver=solver)
    ends = []
    for name in ("cpu", arch):
        assert runtime.start(name) == name
        with Simulation(scene, "list" if name == "cpu" else None) as simulation:
            assert simulation.solver.path == ("list" if name == "cpu" else "gather")
            for _ in range(5):
                simulation.advance_frame()
            ends.append(simulation.positions())
    runtime.start("cpu")
    assert ends[1] == pytest.approx(ends[0], abs=1e-4)


@pytest.mark.skipif(not HERE, reason="no GPU and no Vulkan")
def test_gpu_is_the_first_that_is_there_and_serial_paths_are_refused_on_it() -> None:
    assert runtime.start("gpu") == HERE[0]
    with pytest.raises(WrongUse, match="path list is for --arch cpu; a GPU has the path gather"):
        Simulation(load_scene("curtain"), path="list")
    runtime.start("cpu")


def test_kernels_are_read_with_what_was_read_before() -> None:
    with Simulation(load_scene("curtain", rows=4, columns=5), "list") as simulation:
        simulation.advance_frame()
    hits, misses = source_cache.lookups()
    assert hits > misses > 30


def test_a_mistake_in_a_kernel_is_shown_with_its_line() -> None:
    @ti.kernel
    def wrong():
        print(nowhere)  # noqa: F821

    with pytest.raises(ti.TaichiNameError, match=r"test_runtime\.py(?s:.*)print\(nowhere\).*\n +\^{7}\n") as told:
        wrong()
    assert "line " + str(wrong.__wrapped__.__code__.co_firstlineno + 2) in str(told.value)
