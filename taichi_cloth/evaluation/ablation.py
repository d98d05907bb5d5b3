"""Ablation: what each feature of a scene costs, and what it changes (`taichi-cloth ablate`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.scene_loader import load_scene
from ..geometry.topology import energies
from ..scene import scene_names
from ..scene.overrides import removable_sections, scene_without
from ..scene.schema import COLLIDERS, Scene
from ..simulation.copies import feature_cost
from ..simulation.simulation import Simulation
from ..solvers import SOLVERS
from ..system.console import commit_of, machine, markdown_table, new_file, printed_table, wide_console
from .bench.scene_error import digest_of

Floats = NDArray[np.float64]

PERTURBATION = 1e-6  # size of a perturbation of the start, as a share of the side
CHAOS_GROWTH = 100.0  # growth of the perturbation at which two runs can no longer be compared
# Features of colliders: name, scene key, and the value that turns the feature off.
CONTACT: tuple[tuple[str, str, Any], ...] = (
    ("friction", "friction", 0.0),
    ("continuous", "continuous", False),
    ("triangles", "collide_with", "particles"),
    ("responses", "response", "projection"),
)
TIMED_FRAMES, TIMED_SECONDS = 40, 2.0  # at most, for each comparison of frame times


@dataclass(frozen=True)
class Ablation:
    """The effect of removing one feature from a scene."""

    feature: str
    """Its name."""
    saved_ms: float
    """Frame time saved [ms]."""
    change: float
    """Root mean square change of positions up to the horizon, as a share of the longer side."""
    outline: float
    """Mean change of the area inside the cloth's edge seen from above, up to the horizon, as a share of the sheet."""
    kinetic: float
    """Relative change of the mean kinetic energy."""


@dataclass(frozen=True)
class Ablations:
    """All ablations of a scene."""

    scene: str
    ms: float
    """Frame time with all features [ms]."""
    frames: int
    """Number of frames compared: up to the horizon."""
    rows: list[Ablation]
    digest: str = ""
    """Digest of the scene (see `digest_of`)."""


def ablated_scenes(scene: Scene) -> dict[str, Scene]:
    """Return the scene without each of its features in turn, by the name of the feature."""
    section = SOLVERS[scene.solver.name].info.stiffness_section
    springs = getattr(scene, section)
    found = {}
    has_springs = section == "verlet" or scene.fabric.model == "springs"
    for family in ("shear", "bend") if has_springs else ():
        key = "bend_spring" if (section, family) == ("fabric", "bend") else family
        if getattr(springs, key) > 0:
            found[family] = replace(scene, **{section: replace(springs, **{key: 0.0})})
    if section == "fabric":
        if scene.fabric.bending_stiffness > 0:
            found["bending"] = replace(scene, fabric=replace(scene.fabric, bending_stiffness=0.0, bending_weft=0.0))
        if scene.fabric.damping_time > 0:
            found["spring_damping"] = replace(scene, fabric=replace(scene.fabric, damping_time=0.0))
    if scene.solver.damping > 0:
        found["damping"] = replace(scene, solver=replace(scene.solver, damping=0.0))
    if scene.wind is not None:
        found["wind"] = scene_without(scene, ["wind"])
        if scene.wind.turbulence > 0:
            found["gusts"] = replace(scene, wind=replace(scene.wind, turbulence=0.0))
        if scene.wind.lift > 0:
            found["lift"] = replace(scene, wind=replace(scene.wind, lift=0.0))
    for name in removable_sections(scene):
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


# -- comparing two motions ---------------------------------------------------------------------------------------------


def motion(simulation: Simulation, frames: int) -> tuple[Floats, float]:
    """Run some frames. Return the positions after each, (frames, N, 3) [m], and the mean kinetic energy [J]."""
    positions, kinetic = [], []
    for _ in range(frames):
        simulation.step()
        positions.append(simulation.positions())
        kinetic.append(energies(simulation.topology, positions[-1], simulation.velocities(), 0.0)[0])
    return np.array(positions), float(np.mean(kinetic))


def rms_distance(a: Floats, b: Floats) -> Floats:
    """Return the root mean square distance of the particles in each frame [m], (frames,)."""
    distances: Floats = np.sqrt(((a - b) ** 2).sum(axis=2).mean(axis=1))
    return distances


def outlines(positions: Floats, triangles: NDArray[np.integer], layers: int = 1) -> Floats:
    """Return the area inside the edge of each layer seen from above, (frames, layers) [m²]: how far the cloth spreads.

    It is the sum of the signed areas of the triangles: those seen from one side minus those seen from the other.
    `positions`: (frames, N, 3) [m]; `triangles`: (T, 3), one layer after another.
    """
    a, b, c = (positions[:, triangles[:, k]][..., [0, 2]] for k in range(3))
    doubled = (b - a)[..., 0] * (c - a)[..., 1] - (b - a)[..., 1] * (c - a)[..., 0]
    areas: Floats = np.abs(doubled.reshape(len(positions), layers, -1).sum(axis=2)) / 2
    return areas


