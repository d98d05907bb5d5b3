"""The command line: its parser, the options that commands share, and exit codes.

Exit codes: 0 for success, 1 for a failure, 2 for a usage error or invalid input, 130 after an interrupt. An error is
one line on stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import nan
from pathlib import Path
from typing import NoReturn, Protocol

from .. import __version__
from ..scene import Scene, SceneError, parse_override, scene_names
from ..scene.overrides import override_targets, scene_without
from ..scene.presets import is_file_name
from ..scene.schema import SOLVER_NAMES
from ..system import taichi_runtime as runtime
from ..system.errors import (
    RENAMED_COMMANDS,
    RENAMED_OPTIONS,
    Diverged,
    OutputConflict,
    UsageError,
    error_text,
    nearest_hint,
    one_line,
)

PROGRAM = "taichi-cloth"
COMMAND = "COMMAND"  # in help and messages
DEFAULT_SCENE = "curtain"
DEFAULT_FRAMES = 240
VIEWS = ("shaded", "strain", "error", "wireframe", "particles")


class Action(Protocol):
    """Runs a command with its parsed options and returns the exit code."""

    def __call__(self, args: argparse.Namespace) -> int: ...


class Command(Protocol):
    """Adds a command to the program and returns its parser. `example`: a command line without the program's name."""

    def __call__(self, name: str, action: Action, help: str, example: str) -> argparse.ArgumentParser: ...


class CommandModule(Protocol):
    """A module with commands of the program."""

    def add_commands(self, command: Command) -> None: ...


# What a command has in place of an option that others have, or that one would try.
OPTIONS_OF_OTHERS = {
    ("bench", "--solver"): "--filter NAME",
    ("compare", "--solver"): "--a solver=NAME --b solver=NAME",
    ("run", "--scene"): "the name alone, as in `run NAME`",
    ("run", "--view"): "V in the window, or `render --view`",
    ("render", "--scene"): "the name alone, as in `render NAME`",
    ("render", "--width"): "--size WIDTHxHEIGHT",
    ("render", "--height"): "--size WIDTHxHEIGHT",
    ("render", "--eye"): "--set 'camera.eye=[X,Y,Z]'",
    ("render", "--target"): "--set 'camera.target=[X,Y,Z]'",
}


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, with the nearest valid word for a mistyped one."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {one_line(with_hint(message))} (see {self.prog} --help)\n")

    def refuse(self, words: Sequence[str]) -> NoReturn:
        """Exit because of words that are no arguments of the command. Options come with the nearest valid one."""
        for word in words:
            option = word.partition("=")[0]
            if option in RENAMED_OPTIONS:
                self.error(f"{option} was renamed to {RENAMED_OPTIONS[option]}")
            if option.startswith("-"):
                known = OPTIONS_OF_OTHERS.get((self.prog.split()[-1], option))
                key = option.strip("-").replace("-", "_")
                if not known and "--set" in self._option_string_actions and key in override_targets():
                    known = f"--set {key}=VALUE"
                hint = f"; use {known}" if known else nearest_hint(option, self._option_string_actions)
                self.error(f"unknown option {option}{hint}")
        joined = "; join keys by commas: KEY=VALUE,KEY=VALUE" if all("=" in word for word in words) else ""
        if any(word.startswith("=") for word in words):
            joined = "; write KEY=VALUE without spaces"
        if "--scene" in self._option_string_actions:
            joined = "; --error --scene NAME measures on a scene"
        self.error(f"too many arguments: {' '.join(words)}{joined}")


def with_hint(message: str) -> str:
    """Return an error message of argparse; for an invalid choice with its new name, or the nearest valid one."""
    if "invalid choice: " not in message:
        return message
    shown, _, text = message.partition("invalid choice: ")[2].partition(" (choose from ")
    word, choices = shown.strip("'"), text.rstrip(")").replace("'", "").split(", ")
    if not message.startswith(f"argument {COMMAND}: "):
        return message + nearest_hint(word, choices)
    if word in RENAMED_COMMANDS:
        return f"{word} was renamed to {RENAMED_COMMANDS[word]}"
    hint = nearest_hint(word, [*choices, *scene_names()])  # `taichi-cloth SCENE` runs a scene
    if os.path.isfile(file := f"{word}.toml"):  # false for names that are too long, where Path.is_file raises
        hint = f"; did you mean {file!r}?"
    return f"unknown command {shown}" + (hint or f": {', '.join(choices)}")


