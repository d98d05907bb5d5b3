"""The command line. Exit codes: 0 fine, 2 wrong use or bad input (one line), 1 anything else, 130 interrupted."""

from __future__ import annotations

import argparse
import contextlib
import difflib
import io
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from . import __version__, runtime
from .cli_compare import compare
from .cli_export import run_export
from .cli_measure import run_ablate, run_bench, run_stress, run_validate
from .cli_replay import render_film, run_replay
from .errors import BlewUp, OutputInUse, WrongUse, one_line, why
from .export.output import FORMATS, UPS
from .scene import Scene, SceneError, key_table, load_scene, parse_override, scene_names
from .scene.leave_out import scene_without
from .scene.model import PRESET_NAMES, SOLVER_NAMES
from .scene.presets import load_preset

if TYPE_CHECKING:
    from .simulation import Simulation
    from .view.frames import Plan

PROGRAM = "taichi-cloth"
DEFAULT_SCENE = "curtain"
DEFAULT_FRAMES = 240
VIEWS = ("shaded", "strain", "wireframe", "particles")


class Parser(argparse.ArgumentParser):
    """argparse that answers a mistake with one line, and a mistyped word with the nearest one."""

    def error(self, message: str) -> NoReturn:
        if "invalid choice:" in message:
            wrong, _, choices = message.partition("invalid choice: ")[2].partition(" (choose from ")
            near = difflib.get_close_matches(wrong.strip("'"), choices.rstrip(")").replace("'", "").split(", "), 1)
            message += f"; did you mean {near[0]!r}?" if near else ""
        self.exit(2, f"{self.prog}: {one_line(message)} (see {self.prog} --help)\n")


class Help(argparse.ArgumentDefaultsHelpFormatter):
    """Shows the defaults that say something, once."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        told = action.help is not None and "(default: " in action.help
        return action.help if told or action.default in (None, False, []) else super()._get_help_string(action)


def size(text: str) -> tuple[int, int]:
    """WxH in pixels."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()) or not all(1 <= int(n) <= 8192 for n in (width, height)):
        raise argparse.ArgumentTypeError(f"{text!r} is not WxH in pixels (1 to 8192), as in 960x540")
    return int(width), int(height)


def count(text: str) -> int:
    """A whole number from 1 up."""
    if not text.isdecimal() or not 1 <= int(text) <= 10_000_000:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 10000000")
    return int(text)


