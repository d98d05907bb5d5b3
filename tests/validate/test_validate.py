"""The command `validate`: it measures, judges, and can fail."""

import json
import subprocess
from collections import Counter
from dataclasses import replace
from importlib.metadata import version
from itertools import islice
from math import nan
from pathlib import Path

import numpy as np
import pytest
from rows import name_of, worse

from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.bench.error_sweep import Curtain, curtain_solution
from taichi_cloth.evaluation.stress.store import files_behind
from taichi_cloth.evaluation.validate import check, elasticity, flight, hanging, references, strand, swing
from taichi_cloth.evaluation.validate import validation_report as report
from taichi_cloth.evaluation.validate.check import (
    EXCELLENT,
    FAIL,
    PASS,
    SAME_ITERATIONS,
    TOO_SLOW,
    Check,
    Reference,
    Result,
    TooSlow,
    at_most,
    measure,
    relative,
    run_with_limit,
)
from taichi_cloth.geometry.cloth_builder import build_topology, spring_stiffness
from taichi_cloth.scene.schema import SOLVER_NAMES
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.console import commit_of
from taichi_cloth.system.errors import UsageError

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
BY_NUMBER = {reference.number: reference for reference in references.REFERENCES}

# The whole list takes half an hour; here each kind of setup runs once, with different solvers.
QUICK = [
    *(("A1.1", "xpbd"), ("A1.4", "implicit"), ("A1.5", "lines"), ("A1.6", "explicit"), ("A1.7", "verlet")),
    *(
        ("A2.2", "rk4"),
        ("A2.3", "explicit"),
        ("A2.4", "lines"),
        ("A2.6", "rk4"),
        ("A2.7", "explicit"),
        ("A2.8", "explicit"),
    ),
    *(("A3.2", "verlet"), ("A3.3", "explicit"), ("A3.5", "explicit"), ("A4.1", "xpbd"), ("A4.4", "lines")),
    *(("A6.1", "rk4"), ("A7.1", "verlet"), ("A7.5", "explicit"), ("A8.2", "explicit"), ("A8.3", "explicit")),
    *(("A8.5", "explicit"), ("A8.6", "explicit"), ("A8.10", "explicit"), ("B5", "xpbd")),
    *(("A2.6", "implicit"), ("A7.1", "implicit"), ("B6.1", "lines"), ("B6.2", "implicit")),
]
# References that may fall short because of a law, with these solvers only.
EXPLAINED = {
    **dict.fromkeys(("A1.5", "A2.1", "A2.8"), check.EULER),
    **dict.fromkeys(("A3.1", "B3"), ("xpbd",)),
    **dict.fromkeys(("A2.3", "B1"), ("verlet",)),
    **dict.fromkeys(("A2.5", "A6.2"), ("xpbd",)),
    "A8.5": ("rk4",),
    "A8.7": ("verlet", "xpbd"),
    "A8.9": ("verlet",),
    "A4.2": check.ELASTIC,
}


@pytest.mark.parametrize(("number", "solver"), QUICK)
def test_the_claimed_results_pass(number: str, solver: str) -> None:
    results = measure(BY_NUMBER[number], solver)
    assert results
    assert [result.row for result in results if result.verdict not in (EXCELLENT, PASS)] == []
    if solver not in EXPLAINED.get(number, ()):
        assert [result.row.limit for result in results] == [None] * len(results)


@pytest.mark.parametrize("solver", ["lines", "xpbd"])
def test_only_euler_solvers_are_explained_by_the_law_of_a_pendulum(solver: str) -> None:
    """It explains only rows that fall short, at large angles: at small angles its error is within the tolerance."""
    rows = [result.row for result in measure(BY_NUMBER["A2.1"], solver)]
    assert len(rows) == len(swing.ANGLES)
    assert [row.limit is not None for row in rows] == [row.verdict == FAIL for row in rows]
    assert any(row.limit is not None for row in rows) == (solver in EXPLAINED["A2.1"])
    assert [row.broken for row in rows] == [False] * len(rows)
    assert (rows[-1].verdict == FAIL) == (solver == "xpbd")
    if solver == "xpbd":
        assert rows[-1].limit is not None
        assert rows[-1].error == pytest.approx(rows[-1].limit.max_error - rows[-1].tolerance, abs=rows[-1].tolerance)


