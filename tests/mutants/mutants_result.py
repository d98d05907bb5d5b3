"""What `make mutants` found, as a small file beside the tests: `tests/mutants_result.toml`. A test reads it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

from mutation import ROOT

from taichi_cloth.machine import cpu_model, machine

FILE = ROOT / "tests" / "mutants_result.toml"
TITLE = "# Written by `make mutants`: its last result over the whole table."
KILLED, SURVIVED, BROKEN = "killed", "SURVIVED", "BROKEN"


def reduced(verdicts: Mapping[str, str], of: str, seconds: float) -> dict[str, dict[str, Any]]:
    """Counts, and names of what no test saw or could not be tried, from what became of each mutation by name.

    `of` is the commit that was tried, `seconds` how long all took.
    """
    named = {verdict: [name for name, found in verdicts.items() if found == verdict] for verdict in (SURVIVED, BROKEN)}
    result = {
        "date": date.today().isoformat(),
        "commit": of,
        "mutations": len(verdicts),
        "killed": sum(verdict == KILLED for verdict in verdicts.values()),
        "survived": named[SURVIVED],
        "broken": named[BROKEN],
        "seconds": round(seconds),
    }
    return {"result": result, "machine": {**machine(), "processor": cpu_model()}}
