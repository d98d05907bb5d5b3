"""The command `export`: the cloth after some frames, or a clip, as files for other programs."""

from __future__ import annotations

import argparse
from typing import NamedTuple

from ..export.output import FORMATS, UP_AXES, Output, check_format, default_path, format_of
from ..system import taichi_runtime as runtime
from ..system.errors import OutputConflict, UsageError
from .options import DEFAULT_FRAMES, Command, chosen_scene, count, file_path, scene_options, summary


class Frames(NamedTuple):
    """What to export: the cloth after `end` frames, or a clip of the frames from `first` to before `end`."""

    end: int
    first: int | None = None


def frames(text: str) -> Frames:
    """Parse N or A:B, numbers of frames."""
    first, colon, end = text.partition(":")
    if not colon:
        return Frames(count(text))
    if not first.isdecimal() or not end.isdecimal() or int(first) >= int(end):
        raise argparse.ArgumentTypeError(f"{text!r} is not a range A:B of frames with 0 <= A < B")
    return Frames(count(end), int(first))


def add_commands(command: Command) -> None:
    """Add the command `export`."""
    parser = command(
        "export",
        run_export,
        "export the cloth after some frames, or a clip, to files for other programs",
        "export curtain --frames 0:240 --out clip.pc2",
    )
    scene_options(parser, nargs="?")
    parser.add_argument(
        "--frames",
        type=frames,
        default=str(DEFAULT_FRAMES),
        metavar="N|A:B",
        help="the cloth after N frames [1/60 s], or a clip of the frames from A to before B",
    )
    parser.add_argument("--every", type=count, metavar="K", help="number of frames per sample of a clip (default: 1)")
    parser.add_argument("--format", choices=FORMATS, help="file format (default: by the suffix of --out)")
    parser.add_argument("--up-axis", choices=UP_AXES, default="y", help="up axis of the file")
    parser.add_argument(
        "--out",
        type=file_path,
        metavar="PATH",
        help="file, or folder for a clip of OBJ or PLY files (default: in the folder out)",
    )
    parser.add_argument("--force", action="store_true", help="overwrite existing files")


def run_export(args: argparse.Namespace) -> int:
    """Run the command `export`."""
    scene = chosen_scene(args)
    clip = args.frames.first is not None
    if args.every and not clip:
        raise UsageError(f"--every applies to clips only: use --frames 0:{args.frames.end}")
    format = format_of(args.out, args.format, clip=clip)
    path = args.out or default_path(scene.name, format, clip=clip)
    check_format(format, args.up_axis)
    output = Output(path, format, args.frames.end, args.up_axis, clip, args.frames.first or 0, args.every or 1)
    check_output(output, force=args.force)
    from ..export.clip import export
    from ..simulation.simulation import Simulation
    from ..system.console import frames_progress

    arch = runtime.start(args.arch)
    with Simulation(scene, args.layout) as simulation:
        prepare_output(output)
        print(summary(simulation, arch), flush=True)
        with frames_progress(output.frames) as advance:
            export(simulation, output, advance)
        topology = simulation.topology
    print(
        f"{describe(output)}, {topology.particle_count} particles, {topology.triangle_count} triangles, {output.up} up"
    )
    return 0


def check_output(output: Output, *, force: bool) -> None:
    """Check the output path before the simulation. Raises OutputConflict, and UsageError for a missing folder."""
    from ..system.console import check_output_file

    if output.is_folder and output.existing_samples() and not force:
        raise OutputConflict(f"{output.path} has a clip already: use --force to replace it")
    for path in output.single_files():
        if path.parent.exists():
            check_output_file(path, force=force)


def prepare_output(output: Output) -> None:
    """Make the output folder and remove the numbered files of an older clip. Raises OSError."""
    folder = output.path if output.is_folder else output.path.parent
    folder.mkdir(parents=True, exist_ok=True)
    for path in output.existing_samples() if output.is_folder else []:
        path.unlink()


def describe(output: Output) -> str:
    """Return a description of the output: its files and its length."""
    from ..system.console import count_noun

    where = " and ".join(map(str, output.single_files() or [output.path]))
    if not output.clip:
        return f"{where}: after {count_noun(output.frames, 'frame')}"
    return f"{where}: {count_noun(output.samples, 'sample')}, {60 / output.every:g} per second"
