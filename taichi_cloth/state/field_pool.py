"""Allocation, reuse and upload of Taichi fields."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..geometry.simd_layout import LANES, pack
from ..geometry.topology import Topology
from ..kernels.tensor_fields import (
    element_shape,
    is_tensor_field,
    materialized,
    scalar_dtype,
    tensor_field,
    write_fields,
)
from ..kernels.vec import COMPONENTS
from ..system.taichi_compat import ProgramRef, no_scalarization

Fields = TypeVar("Fields")


def capacity(count: int) -> int:
    """Return the power of two, at least 16, that holds `count`. Rounding lets cloths of similar size share fields."""
    return max(16, 1 << (count - 1).bit_length())


class Pool(Generic[Fields]):
    """Reuses groups of fields of equal capacity.

    Taichi holds at most 512 field trees per process, never frees the kernels compiled for one, and crashes when a
    destroyed field is touched. Reusing fields avoids all three, and their kernels are already compiled.
    """

    def __init__(self, make: Callable[..., Fields]) -> None:
        """`make(*capacities)` allocates a new group."""
        self._make = make
        self._free: dict[tuple[int, ...], list[Fields]] = {}
        self._capacities: dict[int, tuple[int, ...]] = {}  # of each group in use, by its id
        self._program: ProgramRef | None = None  # weak: a strong reference would keep an ended program alive

    def acquire(self, *counts: int) -> Fields:
        """Return a released or new group whose capacities hold these counts."""
        if self._program is None or not self._program.runs():  # Taichi was restarted: old fields are invalid
            self._free.clear()
            self._capacities.clear()
            self._program = ProgramRef()
        capacities = tuple(capacity(count) for count in counts)
        free = self._free.setdefault(capacities, [])
        fields = free.pop() if free else self._make(*capacities)
        self._capacities[id(fields)] = capacities
        return fields

    def release(self, fields: Fields) -> None:
        """Make a group available again. A group of an earlier Taichi program is dropped."""
        capacities = self._capacities.pop(id(fields), None)
        if capacities is not None and self._program is not None and self._program.runs():
            self._free[capacities].append(fields)


def build(layout: Any, make: Callable[[], Fields]) -> Fields:
    """Return `make()`, a group of fields to be used in kernels together with `layout`."""
    return materialized(make) if layout.is_simd else make()


def count_field() -> ti.ScalarField:
    """Return a 0-D int32 field."""
    return ti.field(ti.i32, ())


def scalar_field(count: int, *, simd: bool = False, dtype: object = ti.f32) -> ti.ScalarField:
    """Return a field of `count` scalars, or with `simd` of `count` packets of eight."""
    return tensor_field((LANES,), dtype, count) if simd else ti.field(dtype, count)


def vector_field(count: int, *, simd: bool = False) -> ti.MatrixField:
    """Return a field of `count` 3-vectors, or with `simd` of `count` packets of eight."""
    return tensor_field((COMPONENTS, LANES), ti.f32, count) if simd else ti.Vector.field(3, ti.f32, count)


def soa_vector_field(width: int, count: int, dtype: object = ti.i32) -> ti.MatrixField:
    """Return a field of `count` vectors that kernels may use beside tensor fields, which requires SOA."""
    return ti.Vector.field(width, dtype, count, layout=ti.Layout.SOA)


def vector_field_like(layout: Any) -> ti.MatrixField:
    """Return a vector field with one element for each packet of the layout."""
    return vector_field(layout.x.shape[0], simd=layout.is_simd)


def upload(field: object, values: NDArray[np.generic]) -> None:
    """Write `values` to the beginning of a field and zeros after them.

    Raises ValueError if `values` do not fit.
    """
    upload_all((field, values))


def upload_all(*pairs: tuple[Any, NDArray[Any]]) -> None:
    """Upload several fields in one kernel launch. A kernel per field would make a cold start half a second longer."""
    bits = []
    for field, values in pairs:
        dtype = np.float32 if scalar_dtype(field) == ti.f32 else np.int32
        out = np.zeros((field.shape[0], *element_shape(field)), dtype)
        out[tuple(slice(n) for n in values.shape)] = values
        bits.append(out.reshape(-1).view(np.int32))
    fields = tuple(field for field, _ in pairs)
    with no_scalarization(any(map(is_tensor_field, fields))):
        write_fields(fields, np.concatenate(bits))


def layout_index(layout: Any, topology: Topology, particles: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the index of each particle in the layout: `8·packet + lane` for SIMD, else the particle index."""
    if not layout.is_simd:
        return particles
    row, column = np.divmod(particles, topology.shape[1])
    row_stride = layout.row_stride[None]
    index: NDArray[np.integer] = (row * row_stride + column % row_stride) * LANES + column // row_stride
    return index


def layout_size(layout: Any) -> int:
    """Return the number of layout indices."""
    return int(layout.x.shape[0]) * (LANES if layout.is_simd else 1)


def by_packet(layout: Any, topology: Topology, values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Arrange K values of every particle, or of every place of a grid, as (K·packets,), or (K·packets, 8) for SIMD."""
    if not layout.is_simd:
        return values.reshape(-1)
    return pack(values.reshape(-1, *topology.shape), layout.row_stride[None]).reshape(-1, LANES)