def test_the_spin_that_xpbd_loses_is_explained_by_its_law() -> None:
    """0.9055 of a turn per second remains where the law of its steps predicts 0.9056: the rest is rounding."""
    [result] = measure(BY_NUMBER["A1.5"], "xpbd")
    assert result.row.explained
    assert result.row.limit is not None
    assert result.row.limit.max_error == pytest.approx(result.row.tolerance + 1e-3)


def test_only_rounding_makes_a_budget_of_sweeps_fall_short() -> None:
    """At 400 substeps a second float32 rounds the weight of soft links; all other splits of the budget pass."""
    rows = [result.row for result in measure(BY_NUMBER["B4"], "xpbd")]
    short = [row for row in rows if row.verdict == FAIL]
    assert len(rows) == 2 * len(hanging.SPLITS)
    assert [row.what.partition(":")[0] for row in short] == ["1000 N/m, 400 steps/s × 1"]
    assert short[0].explained
    assert short[0].limit is not None
    assert short[0].limit.max_error < 1.3 * short[0].error


def test_a_law_allows_its_error_and_the_tolerance_where_it_is_applied() -> None:
    *_, row = islice(flight.sail("verlet"), 3)  # at the widest span
    assert row.explained
    assert row.limit is not None
    assert row.limit.max_error == pytest.approx(0.0360 + row.tolerance, rel=0.02)


def test_a_drop_of_first_order_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    for order, verdict in ((2, EXCELLENT), (1, FAIL)):
        drops = iter([0.7 + 8.0 ** (1 - order) / links**order for links in elasticity.ORDER_LINKS])
        columns = (np.array([[0.0, 0.0], [0.0, drop], [0.0, 0.0]]) for drop in drops)
        monkeypatch.setattr(elasticity, "rest_column", lambda *_, columns=columns: next(columns))
        row = elasticity.order_of_drop("", "rk4")
        assert row.measured == pytest.approx(order)
        assert row.verdict == verdict


def test_the_swinging_curtain_is_measured() -> None:
    """`xpbd` on 16 cells at its default 60×4 has an error of 0.19 % of the side at the bottom, and 0.27 % elsewhere."""
    assert SOLVER_CATALOG["xpbd"].defaults == (60, 4)
    rows = list(islice(swing.swinging_curtain("xpbd"), 2))
    assert [row.error for row in rows] == pytest.approx([1.87e-3, 2.71e-3], rel=0.1)
    assert [row.verdict for row in rows] == [PASS, PASS]


def test_a_curtain_with_long_substeps_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SOLVER_CATALOG, "xpbd", replace(SOLVER_CATALOG["xpbd"], substeps=1, iterations=10))
    for row in islice(swing.swinging_curtain("xpbd"), 2):
        assert row.verdict == FAIL
        assert row.limit is None


def test_the_middle_of_the_bottom_is_at_the_same_position_on_every_grid() -> None:
    for cells in (2, 16, 32):
        start = build_topology(swing.curtain("xpbd", cells), "fabric").start
        assert check.bottom_middle(start) == pytest.approx([0.0, -0.5 * np.sqrt(0.5), 0.5 * np.sqrt(0.5)], abs=1e-6)


def test_every_row_of_the_curtain_is_checked() -> None:
    """A displaced particle in the middle changes the row of all particles, and not the row of the bottom."""
    every = curtain_solution(Curtain(16))[[14, 29, 59]]
    seen = np.pad(np.repeat(every[:, :, None], 17, axis=2), ((0, 0), (0, 0), (0, 0), (0, 1)))
    seen[1, 8, 3, 0] += 0.02
    bottom = np.array(swing.CURTAIN[16])[:, None]
    assert swing.curtain_error("", lambda: seen, bottom).verdict == EXCELLENT
    row = swing.curtain_error("", lambda: seen, every)
    assert row.error == pytest.approx(0.02)
    assert row.what.endswith("after 0.5 s")


