"""The command line.

Exit codes: 0 for success, 1 for a failure, 2 for a usage error or invalid input, 130 after an interrupt. An error is
one line on stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import NoReturn, Protocol

from .. import __version__
from ..scene import SceneError, scene_names
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
from .options import Action, Command

PROGRAM = "taichi-cloth"
COMMAND = "COMMAND"  # in help and messages


class CommandModule(Protocol):
    """A module with commands of the program."""

    def add_commands(self, command: Command) -> None: ...


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
                self.error(f"unknown option {option}{nearest_hint(option, self._option_string_actions)}")
        self.error(f"too many arguments: {' '.join(words)}")


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
    """Return whether a word is a shipped scene or a scene file, which `run` opens, and not a command."""
    return word.endswith(".toml") or word in scene_names()


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
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted; files that were written are complete", file=sys.stderr)
        return 130
    except (SceneError, OutputConflict, UsageError) as error:
        print(f"{PROGRAM}: {one_line(str(error))}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # as in `| head -1`: print nothing more, not even when Python exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, Diverged) as error:
        print(f"{PROGRAM}: {one_line(error_text(error))}", file=sys.stderr)
        return 1
