"""The command `validate`: that it measures, that it judges, and that it can fail."""

import json
import subprocess
from dataclasses import replace
from importlib.metadata import version
from itertools import islice
from math import nan
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth import cli
from taichi_cloth.accuracy.truth import Curtain, truth
from taichi_cloth.errors import WrongUse
from taichi_cloth.mesh import from_scene
from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.scene.model import SOLVER_NAMES, USUAL
from taichi_cloth.validate import catalogue, page, report, running, setups, strand, swing
from taichi_cloth.validate.row import (
    EXCELLENT,
    PASS,
    SHORT,
    TOO_SLOW,
    Reference,
    Result,
    Row,
    TooSlow,
    at_most,
    in_time,
    measure,
    relative,
)

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
BY_NUMBER = {reference.number: reference for reference in catalogue.REFERENCES}

# The whole list takes half an hour; here each kind of set-up once, with methods that differ.
QUICK = [
    *(("A1.1", "xpbd"), ("A1.4", "projective"), ("A1.5", "lines"), ("A1.6", "spring"), ("A1.7", "verlet")),
    *(("A2.2", "rk4"), ("A2.3", "spring"), ("A2.4", "lines"), ("A2.6", "rk4"), ("A2.7", "spring"), ("A2.8", "lines")),
    *(("A3.2", "verlet"), ("A3.3", "spring"), ("A4.1", "xpbd"), ("A4.4", "lines")),
    *(("A6.1", "rk4"), ("A7.1", "verlet"), ("A7.5", "spring"), ("A8.2", "spring"), ("A8.3", "spring")),
    *(("A8.5", "spring"), ("A8.6", "spring"), ("A8.10", "spring"), ("B4", "xpbd"), ("B5", "xpbd")),
]
# What may fall short by a law, with these solvers and no other.
EXPLAINED = {
    **dict.fromkeys(("A1.5", "A2.1", "A2.8"), setups.EULER),
    **dict.fromkeys(("A3.1", "B3"), ("xpbd",)),
    **dict.fromkeys(("A2.3", "A8.7", "B1"), ("verlet",)),
    **dict.fromkeys(("A2.5", "A6.2"), ("xpbd",)),
    "A7.2": ("spring", "rk4"),
    "A8.5": ("rk4",),
    "A8.9": ("verlet", "xpbd"),
    "A4.2": setups.ELASTIC,
}


@pytest.mark.parametrize(("number", "solver"), QUICK)
def test_what_is_claimed_passes(number: str, solver: str) -> None:
    results = measure(BY_NUMBER[number], solver)
    assert results
    assert [result.row for result in results if result.verdict not in (EXCELLENT, PASS)] == []
    if solver not in EXPLAINED.get(number, ()):
        assert [result.row.limit for result in results] == [None] * len(results)


@pytest.mark.parametrize("solver", ["lines", "xpbd"])
def test_only_euler_steps_are_excused_by_the_law_of_a_pendulum(solver: str) -> None:
    rows = [result.row for result in measure(BY_NUMBER["A2.1"], solver)]
    assert len(rows) == len(swing.ANGLES)
    assert {row.limit is not None for row in rows if row.verdict != SHORT} == {False}
    assert [row.explained for row in rows if row.verdict == SHORT] == ([True, True] if solver == "xpbd" else [])
    assert [row.broken for row in rows] == [False] * len(rows)
    assert (rows[-1].verdict == SHORT) == (solver == "xpbd")
    if solver == "xpbd":
        assert rows[-1].limit is not None
        assert rows[-1].error == pytest.approx(rows[-1].limit.most - rows[-1].good, abs=rows[-1].good)


def test_what_xpbd_loses_of_a_turn_is_by_its_law() -> None:
    """0.9055 of a turn a second is kept where the law of its steps says 0.9056: too little by rounding, and no more."""
    [result] = measure(BY_NUMBER["A1.5"], "xpbd")
    assert result.row.explained
    assert result.row.limit is not None
    assert result.row.limit.most == pytest.approx(result.row.good + 1e-3)


def test_the_swinging_curtain_is_measured() -> None:
    """16 cells of `xpbd` at its usual 60×4 are 0.19 % of the side away at the bottom, and 0.27 % between."""
    assert USUAL["xpbd"] == (60, 4)
    rows = list(islice(swing.swinging_curtain("xpbd"), 2))
    assert [row.error for row in rows] == pytest.approx([1.87e-3, 2.71e-3], rel=0.1)
    assert [row.verdict for row in rows] == [PASS, PASS]


def test_a_curtain_of_long_steps_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(USUAL, "xpbd", (1, 10))
    for row in islice(swing.swinging_curtain("xpbd"), 2):
        assert row.verdict == SHORT
        assert row.limit is None


def test_the_middle_of_the_bottom_is_at_the_same_place_whatever_the_cells() -> None:
    for cells in (2, 16, 32):
        start = topology_of(swing.curtain("xpbd", cells), "fabric").start
        assert setups.bottom_middle(start) == pytest.approx([0.0, -0.5 * np.sqrt(0.5), 0.5 * np.sqrt(0.5)], abs=1e-6)


