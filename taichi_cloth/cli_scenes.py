"""The commands `list` and `check`: what scenes there are, and whether one is fine."""

from __future__ import annotations

import argparse

from .cli_options import Command
from .scene import Scene, key_table, load_scene, scene_names
from .scene.model import FRAME_SECONDS, PRESET_NAMES
from .scene.presets import load_preset


def declare(command: Command) -> None:
    listing = command("list", list_scenes, "list the shipped scenes, a line each", "list")
    listing.add_argument("--presets", action="store_true", help="list the fabrics instead, with the numbers they have")

    check = command("check", check_file, "check a scene file", "check my_scene.toml")
    what = check.add_mutually_exclusive_group(required=True)
    what.add_argument("file", nargs="?", metavar="FILE", help="a scene file, or the name of a shipped scene")
    what.add_argument("--keys", action="store_true", help="list every key with its default, unit and range")


def list_scenes(args: argparse.Namespace) -> int:
    if args.presets:
        for fabric in map(load_preset, PRESET_NAMES):
            print(
                f"{fabric.name:9}  {fabric.title:46}  {fabric.area_density:6.4g} kg/m²"
                f"  warp {fabric.warp:7.0f} N/m  bend {fabric.bending:.1e} N·m"
            )
        return 0
    names = scene_names()
    width = max(map(len, names))
    for name in names:
        scene = load_scene(name)
        print(" · ".join(filter(None, [f"{name:{width}}  {scene.title}", left_unfinished(scene)])))
    return 0


def left_unfinished(scene: Scene) -> str:
    """What the first lines of a run say of iterations that end too early, if anything; nothing is simulated."""
    from .measure.convergence import unfinished
    from .mesh.from_scene import topology_of

    solver = scene.solver
    topology = topology_of(scene, "springs" if solver.name == "verlet" else "fabric")
    return unfinished(scene, topology, FRAME_SECONDS / solver.substeps, solver.iterations)


def check_file(args: argparse.Namespace) -> int:
    if args.keys:
        from rich.table import Table

        from .bench.report import wide_console

        table = Table("section", "key", "default", "unit", "range", "help")
        for column in table.columns[:2]:
            column.no_wrap, column.min_width = True, 12
        for row in key_table():
            table.add_row(*map(str, row))
        wide_console().print(table)
        return 0
    from .mesh.from_scene import count_of, pieces_of

    scene = load_scene(args.file)
    particles = f"{count_of(scene)} particles" + (f" in {pieces} pieces" if (pieces := pieces_of(scene)) > 1 else "")
    print(f"{args.file}: fine ({particles}, solver {scene.solver.name})")
    if left := left_unfinished(scene):
        print(left)
    return 0
