"""The command `stress`: what it runs, writes and resumes, and what it ends with."""

import json
import pickle
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from taichi_cloth import cli
from taichi_cloth.errors import WrongUse
from taichi_cloth.stress import catalogue, choose, running
from taichi_cloth.stress.causes import Cause
from taichi_cloth.stress.choose import chosen
from taichi_cloth.stress.setting import ROBUST, ROBUST_SLACK, SETTINGS
from taichi_cloth.stress.unit import Failure, Unit, run_unit, seed_of

from .conftest import CASE, SMALL


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Unit]:
    """A catalogue of one case; its units run one by one in this process, and are listed here."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(catalogue, "CASES", (CASE,))
    monkeypatch.setattr(choose, "SETTINGS", {"xpbd": SMALL})
    some: list[Unit] = []

    def one_by_one(units, starts, pictures, on_result):  # type: ignore[no-untyped-def]
        for unit in units:
            some.append(unit)
            on_result(run_unit(unit, starts(unit), pictures))

    monkeypatch.setattr(running, "run_all", one_by_one)
    return some


def without_times(path: str) -> list[dict[str, object]]:
    rows = json.loads(Path(path).read_text(encoding="utf-8"))["results"]
    return [{key: row[key] for key in row if key not in ("ms", "seconds", "date")} for row in rows]


def test_a_failure_without_a_cause_ends_with_1(
    ran: list[Unit], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["stress", "--starts", "2", "--json", "o.json", "--resume"]
    seed = seed_of(1, "breaks", 0)
    assert cli.main(words) == 1
    told = capsys.readouterr().out
    line = f"1 test, breaks, fails with xpbd: something 2, not 1, in frame 6 of start 0 (seed {seed}); "
    assert f"{line}unexplained; " in told
    assert "1 of 1 failures are unexplained" in told
    assert told.rstrip().endswith("xpbd 0 alive, 1 failed, 0 too slow")
    assert list(Path("out/stress").iterdir())
    asked = []
    for most, code in ((1.9, 1), (2.0, 0)):  # it breaks by more than the first

        def showing(failed, on_cause, most=most):  # type: ignore[no-untyped-def]
            for unit, _ in failed:
                asked.append(unit.variant.name)
                on_cause(unit, Cause("something", most, "it is made to"))

        monkeypatch.setattr(running, "explain_all", showing)
        assert cli.main([*words, "--explain"]) == code
    assert f"{line}it is made to; " in capsys.readouterr().out
    assert cli.main([*words, "--explain"]) == cli.main(words) == 0
    assert asked == ["breaks", "breaks"]  # what is explained is not looked at again
    assert cli.main(["stress", "--from", "o.json", "--markdown", "page.md"]) == 0
    assert "in frame 6; it is made to\n" in Path("page.md").read_text(encoding="utf-8")


def test_experiments_run_in_processes_of_their_own() -> None:
    """With a real variant: the sheet of one row that is refused is alive, so its start does not fail again."""
    [unit] = chosen("30", "nan", "xpbd")
    found = []
    running.explain_all([(unit, Failure(0, 1, 0, "something", 2.0, 1.0))], lambda *pair: found.append(pair))
    [(of, cause)] = found
    assert of == unit
    assert (cause.what, cause.shown) == ("something", "")


def test_a_resumed_run_equals_one_that_was_not_broken_off(
    ran: list[Unit], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["stress", "--starts", "2", "--json", "whole.json"]) == 1
    whole = running.run_all

    def broken_off(units, *others):  # type: ignore[no-untyped-def]
        whole(units[:1], *others)
        raise KeyboardInterrupt

    monkeypatch.setattr(running, "run_all", broken_off)
    words = ["stress", "--starts", "2", "--json", "part.json", "--resume"]
    with suppress(KeyboardInterrupt):
        cli.main(words)
    assert len(without_times("part.json")) == 1
    monkeypatch.setattr(running, "run_all", whole)
    ran.clear()
    capsys.readouterr()
    assert cli.main(words) == 1
    assert len(ran) == 1
    assert without_times("part.json") == without_times("whole.json")
    ran.clear()
    assert cli.main(words) == 1  # nothing is left, and it is told again
    assert not ran
    assert "xpbd 0 alive, 1 failed" in capsys.readouterr().out


def test_another_material_runs_last_and_only_where_it_is_needed(
    ran: list[Unit], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slack, robust = (replace(one, solver=SMALL.solver) for one in (ROBUST_SLACK, ROBUST))
    monkeypatch.setattr(choose, "SETTINGS", {one.name: one for one in (slack, robust)})
    other = replace(CASE, number=2, variants=CASE.variants[:1])
    monkeypatch.setattr(catalogue, "CASES", (CASE, other))
    cli.main(["stress", "--quick", "--json", "o.json"])
    assert [unit.key for unit in ran] == [
        (1, "swings", "robust"), (1, "breaks", "robust"), (2, "swings", "robust"),
        (1, "swings", "robust-slack"), (1, "breaks", "robust-slack"),
    ]  # fmt: skip
    assert "robust-slack 0 alive, 1 failed, 0 too slow" in capsys.readouterr().out
    ran.clear()
    cli.main(["stress", "--quick", "--only", "2", "--solver", "robust-slack"])  # asked for by name
    assert [unit.key for unit in ran] == [(2, "swings", "robust-slack")]


def test_a_seed_repeats_one_start(ran: list[Unit], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stress", "--only", "1", "--variant", "breaks", "--solver", "xpbd", "--seed", "12345"]
    assert cli.main(words) == 1
    assert "of start 0 (seed 12345)" in capsys.readouterr().out
    assert cli.main(["stress", "--only", "1", "--seed", "5"]) == 2
    assert "--seed repeats one start" in capsys.readouterr().err


def test_a_file_becomes_the_page_without_a_run(ran: list[Unit], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["stress", "--quick", "--json", "o.json", "--markdown", "page.md"]) == 1
    first = Path("page.md").read_bytes(), Path("page_rows.md").read_bytes()
    ran.clear()
    assert cli.main(["stress", "--from", "o.json", "--markdown", "page.md", "--force"]) == 1
    assert not ran
    assert (Path("page.md").read_bytes(), Path("page_rows.md").read_bytes()) == first
    assert cli.main(["stress", "--from", "o.json", "--markdown", "page.md"]) == 2
    assert "page.md exists already: use --force" in capsys.readouterr().err


def test_one_variant_says_how_much_was_not_run(ran: list[Unit]) -> None:
    assert cli.main(["stress", "--only", "1", "--variant", "swings", "--quick", "--markdown", "o.md"]) == 0
    assert "1 of 2 units not run." in Path("o.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--only", "41"], "no case '41': 1 stiffness sweep, "),
        (["--only", "29", "--variant", "11 m"], "yank has no variant '11 m': "),
        (["--variant", "10 m"], "--variant is one of a case's: it goes with --only"),
        (["--long"], "--long is about the long run: it goes with --only 32"),
        (["--resume"], "--resume goes on with a file"),
        (["--explain"], "--explain goes on with a file"),
        (["--from", "none.json"], "none.json: No such file"),
        (["--from", "o.json", "--json", "p.json"], "--from runs nothing"),
        (["--markdown", "no/where.md"], "no is no folder to write where.md into"),
        (["--markdown", "o.md", "--tear", "0.5"], "--tear has no part in it"),
        (["--solver", "lines", "--tear", "0.5"], "lines needs a grid of whole rows"),
    ],
)
def test_wrong_use_is_one_line(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["stress", *words]) == 2
    [told] = capsys.readouterr().err.strip().splitlines()
    assert line in told


def test_an_unknown_solver_and_a_wrong_number_of_starts(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--tear", "nan"], ["--solver", "robst"], ["--starts", "0"], ["--quick", "--seed", "1"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(["stress", *words])
        assert ended.value.code == 2
    assert "did you mean 'robust'?" in capsys.readouterr().err


def test_chosen() -> None:
    variants = {case.number: len(case.variants) for case in catalogue.CASES}
    assert len(chosen()) == sum(variants.values()) * len(SETTINGS)
    assert [unit.setting.name for unit in chosen("yank")] == [name for name in SETTINGS for _ in range(variants[29])]
    assert {unit.key[0] for unit in chosen("29", None, "robust")} == {29}
    with pytest.raises(WrongUse, match="no case 'yak': 1 stiffness sweep, 2 "):
        chosen("yak")
    assert [unit.case for unit in chosen("32", setting="lines", long=True)] == [catalogue.LONG] * variants[32]


def test_who_can_tear() -> None:
    able = [name for name in SETTINGS if name != "lines"]
    found = chosen("29", tear=0.5)
    assert list(dict.fromkeys(unit.setting.name for unit in found)) == [f"{name} tear 0.5" for name in able]
    with pytest.raises(WrongUse, match="lines needs a grid of whole rows"):
        chosen("29", None, "lines", tear=0.5)


def test_every_unit_can_go_to_another_process() -> None:
    for unit in chosen(setting="xpbd"):
        assert pickle.loads(pickle.dumps(unit)).key == unit.key
    assert len({unit.key for unit in chosen()}) == len(chosen())
