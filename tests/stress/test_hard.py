"""Hard variants on a coarse sheet, one start each. `make stress` runs them in full."""

from math import inf

import pytest
from walks import few_cells

from taichi_cloth.evaluation.stress import trial
from taichi_cloth.evaluation.stress.case_catalog import CASES
from taichi_cloth.evaluation.stress.setup import SETTINGS
from taichi_cloth.evaluation.stress.unit import ALIVE, Unit, run_unit

# Settings that fail on so coarse a sheet.
HARD: dict[tuple[int, str], set[str]] = {
    (1, "1e9 N/m"): {"explicit", "implicit"},
    (2, "1e6"): {"verlet", "explicit", "implicit"},
    (9, "one point"): {"verlet", "explicit", "lines", "rk4", "implicit"},
    (10, "mirrored"): {"explicit", "lines", "rk4", "implicit"},
    (11, "uniform"): {"explicit", "lines", "rk4", "implicit"},
    (12, "0.1 m"): {"explicit", "lines", "rk4", "implicit"},
    (13, "columns"): {"explicit", "lines", "rk4", "implicit"},
    (19, "100 m/s"): {"explicit", "lines", "rk4", "implicit", "robust-slack"},
    (23, "0, then 10 cm"): {"explicit", "lines", "rk4", "implicit"},
    (29, "10 m"): {"verlet", "xpbd", "explicit", "lines", "rk4", "implicit", "robust"},
    (38, "0.1 %"): {"verlet", "xpbd", "explicit", "lines", "rk4", "implicit"},
}
TOO_SLOW = {(1, "rk4"), (2, "rk4")}  # thousands of substeps per frame
EVERY = [
    pytest.param(key, setting, setting not in dead, id=f"{key[0]}-{key[1]}-{setting}")
    for key, dead in HARD.items()
    for setting in SETTINGS
    if (key[0], setting) not in TOO_SLOW
]


@pytest.mark.parametrize(("key", "setting", "alive"), EVERY)
def test_a_hard_variant_is_alive_or_violates_a_bound(
    monkeypatch: pytest.MonkeyPatch, key: tuple[int, str], setting: str, alive: bool
) -> None:
    """It is alive, or violates a bound of the case: no error is raised, and no number is NaN."""
    few_cells(monkeypatch)
    monkeypatch.setattr(trial, "SLOW_MS", inf)  # the result must not depend on the speed of the machine
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
