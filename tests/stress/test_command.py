"""The command `stress`: what it runs, writes and resumes, and its exit code."""

import json
import pickle
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.stress import case_catalog, runner, store
from taichi_cloth.evaluation.stress.causes import Cause
from taichi_cloth.evaluation.stress.runner import select_units
from taichi_cloth.evaluation.stress.setup import ROBUST, ROBUST_SLACK, SETTINGS
from taichi_cloth.evaluation.stress.unit import Failure, Unit, run_unit, seed_of
from taichi_cloth.system.errors import UsageError

from .conftest import CASE, SMALL, failed


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Unit]:
    """A catalog of one case. Its units run one by one in this process, and are listed here."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(case_catalog, "CASES", (CASE,))
    monkeypatch.setattr(runner, "SETTINGS", {"xpbd": SMALL})
    some: list[Unit] = []

    def one_by_one(units, starts, pictures, on_result, run_one=run_unit):  # type: ignore[no-untyped-def]
        for unit in units:
            some.append(unit)
            on_result(run_one(unit, starts(unit), pictures))

    monkeypatch.setattr(runner, "run_all", one_by_one)
    return some


def without_times(path: str) -> list[dict[str, object]]:
    rows = json.loads(Path(path).read_text(encoding="utf-8"))["results"]
    return [{key: row[key] for key in row if key not in ("ms", "seconds", "date")} for row in rows]


def test_an_unexplained_failure_gives_exit_code_1(
    ran: list[Unit], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["stress", "--runs", "2", "--json", "o.json", "--resume"]
    seed = seed_of(1, "breaks", 0)
    assert main(words) == 1
    out = capsys.readouterr().out
    line = f"1 test, breaks, fails with xpbd: something 2, bound 1, in frame 6 of start 0 (seed {seed}); "
    assert f"{line}not examined; " in out
    assert "of 1 failure, 0 unexplained, 1 not examined" in out
    assert out.rstrip().endswith("xpbd 0 alive, 1 failed, 0 too slow")
    assert list(Path("out/stress").iterdir())
    asked = []
    for most, code in ((1.9, 1), (2.0, 0)):  # the failure is worse than the first cause explains

        def showing(failed, on_cause, most=most):  # type: ignore[no-untyped-def]
            for unit, *_ in failed:
                asked.append(unit.variant.name)
                on_cause(unit, Cause("something", most, "it is made to"))

        monkeypatch.setattr(runner, "explain_all", showing)
        assert main([*words, "--explain"]) == code
    assert f"{line}it is made to; " in capsys.readouterr().out
    assert main([*words, "--explain"]) == main(words) == 0
    assert asked == ["breaks", "breaks"]  # an explained failure is not examined again
    assert main(["stress", "--from", "o.json", "--markdown", "page.md"]) == 0
    assert f"(seed {seed}); it is made to\n" in Path("page_rows.md").read_text(encoding="utf-8")


def test_the_shortest_runs_are_examined_first(monkeypatch: pytest.MonkeyPatch) -> None:
    units = [Unit(CASE, replace(CASE.variants[1], name=name), SMALL) for name in "abc"]
    stored = store.Store.new(None, units)
    for unit, seconds in zip(units, (2.0, 3.0, 1.0), strict=True):
        stored.add(failed(variant=unit.variant.name, seconds=seconds))
    examined: list[Unit] = []
    monkeypatch.setattr(runner, "explain_all", lambda some, on_cause: examined.extend(unit for unit, *_ in some))
    runner.explain(stored, units)
    assert [unit.variant.name for unit in examined] == ["c", "a", "b"]


def test_experiments_run_in_worker_processes() -> None:
    """With a shipped variant that survives, so that its start does not fail again."""
    [unit] = select_units("30", "nan", "xpbd")
    found = []
    runner.explain_all([(unit, Failure(0, 1, 0, "something", 2.0, 1.0), 0)], lambda *pair: found.append(pair))
    [(of, cause)] = found
    assert of == unit
    assert (cause.what, cause.shown) == ("something", "")


def test_a_resumed_run_equals_an_uninterrupted_one(
    ran: list[Unit], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["stress", "--runs", "2", "--json", "whole.json"]) == 1
    whole = runner.run_all

    def interrupted(units, *others):  # type: ignore[no-untyped-def]
        whole(units[:1], *others)
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "run_all", interrupted)
    words = ["stress", "--runs", "2", "--json", "part.json", "--resume"]
    with suppress(KeyboardInterrupt):
        main(words)
    assert len(without_times("part.json")) == 1
    monkeypatch.setattr(runner, "run_all", whole)
    ran.clear()
    capsys.readouterr()
    assert main(words) == 1
    assert len(ran) == 1
    assert without_times("part.json") == without_times("whole.json")
    ran.clear()
    assert main(words) == 1  # nothing is left to run, and the report is printed again
    assert not ran
    assert "xpbd 0 alive, 1 failed" in capsys.readouterr().out


@pytest.mark.parametrize("more", [["--filter", "32", "--soak"], ["--tear", "0.5"]])
def test_a_resumed_run_of_other_units_does_not_delete_results(
    ran: list[Unit], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    assert main(["stress", "--quick", "--json", "o.json"]) == 1
    before = Path("o.json").read_bytes()
    long = replace(CASE, number=32, variants=CASE.variants[:1])
    monkeypatch.setattr(case_catalog, "CASES", (CASE, long))
    monkeypatch.setattr(case_catalog, "LONG", long)
    ran.clear()
    capsys.readouterr()
    for force in ([], ["--force"]):
        assert main(["stress", "--quick", *more, "--json", "o.json", "--resume", *force]) == 2
        line = "o.json has 2 results that this run does not include (1 test, swings, xpbd): use another file"
        assert capsys.readouterr().err == f"taichi-cloth: {line}\n"
        assert (ran, Path("o.json").read_bytes()) == ([], before)


def test_a_variant_that_is_no_longer_alive_is_named(ran: list[Unit], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stress", "--quick", "--json", "o.json", "--resume"]
    assert main(words) == 1
    assert "alive before" not in capsys.readouterr().out
    data = json.loads(Path("o.json").read_text(encoding="utf-8"))
    for row in data["results"]:
        row["origin"], row["failure"] = "older", None
    Path("o.json").write_text(json.dumps(data), encoding="utf-8")
    assert main(words) == 1
    assert "1 test, breaks, xpbd: alive before, now failed\n" in capsys.readouterr().out


def test_force_drops_results_of_variants_that_are_gone(ran: list[Unit], monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["stress", "--quick", "--json", "o.json", "--resume"]
    assert main(words) == 1
    monkeypatch.setattr(case_catalog, "CASES", (replace(CASE, variants=CASE.variants[:1]),))
    assert main(words) == 2
    assert len(without_times("o.json")) == 2
    assert main([*words, "--force"]) == 0
    assert Path("o.json").exists()


def test_a_recheck_runs_the_last_start_alone_and_all_starts_if_it_differs(
    ran: list[Unit], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    swings = replace(CASE, variants=CASE.variants[:1])
    monkeypatch.setattr(case_catalog, "CASES", (swings,))
    words = ["stress", "--runs", "3", "--json", "o.json", "--resume", "--recheck"]
    assert main(words) == 0
    asked: list[list[tuple[int, int]]] = []
    one_by_one = runner.run_all

    def listed(units, starts, *others):  # type: ignore[no-untyped-def]
        asked.extend(starts(unit) for unit in units)
        one_by_one(units, starts, *others)

    monkeypatch.setattr(runner, "run_all", listed)
    monkeypatch.setattr(store, "fingerprint", lambda unit: "later")
    last = (2, seed_of(1, "swings", 2))
    assert main(words) == 0
    assert asked == [[last]]
    [row] = json.loads(Path("o.json").read_text(encoding="utf-8"))["results"]
    assert (row["origin"], row["ran"], bool(row["repeated"])) == ("later", 3, True)
    monkeypatch.setattr(store, "fingerprint", lambda unit: "much later")
    Path("o.json").write_text(Path("o.json").read_text(encoding="utf-8").replace(row["digest"], "another bit"))
    asked.clear()
    assert main(words) == 0
    assert asked == [[last], [(k, seed_of(1, "swings", k)) for k in range(3)]]
    assert json.loads(Path("o.json").read_text(encoding="utf-8"))["results"][0]["repeated"] == ""
    monkeypatch.setattr(store, "fingerprint", lambda unit: "on another machine")
    monkeypatch.setattr(store, "machine", lambda: {"cpu": "another processor"})
    asked.clear()
    assert main(words) == 0
    assert asked == [[last]]
    [row] = json.loads(Path("o.json").read_text(encoding="utf-8"))["results"]
    assert row["machine"] != "another processor", "its times are those of the earlier machine"
    assert main(words[:-2] + ["--recheck", "--force"]) == 2
    assert "--recheck needs --resume" in capsys.readouterr().err


def test_robust_slack_runs_last_and_only_where_it_is_needed(
    ran: list[Unit], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slack, robust = (replace(one, solver=SMALL.solver) for one in (ROBUST_SLACK, ROBUST))
    monkeypatch.setattr(runner, "SETTINGS", {one.name: one for one in (slack, robust)})
    other = replace(CASE, number=2, variants=CASE.variants[:1])
    monkeypatch.setattr(case_catalog, "CASES", (CASE, other))
    main(["stress", "--quick", "--json", "o.json"])
    assert [unit.key for unit in ran] == [
        (1, "swings", "robust"), (1, "breaks", "robust"), (2, "swings", "robust"),
        (1, "swings", "robust-slack"), (1, "breaks", "robust-slack"),
    ]  # fmt: skip
    assert "robust-slack 0 alive, 1 failed, 0 too slow" in capsys.readouterr().out
    ran.clear()
    main(["stress", "--quick", "--filter", "2", "--solver", "robust-slack"])  # requested by name
    assert [unit.key for unit in ran] == [(2, "swings", "robust-slack")]


def test_results_that_are_needed_no_longer_are_dropped(ran: list[Unit], monkeypatch: pytest.MonkeyPatch) -> None:
    """`robust` survived a case that it did not survive before. Results that were requested by name stay until then."""
    slack, robust = (replace(one, solver=SMALL.solver) for one in (ROBUST_SLACK, ROBUST))
    monkeypatch.setattr(runner, "SETTINGS", {one.name: one for one in (slack, robust)})
    monkeypatch.setattr(case_catalog, "CASES", (replace(CASE, variants=CASE.variants[:1]),))
    words = ["stress", "--quick", "--json", "o.json"]
    main([*words, "--solver", "robust-slack"])
    main([*words, "--resume", "--solver", "robust"])
    assert [row["setting"] for row in without_times("o.json")] == ["robust-slack", "robust"]
    main([*words, "--resume"])
    assert [unit.setting.name for unit in ran] == ["robust-slack", "robust"]
    assert [row["setting"] for row in without_times("o.json")] == ["robust"]


def test_a_seed_repeats_one_start(ran: list[Unit], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stress", "--filter", "1", "--variant", "breaks", "--solver", "xpbd", "--seed", "12345"]
    assert main(words) == 1
    assert "of start 0 (seed 12345)" in capsys.readouterr().out
    assert main(["stress", "--filter", "1", "--seed", "5"]) == 2
    assert "--seed repeats one run" in capsys.readouterr().err


def test_the_page_is_written_from_a_file_without_a_run(ran: list[Unit], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stress", "--quick", "--json", "o.json", "--markdown", "page.md"]) == 1
    first = Path("page.md").read_bytes(), Path("page_rows.md").read_bytes()
    ran.clear()
    assert main(["stress", "--from", "o.json", "--markdown", "page.md", "--force"]) == 1
    assert not ran
    assert (Path("page.md").read_bytes(), Path("page_rows.md").read_bytes()) == first
    assert main(["stress", "--from", "o.json", "--markdown", "page.md"]) == 2
    assert "page.md already exists; use --force" in capsys.readouterr().err
    Path("page.md").unlink()
    assert main(["stress", "--from", "o.json", "--markdown", "page.md"]) == 2  # the second page is there
    assert "page_rows.md already exists; use --force" in capsys.readouterr().err
    assert (Path("page.md").exists(), Path("page_rows.md").read_bytes()) == (False, first[1])


def test_the_page_says_how_many_units_were_not_run(ran: list[Unit]) -> None:
    assert main(["stress", "--filter", "1", "--variant", "swings", "--quick", "--markdown", "o.md"]) == 0
    page = Path("o.md").read_text(encoding="utf-8")
    assert "1 of 2 combinations of variant and setting were not run." in page
    assert "\n1 starts per variant; run " in page


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--filter", "41"], "unknown case '41'; allowed: 1 stiffness sweep, "),
        (["--filter", "29", "--variant", "11 m"], "yank has no variant '11 m'; allowed: "),
        (["--variant", "10 m"], "--variant requires --filter with a single case"),
        (["--soak"], "--soak requires --filter 32"),
        (["--resume"], "--resume needs --json"),
        (["--explain"], "--explain needs --json"),
        (["--from", "none.json"], "none.json: No such file"),
        (["--from", "o.json", "--json", "p.json"], "--from runs nothing, and reports all results: leave out --json"),
        (["--from", "o.json", "--filter", "yank", "--solver", "lines"], "leave out --filter, --solver"),
        (["--from", "o.json", "--variant", "10 m", "--tear", "0.5"], "leave out --variant, --tear"),
        (["--from", "o.json", "--soak", "--seed", "0"], "leave out --seed, --soak"),
        (["--from", "o.json", "--resume", "--recheck", "--explain"], "leave out --resume, --recheck, --explain"),
        (["--markdown", "file/where.md"], "cannot write where.md: file is not a folder"),
        (["--markdown", "o.md", "--tear", "0.5"], "--markdown cannot be combined with --tear"),
        (["--solver", "lines", "--tear", "0.5"], "lines needs complete grid rows"),
    ],
)
def test_wrong_use_is_reported_in_one_line(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    assert main(["stress", *words]) == 2
    [message] = capsys.readouterr().err.strip().splitlines()
    assert line in message


def test_unknown_solvers_and_invalid_numbers_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--tear", "nan"], ["--solver", "robst"], ["--runs", "0"], ["--quick", "--seed", "1"]):
        with pytest.raises(SystemExit) as ended:
            main(["stress", *words])
        assert ended.value.code == 2
    assert "did you mean 'robust'?" in capsys.readouterr().err


def test_units_are_selected_by_case_variant_and_setting() -> None:
    variants = {case.number: len(case.variants) for case in case_catalog.CASES}
    assert len(select_units()) == sum(variants.values()) * len(SETTINGS)
    assert [unit.setting.name for unit in select_units("yank")] == [
        name for name in SETTINGS for _ in range(variants[29])
    ]
    assert {unit.key[0] for unit in select_units("29", None, "robust")} == {29}
    with pytest.raises(UsageError, match="unknown case 'yak'; allowed: 1 stiffness sweep, 2 "):
        select_units("yak")
    assert [unit.case for unit in select_units("32", setting="lines", long=True)] == [case_catalog.LONG] * variants[32]


def test_only_settings_that_support_tearing_are_selected_to_tear() -> None:
    able = [name for name in SETTINGS if name != "lines"]
    found = select_units("29", tear=0.5)
    assert list(dict.fromkeys(unit.setting.name for unit in found)) == [f"{name} tear 0.5" for name in able]
    with pytest.raises(UsageError, match="lines needs complete grid rows"):
        select_units("29", None, "lines", tear=0.5)


def test_every_unit_can_be_pickled() -> None:
    for unit in select_units(setting="xpbd"):
        assert pickle.loads(pickle.dumps(unit)).key == unit.key
    assert len({unit.key for unit in select_units()}) == len(select_units())
