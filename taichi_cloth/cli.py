"""The command line. Exit codes: 0 fine, 2 wrong use or bad input (one line), 1 anything else, 130 interrupted."""

from __future__ import annotations

import argparse
import contextlib
import difflib
import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from typing import NoReturn

from . import __version__, cli_compare, cli_export, cli_measure, cli_replay, cli_run, cli_scenes, cli_web
from .cli_options import Action
from .errors import BlewUp, OutputInUse, WrongUse, one_line, why
from .scene import SceneError

PROGRAM = "taichi-cloth"
FILES = (cli_run, cli_web, cli_compare, cli_export, cli_replay, cli_scenes, cli_measure)  # in the order of the help


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


def build_parser() -> Parser:
    """All commands, their options and defaults."""
    parser = Parser(PROGRAM, description="Cloth you can grab, in real time, that tells you how wrong it is.")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", parser_class=Parser)

    def command(name: str, action: Action, help: str, example: str) -> Parser:
        added = commands.add_parser(
            name,
            help=help,
            description=help,
            epilog=f"example: {PROGRAM} {example}",
            formatter_class=Help,
        )
        added.set_defaults(action=action)
        return added

    for file in FILES:
        file.declare(command)
    return parser


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
