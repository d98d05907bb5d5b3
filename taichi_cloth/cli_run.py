"""The commands `run` and `render`: a scene in a window, as pictures, or as a film."""

from __future__ import annotations

import argparse
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from . import runtime
from .cli_options import DEFAULT_FRAMES, VIEWS, Command, chosen_scene, count, scene_options, size, summary
from .cli_replay import check_film, film_of
from .errors import BlewUp, WrongUse
from .scene import Scene

if TYPE_CHECKING:
    from .simulation import Simulation
    from .view.frames import Plan


def declare(command: Command) -> None:
    run = command("run", run_scene, "open a scene in a window, or render it where there is none", "run table")
    scene_options(run, nargs="?")
    run.add_argument("--size", type=size, default="1280x720", metavar="WxH", help="size of the window in pixels")
    run.add_argument("--frames", type=count, metavar="N", help="end after N displayed frames (default: never)")
    run.add_argument("--log", type=Path, metavar="FILE", help="write one line of JSON for every displayed frame")
    run.add_argument("--headless", action="store_true", help="render to out/SCENE even where a window could open")

    render = command(
        "render", render_scene, "render a scene to numbered PNG files", "render curtain --frames 240 --out out/curtain"
    )
    scene_options(render)
    render.add_argument(
        "--frames", type=count, default=DEFAULT_FRAMES, metavar="N", help="frames of 1/60 s to simulate"
    )
    render.add_argument("--size", type=size, default="960x540", metavar="WxH", help="size of a picture in pixels")
    render.add_argument("--out", type=Path, metavar="DIR", help="folder for the pictures (default: out/SCENE)")
    render.add_argument("--view", choices=VIEWS, default="shaded", help="how the cloth is drawn")
    render.add_argument("--every", type=count, default=1, metavar="K", help="draw every K-th frame only")
    render.add_argument("--samples", type=int, choices=(1, 4), default=4, help="samples a pixel: 4 smooths edges")
    render.add_argument("--video", type=Path, metavar="FILE", help="write a film instead, an .mp4 or a .webp")
    render.add_argument("--contact-sheet", action="store_true", help="also write twelve moments as one picture")
    again = render.add_mutually_exclusive_group()
    again.add_argument("--force", action="store_true", help="replace the frames in DIR, or the film")
    again.add_argument("--resume", action="store_true", help="go on where an interrupted render stopped")


def run_scene(args: argparse.Namespace) -> int:
    scene = chosen_scene(args)
    from .view.display import window_obstacle

    obstacle = "--headless was given" if args.headless else window_obstacle()
    if obstacle is None:
        from .progress import waiting
        from .view import window

        arch = runtime.start(args.arch)
        from .view.session import Session

        with ExitStack() as until_open:
            until_open.enter_context(waiting(f"{scene.name}: compiling, which takes some seconds the first time"))

            def announce(simulation: Simulation) -> None:
                until_open.close()
                print(summary(simulation, arch), flush=True)

            window.run(
                partial(Session, scene, args.path), size=args.size, frames=args.frames, log=args.log, announce=announce
            )
        return 0
    from .view.frames import Plan

    print(f"no window ({obstacle}): rendering frames instead; `taichi-cloth web` shows it in a browser", flush=True)
    plan = Plan(Path("out") / scene.name, args.frames or DEFAULT_FRAMES, sheet=True)
    return render_plan(scene, plan, args, force=True)


def render_scene(args: argparse.Namespace) -> int:
    scene = chosen_scene(args)
    from .view.frames import Plan

    plan = Plan(
        out=args.out or Path("out") / scene.name,
        frames=args.frames,
        width=args.size[0],
        height=args.size[1],
        view=args.view,
        every=args.every,
        samples=args.samples,
        sheet=args.contact_sheet,
    )
    if args.video:
        return render_film(scene, plan, args)
    return render_plan(scene, plan, args, force=args.force, resume=args.resume)


def render_plan(
    scene: Scene, plan: Plan, args: argparse.Namespace, *, force: bool = False, resume: bool = False
) -> int:
    from .progress import counted, frames_progress
    from .simulation import Simulation
    from .view import frames

    arch = runtime.start(args.arch)
    with Simulation(scene, args.path) as simulation, frames.claimed(plan, simulation, force=force, resume=resume):
        print(summary(simulation, arch), flush=True)
        with frames_progress(plan.frames) as advance:
            frames.render(simulation, plan, advance)
    print(
        f"{counted(plan.pictures, 'picture')} in {plan.out}" + (", contact_sheet.png among them" if plan.sheet else "")
    )
    return 0


def render_film(scene: Scene, plan: Plan, args: argparse.Namespace) -> int:
    from .view.session import Session

    if args.out or args.resume or args.contact_sheet:
        raise WrongUse("--video writes one file: it goes without --out, --resume and --contact-sheet")
    check_film(args.video, force=args.force)
    arch = runtime.start(args.arch)
    with closing(Session(scene, args.path)) as session:
        print(summary(session.simulation, arch), flush=True)
        session.view = plan.view
        film_of(session, plan, args.video)
        if session.frozen:
            raise BlewUp(f"{session.note}; {args.video} ends there")
    return 0
