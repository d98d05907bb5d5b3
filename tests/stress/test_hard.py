"""Short forms of hard variants on a coarse sheet, one start each: the claim itself is what `make stress` runs."""

import pytest
from walks import CELLS, ROWS

from taichi_cloth.stress.catalogue import CASES
from taichi_cloth.stress.setting import SETTINGS
from taichi_cloth.stress.unit import Unit, run_unit

HARD = (
    (1, "1e9 N/m"),
    (2, "1e6"),
    (9, "one point"),
    (10, "mirrored"),
    (11, "uniform"),
    (12, "0.1 m"),
    (13, "columns"),
    (37, "1e6"),
)
USUAL = ((2, "1e6"), (10, "mirrored"), (12, "0.1 m"), (13, "columns"))


def state(monkeypatch: pytest.MonkeyPatch, number: int, name: str, setting: str) -> object:
    for module in ROWS:
        if hasattr(module, "CELLS"):
            monkeypatch.setattr(module, "CELLS", CELLS)
    case = CASES[number - 1]
    [variant] = [one for one in case.variants if one.name == name]
    unit = Unit(case, variant, SETTINGS[setting])
    result = run_unit(unit, unit.starts(1), None)
    return result.failure or result.state


@pytest.mark.parametrize("setting", ["robust", "robust-slack"])
@pytest.mark.parametrize(("number", "name"), HARD)
def test_the_robust_settings_are_alive(monkeypatch: pytest.MonkeyPatch, number: int, name: str, setting: str) -> None:
    assert state(monkeypatch, number, name, setting) == "alive"


@pytest.mark.parametrize(("number", "name"), USUAL)
def test_xpbd_at_its_usual_sweeps_is_alive(monkeypatch: pytest.MonkeyPatch, number: int, name: str) -> None:
    assert state(monkeypatch, number, name, "xpbd") == "alive"


@pytest.mark.parametrize("setting", ["verlet", "spring", "rk4", "lines", "projective"])
def test_an_ordinary_sheet_is_alive_with_every_method(monkeypatch: pytest.MonkeyPatch, setting: str) -> None:
    assert state(monkeypatch, 5, "1/144 and 1/20 s", setting) == "alive"
