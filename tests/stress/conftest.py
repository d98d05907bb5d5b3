"""Small cases that need few kernels, and results that nobody ran."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from taichi_cloth.scene.model import Solver
from taichi_cloth.stress.case import Case, Variant
from taichi_cloth.stress.scenes import sheet
from taichi_cloth.stress.setting import Setting
from taichi_cloth.stress.trial import Trial, close
from taichi_cloth.stress.unit import Failure, Result, Unit
from taichi_cloth.stress.watch import Broken

SMALL = Setting("xpbd", Solver("xpbd", 10, 2, damping=0.0))


@pytest.fixture(autouse=True)
def given_back() -> Iterator[None]:
    yield
    close()


def swings(trial: Trial) -> None:
    """Six frames, and a number that depends on the seed."""
    trial.open(sheet(8), rest_strain=0.1)
    trial.start()
    trial.run(0.1)
    trial.only_frames("a test")
    trial.tell("way [m]", float(trial.simulation.positions()[40, 2]))


def breaks(trial: Trial) -> None:
    swings(trial)
    raise Broken("something", 2.0, 1.0)


def breaks_once(trial: Trial) -> None:
    swings(trial)
    if trial.seed % 3 == 0:
        raise Broken("something", 2.0, 1.0)


def goes_wrong(trial: Trial) -> None:
    raise ZeroDivisionError("of a case")


CASE = Case(1, "test", "nothing", (Variant("swings", swings), Variant("breaks", breaks)), note="it is a test")
SWINGS, BREAKS = (Unit(CASE, variant, SMALL) for variant in CASE.variants)


def result(case: int = 1, variant: str = "a", setting: str = "xpbd", **found: object) -> Result:
    values: dict[str, object] = {"starts": 10, "ran": 10, "origin": "abc", "date": "2026-01-02 03:04"}
    return Result(case, "test", "nothing", "", variant, setting, **(values | found))  # type: ignore[arg-type]


def failed(value: float = 2.0, what: str = "something", **found: object) -> Result:
    return result(failure=Failure(0, 17, 6, what, value, 1.0), ran=1, **found)
