"""The command `replay`: repeats a recording, shows it, and says whether it came out the same."""

from __future__ import annotations

import argparse
import itertools
import sys
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from . import runtime
from .cli_options import Command, count, size
from .errors import WrongUse

if TYPE_CHECKING:
    from .record.recording import Recording
    from .view.frames import Plan
    from .view.rerun import Rerun
    from .view.session import Session


def declare(command: Command) -> None:
    replay = command(
        "replay", run_replay, "repeat a recording bit for bit", "replay out/curtain/clip_001.toml --video again.mp4"
    )
    replay.add_argument("file", type=Path, metavar="FILE", help="a recording: the .toml beside a screenshot or a clip")
    how = replay.add_mutually_exclusive_group()
    how.add_argument("--headless", action="store_true", help="draw numbered PNG files, even where a window could open")
    how.add_argument("--video", type=Path, metavar="FILE", help="draw a film, an .mp4 or a .webp")
    how.add_argument("--check", action="store_true", help="draw nothing: only say whether it comes out the same")
    replay.add_argument("--log", type=Path, metavar="FILE", help="write one line of JSON for every displayed frame")
    replay.add_argument("--out", type=Path, metavar="DIR", help="folder for the pictures (default: FILE without .toml)")
    replay.add_argument("--size", type=size, metavar="WxH", help="size in pixels (default: as it was seen)")
    replay.add_argument("--every", type=count, default=1, metavar="K", help="draw every K-th frame only")
    replay.add_argument("--samples", type=int, choices=(1, 4), default=4, help="samples a pixel: 4 smooths edges")
    replay.add_argument("--arch", choices=runtime.ARCHS, help="Taichi back-end (default: the recording's)")
    replay.add_argument("--force", action="store_true", help="replace the frames in DIR, or the film")


def run_replay(args: argparse.Namespace) -> int:
    from .record.recording import differences, read_recording

    recording = read_recording(args.file)
    if args.video:
        check_film(args.video, force=args.force)
    arch = args.arch or recording.made_with.get("arch", "cpu")
    if arch not in runtime.ARCHS:
        raise WrongUse(f"{args.file}: there is no arch {arch!r}: {', '.join(runtime.ARCHS)}")
    runtime.start(arch)
    for line in differences(recording):
        print(f"{args.file}: {line}: the last bits may differ", file=sys.stderr)
    try:
        rerun = repeated(recording, args)
    except WrongUse as error:
        raise WrongUse(f"{args.file}: {error}") from None
    print(f"{args.file}: {rerun.verdict}")
    return 0 if rerun.is_equal else 1


def repeated(recording: Recording, args: argparse.Namespace) -> Rerun:
    """In the window, as a film, as pictures, or unseen; closed when it comes back."""
    from .view.frames import Plan
    from .view.rerun import Rerun

    size = args.size or recording.size
    if not (args.check or args.headless or args.video):
        from .view.display import window_obstacle

        obstacle = window_obstacle()
        if obstacle is None:
            from .view import window

            return window.run(partial(Rerun, recording), size=size, log=args.log)
        print(f"no window ({obstacle}): drawing pictures instead", flush=True)
    out = args.out or args.file.with_suffix("")
    plan = Plan(out, recording.frames + 1, width=size[0], height=size[1], every=args.every, samples=args.samples)
    with closing(Rerun(recording)) as rerun:
        if args.check:
            while not rerun.over:
                rerun.forward()
        elif args.video:
            film_of(rerun, plan, args.video)
        else:
            pictures_of(rerun, plan, force=args.force)
    return rerun


def check_film(path: Path, *, force: bool) -> None:
    """Says what would go wrong before minutes are spent. Raises OutputInUse and WrongUse."""
    from .bench.report import check_free
    from .view.video import check_kind

    check_kind(path)
    check_free(path, force=force)


def film_of(session: Session, plan: Plan, path: Path) -> None:
    from .progress import counted, frames_progress
    from .view.reel import reel
    from .view.video import film

    with film(path, (plan.width, plan.height), plan.every) as show, frames_progress(plan.frames) as advance:
        shown = reel(session, plan, show, advance)
    print(f"{counted(shown, 'picture')} in {path}")


def pictures_of(session: Session, plan: Plan, *, force: bool) -> None:
    from .progress import counted, frames_progress
    from .view.frames import claimed, writing_behind
    from .view.reel import reel

    number = itertools.count()
    with (
        claimed(plan, session.simulation, force=force, resume=False),
        writing_behind() as write,
        frames_progress(plan.frames) as advance,
    ):
        reel(session, plan, lambda picture: write(plan.path(next(number)), picture), advance)
    print(f"{counted(plan.pictures, 'picture')} in {plan.out}")
