"""Jobs in processes of their own, that end with the process that began them."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from multiprocessing import active_children, connection, get_context, parent_process
from typing import Any, TypeVar

Result = TypeVar("Result")


def side_by_side(
    work: Callable[..., Result], jobs: Mapping[int, tuple[Any, ...]], processes: int, begin: Callable[[], object]
) -> Generator[tuple[int, Result], None, None]:
    """Results of `work` with these arguments as they come; each process calls `begin` first.

    Raises BrokenProcessPool where a process ends before its time. Closing the generator ends the processes.
    """
    with ProcessPoolExecutor(processes, get_context("spawn"), begin_child, (begin,)) as pool:
        try:
            with deaf_children():
                waiting = {pool.submit(work, *job): k for k, job in jobs.items()}
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            for child in active_children():  # a job may have minutes to go; the pool sees that they ended, and does too
                child.terminate()
            raise


def begin_child(begin: Callable[[], object]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # also in one that replaces another later
    threading.Thread(target=end_with_parent, daemon=True).start()
    begin()


def end_with_parent() -> None:
    """Ends this process at once when the one that began it is gone: a killed one ends nobody by itself."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


@contextmanager
def deaf_children() -> Iterator[None]:
    """Processes that begin meanwhile do not hear Ctrl-C, nor print what it broke off: it is for us, who end them."""
    before = None
    with suppress(ValueError):  # not in the main thread, which alone is interrupted
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)
