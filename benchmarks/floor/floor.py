"""Times the programs beside this file: how fast a frame of cloth is without Python, on this machine, now.

    python benchmarks/floor/floor.py relax 24 30 5 12 300
    python benchmarks/floor/floor.py relax 24 30 5 12 300 4

`relax` and `explicit` are compiled from C the first time, with a last 4 for registers of four floats, whatever the
processor has; `frame` is run by node.
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


def compile_command(program: str, target: Path, lanes: int | None = None, *, native: bool) -> list[str]:
    """The call that compiles `program`; `native` uses all that this processor can do, `lanes` floats at once."""
    command = compiler()
    if command is None:
        raise FloorError("no C compiler: neither $CC nor cc, gcc or clang")
    machine = ["-march=native"] if native else []
    width = [f"-DLANES={lanes}"] if lanes else []
    return [*shlex.split(command), *FLAGS, *machine, *width, str(HERE / f"{program}.c"), "-o", str(target), "-lm"]


def build(program: str, into: Path, lanes: int | None = None) -> Path:
    """Compiles `program` into a folder unless it is there already; returns the executable.

    It treats `lanes` floats at once (4, 8), by default as many as a register holds.

    The file's name holds a hash of all that decides about it, sources and machine. Raises FloorError.
    """
    key = hashlib.sha256(repr((compiler(), FLAGS, lanes, platform.uname())).encode())
    for source in sorted([*HERE.glob("*.h"), HERE / f"{program}.c"]):
        key.update(source.read_bytes())
    target = into / f"{program}-{key.hexdigest()[:16]}{'.exe' if os.name == 'nt' else ''}"
    if target.exists():
        return target
    into.mkdir(parents=True, exist_ok=True)
    fresh = target.with_name(f"{os.getpid()}-{target.name}")  # renamed when whole: another process may build too
    for native in (True, False):  # not every compiler knows its own machine
        result = subprocess.run(compile_command(program, fresh, lanes, native=native), capture_output=True, text=True)
        if result.returncode == 0:
            fresh.replace(target)
            return target
    raise FloorError(f"{program}.c does not compile: {(result.stderr.strip() or 'no message').splitlines()[0]}")


def command_of(program: str, into: Path = BUILDS, lanes: int | None = None) -> list[str] | None:
    """What starts a program, or None where the compiler (C) or node (`frame`) for it is missing."""
    if program not in PROGRAMS:
        raise FloorError(f"no program {program!r}: there are {', '.join(PROGRAMS)}")
    if program == "frame":
        node = shutil.which("node")
        return [node, str(HERE / "frame.mjs")] if node else None
    return [str(build(program, into, lanes))] if compiler() else None


def time_floor(
    program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int, lanes: int | None = None
) -> dict[str, Any] | None:
    """The line a program prints, as a dict; None where it cannot be had on this machine. Raises FloorError.

    `explicit` has nothing to iterate: its `iterations` is 1. `lanes` is for programs in C, see `build`.
    """
    command = command_of(program, lanes=lanes)
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
        rows, columns, substeps, iterations, frames, *lanes = map(int, numbers)
        if lanes and (lanes not in ([4], [8]) or program == "frame"):
            raise ValueError
    except ValueError:
        print(f"arguments: {'|'.join(PROGRAMS)} ROWS COLUMNS SUBSTEPS ITERATIONS FRAMES [4|8, in C]", file=sys.stderr)
        return 2
    try:
        line = time_floor(program, rows, columns, substeps, iterations, frames, *lanes)
    except FloorError as error:
        print(error, file=sys.stderr)
        return 1
    print(json.dumps(line) if line else f"{program}: no compiler or node for it here")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
