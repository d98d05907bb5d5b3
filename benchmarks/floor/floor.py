"""Times the programs beside this file: how fast a frame of cloth is without Python, on this machine, now.

    python benchmarks/floor/floor.py relax 24 30 5 12 300

`relax` and `explicit` are compiled from C the first time; `frame` is run by node.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
BUILDS = HERE / ".build"
PROGRAMS = ("relax", "explicit", "frame")

FLAGS = ("-O3", "-Wall", "-Wextra")

TIME_LIMIT = 600  # [s]


class FloorError(RuntimeError):
    """A program that does not compile, or that ends with an error of its own."""


def compiler() -> str | None:
    """The C compiler's command: $CC if it is set, else the first of cc, gcc and clang; None if there is none."""
    wanted = os.environ.get("CC")
    for command in [wanted] if wanted else ["cc", "gcc", "clang"]:
        if shutil.which(shlex.split(command)[0]):
            return command
    return None


def compile_command(program: str, target: Path, *, native: bool) -> list[str]:
    """The call that compiles `program`; `native` uses all that this processor can do."""
    command = compiler()
    if command is None:
        raise FloorError("no C compiler: neither $CC nor cc, gcc or clang")
    machine = ["-march=native"] if native else []
    return [*shlex.split(command), *FLAGS, *machine, str(HERE / f"{program}.c"), "-o", str(target), "-lm"]


def build(program: str, into: Path) -> Path:
    """Compiles `program` into a folder unless it is there already; returns the executable.

    The file's name holds a hash of all that decides about it, sources and machine. Raises FloorError.
    """
    key = hashlib.sha256(repr((compiler(), FLAGS, platform.uname())).encode())
    for source in sorted([*HERE.glob("*.h"), HERE / f"{program}.c"]):
        key.update(source.read_bytes())
    target = into / f"{program}-{key.hexdigest()[:16]}{'.exe' if os.name == 'nt' else ''}"
    if target.exists():
        return target
    into.mkdir(parents=True, exist_ok=True)
    fresh = target.with_name(f"{os.getpid()}-{target.name}")  # renamed when whole: another process may build too
    for native in (True, False):  # not every compiler knows its own machine
        result = subprocess.run(compile_command(program, fresh, native=native), capture_output=True, text=True)
        if result.returncode == 0:
            fresh.replace(target)
            return target
    raise FloorError(f"{program}.c does not compile: {(result.stderr.strip() or 'no message').splitlines()[0]}")


def command_of(program: str, into: Path = BUILDS) -> list[str] | None:
    """What starts a program, or None where the compiler (C) or node (`frame`) for it is missing."""
    if program not in PROGRAMS:
        raise FloorError(f"no program {program!r}: there are {', '.join(PROGRAMS)}")
    if program == "frame":
        node = shutil.which("node")
        return [node, str(HERE / "frame.mjs")] if node else None
    return [str(build(program, into))] if compiler() else None


def time_floor(
    program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int
) -> dict[str, Any] | None:
    """The line a program prints, as a dict; None where it cannot be had on this machine. Raises FloorError.

    `explicit` has nothing to iterate: its `iterations` is 1.
    """
    command = command_of(program)
    if command is None:
        return None
    numbers = [str(n) for n in (rows, columns, substeps, iterations, frames)]
    result = subprocess.run([*command, *numbers], capture_output=True, text=True, timeout=TIME_LIMIT)
    if result.returncode:
        raise FloorError(f"{program} {' '.join(numbers)}: {result.stderr.strip()}")
    line: dict[str, Any] = json.loads(result.stdout)
    return line


def main(words: list[str]) -> int:
    try:
        program, *numbers = words
        rows, columns, substeps, iterations, frames = map(int, numbers)
    except ValueError:
        print(f"arguments: {'|'.join(PROGRAMS)} ROWS COLUMNS SUBSTEPS ITERATIONS FRAMES", file=sys.stderr)
        return 2
    try:
        line = time_floor(program, rows, columns, substeps, iterations, frames)
    except FloorError as error:
        print(error, file=sys.stderr)
        return 1
    print(json.dumps(line) if line else f"{program}: no compiler or node for it here")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
