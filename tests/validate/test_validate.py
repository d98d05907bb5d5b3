"""The command `validate`: that it measures, that it judges, and that it can fail."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from taichi_cloth import cli
from taichi_cloth.errors import WrongUse
from taichi_cloth.mesh import from_scene
from taichi_cloth.scene.model import SOLVER_NAMES
from taichi_cloth.validate import catalogue, report, strand
from taichi_cloth.validate.row import EXCELLENT, PASS, SHORT, Known, Reference, Result, Row, at_most, measure, relative

BY_NUMBER = {reference.number: reference for reference in catalogue.REFERENCES}

# The whole list takes minutes; of each kind of motion one, with methods that differ.
QUICK = [
    ("A1.1", "xpbd"),
    ("A1.5", "lines"),
    ("A2.2", "rk4"),
    ("A2.3", "spring"),
    ("A2.6", "rk4"),
    ("B4", "xpbd"),
    ("A3.2", "verlet"),
    ("A3.3", "spring"),
    ("A3.4", "spring"),
    ("A4.1", "xpbd"),
    ("A4.4", "lines"),
]
QUICK += [("A6.1", "rk4"), ("A7.1", "verlet"), ("A8.3", "spring"), ("B3", "xpbd"), ("B5", "xpbd"), ("B6.2", "lines")]


@pytest.mark.parametrize(("number", "solver"), QUICK)
def test_what_is_claimed_passes(number: str, solver: str) -> None:
    results = measure(BY_NUMBER[number], solver)
    assert results
    assert not [result.row for result in results if result.broken]


@pytest.mark.long
@pytest.mark.parametrize(("reference", "solver"), catalogue.chosen(None, None), ids=lambda v: getattr(v, "number", v))
def test_every_claim(reference: Reference, solver: str) -> None:
    assert not [result.row for result in measure(reference, solver) if result.broken]


def test_numbers_are_not_used_twice_and_reasons_name_solvers() -> None:
    assert len(BY_NUMBER) == len(catalogue.REFERENCES)
    for reference in catalogue.REFERENCES:
        assert {*reference.beyond, *reference.solvers} <= set(SOLVER_NAMES)


def test_verdicts() -> None:
    rows = [relative("", 2.0, 2.0 + d, 0.1, 0.01) for d in (0.0, 0.019, 0.021, 0.21, float("nan"))]
    assert [row.verdict for row in rows] == [EXCELLENT, EXCELLENT, PASS, SHORT, SHORT]
    assert [at_most("", e, 1.0, 0.0).verdict for e in (0.0, -1.0, 1.1)] == [EXCELLENT, PASS, SHORT]


def test_a_wrong_spring_constant_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows measure the program, not themselves: with springs 1 % too stiff a spring's law does not fit."""
    right = from_scene.stiffness_of
    monkeypatch.setattr("taichi_cloth.scene_solver.stiffness_of", lambda *words: 1.01 * right(*words))
    assert all(result.broken for result in measure(BY_NUMBER["A2.2"], "spring"))


def test_a_force_that_is_not_carried_to_the_pin_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strand, "SWEEPS", ((1, 6e-2),))
    assert all(result.broken for result in measure(BY_NUMBER["B5"], "xpbd"))


def test_chosen() -> None:
    assert {reference.number for reference, _ in catalogue.chosen("A2", None)} == {f"A2.{k}" for k in range(1, 9)}
    assert catalogue.chosen("B3", "lines") == [(BY_NUMBER["B3"], "lines")]
    with pytest.raises(WrongUse, match=r"no reference 'Z9' with rk4: A1\.1, "):
        catalogue.chosen("Z9", "rk4")


def results(beyond: dict[str, Known]) -> list[Result]:
    reference = Reference("A0", "test", "nobody", lambda solver: iter(()), ("xpbd", "rk4"), beyond)
    rows = [relative("way [m]", 1.0, measured, 0.1, 0.01) for measured in (1.0, 1.05, 2.0)]
    return [Result(reference, solver, row) for solver in ("xpbd", "rk4") for row in rows]


def test_a_reason_explains_no_more_than_it_is_known_to() -> None:
    assert [result.broken for result in results({"rk4": Known("it is too short", 0.9)})][-1]
    assert not [result.broken for result in results({"rk4": Known("it is too short", 1.1)})][-1]


def test_reasons_and_the_last_line(tmp_path: Path) -> None:
    found = results({"rk4": Known("it is too short", 1.0)})
    assert [result.broken for result in found] == [False, False, True, False, False, False]
    assert report.reasons(found) == [
        "A0 test falls short with xpbd: it should not",
        "A0 test falls short with rk4: it is too short",
    ]
    last = "6 rows: 2 excellent, 2 pass, 2 fall short (1 for a known reason, 1 broken)"
    assert report.count(found) == last
    report.write_markdown(tmp_path / "o.md", found)
    text = (tmp_path / "o.md").read_text(encoding="utf-8")
    assert last in text
    assert "| reference | xpbd | rk4 |\n|---|---|---|\n| A0 test | **1.0e+00** | **1.0e+00** |\n" in text
    assert text.count("\n| A0 test | ") == 1 + 6
    report.write_json(tmp_path / "o.json", found)
    rows = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))["rows"]
    assert [row["reason"] for row in rows] == ["", "", "", "", "", "it is too short"]
    assert rows[1]["error"] == pytest.approx(0.05)
    assert rows[1]["pass"] == 0.1


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["validate", "--only", "A2.2", "--solver", "spring", "--json", "o.json", "--markdown", "o.md"]
    assert cli.main(words) == 0
    told = capsys.readouterr().out
    assert "A2.2 one spring" in told
    assert told.rstrip().endswith("1 rows: 1 excellent, 0 pass, 0 fall short (0 for a known reason, 0 broken)")
    assert cli.main(words) == 2
    assert "o.json exists already: use --force" in capsys.readouterr().err
    broken = replace(BY_NUMBER["A2.2"], run=lambda solver: iter([Row("", 1.0, 2.0, 1.0, 0.1, 0.01)]))
    monkeypatch.setattr(catalogue, "REFERENCES", (broken,))
    assert cli.main(["validate", "--solver", "spring"]) == 1
    assert "falls short with spring: it should not" in capsys.readouterr().out


def test_an_unknown_reference_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["validate", "--only", "A9"]) == 2
    assert capsys.readouterr().err.startswith("taichi-cloth: no reference 'A9': A1.1, A1.2")