class Help(argparse.ArgumentDefaultsHelpFormatter):
    """A help formatter that appends defaults, but not None, False and [] and not where the text has one already."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        has_default = action.help is not None and "(default: " in action.help
        return action.help if has_default or action.default in (None, False, []) else super()._get_help_string(action)


def build_parser(modules: Iterable[CommandModule]) -> Parser:
    """Return the parser with all commands, their options and defaults."""
    parser = Parser(PROGRAM, description="Interactive real-time cloth simulation with measured errors.")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(title="commands", metavar=COMMAND, parser_class=Parser)

    def command(name: str, action: Action, help: str, example: str) -> Parser:
        added = commands.add_parser(
            name,
            help=help,
            description=help,
            epilog=f"example: {PROGRAM} {example}",
            formatter_class=Help,
            allow_abbrev=False,  # a mistyped option could be the beginning of another
        )
        added.set_defaults(action=action, parser=added)
        return added

    for module in modules:
        module.add_commands(command)
    return parser


@contextlib.contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM within the block, so that `kill` ends a run like Ctrl-C."""

    def interrupt(number: int, frame: object) -> NoReturn:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def is_scene(word: str) -> bool:
    """Return whether a word is a shipped scene or the path of a file, which `run` opens, and not a command."""
    return not word.startswith("-") and (is_file_name(word) or word in scene_names())


def run_command(modules: Iterable[CommandModule], argv: Sequence[str]) -> int:
    """Run one command of the program and return its exit code. `argv`: its words."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # for terminals that cannot print · and ×
    words = list(argv)
    if not words or is_scene(words[0]) or (words[0].startswith("-") and words[0] not in ("-h", "--help", "--version")):
        words.insert(0, "run")
    parser = build_parser(modules)
    args, unknown = parser.parse_known_args(words)
    if unknown:
        getattr(args, "parser", parser).refuse(unknown)
    if "action" not in args:  # --version and --help exit while parsing
        parser.error("missing command")
    try:
        with sigterm_interrupts():
            return int(args.action(args))
    except KeyboardInterrupt as interrupt:
        print(f"{PROGRAM}: interrupted; {str(interrupt) or 'files that were written are complete'}", file=sys.stderr)
        return 130
    except (SceneError, OutputConflict, UsageError) as error:
        print(f"{PROGRAM}: {one_line(str(error))}{other_mistakes(error)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # as in `| head -1`: print nothing more, not even when Python exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, Diverged) as error:
        print(f"{PROGRAM}: {one_line(error_text(error))}", file=sys.stderr)
        return 1


def other_mistakes(error: Exception) -> str:
    """Return how many mistakes a scene has besides the first one, and what lists them; empty if there are none."""
    from ..system.console import count_noun  # which imports Rich

    others = error.others if isinstance(error, SceneError) else ()
    return f" ({count_noun(len(others), 'more mistake')}; `{PROGRAM} check` lists all)" if others else ""


# -- options that commands share ---------------------------------------------------------------------------------------


def size(text: str) -> tuple[int, int]:
    """Parse a size, WxH [pixels], 1 to 8192 each."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()) or not all(1 <= int(n) <= 8192 for n in (width, height)):
        raise argparse.ArgumentTypeError(f"{text!r} is not WxH in pixels, 1 to 8192 each, such as 960x540")
    return int(width), int(height)


def count(text: str) -> int:
    """Parse an integer from 1 to 10,000,000."""
    if not text.isdecimal() or not 1 <= int(text) <= 10_000_000:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer from 1 to 10000000")
    return int(text)


def file_path(text: str) -> Path:
    """Parse the path of a file or folder. An empty text, as of an unset shell variable, would be the current folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError("the path is empty")
    return Path(text)


def seed(text: str) -> int:
    """Parse a random seed, an integer of up to 20 digits."""
    if not text.isdecimal() or len(text) > 20:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer from 0 to {10**20 - 1}")
    return int(text)


def number(low: float, high: float, what: str) -> Callable[[str], float]:
    """Return a function that parses numbers from `low` to `high`. Its message says that a text is not `what`."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
        return value

    return parse


percent = number(sys.float_info.min, 100, "a percentage of the longer side above 0 and up to 100")
milliseconds = number(0.001, 10_000, "a time from 0.001 to 10000 [ms]")
strain = number(0.01, 100, "a strain from 0.01 to 100, such as 0.5 for 50 % longer")


def any_of(words: Sequence[str]) -> str:
    """Return the allowed values of an option as text: `y or z`, `simd, serial or parallel`."""
    return f"{', '.join(words[:-1])} or {words[-1]}"


ARCH_HELP = f"Taichi backend: {any_of(runtime.ARCHS)}, which is the first GPU backend found"


def no_errors_option(parser: argparse.ArgumentParser) -> None:
    """Add `--no-errors` to a command that shows a running scene."""
    parser.add_argument(
        "--no-errors", action="store_true", help="do not measure the errors of frames; press U to measure them later"
    )


