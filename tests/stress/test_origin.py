"""A result is repeated if a file that it depends on has changed, and only then."""

import shutil
from pathlib import Path

import pytest

from taichi_cloth.evaluation.stress import store as module
from taichi_cloth.evaluation.stress.runner import select_units
from taichi_cloth.evaluation.stress.store import fingerprint
from taichi_cloth.evaluation.stress.unit import Unit


def unit(case: int, setting: str, variant: str | None = None) -> Unit:
    return select_units(str(case), variant, setting)[0]


YANK, SLOPE, METHOD = unit(29, "lines"), unit(35, "explicit"), unit(31, "verlet", "method")
ALL = {"yank": YANK, "slope": SLOPE, "method": METHOD}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the package, which tests may change."""
    copy = tmp_path / "taichi_cloth"
    shutil.copytree(module.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(module, "PACKAGE", copy)
    return copy


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("simulation/simulation.py", {"yank", "slope", "method"}),
        ("kernels/springs.py", {"yank", "slope", "method"}),
        ("evaluation/reference/static_solution.py", {"yank", "slope", "method"}),
        ("evaluation/stress/invariants.py", {"yank", "slope", "method"}),
        ("evaluation/stress/trial.py", {"yank", "slope", "method"}),
        ("evaluation/stress/loads.py", {"yank"}),
        ("evaluation/stress/changes.py", {"method"}),
        ("evaluation/stress/contact.py", {"slope", "method"}),  # `changes` takes its margin
        ("evaluation/stress/layered_cloth.py", set()),
        ("solvers/lines.py", {"yank", "method"}),
        ("solvers/explicit.py", {"slope", "method"}),
        ("solvers/base.py", {"yank", "slope", "method"}),
        ("solvers/__init__.py", {"yank", "slope", "method"}),
        ("kernels/line_solver.py", {"yank", "method"}),  # only `lines` uses it
        ("kernels/conjugate_gradient.py", {"method"}),  # only `implicit` uses it
        ("evaluation/stress/stress_report.py", set()),
        ("evaluation/stress/causes.py", set()),
        ("evaluation/stress/case_catalog.py", set()),
        ("__init__.py", set()),
        ("web/server.py", set()),
        ("export/clip.py", set()),
        ("simulation/recording.py", set()),
        ("evaluation/validate/swing.py", set()),
    ],
)
def test_a_changed_file_changes_the_fingerprints_of_its_results(package: Path, name: str, others: set[str]) -> None:
    module.sources.cache_clear()
    before = {key: fingerprint(one) for key, one in ALL.items()}
    path = package / name
    source = path.read_bytes()
    path.write_bytes(b'"""Another text."""\n\n' + source.partition(b'"""\n')[2].replace(b"\n", b"\r\n") + b"\n# more\n")
    module.sources.cache_clear()
    assert {key: fingerprint(one) for key, one in ALL.items()} == before
    path.write_bytes(source + b"\nMORE = 1\n")
    module.sources.cache_clear()
    assert {key for key, one in ALL.items() if fingerprint(one) != before[key]} == others
    module.sources.cache_clear()


def test_every_unit_has_its_own_fingerprint() -> None:
    units = select_units()
    assert len({fingerprint(one) for one in units}) == len(units)


def test_the_values_of_a_variant_are_part_of_its_fingerprint() -> None:
    assert list(module.called(YANK.variant.run)) == [
        "taichi_cloth.evaluation.stress.unit._with_value",
        "taichi_cloth.evaluation.stress.loads.yank",
        "10.0",
    ]