def test_a_curtain_that_moves_along_its_top_edge_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wave that moves particles along x only: by 2 cm, above the bound of 1 % of the side."""

    def advance(simulation: Simulation, seconds: float) -> None:
        x = simulation.topology.start.copy()
        x[8, 0] += 0.02
        simulation.set_state(x)

    monkeypatch.setattr(swing, "advance", advance)
    rows = swing.curtain_rows("explicit", 4)
    start = np.repeat(Curtain(4).start[None], 3, axis=0)
    row = swing.curtain_error("", lambda: rows, start)
    assert row.error == pytest.approx(0.02, rel=1e-4)
    assert row.verdict == FAIL


@pytest.mark.long
@pytest.mark.parametrize(
    ("reference", "solver"), references.select_pairs(None, None), ids=lambda v: getattr(v, "number", v)
)
def test_no_result_is_worse(reference: Reference, solver: str) -> None:
    """No result may be worse than its law, or fall short where the stored one passes."""
    stored = report.read_json(RESULTS / "validation.json").results
    found = measure(reference, solver)
    assert worse(found, stored) == []
    kept = [one for one in stored if (one.number, one.solver) == (reference.number, solver)]
    assert list(map(name_of, found)) == list(map(name_of, kept))


def row_of(what: str, error: float, *, seconds: float = 0.0, law: float | None = None) -> Result:
    """Return the result of a row with a bound of 1 % and of 0.1 %; or of one that took too long."""
    row = Check(what, 0.0, error, error, 0.01, 0.001, seconds=seconds)
    return Result("B1", "", "", "explicit", row if law is None else row.by_law("a law", law))


def test_a_row_that_gets_worse_is_found_whatever_it_measured() -> None:
    before = [row_of("16 cells: error after 0.5 s", 0.005)]
    assert worse([row_of("16 cells: error after 0.25 s", 0.009)], before) == []
    assert worse([row_of("16 cells: error after 0.25 s", 0.5)], before) == ["16 cells: error after 0.25 s"]
    assert worse([row_of("16 cells: error after 0.25 s", 0.005, seconds=99.0)], before)
    assert worse([row_of("16 cells: error after 0.25 s", 0.005)], [row_of("16 cells: error after 0.5 s", 0.5)]) == []
    assert worse([row_of("16 cells: error after 0.25 s", 0.5)], [row_of("16 cells: error after 0.5 s", 0.5)]) == []
    assert worse([row_of("32 cells: error after 0.5 s", 0.5)], before) == ["32 cells: error after 0.5 s"]
    outside = row_of("16 cells: error after 0.5 s", 0.5, law=0.4)
    assert worse([outside], [outside]) == ["16 cells: error after 0.5 s"]
    assert worse([row_of("16 cells: error at frame 57", 0.5)], [row_of("16 cells: error at frame 4", 0.005)])


def test_reference_numbers_are_unique_and_their_solvers_exist() -> None:
    assert len(BY_NUMBER) == len(references.REFERENCES)
    for reference in references.REFERENCES:
        assert set(reference.solvers) <= set(SOLVER_NAMES)


def test_a_setup_that_takes_too_long_is_too_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "MAX_SECONDS", 0.0)
    [result] = measure(BY_NUMBER["A1.1"], "xpbd")
    assert result.verdict == TOO_SLOW
    assert not result.row.broken
    rows = measure(BY_NUMBER["A2.3"], "xpbd")
    assert [row.verdict for row in rows] == [TOO_SLOW] * len(swing.HANGING_LINKS) * swing.MODES

    def slow() -> Check:
        raise TooSlow(33.0)

    assert run_with_limit("distance", 0.1, 0.01, slow).seconds == 33.0


@pytest.mark.parametrize(("number", "rows"), [("A3.5", 4), ("A4.3", 19), ("A4.6", 5)])
def test_a_setup_that_takes_too_long_has_as_many_rows_as_any_other(
    number: str, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "MAX_SECONDS", 0.0)
    found = [result.row for result in measure(BY_NUMBER[number], "xpbd")]
    assert [row.verdict for row in found] == [TOO_SLOW] * rows
    stored = report.read_json(RESULTS / "validation.json").results
    names = [one.row.what for one in stored if (one.number, one.solver) == (number, "explicit")]
    assert [row.what for row in found] == names


def test_too_slow_rows_are_not_left_out_of_the_stored_results() -> None:
    """Every solver has as many rows of a reference as the others, but for two.

    `verlet` cannot run two setups of the sail. `xpbd` takes steps of backward Euler, whose damping of a spring is
    published for six frequencies and step sizes more.
    """
    rows = Counter((one.number, one.solver) for one in report.read_json(RESULTS / "validation.json").results)
    assert rows[("A6.2", "verlet")] == rows[("A6.2", "xpbd")] - 2
    assert rows[("A2.2", "xpbd")] == rows[("A2.2", "explicit")] + 6
    del rows[("A6.2", "verlet")], rows[("A2.2", "xpbd")]
    for reference in references.REFERENCES:
        assert len({count for (number, _), count in rows.items() if number == reference.number}) == 1


def test_an_update_replaces_its_references_only_and_names_its_run() -> None:
    def of(number: str, solver: str, measured: float) -> Result:
        return Result(number, "test", "nobody", solver, relative("", 1.0, measured, 0.5, 0.1))

    order = [("A1", "xpbd"), ("A1", "rk4"), ("A2", "xpbd"), ("A9", "rk4")]
    rows = [of("A1", "xpbd", 1.0), of("A1", "rk4", 1.0), of("A2", "xpbd", 1.0), of("A8", "xpbd", 1.0)]
    earlier = report.Measured({"cpu": "one"}, rows, "2020-01-01 00:00", "old")
    later = report.Measured({"cpu": "one"}, [of("A9", "rk4", 1.0), of("A1", "rk4", 1.2)], "2020-02-02 00:00", "new")
    found = report.updated(earlier, later, order)
    when = ("2020-02-02 00:00", "new")
    assert [(one.number, one.solver, one.row.measured, one.later) for one in found.results] == [
        ("A1", "xpbd", 1.0, None),
        ("A1", "rk4", 1.2, when),
        ("A2", "xpbd", 1.0, None),
        ("A9", "rk4", 1.0, when),
    ]
    assert (found.date, found.commit) == ("2020-01-01 00:00", "old")
    line = "Measured later, 2020-02-02 00:00 · new: A1, A9 (2 rows)."
    assert line in report.main_page(found, "rows.md")
    assert not any(one.startswith("Measured later") for one in report.main_page(earlier, "rows.md"))
    with pytest.raises(UsageError, match="of another machine or other versions"):
        report.updated(earlier, later._replace(machine={"cpu": "two"}), order)


def test_later_rows_are_read_as_they_were_written(tmp_path: Path) -> None:
    row = Result("A1", "test", "nobody", "rk4", relative("", 1.0, 1.0, 0.5, 0.1), ("2020-02-02 00:00", "new"))
    rows = [row, replace(row, later=None), replace(row, origin="0123456789ab")]
    run = report.Measured({"cpu": "one"}, rows, "2020-01-01 00:00", "old")
    report.write_json(tmp_path / "a.json", run)
    assert report.read_json(tmp_path / "a.json").results == run.results


def test_rows_are_of_earlier_sources_once_their_solver_or_setup_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    [row] = references.measure_pair("A1.1", "explicit")[:1]
    pairs = [("A1.1", "explicit"), ("A1.1", "lines"), ("A2.1", "explicit")]
    rows = [replace(row, number=n, solver=s, origin=references.origin_of(n, s)) for n, s in pairs]
    assert rows[0] == row
    assert len({one.origin for one in rows}) == 3
    assert references.earlier_count(rows) == 0
    assert report.earlier_lines(rows) == []
    assert references.earlier_count([replace(row, origin=""), replace(row, number="A0"), *rows]) == 2
    found = files_behind(frozenset({"solvers/explicit.py"}))
    assert "kernels/springs.py" in dict(found)

    def changed(roots: frozenset[str]) -> list[tuple[str, str]]:
        return [(name, "new" if name == "solvers/explicit.py" else digest) for name, digest in files_behind(roots)]

    monkeypatch.setattr(references, "files_behind", changed)
    references.origin_of.cache_clear()
    try:
        assert references.earlier_count(rows) == 2
        assert (
            report.earlier_lines(rows)[0] == "2 of 3 rows were measured with earlier sources of their solver or setup."
        )
    finally:
        references.origin_of.cache_clear()


@pytest.mark.parametrize("options", [[], ["--json", "new.json", "--from", "a.json"]])
def test_an_update_needs_earlier_results(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "--update", *options]) == 2
    assert "--update needs --json with earlier results" in capsys.readouterr().err


def test_verdicts_follow_the_bounds() -> None:
    rows = [relative("", 2.0, 2.0 + d, 0.1, 0.01) for d in (0.0, 0.019, 0.021, 0.21, float("nan"))]
    assert [row.verdict for row in rows] == [EXCELLENT, EXCELLENT, PASS, FAIL, FAIL]
    assert [at_most("", e, 1.0, 0.0).verdict for e in (0.0, -1.0, 1.1)] == [EXCELLENT, PASS, FAIL]


def test_a_wrong_spring_constant_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows measure the program: with springs 1 % too stiff the law of a spring does not hold."""
    monkeypatch.setattr(
        "taichi_cloth.simulation.builder.spring_stiffness", lambda *arguments: 1.01 * spring_stiffness(*arguments)
    )
    assert measure(BY_NUMBER["A2.2"], "explicit")[0].verdict == FAIL


