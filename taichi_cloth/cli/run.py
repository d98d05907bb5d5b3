"""The commands `run`, `web` and `render`: a scene in a window, in a browser, as images, or as a video."""

from __future__ import annotations

import argparse
import importlib.util
import secrets
import socket
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..scene import Scene
from ..system import taichi_runtime as runtime
from ..system.errors import Diverged, UsageError, install_command
from .output_commands import check_video, log_option, samples_option, save_running_scene, write_video
from .program import (
    DEFAULT_FRAMES,
    VIEWS,
    Command,
    any_of,
    check_log,
    chosen_scene,
    count,
    file_path,
    no_errors_option,
    refuse_log,
    scene_options,
    size,
)
from .scenes import summary

if TYPE_CHECKING:
    from ..render.image import RenderPlan
    from ..simulation.copies import FrameErrorMeter
    from ..simulation.simulation import Simulation
    from ..viewer.capture import Exporter
    from ..viewer.session import Session

PORT = 8080  # of the command `web`
IFRAME_SIZE = 960, 540  # [pixels] size of the <iframe>
MIN_TOKEN = 8  # [characters]
FILE_SUFFIXES = (".png", ".jpg", ".jpeg", ".gif", ".webp", ".mp4", ".mov", ".webm")  # of no folder of images


def add_commands(command: Command) -> None:
    """Add the commands `run`, `web` and `render`."""
    run = command("run", run_scene, "open a scene in a window, or render images if no window can open", "run table")
    scene_options(run, nargs="?")
    run.add_argument(
        "--size", type=size, metavar="WxH", help="size [pixels] (default: 1280x720 for a window, 960x540 for images)"
    )
    run.add_argument(
        "--frames",
        type=count,
        metavar="N",
        help="close the window after N frames, or render N frames (default: no limit, or 240)",
    )
    log_option(run)
    no_errors_option(run)
    run.add_argument("--headless", action="store_true", help="render images to out/run_SCENE, without a window")

    web = command("web", run_web, "serve an interactive browser view of a scene", "web curtain")
    scene_options(web, nargs="?")
    web.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to listen on; all but loopback addresses need a token",
    )
    web.add_argument("--port", type=port, default=PORT, metavar="N", help="port to listen on; 0 picks a free port")
    web.add_argument(
        "--token",
        type=token,
        metavar="WORD",
        help="access token (default: none on a loopback address, else a random one, which is printed)",
    )
    no_errors_option(web)
    web.add_argument(
        "--print-iframe", action="store_true", help="also print an <iframe> element for use in another page"
    )

    render = command(
        "render",
        render_scene,
        "render a scene to PNG images or a video",
        "render curtain --frames 240 --out out/curtain",
    )
    scene_options(render)
    render.add_argument(
        "--frames", type=count, default=DEFAULT_FRAMES, metavar="N", help="number of frames to simulate, of 1/60 s each"
    )
    render.add_argument("--size", type=size, default="960x540", metavar="WxH", help="image size [pixels]")
    render.add_argument("--out", type=file_path, metavar="DIR", help="folder of the images (default: out/SCENE)")
    render.add_argument("--view", choices=VIEWS, default="shaded", metavar="NAME", help=f"view: {any_of(VIEWS)}")
    render.add_argument("--every", type=count, default=1, metavar="K", help="render every Kth frame")
    samples_option(render)
    render.add_argument(
        "--video", type=file_path, metavar="FILE", help="write a video instead of images: an .mp4 or .webp file"
    )
    render.add_argument(
        "--contact-sheet", action="store_true", help="also write contact_sheet.png with twelve of the images"
    )
    render.add_argument(
        "--errors", action="store_true", help="also measure the error of every tenth frame, and write it to run.json"
    )
    existing = render.add_mutually_exclusive_group()
    existing.add_argument("--force", action="store_true", help="overwrite existing images or video")
    existing.add_argument("--resume", action="store_true", help="continue an interrupted render")


