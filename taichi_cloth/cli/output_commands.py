"""The commands `export`, which writes cloth as files for other programs, and `replay`, which repeats a recording."""

from __future__ import annotations

import argparse
import itertools
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..export.output import FORMATS, UP_AXES, Output, check_format, default_path, format_of
from ..system import taichi_runtime as runtime
from ..system.errors import OutputConflict, UsageError, choose_from
from ..system.files import next_free_path
from .program import (
    ARCH_HELP,
    DEFAULT_FRAMES,
    Command,
    any_of,
    check_log,
    chosen_scene,
    count,
    file_path,
    refuse_log,
    scene_options,
    size,
)
from .scenes import summary

if TYPE_CHECKING:
    from ..render.image import RenderPlan
    from ..simulation.recording import Recording
    from ..simulation.simulation import Simulation
    from ..viewer.replay import ReplaySession
    from ..viewer.session import Session


def add_commands(command: Command) -> None:
    """Add both commands."""
    add_export(command)
    add_replay(command)


# -- export ------------------------------------------------------------------------------------------------------------


class Frames(NamedTuple):
    """What to export: the cloth after `end` frames, or a clip of the frames from `first` to before `end`."""

    end: int
    first: int | None = None


def frames(text: str) -> Frames:
    """Parse N or A:B, numbers of frames."""
    first, colon, end = text.partition(":")
    if not colon:
        if not text.isdecimal():
            raise argparse.ArgumentTypeError(f"{text!r} is neither a number of frames nor a range A:B, such as 0:240")
        return Frames(count(text))
    if not first.isdecimal() or not end.isdecimal() or int(first) >= int(end):
        raise argparse.ArgumentTypeError(f"{text!r} is not a range A:B of frames with 0 <= A < B")
    return Frames(count(end), int(first))


def add_export(command: Command) -> None:
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
        help="N: the cloth after N frames of 1/60 s; A:B: a clip of the frames from A to before B",
    )
    parser.add_argument("--every", type=count, metavar="K", help="with A:B: write every Kth frame (default: 1)")
    parser.add_argument(
        "--format",
        choices=FORMATS,
        metavar="NAME",
        help=f"file format: {any_of(FORMATS)} (default: by the suffix of --out)",
    )
    parser.add_argument(
        "--up-axis",
        choices=UP_AXES,
        default="y",
        metavar="AXIS",
        help=f"axis that points up in the file: {any_of(UP_AXES)}",
    )
    parser.add_argument(
        "--out",
        type=file_path,
        metavar="PATH",
        help="file to write, or folder for a clip of OBJ or PLY files (default: a name in the folder out)",
    )
    parser.add_argument("--force", action="store_true", help="overwrite existing files")


def run_export(args: argparse.Namespace) -> int:
    """Run the command `export`."""
    scene = chosen_scene(args)
    clip = args.frames.first is not None
    if args.every and not clip:
        raise UsageError(f"--every applies to clips only: use --frames 0:{args.frames.end}")
    format = format_of(args.out, args.format, clip=clip, options=True)
    path = args.out or default_path(scene.name, format, clip=clip)
    check_format(format, args.up_axis)
    output = Output(path, format, args.frames.end, args.up_axis, clip, args.frames.first or 0, args.every or 1)
    check_output(output, force=args.force)
    from ..export.clip import export
    from ..simulation.simulation import Simulation
    from ..system.console import frames_progress

    arch = runtime.start(args.arch)
    with Simulation(scene, args.layout) as simulation:
        output.prepare()
        print(summary(simulation, arch), flush=True)
        with frames_progress(output.frames) as advance:
            export(simulation, output, advance)
        topology = simulation.topology
    print(
        f"{describe(output)}, {topology.particle_count} particles, {topology.triangle_count} triangles, {output.up} up"
    )
    return 0


def check_output(output: Output, *, force: bool) -> None:
    """Check the path of the output before the simulation. Raises OutputConflict and UsageError."""
    from ..system.console import check_output_file

    if output.is_folder and output.existing_samples() and not force:
        raise OutputConflict(f"{output.path} has a clip already: use --force to replace it")
    for path in output.single_files():
        check_output_file(path, force=force)


def describe(output: Output) -> str:
    """Return a description of the output: its files and its length."""
    from ..system.console import count_noun

    where = " and ".join(map(str, output.single_files() or [output.path]))
    if not output.clip:
        return f"{where}: after {count_noun(output.frames, 'frame')}"
    return f"{where}: {count_noun(output.samples, 'sample')}, {60 / output.every:g} per second"


def samples_option(parser: argparse.ArgumentParser) -> None:
    """Add `--samples` to a command that renders images."""
    text = "samples per pixel, 1 or 4: 4 gives smooth edges, 1 is faster"
    parser.add_argument("--samples", type=int, choices=(1, 4), default=4, metavar="N", help=text)


def log_option(parser: argparse.ArgumentParser) -> None:
    """Add `--log` to a command that opens a window."""
    text = "write a line of JSON for each displayed frame to FILE"
    parser.add_argument("--log", type=file_path, metavar="FILE", help=text)


# -- replay ------------------------------------------------------------------------------------------------------------


