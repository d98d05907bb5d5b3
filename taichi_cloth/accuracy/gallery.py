"""How wrong every solver is on a scene as it is, with contact, wind and folds (`taichi-cloth bench --error --scene`).

There is no closed form: all solvers are judged by the float64 reference (`reference/`), which shares no code with them.
It says how well it is known itself, and up to which frame there is one motion to be right about. A scene without such a
reference is listed with the reason, and not compared with a solver's own finer steps: a force that is wrong would be
wrong in both.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import reference
from ..bench.cases import BUDGETS
from ..bench.report import machine, made, markdown_table, printed_table, wide_console
from ..errors import WrongUse
from ..files import whole_file
from ..mesh.from_scene import particles_of
from ..reference.solution import Solution, distances, solve, without_solution
from ..scene import load_scene, scene_names
from ..scene.model import USUAL, Camera, Look, Scene
from ..scene_stages import unfit_for
from ..simulation import Simulation
from ..solvers import SOLVERS
from ..timing import timed_frame
from .kept import kept

FRAMES = 120
VERLET = "`verlet` has shares of 0…1 for constants: it is wrong by its model too."
# (substeps, iterations) beside the scene's own, the usual ones among them; (1, 1) for methods that take what they need.
SETTINGS = {
    "verlet": ((5, 12), (20, 12)),
    "xpbd": (USUAL["xpbd"], (5, 12), (30, 1), (20, 12)),
    "lines": (USUAL["lines"], (5, 1), (20, 1)),
    "spring": ((1, 1),),
    "rk4": ((1, 1),),
    "projective": (USUAL["projective"], (5, 10)),
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
    rms_uncertainty: float  # of the reference: how far it is from that of twice the step, as a share of the side
    max_uncertainty: float
    points: list[ScenePoint]


def settings(scene: Scene) -> list[tuple[str, int, int]]:
    """What is measured: solver, substeps, iterations; the scene's own first; no method that its cloth cannot have.

    Raises WrongUse for a scene that the reference does not cover.
    """
    if reason := without_solution(scene):
        raise WrongUse(f"{scene.name} has no independent reference: {reason}")
    own, rows = scene.solver, not unfit_for(scene, particles_of(scene)).rows
    names = [name for name in SETTINGS if rows or not SOLVERS[name].needs_rows]
    every = [(name, *pair) for name in names for pair in SETTINGS[name]]
    return list(dict.fromkeys([(own.name, own.substeps, own.iterations), *every]))


def solution(scene: Scene, frames: int) -> Solution:
    """The reference solution of a scene for at most so many frames. Kept on disk."""
    motion = replace(scene, title="", name="", camera=Camera(), look=Look())
    places, coarser = kept(f"{motion} {frames}", Path(reference.__file__).parent, lambda: solve(motion, frames))
    return Solution(places, coarser, particles_of(scene).side)


def measure(scene: Scene, name: str, substeps: int, iterations: int, truth: Solution) -> ScenePoint:
    """One setting up to the horizon."""
    solver = replace(scene.solver, name=name, substeps=substeps, iterations=iterations)
    with Simulation(replace(scene, solver=solver)) as simulation:
        simulation.advance_frame()  # compiles
        simulation.reset()
        ms, places = [], []
        for _ in truth.places:
            ms.append(timed_frame(simulation))
            places.append(simulation.positions())
        away = distances(np.array(places), truth.places) / truth.side
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
    yield f"{scene.name}: the reference"
    truth = solution(scene, FRAMES)
    points = []
    for name, substeps, iterations in settings(scene):
        yield f"{scene.name}: {name} {substeps}×{iterations}"
        points.append(measure(scene, name, substeps, iterations, truth))
    yield SceneErrors(scene.name, truth.horizon, *truth.uncertainty, points)


def left_out() -> dict[str, str]:
    """The shipped scenes without a reference, and why."""
    reasons = {name: without_solution(load_scene(name)) for name in scene_names()}
    return {name: reason for name, reason in reasons.items() if reason}


# -- in print ------------------------------------------------------------------------------------------------------

HEADINGS = ["setting", "ms", "p95", "pictures a second", "error rms", "largest", "strain"]


def share(error: float, uncertainty: float) -> str:
    """An error in % of the side to two digits; one that is below the reference's own uncertainty is not known."""
    return f"{100 * error:.2g}%" if error >= uncertainty else f"< {100 * uncertainty:.2g}%"


def lines(found: SceneErrors) -> list[list[str]]:
    """Rows of text, the heading first."""
    rows = [HEADINGS]
    for p in found.points:
        rate = next((f"{rate}" for rate in BUDGETS if p.p95_ms <= 1000 / rate), "-")
        away = share(p.rms_error, found.rms_uncertainty), share(p.max_error, found.max_uncertainty)
        rows.append([p.setting, f"{p.median_ms:.2f}", f"{p.p95_ms:.2f}", rate, *away, f"{p.max_strain:.1%}"])
    return rows


def heading(found: SceneErrors) -> str:
    frames = "frame 1" if found.horizon == 1 else f"frames 1 to {found.horizon}"
    return (
        f"Of the longer side, over {frames}. The reference is known to {100 * found.rms_uncertainty:.1g}% rms,"
        f" {100 * found.max_uncertainty:.1g}% at most."
    )


def print_report(all_found: Sequence[SceneErrors]) -> None:
    console = wide_console()
    for found in all_found:
        console.print(f"{found.scene}: {heading(found)}", soft_wrap=True)
        console.print(printed_table(lines(found)))
    if any("verlet" in point.setting for found in all_found for point in found.points):
        console.print(VERLET, soft_wrap=True)
    console.print(" · ".join(machine().values()), soft_wrap=True)


def report(all_found: Sequence[SceneErrors]) -> dict[str, Any]:
    """All there is, for JSON."""
    return {**made(), "scenes": [asdict(found) for found in all_found], "left_out": left_out()}


def write_json(path: Path, all_found: Sequence[SceneErrors]) -> None:
    """Raises OSError."""
    with whole_file(path) as file:
        file.write(json.dumps(report(all_found), indent=1).encode())


def page(told: dict[str, Any]) -> str:
    """The document of a report: a chapter for each scene."""
    text = [
        "# Scenes: how wrong each solver is",
        "",
        "`taichi-cloth bench --error --scene` wrote this on:",
        "",
        " · ".join([*told["machine"].values(), told["date"]]),
        "",
        "Errors are distances from the float64 reference (`taichi_cloth/reference/`), which shares no code with the",
        "solvers: root mean square, and the largest of any particle in any frame. They count while a start 1e-9 of",
        "the side off has come less than 1e-7 off, and before a strain limit acts or a thread tears. `<` is below what",
        f"the reference itself is known to: its distance from that of twice the step. {VERLET}",
        "",
    ]
    if told["left_out"]:
        text += ["Scenes without such a reference:", ""]
        text += [f"- `{name}`: {reason}." for name, reason in told["left_out"].items()] + [""]
    for one in told["scenes"]:
        found = SceneErrors(**{**one, "points": [ScenePoint(**point) for point in one["points"]]})
        text += [f"## {found.scene}", "", heading(found), "", *markdown_table(lines(found)), ""]
    return "\n".join(text)


def write_markdown(path: Path, all_found: Sequence[SceneErrors]) -> None:
    """Raises OSError."""
    with whole_file(path) as file:
        file.write(page(report(all_found)).encode())
