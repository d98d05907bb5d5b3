"""Jobs in worker processes that exit with their parent process."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from multiprocessing import active_children, connection, get_context, parent_process
from typing import TypeVar

Result = TypeVar("Result")


def run_parallel(
    work: Callable[..., Result], jobs: Mapping[int, tuple[object, ...]], processes: int, begin: Callable[[], object]
) -> Generator[tuple[int, Result], None, None]:
    """Yield the key and the result of every job as it completes. Each worker process calls `begin` first.

    `jobs` has the arguments of `work` by key. Raises BrokenProcessPool if a process dies. Closing the generator
    terminates the processes.
    """
    with ProcessPoolExecutor(processes, get_context("spawn"), init_worker, (begin,)) as pool:
        try:
            with ignore_interrupts():
                key_of = {pool.submit(work, *job): k for k, job in jobs.items()}
            for future in as_completed(key_of):
                yield key_of[future], future.result()
        except BaseException:
            for child in active_children():  # a job may run for minutes; the pool shuts down once its processes end
                child.terminate()
            raise


def init_worker(begin: Callable[[], object]) -> None:
    """Initialize a worker process: ignore Ctrl-C, exit with the parent, and call `begin`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pool may start a process outside `ignore_interrupts`
    threading.Thread(target=exit_with_parent, daemon=True).start()
    begin()


def exit_with_parent() -> None:
    """Exit this process as soon as its parent is gone: a killed parent does not stop its children."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


@contextmanager
def ignore_interrupts() -> Iterator[None]:
    """Make processes that start meanwhile ignore Ctrl-C and print no traceback. The parent terminates them."""
    previous = None
    with suppress(ValueError):  # raised outside the main thread, which alone receives SIGINT
        previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        if previous is not None:
            signal.signal(signal.SIGINT, previous)
