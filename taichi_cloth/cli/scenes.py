"""The commands `list`, `check` and `schema`: shipped scenes, mistakes and costs of scene files, and all scene keys.

Also the lines about its scene that every run prints.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..scene import Scene, key_table, scene_names
from ..scene.fabric_schema import PRESET_NAMES
from ..scene.overrides import removable_sections, scene_without
from ..scene.presets import Preset, load_preset
from ..scene.schema import FRAME_SECONDS, sections
from ..scene.solver_catalog import SOLVER_CATALOG
from ..system import taichi_runtime as runtime
from ..system.errors import UsageError, choose_from
from .program import Command, changes_of, variant_options

if TYPE_CHECKING:
    from ..geometry.topology import Topology
    from ..simulation.simulation import Simulation

SLOW_FRAME = 2.0  # [s] from which the time of a frame is printed before it runs: it cannot be interrupted
MAX_TIMED_MS = 20_000.0  # [ms] estimated frame time above which `check --time` does not run a scene


def add_commands(command: Command) -> None:
    """Add the commands `list`, `check` and `schema`."""
    listing = command("list", list_scenes, "list the shipped scenes", "list")
    instead = listing.add_mutually_exclusive_group()
    instead.add_argument(
        "--presets", action="store_true", help="list the shipped fabrics instead, with their constants"
    )
    instead.add_argument("--solvers", action="store_true", help="list the solvers instead")

    check = command(
        "check",
        check_files,
        "report all mistakes in scene files, and what a frame of a valid one costs",
        "check my_scene.toml curtain",
    )
    check.add_argument("files", nargs="+", metavar="FILE", help="TOML files or shipped scenes")
    variant_options(check)
    check.add_argument(
        "--time", action="store_true", help="run frames and measure their time, instead of estimating it"
    )
    schema = command("schema", print_schema, "list scene keys with default, unit and range", "schema self_collision")
    schema.add_argument("section", nargs="?", metavar="SECTION", help="section of a scene file (default: all)")


def list_scenes(args: argparse.Namespace) -> int:
    """Run the command `list`: print one line per scene or fabric."""
    from ..geometry.cloth_builder import build_topology
    from ..geometry.scene_loader import load_scene

    if args.presets:
        for name in PRESET_NAMES:
            print("\n    ".join(lines_of_preset(load_preset(name))))
        print("docs/presets.md has the source of each number, and the rows of `validate` that a fabric is in")
        return 0
    if args.solvers:
        for name, info in SOLVER_CATALOG.items():
            print(f"{name:9}  {info.summary}")
        return 0
    names = scene_names()
    width = max(map(len, names))
    for name in names:
        scene = load_scene(name)
        topology = build_topology(scene, SOLVER_CATALOG[scene.solver.name].stiffness_section)
        unfinished = left_unfinished(scene, topology, scene.solver.substeps)
        print(f"{name:{width}}  {scene.title}{' · not converged' if unfinished else ''}")
    print("not converged: more iterations or substeps bring the cloth closer to its fabric; `check NAME` says how far")
    return 0


def lines_of_preset(fabric: Preset) -> tuple[str, str, str]:
    """Return a line with the title of a fabric, one with its constants and one with the kinds of their sources."""
    bending = " and ".join(f"{value:.2g}" for value in (fabric.bending, fabric.bending_weft) if value)
    kinds: dict[str, list[str]] = {}
    for key, source in fabric.sources.items():
        kinds.setdefault(source.split()[0].rstrip(":"), []).append(key.replace("_", " "))
    projected = (
        "" if fabric.measured_tensor is None else "; the tensor, not positive definite as measured, is projected"
    )
    return (
        f"{fabric.name:18}  {fabric.title}",
        f"{fabric.area_density:.4g} kg/m²; warp {fabric.warp:.5g}, weft {fabric.weft:.5g}, bias {fabric.bias:.5g} N/m;"
        f" bending {bending} N·m",
        "; ".join(f"{kind}: {', '.join(keys)}" for kind, keys in kinds.items() if kind != "chosen") + projected,
    )


def left_unfinished(scene: Scene, topology: Topology, substeps: int) -> str:
    """Return the line of a run's summary about iterations that end too early, or empty. It simulates nothing."""
    from ..simulation.convergence import unconverged

    return unconverged(scene, topology, FRAME_SECONDS / substeps, scene.solver.iterations)


def check_files(args: argparse.Namespace) -> int:
    """Run the command `check`. Raises UsageError with the number of mistakes."""
    from ..system.console import count_noun

    if args.time:
        runtime.start("cpu")
    changes = changes_of(args)
    found = [check_file(file, changes, args.without, timed=args.time) for file in args.files]
    if wrong := [count for count in found if count]:
        files = f" in {len(wrong)} of {len(found)} files" if len(found) > 1 else ""
        raise UsageError(f"{count_noun(sum(wrong), 'mistake')}{files}")
    return 0


def check_file(file: str, changes: dict[str, object], without: list[str], *, timed: bool) -> int:
    """Print a line for each mistake of a scene, or one about a valid scene. Return the number of mistakes.

    `changes`: values by key. `without`: features to leave out. They apply to a scene that is valid without them, as in
    a run, and only the first mistake in them is found.
    """
    from ..geometry.scene_loader import load_scene, load_with_mistakes

    scene, mistakes = load_with_mistakes(file)
    lines = []
    if scene and not mistakes:
        with mistakes.collect():
            scene = scene_without(load_scene(file, **changes) if changes else scene, without)
            lines = [f"{file}: valid · {describe(scene, timed=timed)}"]
    for line in lines or mistakes:
        print(line, flush=True)
    return len(mistakes)


