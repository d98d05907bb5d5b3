"""The command line: `python -m taichi_cloth`, and the program `taichi-cloth`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from .cli import output_commands, run, scenes
from .cli.program import run_command
from .evaluation import commands, compare


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code. `argv`: its words, by default those of the process."""
    modules = (run, compare, output_commands, scenes, commands)  # in the order of `--help`
    return run_command(modules, sys.argv[1:] if argv is None else argv)


if __name__ == "__main__":
    sys.exit(main())
