"""Imports go one way, and the package is light until a simulation is made."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import taichi_cloth

PACKAGE = Path(taichi_cloth.__file__).parent

# A module may import from its own line and from those above it.
FLOORS = [
    {"errors", "files", "lock", "machine", "notes", "progress", "side_by_side"},
    {"scene", "mesh", "interact"},
    {"measure"},
    {"reference"},
    {"kernels"},
    {"state"},
    {"contact", "solvers"},
    {"controls_row", "given", "hand", "hands", "save_file", "scene_solver", "scene_stages", "simulation"},
    {"guard", "record", "timing"},
    {"export", "page", "view"},  # the window writes meshes; a page has the window's colours
    {"web"},
    {"kernel_cache", "runtime", "source_cache"},
    {"bench"},
    {"validate", "accuracy", "stress"},
    {"cli_options"},
    {"cli_compare", "cli_export", "cli_measure", "cli_replay", "cli_run", "cli_scenes", "cli_web"},
    {"cli", "__init__", "__main__"},
]
NO_TAICHI = {
    "errors",
    "files",
    "lock",
    "machine",
    "notes",
    "progress",
    "side_by_side",
    "scene",
    "mesh",
    "interact",
    "measure",
    "reference",
}
FLOOR = {name: number for number, names in enumerate(FLOORS) for name in names}


def unit_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path: Path) -> set[str]:
    """Dotted names that a file imports, those of the package starting with its own name."""
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


FILES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_one_way(path: Path) -> None:
    floor = FLOOR[unit_of(path)]
    for name in imports(path):
        if name.startswith("taichi_cloth."):
            unit = name.split(".")[1]
            if unit in FLOOR and name != "taichi_cloth.__version__":
                assert FLOOR[unit] <= floor, f"{path.name} imports {name}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_kernels_and_above_import_taichi(path: Path) -> None:
    if unit_of(path) in NO_TAICHI:
        assert not {name for name in imports(path) if name.split(".")[0] == "taichi"}


def test_the_reference_shares_only_scenes_and_meshes_with_what_it_judges() -> None:
    for path in FILES:
        if unit_of(path) == "reference":
            own = {name.split(".")[1] for name in imports(path) if name.startswith("taichi_cloth.")}
            assert own <= {"scene", "mesh", "reference"}, path


def test_solvers_do_not_know_each_other_nor_views_any_solver() -> None:
    for path in FILES:
        for name in imports(path):
            if unit_of(path) == "view":
                assert not name.startswith("taichi_cloth.solvers"), path
            if unit_of(path) == "solvers" and path.stem not in ("__init__", "base"):
                assert name.split(".")[:2] != ["taichi_cloth", "solvers"] or name.split(".")[2] == "base", path


@pytest.mark.parametrize("code", ["import taichi_cloth", "from taichi_cloth.cli import main; main(['list'])"])
def test_taichi_is_not_imported_before_it_is_needed(code: str) -> None:
    code += "; import sys; sys.exit('taichi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0


def test_help_is_light() -> None:
    code = "import sys; from taichi_cloth.cli import main\n"
    code += "try: main(['--help'])\nfinally: assert not {'taichi', 'numpy', 'rich'} & set(sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "render" in done.stdout
