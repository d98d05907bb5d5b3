"""What each stage of a scene costs, and what would be missing without it (`taichi-cloth ablate`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bench.report import machine, markdown_table, printed_table, wide_console
from ..files import whole_file
from ..measure.cloth import energies
from ..scene import load_scene, scene_names
from ..scene.leave_out import may_do_without, scene_without
from ..scene.model import COLLIDERS, Scene
from ..simulation import Simulation
from ..solvers import SOLVERS
from ..timing import frames as time_frames

Floats = NDArray[np.float64]

NUDGE = 1e-6  # of the side: a start this far off …
GROWN = 100.0  # … that has grown so much says nothing any more about one motion rather than another
# Of colliders: what a scene may do without, the key, and the value that does.
CONTACT: tuple[tuple[str, str, Any], ...] = (
    ("friction", "friction", 0.0),
    ("swept", "swept", False),
    ("triangles", "against", "particles"),
    ("responses", "response", "projection"),
)
TIMED_FRAMES, TIMED_SECONDS = 40, 2.0


@dataclass(frozen=True)
class Ablation:
    """A scene without one of its stages."""

    stage: str
    less_ms: float  # that a frame takes
    change: float  # of the places, root mean square up to the horizon, as a share of the longer side
    outline: float  # of the area inside the edge seen from above, mean up to the horizon, as a share of the sheet
    kinetic: float  # of the kinetic energy, as a share


@dataclass(frozen=True)
class Ablations:
    """All of a scene."""

    scene: str
    ms: float  # of a frame with all stages
    frames: int  # compared: up to the horizon
    rows: list[Ablation]


def without(scene: Scene) -> dict[str, Scene]:
    """The scene without each of what it names, by the name of the stage."""
    section = SOLVERS[scene.solver.name].springs
    springs = getattr(scene, section)
    found = {}
    for family in ("shear", "bend"):
        if getattr(springs, family) > 0:
            found[family] = replace(scene, **{section: replace(springs, **{family: 0.0})})
    if section == "fabric":
        if scene.fabric.bending > 0:
            found["bending"] = replace(scene, fabric=replace(scene.fabric, bending=0.0))
        if scene.fabric.damping_time > 0:
            found["dashpots"] = replace(scene, fabric=replace(scene.fabric, damping_time=0.0))
    if scene.solver.damping > 0:
        found["damping"] = replace(scene, solver=replace(scene.solver, damping=0.0))
    if scene.wind is not None:
        found["wind"] = scene_without(scene, ["wind"])
        if scene.wind.turbulence > 0:
            found["gusts"] = replace(scene, wind=replace(scene.wind, turbulence=0.0))
        if scene.wind.lift > 0:
            found["lift"] = replace(scene, wind=replace(scene.wind, lift=0.0))
    for name in may_do_without(scene):
        found.setdefault(name, scene_without(scene, [name]))
    for name, key, off in CONTACT:
        changed: dict[str, Any] = {
            n: tuple(replace(one, **{key: off}) if hasattr(one, key) else one for one in getattr(scene, n))
            for n in COLLIDERS
        }
        if scene.ground and hasattr(scene.ground, key):
            changed["ground"] = replace(scene.ground, **{key: off})
        if replace(scene, **changed) != scene:
            found[name] = replace(scene, **changed)
    return found


def motion(simulation: Simulation, frames: int) -> tuple[Floats, float]:
    """Places after each frame, (frames, N, 3) [m], and the mean kinetic energy [J]."""
    places, kinetic = [], []
    for _ in range(frames):
        simulation.advance_frame()
        places.append(simulation.positions())
        kinetic.append(energies(simulation.topology, places[-1], simulation.velocities(), 0.0)[0])
    return np.array(places), float(np.mean(kinetic))


def apart(a: Floats, b: Floats) -> Floats:
    """Root mean square distance of the particles, frame by frame [m]."""
    distances: Floats = np.sqrt(((a - b) ** 2).sum(axis=2).mean(axis=1))
    return distances


def outlines(places: Floats, triangles: NDArray[np.integer], sheets: int = 1) -> Floats:
    """Area inside the edge of each sheet from above, frame by frame [m²], (frames, sheets): how far it spreads.

    That of its triangles (T, 3), one sheet after another, seen from one side less that of those seen from the other.
    """
    a, b, c = (places[:, triangles[:, k]][..., [0, 2]] for k in range(3))
    seen = (b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0]
    areas: Floats = np.abs(seen.reshape(len(places), sheets, -1).sum(axis=2)) / 2
    return areas


def area(x: Floats, triangles: NDArray[np.integer]) -> float:
    """Of all triangles (T, 3) of points (N, 3) [m²]."""
    a, b, c = x[triangles.T]
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def horizon(whole: Simulation, plain: Floats) -> int:
    """How many frames of a run from the start, `plain`, say something: a start a hair off goes the same way so long."""
    side = whole.topology.side
    whole.reset()
    start = whole.topology.start
    free = ~whole.topology.pinned[:, None]
    whole.place(start + free * np.random.default_rng(1).normal(0.0, NUDGE * side, start.shape))
    off = apart(plain, motion(whole, len(plain))[0])
    far = np.flatnonzero(off > GROWN * NUDGE * side)
    return max(1, int(far[0])) if len(far) else len(plain)


def ablate(scene: Scene, frames: int) -> Ablations:
    """Runs the scene as it is, a hair off, and without each stage in turn; compares at most so many frames."""
    with Simulation(scene) as whole:
        triangles, sheets, side = whole.topology.triangles, whole.topology.sheets, whole.topology.side
        sheet = area(whole.topology.flat, triangles) / sheets
        plain, kinetic = motion(whole, frames)
        told = horizon(whole, plain)
        rows = []
        all_ms = []
        for stage, variant in without(scene).items():
            with Simulation(variant) as other:
                places, moving = motion(other, frames)
                ms, less = (float(np.median(t)) for t in time_frames([whole, other], TIMED_FRAMES, TIMED_SECONDS))
            change = sqrt(float((apart(plain[:told], places[:told]) ** 2).mean())) / side
            spreads = (outlines(x[:told], triangles, sheets) for x in (places, plain))
            outline = float(np.abs(np.subtract(*spreads)).mean()) / sheet
            rows.append(Ablation(stage, ms - less, change, outline, moving / kinetic - 1 if kinetic else 0.0))
            all_ms.append(ms)
    return Ablations(scene.name, float(np.median(all_ms)) if all_ms else 0.0, told, rows)


def table(found: Ablations) -> list[list[str]]:
    """Lines of text, the heading first."""
    lines = [["without", "ms less", "places change by", "outline", "kinetic energy"]]
    for row in found.rows:
        shares = f"{row.change:.2%}", f"{row.outline:.2%}", f"{row.kinetic:+.1%}"
        lines.append([row.stage, f"{row.less_ms:+.3f}", *shares])
    return lines


def heading(found: Ablations) -> str:
    """What the table belongs to."""
    return (
        f"{found.ms:.2f} ms a frame. Places: root mean square of the side up to frame {found.frames}, when a start"
        f" {NUDGE:g} of the side off has grown {GROWN:g} times or the run ends. Outline: change of the area inside the"
        " sheet's edge, seen from above, till then, of its whole area. Kinetic energy: mean of the whole run."
    )


def print_tables(all_found: Sequence[Ablations]) -> None:
    console = wide_console()
    for found in all_found:
        console.print(f"{found.scene}: {heading(found)}", soft_wrap=True)
        console.print(printed_table(table(found)))


def write_markdown(path: Path, all_found: Sequence[Ablations]) -> None:
    """A chapter for each scene. Raises OSError."""
    lines = ["# Scenes: what each stage is there for", "", "`taichi-cloth ablate` wrote this on:", ""]
    lines += [" · ".join(machine().values()), ""]
    for found in all_found:
        title = load_scene(found.scene).title if found.scene in scene_names() else found.scene
        lines += [f"## {found.scene}", "", title, "", heading(found), "", *markdown_table(table(found)), ""]
    with whole_file(path) as file:
        file.write("\n".join(lines).encode())
