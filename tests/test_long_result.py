"""The stored result of `make long` has no failures, and how it is made from a report."""

from __future__ import annotations

import importlib.util
import tomllib
from datetime import date
from pathlib import Path

import pytest
from result_file import written

HERE = Path(__file__).parent
REPORT = """<?xml version="1.0" encoding="utf-8"?>
<testsuites><testsuite name="pytest" errors="0" failures="1" skipped="1" tests="4" time="12.6"
  timestamp="2026-03-01T10:20:30.5">
<testcase classname="tests.test_a" name="test_one" time="1.25" />
<testcase classname="tests.test_b" name="test_two[x]" time="7.5"><failure message="no">1 == 2</failure></testcase>
<testcase classname="tests.test_b" name="test_three" time="0.5" />
<testcase classname="tests.test_b" name="test_four" time="0.0"><skipped message="not here" /></testcase>
</testsuite></testsuites>
"""


@pytest.fixture(autouse=True, scope="module")
def taichi() -> None:
    """No test here needs Taichi."""


def test_the_last_run_is_stored_and_has_no_failures() -> None:
    file = HERE / "long_result.toml"
    if not file.exists():
        pytest.skip("`make long`, which writes tests/long_result.toml, has not been completed yet")
    kept = tomllib.loads(file.read_text(encoding="utf-8"))
    result = kept["result"]
    assert result["failed"] == []
    assert result["passed"] > 0
    assert result["seconds"] > 0
    assert date.fromisoformat(result["date"]) > date(2026, 1, 1)
    assert result["commit"]
    assert kept["machine"]["processor"]
    assert all((HERE.parent / Path(*name.split(".")).with_suffix(".py")).exists() for name in kept["seconds"])


def test_a_report_is_reduced_to_counts_and_seconds_by_file() -> None:
    spec = importlib.util.spec_from_file_location("long_result", HERE / "long_result.py")
    assert spec is not None
    assert spec.loader is not None
    long_result = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(long_result)
    tables = long_result.reduced(REPORT)
    read = tomllib.loads(written(long_result.TITLE, tables))
    assert read == tables
    assert read["result"] == {
        "date": "2026-03-01",
        "passed": 2,
        "skipped": 1,
        "failed": ["tests.test_b::test_two[x]"],
        "seconds": 13,
    }
    assert list(read["seconds"].items()) == [("tests.test_b", 8), ("tests.test_a", 1)]
