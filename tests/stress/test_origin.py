"""A result is run again where what it depends on has changed, and nowhere else."""

import shutil
from pathlib import Path

import pytest

from taichi_cloth.stress import origin as module
from taichi_cloth.stress.choose import chosen
from taichi_cloth.stress.origin import origin
from taichi_cloth.stress.unit import Unit


def unit(case: int, setting: str, variant: str | None = None) -> Unit:
    return chosen(str(case), variant, setting)[0]


YANK, SLOPE, METHOD = unit(29, "lines"), unit(35, "spring"), unit(31, "verlet", "method")
ALL = {"yank": YANK, "slope": SLOPE, "method": METHOD}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the program that may be changed."""
    copy = tmp_path / "taichi_cloth"
    shutil.copytree(module.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(module, "PACKAGE", copy)
    return copy


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("simulation.py", {"yank", "slope", "method"}),
        ("kernels/springs.py", {"yank", "slope", "method"}),
        ("reference/rest.py", {"yank", "slope", "method"}),
        ("stress/watch.py", {"yank", "slope", "method"}),
        ("stress/rest.py", {"yank", "slope", "method"}),  # trial.py takes it
        ("stress/loads.py", {"yank"}),
        ("stress/friction.py", {"slope"}),
        ("stress/shots.py", {"slope", "method"}),  # its margin
        ("solvers/lines.py", {"yank", "method"}),
        ("solvers/spring.py", {"slope", "method"}),
        ("solvers/base.py", {"yank", "slope", "method"}),
        ("solvers/__init__.py", {"yank", "slope", "method"}),
        ("kernels/chains.py", {"yank", "method"}),  # only `lines` has it
        ("kernels/conjugate.py", {"method"}),  # only `projective`
        ("stress/page.py", set()),
        ("stress/causes.py", set()),
        ("stress/catalogue.py", set()),
        ("web/hub.py", set()),
        ("validate/swing.py", set()),
    ],
)
def test_which_results_a_changed_file_is_about(package: Path, name: str, others: set[str]) -> None:
    module.sources.cache_clear()
    before = {key: origin(one) for key, one in ALL.items()}
    path = package / name
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    module.sources.cache_clear()
    assert {key: origin(one) for key, one in ALL.items()} == before
    path.write_bytes(path.read_bytes() + b"\n# more\n")
    module.sources.cache_clear()
    assert {key for key, one in ALL.items() if origin(one) != before[key]} == others
    module.sources.cache_clear()


def test_no_two_units_are_alike() -> None:
    units = chosen()
    assert len({origin(one) for one in units}) == len(units)


def test_a_number_of_a_variant_counts() -> None:
    assert list(module.called(YANK.variant.run)) == [
        "taichi_cloth.stress.case._with_value",
        "taichi_cloth.stress.loads.yank",
        "10.0",
    ]
