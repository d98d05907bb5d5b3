"""How far a long run is: a bar on a terminal, a plain line now and then in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

LINES = 8  # in a log, for a whole run


def counted(number: int, word: str) -> str:
    """`1 picture`, `2 pictures`."""
    return f"{number} {word}" + "s" * (number != 1)


@contextmanager
def frames_progress(frames: int) -> Iterator[Callable[[int], None]]:
    """A function to call with the index of each frame done."""
    start = time.perf_counter()

    def rate(done: int) -> str:
        return f"{done / (time.perf_counter() - start):.0f} frames/s"

    if sys.stdout.isatty():
        columns = (
            TextColumn("frame"),
            MofNCompleteColumn(),
            BarColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
        )
        with Progress(*columns) as progress:
            task = progress.add_task("", total=frames, rate="")
            yield lambda k: progress.update(task, completed=k + 1, rate=rate(k + 1))
    else:
        every = max(1, frames // LINES)

        def line(k: int) -> None:
            if (k + 1) % every == 0 or k + 1 == frames:
                print(f"frame {k + 1}/{frames}, {rate(k + 1)}", flush=True)

        yield line


@contextmanager
def waiting(line: str) -> Iterator[None]:
    """Shows a line on a terminal for as long as it lasts; a log has no use for it."""
    if sys.stdout.isatty():
        with Console().status(line):
            yield
    else:
        yield


@contextmanager
def steps_progress(steps: int) -> Iterator[Callable[[str], None]]:
    """A function to call with the name of each step as it begins."""
    begun = 0
    if sys.stdout.isatty():
        with Progress(MofNCompleteColumn(), BarColumn(), TextColumn("{task.description}"), transient=True) as progress:
            task = progress.add_task("", total=steps)

            def show(name: str) -> None:
                nonlocal begun
                begun += 1
                progress.update(task, completed=min(begun - 1, steps), description=name)

            yield show
    else:

        def line(name: str) -> None:
            nonlocal begun
            begun += 1
            print(f"{begun}/{max(begun, steps)} {name}", flush=True)

        yield line
