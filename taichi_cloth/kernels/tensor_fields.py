"""Tensor fields: fields of packets of eight that Taichi does not take apart into scalars.

By default Taichi splits a matrix into its components, and LLVM has to find out which of them belong side by side; it
combines as many as fit the registers of the processor, four floats if the processor is unknown to it. A field
whose elements have a tensor type, in a kernel compiled with `real_matrix_scalarize=False`, gives LLVM one value of 8 or
32 floats: one load, one store, and full-width registers.

What such a kernel must not do (Taichi 1.7.4: LLVM asserts, or a number is written to the wrong place): read or write
one component of a field's element (copy the element to a variable, and write that back); use other vector fields unless
their layout is SOA; apply unary minus, `-=`, `ti.abs` or `ti.cast` to a vector (`vec.py` has replacements).
"""

from collections.abc import Callable
from math import prod
from typing import TypeVar

import numpy as np
import taichi as ti

from ..system.taichi_compat import SIMD, materialize_fields, no_scalarization, tensor_type, usable
from .vec import COMPONENTS, LANES

Fields = TypeVar("Fields")


def tensor_field(shape: tuple[int, ...], dtype: object, count: int) -> ti.ScalarField:
    """Return a field of `count` elements, each a vector (n,) or a matrix (n, m)."""
    element = ti.types.vector(*shape, dtype) if len(shape) == 1 else ti.types.matrix(*shape, dtype)
    return ti.field(tensor_type(element), count)


def materialized(make: Callable[[], Fields]) -> Fields:
    """Return `make()` with its fields allocated at once.

    Taichi decides when it allocates a field whether its elements are vectors or arrays for LLVM.
    """
    with no_scalarization(True):
        fields = make()
        materialize_fields()
    return fields


def is_tensor_field(field: object) -> bool:
    return bool(scalar_dtype(field) != field.dtype)


def scalar_dtype(field: object) -> object:
    """Return the type of the numbers in a field."""
    return field.dtype.element_type()


def element_shape(field: object) -> tuple[int, ...]:
    """Return the shape of an element: (), (n,) or (n, m)."""
    if is_tensor_field(field):
        return tuple(field.dtype.shape())
    return (field.n, field.m)[: field.ndim] if isinstance(field, ti.MatrixField) else ()


# -- uploading many fields with one kernel ---------------------------------------------------------------------------

i32_array = ti.types.ndarray(dtype=ti.i32, ndim=1)


def component_count(field: object) -> int:
    """Return how many numbers an element has."""
    return prod(element_shape(field))


def first_component(fields: tuple[object, ...], f: int) -> int:
    """Return where the numbers of field f begin among those of all fields."""
    return sum(field.shape[0] * component_count(field) for field in fields[:f])


def max_length(fields: tuple[object, ...]) -> int:
    """Return the length of the longest field."""
    return max(field.shape[0] for field in fields)


@ti.func
def component_at(bits: ti.template(), at: int, field: ti.template()):
    if ti.static(scalar_dtype(field) == ti.f32):
        return ti.bit_cast(bits[at], ti.f32)
    else:
        return bits[at]


@ti.func
def element_at(bits: ti.template(), at: int, field: ti.template()):
    """Return an element of a tensor field from its numbers."""
    last = ti.static(element_shape(field)[-1])
    if ti.static(len(element_shape(field)) == 1):
        return ti.Vector([component_at(bits, at + k, field) for k in ti.static(range(last))])
    else:
        return ti.Matrix(
            [
                [component_at(bits, at + c * last + k, field) for k in ti.static(range(last))]
                for c in ti.static(range(element_shape(field)[0]))
            ]
        )


@ti.kernel
def write_fields(fields: ti.template(), bits: i32_array):
    """Set every element of all fields from the bits of their numbers, one field after another.

    A single loop over all fields: each loop is compiled separately.
    """
    for i in range(ti.static(max_length(fields))):
        for f in ti.static(range(len(fields))):
            field = ti.static(fields[f])
            if i < field.shape[0]:
                at = ti.static(first_component(fields, f)) + i * ti.static(component_count(field))
                if ti.static(is_tensor_field(field)):
                    field[i] = element_at(bits, at, field)
                elif ti.static(component_count(field) == 1):
                    field[i] = component_at(bits, at, field)
                else:
                    for c in ti.static(range(field.n)):  # a variable index does not compile for Vulkan
                        field[i][c] = component_at(bits, at + c, field)


# -- a probe: does this release of Taichi compile them correctly? ----------------------------------------------------

f32_matrix = ti.types.ndarray(dtype=ti.f32, ndim=2)


@ti.kernel
def probe(field: ti.template(), values: f32_matrix, out: f32_matrix):
    """Set out = 2·values by way of a tensor field."""
    ti.loop_config(serialize=True)
    for i in range(1):
        element = ti.Matrix.zero(ti.f32, COMPONENTS, LANES)
        for k in range(LANES):
            for c in range(COMPONENTS):
                element[c, k] = values[c, k]
        field[i] = element
        field[i] = field[i] * 2.0
        element = field[i]
        for k in range(LANES):
            for c in range(COMPONENTS):
                out[c, k] = element[c, k]


def probe_is_correct() -> bool:
    """Return whether the probe gives the right numbers."""
    field = materialized(lambda: tensor_field((COMPONENTS, LANES), ti.f32, 1))
    values = np.arange(COMPONENTS * LANES, dtype=np.float32).reshape(COMPONENTS, LANES)
    out = np.zeros_like(values)
    with no_scalarization(True):
        probe(field, values, out)
    return bool((out == 2 * values).all())


def simd_available() -> bool:
    """Return whether the SIMD layout works with this release of Taichi."""
    return usable(SIMD, probe_is_correct)