def test_a_wrong_spring_constant_changes_the_damping(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "taichi_cloth.simulation.builder.spring_stiffness", lambda *arguments: 1.01 * spring_stiffness(*arguments)
    )
    rows = [swing.numerical_damping("xpbd", "", 1000.0, substeps) for substeps in (4, 16)]
    assert [row.verdict for row in rows] == [FAIL, FAIL]


def test_a_wrong_coefficient_or_sag_falls_short(monkeypatch: pytest.MonkeyPatch) -> None:
    threads = hanging.threads("xpbd", 32)
    assert [hanging.stretch_row("", threads, c).verdict for c in (0.5, 0.54, 0.46)] == [EXCELLENT, FAIL, FAIL]
    assert hanging.discrete_sag("", "explicit", 32).verdict == EXCELLENT
    constant = hanging.strip_constant
    monkeypatch.setattr(hanging, "strip_constant", lambda simulation: 0.05 * constant(simulation))
    row = hanging.discrete_sag("", "explicit", 32)
    assert row.verdict == FAIL
    assert row.limit is None


def test_too_few_iterations_to_carry_a_force_to_the_pin_fall_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strand, "SWEEPS", ((1, 6e-2),))
    assert [result.verdict for result in measure(BY_NUMBER["B5"], "xpbd")] == [FAIL]


