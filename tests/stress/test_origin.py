"""A result is repeated if something that it depends on has changed, and only then."""

import ast
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


def forget() -> None:
    """Forget sources, which a test has changed."""
    module.sources.cache_clear()
    module.files_behind.cache_clear()


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
        ("evaluation/stress/loads.py", set()),  # of modules with cases, only what a variant uses counts
        ("evaluation/stress/contact.py", set()),
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
    forget()
    before = {key: fingerprint(one) for key, one in ALL.items()}
    path = package / name
    source = path.read_bytes()
    path.write_bytes(b'"""Another text."""\n\n' + source.partition(b'"""\n')[2].replace(b"\n", b"\r\n") + b"\n# more\n")
    forget()
    assert {key: fingerprint(one) for key, one in ALL.items()} == before
    path.write_bytes(source + b"\nMORE = 1\n")
    forget()
    assert {key for key, one in ALL.items() if fingerprint(one) != before[key]} == others
    forget()


@pytest.mark.parametrize(
    ("name", "before", "after", "others"),
    [
        ("loads.py", "YANKED_STRAIN = 0.05", "YANKED_STRAIN = 0.06", {"yank"}),  # a value that the function uses
        ("loads.py", "for z in (0.0, distance, 0.0):", "for z in (0.0, distance):", {"yank"}),
        ("loads.py", "CHATTER = 1e-3", "CHATTER = 2e-3", set()),
        ("loads.py", "from functools import partial", "from functools import reduce as partial", {"yank"}),
        ("loads.py", "from functools import partial", "from functools import partial, reduce", set()),
        ("loads.py", "from .invariants import ROUNDING", "from .setup import ROUNDING", set()),
        ("contact.py", "CREEP = 1e-3", "CREEP = 2e-3", {"slope"}),
        ("contact.py", "shake - np.outer", "2 * shake - np.outer", {"slope"}),  # in a function that it calls
        ("contact.py", "MARGIN = 0.01", "MARGIN = 0.02", {"slope", "ball"}),  # imported by another module with cases
        ("contact.py", "TURNED = 0.5", "TURNED = 0.6", set()),
        ("layered_cloth.py", "EJECTED = 2.0", "EJECTED = 3.0", {"ball"}),
    ],
)
def test_only_what_a_variant_uses_of_a_module_with_cases_counts(
    package: Path, name: str, before: str, after: str, others: set[str]
) -> None:
    units = ALL | {"ball": unit(21, "xpbd", "teleported")}
    forget()
    unchanged = {key: fingerprint(one) for key, one in units.items()}
    path = package / "evaluation/stress" / name
    source = path.read_text(encoding="utf-8")
    assert before in source
    path.write_text(source.replace(before, after, 1), encoding="utf-8")
    forget()
    assert {key for key, one in units.items() if fingerprint(one) != unchanged[key]} == others
    forget()


@pytest.mark.parametrize("name", ["changes", "contact", "extremes", "layered_cloth", "loads"])
def test_every_statement_of_a_module_with_cases_binds_its_names(name: str) -> None:
    """The fingerprint follows names to these statements only, and would miss any other."""
    [docstring, *statements] = module.statements((module.PACKAGE / f"evaluation/stress/{name}.py").read_bytes())
    assert module.is_text(docstring)
    assert [ast.unparse(one) for one in statements if not module.bound_names(one)] == []
    assert "*" not in set().union(*map(module.bound_names, statements))
    inside = [one for outer in statements for one in ast.walk(outer) if one is not outer]
    assert [ast.unparse(one) for one in inside if isinstance(one, ast.Import | ast.ImportFrom)] == []


def test_every_unit_has_its_own_fingerprint() -> None:
    units = select_units()
    assert len({fingerprint(one) for one in units}) == len(units)


def test_the_values_of_a_variant_are_part_of_its_fingerprint() -> None:
    assert list(module.called(YANK.variant.run)) == [
        "taichi_cloth.evaluation.stress.unit._with_value",
        "taichi_cloth.evaluation.stress.loads.yank",
        "10.0",
    ]
