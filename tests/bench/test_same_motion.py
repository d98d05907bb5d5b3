"""The C programs that `bench` times compute the same motion as the simulation. Nothing is timed."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_cloth.evaluation.bench.cases import Case, native_programs_of, scene_of
from taichi_cloth.scene import Scene
from taichi_cloth.simulation.simulation import Simulation

FLOOR = Path(__file__).resolve().parents[2] / "benchmarks" / "floor" / "floor.py"

# Positions reach 4 m, where float32 rounds by up to 2.4e-7 m, and both programs round each of some hundred
# corrections differently: 6e-6 m after the frames below. An error of 1 % in a spring constant gives 1e-4 m.
ROUNDING = 2e-5  # [m]

CURTAIN = Case("curtain", "verlet", 24, 30, 5, 12, "serial")
COARSE = Case("curtain", "verlet", 5, 10, 1, 2, "serial")  # coarse enough to compare it until the ball has passed
SHEET = Case("sheet", "explicit", 24, 30, 60, 1, "serial")


def load_floor() -> ModuleType:
    spec = importlib.util.spec_from_file_location("floor_same_motion", FLOOR)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


floor = load_floor()
needs_compiler = pytest.mark.skipif(floor.compiler() is None, reason="no C compiler: neither $CC nor cc, gcc, clang")


def without_gusts(scene: Scene) -> Scene:
    """Return the scene without gusts: `relax.c` has only the mean wind."""
    return scene if scene.wind is None else replace(scene, wind=replace(scene.wind, turbulence=0.0))


def in_c(case: Case, substeps: int, frames: int, builds: Path) -> list[NDArray[np.float64]]:
    program = native_programs_of(case).in_c
    numbers = [str(n) for n in (case.rows, case.columns, substeps, case.iterations, frames)]
    done = [
        subprocess.run([*command, *numbers, "dump"], capture_output=True, text=True, check=True, timeout=60)
        for command in floor.commands_of(program, builds)
    ]
    return [np.array(json.loads(run.stdout)["positions"]) for run in done]


def largest_distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(a - b, axis=1).max())


def in_taichi(scene: Scene, frames: int) -> tuple[NDArray[np.float64], int]:
    """Return positions [m] after some frames, and the substeps that were used."""
    with Simulation(scene, "serial") as simulation:
        for _ in range(frames):
            simulation.step()
        return simulation.positions(), simulation.substeps


def from_first(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions relative to the first particle, which is pinned: `explicit.c` has another origin."""
    return x - x[0]


@needs_compiler
@pytest.mark.parametrize(
    ("case", "frames"), [(CURTAIN, 12), (COARSE, 80), (SHEET, 12)], ids=["relax", "relax-ball", "explicit"]
)
def test_c_and_the_simulation_have_equal_motion(case: Case, frames: int, tmp_path: Path) -> None:
    ours, substeps = in_taichi(without_gusts(scene_of(case)), frames)
    found = in_c(case, substeps, frames, tmp_path)
    assert found
    assert max(largest_distance(from_first(ours), from_first(theirs)) for theirs in found) < ROUNDING


def test_the_comparison_detects_wind_ball_and_a_spring_constant() -> None:
    scene = without_gusts(scene_of(COARSE))
    ours, _ = in_taichi(scene, 80)
    assert scene.wind is not None
    others = [
        replace(scene, wind=None),
        replace(scene, spheres=()),
        replace(scene, verlet=replace(scene.verlet, bend=1.01 * scene.verlet.bend)),
    ]
    assert min(largest_distance(ours, in_taichi(other, 80)[0]) for other in others) > ROUNDING