def area(x: Floats, triangles: NDArray[np.integer]) -> float:
    """Return the total area of triangles (T, 3) of points (N, 3) [m²]."""
    a, b, c = x[triangles.T]
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def horizon(simulation: Simulation, unperturbed: Floats) -> int:
    """Return for how many frames, at least 1, a run with a perturbed start stays close to the unperturbed run.

    `unperturbed`: positions of that run from the start, (frames, N, 3) [m].
    """
    side = simulation.topology.longest_side
    simulation.reset()
    start = simulation.topology.start
    free = ~simulation.topology.pinned[:, None]
    simulation.set_state(start + free * np.random.default_rng(1).normal(0.0, PERTURBATION * side, start.shape))
    distances = rms_distance(unperturbed, motion(simulation, len(unperturbed))[0])
    beyond = np.flatnonzero(distances > CHAOS_GROWTH * PERTURBATION * side)
    return max(1, int(beyond[0])) if len(beyond) else len(unperturbed)


def ablate(scene: Scene, frames: int) -> Ablations:
    """Run the scene with all features, with a perturbed start, and without each feature, for `frames` frames each."""
    with Simulation(scene) as full:
        triangles, layers, side = full.topology.triangles, full.topology.layers, full.topology.longest_side
        layer_area = area(full.topology.flat, triangles) / layers
        baseline, kinetic = motion(full, frames)
        compared = horizon(full, baseline)
        rows = []
        all_ms = []
        for feature, variant in ablated_scenes(scene).items():
            with Simulation(variant) as reduced:
                positions, reduced_kinetic = motion(reduced, frames)
                ms, saved_ms = feature_cost(full, reduced, TIMED_FRAMES, TIMED_SECONDS)
            change = sqrt(float((rms_distance(baseline[:compared], positions[:compared]) ** 2).mean())) / side
            areas = (outlines(x[:compared], triangles, layers) for x in (positions, baseline))
            outline = float(np.abs(np.subtract(*areas)).mean()) / layer_area
            rows.append(Ablation(feature, saved_ms, change, outline, reduced_kinetic / kinetic - 1 if kinetic else 0.0))
            all_ms.append(ms)
    return Ablations(scene.name, float(np.median(all_ms)) if all_ms else 0.0, compared, rows, digest_of(scene))


# -- tables ------------------------------------------------------------------------------------------------------------


def table(found: Ablations) -> list[list[str]]:
    """Return the rows of the table as text, the heading first."""
    lines = [["without", "ms saved", "position change", "outline change", "kinetic energy"]]
    for row in found.rows:
        shares = f"{row.change:.2%}", f"{row.outline:.2%}", f"{row.kinetic:+.1%}"
        lines.append([row.feature, f"{row.saved_ms:+.3f}", *shares])
    return lines


EXPLANATION = f"""\
Each row is the scene without one feature. The motions are compared up to the last frame, or up to the frame in which a
perturbation of the start by {PERTURBATION:g} of the side has grown {CHAOS_GROWTH:g} times. ms saved: difference of the
frame times. Position change: root mean square, as a share of the side. Outline change: mean change of the area inside
the edge of the cloth seen from above, as a share of its area. Kinetic energy: change of its mean over all frames."""


def heading(found: Ablations) -> str:
    """Return the line above the table of a scene."""
    return f"{found.ms:.2f} ms a frame. Compared up to frame {found.frames}."


def print_tables(all_found: Sequence[Ablations]) -> None:
    """Print a line and a table for each scene, and what the columns mean."""
    console = wide_console()
    for found in all_found:
        console.print(f"{found.scene}: {heading(found)}", soft_wrap=True)
        console.print(printed_table(table(found)))
    console.print(EXPLANATION, soft_wrap=True)


@dataclass(frozen=True)
class Run:
    """The ablations of a run, with the machine, the time [UTC] and the commit of the program."""

    machine: dict[str, str]
    date: str
    commit: str
    scenes: list[Ablations]


def this_machine(scenes: list[Ablations]) -> Run:
    """Return a run that ends now, on this machine."""
    return Run(machine(), datetime.now(UTC).strftime("%Y-%m-%d %H:%M"), commit_of(), scenes)


def write_json(path: Path, run: Run) -> None:
    """Write a run. Raises OSError."""
    with new_file(path) as file:
        file.write(json.dumps(asdict(run), indent=1, allow_nan=False).encode())


def write_markdown(path: Path, run: Run) -> None:
    """Write a page with a section for each scene. Raises OSError."""
    lines = ["# Features of the scenes: all rows", "", "Written by `taichi-cloth ablate` on:", ""]
    commit = run.commit[:8] + "+" * run.commit.endswith("+")
    lines += [" · ".join([*run.machine.values(), run.date, f"commit {commit}"]), ""]
    lines += [*EXPLANATION.splitlines(), ""]
    for found in run.scenes:
        title = load_scene(found.scene).title if found.scene in scene_names() else found.scene
        lines += [f"## {found.scene}", "", title, "", heading(found), "", *markdown_table(table(found)), ""]
    with new_file(path) as file:
        file.write("\n".join(lines).encode())
