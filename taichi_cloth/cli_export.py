"""The commands `export` and `bake`: one moment of a scene, or a whole clip, as files that other programs read."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

from . import runtime
from .cli_options import DEFAULT_FRAMES, Command, chosen_scene, count, scene_options, summary
from .errors import OutputInUse, WrongUse
from .export.output import FORMATS, UPS, Output, default_path, format_of


def declare(command: Command) -> None:
    export = command(
        "export", run_export, "write the cloth as a mesh, after some frames", "export curtain --frames 60 --out c.obj"
    )
    export_options(export)
    export.add_argument("--clip", action="store_true", help="write a whole clip, as `bake` does")
    export.add_argument("--html", type=Path, metavar="FILE", help="write a page that plays a clip: --clip --out FILE")

    bake = command("bake", run_export, "write a whole clip of the cloth", "bake curtain --frames 240 --out clip.pc2")
    export_options(bake)
    bake.set_defaults(clip=True, html=None)


def export_options(parser: argparse.ArgumentParser) -> None:
    """The options of `export` and `bake`."""
    scene_options(parser, nargs="?")
    parser.add_argument(
        "--frames", type=count, default=DEFAULT_FRAMES, metavar="N", help="frames of 1/60 s to simulate"
    )
    parser.add_argument("--every", type=count, metavar="K", help="of a clip, write every K-th frame only (default: 1)")
    parser.add_argument("--format", choices=FORMATS, help="format of the file (default: by the suffix of --out)")
    parser.add_argument("--up", choices=UPS, default="y", help="axis that is upwards in the file")
    parser.add_argument(
        "--out", type=Path, metavar="PATH", help="file, or folder for a clip of OBJ or PLY files (default: in out)"
    )
    parser.add_argument("--force", action="store_true", help="replace what is there")


def run_export(args: argparse.Namespace) -> int:
    scene = chosen_scene(args)
    if args.html:
        if args.out or args.format not in (None, "html"):
            raise WrongUse("--html says both what is written and where: it goes without --out and --format")
        args.out, args.format, args.clip = args.html, "html", True
    if args.every and not args.clip:
        raise WrongUse("--every leaves frames of a clip out: it goes with --clip, or use `bake`")
    format = format_of(args.out, args.format, clip=args.clip)
    path = args.out or default_path(scene.name, format, clip=args.clip)
    if format == "html" and args.up != "y":
        raise WrongUse("--up turns meshes for other programs: a page stands upright by itself")
    output = Output(path, format, args.frames, args.up, args.clip, args.every or 1)
    if format == "usd" and importlib.util.find_spec("pxr") is None:
        raise WrongUse("USD files need usd-core: pip install 'taichi-cloth[usd]'")
    check_room(output, force=args.force)
    from .export.clip import export
    from .progress import frames_progress
    from .simulation import Simulation

    arch = runtime.start(args.arch)
    with Simulation(scene, args.path) as simulation:
        make_room(output)
        print(summary(simulation, arch), flush=True)
        with frames_progress(output.frames) as advance:
            export(simulation, output, advance)
        topology = simulation.topology
    print(f"{told(output)}, {topology.particle_count} particles, {topology.triangle_count} triangles, {output.up} up")
    return 0


def check_room(output: Output, *, force: bool) -> None:
    """Says what is in the way before anything starts. Raises OutputInUse and WrongUse."""
    from .bench.report import check_free

    if output.is_folder and output.earlier() and not force:
        raise OutputInUse(f"{output.path} holds a clip already: use --force to replace it")
    for path in output.files():
        if path.parent.exists():
            check_free(path, force=force)


def make_room(output: Output) -> None:
    """The folder made, and an older clip's numbered files removed. Raises OSError."""
    folder = output.path if output.is_folder else output.path.parent
    folder.mkdir(parents=True, exist_ok=True)
    for path in output.earlier() if output.is_folder else []:
        path.unlink()


def told(output: Output) -> str:
    """What was written, and where."""
    from .progress import counted

    where = " and ".join(map(str, output.files() or [output.path]))
    if not output.clip:
        return f"{where}: after {counted(output.frames, 'frame')}"
    return f"{where}: {counted(output.samples, 'sample')}, {60 / output.every:g} a second"
