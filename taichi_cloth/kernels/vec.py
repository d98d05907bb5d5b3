"""Vector arithmetic that works on one particle or on eight.

Every formula of the cloth is written once with these functions. A vec3 is one particle's vector and a scalar goes with
it; in the SIMD layout a 4×8 matrix holds the vectors of eight particles, one in each column, and a row of eight goes
with it. LLVM compiles the matrix form to SIMD instructions; Taichi's CPU code for scalar fields is never vectorized.
"""

import taichi as ti
import taichi.math as tm

from ..geometry.simd_layout import LANES  # an AVX2 register holds 8 floats; 4 lanes took 1.5 times as long, 16 1.25

COMPONENTS = 4  # x, y, z and a row of zeros: LLVM splits 24 floats into single numbers between basic blocks, but not 32


def is_scalar(vector) -> bool:
    """Return whether this is one vector and not eight (while compiling)."""
    return len(vector.get_shape()) == 1


@ti.func
def lane_broadcast(row):
    """Repeat a row of eight for every component."""
    # `*` repeats a list while compiling. A comprehension of 32 subscripts took a tenth of the time to parse a kernel.
    return ti.Matrix([[row[k] for k in ti.static(range(LANES))]] * COMPONENTS)


@ti.func
def broadcast(vector: tm.vec3, like):
    """Repeat a vector for every particle that `like` holds."""
    if ti.static(is_scalar(like)):
        return vector
    else:
        return ti.Matrix([[vector[c]] * LANES for c in ti.static(range(3))] + [[0.0] * LANES])


@ti.func
def max_lane(row):
    """Return the largest number of a row of eight. `.max()` does not compile for tensor fields."""
    largest = row[0]
    for k in ti.static(range(1, LANES)):
        largest = ti.max(largest, row[k])
    return largest


@ti.func
def any_nonzero(vector) -> int:
    """Return 1 if the vector, or one of eight, is not zero, else 0."""
    if ti.static(is_scalar(vector)):
        return ti.select(vector.norm_sqr() > 0.0, 1, 0)
    else:
        return ti.select(max_lane(dot(vector, vector)) > 0.0, 1, 0)


@ti.func
def any_at_most(row, bound: float) -> int:
    """Return 1 if a number of a row of eight is at most the bound, else 0."""
    return ti.select(max_lane(neg(row)) >= -bound, 1, 0)


@ti.func
def component(vector, c: ti.template()):
    """Return component c."""
    if ti.static(is_scalar(vector)):
        return vector[c]
    else:
        return vector[c, :]


@ti.func
def from_components(x, y, z, like):
    """Return the vector with these components, in the form of `like`."""
    if ti.static(is_scalar(like)):
        return tm.vec3(x, y, z)
    else:
        zero = ti.Vector.zero(ti.f32, LANES)
        return ti.Matrix([[row[k] for k in ti.static(range(LANES))] for row in ti.static((x, y, z, zero))])


@ti.func
def neg(value):
    """Return −value. Unary minus does not compile for tensor fields (`tensor_fields.py`), nor does `ti.abs`."""
    return value * -1.0


@ti.func
def abs_(value):
    """Return |value|, element by element."""
    return ti.max(value, neg(value))


@ti.func
def cast(vector, dtype: ti.template()):
    """Return a vec3 of another type. `ti.cast` does not compile for tensor fields."""
    return ti.Vector([ti.cast(vector[c], dtype) for c in ti.static(range(3))])


@ti.func
def scale(vector, factor):
    """Return the vector times a scalar."""
    if ti.static(is_scalar(vector)):
        return vector * factor
    else:
        return vector * lane_broadcast(factor)


@ti.func
def dot(a, b):
    if ti.static(is_scalar(a)):
        return a.dot(b)
    else:
        product = a * b
        return product[0, :] + product[1, :] + product[2, :]


@ti.func
def cross(a, b):
    if ti.static(is_scalar(a)):
        return a.cross(b)
    else:
        x = a[1, :] * b[2, :] - a[2, :] * b[1, :]
        y = a[2, :] * b[0, :] - a[0, :] * b[2, :]
        z = a[0, :] * b[1, :] - a[1, :] * b[0, :]
        return from_components(x, y, z, a)


@ti.func
def length(vector):
    return ti.sqrt(dot(vector, vector))


@ti.func
def select(condition, a, b):
    """Return vector a where the condition holds, else b."""
    if ti.static(is_scalar(a)):
        return ti.select(condition, a, b)
    else:  # a row of truth values cannot be indexed
        return ti.select(lane_broadcast(ti.select(condition, 1.0, 0.0)) > 0.0, a, b)


# -- between lanes -------------------------------------------------------------------------------------------------


@ti.func
def shift_left_clamped(value):
    """Return for each lane the value of the lane after it; the last lane keeps its own."""
    if ti.static(len(value.get_shape()) == 1):
        return ti.Vector([value[min(k + 1, LANES - 1)] for k in ti.static(range(LANES))])
    else:
        return ti.Matrix(
            [[value[c, min(k + 1, LANES - 1)] for k in ti.static(range(LANES))] for c in ti.static(range(COMPONENTS))]
        )


@ti.func
def shift_left(value):
    """Return for each lane the value of the lane after it; the last lane gets zero."""
    if ti.static(len(value.get_shape()) == 1):
        return ti.Vector([value[min(k + 1, LANES - 1)] * min(LANES - 1 - k, 1) for k in ti.static(range(LANES))])
    else:
        return ti.Matrix(
            [
                [value[c, min(k + 1, LANES - 1)] * min(LANES - 1 - k, 1) for k in ti.static(range(LANES))]
                for c in ti.static(range(COMPONENTS))
            ]
        )


@ti.func
def shift_right(value):
    """Return for each lane the value of the lane before it; the first lane gets zero."""
    if ti.static(len(value.get_shape()) == 1):
        return ti.Vector([value[max(k - 1, 0)] * min(k, 1) for k in ti.static(range(LANES))])
    else:
        return ti.Matrix(
            [
                [value[c, max(k - 1, 0)] * min(k, 1) for k in ti.static(range(LANES))]
                for c in ti.static(range(COMPONENTS))
            ]
        )


@ti.func
def insert_shifted(value, shifted):
    """Undo `shift_left_clamped` after a change: lane k + 1 gets lane k of `shifted`, lane 0 keeps its own value."""
    return ti.Matrix(
        [
            [shifted[c, max(k - 1, 0)] if ti.static(k > 0) else value[c, k] for k in ti.static(range(LANES))]
            for c in ti.static(range(COMPONENTS))
        ]
    )
