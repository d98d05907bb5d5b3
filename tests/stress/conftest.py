"""Small cases that need few kernels, and results that are made by hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from taichi_cloth.evaluation.stress.invariants import Violation
from taichi_cloth.evaluation.stress.setup import Setting, sheet
from taichi_cloth.evaluation.stress.trial import Trial, close
from taichi_cloth.evaluation.stress.unit import Case, Failure, Result, Unit, Variant
from taichi_cloth.scene.schema import Forces, Solver

SMALL = Setting("xpbd", Solver("xpbd", 10, 2, damping=0.0))


@pytest.fixture(autouse=True)
def closed_simulation() -> Iterator[None]:
    yield
    close()


def swings(trial: Trial) -> None:
    """Run six frames, and record a number that depends on the seed."""
    trial.open(sheet(8), rest_strain=0.1)
    trial.start()
    trial.run(0.1)
    trial.skip_rest_check("a test")
    trial.record("distance [m]", float(trial.simulation.positions()[40, 2]))


def moves_late(trial: Trial) -> None:
    """Fall so slowly that the cloth counts as at rest after five seconds, and no longer soon after."""
    trial.open(sheet(4, pins=(), damping=0.0, forces=Forces(gravity=0.0195)))  # 0.0975 m/s after 5 s
    trial.start(shake=0.0)
    trial.settle()


def breaks(trial: Trial) -> None:
    swings(trial)
    raise Violation("something", 2.0, 1.0)


def breaks_once(trial: Trial) -> None:
    swings(trial)
    if trial.seed % 3 == 0:
        raise Violation("something", 2.0, 1.0)


def raises_an_error(trial: Trial) -> None:
    raise ZeroDivisionError("of a case")


CASE = Case(1, "test", "nothing", (Variant("swings", swings), Variant("breaks", breaks)), note="it is a test")
SWINGS, BREAKS = (Unit(CASE, variant, SMALL) for variant in CASE.variants)


def result(case: int = 1, variant: str = "a", setting: str = "xpbd", **found: Any) -> Result:
    values: dict[str, Any] = {"starts": 10, "ran": 10, "origin": "abc", "date": "2026-01-02 03:04"}
    return Result(case, "test", "nothing", "", variant, setting, **(values | found))


def failed(value: float = 2.0, what: str = "something", **found: Any) -> Result:
    return result(failure=Failure(0, 17, 6, what, value, 1.0), ran=1, **found)
