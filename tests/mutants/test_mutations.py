"""The table of mutations fits the program: every text occurs once, and every named test exists.

The last result of the complete table is stored, and no mutation survived.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path

import mutants_result
import mutations
import pytest
import run_mutants
from mutants_result import BROKEN, KILLED, SURVIVED
from mutation import ROOT, Mutation
from mutations import MUTATIONS, digest
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


def test_the_last_run_is_stored_and_no_mutation_survived() -> None:
    """The result is that of the present table: after a mutation is added or changed, `make mutants` must run again."""
    file = mutants_result.FILE
    if not file.exists():
        pytest.skip("`make mutants`, which writes tests/mutants_result.toml, has not been completed yet")
    stored = tomllib.loads(file.read_text(encoding="utf-8"))
    result = stored["result"]
    assert result["survived"] == []
    assert result["broken"] == []
    assert result["killed"] == result["mutations"] == len(MUTATIONS)
    assert result["table"] == digest()
    assert result["seconds"] > 0
    assert date.fromisoformat(result["date"]) > date(2026, 1, 1)
    assert result["commit"]
    assert stored["machine"]["processor"]


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


def test_the_result_of_the_complete_table_is_stored(file: Path) -> None:
    assert main([]) == 2
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    result = tables["result"]
    assert (result["mutations"], result["killed"]) == (len(MUTATIONS), len(MUTATIONS) - 2)
    assert result["survived"] == [MUTATIONS[-2].name]
    assert result["broken"] == [MUTATIONS[-1].name]
    assert result["date"] == date.today().isoformat()
    assert result["commit"] == commit()
    assert tables == tomllib.loads(written(mutants_result.TITLE, tables))


def test_another_table_has_another_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest()
    assert mutants_result.reduced({}, "", 0.0)["result"]["table"] == before
    for other in (replace(MUTATIONS[0], new=""), replace(MUTATIONS[0], tests=())):
        monkeypatch.setattr(mutations, "MUTATIONS", [other, *MUTATIONS[1:]])
        assert digest() != before
    monkeypatch.undo()
    assert digest() == before


def test_survivors_are_listed_in_the_order_of_the_table() -> None:
    verdicts = {"a": SURVIVED, "b": KILLED, "c": SURVIVED, "d": BROKEN}
    result = mutants_result.reduced(verdicts, "abc+", 12.6)["result"]
    assert (result["survived"], result["broken"]) == (["a", "c"], ["d"])
    assert (result["mutations"], result["killed"], result["seconds"]) == (4, 1, 13)
    assert result["commit"] == "abc+"


def test_the_result_of_selected_mutations_is_not_stored(file: Path) -> None:
    assert main(["--only", MUTATIONS[0].name, MUTATIONS[1].name]) == 2
    assert not file.exists()


def test_a_mutation_that_is_killed_in_a_second_run_is_stored_with_its_commit(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main([]) == 2
    before = tomllib.loads(file.read_text(encoding="utf-8"))["result"]
    survivor, broken = before["survived"][0], before["broken"][0]

    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        return [Result(mutation, KILLED, 1.0) for mutation in mutations]

    monkeypatch.setattr(run_mutants, "run", run)
    assert main(["--only", MUTATIONS[0].name, survivor]) == 0
    after = tomllib.loads(file.read_text(encoding="utf-8"))["result"]
    assert (after["killed"], after["survived"], after["broken"]) == (len(MUTATIONS) - 1, [], [broken])
    assert after["retried"] == [f"{survivor}: {commit()}"]
    monkeypatch.setattr(mutants_result, "digest", lambda: "of another table")
    assert main(["--only", broken]) == 0
    assert tomllib.loads(file.read_text(encoding="utf-8"))["result"] == after


def test_nothing_is_stored_if_tests_fail_without_a_mutation(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        raise ValueError("the tests fail without a mutation")

    monkeypatch.setattr(run_mutants, "run", run)
    assert main([]) == 2
    assert not file.exists()
