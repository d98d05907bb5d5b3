"""The result of `make mutants` as a small file next to the tests: `tests/mutants_result.toml`. A test reads it."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

from mutation import ROOT
from mutations import digest

from taichi_cloth.system.taichi_runtime import cpu_model, machine

FILE = ROOT / "tests" / "mutants_result.toml"
TITLE = "# Written by `make mutants`: its last result for the complete table."
KILLED, SURVIVED, BROKEN = "killed", "SURVIVED", "BROKEN"


def reduced(verdicts: Mapping[str, str], commit: str, seconds: float) -> dict[str, dict[str, Any]]:
    """Return the counts, and the names of mutations that survived or could not be tried, from the verdicts by name.

    `commit` is the tested commit, `seconds` the duration of the run. The digest of the table tells a result of another
    table, even of as many mutations.
    """
    named = {verdict: [name for name, found in verdicts.items() if found == verdict] for verdict in (SURVIVED, BROKEN)}
    result = {
        "date": date.today().isoformat(),
        "commit": commit,
        "table": digest(),
        "mutations": len(verdicts),
        "killed": sum(verdict == KILLED for verdict in verdicts.values()),
        "survived": named[SURVIVED],
        "broken": named[BROKEN],
        "seconds": round(seconds),
    }
    return {"result": result, "machine": {**machine(), "processor": cpu_model()}}


def retried(
    stored: Mapping[str, Mapping[str, Any]], verdicts: Mapping[str, str], commit: str
) -> dict[str, dict[str, Any]] | None:
    """Return a stored result in which mutations that survived or were broken are killed now; None if nothing changes.

    `retried` names them, with the commit that was tested. A result of another table cannot change.
    """
    result = dict(stored["result"])
    failed = {*result["survived"], *result["broken"]}
    killed = [name for name, verdict in verdicts.items() if verdict == KILLED and name in failed]
    if not killed or result["table"] != digest():
        return None
    for verdict in ("survived", "broken"):
        result[verdict] = [name for name in result[verdict] if name not in killed]
    result["killed"] += len(killed)
    result["retried"] = [*result.get("retried", []), *(f"{name}: {commit}" for name in killed)]
    return {"result": result, "machine": dict(stored["machine"])}
