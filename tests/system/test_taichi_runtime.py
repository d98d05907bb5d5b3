"""Starting Taichi on the available backends, and errors for the others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import Scene
from taichi_cloth.scene.schema import Cloth, SelfCollision, Solver
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system import kernel_parsing
from taichi_cloth.system import taichi_runtime as runtime
from taichi_cloth.system.errors import UsageError

AVAILABLE = [a for a in ("cuda", "vulkan", "metal") if ti.lang.misc.is_arch_supported(getattr(ti, a))]
MISSING = [a for a in ("cuda", "vulkan", "metal") if a not in AVAILABLE]


@pytest.mark.parametrize("arch", MISSING)
def test_a_missing_arch_is_refused_and_not_replaced(arch: str) -> None:
    with pytest.raises(UsageError, match=f"arch {arch} is not available: this machine has cpu"):
        runtime.start(arch)
    done = subprocess.run(
        [sys.executable, "-m", "taichi_cloth", "render", "curtain", "--frames", "1", "--arch", arch],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [f"taichi-cloth: arch {arch} is not available: this machine has {archs()}"]


def archs() -> str:
    return ", ".join(["cpu", *AVAILABLE])


@pytest.mark.parametrize(
    "solver",
    ["verlet", "lines", *(pytest.param(s, marks=pytest.mark.long) for s in ("xpbd", "explicit", "rk4", "implicit"))],
)
@pytest.mark.parametrize("arch", AVAILABLE)
def test_every_available_arch_gives_the_same_motion(arch: str, solver: str) -> None:
    """For example the software Vulkan of Mesa, or a GPU."""
    scene = load_scene("curtain", rows=8, columns=10, substeps=2, iterations=3, solver=solver)
    ends = []
    for name in ("cpu", arch):
        assert runtime.start(name) == name
        with Simulation(scene, "serial" if name == "cpu" else None) as simulation:
            assert simulation.solver.layout_name == ("serial" if name == "cpu" else "parallel")
            for _ in range(5):
                simulation.step()
            ends.append(simulation.positions())
    runtime.start("cpu")
    assert ends[1] == pytest.approx(ends[0], abs=1e-4)


@pytest.mark.parametrize("arch", AVAILABLE)
def test_self_collision_gives_the_same_motion_on_every_arch_or_is_refused(arch: str) -> None:
    layers = Cloth(
        rows=12, columns=12, center=(0, 0.08, 0), rotation=(-80, 0, 0), pins=(), layers=2, layer_spacing=0.04
    )
    scene = Scene(cloth=layers, solver=Solver("verlet", 2, 3), self_collision=SelfCollision(thickness=0.05))

    def end(arch: str, layout: str | None) -> np.ndarray:
        assert runtime.start(arch) == arch
        with Simulation(scene, layout) as simulation:
            simulation.step(5)
            return simulation.positions()

    expected = end("cpu", "serial")
    try:
        assert end(arch, None) == pytest.approx(expected, abs=1e-4)
    except UsageError as error:
        assert arch == "vulkan"
        assert str(error) == (
            "self-collision does not work with this Vulkan driver, which leaves loops with atomic sums too early; use"
            " --arch cpu"
        )
    finally:
        runtime.start("cpu")


@pytest.mark.skipif(not AVAILABLE, reason="no GPU and no Vulkan")
def test_gpu_is_the_first_available_and_refuses_layouts_for_the_cpu() -> None:
    assert runtime.start("gpu") == AVAILABLE[0]
    with pytest.raises(UsageError, match="layout serial is for --arch cpu; a GPU uses parallel"):
        Simulation(load_scene("curtain"), layout="serial")
    runtime.start("cpu")


def test_an_unknown_option_is_refused_and_taichi_starts_again() -> None:
    with pytest.raises(ValueError, match=r"ti\.init: debg"):
        runtime.start(debg=True)
    assert runtime.start(debug=False) == "cpu"


@pytest.mark.parametrize(("option", "kind", "usual"), [("default_fp", ti.f64, "f32"), ("default_ip", ti.i64, "i32")])
def test_other_default_types_of_numbers_are_refused(option: str, kind: object, usual: str) -> None:
    """Kernels of this package rely on them: with others, Taichi ends the process."""
    message = rf"{option} must be ti\.{usual}"
    with pytest.raises(UsageError, match=message):
        runtime.start(**{option: kind})
    assert runtime.running_arch() == "cpu"  # the program that ran before still runs
    runtime.stop()
    try:
        ti.init(ti.cpu, log_level=ti.ERROR, **{option: kind})
        with pytest.raises(UsageError, match=message):
            runtime.start_if_needed()
    finally:
        ti.reset()
        runtime.start("cpu")
    assert runtime.start(**{option: getattr(ti, usual)}) == "cpu"


SCRIPT = """
import taichi as ti
import taichi_cloth as tc

simulation = tc.Simulation(tc.load_scene("curtain", rows=4, columns=5))

@ti.kernel
def twice(a: ti.f32) -> ti.f32:
    return a * 2

@ti.data_oriented
class Holder:
    @ti.kernel
    def three(self) -> ti.f32:
        return 3.0

print(twice(2.0), Holder().three())
"""


def test_a_script_has_kernels_of_its_own_after_a_simulation(tmp_path: Path) -> None:
    """At the top level of a script, no frame lies below the line with the decorator."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split()[-2:] == ["4.0", "3.0"]


def test_kernel_sources_are_found_in_the_cache() -> None:
    with Simulation(load_scene("curtain", rows=4, columns=5), "serial") as simulation:
        simulation.step()
    hits, misses = kernel_parsing.cache_hits_and_misses()
    assert hits > misses > 30


def test_an_error_in_a_kernel_shows_its_line() -> None:
    @ti.kernel
    def wrong():
        print(nowhere)  # type: ignore[name-defined]  # noqa: F821

    shown = r"test_taichi_runtime\.py(?s:.*)print\(nowhere\).*\n +\^{7}\n"
    with pytest.raises(ti.TaichiNameError, match=shown) as error:
        wrong()
    assert "line " + str(wrong.__wrapped__.__code__.co_firstlineno + 2) in str(error.value)


REPLACED_STDOUT = """
import io, os, sys
sys.stdout = io.StringIO()  # as notebooks do
import taichi_cloth as tc
tc.Simulation
assert sys.stdout.getvalue() == ""
assert os.environ.get("TI_LOG_LEVEL") == {level!r}
"""


@pytest.mark.parametrize("level", [None, "info"])
def test_nothing_is_printed_where_stdout_is_replaced(level: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    if level is not None:
        monkeypatch.setenv("TI_LOG_LEVEL", level)
    code = REPLACED_STDOUT.format(level=level)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert ("Graphical python shell" in done.stdout + done.stderr) == (level is not None)  # as the user has chosen
    assert level is not None or done.stdout + done.stderr == ""
