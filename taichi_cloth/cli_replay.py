"""`replay` repeats a recording and says whether it came out the same; `render --video` draws a film."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from . import runtime
from .errors import BlewUp, WrongUse
from .scene import Scene

if TYPE_CHECKING:
    from .record.recording import Recording
    from .simulation import Simulation
    from .view.frames import Plan
    from .view.rerun import Rerun
    from .view.session import Session


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


def render_film(scene: Scene, plan: Plan, args: argparse.Namespace, announce: Callable[[Simulation, str], None]) -> int:
    """`render --video`."""
    from .view.session import Session

    if args.out or args.resume or args.contact_sheet:
        raise WrongUse("--video writes one file: it goes without --out, --resume and --contact-sheet")
    check_film(args.video, force=args.force)
    arch = runtime.start(args.arch)
    with closing(Session(scene, args.path)) as session:
        announce(session.simulation, arch)
        session.view = plan.view
        film_of(session, plan, args.video)
        if session.frozen:
            raise BlewUp(f"{session.note}; {args.video} ends there")
    return 0


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

    number = count()
    with (
        claimed(plan, session.simulation, force=force, resume=False),
        writing_behind() as write,
        frames_progress(plan.frames) as advance,
    ):
        reel(session, plan, lambda picture: write(plan.path(next(number)), picture), advance)
    print(f"{counted(plan.pictures, 'picture')} in {plan.out}")
