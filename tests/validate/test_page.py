"""The pages of the documentation about validation, compared with the stored run."""

from pathlib import Path

import pytest

from taichi_cloth.evaluation.validate import references
from taichi_cloth.evaluation.validate import validation_report as report

TOP = Path(__file__).parents[2]
RESULTS = TOP / "benchmarks" / "results"


@pytest.fixture(scope="module")
def run() -> report.Measured:
    return report.read_json(RESULTS / "validation.json")


def test_the_pages_match_the_stored_run(run: report.Measured, tmp_path: Path) -> None:
    report.write_pages(tmp_path / "validation.md", run)
    for name in ("validation.md", "validation_rows.md"):
        assert (TOP / "docs" / name).read_text(encoding="utf-8") == (tmp_path / name).read_text(encoding="utf-8")


def test_the_run_has_every_reference_with_every_solver(run: report.Measured) -> None:
    pairs = [(reference.number, solver) for reference, solver in references.select_pairs(None, None)]
    assert list(dict.fromkeys((result.number, result.solver) for result in run.results)) == pairs
    names = {reference.number: (reference.name, reference.source) for reference in references.REFERENCES}
    assert {(result.number, result.name, result.source) for result in run.results} == {
        (number, *rest) for number, rest in names.items()
    }


def test_nothing_in_the_run_is_worse_than_its_law(run: report.Measured) -> None:
    assert [result for result in run.results if result.row.broken] == []


def test_fitted_rows_are_counted_apart(run: report.Measured) -> None:
    drape = [one for one in run.results if one.number == "A4.6"]
    others = [one for one in run.results if one.number == "A1.1"]
    excellent = sum(one.verdict == "excellent" for one in others)
    [line, empty] = report.fitted_lines([*drape, *others])
    assert f"its {len(drape)} rows" in line
    assert f"{100 * excellent / len(others):.1f} % are excellent" in line
    assert empty == ""
    assert report.fitted_lines(drape) == report.fitted_lines(others) == []


def test_the_text_on_the_strip_on_five_meshes_is_that_of_the_run(run: report.Measured) -> None:
    short = {one.row.what for one in run.results if one.number == "A9.7" and one.verdict == "falls short"}
    assert short == {"8 cells: ω2 [rad/s]"}
    text = " ".join((TOP / "docs" / "accuracy.md").read_text(encoding="utf-8").split())
    assert "Only the second frequency on 8 cells falls short" in text
