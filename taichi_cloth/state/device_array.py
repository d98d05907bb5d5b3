"""An array in the memory of the device that kernels run on."""

from __future__ import annotations

import weakref
from typing import Any

import taichi as ti

from .program import ProgramRef, running_program

# Where a release has it not, `kernels/internals.py` finds out, and no array is made.
_ScalarNdarray: Any = getattr(getattr(ti.lang, "_ndarray", None), "ScalarNdarray", object)


class DeviceArray(_ScalarNdarray):  # type: ignore[misc]  # Taichi has no types
    """A `ti.ndarray` of float32 that frees itself only while its own program runs.

    Taichi 1.7.4's own deletes its address in whatever program runs when Python lets go of it: that of an ended program
    may be the address of an array in use. An ended program has freed its arrays itself.
    """

    arr: Any  # Taichi's own handle

    def __init__(self, shape: tuple[int, ...]) -> None:
        super().__init__(ti.f32, shape)
        self._delete = weakref.finalize(self, _delete, ProgramRef(), self.arr)
        self._delete.atexit = False  # modules may be gone by then

    def free(self) -> None:
        """Frees the memory now, whoever still refers to the array. Twice does no harm."""
        self._delete()
        self.arr = None

    def __del__(self) -> None:
        """Instead of Taichi's own."""


def _delete(program: ProgramRef, array: Any) -> None:
    if program.runs():
        running_program().delete_ndarray(array)
