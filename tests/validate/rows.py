"""Compares rows of two runs of `validate`."""

from __future__ import annotations

import re
from collections.abc import Sequence

from taichi_cloth.evaluation.validate.check import EXCELLENT, FAIL, PASS, TOO_SLOW, Result

Row = tuple[str, str, str]  # reference, solver, name


def name_of(result: Result) -> str:
    """Return the name of a row, without what was measured or when an error was largest."""
    return re.sub(r" \(.*% lost\)| at frame \d+| after [\d.]+ s$", "", result.row.what)


def key_of(result: Result) -> Row:
    return result.number, result.solver, name_of(result)


def worse(found: Sequence[Result], stored: Sequence[Result]) -> list[str]:
    """Return the rows that are worse than their law, that are not in the stored run, or that passed there only."""
    passed = {key_of(one): one.verdict in (EXCELLENT, PASS) for one in stored}
    return [
        one.row.what
        for one in found
        if one.row.broken or passed.get(key_of(one), True) > (one.verdict not in (FAIL, TOO_SLOW))
    ]
