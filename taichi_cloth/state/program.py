"""Which Taichi program something belongs to.

A Taichi program owns all fields, arrays and compiled kernels, from `ti.init` to `ti.reset`. Nothing here may keep an
ended one alive: its destructor frees its arrays by address, and those addresses may be memory of the next program by
then. So it is known by a weak reference only.
"""

from __future__ import annotations

import weakref
from typing import Any

import taichi as ti


def running_program() -> Any:
    """The Taichi program that runs, or None. Do not keep it: `ProgramRef` does that."""
    return ti.lang.impl.get_runtime().prog


class ProgramRef:
    """The program that ran when this was made."""

    def __init__(self) -> None:
        program = running_program()
        self._program = None if program is None else weakref.ref(program)

    def runs(self) -> bool:
        """Whether that program still runs: False from its end on, and where none ran."""
        program = None if self._program is None else self._program()
        return program is not None and program is running_program()
