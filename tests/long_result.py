"""The result of `make long` as a small file beside the tests: `long_result.toml`.

`python tests/long_result.py REPORT.xml` reduces pytest's JUnit report to it. `test_long_result.py` reads the file.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from collections import defaultdict
from pathlib import Path
from typing import Any

from result_file import commit, written

from taichi_cloth.system.taichi_runtime import cpu_model, machine

FILE = Path(__file__).with_suffix(".toml")
TITLE = "# Written by `make long`: its last result, and how long each file of tests took in one process."


def reduced(report: str) -> dict[str, Any]:
    """Return counts, names of failed tests, date, and seconds by test file, from a JUnit report."""
    suites = ET.fromstring(report)
    suite = suites if suites.tag == "testsuite" else suites[0]
    seconds: dict[str, float] = defaultdict(float)
    failed = []
    for case in suite.iter("testcase"):
        name = case.get("classname", "")
        seconds[name] += float(case.get("time", "0"))
        if case.find("failure") is not None or case.find("error") is not None:
            failed.append(f"{name}::{case.get('name')}")
    total, skipped = int(suite.get("tests", "0")), int(suite.get("skipped", "0"))
    result = {
        "date": suite.get("timestamp", "")[:10],
        "passed": total - skipped - len(failed),
        "skipped": skipped,
        "failed": failed,
        "seconds": round(float(suite.get("time", "0"))),
    }
    slowest = sorted(seconds.items(), key=lambda item: -item[1])
    return {"result": result, "seconds": {name: round(spent) for name, spent in slowest}}


if __name__ == "__main__":
    tables = reduced(Path(sys.argv[1]).read_text(encoding="utf-8"))
    tables["result"]["commit"] = commit()
    tables["machine"] = {**machine(), "processor": cpu_model()}
    FILE.write_text(written(TITLE, tables), encoding="utf-8")
