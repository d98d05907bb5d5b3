"""Tables and pages from stored results. A cause explains its own bound, up to its value."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from taichi_cloth.evaluation.stress import stress_report as report
from taichi_cloth.evaluation.stress.causes import EXPERIMENTS, Cause
from taichi_cloth.evaluation.stress.store import Store
from taichi_cloth.evaluation.stress.trial import Measurement
from taichi_cloth.evaluation.stress.unit import Result

from .conftest import failed, result


def store_of(*results: Result, missing: int = 0) -> Store:
    planned = [one.key for one in results] + [(9, f"missing {k}", "xpbd") for k in range(missing)]
    return Store(None, planned, {one.key: one for one in results}, "a machine")


def slow(**found: Any) -> Result:
    return result(slow_ms=250.0, ran=1, **found)


def test_the_state_of_a_case() -> None:
    some = store_of(
        result(1, "a"),
        result(1, "b"),
        result(2, "a"),
        slow(case=2, variant="b"),
        slow(case=3, variant="a"),
        failed(case=3, variant="b"),
        missing=1,
    )
    cells = report.cells_of(some)
    assert [cell.state for cell in cells.values()] == ["alive", "too slow", "failed", "not run"]
    assert [cell.shown() for cell in cells.values()] == ["2/2", "1/2 too slow", "**0/2**", "0/1 not run"]
    assert report.count_line(cells) == "xpbd 1 alive, 1 failed, 1 too slow, 1 not run"


def test_a_partly_run_case_is_not_alive() -> None:
    some = store_of(result(9, "a"), missing=1)
    assert report.count_line(report.cells_of(some)) == "xpbd 0 alive, 0 failed, 0 too slow, 1 not run"


def test_the_cells_of_a_row() -> None:
    one = replace(
        result(energy=0.5, strain=0.25, speed=1.5, penetration=0.002, frames=7, ms=1.234),
        figures=[
            Measurement("distance [m]", 3.0, 4.0),
            Measurement("strain 5 s after", 0.02, 0.03),  # has a column
            Measurement("speed 5 s after [m/s]", 0.05, 0.1),
            Measurement("sag", 0.1, None),
        ],
        notes=["a note"],
    )
    assert report.row(one) == (
        *("1 test", "a", "xpbd", "alive", "10 of 10", "+50.0%", "0.25", "0.02 (≤ 0.03)", "1.5", "2"),
        *("7", "1.23"),
        "distance [m] 3 (≤ 4); sag 0.1; a note",
    )
    assert report.row(slow())[11] == "250.00"


def test_a_failure_line_says_how_to_repeat_it() -> None:
    assert report.failure_line(failed(picture="p.png"), "unexplained") == (
        "1 test, a, fails with xpbd: something 2, bound 1, in frame 6 of start 0 (seed 17); unexplained; p.png"
    )
    assert report.slow_line(slow()) == "1 test, a, is too slow with xpbd: 250 ms per frame"


CAUSE = Cause("something", 3.0, "it is made to", origin="abc")


@pytest.mark.parametrize(
    ("one", "why"),
    [
        (failed(2.0), "it is made to"),
        (failed(3.1), ""),  # a worse failure
        (failed(float("nan")), ""),
        (failed(2.0, "another bound"), ""),
        (failed(2.0, variant="c"), ""),
        (failed(2.0, setting="lines"), ""),
        (failed(2.0, case=2), ""),
        (failed(2.0, origin="another program"), ""),
        (result(), ""),
    ],
)
def test_a_cause_explains_only_its_own_failure(one: Result, why: str) -> None:
    some = replace(store_of(one), causes={failed().key: CAUSE})
    assert some.reason(one) == why
    assert (one in some.unexplained([one])) == (one.state == "failed" and not why)


def test_the_pages_have_counts_failures_and_notes(tmp_path: Path) -> None:
    some = store_of(
        replace(result(1, "a", "robust"), about="it is small"),
        failed(2.0, setting="xpbd"),
        failed(5.0, setting="xpbd", variant="b"),
        failed(2.0, setting="robust", case=2),
        slow(setting="xpbd", case=2, variant="b"),
        slow(setting="robust", case=3),
    )
    some.causes = {(1, "a", "xpbd"): CAUSE, (2, "a", "robust"): Cause("something", 2.0, "", len(EXPERIMENTS), "abc")}
    some.causes[2, "a", "robust"] = replace(some.causes[2, "a", "robust"], seconds=5400.0)
    report.write_pages(tmp_path / "o.md", some)
    text = (tmp_path / "o.md").read_text(encoding="utf-8")
    counted = "failed variants unexplained | failed variants not examined"
    assert f"| setting | cases | alive | failed | too slow | {counted} |" in text
    assert "| `robust` | 3 | 1 | 1 | 1 | 1 | 0 |\n| `xpbd` | 2 | 0 | 1 | 1 | 0 | 1 |" in text
    assert "Looking for the causes of 1 failure took 1.5 more hours; the others were not timed." in text
    assert "With `robust` or" not in text
    assert "| 1 test | nothing | 1/1 | **0/2** |" in text
    line = "- 2 test, a, fails with robust: something 2, bound 1, in frame 6 of start 0 (seed 17); unexplained\n"
    assert line in text
    assert "- 3 test, a, is too slow with robust: 250 ms per frame\n" in text
    assert "fails with xpbd" not in text
    rows = (tmp_path / "o_rows.md").read_text(encoding="utf-8")
    assert rows.count("| 1 test |") == 3
    assert line in rows
    assert (
        "- 1 test, a, fails with xpbd: something 2, bound 1, in frame 6 of start 0 (seed 17); it is made to\n" in rows
    )
    assert "- 1 test, b, fails with xpbd: something 5, bound 1, in frame 6 of start 0 (seed 17); not examined\n" in rows
    assert "- 1 test: it is small." in rows


def test_failures_are_unexplained_only_if_experiments_were_made(capsys: pytest.CaptureFixture[str]) -> None:
    some = store_of(*(failed(variant=name) for name in ("explained", "examined", "left")))
    causes = {"explained": "it is made to", "examined": ""}
    some.causes = {
        (1, name, "xpbd"): Cause("something", 2.0, why, len(EXPERIMENTS), "abc") for name, why in causes.items()
    }
    assert [report.explanation(some, one) for one in some.ordered()] == ["it is made to", "unexplained", "not examined"]
    report.print_report(some, some.ordered())
    out = capsys.readouterr().out
    assert "of 3 failures, 1 unexplained, 1 not examined" in out
    assert "--json FILE --explain looks for causes of failures" in out
    assert "1 again: " not in out
    report.print_report(some, [result(repeated="2026-02-01 00:00")])
    out = capsys.readouterr().out
    assert "1 again: a later version repeated the last start only" in out
    assert "--explain" not in out
    assert len(some.unexplained(some.ordered())) == 2  # both give exit code 1


def test_the_page_of_a_store_without_causes_says_that_nothing_was_examined(tmp_path: Path) -> None:
    report.write_pages(tmp_path / "o.md", store_of(failed(setting="robust")))
    text = (tmp_path / "o.md").read_text(encoding="utf-8")
    assert "; not examined\n" in text
    assert "; unexplained\n" not in text
    assert "and not examined if some have not run." in text.replace("\n", " ")


def test_the_page_counts_the_cases_alive_with_either_recommended_setting(tmp_path: Path) -> None:
    some = store_of(
        *(result(1, name, "robust") for name in ("a", "b")),
        failed(setting="robust", case=2),
        failed(setting="robust", case=3),
        result(2, "a", "robust-slack"),
        failed(setting="robust-slack", case=3),
    )
    report.write_pages(tmp_path / "o.md", some)
    text = (tmp_path / "o.md").read_text(encoding="utf-8")
    assert "| `robust` | 3 | 1 | 2 | 0 | 0 | 2 |\n| `robust-slack` | 2 | 1 | 1 | 0 | 0 | 1 |" in text
    line = "With `robust` or `robust-slack`: 2 of 3 cases alive, 1 of them only with the other material"
    assert f"{line} of `robust-slack`.\n" in text


def test_the_page_names_cases_that_ran_for_less_than_ten_seconds(tmp_path: Path) -> None:
    """A run that failed ended early and does not count, nor does one without frames."""
    some = store_of(
        result(1, "a", "robust", frames=300),
        result(1, "b", "robust", frames=270),
        result(2, "a", "robust", frames=600),
        result(3, "a", "robust", frames=0),
        failed(setting="robust", case=4, frames=200),
        result(5, "a", "robust", frames=599),
    )
    assert report.shorter_runs(some) == "case 1 (4.5 s), case 5 (10 s)"
    report.write_pages(tmp_path / "o.md", some)
    text = (tmp_path / "o.md").read_text(encoding="utf-8")
    assert "Variants that ran to their end in less time: case 1 (4.5 s), case 5 (10 s)." in text
    assert report.shorter_runs(store_of(result(2, "a", "robust", frames=600))) == "none"


def test_no_time_is_shown_if_none_was_measured() -> None:
    results = (result(), result(ms=1.0), result(slow_ms=40.0))
    assert [report.frame_time(one) for one in results] == ["-", "1.00", "40.00"]


def test_the_page_names_dates_hours_starts_and_versions() -> None:
    assert report.origin_lines(store_of(result(seconds=1800.0))) == [
        "10 starts per variant; run 2026-01-02; 0.5 hours of CPU time, 0.2 hours on two cores (goal: 4)."
    ]
    faster = replace(store_of(one := result(seconds=36000.0)), repeat_seconds={one.key: 14400.0})
    assert (
        report.origin_lines(faster)[1] == "At the speed of the starts that confirmed results: 2.0 hours on two cores."
    )
    older = result(2, date="2026-01-01 00:00", starts=1, seconds=1800.0)
    assert report.origin_lines(replace(store_of(result(seconds=1800.0), older, missing=2), older=1)) == [
        "2 of 4 combinations of variant and setting were not run.",
        "1 of 2 results are of earlier versions of the program or of its rules, and the present one has"
        " not confirmed them.",
        "1 to 10 starts per variant; run 2026-01-01 to 2026-01-02; 1.0 hours of CPU time.",
    ]
    again = result(repeated="2026-02-01 00:00")
    assert report.row(again)[4:6] == ("10 of 10, 1 again", report.row(result())[5])
    assert report.origin_lines(store_of(again))[0] == (
        "1 results were confirmed once by a later version than the one that produced them: it repeated the last start"
        " of each bit by bit."
    )
