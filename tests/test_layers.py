"""The floors of the package: a module imports from its own folder and from lower floors, and the package is light."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import taichi_cloth

PACKAGE = Path(taichi_cloth.__file__).parent

# One folder is one floor, from the lowest to the highest. Two folders of one floor do not import each other.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("system",),
    ("scene",),
    ("geometry",),
    ("kernels",),
    ("state",),
    ("collision",),
    ("solvers",),
    ("simulation",),
    ("render",),
    ("viewer", "export"),
    ("web",),
    ("cli",),
    ("evaluation",),
)
FLOOR = {folder: number for number, folders in enumerate(FLOORS) for folder in folders}
TOP = len(FLOORS)  # of `taichi_cloth/__init__.py` and `__main__.py`
NO_TAICHI = ("scene", "geometry")
MAX_MODULES, MAX_LINES = 181, 400
MAX_FACADE_LINES = 250  # of `Simulation`, whose parts are in modules of their own

FILES = sorted(PACKAGE.rglob("*.py"))
IDS = [str(path.relative_to(PACKAGE)) for path in FILES]


def folder_of(path: Path) -> str:
    """The folder of the package that a module lies in; nothing for one that lies in none."""
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else ""


def imports(path: Path) -> set[str]:
    """Dotted names that a module imports anywhere, also within functions and for type checking only."""
    package = ["taichi_cloth", *path.relative_to(PACKAGE).parent.parts]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def imported_folders(path: Path) -> set[str]:
    own = {name.split(".")[1] for name in imports(path) if name.startswith("taichi_cloth.")}
    return {name for name in own if (PACKAGE / name).is_dir()}


def test_every_folder_has_a_floor() -> None:
    assert {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()} == set(FLOOR)


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_imports_go_down(path: Path) -> None:
    own = folder_of(path)
    for other in imported_folders(path):
        if other != own:
            assert FLOOR[other] < FLOOR.get(own, TOP), f"{path.name} imports {other}"


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_only_kernels_and_above_import_taichi(path: Path) -> None:
    if folder_of(path) in NO_TAICHI:
        assert not {name for name in imports(path) if name.split(".")[0] == "taichi"}


TAICHI_INTERNALS = {"lang", "_lib", "_primal", "_graph_builder", "tensor_type"}


@pytest.mark.parametrize("path", FILES, ids=IDS)
def test_only_two_modules_use_taichi_internals(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    attributes = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    modules = {part for name in imports(path) if name.split(".")[0] == "taichi" for part in name.split(".")[1:]}
    used = TAICHI_INTERNALS & (attributes | modules)
    assert bool(used) == (path.name in ("taichi_compat.py", "kernel_parsing.py")), used


def test_reference_solutions_share_only_scenes_and_geometry_with_what_they_judge() -> None:
    for path in (PACKAGE / "evaluation" / "reference").glob("*.py"):
        assert imported_folders(path) <= {"scene", "geometry", "system", "evaluation"}, path


def test_the_float64_model_of_the_references_is_not_used_by_what_they_judge() -> None:
    users = {folder_of(path) for path in FILES if any("geometry.spring_model" in name for name in imports(path))}
    assert users == {"evaluation", "simulation"}  # `Simulation.forces`, which moves nothing


def test_solvers_do_not_import_each_other() -> None:
    solvers = {path.stem for path in (PACKAGE / "solvers").glob("*.py")} & set(taichi_cloth_solvers())
    for name in solvers:
        found = {other.split(".")[2] for other in imports(PACKAGE / "solvers" / f"{name}.py") if ".solvers." in other}
        assert not found & (solvers - {name}), name


def test_solvers_reach_contact_and_external_forces_through_the_pipeline_only() -> None:
    shared = {
        *("add_wind", "add_repulsion", "resolve_contacts", "resolve_self_contacts"),
        *("project_tethers", "project_max_distances", "limit_strain"),
    }
    for name in taichi_cloth_solvers():
        tree = ast.parse((PACKAGE / "solvers" / f"{name}.py").read_text(encoding="utf-8"))
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        assert not names & shared, name


def taichi_cloth_solvers() -> list[str]:
    from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG

    return [*SOLVER_CATALOG]


def test_modules_are_few_short_and_called_differently() -> None:
    assert len([path for path in FILES if path.stem != "__init__"]) <= MAX_MODULES
    long = {str(path.relative_to(PACKAGE)): count for path in FILES if (count := lines_of(path)) > MAX_LINES}
    assert not long
    assert lines_of(PACKAGE / "simulation" / "simulation.py") <= MAX_FACADE_LINES
    names = Counter(path.stem for path in FILES if path.stem != "__init__")
    assert [name for name, count in names.items() if count > 1] == []


def lines_of(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("code", ["import taichi_cloth", "from taichi_cloth.__main__ import main; main(['list'])"])
def test_taichi_is_not_imported_before_it_is_needed(code: str) -> None:
    code += "; import sys; sys.exit('taichi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0


def test_help_imports_neither_numpy_nor_rich() -> None:
    code = "import sys; from taichi_cloth.__main__ import main\n"
    code += "try: main(['--help'])\nfinally: assert not {'taichi', 'numpy', 'rich'} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "render" in done.stdout
