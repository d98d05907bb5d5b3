"""Many fields filled by one kernel: one of its own for each would make a cold start half a second longer."""

from math import prod
from typing import Any

import taichi as ti

from .whole import is_whole, kind_of

whole = ti.types.ndarray(dtype=ti.i32, ndim=1)


def width(field: Any) -> int:
    """How many numbers a slot of a field holds."""
    return prod(shape_of(field))


def shape_of(field: Any) -> tuple[int, ...]:
    """(), (n,) or (n, m): the shape of what a slot holds."""
    if is_whole(field):
        return tuple(field.dtype.shape())
    return (field.n, field.m)[: field.ndim] if isinstance(field, ti.MatrixField) else ()


def first_of(fields: tuple[Any, ...], f: int) -> int:
    """Where the numbers of field f begin among those of all."""
    return sum(field.shape[0] * width(field) for field in fields[:f])


def most_slots(fields: tuple[Any, ...]) -> int:
    """Slots of the longest field."""
    return max(field.shape[0] for field in fields)


@ti.func
def number_at(bits: ti.template(), at: int, field: ti.template()):
    if ti.static(kind_of(field) == ti.f32):
        return ti.bit_cast(bits[at], ti.f32)
    else:
        return bits[at]


@ti.func
def slot_at(bits: ti.template(), at: int, field: ti.template()):
    """A row or a matrix from its numbers."""
    last = ti.static(shape_of(field)[-1])
    if ti.static(len(shape_of(field)) == 1):
        return ti.Vector([number_at(bits, at + k, field) for k in ti.static(range(last))])
    else:
        return ti.Matrix(
            [
                [number_at(bits, at + c * last + k, field) for k in ti.static(range(last))]
                for c in ti.static(range(shape_of(field)[0]))
            ]
        )


@ti.kernel
def write(fields: ti.template(), bits: whole):
    """Every slot of all fields, from the bits of their numbers in a row. One loop: each is compiled by itself."""
    for i in range(ti.static(most_slots(fields))):
        for f in ti.static(range(len(fields))):
            field = ti.static(fields[f])
            if i < field.shape[0]:
                at = ti.static(first_of(fields, f)) + i * ti.static(width(field))
                if ti.static(is_whole(field)):
                    field[i] = slot_at(bits, at, field)
                elif ti.static(width(field) == 1):
                    field[i] = number_at(bits, at, field)
                else:
                    for c in range(field.n):
                        field[i][c] = number_at(bits, at + c, field)