def test_every_row_of_the_curtain_is_judged() -> None:
    """A row in the middle that is out of place is seen by the one row of the report, and not by the other."""
    every = truth(Curtain(16))[[14, 29, 59]]
    seen = np.repeat(every[:, :, None], 17, axis=2)
    seen[1, 8, 3, 0] += 0.02
    bottom = np.array(swing.CURTAIN[16])[:, None]
    assert swing.curtain_error("", lambda: seen, bottom).verdict == EXCELLENT
    row = swing.curtain_error("", lambda: seen, every)
    assert row.error == pytest.approx(0.02)
    assert row.what.endswith("after 0.5 s")


@pytest.mark.long
@pytest.mark.parametrize(("reference", "solver"), catalogue.chosen(None, None), ids=lambda v: getattr(v, "number", v))
def test_nothing_is_worse_than_its_law_nor_falls_short_where_it_passed(reference: Reference, solver: str) -> None:
    """Beside the results that are stored."""
    stored = report.read_json(RESULTS / "validation.json").results
    passed = {(one.number, one.solver, one.row.what) for one in stored if one.verdict in (EXCELLENT, PASS)}
    found = measure(reference, solver)
    assert not [one.row for one in found if one.row.broken]
    assert not [one.row for one in found if one.verdict == SHORT and (reference.number, solver, one.row.what) in passed]


def test_numbers_are_not_used_twice_and_all_solvers_exist() -> None:
    assert len(BY_NUMBER) == len(catalogue.REFERENCES)
    for reference in catalogue.REFERENCES:
        assert set(reference.solvers) <= set(SOLVER_NAMES)


def test_a_set_up_that_takes_too_long_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setups, "LONGEST", 0.0)
    [result] = measure(BY_NUMBER["A1.1"], "xpbd")
    assert result.verdict == TOO_SLOW
    assert not result.row.broken
    rows = measure(BY_NUMBER["A2.3"], "xpbd")
    assert [row.verdict for row in rows] == [TOO_SLOW] * len(swing.HANGING_LINKS) * swing.MODES

    def slow() -> Row:
        raise TooSlow(33.0)

    assert in_time("way", 0.1, 0.01, slow).seconds == 33.0


def test_verdicts() -> None:
    rows = [relative("", 2.0, 2.0 + d, 0.1, 0.01) for d in (0.0, 0.019, 0.021, 0.21, float("nan"))]
    assert [row.verdict for row in rows] == [EXCELLENT, EXCELLENT, PASS, SHORT, SHORT]
    assert [at_most("", e, 1.0, 0.0).verdict for e in (0.0, -1.0, 1.1)] == [EXCELLENT, PASS, SHORT]


def test_a_wrong_spring_constant_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows measure the program, not themselves: with springs 1 % too stiff a spring's law does not fit."""
    right = from_scene.stiffness_of
    monkeypatch.setattr("taichi_cloth.scene_solver.stiffness_of", lambda *words: 1.01 * right(*words))
    assert [result.verdict for result in measure(BY_NUMBER["A2.2"], "spring")] == [SHORT]


def test_a_force_that_is_not_carried_to_the_pin_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strand, "SWEEPS", ((1, 6e-2),))
    assert [result.verdict for result in measure(BY_NUMBER["B5"], "xpbd")] == [SHORT]


def test_chosen() -> None:
    assert {reference.number for reference, _ in catalogue.chosen("A2", None)} == {f"A2.{k}" for k in range(1, 9)}
    assert catalogue.chosen("B3", "lines") == [(BY_NUMBER["B3"], "lines")]
    with pytest.raises(WrongUse, match=r"no reference 'Z9' with rk4: A1\.1, "):
        catalogue.chosen("Z9", "rk4")


def results() -> list[Result]:
    """Of `xpbd` and `rk4`: the last row of `xpbd` is worse than its law, that of `rk4` within it; one is too slow."""
    rows = [relative("way [m]", 1.0, measured, 0.1, 0.01) for measured in (1.0, 1.05, 2.0)]
    law = {"xpbd": 0.5, "rk4": 0.95}
    found = [
        Result("A0", "test", "nobody", solver, row.by_law("x²", law[solver]) if row.verdict == SHORT else row)
        for solver in law
        for row in rows
    ]
    slow = Row("wait [s]", nan, nan, nan, 0.1, 0.01, seconds=20.4)
    return [*found, Result("A0", "test", "nobody", "rk4", slow), Result("A9", "other", "nobody", "rk4", rows[-1])]


LAST = "8 rows: 2 excellent, 2 pass, 3 fall short (1 as a law says, 1 broken), 1 too slow"


def test_reasons_and_the_last_line() -> None:
    found = results()
    assert [result.row.broken for result in found] == [False, False, True] + 5 * [False]
    assert report.reasons(found) == [
        "A0 test falls short with xpbd: more than its law explains",
        "A0 test falls short with rk4: x²",
        "A0 test falls short with rk4: its set-ups take too long",
        "A9 other falls short with rk4: no law explains it",
    ]
    assert report.count(found) == LAST
    assert report.tally(found) == {
        "rows": 8,
        "excellent": 2,
        "pass": 2,
        "falls short": 3,
        "too slow": 1,
        "broken": 1,
        "pass or excellent [%]": 50.0,
        "excellent [%]": 25.0,
    }


