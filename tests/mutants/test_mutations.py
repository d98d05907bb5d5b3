"""The table of mutations fits the program: every text is there once, and every test that it names exists.

The last result of the whole table is kept, and no mutation survived in it.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import mutants_result
import pytest
import run_mutants
from mutants_result import BROKEN, KILLED, SURVIVED
from mutation import ROOT, Mutation
from mutations import MUTATIONS
from result_file import commit, written
from run_mutants import Result, chosen, main


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """Nothing here needs it."""


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_its_text_is_there_once(mutation: Mutation) -> None:
    text = (ROOT / mutation.path).read_text(encoding="utf-8")
    changed = mutation.applied(text)
    assert changed != text
    compile(changed, str(mutation.path), "exec")


def test_names_are_unique_and_faults_too() -> None:
    assert max(Counter(mutation.name for mutation in MUTATIONS).values()) == 1
    assert max(Counter((m.file, m.old, m.new) for m in MUTATIONS).values()) == 1


def test_every_test_that_is_named_is_there() -> None:
    named = sorted({test for mutation in MUTATIONS for test in mutation.node_ids})
    command = [sys.executable, "-m", "pytest", "-n", "0", "--collect-only", "-q", "-m", "long or not long"]
    done = subprocess.run([*command, "-p", "no:cacheprovider", *named], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_what_does_not_fit_is_said() -> None:
    wrong = Mutation("wrong", "hand.py", "there is no such line", "", ())
    with pytest.raises(ValueError, match=r"wrong: .*hand\.py has 0 places for 'there is no such line', not one"):
        wrong.applied((ROOT / wrong.path).read_text(encoding="utf-8"))


def test_a_name_that_is_none_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert [mutation.name for mutation in chosen([MUTATIONS[3].name])] == [MUTATIONS[3].name]
    assert main(["--only", "no-such-mutation"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("mutants: no mutation is called no-such-mutation")
    assert err.count("\n") == 1
    assert BROKEN


# -- what is kept of a run ---------------------------------------------------------------------------------


def test_the_last_run_is_kept_and_nothing_survived_in_it() -> None:
    """It is of the table as it is: who adds a mutation runs `make mutants` again."""
    file = mutants_result.FILE
    if not file.exists():
        pytest.skip("`make mutants`, which writes tests/mutants_result.toml, has not been run to its end yet")
    kept = tomllib.loads(file.read_text(encoding="utf-8"))
    result = kept["result"]
    assert result["survived"] == []
    assert result["broken"] == []
    assert result["killed"] == result["mutations"] == len(MUTATIONS)
    assert result["seconds"] > 0
    assert date.fromisoformat(result["date"]) > date(2026, 1, 1)
    assert result["commit"]
    assert kept["machine"]["processor"]


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a result is written. No mutation is run: the last of a table is broken, and that before it survives."""

    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        verdicts = [*[KILLED] * (len(mutations) - 2), SURVIVED, BROKEN][-len(mutations) :]
        results = [Result(mutation, verdict, 1.0) for mutation, verdict in zip(mutations, verdicts, strict=True)]
        return results[::-1]  # as they end

    monkeypatch.setattr(run_mutants, "run", run)
    monkeypatch.setattr(mutants_result, "FILE", tmp_path / "mutants_result.toml")
    return mutants_result.FILE


def test_a_whole_table_is_stored(file: Path) -> None:
    assert main([]) == 2
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    result = tables["result"]
    assert (result["mutations"], result["killed"]) == (len(MUTATIONS), len(MUTATIONS) - 2)
    assert result["survived"] == [MUTATIONS[-2].name]
    assert result["broken"] == [MUTATIONS[-1].name]
    assert result["date"] == date.today().isoformat()
    assert result["commit"] == commit()
    assert tables == tomllib.loads(written(mutants_result.TITLE, tables))


def test_survivors_are_named_in_the_order_of_the_table() -> None:
    verdicts = {"a": SURVIVED, "b": KILLED, "c": SURVIVED, "d": BROKEN}
    result = mutants_result.reduced(verdicts, "abc+", 12.6)["result"]
    assert (result["survived"], result["broken"]) == (["a", "c"], ["d"])
    assert (result["mutations"], result["killed"], result["seconds"]) == (4, 1, 13)
    assert result["commit"] == "abc+"


def test_chosen_mutations_are_not_stored(file: Path) -> None:
    assert main(["--only", MUTATIONS[0].name, MUTATIONS[1].name]) == 2
    assert not file.exists()


def test_nothing_is_stored_where_tests_fail_without_a_fault(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(mutations: Sequence[Mutation], jobs: int) -> list[Result]:
        raise ValueError("without a fault the tests do not pass")

    monkeypatch.setattr(run_mutants, "run", run)
    assert main([]) == 2
    assert not file.exists()
