"""What this program takes from inside Taichi, and whether it is there.

None of it is in Taichi's interface, so another release may have it otherwise, or not at all. Each use of it is checked
before it is relied on: the release, the names, and for kernels a small one that must give the right numbers. Where a
check fails the program does without, says so in one line, and is slower.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import taichi as ti

from ..errors import one_line
from ..notes import note

TESTED = (1, 7, 4)  # the release that all of this was tried with


class Use(NamedTuple):
    """One thing that is done by Taichi's inside."""

    names: tuple[str, ...]  # of what it takes, from `taichi` on
    without: str  # what happens without it, for the user


SIMD = Use(
    (
        "_lib.core.CompileConfig.real_matrix_scalarize",
        "_lib.core.CompileConfig.fast_math",
        "lang.impl.current_cfg",
        "lang.impl.PyTaichi.materialize",
        "_lib.core.TypeFactory.get_tensor_type",
    ),
    "grids take the path list, which is slower",
)
GRAPHS = Use(
    (
        "lang.kernel_impl.Kernel.ensure_compiled",
        "_lib.core.GraphBuilder.dispatch",
        "graph.GraphBuilder",
        "lang._ndarray.ScalarNdarray",
        "_lib.core.Program.delete_ndarray",
    ),
    "kernels are launched one by one, which is slower",
)
SOURCES = Use(
    (
        "lang.kernel_impl.getsourcefile",
        "lang.kernel_impl.getsourcelines",
        "lang.ast.ast_transformer_utils.TextWrapper",
    ),
    "a start takes a second longer",
)
CACHE = Use(
    ("lang.impl.default_cfg", "_lib.core.CompileConfig.offline_cache_file_path"),
    "compiled kernels are kept in Taichi's own folder, which is not checked",
)

_checked: dict[tuple[Use, Any], bool] = {}  # and on which arch


def usable(use: Use, probe: Callable[[], bool] | None = None) -> bool:
    """Whether a use works: its names are there, and `probe`, for the arch that runs, gives True. Looked at once.

    The first time that it does not, a line says so.
    """
    key = use, None if probe is None else ti.cfg.arch
    if key not in _checked:
        trouble = _trouble(use, probe)
        _checked[key] = not trouble
        if trouble:
            note(f"{trouble}: {use.without}")
    return _checked[key]


def find(name: str) -> Any:
    """What has this name, from `taichi` on. Raises AttributeError."""
    return reduce(getattr, name.split("."), ti)


def _trouble(use: Use, probe: Callable[[], bool] | None) -> str:
    """Why a use does not work, in words; nothing where it does."""
    if ti.__version__ != TESTED:
        there, tested = (".".join(map(str, version)) for version in (ti.__version__, TESTED))
        return f"Taichi is {there}, and {tested} was tried"
    for name in use.names:
        try:
            find(name)
        except AttributeError:
            return f"Taichi has no {name}"
    try:
        return "" if probe is None or probe() else "a kernel that was tried gives wrong numbers"
    except Exception as error:  # whatever it is, the program can do without
        return f"a kernel that was tried fails ({one_line(f'{type(error).__name__}: {error}')[:200]})"
