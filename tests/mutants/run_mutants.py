"""Applies mutations one at a time to copies of the repository, and runs the tests that must fail.

`python tests/mutants/run_mutants.py [--only NAME ...] [--jobs 2]`. The exit status is 1 if a mutation survives, and 2
if the table does not fit the program: a text does not occur once, or a test cannot run or fails without a fault. The
verdicts are written to `tests/mutants_result.toml`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.pool import ThreadPool
from pathlib import Path
from queue import SimpleQueue

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))

import mutants_result
from mutants_result import BROKEN, KILLED, SURVIVED
from mutation import ROOT, Mutation
from mutations import MUTATIONS
from result_file import commit

TIME_LIMIT = 600  # [s] a mutation may make a loop endless
NOT_COPIED = shutil.ignore_patterns(
    *(".git", ".venv", "__pycache__", ".*_cache", ".hypothesis", "out", "site", "build", "dist", "screenshots")
)


@dataclass(frozen=True)
class Result:
    """The result of one mutation."""

    mutation: Mutation
    verdict: str
    seconds: float
    message: str = ""  # the failed test, or why the mutation could not be applied


class Tree:
    """A copy of the repository, used by one process at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT, folder, ignore=NOT_COPIED)

    def try_mutation(self, mutation: Mutation) -> Result:
        """Apply a mutation, run its tests and undo it."""
        start = time.monotonic()
        file = self.folder / mutation.path
        original = file.read_text(encoding="utf-8")
        try:
            file.write_text(mutation.applied(original), encoding="utf-8")
        except ValueError as error:
            return Result(mutation, BROKEN, 0.0, str(error))
        try:
            verdict, message = self.test(mutation.node_ids, TIME_LIMIT)
        finally:
            file.write_text(original, encoding="utf-8")
        return Result(mutation, verdict, time.monotonic() - start, message)

    def test(self, node_ids: Sequence[str], time_limit: float | None) -> tuple[str, str]:
        """Run the tests for at most `time_limit` [s]. Return the verdict and a message."""
        command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-m", "long or not long"]
        # Compiled files are matched to their source by time in seconds and size: a fault of one letter could be missed.
        environment = {**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            done = subprocess.run(
                [*command, "-p", "no:cacheprovider", *node_ids],
                cwd=self.folder,
                env=environment,
                timeout=time_limit,
                capture_output=True,
                text=True,
                errors="replace",
            )
        except subprocess.TimeoutExpired:
            return KILLED, f"no end within {time_limit} s"
        if done.returncode == 0:
            return SURVIVED, ""
        if done.returncode in (2, 3, 4, 5):  # no test failed: pytest could not run them
            lines = (done.stdout + done.stderr).strip().splitlines()
            return BROKEN, lines[-1] if lines else "no output from pytest"
        if done.returncode == 1:
            return KILLED, next((line for line in done.stdout.splitlines() if line.startswith("FAILED ")), "")
        return KILLED, f"the process ended with {done.returncode}"


def selected(names: Sequence[str]) -> list[Mutation]:
    """Return the mutations with these names, or all. Raises ValueError for an unknown name."""
    known = {mutation.name: mutation for mutation in MUTATIONS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"unknown mutation {', '.join(unknown)}; use {', '.join(known)}")
    return [known[name] for name in names] or list(MUTATIONS)


def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
    """Run mutations, `jobs` at a time, and print each result. Raises ValueError if tests fail without a mutation."""
    trees: SimpleQueue[Tree] = SimpleQueue()
    results: list[Result] = []
    with tempfile.TemporaryDirectory(prefix="taichi_cloth_mutants_") as folder:
        for k in range(min(jobs, len(mutations))):
            trees.put(Tree(Path(folder) / str(k)))

        # A test that fails without a mutation proves nothing. This also compiles the kernels that all mutants share.
        node_ids = sorted({test for mutation in mutations for test in mutation.node_ids})
        tree = trees.get()
        verdict, message = tree.test(node_ids, None)
        trees.put(tree)
        if verdict != SURVIVED:
            raise ValueError(f"the tests fail without a mutation: {message}")
        print(f"{len(node_ids)} tests pass without a mutation", flush=True)

        def try_one(mutation: Mutation) -> Result:
            tree = trees.get()
            try:
                return tree.try_mutation(mutation)
            finally:
                trees.put(tree)

        with ThreadPool(jobs) as pool:
            for result in pool.imap_unordered(try_one, mutations):
                results.append(result)
                name = result.mutation.name
                print(f"{len(results)}/{len(mutations)} {name}: {result.verdict}, {result.seconds:.0f} s", flush=True)
    return results


def table(results: Sequence[Result]) -> str:
    """Return a line for each result; mutations that survived or did not run come last."""
    order = {mutation.name: number for number, mutation in enumerate(MUTATIONS)}
    ordered = sorted(results, key=lambda r: (r.verdict != KILLED, order[r.mutation.name]))
    width = max(len(result.mutation.name) for result in ordered)
    rows = [f"{r.mutation.name:{width}}  {r.verdict:8}  {r.seconds:5.0f} s  {r.message}".rstrip() for r in ordered]
    counts = [f"{sum(r.verdict == v for r in results)} {v.lower()}" for v in (KILLED, SURVIVED, BROKEN)]
    return "\n".join([*rows, f"{len(results)} mutations: {', '.join(counts)}"])


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--only", nargs="+", action="extend", default=[], metavar="NAME", help="run only these mutations"
    )
    parser.add_argument("--jobs", type=int, default=2, help="number of parallel jobs (default: 2)")
    options = parser.parse_args(arguments)
    tested_commit = commit()  # the working tree may change after it is copied
    try:
        results = run(selected(options.only), max(options.jobs, 1))
    except ValueError as error:
        print(f"mutants: {error}", file=sys.stderr)
        return 2
    print(table(results))
    mutants_result.store({result.mutation.name: result.verdict for result in results}, tested_commit)
    verdicts = {result.verdict for result in results}
    return 2 if BROKEN in verdicts else int(SURVIVED in verdicts)


if __name__ == "__main__":
    sys.exit(main())
