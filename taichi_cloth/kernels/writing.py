"""Many fields filled by one kernel: one of its own for each would make a cold start half a second longer."""

from math import prod
from typing import Any

import taichi as ti

whole = ti.types.ndarray(dtype=ti.i32, ndim=1)


def width(field: Any) -> int:
    """How many numbers a slot of a field holds."""
    return prod(shape_of(field))


def shape_of(field: Any) -> tuple[int, ...]:
    """(), (n,) or (n, m): the shape of what a slot holds."""
    return (field.n, field.m)[: field.ndim] if isinstance(field, ti.MatrixField) else ()


def first_of(fields: tuple[Any, ...], f: int) -> int:
    """Where the numbers of field f begin among those of all."""
    return sum(field.shape[0] * width(field) for field in fields[:f])


def most_slots(fields: tuple[Any, ...]) -> int:
    """Slots of the longest field."""
    return max(field.shape[0] for field in fields)


@ti.func
def number_at(bits: ti.template(), at: int, kind: ti.template()):
    if ti.static(kind == ti.f32):
        return ti.bit_cast(bits[at], ti.f32)
    else:
        return bits[at]


@ti.kernel
def write(fields: ti.template(), bits: whole):
    """Every slot of all fields, from the bits of their numbers in a row. One loop: each is compiled by itself."""
    for i in range(ti.static(most_slots(fields))):
        for f in ti.static(range(len(fields))):
            field = ti.static(fields[f])
            if i < field.shape[0]:
                at = ti.static(first_of(fields, f)) + i * ti.static(width(field))
                if ti.static(width(field) == 1):
                    field[i] = number_at(bits, at, field.dtype)
                elif ti.static(field.ndim == 1):
                    for c in range(field.n):
                        field[i][c] = number_at(bits, at + c, field.dtype)
                else:
                    for c in range(field.n):
                        for k in range(field.m):
                            field[i][c, k] = number_at(bits, at + c * field.m + k, field.dtype)
