"""The command `replay`: replay a recording in a window, as images or as a video, and check that the result is equal."""

from __future__ import annotations

import argparse
import itertools
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from ..system import taichi_runtime as runtime
from ..system.errors import UsageError, choose_from
from .options import Command, check_log, count, file_path, refuse_log, size

if TYPE_CHECKING:
    from ..render.sequence import RenderPlan
    from ..simulation.recording import Recording
    from ..viewer.replay import ReplaySession
    from ..viewer.session import Session


def add_commands(command: Command) -> None:
    """Add the command `replay`."""
    replay = command(
        "replay",
        run_replay,
        "replay a recording and check that it ends in the same bits",
        "replay out/curtain/clip_001.toml --video again.mp4",
    )
    replay.add_argument("file", type=file_path, metavar="FILE", help="recording: .toml file of a screenshot or clip")
    output = replay.add_mutually_exclusive_group()
    output.add_argument("--headless", action="store_true", help="render images instead of opening a window")
    output.add_argument("--video", type=file_path, metavar="FILE", help="video to write, .mp4 or .webp")
    output.add_argument("--check", action="store_true", help="check the result without drawing")
    replay.add_argument("--log", type=file_path, metavar="FILE", help="write a JSON line per displayed frame")
    replay.add_argument("--out", type=file_path, metavar="DIR", help="image folder (default: FILE without .toml)")
    replay.add_argument(
        "--size", type=size, metavar="WxH", help="image or window size [pixels] (default: the recorded size)"
    )
    replay.add_argument("--every", type=count, default=1, metavar="K", help="number of frames per image")
    replay.add_argument("--samples", type=int, choices=(1, 4), default=4, help="samples per pixel; 4 smooths edges")
    replay.add_argument("--arch", choices=runtime.ARCHS, help="Taichi backend (default: the recorded one)")
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
    return 0 if session.is_equal else 1


def run_session(recording: Recording, args: argparse.Namespace, obstacle: str | None) -> ReplaySession:
    """Replay in a window, or if there is an `obstacle` to it, as a video, as images, or without drawing.

    Return the session, which is closed.
    """
    from ..render.sequence import RenderPlan
    from ..viewer.replay import ReplaySession

    size = args.size or recording.size
    if obstacle is None:
        from ..export.clip import export_snapshot
        from ..simulation.events import Event
        from ..viewer import window

        def open_session() -> ReplaySession:
            session = ReplaySession(recording, export=export_snapshot)
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
    """Render a session to a video. `plan.out` is not used."""
    from ..render.image_files import open_video
    from ..system.console import count_noun, frames_progress
    from ..viewer.replay import session_images

    with open_video(path, (plan.width, plan.height), plan.every) as show, frames_progress(plan.frames) as advance:
        images = session_images(session, plan, show, advance)
    print(f"{count_noun(images, 'image')} in {path}")


def write_images(session: Session, plan: RenderPlan, *, force: bool) -> None:
    """Render a session to numbered PNG files in the folder `plan.out`."""
    from ..render.sequence import background_writer, claim_folder
    from ..system.console import count_noun, frames_progress
    from ..viewer.replay import session_images

    number = itertools.count()
    with (
        claim_folder(plan, session.simulation, force=force, resume=False),
        background_writer() as write,
        frames_progress(plan.frames) as advance,
    ):
        session_images(session, plan, lambda image: write(plan.path(next(number)), image), advance)
    print(f"{count_noun(plan.image_count, 'image')} in {plan.out}")
