"""Applies mutations one at a time to copies of the repository, and runs the tests that must fail.

`python tests/mutants/run_mutants.py [--only NAME ...] [--jobs 2]`. Exit status 1 where a mutation survives, 2 where the
table does not fit the program any more: a text that is not there once, a test that cannot be run or fails without a
fault. What came of the whole table is written to `tests/mutants_result.toml`; what came of chosen ones is not.
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
from result_file import commit, written

LONGEST = 600  # [s] a mutation may also make a loop endless
LEFT_OUT = shutil.ignore_patterns(
    *(".git", ".venv", "__pycache__", ".*_cache", ".hypothesis", "out", "site", "build", "dist", "screenshots")
)


@dataclass(frozen=True)
class Result:
    """What became of one mutation."""

    mutation: Mutation
    verdict: str
    seconds: float
    told: str = ""  # why it could not be tried


class Tree:
    """A copy of the repository for one process at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT, folder, ignore=LEFT_OUT)

    def try_out(self, mutation: Mutation) -> Result:
        """Applies it, runs its tests and takes it back."""
        begun = time.monotonic()
        file = self.folder / mutation.path
        whole = file.read_text(encoding="utf-8")
        try:
            file.write_text(mutation.applied(whole), encoding="utf-8")
        except ValueError as error:
            return Result(mutation, BROKEN, 0.0, str(error))
        try:
            verdict, told = self.test(mutation.node_ids, LONGEST)
        finally:
            file.write_text(whole, encoding="utf-8")
        return Result(mutation, verdict, time.monotonic() - begun, told)

    def test(self, node_ids: Sequence[str], longest: float | None) -> tuple[str, str]:
        """Whether the tests see a fault, and a word more where there is one; `longest` [s]."""
        command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", "-m", "long or not long"]
        # Compiled Python is told from its source by second and size: a fault of one letter could be missed.
        environment = {**os.environ, "PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            done = subprocess.run(
                [*command, "-p", "no:cacheprovider", *node_ids],
                cwd=self.folder,
                env=environment,
                timeout=longest,
                capture_output=True,
                text=True,
                errors="replace",
            )
        except subprocess.TimeoutExpired:
            return KILLED, f"no end in {longest} s"
        if done.returncode == 0:
            return SURVIVED, ""
        if done.returncode in (2, 3, 4, 5):  # no test failed: pytest could not run them
            lines = (done.stdout + done.stderr).strip().splitlines()
            return BROKEN, lines[-1] if lines else "pytest said nothing"
        if done.returncode == 1:
            return KILLED, next((line for line in done.stdout.splitlines() if line.startswith("FAILED ")), "")
        return KILLED, f"the process ended with {done.returncode}"


def chosen(names: Sequence[str]) -> list[Mutation]:
    """Those of the names, or all. Raises ValueError for a name that is none."""
    known = {mutation.name: mutation for mutation in MUTATIONS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"no mutation is called {', '.join(unknown)}; there are {', '.join(known)}")
    return [known[name] for name in names] or list(MUTATIONS)


def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
    """All of them, so many at a time; each is told as it ends. Raises ValueError where tests fail without any."""
    trees: SimpleQueue[Tree] = SimpleQueue()
    results: list[Result] = []
    with tempfile.TemporaryDirectory(prefix="taichi_cloth_mutants_") as folder:
        for k in range(min(jobs, len(mutations))):
            trees.put(Tree(Path(folder) / str(k)))

        # A test that fails anyway kills nothing. This also compiles what the mutants have in common.
        named = sorted({test for mutation in mutations for test in mutation.node_ids})
        tree = trees.get()
        verdict, told = tree.test(named, None)
        trees.put(tree)
        if verdict != SURVIVED:
            raise ValueError(f"without a fault the tests do not pass: {told}")
        print(f"{len(named)} tests pass without a fault", flush=True)

        def try_out(mutation: Mutation) -> Result:
            tree = trees.get()
            try:
                return tree.try_out(mutation)
            finally:
                trees.put(tree)

        with ThreadPool(jobs) as pool:
            for result in pool.imap_unordered(try_out, mutations):
                results.append(result)
                name = result.mutation.name
                print(f"{len(results)}/{len(mutations)} {name}: {result.verdict}, {result.seconds:.0f} s", flush=True)
    return results


def table(results: Sequence[Result]) -> str:
    """A line for each, those that are not killed at the end."""
    order = {mutation.name: number for number, mutation in enumerate(MUTATIONS)}
    ordered = sorted(results, key=lambda r: (r.verdict != KILLED, order[r.mutation.name]))
    width = max(len(result.mutation.name) for result in ordered)
    rows = [f"{r.mutation.name:{width}}  {r.verdict:8}  {r.seconds:5.0f} s  {r.told}".rstrip() for r in ordered]
    counts = [f"{sum(r.verdict == v for r in results)} {v.lower()}" for v in (KILLED, SURVIVED, BROKEN)]
    return "\n".join([*rows, f"{len(results)} mutations: {', '.join(counts)}"])


def write(results: Sequence[Result], of: str, seconds: float) -> None:
    """Stores what came of them, in the order of the table; `of` is the commit that they were tried on."""
    verdicts = {result.mutation.name: result.verdict for result in results}
    ordered = {mutation.name: verdicts[mutation.name] for mutation in MUTATIONS}
    text = written(mutants_result.TITLE, mutants_result.reduced(ordered, of, seconds))
    mutants_result.FILE.write_text(text, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", action="extend", default=[], metavar="NAME", help="these mutations only")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time (2)")
    options = parser.parse_args(arguments)
    of, begun = commit(), time.monotonic()  # the copies are made now: later the tree may be another
    try:
        results = run(chosen(options.only), max(options.jobs, 1))
    except ValueError as error:
        print(f"mutants: {error}", file=sys.stderr)
        return 2
    print(table(results))
    if not options.only:
        write(results, of, time.monotonic() - begun)
    verdicts = {result.verdict for result in results}
    return 2 if BROKEN in verdicts else int(SURVIVED in verdicts)


if __name__ == "__main__":
    sys.exit(main())
