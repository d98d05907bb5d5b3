"""Short forms of hard variants on a coarse sheet, one start each: the claim itself is what `make stress` runs."""

from math import inf

import pytest
from walks import few_cells

from taichi_cloth.stress import trial
from taichi_cloth.stress.catalogue import CASES
from taichi_cloth.stress.setting import SETTINGS
from taichi_cloth.stress.unit import ALIVE, Unit, run_unit

# Which settings are not alive on so coarse a sheet.
HARD: dict[tuple[int, str], set[str]] = {
    (1, "1e9 N/m"): {"spring"},
    (2, "1e6"): {"verlet", "spring", "projective"},
    (3, "×10000"): set(),
    (5, "1/144 and 1/20 s"): set(),
    (9, "one point"): {"verlet", "spring", "lines", "rk4"},
    (10, "mirrored"): {"spring", "rk4"},
    (11, "uniform"): {"spring", "lines", "rk4"},
    (12, "0.1 m"): {"spring", "lines", "rk4"},
    (13, "columns"): {"spring", "rk4"},
    (23, "0, then 10 cm"): {"spring", "lines", "rk4"},
    (37, "1e6"): set(),
}
TOO_SLOW = {(1, "rk4"), (2, "rk4")}  # thousands of substeps a frame
EVERY = [
    pytest.param(key, setting, setting not in dead, id=f"{key[0]}-{key[1]}-{setting}")
    for key, dead in HARD.items()
    for setting in SETTINGS
    if (key[0], setting) not in TOO_SLOW
]


@pytest.mark.parametrize(("key", "setting", "alive"), EVERY)
def test_a_hard_variant(monkeypatch: pytest.MonkeyPatch, key: tuple[int, str], setting: str, alive: bool) -> None:
    """Alive; or beyond a bound of the case, and neither an error nor a number that is none."""
    few_cells(monkeypatch)
    monkeypatch.setattr(trial, "SLOW_MS", inf)  # no test depends on how fast a machine is
    number, name = key
    case = CASES[number - 1]
    [variant] = [one for one in case.variants if one.name == name]
    unit = Unit(case, variant, SETTINGS[setting])
    result = run_unit(unit, unit.starts(1), None)
    if alive:
        assert (result.failure or result.state) == ALIVE
    else:
        assert result.failure is not None
        assert any(word in result.failure.what for word in ("energy", "strain", "speed"))
