"""Output of commands: progress of long runs, tables, CSV files, and machine and commit of a measurement.

Progress is a bar on a terminal, and a few plain lines in a log.
"""

from __future__ import annotations

import csv
import io
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from .errors import OutputConflict, UsageError, shown_path
from .files import PACKAGE, atomic_file
from .taichi_runtime import cpu_model

LOG_LINES = 8  # in the log of one run


def count_noun(number: int, word: str) -> str:
    """Return a number with a noun: `1 image`, `2 images`."""
    return f"{number} {word}" + "s" * (number != 1)


@contextmanager
def frames_progress(frames: int) -> Iterator[Callable[[int], None]]:
    """Show progress over frames. Yields a function to call with the index of each completed frame.

    Until the first frame is complete, a terminal shows that kernels are compiled. The rate is that of the frames since.
    """
    first_frame: float | None = None

    def rate(k: int) -> str:
        nonlocal first_frame
        now = time.perf_counter()
        if first_frame is None:
            first_frame = now
        return f"{k / max(now - first_frame, 1e-9):.0f} frames/s" if k else ""

    if sys.stdout.isatty():
        columns = (
            TextColumn("frame"),
            MofNCompleteColumn(),
            BarColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        with Progress(*columns) as progress:
            task = progress.add_task("", total=frames, rate="compiling kernels")
            yield lambda k: progress.update(task, completed=k + 1, rate=rate(k))
    else:
        interval = max(1, frames // LOG_LINES)

        def line(k: int) -> None:
            since_first = rate(k)
            if (k + 1) % interval == 0 or k + 1 == frames:
                print(", ".join(filter(None, [f"frame {k + 1}/{frames}", since_first])), flush=True)

        yield line


@contextmanager
def spinner(line: str) -> Iterator[None]:
    """Show a line with a spinner on a terminal during the block; a log gets nothing."""
    if sys.stdout.isatty():
        with Console().status(line):
            yield
    else:
        yield


@contextmanager
def steps_progress(steps: int) -> Iterator[Callable[[str], None]]:
    """Show progress over steps. Yields a function to call with the name of each step when it starts."""
    started = 0
    if sys.stdout.isatty():
        with Progress(MofNCompleteColumn(), BarColumn(), TextColumn("{task.description}"), transient=True) as progress:
            task = progress.add_task("", total=steps)

            def show(name: str) -> None:
                nonlocal started
                started += 1
                progress.update(task, completed=min(started - 1, steps), description=name)

            yield show
    else:

        def line(name: str) -> None:
            nonlocal started
            started += 1
            print(f"{started}/{max(started, steps)} {name}", flush=True)

        yield line


LOG_WIDTH = 200  # [characters] width of the output if it is no terminal


def number(value: float | None, form: str = ".2f", unit: str = "") -> str:
    """Return a number as text; `-` for None."""
    return "-" if value is None else f"{value:{form}}{unit}"


def milliseconds(value: float | None) -> str:
    """Return a time [ms] as text, with three decimals below 10 ms and one above; `-` for None."""
    return number(value, ".3f" if value is not None and value < 10 else ".1f")


def wide_console() -> Console:
    """Return a console; without a terminal it is wide enough for the tables."""
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = LOG_WIDTH
    return console


def print_table(
    headings: Sequence[str], lines: Iterable[Sequence[str]], figures: slice, notes: Iterable[str] = ()
) -> None:
    """Print a table whose columns `figures` are aligned right, and `notes` below it."""
    console = wide_console()
    table = Table(*headings, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for column in table.columns[figures]:
        column.justify = "right"
    for line in lines:
        table.add_row(*line)
    console.print(table)
    for note in notes:
        console.print(note, soft_wrap=True)


def printed_table(lines: Sequence[Sequence[str]]) -> Table:
    """Return a table for a terminal. The first line is the heading; all columns but the first are aligned right."""
    head, *body = lines
    table = Table(*head, box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0), pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for line in body:
        table.add_row(*line)
    return table


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table. The first line is the heading."""
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return [head, f"|{'---|' * len(lines[0])}", *body]


def commit_of(folder: Path = PACKAGE.parent) -> str:
    """Return the commit of the clone in a folder, or the version of the package if the folder is not that of a clone.

    A `+` is appended if files of the package were changed since.
    """

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True).stdout

    try:
        if Path(git("rev-parse", "--show-toplevel").strip()).resolve() == folder.resolve():
            changed = git("status", "--porcelain", "--untracked-files=no", "--", PACKAGE.name)
            return git("rev-parse", "HEAD").strip() + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        pass
    return version("taichi-cloth")


def machine() -> dict[str, str]:
    """Return the processor, and the versions of Python, Taichi and this package."""
    return {
        "cpu": cpu_model(),
        "cores": f"{os.cpu_count()} cores",
        "python": f"Python {platform.python_version()}",
        "taichi": f"Taichi {version('taichi')}",
        "taichi_cloth": f"taichi_cloth {version('taichi-cloth')}",
    }


def check_output_file(path: Path, *, force: bool) -> None:
    """Check before a long run that a file can be written, in a folder that may be missing.

    Raises OutputConflict and UsageError.
    """
    if path.is_dir():
        raise OutputConflict(f"{path} is a folder, not a file")
    if path.exists() and not force:
        raise OutputConflict(f"{path} already exists; use --force to replace it")
    folder = next(folder for folder in path.absolute().parents if folder.exists())
    if not folder.is_dir():
        raise UsageError(f"cannot write {path.name}: {path.parent} is not a folder")
    if not os.access(folder, os.W_OK):
        raise UsageError(f"cannot write {path.name}: no permission to write in {shown_path(folder)}")


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Write a file atomically, as `atomic_file` does, and make its folder. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        yield file


ROWS = "_rows"  # suffix of the name of a second page, with all rows


def page_files(path: Path | None) -> list[Path]:
    """Return the files that `--markdown PATH` writes: the page, and next to it the page of all rows."""
    return [path, path.with_name(f"{path.stem}{ROWS}{path.suffix}")] if path else []


def write_csv(path: Path, rows: Sequence[Any], kind: type) -> None:
    """Write dataclasses of one type as CSV, a line each; None is an empty cell. Raises OSError."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(kind)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    with new_file(path) as file:
        file.write(text.getvalue().encode())
