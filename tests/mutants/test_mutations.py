"""The table of mutations fits the program: every text occurs once, and every named test exists.

The last verdict on each is stored, and none survived.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mutants_result
import pytest
import run_mutants
from mutants_result import BROKEN, KILLED, SURVIVED, digest, not_killed
from mutation import ROOT, Mutation
from mutations import MUTATIONS
from result_file import commit, written
from run_mutants import Result, main, selected


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """No test of this module needs Taichi."""


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_the_text_of_each_mutation_occurs_once(mutation: Mutation) -> None:
    text = (ROOT / mutation.path).read_text(encoding="utf-8")
    changed = mutation.applied(text)
    assert changed != text
    compile(changed, str(mutation.path), "exec")


def test_names_and_faults_are_unique() -> None:
    assert max(Counter(mutation.name for mutation in MUTATIONS).values()) == 1
    assert max(Counter((m.file, m.old, m.new) for m in MUTATIONS).values()) == 1


def test_every_named_test_exists() -> None:
    node_ids = sorted({test for mutation in MUTATIONS for test in mutation.node_ids})
    command = [sys.executable, "-m", "pytest", "-n", "0", "--collect-only", "-q", "-m", "long or not long"]
    done = subprocess.run([*command, "-p", "no:cacheprovider", *node_ids], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_missing_text_is_an_error() -> None:
    wrong = Mutation("wrong", "simulation/grabbing.py", "there is no such line", "", ())
    with pytest.raises(ValueError, match=r"wrong: .*grabbing\.py contains 'there is no such line' 0 times, not once"):
        wrong.applied((ROOT / wrong.path).read_text(encoding="utf-8"))


def test_an_unknown_name_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert [mutation.name for mutation in selected([MUTATIONS[3].name])] == [MUTATIONS[3].name]
    assert main(["--only", "no-such-mutation"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("mutants: unknown mutation no-such-mutation; use ")
    assert err.count("\n") == 1
    assert BROKEN


# -- stored result -----------------------------------------------------------------------------------------------------


def test_every_mutation_was_killed_as_it_is_now() -> None:
    """After a mutation is added or changed, `make mutants ONLY=NAME` must run it."""
    lines = mutants_result.stored_lines()
    assert not_killed(lines) == []
    assert list(lines) == [mutation.name for mutation in MUTATIONS]
    assert all(re.fullmatch(r"killed [0-9a-f]{8} [0-9a-f]{7,}", line) for line in lines.values())


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file of the result. No mutation runs: the last one of a table is broken, the one before survives."""

    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        verdicts = [*[KILLED] * (len(mutations) - 2), SURVIVED, BROKEN][-len(mutations) :]
        results = [Result(mutation, verdict, 1.0) for mutation, verdict in zip(mutations, verdicts, strict=True)]
        return results[::-1]  # mutations end in any order

    monkeypatch.setattr(run_mutants, "run", run)
    monkeypatch.setattr(mutants_result, "FILE", tmp_path / "mutants_result.toml")
    return mutants_result.FILE


def test_the_result_of_all_mutations_is_stored_in_the_order_of_the_table(file: Path) -> None:
    assert main([]) == 2
    text = file.read_text(encoding="utf-8")
    lines = mutants_result.stored_lines()
    assert list(lines) == [mutation.name for mutation in MUTATIONS]
    assert lines[MUTATIONS[0].name] == f"killed {digest(MUTATIONS[0])} {commit()}"
    assert lines[MUTATIONS[-2].name].startswith("SURVIVED ")
    assert lines[MUTATIONS[-1].name].startswith("BROKEN ")
    assert not_killed(lines) == [MUTATIONS[-2].name, MUTATIONS[-1].name]
    tables = tomllib.loads(text)
    assert tables["machine"]["processor"]
    assert text == written(mutants_result.TITLE, tables)


def test_a_changed_mutation_has_another_digest() -> None:
    first = MUTATIONS[0]
    assert len({digest(one) for one in (first, replace(first, new=""), replace(first, tests=()), MUTATIONS[1])}) == 4
    assert digest(replace(first)) == digest(first)


def test_the_digest_covers_the_bodies_of_the_tests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutants_result, "ROOT", tmp_path)
    (tmp_path / "tests").mkdir()
    bodies = []
    for text in ("def test_b(): assert 1", "def test_b():\n    assert 1  # a comment", "def test_b(): pass"):
        (tmp_path / "tests" / "test_a.py").write_text(text, encoding="utf-8")
        mutants_result.parsed.cache_clear()
        bodies.append({mutants_result.body("test_a.py::test_b[x]"), mutants_result.body("test_a.py")})
    mutants_result.parsed.cache_clear()
    assert bodies[0] == bodies[1]
    assert not bodies[0] & bodies[2]
    mutation = replace(MUTATIONS[0], tests=("test_a.py::test_b",))
    now = digest(mutation)
    monkeypatch.setattr(mutants_result, "body", lambda test: "another")
    assert digest(mutation) != now


def test_a_mutation_that_changed_or_is_new_was_not_killed(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert main(["--only", *(mutation.name for mutation in MUTATIONS[1:-2])]) == 2
    lines = mutants_result.stored_lines()
    missing = [MUTATIONS[0].name, MUTATIONS[-4].name, MUTATIONS[-3].name, MUTATIONS[-2].name, MUTATIONS[-1].name]
    assert not_killed(lines) == missing
    changed = [*MUTATIONS[:1], replace(MUTATIONS[1], new="something else"), *MUTATIONS[2:]]
    monkeypatch.setattr(mutants_result, "MUTATIONS", changed)
    assert not_killed(lines) == [missing[0], MUTATIONS[1].name, *missing[1:]]


def test_a_run_of_some_mutations_replaces_their_results_and_drops_those_that_are_gone(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main([]) == 2
    before = mutants_result.stored_lines()

    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        return [Result(mutation, KILLED, 1.0) for mutation in mutations]

    monkeypatch.setattr(run_mutants, "run", run)
    monkeypatch.setattr(run_mutants, "commit", lambda: "1234567")
    monkeypatch.setattr(mutants_result, "MUTATIONS", MUTATIONS[1:])
    assert main(["--only", MUTATIONS[-2].name]) == 0
    after = mutants_result.stored_lines()
    assert after.pop(MUTATIONS[-2].name) == f"killed {digest(MUTATIONS[-2])} 1234567"
    assert after == {name: before[name] for name in after}
    assert list(before)[:1] == [MUTATIONS[0].name]
    assert MUTATIONS[0].name not in after


def test_nothing_is_stored_if_tests_fail_without_a_mutation(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        raise ValueError("the tests fail without a mutation")

    monkeypatch.setattr(run_mutants, "run", run)
    assert main([]) == 2
    assert not file.exists()
