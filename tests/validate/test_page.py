"""The pages of documents about validation, beside the run that they are made from."""

from pathlib import Path

import pytest

from taichi_cloth.validate import catalogue, page, report

TOP = Path(__file__).parents[2]
RESULTS = TOP / "benchmarks" / "results"


@pytest.fixture(scope="module")
def run() -> report.Measured:
    return report.read_json(RESULTS / "validation.json")


def test_the_pages_are_the_run(run: report.Measured, tmp_path: Path) -> None:
    page.write_pages(tmp_path / "validation.md", run)
    for name in ("validation.md", "validation_rows.md"):
        assert (TOP / "docs" / name).read_text(encoding="utf-8") == (tmp_path / name).read_text(encoding="utf-8")


def test_the_run_has_every_reference_with_every_solver(run: report.Measured) -> None:
    pairs = [(reference.number, solver) for reference, solver in catalogue.chosen(None, None)]
    assert list(dict.fromkeys((result.number, result.solver) for result in run.results)) == pairs
    names = {reference.number: (reference.name, reference.source) for reference in catalogue.REFERENCES}
    assert {(result.number, result.name, result.source) for result in run.results} == {
        (number, *rest) for number, rest in names.items()
    }


def test_nothing_in_the_run_is_worse_than_its_law(run: report.Measured) -> None:
    assert [result for result in run.results if result.row.broken] == []
