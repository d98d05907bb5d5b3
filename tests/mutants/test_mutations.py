"""The table of mutations fits the program: every text is there once, and every test that it names exists."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter

import pytest
from mutation import ROOT, Mutation
from mutations import MUTATIONS
from run_mutants import BROKEN, chosen, main


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
