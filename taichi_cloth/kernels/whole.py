"""Slots of eight that stay whole: how fields of them are made, and how the kernels that use them are compiled.

Taichi takes a matrix apart into its components and LLVM has to find out which of them go side by side: it takes as many
at once as it believes the processor to have registers for, four floats where it does not know its name. A field whose
slots are of a tensor type, in a kernel compiled with `real_matrix_scalarize=False`, hands LLVM a slot as one value of 8
or 32 floats: one load, one store, and registers as wide as the processor's.

What such a kernel may not do (Taichi 1.7.4: LLVM ends the process in an assertion, or a number goes to a wrong place):
read or write one number of a field's slot (take the slot into a variable, and put that back); use other fields of
vectors unless their layout is SOA; `-v`, `v -= …`, `ti.abs` and `ti.cast` of a vector (`places.py` has others).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import taichi as ti

Fields = TypeVar("Fields")


def whole_field(shape: tuple[int, ...], kind: Any, count: int) -> Any:
    """A field of `count` slots, each a row (n,) or a matrix (n, m) of numbers."""
    slot = ti.types.vector(*shape, kind) if len(shape) == 1 else ti.types.matrix(*shape, kind)
    return ti.field(slot.tensor_type, count)


def placed(make: Callable[[], Fields]) -> Fields:
    """What `make` gives; the fields that it makes get their memory now. Under this option: by it Taichi decides whether
    slots are vectors for LLVM, or arrays.
    """
    with kept_whole(True):
        made = make()
        ti.lang.impl.get_runtime().materialize()
    return made


@contextmanager
def kept_whole(on: bool) -> Iterator[None]:
    """Kernels that are compiled meanwhile leave vectors and matrices whole, if `on`.

    And sums in the order in which they are written: LLVM would change it in slots and not in single numbers, but strips
    are to give the bits of the list.
    """
    if not on:
        yield
        return
    options = ti.lang.impl.current_cfg()
    before = options.real_matrix_scalarize, options.fast_math
    options.real_matrix_scalarize = options.fast_math = False
    try:
        yield
    finally:
        options.real_matrix_scalarize, options.fast_math = before


def is_whole(field: Any) -> bool:
    """Whether a field's slots are whole rows or matrices."""
    return bool(kind_of(field) != field.dtype)


def kind_of(field: Any) -> Any:
    """The type of the numbers in a field."""
    return field.dtype.element_type()