def run_scene(args: argparse.Namespace) -> int:
    """Run the command `run`."""
    check_log(args.log)
    scene = chosen_scene(args)
    from ..viewer.toolkit import window_obstacle

    obstacle = "--headless" if args.headless else window_obstacle()
    if obstacle is None:
        from ..system.console import spinner
        from ..viewer import window

        arch = runtime.start(args.arch)
        from ..export.clip import export_snapshot

        with ExitStack() as until_open:
            until_open.enter_context(spinner(f"{scene.name}: compiling kernels (some seconds on the first run)"))

            def announce(simulation: Simulation) -> None:
                until_open.close()
                print(summary(simulation, arch), flush=True)

            window.run(
                partial(open_session, scene, args, export_snapshot),
                size=args.size or (1280, 720),
                frames=args.frames,
                log=args.log,
                announce=announce,
            )
        return 0
    from ..render.image import RenderPlan

    refuse_log(args.log, obstacle)
    print(
        f"no window ({obstacle}): rendering images instead; `taichi-cloth web` shows the scene in a browser", flush=True
    )
    # A folder of its own: each run replaces the images of the last one, never those of `render`.
    frames, (width, height) = args.frames or DEFAULT_FRAMES, args.size or (960, 540)
    plan = RenderPlan(Path("out") / f"run_{scene.name}", frames, width, height, contact_sheet=True)
    replaces = any(plan.out.glob("frame_*.png"))
    status = render_images(scene, plan, args, force=True)
    if replaces:
        print(f"the images of an earlier run in {plan.out} were replaced; `taichi-cloth render --out` keeps its own")
    return status


def open_session(scene: Scene, args: argparse.Namespace, export: Exporter | None = None) -> Session:
    """Return a session that measures the errors of frames unless `--no-errors` is set."""
    from ..viewer.session import Session

    session = Session(scene, args.layout, export=export, save=save_running_scene)
    session.measure_errors(not args.no_errors)
    return session


def render_scene(args: argparse.Namespace) -> int:
    """Run the command `render`."""
    scene = chosen_scene(args)
    from ..render.image import RenderPlan

    if args.out and args.out.suffix.lower() in FILE_SUFFIXES and not args.out.is_dir():
        raise UsageError(f"--out names a folder of images, not a file: {args.out}; --video writes one file")
    plan = RenderPlan(
        out=args.out or Path("out") / scene.name,
        frames=args.frames,
        width=args.size[0],
        height=args.size[1],
        view=args.view,
        every=args.every,
        samples=args.samples,
        contact_sheet=args.contact_sheet,
        errors=args.errors,
    )
    if args.video:
        return render_video(scene, plan, args)
    return render_images(scene, plan, args, force=args.force, resume=args.resume)


def render_images(
    scene: Scene, plan: RenderPlan, args: argparse.Namespace, *, force: bool = False, resume: bool = False
) -> int:
    """Render a scene to numbered PNG files in the folder `plan.out`."""
    from ..render import image
    from ..simulation.convergence import VERLET_MODEL
    from ..simulation.simulation import Simulation
    from ..system.console import count_noun, frames_progress

    arch = runtime.start(args.arch)
    with (
        Simulation(scene, args.layout) as simulation,
        error_meter(simulation, plan) as meter,
        image.claim_folder(plan, simulation, force=force, resume=resume),
    ):
        print(summary(simulation, arch), flush=True)
        try:
            with frames_progress(plan.frames) as advance:
                report = image.render(simulation, plan, meter, advance)
        except KeyboardInterrupt:
            complete = count_noun(len(list(plan.out.glob("frame_*.png"))), "image")
            raise KeyboardInterrupt(f"{complete} in {plan.out}; --resume continues") from None
    if line := error_summary(report.median_error):
        print(line)
        if scene.solver.name == "verlet":
            print(VERLET_MODEL)
    elif plan.errors and plan.frames < image.MEASURED_EVERY:
        print(f"no error was measured: --errors measures every {image.MEASURED_EVERY}th frame")
    print(plan.images + (", and contact_sheet.png" if plan.contact_sheet else ""))
    return 0