def percent(text: str) -> float:
    """A number above 0 and up to 100."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0 and up to 100, in % of the side")
    return value


def build_parser() -> Parser:
    """All commands, their options and defaults."""
    parser = Parser(PROGRAM, description="Cloth you can grab, in real time, that tells you how wrong it is.")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", parser_class=Parser)

    def command(name: str, action: Callable[[argparse.Namespace], int], help: str, example: str) -> Parser:
        added = commands.add_parser(
            name,
            help=help,
            description=help,
            epilog=f"example: {PROGRAM} {example}",
            formatter_class=Help,
        )
        added.set_defaults(action=action)
        return added

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

    comparing = command(
        "compare",
        compare,
        "a scene in two ways, side by side, with the time, the strain and the error of each",
        "compare curtain --a solver=verlet,iterations=2 --b solver=spring",
    )
    comparing.add_argument("scene", metavar="SCENE", help="a shipped scene or a TOML file")
    for letter, side in (("a", "left"), ("b", "right")):
        comparing.add_argument(
            f"--{letter}",
            action="append",
            default=[],
            metavar="KEY=VALUE,…",
            help=f"what is other on the {side}, as in solver=spring",
        )
    comparing.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="what is other in both")
    comparing.add_argument("--arch", choices=runtime.ARCHS, default="cpu", help="Taichi back-end")
    comparing.add_argument("--frames", type=count, default=DEFAULT_FRAMES, metavar="N", help="frames of 1/60 s")
    comparing.add_argument("--size", type=size, default="1280x540", metavar="WxH", help="size of a picture in pixels")
    comparing.add_argument("--view", choices=VIEWS, default="shaded", help="how the cloth is drawn")
    comparing.add_argument("--every", type=count, default=1, metavar="K", help="draw every K-th frame only")
    comparing.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the pictures (default: out/compare_SCENE)"
    )
    comparing.add_argument("--force", action="store_true", help="replace the pictures in DIR")
    export = command(
        "export", export_scene, "write the cloth as a mesh, after some frames", "export curtain --frames 60 --out c.obj"
    )
    export_options(export)
    export.add_argument("--clip", action="store_true", help="write a whole clip, as `bake` does")

    bake = command("bake", export_scene, "write a whole clip of the cloth", "bake curtain --frames 240 --out clip.pc2")
    export_options(bake)
    bake.set_defaults(clip=True)
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

    listing = command("list", list_scenes, "list the shipped scenes, a line each", "list")
    listing.add_argument("--presets", action="store_true", help="list the fabrics instead, with the numbers they have")

    bench = command("bench", run_bench, "measure frames, compiling and memory on this machine", "bench --only verlet")
    which = bench.add_mutually_exclusive_group()
    which.add_argument("--only", choices=SOLVER_NAMES, metavar="SOLVER", help="measure one solver")
    which.add_argument("--stages", action="store_true", help="what each stage of the curtain costs, instead")
    bench.add_argument("--error", action="store_true", help="how wrong each setting is, beside its time, instead")
    bench.add_argument(
        "--scene",
        action="append",
        default=[],
        metavar="SCENE",
        help="with --error: on this scene instead of the curtain",
    )
    bench.add_argument("--markdown", type=Path, metavar="FILE", help="with --scene: write the tables for a document")
    bench.add_argument("--plot", type=Path, metavar="DIR", help="with --error: a picture for each grid")
    bench.add_argument("--full", action="store_true", help="all there is; takes half an hour")
    bench.add_argument("--frames", type=count, default=120, metavar="N", help="frames to time in each measurement")
    bench.add_argument("--csv", type=Path, metavar="FILE", help="write the measurements, a line each")
    bench.add_argument("--json", type=Path, metavar="FILE", help="write measurements, stages and machine")
    bench.add_argument("--force", action="store_true", help="replace FILE")

    validate = command(
        "validate", run_validate, "measure every solver against known answers", "validate --only A2 --solver spring"
    )
    validate.add_argument("--only", metavar="REF", help="one reference, or all that begin so: A2.1, A2, B")
    validate.add_argument("--solver", choices=SOLVER_NAMES, metavar="NAME", help="one solver")
    validate.add_argument("--json", type=Path, metavar="FILE", help="write the rows, with bounds and sources")
    validate.add_argument("--markdown", type=Path, metavar="FILE", help="write the table for a document")
    validate.add_argument("--force", action="store_true", help="replace FILE")

    stress = command("stress", run_stress, "run 40 cases that break cloth", "stress --only yank --solver lines")
    stress.add_argument("--only", metavar="CASE", help="one case, by its number or name")
    stress.add_argument("--solver", choices=(*SOLVER_NAMES, "robust"), metavar="NAME", help="one solver, or robust")
    stress.add_argument("--starts", type=count, default=10, metavar="N", help="starts of each case")
    stress.add_argument("--long", action="store_true", help="with --only 32: a million frames")
    stress.add_argument("--json", type=Path, metavar="FILE", help="write every start, with what broke")
    stress.add_argument("--markdown", type=Path, metavar="FILE", help="write the page for a document")
    stress.add_argument(
        "--pictures", type=Path, default=Path("out/stress"), metavar="DIR", help="folder for frames that failed"
    )
    stress.add_argument("--force", action="store_true", help="replace FILE")

    ablate = command("ablate", run_ablate, "what each stage of a scene costs, and what it changes", "ablate curtain")
    ablate.add_argument("scenes", nargs="+", metavar="SCENE", help="shipped scenes or TOML files")
    ablate.add_argument("--frames", type=count, default=120, metavar="N", help="frames to compare at most")
    ablate.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables for a document")
    ablate.add_argument("--force", action="store_true", help="replace FILE")

    check = command("check", check_file, "check a scene file", "check my_scene.toml")
    what = check.add_mutually_exclusive_group(required=True)
    what.add_argument("file", nargs="?", metavar="FILE", help="a scene file, or the name of a shipped scene")
    what.add_argument("--keys", action="store_true", help="list every key with its default, unit and range")
    return parser


def scene_options(parser: Parser, nargs: str | None = None) -> None:
    """The options of every command that runs a scene."""
    default = DEFAULT_SCENE if nargs else None
    parser.add_argument("scene", nargs=nargs, default=default, metavar="SCENE", help="a shipped scene or a TOML file")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a key of the scene, as in wind_z=6"
    )
    parser.add_argument(
        "--without", action="append", default=[], metavar="STAGE", help="leave out a stage of the scene, as limit"
    )
    parser.add_argument("--solver", metavar="NAME", help="method that advances the cloth (default: the scene's)")
    parser.add_argument(
        "--path", metavar="NAME", help="layout the solver works on, as lanes or list (default: chosen by the grid)"
    )
    parser.add_argument(
        "--target-error",
        type=percent,
        metavar="P",
        help="take the fastest setting that is at most P %% of the side wrong",
    )
    parser.add_argument("--arch", choices=runtime.ARCHS, default="cpu", help="Taichi back-end")


def export_options(parser: Parser) -> None:
    """The options of `export` and `bake`."""
    scene_options(parser)
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


def chosen_scene(args: argparse.Namespace) -> Scene:
    overrides = dict(parse_override(text) for text in args.set)
    if args.solver:
        overrides["solver"] = args.solver
    scene = scene_without(load_scene(args.scene, **overrides), args.without)
    if args.target_error is None:
        return scene
    from .measure.estimate import aim

    scene, why = aim(scene, args.target_error / 100, args.solver)
    print(why, flush=True)
    return scene


def summary(simulation: Simulation, arch: str) -> str:
    """The line every run prints: scene, solver, substeps × iterations, path, grid, stages, arch, seed."""
    from .mesh.from_scene import count_of

    scene = simulation.scene
    line = (
        f"{scene.name} · {simulation.method}"
        f" · {count_of(scene)} · {' '.join(simulation.stages)} · {arch} · seed {scene.seed}"
    )
    return "\n".join(filter(None, [line, simulation.advice]))


# -- commands: each returns the exit code --------------------------------------------------------------


def run_scene(args: argparse.Namespace) -> int:
    scene = chosen_scene(args)
    from .view.display import window_obstacle

    obstacle = "--headless was given" if args.headless else window_obstacle()
    if obstacle is None:
        from .progress import waiting
        from .view import window

        arch = runtime.start(args.arch)
        from .view.session import Session

        with contextlib.ExitStack() as until_open:
            until_open.enter_context(waiting(f"{scene.name}: compiling, which takes some seconds the first time"))

            def announce(simulation: Simulation) -> None:
                until_open.close()
                print(summary(simulation, arch), flush=True)

            window.run(
                partial(Session, scene, args.path), size=args.size, frames=args.frames, log=args.log, announce=announce
            )
        return 0
    from .view.frames import Plan

    print(f"no window ({obstacle}): rendering frames instead", flush=True)
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
        return render_film(scene, plan, args, lambda s, arch: print(summary(s, arch), flush=True))
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


def export_scene(args: argparse.Namespace) -> int:
    return run_export(chosen_scene(args), args, summary)


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


# -- the program ---------------------------------------------------------------------------------------


@contextlib.contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Lets `kill` end a run as Ctrl-C does, with every file whole."""

    def interrupt(number: int, frame: object) -> NoReturn:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without · and × still gets the rest of the line
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or (words[0].startswith("-") and words[0] not in ("-h", "--help", "--version")):
        words.insert(0, "run")
    args = build_parser().parse_args(words)
    if "action" not in args:  # "--version" and "--help" have ended the program already
        build_parser().error("a command is missing")
    try:
        with sigterm_interrupts():
            return int(args.action(args))
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted; finished files are whole", file=sys.stderr)
        return 130
    except (SceneError, OutputInUse, WrongUse) as error:
        print(f"{PROGRAM}: {one_line(str(error))}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader of our output has gone, as in `| head -1`: no more to say, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, BlewUp) as error:
        print(f"{PROGRAM}: {one_line(why(error))}", file=sys.stderr)
        return 1
