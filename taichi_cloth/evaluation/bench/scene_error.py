"""Error of every solver on complete scenes, with contact, wind and folds (`taichi-cloth bench --error --scene`).

Such scenes have no closed-form solution. All solvers are compared with the float64 reference solution (`reference/`).
It shares with them the construction of the cloth (masses, rest lengths, constants, bending links, tethers); forces,
steps and contact are its own. It comes with an uncertainty and a horizon: the frame from which the motion is chaotic.
A scene without a reference solution is listed with the reason. It is not compared with a solver's own finer steps: an
error in a force would be in both.

Reference solutions take seconds to compute and are cached on disk.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry.cloth_builder import build_particles
from ...geometry.scene_loader import files_of, load_scene
from ...scene import scene_names
from ...scene.fabric_schema import Look
from ...scene.keys import keys_of, toml_value
from ...scene.schema import Camera, Scene, sections
from ...scene.solver_catalog import SOLVER_CATALOG
from ...simulation.builder import unsupported_by
from ...simulation.copies import timed_frame
from ...simulation.frame_contact import penetration
from ...simulation.simulation import Simulation
from ...solvers import SOLVERS
from ...system.console import machine, markdown_table, new_file, printed_table, wide_console
from ...system.errors import UsageError
from ...system.files import cached
from ..reference.solution import Solution, distances, reason_unsupported, solve, steps_per_frame
from .bench_report import NOT_FINITE, finite, run_info
from .cases import FRAME_RATES

Floats = NDArray[np.float64]

FRAMES = 120
CHAOS = ", beyond which the motion is chaotic: a tiny change of the start has grown a hundredfold"
RATE_NOTE = (
    f"frames/s: the highest of {', '.join(map(str, FRAME_RATES))} that the 95th percentile of the frame time allows."
)
MODEL_NOTE = (
    "Fine settings may keep the same distance to the reference. Contact and tethers of the solvers act once per substep"
    " or iteration. The reference damps springs as `fabric.damping_time` says, which presets of fabrics set; `implicit`"
    " and `verlet` do not, and `explicit` and `rk4` for at most a time that `simulation.warnings` names."
)
VERLET_NOTE = "`verlet` has stiffness 0…1 instead of SI constants: its error includes that of the model."
# (substeps, iterations), measured in addition to the scene's own. They include the defaults of the solvers. Explicit
# solvers raise (1, 1) to what is stable.
SETTINGS = {
    "verlet": ((5, 12), (20, 12)),
    "xpbd": (SOLVER_CATALOG["xpbd"].defaults, (5, 12), (30, 1), (20, 12)),
    "lines": (SOLVER_CATALOG["lines"].defaults, (5, 1), (20, 1)),
    "explicit": ((1, 1),),
    "rk4": ((1, 1),),
    "implicit": (SOLVER_CATALOG["implicit"].defaults, (10, 1), (40, 1)),
}


@dataclass(frozen=True)
class ScenePoint:
    """Frame time and error of one setting on one scene."""

    scene: str
    setting: str
    median_ms: float
    """Median frame time [ms]."""
    p95_ms: float
    """95th percentile of the frame time [ms]."""
    rms_error: float
    """Root mean square over all particles and frames up to the horizon, as a share of the longer side."""
    max_error: float
    """Largest error of a particle in these frames, as a share of the longer side."""
    max_strain: float
    """Largest strain at the horizon."""
    max_penetration: float | None = None
    """Largest depth of a particle in a collider after any of these frames [m]; None in runs that did not measure it."""


@dataclass(frozen=True)
class SceneErrors:
    """Frame time and error of all settings on a scene."""

    scene: str
    horizon: int
    """Number of frames compared."""
    rms_uncertainty: float
    """Root mean square distance of the reference from one with twice the time step, as a share of the longer side."""
    max_uncertainty: float
    """Largest distance of a particle between these two, as a share of the longer side."""
    points: list[ScenePoint]
    digest: str = ""
    """Digest of the scene (see `digest_of`)."""
    measured: str = ""
    """When and at which commit, if a stored report of another run has taken it in."""


def settings(scene: Scene) -> list[tuple[str, int, int]]:
    """Return the settings to measure: solver, substeps, iterations. The scene's own is first.

    Solvers that do not support the cloth are left out. Raises UsageError for a scene without a reference solution.
    """
    if reason := reason_unsupported(scene):
        raise UsageError(f"{scene.name} has no independent reference: {reason}")
    own, has_rows = scene.solver, not unsupported_by(scene, build_particles(scene)).grid_only
    supported = [name for name in SETTINGS if scene.fabric.model in SOLVERS[name].info.models]
    names = [name for name in supported if has_rows or not SOLVERS[name].info.grid_only]
    every = [(name, *pair) for name in names for pair in SETTINGS[name]]
    return list(dict.fromkeys([(own.name, own.substeps, own.iterations), *every]))


def motion_of(scene: Scene) -> Scene:
    """Return the scene without what does not move the cloth: names, camera and look."""
    return replace(scene, title="", name="", camera=Camera(), look=Look())


def digest_of(scene: Scene) -> str:
    """Return a digest of all values that move the cloth, 12 hex digits: results with another are of another scene.

    Keys with their default are left out, so that a new key changes no digest.
    """
    scene, words = motion_of(scene), [f"seed = {scene.seed}"]
    for part in sections().values():
        found, default = getattr(scene, part.name), part.cls()
        for one in found if part.is_array else [found] if found is not None else []:
            names = [name for name in keys_of(part.cls) if getattr(one, name) != getattr(default, name)]
            words += [f"[{part.name}]", *(f"{name} = {toml_value(getattr(one, name))}" for name in names)]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:12]


def solution(scene: Scene, frames: int) -> Solution:
    """Return the reference solution of a scene for up to `frames` frames. It is cached on disk."""
    motion = motion_of(scene)
    positions, coarser = cached(f"solve {motion} {frames}", lambda: solve(motion, frames), files_of(motion))
    return Solution(positions, coarser, build_particles(scene).longest_side)


def timed_run(simulation: Simulation, frames: int) -> tuple[list[float], Floats, float]:
    """Run frames from the start.

    Return the time of each [ms], the positions after each, (frames, N, 3) [m], and the largest penetration [m].
    """
    simulation.step()  # compiles
    simulation.reset()
    ms, positions, depth = [], [], 0.0
    for _ in range(frames):
        ms.append(timed_frame(simulation))
        positions.append(simulation.positions())
        # Penetration is a largest depth, in which a particle without a position does not count.
        depth = max(depth, penetration(simulation, positions[-1])) if np.isfinite(positions[-1]).all() else np.nan
    return ms, np.array(positions), depth


def measure(scene: Scene, name: str, substeps: int, iterations: int, truth: Solution) -> ScenePoint:
    """Measure one setting up to the horizon."""
    solver = replace(scene.solver, name=name, substeps=substeps, iterations=iterations)
    with Simulation(replace(scene, solver=solver)) as simulation:
        ms, positions, depth = timed_run(simulation, len(truth.positions))
        error = distances(positions, truth.positions) / truth.side
        return ScenePoint(
            scene=scene.name,
            setting=simulation.method.partition(" · ")[0],
            median_ms=float(np.median(ms)),
            p95_ms=float(np.percentile(ms, 95)),
            rms_error=float(np.sqrt((error**2).mean())),
            max_error=float(error.max()),
            max_strain=simulation.metrics().max_strain,
            max_penetration=depth,
        )


def errors(scene: Scene) -> Iterator[str | SceneErrors]:
    """Measure all settings of a scene. Yield the name of each step as it begins, then the result."""
    steps = f"{FRAMES} frames of {steps_per_frame(motion_of(scene)):,} steps"
    yield f"{scene.name}: reference solution, up to {steps} (minutes; it is stored for later runs)"
    truth = solution(scene, FRAMES)
    points: list[ScenePoint] = []
    for name, substeps, iterations in settings(scene):
        yield f"{scene.name}: {name} {substeps}×{iterations}"
        point = measure(scene, name, substeps, iterations, truth)
        if point.setting not in [other.setting for other in points]:  # explicit solvers may raise two to one
            points.append(point)
    yield SceneErrors(scene.name, truth.horizon, *truth.uncertainty, points, digest_of(scene))


def scenes_without_reference() -> dict[str, str]:
    """Return the shipped scenes without a reference solution, each with the reason."""
    reasons = {name: reason_unsupported(load_scene(name)) for name in scene_names()}
    return {name: reason for name, reason in reasons.items() if reason}


# -- tables ------------------------------------------------------------------------------------------------------------

HEADINGS = ["setting", "ms", "p95", "frames/s", "RMS error", "max error", "strain", "depth mm"]


def share(error: float, uncertainty: float) -> str:
    """Return an error in % of the side, to two digits; for one below the uncertainty of the reference, that bound."""
    if not np.isfinite(error):  # neither comparison with NaN is true
        return NOT_FINITE
    return f"{100 * error:.2g}%" if error >= uncertainty else f"< {100 * uncertainty:.2g}%"


def lines(found: SceneErrors) -> list[list[str]]:
    """Return the rows of the table as text, the heading first."""
    rows = [HEADINGS]
    for p in found.points:
        rate = next((f"{rate}" for rate in FRAME_RATES if p.p95_ms <= 1000 / rate), "-")
        shares = share(p.rms_error, found.rms_uncertainty), share(p.max_error, found.max_uncertainty)
        times = f"{p.median_ms:.2f}", f"{p.p95_ms:.2f}"
        depth = "-" if p.max_penetration is None else finite(1e3 * p.max_penetration, ".1f")
        rows.append([p.setting, *times, rate, *shares, finite(p.max_strain, ".1%"), depth])
    return rows


def heading(found: SceneErrors) -> str:
    """Return the paragraph above the table: frames compared, and uncertainty of the reference."""
    frames = "frame 1" if found.horizon == 1 else f"frames 1 to {found.horizon}"
    frames += CHAOS if found.horizon < FRAMES else ""
    later = f" Measured {found.measured}." if found.measured else ""
    return (
        f"Errors as shares of the longer side, over {frames}. Uncertainty of the reference:"
        f" {100 * found.rms_uncertainty:.1g}% RMS, {100 * found.max_uncertainty:.1g}% at most.{later}"
    )


def print_report(all_found: Sequence[SceneErrors]) -> None:
    """Print a paragraph and a table for each scene, and the machine in the last line."""
    console = wide_console()
    for found in all_found:
        console.print(f"{found.scene}: {heading(found)}", soft_wrap=True)
        console.print(printed_table(lines(found)))
    for note in (RATE_NOTE, MODEL_NOTE):
        console.print(note, soft_wrap=True)
    if any("verlet" in point.setting for found in all_found for point in found.points):
        console.print(VERLET_NOTE, soft_wrap=True)
    console.print(" · ".join(machine().values()), soft_wrap=True)


def report(all_found: Sequence[SceneErrors]) -> dict[str, object]:
    """Return everything that is stored in the JSON file."""
    return {
        **run_info(),
        "scenes": [asdict(found) for found in all_found],
        "left_out": scenes_without_reference(),
    }


def write_json(path: Path, all_found: Sequence[SceneErrors]) -> None:
    """Write all results as JSON. Raises OSError."""
    with new_file(path) as file:
        file.write(json.dumps(report(all_found), indent=1).encode())


def page(stored: dict[str, Any]) -> str:
    """Return a Markdown page of a report (the content of the JSON file), with a section for each scene."""
    text = [
        "# Scenes: error of each solver",
        "",
        "Written by `taichi-cloth bench --error --scene` on:",
        "",
        " · ".join([*stored["machine"].values(), stored["date"]]),
        "",
        "Errors are distances from the float64 reference solution (`taichi_cloth/evaluation/reference/`): root mean",
        "square, and the largest of any particle in any frame. The reference shares the construction of the cloth with",
        "the solvers (masses, rest lengths, constants); forces, steps and contact are its own. Frames are compared",
        "until a perturbation of the start by 1e-9 of the side has grown to 1e-7, a strain limit acts, or a spring",
        "tears. `<` means below the uncertainty of the reference: its distance from one with twice the time step.",
        VERLET_NOTE,
        RATE_NOTE,
        MODEL_NOTE,
        "",
    ]
    if stored["left_out"]:
        text += ["Scenes without a reference solution:", ""]
        text += [f"- `{name}`: {reason}." for name, reason in stored["left_out"].items()] + [""]
    for one in stored["scenes"]:
        found = SceneErrors(**{**one, "points": [ScenePoint(**point) for point in one["points"]]})
        text += [f"## {found.scene}", "", heading(found), "", *markdown_table(lines(found)), ""]
    return "\n".join(text)


def write_markdown(path: Path, all_found: Sequence[SceneErrors]) -> None:
    """Write the Markdown page. Raises OSError."""
    with new_file(path) as file:
        file.write(page(report(all_found)).encode())