def test_references_are_selected_by_number_and_solver() -> None:
    assert {reference.number for reference, _ in references.select_pairs("A2", None)} == {
        f"A2.{k}" for k in range(1, 9)
    }
    assert references.select_pairs("B3", "lines") == [(BY_NUMBER["B3"], "lines")]
    with pytest.raises(UsageError, match=r"no reference 'Z9' with rk4; choose from A1\.1, "):
        references.select_pairs("Z9", "rk4")


def results() -> list[Result]:
    """Return results of `xpbd`, whose last row is worse than its law, and of `rk4`, whose last row is within it."""
    rows = [relative("distance [m]", 1.0, measured, 0.1, 0.01) for measured in (1.0, 1.05, 2.0)]
    law = {"xpbd": 0.5, "rk4": 0.95}
    found = [
        Result("A0", "test", "nobody", solver, row.by_law("x²", law[solver]) if row.verdict == FAIL else row)
        for solver in law
        for row in rows
    ]
    slow = Check("wait [s]", nan, nan, nan, 0.1, 0.01, seconds=20.4)
    return [*found, Result("A0", "test", "nobody", "rk4", slow), Result("A9", "other", "nobody", "rk4", rows[-1])]


LAST = (
    "8 rows: 2 excellent, 2 pass, 3 fall short (1 by no more than theory allows, 0 within a law over 3 times as wide,"
    " 0 by no more than the same iterations in float64, 1 by more, 1 without a theory), 1 too slow"
)


