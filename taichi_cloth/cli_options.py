"""What commands share: values on the command line, the options of a scene, and the line that every run prints."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Protocol

from . import runtime
from .scene import Scene, load_scene, parse_override
from .scene.leave_out import scene_without

if TYPE_CHECKING:
    from .simulation import Simulation

DEFAULT_SCENE = "curtain"
DEFAULT_FRAMES = 240
VIEWS = ("shaded", "strain", "wireframe", "particles")


class Action(Protocol):
    """Does what a command line says, and returns the exit code."""

    def __call__(self, args: argparse.Namespace) -> int: ...


class Command(Protocol):
    """Adds a command to the program."""

    def __call__(self, name: str, action: Action, help: str, example: str) -> argparse.ArgumentParser: ...


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


def strain(text: str) -> float:
    """A strain that threads may tear at."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.01 <= value <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a strain from 0.01 to 100, as 0.5 for half its length more")
    return value


def scene_options(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
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


def chosen_scene(args: argparse.Namespace) -> Scene:
    """What `scene_options` say. Raises SceneError."""
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
    """The line every run prints: scene, solver, substeps × iterations, path, grid, stages, arch, seed.

    A second one tells where substeps are not those that were asked for, or iterations end too early.
    """
    from .measure.convergence import unfinished
    from .mesh.from_scene import count_of
    from .scene.model import FRAME_SECONDS

    scene = simulation.scene
    line = (
        f"{scene.name} · {simulation.method}"
        f" · {count_of(scene)} · {' '.join(simulation.stages)} · {arch} · seed {scene.seed}"
    )
    solver = scene.solver
    left = unfinished(scene, simulation.topology, FRAME_SECONDS / simulation.substeps, solver.iterations)
    return "\n".join(filter(None, [line, simulation.advice, left]))
