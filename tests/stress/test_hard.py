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
    (10, "mirrored"): {"explicit", "rk4", "implicit"},
    (11, "uniform"): {"explicit", "lines", "rk4", "implicit"},
    (12, "0.1 m"): {"explicit", "rk4", "implicit"},
    (13, "columns"): {"explicit", "lines", "rk4", "implicit"},
    (19, "100 m/s"): {"explicit", "lines", "rk4", "implicit", "robust-slack"},
    (23, "0, then 10 cm"): {"explicit", "lines", "rk4", "implicit"},
    (29, "10 m"): {"verlet", "xpbd", "explicit", "lines", "rk4", "implicit", "robust"},
    (38, "0.1 %"): {"verlet", "xpbd", "explicit", "lines", "rk4", "implicit"},
}
TOO_SLOW = {(1, "rk4"), (2, "rk4")}  # thousands of substeps per frame
# Variants that run with `robust` only, which is alive.
ROBUST_ONLY = [
    (5, "1/144 and 1/20 s"),
    (8, "past each other"),
    (17, "100 m/s"),
    (18, "against triangles"),
    (20, "1 m"),
    (21, "teleported"),
    (24, "doubled points"),
    (26, "sign flips"),
    (27, "100 m/s"),
    (28, "crossing zero"),
    (31, "k ×1e3"),
    (31, "ball toggled"),
    (33, "1000 m"),
    (34, "toggled"),
    (35, "μ = 10, 30°"),
    (35, "μ = 0, 89°"),
    (37, "damping time 1 s"),
    (39, "1 m/s, 5×5"),
]
EVERY = [
    (key, setting, setting not in dead)
    for key, dead in HARD.items()
    for setting in SETTINGS
    if (key[0], setting) not in TOO_SLOW
]
EVERY += [(key, "robust", True) for key in ROBUST_ONLY]


@pytest.mark.parametrize(
    ("key", "setting", "alive"), EVERY, ids=[f"{number}-{name}-{setting}" for (number, name), setting, _ in EVERY]
)
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
