"""The commands `list` and `check`: what scenes there are, and whether one is fine."""

from __future__ import annotations

import argparse

from .cli_options import Command
from .scene import key_table, load_scene, scene_names
from .scene.model import PRESET_NAMES
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
        print(f"{name:{width}}  {load_scene(name).title}")
    return 0


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
    return 0
