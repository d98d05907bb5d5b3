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
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
BUILDS = HERE / ".build"
PROGRAMS = ("relax", "explicit", "frame")

# Every liberty that a compiler may take, but for the check that the cloth is still finite.
FLAGS = ("-O3", "-ffast-math", "-fno-finite-math-only", "-Wall", "-Wextra")
WIDE = 16  # lanes of the second build, where the processor has AVX-512: faster or slower, as the grid fills them

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


def compile_command(program: str, target: Path, *, native: bool, lanes: int | None = None) -> list[str]:
    """The call that compiles `program`; `native` uses all that this processor can do, `lanes` None its usual width."""
    command = compiler()
    if command is None:
        raise FloorError("no C compiler: neither $CC nor cc, gcc or clang")
    machine = ["-march=native"] if native else []
    width = [] if lanes is None else [f"-DLANES={lanes}"]
    return [*shlex.split(command), *FLAGS, *machine, *width, str(HERE / f"{program}.c"), "-o", str(target), "-lm"]


def build(program: str, into: Path, lanes: int | None = None) -> Path:
    """Compiles `program` into a folder unless it is there already; returns the executable.

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
        command = compile_command(program, fresh, native=native, lanes=lanes)
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode == 0:
            fresh.replace(target)
            return target
    raise FloorError(f"{program}.c does not compile: {(result.stderr.strip() or 'no message').splitlines()[0]}")


@cache
def has_wide_registers(command: str) -> bool:
    """Whether a compiler that is asked for all of this processor has AVX-512 there."""
    words = [*shlex.split(command), "-march=native", "-dM", "-E", "-x", "c", "-"]
    return "__AVX512F__" in subprocess.run(words, input="", capture_output=True, text=True).stdout


def commands_of(program: str, into: Path = BUILDS) -> list[list[str]]:
    """What starts a program, in each width that this processor has; empty without the compiler (C) or node for it."""
    if program not in PROGRAMS:
        raise FloorError(f"no program {program!r}: there are {', '.join(PROGRAMS)}")
    if program == "frame":
        node = shutil.which("node")
        return [[node, str(HERE / "frame.mjs")]] if node else []
    command = compiler()
    if command is None:
        return []
    widths = [None, WIDE] if has_wide_registers(command) else [None]
    return [[str(build(program, into, lanes))] for lanes in widths]


def time_floor(
    program: str, rows: int, columns: int, substeps: int, iterations: int, frames: int
) -> dict[str, Any] | None:
    """The line that the fastest build prints, as a dict; None where there is none on this machine. Raises FloorError.

    `explicit` has nothing to iterate: its `iterations` is 1.
    """
    numbers = [str(n) for n in (rows, columns, substeps, iterations, frames)]
    lines: list[dict[str, Any]] = []
    for command in commands_of(program):
        result = subprocess.run([*command, *numbers], capture_output=True, text=True, timeout=TIME_LIMIT)
        if result.returncode:
            raise FloorError(f"{program} {' '.join(numbers)}: {result.stderr.strip()}")
        lines.append(json.loads(result.stdout))
    return min(lines, key=lambda line: float(line["median_ms"]), default=None)


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