def test_the_reasons_and_the_summary_line() -> None:
    found = results()
    assert [result.row.broken for result in found] == [False, False, True] + 5 * [False]
    assert report.reasons(found) == [
        "A0 test falls short with xpbd: more than its law explains",
        "A0 test falls short with rk4: x²",
        "A0 test is too slow with rk4: a setup was stopped at its time limit",
        "A9 other falls short with rk4: no law explains it",
    ]
    assert report.summary_line(found) == LAST
    law = f"{SAME_ITERATIONS} end there"
    repeated = [replace(one, row=one.row.by_law(law, 0.95)) if one.verdict == FAIL else one for one in found[3:]]
    assert "wide, 2 by no more than the same iterations" in report.summary_line(repeated)
    wide = [replace(one, row=one.row.by_law("x²", 3.1 * one.row.error)) for one in found[3:] if one.verdict == FAIL]
    near = [replace(one, row=one.row.by_law("x²", 2.9 * one.row.error)) for one in found[3:] if one.verdict == FAIL]
    assert "(0 by no more than theory allows, 2 within a law" in report.summary_line(wide)
    assert "(2 by no more than theory allows, 0 within a law" in report.summary_line(near)
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


@pytest.mark.parametrize(("bound", "wide"), [(2.9, False), (3.1, True)])
def test_the_page_names_laws_that_allow_far_more_than_the_error(bound: float, wide: bool) -> None:
    row = relative("distance [m]", 1.0, 2.0, 0.1, 0.01)
    found = [Result("A0", "test", "nobody", "rk4", row.by_law("x²", bound, 0.0)), *results()]
    line = "Laws that allow more than 3 times the error (1 row): A0 with rk4 (3.1 times)."
    assert report.wide_bounds(found) == ([line, ""] if wide else [])
    assert (line in report.main_page(report.Measured({"cpu": "one"}, found), "rows.md")) == wide


def test_the_largest_error_is_shown_with_the_worst_verdict() -> None:
    """A row with a tight bound falls short by a small error, and another passes with a larger one."""
    rows = {
        "xpbd": [at_most("", 1e-4, 1e-6, 0.0), at_most("", 0.5, 1.0, 0.0)],
        "rk4": [at_most("", 2e-4, 1.0, 0.0), at_most("", 0.1, 1.0, 0.2)],
        "lines": [at_most("", 0.3, 1.0, 0.0), Check("", nan, nan, nan, 0.1, 0.01, seconds=20.4)],
        "verlet": [Check("", nan, nan, nan, 0.1, 0.01, seconds=20.4)],
        "explicit": [at_most("", 0.3, 1.0, 0.0), at_most("", nan, 1.0, 0.0)],
    }
    found = [Result("A0", "test", "nobody", solver, row) for solver, some in rows.items() for row in some]
    cells = ["**5.0e-01**", "1.0e-01", "**3.0e-01, too slow**", "**too slow**", "**not finite**"]
    assert report.matrix(found) == [["reference", *rows], ["A0 test", *cells]]


def test_the_pages_are_made_from_the_rows(tmp_path: Path) -> None:
    run = report.this_machine(results)
    text = "\n".join([*report.main_page(run, "rows.md"), *report.rows_page(run, "main.md")])
    assert f"# Validation\n\n{LAST}. [rows.md](rows.md) has them all.\n" in text
    assert "\n50.0 % pass (goal: 90 %), 25.0 % are excellent (goal: 60 %).\n" in text
    assert "Of the 3 pairs of a reference and a solver, 0 pass in every row." in text
    assert "| xpbd | 3 | 1 | 1 | 1 | 0 | 66.7 % | 33.3 % |" in text
    assert "| A0 test | **1.0e+00** | **1.0e+00** |\n| A9 other |  | **1.0e+00** |\n" in text
    assert "| A0 test | rk4 | wait [s] | - | - | - | too slow: over 20 s | 0.1 | 0.01 | nobody |" in text
    report.write_json(tmp_path / "o.json", run)
    read = report.read_json(tmp_path / "o.json")
    assert read.date == run.date
    assert read.commit == run.commit
    assert "\n".join([*report.main_page(read, "rows.md"), *report.rows_page(read, "main.md")]) == text
    assert [result.row.broken for result in read.results] == [result.row.broken for result in run.results]
    everything = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))
    assert everything["summary"]["all"]["pass or excellent [%]"] == 50.0
    assert [row["reason"] for row in everything["rows"]][2:5] == ["more than its law explains", "", ""]
    assert everything["rows"][1]["error"] == pytest.approx(0.05)
    assert everything["rows"][1]["pass"] == 0.1
    assert everything["rows"][6]["error"] is None


