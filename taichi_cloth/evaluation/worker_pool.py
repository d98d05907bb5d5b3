"""Jobs in worker processes that exit with their parent process: a pool, and one process that may crash or hang."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from multiprocessing import active_children, connection, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from ..system.errors import one_line

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


# -- one process -------------------------------------------------------------------------------------------------------


TIME = "time"  # reason of a job that took too long


class JobFailed(Exception):
    """A job raised an exception, ended its process, or took too long; the message says which."""


class Worker:
    """A process that runs one job after another. A process that crashed or hung is replaced before the next job."""

    def __init__(self, begin: Callable[[], object]) -> None:
        """`begin` is called first in each process."""
        self._begin = begin
        self._process: SpawnProcess | None = None
        self._jobs: Connection | None = None

    def start(self, work: Callable[..., object], *arguments: object) -> None:
        """Start a job; `result` waits for it."""
        if self._jobs is None:
            self._jobs, theirs = get_context("spawn").Pipe()
            self._process = get_context("spawn").Process(target=serve, args=(theirs, self._begin), daemon=True)
            with ignore_interrupts():
                self._process.start()
            theirs.close()
        with suppress(BrokenPipeError):  # `result` reports that the process has ended
            self._jobs.send((work, arguments))

    def result(self, seconds: float) -> Any:
        """Return the result of the job. Raises JobFailed, also if it takes longer than `seconds`."""
        assert self._jobs is not None, "no job was started"
        assert self._process is not None
        try:
            if not self._jobs.poll(max(seconds, 0.0)):
                self.close()
                raise JobFailed(TIME)
            succeeded, value = self._jobs.recv()
        except (EOFError, ConnectionResetError):
            self._process.join(10)
            code = self._process.exitcode
            self.close()
            raise JobFailed(f"the process ended with exit code {code}") from None
        if not succeeded:
            raise JobFailed(value)
        return value

    def run(self, work: Callable[..., object], *arguments: object, seconds: float) -> Any:
        """Run a job and return its result. Raises JobFailed."""
        self.start(work, *arguments)
        return self.result(seconds)

    def close(self) -> None:
        """End the process, also within a job."""
        if self._process is not None and self._jobs is not None:
            self._jobs.close()
            self._process.kill()
            self._process.join()
        self._process = self._jobs = None


def serve(jobs: Connection, begin: Callable[[], object]) -> None:
    """Run the jobs of a `Worker`, until its end of the connection is closed."""
    problem = ""
    try:
        init_worker(begin)
    except Exception as error:  # every job then fails with this reason
        problem = reason(error)
    with suppress(EOFError):
        while True:
            work, arguments = jobs.recv()
            try:
                jobs.send((False, problem) if problem else (True, work(*arguments)))
            except Exception as error:  # of the job, whatever it is
                jobs.send((False, reason(error)))


MAX_REASON = 300  # [characters]


def reason(error: Exception) -> str:
    """Return an exception as one line."""
    text = one_line(f"{type(error).__name__}: {error}".strip())
    return text if len(text) <= MAX_REASON else text[: MAX_REASON - 1] + "…"