def test_the_page_is_made_from_the_rows(tmp_path: Path) -> None:
    run = report.this_machine(results())
    text = "\n".join([*page.main_page(run, "rows.md"), *page.rows_page(run, "main.md")])
    assert f"# Validation\n\n{LAST}. [rows.md](rows.md) has them all.\n" in text
    assert "\n50.0 % pass (goal: 90 %), 25.0 % are excellent (goal: 60 %).\n" in text
    assert "| xpbd | 3 | 1 | 1 | 1 | 0 | 66.7 % | 33.3 % |" in text
    assert "| A0 test | **1.0e+00** | **1.0e+00** |\n| A9 other |  | **1.0e+00** |\n" in text
    assert "| A0 test | rk4 | wait [s] | - | - | - | too slow: over 20 s | nobody |" in text
    report.write_json(tmp_path / "o.json", run)
    read = report.read_json(tmp_path / "o.json")
    assert read.date == run.date
    assert read.commit == run.commit
    assert "\n".join([*page.main_page(read, "rows.md"), *page.rows_page(read, "main.md")]) == text
    assert [result.row.broken for result in read.results] == [result.row.broken for result in run.results]
    everything = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))
    assert everything["summary"]["all"]["pass or excellent [%]"] == 50.0
    assert [row["reason"] for row in everything["rows"]][2:5] == ["more than its law explains", "", ""]
    assert everything["rows"][1]["error"] == pytest.approx(0.05)
    assert everything["rows"][1]["pass"] == 0.1
    assert everything["rows"][6]["error"] is None


def test_a_run_says_which_program_it_was(tmp_path: Path) -> None:
    assert report.commit_of(tmp_path) == version("taichi-cloth")  # no clone
    for words in (
        ["init", "-q"],
        ["-c", "user.name=a", "-c", "user.email=a", "commit", "-q", "--allow-empty", "-m", "a"],
    ):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    head = subprocess.run(["git", "-C", str(tmp_path), "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    assert report.commit_of(tmp_path) == head.stdout.strip()
    (tmp_path / "within").mkdir()
    assert report.commit_of(tmp_path / "within") == version("taichi-cloth")  # installed within another clone


def test_pairs_run_in_processes_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(running, "CORES", 2)
    pairs = [(BY_NUMBER["A2.2"], "spring"), (BY_NUMBER["A2.2"], "rk4")]
    steps: list[str] = []
    found = running.measure_all(pairs, steps.append)
    assert [(result.number, result.solver, result.verdict) for result in found] == [
        ("A2.2", "spring", EXCELLENT),
        ("A2.2", "rk4", EXCELLENT),
    ]
    assert sorted(steps) == ["A2.2 one spring, rk4", "A2.2 one spring, spring"]


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["validate", "--only", "A2.2", "--solver", "spring", "--json", "o.json", "--markdown", "o.md"]
    assert cli.main(words) == 0
    told = capsys.readouterr().out
    assert "A2.2 one spring" in told
    assert told.rstrip().endswith("1 rows: 1 excellent, 0 pass, 0 fall short (0 as a law says, 0 broken), 0 too slow")
    assert cli.main(words) == 2
    assert "o.json exists already: use --force" in capsys.readouterr().err
    assert cli.main(["validate", "--from", "o.json", "--markdown", "again.md"]) == 0
    assert Path("again.md").read_bytes() == Path("o.md").read_bytes().replace(b"o_rows.md", b"again_rows.md")
    assert "| A2.2 one spring | spring |" in Path("again_rows.md").read_text(encoding="utf-8")
    short = Row("", 1.0, 2.0, 1.0, 0.1, 0.01)
    for row, status in ((short, 1), (short.by_law("x²", 0.5), 1), (short.by_law("x²", 0.95), 0)):
        broken = replace(BY_NUMBER["A2.2"], run=lambda solver, row=row: iter([row]))
        monkeypatch.setattr(catalogue, "REFERENCES", (broken,))
        assert cli.main(["validate", "--solver", "spring"]) == status
    assert "falls short with spring: x²" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", "[]", '{"machine": {}, "rows": [{}]}'])
def test_a_file_that_is_no_run_is_one_line(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "o.json"
    path.write_text(text, encoding="utf-8")
    assert cli.main(["validate", "--from", str(path)]) == 2
    err = capsys.readouterr().err
    assert "is not what `validate --json` writes" in err
    assert err.count("\n") == 1
    assert cli.main(["validate", "--from", str(tmp_path / "none.json")]) == 2
    assert "No such file" in capsys.readouterr().err
    assert cli.main(["validate", "--from", str(path), "--only", "A1"]) == 2
    assert "it goes without --only and --solver" in capsys.readouterr().err


def test_an_unknown_reference_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["validate", "--only", "A9"]) == 2
    assert capsys.readouterr().err.startswith("taichi-cloth: no reference 'A9': A1.1, A1.2")