def describe(scene: Scene, *, timed: bool) -> str:
    """Return what a scene has and what a frame of it costs, in one line. Raises UsageError if it cannot run.

    With `timed`, frames of it are run.
    """
    from ..geometry.cloth_builder import build_topology, component_count, model_of, particle_count_text
    from ..simulation.builder import keys_without_effect, stiffer_by_long_cells, unusual, unusual_values
    from ..simulation.convergence import coarse_for_folds
    from ..simulation.error_estimate import SAMPLE, cost_of
    from ..system.console import count_noun

    cost = cost_of(scene)
    pieces = component_count(scene)
    particles = f"{particle_count_text(scene)} particles" + (f" in {pieces} pieces" if pieces > 1 else "")
    size = "" if scene.cloth.file else f"{scene.cloth.width:g}×{scene.cloth.height:g} m"
    is_large, pins, memory, unfinished, coarse = cost.particles > SAMPLE**2, "", "", "", ""
    section = SOLVER_CATALOG[scene.solver.name].stiffness_section
    model = model_of(scene, section)
    springs = "springs" if model == "springs" else f"edges of a {model}"
    counts = (cost.springs, springs), (cost.bending_links, "bending links")
    springs = " and ".join(
        f"about {two_digits(count / 1e6)} million {what}" if is_large else f"{count:,} {what}"
        for count, what in counts
        if count
    )
    stiffer = stiffer_by_long_cells(scene) if model == "springs" and section == "fabric" else ""
    if is_large:
        memory = f"about {cost.bytes / 1e9:.1f} GB of memory"
        notes = tuple(unusual_values(scene))
    else:
        topology = build_topology(scene, section)
        unfinished, notes = left_unfinished(scene, topology, cost.substeps), unusual(scene, topology)
        coarse = coarse_for_folds(scene, topology) if section == "fabric" else ""
        pins = count_noun(int(topology.pinned.sum()), "pin")
        if scene.cloth.file:
            extent = topology.start.max(axis=0) - topology.start.min(axis=0)
            size = "×".join(f"{side:.2g}" for side in extent) + " m"
    if timed and cost.ms <= MAX_TIMED_MS:
        time = f"{frame_time(measured_ms(scene))} (measured)"
    else:
        time = f"{'about' if cost.is_measured_size else 'more than'} {frame_time(cost.ms)}"
        if features := removable_sections(scene):
            time += f", without {', '.join(features)}, which may take longer than all else"
            time += "" if timed else ": --time measures a frame"
        time += " (too slow to measure)" if timed else ""
    words = [particles, size, springs, pins, cost.setting, time, memory, unfinished, stiffer, coarse]
    return " · ".join(filter(None, [*words, keys_without_effect(scene), *notes]))


def measured_ms(scene: Scene) -> float:
    """Run frames of a scene for up to two seconds after the first, which compiles. Return their median time [ms]."""
    from statistics import median

    from ..simulation.copies import time_frames
    from ..simulation.simulation import Simulation
    from ..system.console import spinner

    with spinner(f"{scene.name}: compiling and running"), Simulation(scene) as simulation:
        simulation.step()
        return median(time_frames([simulation], count=120, seconds=2.0)[0])


def frame_time(ms: float) -> str:
    """Return a frame time [ms] as text, compared with real time."""
    real = 1e3 * FRAME_SECONDS
    if ms < 1.05 * real:
        return f"{ms:.2g} ms per frame of {real:.1f} ms"
    time = f"{ms:.0f} ms" if ms < 1000 else f"{two_digits(ms / 1000)} s"
    return f"{time} per frame, {two_digits(ms / real)} times slower than real time"


def two_digits(value: float) -> str:
    """Return a number of 1 or more with two significant digits: `1.5`, `83`, `1,500`."""
    return f"{float(f'{value:.2g}'):,.{int(value < 9.95)}f}"


def print_schema(args: argparse.Namespace) -> int:
    """Run the command `schema`: print the table of keys, or of those of a section. Raises UsageError for no section."""
    from rich.table import Table

    from ..system.console import wide_console

    table = Table("section", "key", "default", "unit", "range", "help")
    for column in table.columns[:2]:
        column.no_wrap, column.min_width = True, 12
    if args.section not in (None, *sections()):
        raise UsageError(f"unknown section {args.section!r}{choose_from(args.section, tuple(sections()))}")
    for row in key_table():
        if args.section in (None, row[0].strip("[]")):
            table.add_row(*map(str, row))
    wide_console().print(table)
    return 0


# -- what a run prints ------------------------------------------------------------------------------------------------


def summary(simulation: Simulation, arch: str) -> str:
    """Return the line that every run prints: scene, solver, substeps × iterations, layout, grid, features, arch, seed.

    Further lines say if the scene is not simulated as written or is unusual (`Simulation.warnings`), iterations end too
    early, or a frame takes seconds.
    """
    from ..geometry.cloth_builder import particle_count_text
    from ..simulation.error_estimate import SAMPLE, cost_of

    scene = simulation.scene
    seconds = cost_of(scene).ms / 1e3 if simulation.topology.particle_count > SAMPLE**2 else 0.0
    forecast = f"a frame takes about {seconds:,.0f} s or more" if seconds > SLOW_FRAME else ""
    line = (
        f"{scene.name} · {simulation.method}"
        f" · {particle_count_text(scene)} · {' '.join(simulation.features)} · {arch} · seed {scene.seed}"
    )
    unfinished = left_unfinished(scene, simulation.topology, simulation.substeps)
    warnings = simulation.warnings, unfinished, forecast
    return "\n".join(filter(None, [line, *warnings]))