def error_meter(simulation: Simulation, plan: RenderPlan) -> AbstractContextManager[FrameErrorMeter | None]:
    """Return a meter for the errors that a plan needs, if any. Raises UsageError if they cannot be measured."""
    from ..simulation.copies import FrameErrorMeter

    if not plan.errors and plan.view != "error":
        return nullcontext()
    try:
        return closing(FrameErrorMeter(simulation.scene, simulation.requested_layout))
    except UsageError as error:
        option = "--errors" if plan.errors else "--view error"
        raise UsageError(f"errors of frames cannot be measured: {error}; without {option} the scene renders") from None


def error_summary(medians: Mapping[str, float | None]) -> str:
    """Return a line with the medians of the error of frames and its parts [m]; empty if none was measured."""
    from ..simulation.copies import millimeters, parts_text, share_text

    error, motion, residual, step_error = (medians[name] for name in ("error", "motion", "residual", "step_error"))
    if error is None or motion is None or step_error is None:
        return ""
    share = share_text(error, motion)
    return f"error of a frame: median {millimeters(error)}{share}; {parts_text(error, residual, step_error)}"


def render_video(scene: Scene, plan: RenderPlan, args: argparse.Namespace) -> int:
    """Render a scene to the video `args.video`. Raises UsageError, OutputConflict and Diverged."""
    from ..viewer.session import Session

    if args.out or args.resume or args.contact_sheet:
        raise UsageError("--video writes one file: it cannot be combined with --out, --resume or --contact-sheet")
    if args.errors:
        raise UsageError("--errors writes run.json, beside images: leave out --video")
    check_video(args.video, force=args.force)
    arch = runtime.start(args.arch)
    with closing(Session(scene, args.layout)) as session:
        print(summary(session.simulation, arch), flush=True)
        session.view = plan.view
        write_video(session, plan, args.video)
        if session.frozen:
            raise Diverged(f"{session.note}; {args.video} ends with that frame")
    return 0


def port(text: str) -> int:
    """Parse a port, 0 to 65535."""
    if not text.isdecimal() or not int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def token(text: str) -> str:
    """Parse a token: printable characters, too many to be guessed within a minute."""
    if len(text) < MIN_TOKEN or not text.isprintable():
        raise argparse.ArgumentTypeError(f"a token needs {MIN_TOKEN} or more printable characters")
    return text


def run_web(args: argparse.Namespace) -> int:
    """Run the command `web` until it is interrupted."""
    scene = chosen_scene(args)
    if importlib.util.find_spec("websockets") is None:
        raise UsageError(f"the browser view needs websockets: {install_command('web')}")
    from ..render.webgl import fill_template
    from ..system.console import spinner
    from ..web.server import PAGE_FILE, AccessControl, WebServer, is_loopback

    loopback = is_loopback(args.host)
    access_token = args.token or ("" if loopback else secrets.token_urlsafe(16))
    access = AccessControl(access_token, only_loopback=loopback)
    with closing(
        WebServer(args.host, args.port, access, fill_template(PAGE_FILE, scene.title or scene.name, {}).encode())
    ) as server:
        arch = runtime.start(args.arch)
        from ..web.app import WebApp

        with spinner(f"{scene.name}: compiling kernels (some seconds on the first run)"):
            session = open_session(scene, args)
        with closing(session):
            print(summary(session.simulation, arch), flush=True)
            name = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(args.host, args.host)
            address = f"http://{f'[{name}]' if ':' in name else name}:{server.port}/{access.query}"
            if not loopback:
                print(f"taichi-cloth: anyone with this address can control the scene: {address}", file=sys.stderr)
            print(f"open {address} in a browser; Ctrl-C stops the server", flush=True)
            if args.print_iframe:
                print(iframe(address), flush=True)
            try:
                WebApp(session, server).run()
            except KeyboardInterrupt:
                print("stopped", flush=True)
    return 0


def iframe(address: str) -> str:
    """Return an `<iframe>` of the cloth alone, without the panel, for another page."""
    width, height = IFRAME_SIZE
    plain = address + ("&" if "?" in address else "?") + "plain"
    return f'<iframe src="{plain.replace("&", "&amp;")}" width="{width}" height="{height}" style="border:0"></iframe>'
