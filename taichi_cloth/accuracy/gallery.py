"""How wrong every solver is on a scene as it is, with contact, wind and folds (`taichi-cloth bench --error --scene`).

There is no closed form: the truth is `spring` with many times the substeps it needs, and how far two such runs are
apart says how true it is. Errors count up to the horizon, behind which a hair's difference at the start has become
another motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..bench.cases import BUDGETS
from ..bench.report import machine, markdown_table, printed_table, wide_console
from ..errors import WrongUse
from ..files import whole_file
from ..mesh.from_scene import particles_of
from ..scene.model import Scene, Solver, keys_of
from ..scene_stages import unfit_for
from ..simulation import Simulation
from ..solvers import SOLVERS
from ..timing import timed_frame
from .ablate import Floats, apart, horizon, motion

FRAMES = 120
FINEST = 8  # times the substeps that `spring` needs, as far as a scene may have so many
MOST_SUBSTEPS = int(keys_of(Solver)["substeps"].high or 0)
# (substeps, iterations) beside the scene's own; (1, 1) for methods that take what they need.
SETTINGS = {
    "verlet": ((5, 12), (20, 12)),
    "xpbd": ((5, 12), (30, 1), (20, 12)),
    "lines": ((5, 1), (20, 1)),
    "spring": ((1, 1),),
    "rk4": ((1, 1),),
    "projective": ((5, 10),),
}


@dataclass(frozen=True)
class ScenePoint:
    """One setting on one scene."""

    scene: str
    setting: str
    median_ms: float  # of a frame
    p95_ms: float
    rms_error: float  # of all particles up to the horizon, as a share of the longer side
    max_error: float
    max_strain: float  # at the horizon


@dataclass(frozen=True)
class SceneErrors:
    """All settings of a scene."""

    scene: str
    horizon: int  # [frames]
    finer: int  # times the substeps that `spring` needs were taken for the truth
    doubt: float  # how far the truth is from one with half its substeps, root mean square, as a share of the side
    points: list[ScenePoint]


def settings(scene: Scene) -> list[tuple[str, int, int]]:
    """What is measured: solver, substeps, iterations; the scene's own first; no method that its cloth cannot have.

    Raises WrongUse for a cloth that tears.
    """
    if scene.tear is not None:
        raise WrongUse(f"{scene.name}: a cloth that tears has no motion that finer steps come nearer to")
    own, rows = scene.solver, not unfit_for(scene, particles_of(scene)).rows
    names = [name for name in SETTINGS if rows or not SOLVERS[name].needs_rows]
    every = [(name, *pair) for name in names for pair in SETTINGS[name]]
    return list(dict.fromkeys([(own.name, own.substeps, own.iterations), *every]))


def converged(scene: Scene) -> tuple[Floats, int, float]:
    """Places after each frame up to the horizon, (frames, N, 3) [m], how much finer than needed, and `doubt`."""
    runs = []
    with Simulation(replace(scene, solver=replace(scene.solver, name="spring", substeps=1))) as simulation:
        needed = simulation.substeps
        plain, _ = motion(simulation, FRAMES)
        told = horizon(simulation, plain)
        finer = max(2, min(FINEST, MOST_SUBSTEPS // needed))
        for times in (finer, finer // 2):
            simulation.reset()
            simulation.set("substeps", times * needed)
            runs.append(motion(simulation, told)[0])
        doubt = float(np.sqrt((apart(*runs) ** 2).mean())) / simulation.topology.side
    return runs[0], finer, doubt


def measure(scene: Scene, name: str, substeps: int, iterations: int, truth: Floats) -> ScenePoint:
    """One setting up to the horizon."""
    solver = replace(scene.solver, name=name, substeps=substeps, iterations=iterations)
    with Simulation(replace(scene, solver=solver)) as simulation:
        simulation.advance_frame()  # compiles
        simulation.reset()
        ms, places = [], []
        for _ in truth:
            ms.append(timed_frame(simulation))
            places.append(simulation.positions())
        away = np.linalg.norm(np.array(places) - truth, axis=2) / simulation.topology.side
        return ScenePoint(
            scene=scene.name,
            setting=simulation.method.partition(" · ")[0],
            median_ms=float(np.median(ms)),
            p95_ms=float(np.percentile(ms, 95)),
            rms_error=float(np.sqrt((away**2).mean())),
            max_error=float(away.max()),
            max_strain=simulation.measure().max_strain,
        )


def errors(scene: Scene) -> Iterator[str | SceneErrors]:
    """What is being done, step by step, and at last the result."""
    yield f"{scene.name}: the converged motion"
    truth, finer, doubt = converged(scene)
    points = []
    for name, substeps, iterations in settings(scene):
        yield f"{scene.name}: {name} {substeps}×{iterations}"
        points.append(measure(scene, name, substeps, iterations, truth))
    yield SceneErrors(scene.name, len(truth), finer, doubt, points)


# -- in print ------------------------------------------------------------------------------------------------------

HEADINGS = ["setting", "ms", "p95", "pictures a second", "error rms", "largest", "strain"]


def lines(found: SceneErrors) -> list[list[str]]:
    """Rows of text, the heading first."""
    rows = [HEADINGS]
    for p in found.points:
        rate = next((f"{rate}" for rate in BUDGETS if p.p95_ms <= 1000 / rate), "-")
        numbers = (f"{p.median_ms:.2f}", f"{p.p95_ms:.2f}", rate)
        rows.append([p.setting, *numbers, f"{p.rms_error:.3%}", f"{p.max_error:.2%}", f"{p.max_strain:.1%}"])
    return rows


def heading(found: SceneErrors) -> str:
    return (
        f"Up to frame {found.horizon}, of the longer side. The truth is `spring` with {found.finer} times the substeps"
        f" it needs; with {found.finer // 2} times it is {found.doubt:.2%} away."
    )


def print_report(all_found: Sequence[SceneErrors]) -> None:
    console = wide_console()
    for found in all_found:
        console.print(f"{found.scene}: {heading(found)}", soft_wrap=True)
        console.print(printed_table(lines(found)))
    if any("verlet" in point.setting for found in all_found for point in found.points):
        console.print("verlet has shares of 0…1 for constants: it is wrong by its model too", soft_wrap=True)
    console.print(" · ".join(machine().values()), soft_wrap=True)


def write_markdown(path: Path, all_found: Sequence[SceneErrors]) -> None:
    """A chapter for each scene. Raises OSError."""
    text = [
        "# Scenes: how wrong each solver is",
        "",
        "`taichi-cloth bench --error --scene` wrote this on:",
        "",
        " · ".join(machine().values()),
        "",
        "`verlet` has shares of 0…1 for constants: it is wrong by its model too.",
        "",
    ]
    for found in all_found:
        text += [f"## {found.scene}", "", heading(found), "", *markdown_table(lines(found)), ""]
    with whole_file(path) as file:
        file.write("\n".join(text).encode())
