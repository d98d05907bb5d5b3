"""The commands `list`, `check` and `schema`: shipped scenes, validation of a scene file, and all scene keys."""

from __future__ import annotations

import argparse

from ..scene import Scene, key_table, scene_names
from ..scene.presets import load_preset
from ..scene.schema import FRAME_SECONDS, PRESET_NAMES
from ..scene.solver_catalog import SOLVER_CATALOG
from .options import Command


def add_commands(command: Command) -> None:
    """Add the commands `list`, `check` and `schema`."""
    listing = command("list", list_scenes, "list the shipped scenes", "list")
    listing.add_argument(
        "--presets", action="store_true", help="list the shipped fabrics instead, with their constants"
    )

    check = command("check", check_file, "validate a scene file", "check my_scene.toml")
    check.add_argument("file", metavar="FILE", help="TOML file or shipped scene")
    command("schema", print_schema, "list all scene keys with default, unit and range", "schema")


def list_scenes(args: argparse.Namespace) -> int:
    """Run the command `list`: print one line per scene or fabric."""
    from ..geometry.scene_loader import load_scene

    if args.presets:
        for fabric in map(load_preset, PRESET_NAMES):
            print(
                f"{fabric.name:9}  {fabric.title:46}  {fabric.area_density:6.4g} kg/m²"
                f"  warp {fabric.warp:7.0f} N/m  bending {fabric.bending:.1e} N·m"
            )
        return 0
    names = scene_names()
    width = max(map(len, names))
    for name in names:
        scene = load_scene(name)
        print(" · ".join(filter(None, [f"{name:{width}}  {scene.title}", left_unfinished(scene)])))
    return 0


def left_unfinished(scene: Scene) -> str:
    """Return the line of a run's summary about iterations that end too early, or empty. It simulates nothing."""
    from ..geometry.cloth_builder import build_topology
    from ..simulation.error_estimate import unconverged

    solver = scene.solver
    topology = build_topology(scene, SOLVER_CATALOG[solver.name].stiffness_section)
    return unconverged(scene, topology, FRAME_SECONDS / solver.substeps, solver.iterations)


def check_file(args: argparse.Namespace) -> int:
    """Run the command `check`: validate a scene."""
    from ..geometry.cloth_builder import component_count, particle_count_text
    from ..geometry.scene_loader import load_scene

    scene = load_scene(args.file)
    particles = f"{particle_count_text(scene)} particles" + (
        f" in {pieces} pieces" if (pieces := component_count(scene)) > 1 else ""
    )
    print(f"{args.file}: valid ({particles}, solver {scene.solver.name})")
    if unfinished := left_unfinished(scene):
        print(unfinished)
    return 0


def print_schema(args: argparse.Namespace) -> int:
    """Run the command `schema`: print the table of keys."""
    from rich.table import Table

    from ..system.console import wide_console

    table = Table("section", "key", "default", "unit", "range", "help")
    for column in table.columns[:2]:
        column.no_wrap, column.min_width = True, 12
    for row in key_table():
        table.add_row(*map(str, row))
    wide_console().print(table)
    return 0
