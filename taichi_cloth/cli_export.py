"""The commands `export` and `bake`: one moment of a scene, or a whole clip, as files that other programs read."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING

from . import runtime
from .errors import OutputInUse, WrongUse
from .export.output import Output, default_path, format_of
from .scene import Scene

if TYPE_CHECKING:
    from .simulation import Simulation


def run_export(scene: Scene, args: argparse.Namespace, summary: Callable[[Simulation, str], str]) -> int:
    """Writes what the user asked for. `summary` is the line that every run prints."""
    if args.every and not args.clip:
        raise WrongUse("--every leaves frames of a clip out: it goes with --clip, or use `bake`")
    format = format_of(args.out, args.format, clip=args.clip)
    path = args.out or default_path(scene.name, format, clip=args.clip)
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