def set_option(parser: argparse.ArgumentParser) -> None:
    """Add `--set`, whose texts `overrides` reads."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="scene keys to override, such as wind.z=6 or rows=20,columns=30; repeatable",
    )


def variant_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that change scenes, which `changes_of` and `scene_without` read."""
    set_option(parser)
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="FEATURE",
        help="feature of the scene to leave out, such as tethers; repeatable",
    )
    parser.add_argument("--solver", metavar="NAME", help=f"solver: {any_of(SOLVER_NAMES)} (default: the scene's)")


def scene_options(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Add the options of every command that runs a scene. `nargs` "?" makes the scene optional."""
    default = DEFAULT_SCENE if nargs else None
    parser.add_argument("scene", nargs=nargs, default=default, metavar="SCENE", help="shipped scene or TOML file")
    variant_options(parser)
    parser.add_argument(
        "--layout",
        metavar="NAME",
        help="memory layout: simd, serial or parallel (default: the first that suits the cloth)",
    )
    target = parser.add_mutually_exclusive_group()
    target.add_argument(
        "--target-error",
        type=percent,
        metavar="P",
        help="use the fastest stored setting with an RMS error of at most P [%% of the longer side]",
    )
    target.add_argument(
        "--target-time",
        type=milliseconds,
        metavar="MS",
        help="use the most accurate stored setting whose frame takes at most MS [ms]",
    )
    parser.add_argument("--arch", choices=runtime.ARCHS, default="cpu", metavar="NAME", help=ARCH_HELP)


NEXT_KEY = re.compile(r",(?=\s*\w[\w.\[\]]*\s*=)")  # a comma before another key


def overrides(texts: Iterable[str], option: str) -> dict[str, object]:
    """Parse texts such as `solver=verlet,wind={x=1,z=6}`. Return values by key.

    Raises SceneError, which names the `option`, for invalid text.
    """
    found: dict[str, object] = {}
    for text in texts:
        if text in SOLVER_NAMES:
            raise SceneError(option, text, "must be KEY=VALUE", f"solver={text}")
        ends = [comma.start() for comma in NEXT_KEY.finditer(text) if is_outside_values(text[: comma.start()])]
        starts = [0, *(end + 1 for end in ends)]
        found |= (parse_override(text[a:b], option) for a, b in zip(starts, [*ends, len(text)], strict=True))
    return found


def is_outside_values(before: str) -> bool:
    """Return whether a text ends outside all brackets and quotes."""
    opened, closed = (sum(map(before.count, brackets)) for brackets in ("[{", "]}"))
    return opened == closed and all(before.count(quote) % 2 == 0 for quote in "\"'")


SELECTED_KEYS = {key for name in ("substeps", "iterations") for key in (name, f"solver.{name}")}  # by a target


def changes_of(args: argparse.Namespace) -> dict[str, object]:
    """Return the values by key that `--set` and `--solver` select. Raises SceneError for invalid text."""
    changes = overrides(args.set, "--set")
    return {**changes, "solver": args.solver} if args.solver else changes


def chosen_scene(args: argparse.Namespace) -> Scene:
    """Return the scene that the options select.

    Raises SceneError, and UsageError for a target out of reach or beside a setting of its own.
    """
    from ..geometry.scene_loader import load_scene

    changes = changes_of(args)
    scene = scene_without(load_scene(args.scene, **changes), args.without)
    if args.target_error is None and args.target_time is None:
        return scene
    from ..simulation.error_estimate import settings_for_error, settings_for_time

    if selected := sorted(changes.keys() & SELECTED_KEYS):
        option = "--target-error" if args.target_error else "--target-time"
        raise UsageError(f"{option} selects substeps and iterations: leave out --set {selected[0]}")
    only = scene.solver.name if changes.keys() & {"solver", "solver.name"} else None
    if args.target_error:
        scene, why = settings_for_error(scene, args.target_error / 100, only)
    else:
        scene, why = settings_for_time(scene, args.target_time, only)
    here = f"`{PROGRAM} bench --error --scene {args.scene}` measures this scene on this machine"
    print(f"{why}\nThese are stored RMS errors and times; {here}", flush=True)
    return scene


def check_log(path: Path | None) -> None:
    """Prepare the file of a log, before a window opens. Raises OutputConflict and UsageError."""
    if path:
        from ..system.console import check_output_file

        check_output_file(path, force=True)
        path.parent.mkdir(parents=True, exist_ok=True)


def refuse_log(path: Path | None, obstacle: str) -> None:
    """Raise UsageError if there is a log, whose lines are of displayed frames, and `obstacle` prevents a window."""
    if path:
        raise UsageError(f"--log has a line per displayed frame, but no window opens ({obstacle})")