def test_a_run_names_the_commit_of_the_program(tmp_path: Path) -> None:
    assert commit_of(tmp_path) == version("taichi-cloth")  # not a clone
    for words in (
        ["init", "-q"],
        ["-c", "user.name=a", "-c", "user.email=a", "commit", "-q", "--allow-empty", "-m", "a"],
    ):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    head = subprocess.run(["git", "-C", str(tmp_path), "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    assert commit_of(tmp_path) == head.stdout.strip()
    (tmp_path / "within").mkdir()
    assert commit_of(tmp_path / "within") == version("taichi-cloth")  # installed inside another clone


def test_pairs_run_in_worker_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(references, "CORES", 2)
    pairs = [(BY_NUMBER["A2.2"], "explicit"), (BY_NUMBER["A2.2"], "rk4")]
    steps: list[str] = []
    found = references.measure_all(pairs, steps.append)
    assert [(result.number, result.solver, result.verdict) for result in found] == [
        *5 * [("A2.2", "explicit", EXCELLENT)],
        *5 * [("A2.2", "rk4", EXCELLENT)],
    ]
    assert sorted(steps) == ["A2.2 one spring, explicit", "A2.2 one spring, rk4"]


def test_the_command_prints_writes_and_reads_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["validate", "--filter", "A2.2", "--solver", "explicit", "--json", "o.json", "--markdown", "o.md"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "A2.2 one spring" in out
    assert out.rstrip().endswith(
        "5 rows: 5 excellent, 0 pass, 0 fall short (0 by no more than theory allows, 0 within a law over 3 times as"
        " wide, 0 by no more than the same iterations in float64, 0 by more, 0 without a theory), 0 too slow"
    )
    assert main(words) == 2
    assert "o.json already exists; use --force" in capsys.readouterr().err
    assert main(["validate", "--from", "o.json", "--markdown", "again.md"]) == 0
    assert Path("again.md").read_bytes() == Path("o.md").read_bytes().replace(b"o_rows.md", b"again_rows.md")
    assert "| A2.2 one spring | explicit |" in Path("again_rows.md").read_text(encoding="utf-8")
    Path("mine_rows.md").write_text("mine", encoding="utf-8")
    assert main(["validate", "--from", "o.json", "--markdown", "mine.md"]) == 2
    assert "mine_rows.md already exists; use --force" in capsys.readouterr().err
    assert Path("mine_rows.md").read_text(encoding="utf-8") == "mine"
    short = Check("", 1.0, 2.0, 1.0, 0.1, 0.01)
    for row, status in ((short, 1), (short.by_law("x²", 0.5), 1), (short.by_law("x²", 0.95), 0)):
        broken = replace(BY_NUMBER["A2.2"], run=lambda solver, row=row: iter([row]))
        monkeypatch.setattr(references, "REFERENCES", (broken,))
        assert main(["validate", "--solver", "explicit"]) == status
    assert "falls short with explicit: x²" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", "[]", '{"machine": {}, "rows": [{}]}'])
def test_another_file_is_refused_in_one_line(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "o.json"
    path.write_text(text, encoding="utf-8")
    assert main(["validate", "--from", str(path)]) == 2
    err = capsys.readouterr().err
    assert "was not written by `validate --json`" in err
    assert err.count("\n") == 1
    assert main(["validate", "--from", str(tmp_path / "none.json")]) == 2
    assert "No such file" in capsys.readouterr().err
    assert main(["validate", "--from", str(path), "--filter", "A1"]) == 2
    assert "it cannot be combined with --filter or --solver" in capsys.readouterr().err


def test_an_unknown_reference_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", "--filter", "A10"]) == 2
    assert capsys.readouterr().err.startswith("taichi-cloth: no reference 'A10'; choose from A1.1, A1.2")


def test_a_fall_with_all_features_judges_drop_and_strain() -> None:
    rows = list(BY_NUMBER["A1.2"].run("verlet"))
    assert [(row.what.partition(" after")[0], row.tolerance, row.tight_tolerance) for row in rows] == [
        ("drop", 1e-3, 1e-5),
        ("strain", 1e-4, 1e-6),
    ]
    assert [row.verdict for row in rows] == [PASS, PASS]
