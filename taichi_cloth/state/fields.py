"""How fields are made and filled. With `lanes`, a slot holds eight values side by side (`mesh/strips.py`)."""

from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..kernels.places import COMPONENTS
from ..kernels.whole import is_whole, kept_whole, kind_of, whole_field
from ..kernels.writing import shape_of, write
from ..mesh.strips import STRIPS


def number() -> Any:
    """One whole number."""
    return ti.field(ti.i32, ())


def numbers(count: int, *, lanes: bool = False, kind: Any = ti.f32) -> Any:
    """A number in each of `count` slots."""
    return whole_field((STRIPS,), kind, count) if lanes else ti.field(kind, count)


def places(count: int, *, lanes: bool = False) -> Any:
    """A vector of three in each of `count` slots."""
    return whole_field((COMPONENTS, STRIPS), ti.f32, count) if lanes else ti.Vector.field(3, ti.f32, count)


def rows(width: int, count: int, kind: Any = ti.i32) -> Any:
    """A vector in each of `count` slots, for kernels of strips too: beside what is whole it must be SOA."""
    return ti.Vector.field(width, kind, count, layout=ti.Layout.SOA)


def like_places(work: Any) -> Any:
    """The same, as many as a state has."""
    return places(work.x.shape[0], lanes=work.in_lanes)


def put(field: Any, values: NDArray[Any]) -> None:
    """Writes `values` to the beginning of a field and zeros behind them. `values` that do not fit raise ValueError."""
    put_all((field, values))


def put_all(*pairs: tuple[Any, NDArray[Any]]) -> None:
    """The same for several fields and the values of each. The fewer the calls, the earlier is a first frame."""
    bits = []
    for field, values in pairs:
        out = np.zeros((field.shape[0], *shape_of(field)), np.float32 if kind_of(field) == ti.f32 else np.int32)
        out[tuple(slice(n) for n in values.shape)] = values
        bits.append(out.reshape(-1).view(np.int32))
    fields = tuple(field for field, _ in pairs)
    with kept_whole(any(map(is_whole, fields))):
        write(fields, np.concatenate(bits))