def add_replay(command: Command) -> None:
    """Add the command `replay`."""
    replay = command(
        "replay",
        run_replay,
        "replay a recording and check that it ends in the same bits",
        "replay out/curtain/clip_001.toml --video again.mp4",
    )
    replay.add_argument(
        "file", type=file_path, metavar="FILE", help="recording: the .toml file beside a screenshot or clip"
    )
    output = replay.add_mutually_exclusive_group()
    output.add_argument("--headless", action="store_true", help="render images instead of opening a window")
    output.add_argument(
        "--video",
        type=file_path,
        metavar="FILE",
        help="write a video instead of opening a window: an .mp4 or .webp file",
    )
    output.add_argument("--check", action="store_true", help="only compare the result, without drawing")
    log_option(replay)
    replay.add_argument(
        "--out", type=file_path, metavar="DIR", help="folder of the images (default: FILE without .toml)"
    )
    replay.add_argument(
        "--size", type=size, metavar="WxH", help="image or window size [pixels] (default: the recorded size)"
    )
    replay.add_argument("--every", type=count, default=1, metavar="K", help="render every Kth frame")
    samples_option(replay)
    replay.add_argument(
        "--arch", choices=runtime.ARCHS, metavar="NAME", help=f"{ARCH_HELP} (default: the recorded one)"
    )
    replay.add_argument("--force", action="store_true", help="overwrite existing images or video")


def run_replay(args: argparse.Namespace) -> int:
    """Run the command `replay`. Return 0 if the positions at the end equal the recorded ones, else 1."""
    from ..simulation.recording import differences, read_recording
    from ..viewer.toolkit import window_obstacle

    check_log(args.log)
    chosen = next((f"--{option}" for option in ("check", "headless", "video") if getattr(args, option)), None)
    obstacle = chosen or window_obstacle()
    if obstacle:
        refuse_log(args.log, obstacle)
    recording = read_recording(args.file)
    if args.video:
        check_video(args.video, force=args.force)
    arch = args.arch or recording.created_with.get("arch", "cpu")
    if arch not in runtime.ARCHS:
        raise UsageError(f"{args.file}: unknown arch {arch!r}{choose_from(arch, runtime.ARCHS)}")
    runtime.start(arch)
    for line in differences(recording):
        print(f"{args.file}: {line}; the last bits may differ", file=sys.stderr)
    if obstacle and not chosen:
        print(f"no window ({obstacle}): rendering images instead", flush=True)
    try:
        session = run_session(recording, args, obstacle)
    except UsageError as error:
        raise UsageError(f"{args.file}: {error}") from None
    print(f"{args.file}: {session.verdict}")
    return 0 if session.was_equal else 1


def save_running_scene(simulation: Simulation, folder: Path) -> Path:
    """Write a scene with the present values of its parameters to a new file in a folder. Return its path.

    Raises OSError, SceneError and UsageError.
    """
    from ..export.clip import tuned_scene
    from ..geometry.scene_loader import save_scene

    path = next_free_path(folder, "scene").with_suffix(".toml")
    save_scene(tuned_scene(simulation), path)
    return path


def run_session(recording: Recording, args: argparse.Namespace, obstacle: str | None) -> ReplaySession:
    """Replay in a window, or if there is an `obstacle` to it, as a video, as images, or without drawing.

    Return the session, which is closed.
    """
    from ..render.image import RenderPlan
    from ..viewer.replay import ReplaySession

    size = args.size or recording.size
    if obstacle is None:
        from ..export.clip import export_snapshot
        from ..simulation.events import Event
        from ..viewer import window

        def open_session() -> ReplaySession:
            session = ReplaySession(recording, export=export_snapshot, save=save_running_scene)
            session.measure_errors(any(event == Event("view", ("error",)) for _, event in recording.rows))
            return session

        return window.run(open_session, size=size, log=args.log)
    out = args.out or args.file.with_suffix("")
    plan = RenderPlan(out, recording.frames + 1, width=size[0], height=size[1], every=args.every, samples=args.samples)
    with closing(ReplaySession(recording)) as session:
        if args.check:
            while not session.is_over:
                session.replay_frame()
        elif args.video:
            write_video(session, plan, args.video)
        else:
            write_images(session, plan, force=args.force)
    return session


def check_video(path: Path, *, force: bool) -> None:
    """Check that a video can be written, before minutes of work. Raises OutputConflict and UsageError."""
    from ..render.image_files import check_format
    from ..system.console import check_output_file

    check_format(path)
    check_output_file(path, force=force)


def write_video(session: Session, plan: RenderPlan, path: Path) -> None:
    """Render a session to a video, and make its folder. `plan.out` is not used."""
    from ..render.image_files import open_video
    from ..system.console import count_noun, frames_progress
    from ..viewer.replay import session_images

    path.parent.mkdir(parents=True, exist_ok=True)
    with open_video(path, (plan.width, plan.height), plan.every) as show, frames_progress(plan.frames) as advance:
        images = session_images(session, plan, show, advance)
    print(f"{count_noun(images, 'image')} in {path}")


def write_images(session: Session, plan: RenderPlan, *, force: bool) -> None:
    """Render a session to numbered PNG files in the folder `plan.out`."""
    from ..render.image import claim_folder
    from ..render.image_files import background_writer
    from ..system.console import frames_progress
    from ..viewer.replay import session_images

    number = itertools.count()
    with (
        claim_folder(plan, session.simulation, force=force, resume=None),
        background_writer() as write,
        frames_progress(plan.frames) as advance,
    ):
        session_images(session, plan, lambda image: write(plan.path(next(number)), image), advance)
    print(plan.images)
