"""Time the native programs in this folder, which compute a frame of cloth in C and JavaScript.

    python benchmarks/floor/floor.py relax 24 30 5 12 300

The first run of `relax` and `explicit` compiles them from C; node runs `frame`.
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

# All optimizations, except that the program must be able to detect positions that are not finite.
FLAGS = ("-O3", "-ffast-math", "-fno-finite-math-only", "-Wall", "-Wextra")
WIDE = 16  # lanes of the second build on processors with AVX-512, which is faster on some grids

TIME_LIMIT = 600  # [s]


class FloorError(RuntimeError):
    """A program does not compile, or ended with an error."""


def compiler() -> str | None:
    """Return the command of the C compiler: $CC, or the first of cc, gcc and clang; None if there is none."""
    wanted = os.environ.get("CC")
    for command in [wanted] if wanted else ["cc", "gcc", "clang"]:
        if shutil.which(shlex.split(command)[0]):
            return command
    return None


def compile_command(program: str, target: Path, *, native: bool, lanes: int | None = None) -> list[str]:
    """Return the command that compiles `program`, with `native` for this processor; `lanes`: width of SIMD vectors."""
    command = compiler()
    if command is None:
        raise FloorError("no C compiler: neither $CC nor cc, gcc or clang")
    machine = ["-march=native"] if native else []
    width = [] if lanes is None else [f"-DLANES={lanes}"]
    return [*shlex.split(command), *FLAGS, *machine, *width, str(HERE / f"{program}.c"), "-o", str(target), "-lm"]


def build(program: str, into: Path, lanes: int | None = None) -> Path:
    """Compile `program` into a folder unless that was done before, and return the executable.

    The name of the file contains a hash of sources, compiler and machine. Raises FloorError.
    """
    key = hashlib.sha256(repr((compiler(), FLAGS, lanes, platform.uname())).encode())
    for source in sorted([*HERE.glob("*.h"), HERE / f"{program}.c"]):
        key.update(source.read_bytes())
    target = into / f"{program}-{key.hexdigest()[:16]}{'.exe' if os.name == 'nt' else ''}"
    if target.exists():
        return target
    into.mkdir(parents=True, exist_ok=True)
    fresh = target.with_name(f"{os.getpid()}-{target.name}")  # renamed when complete: another process may compile too
    for native in (True, False):  # not every compiler supports -march=native
        command = compile_command(program, fresh, native=native, lanes=lanes)
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode == 0:
            fresh.replace(target)
            return target
    raise FloorError(f"{program}.c does not compile: {(result.stderr.strip() or 'no message').splitlines()[0]}")


@cache
def has_wide_registers(command: str) -> bool:
    """Return whether the compiler uses AVX-512 on this processor."""
    words = [*shlex.split(command), "-march=native", "-dM", "-E", "-x", "c", "-"]
    return "__AVX512F__" in subprocess.run(words, input="", capture_output=True, text=True).stdout


def commands_of(program: str, into: Path = BUILDS) -> list[list[str]]:
    """Return the command of a program for each SIMD width of this processor; empty without a compiler or node."""
    if program not in PROGRAMS:
        raise FloorError(f"no program {program!r}; choose from {', '.join(PROGRAMS)}")
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
    """Return the output of the fastest build, or None if the program cannot run on this machine. Raises FloorError.

    `iterations` of `explicit` is 1.
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
    print(json.dumps(line) if line else f"{program}: no compiler or node found")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
