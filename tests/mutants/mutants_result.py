"""The results of `make mutants` in a small file next to the tests: `tests/mutants_result.toml`. A test reads it.

Every mutation has a line with its verdict, a digest of its text and the bodies of its tests, and the tested commit. A
run of some mutations replaces their lines, so that a mutation that is added or changed needs no run of all.
"""

from __future__ import annotations

import ast
import hashlib
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from mutation import ROOT, Mutation
from mutations import MUTATIONS
from result_file import written

from taichi_cloth.system.taichi_runtime import cpu_model, machine

FILE = ROOT / "tests" / "mutants_result.toml"
TITLE = "# Written by `make mutants`: the last verdict on every mutation, a digest of it, and the tested commit."
KILLED, SURVIVED, BROKEN = "killed", "SURVIVED", "BROKEN"


def digest(mutation: Mutation) -> str:
    """Return a digest of a mutation with its text and the bodies of its tests, 8 hex digits."""
    words = [repr(mutation), *map(body, mutation.tests)]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:8]


def body(test: str) -> str:
    """Return the syntax tree of a test, or of all tests of a file, without comments and line breaks."""
    path, *names = test.split("::")
    tree = parsed(ROOT / "tests" / path)
    if not names:
        return ast.dump(tree)
    name = names[-1].partition("[")[0]
    [found] = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == name]
    return ast.dump(found)


@cache
def parsed(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def line_of(mutation: Mutation, verdict: str, commit: str) -> str:
    """Return the stored line of a mutation."""
    return f"{verdict} {digest(mutation)} {commit}"


def stored_lines() -> dict[str, str]:
    """Return the stored lines by name; none if there is no file."""
    return dict(tomllib.loads(FILE.read_text(encoding="utf-8"))["mutations"]) if FILE.exists() else {}


def store(verdicts: Mapping[str, str], commit: str) -> None:
    """Replace the lines of mutations by these verdicts by name. Lines of mutations that are gone are dropped."""
    lines = stored_lines()
    for mutation in MUTATIONS:
        if mutation.name in verdicts:
            lines[mutation.name] = line_of(mutation, verdicts[mutation.name], commit)
    ordered = {mutation.name: lines[mutation.name] for mutation in MUTATIONS if mutation.name in lines}
    tables = {"mutations": ordered, "machine": {**machine(), "processor": cpu_model()}}
    FILE.write_text(written(TITLE, tables), encoding="utf-8")


def not_killed(lines: Mapping[str, str]) -> list[str]:
    """Return the names of the mutations that were not killed as they are now: survived, broken, changed or new."""
    alike = {m.name: line_of(m, KILLED, "") for m in MUTATIONS}
    return [name for name, line in alike.items() if not lines.get(name, "").startswith(line)]
