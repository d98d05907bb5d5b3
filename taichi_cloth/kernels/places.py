"""Arithmetic on places: one as a vec3, or eight at once as a 4×8 matrix with a place in each column.

Every formula of the cloth is written once with these. With vec3 it serves one particle; with a matrix
LLVM turns it into SIMD code for eight (Taichi's CPU code for scalar fields is never vectorised). What goes
with a place is a number, or a row of eight.
"""

import taichi as ti
import taichi.math as tm

LANES = 8  # floats in an AVX2 register; 4 lanes were 1.5 times slower, 16 lanes 1.25 times
COMPONENTS = 4  # x, y, z and a row of zeros: LLVM takes 24 floats apart, number by number, between two blocks; not 32


def single(place) -> bool:
    """Whether this is one place and not eight (asked while compiling)."""
    return len(place.get_shape()) == 1


@ti.func
def each_row(row):
    """A row of eight for each row."""
    return ti.Matrix([[row[k] for k in ti.static(range(LANES))] for _ in ti.static(range(COMPONENTS))])


@ti.func
def dot(a, b):
    """a·b of each place."""
    if ti.static(single(a)):
        return a.dot(b)
    else:
        product = a * b
        return product[0, :] + product[1, :] + product[2, :]


@ti.func
def minus(value):
    """−value; a sign alone is not for what stays whole (`whole.py`)."""
    return value * -1.0


@ti.func
def size_of(value):
    """|value| of each number."""
    return ti.max(value, minus(value))


@ti.func
def in_kind(vector, kind: ti.template()):
    """A vector of three with numbers of another kind; `ti.cast` is not for one that stays whole."""
    return ti.Vector([ti.cast(vector[c], kind) for c in ti.static(range(3))])


@ti.func
def cross(a, b):
    """a×b of each place."""
    if ti.static(single(a)):
        return a.cross(b)
    else:
        x = a[1, :] * b[2, :] - a[2, :] * b[1, :]
        y = a[2, :] * b[0, :] - a[0, :] * b[2, :]
        z = a[0, :] * b[1, :] - a[1, :] * b[0, :]
        return join(x, y, z, a)


@ti.func
def times(place, number):
    """Each place multiplied by its number."""
    if ti.static(single(place)):
        return place * number
    else:
        return place * each_row(number)


@ti.func
def length(place):
    """Distance of each place from the origin."""
    return ti.sqrt(dot(place, place))


@ti.func
def spread(vector: tm.vec3, like):
    """The same vector for each of the places that `like` holds."""
    if ti.static(single(like)):
        return vector
    else:
        return ti.Matrix(
            [
                [vector[c] if ti.static(c < 3) else 0.0 for _ in ti.static(range(LANES))]
                for c in ti.static(range(COMPONENTS))
            ]
        )


@ti.func
def part(place, c: ti.template()):
    """Component c of each place."""
    if ti.static(single(place)):
        return place[c]
    else:
        return place[c, :]


@ti.func
def join(x, y, z, like):
    """Places from their components."""
    if ti.static(single(like)):
        return tm.vec3(x, y, z)
    else:
        still = ti.Vector.zero(ti.f32, LANES)
        return ti.Matrix([[row[k] for k in ti.static(range(LANES))] for row in ti.static((x, y, z, still))])


@ti.func
def choose(condition, a, b):
    """Place a where the condition holds, else b."""
    if ti.static(single(a)):
        return ti.select(condition, a, b)
    else:
        return ti.select(each_row(ti.select(condition, 1.0, 0.0)) > 0.0, a, b)  # a truth of eight has no parts to read


@ti.func
def next_lane(value):
    """Each lane takes the value of the lane after it; the last keeps its own."""
    if ti.static(len(value.get_shape()) == 1):
        return ti.Vector([value[min(k + 1, LANES - 1)] for k in ti.static(range(LANES))])
    else:
        return ti.Matrix(
            [[value[c, min(k + 1, LANES - 1)] for k in ti.static(range(LANES))] for c in ti.static(range(COMPONENTS))]
        )


@ti.func
def from_next(value):
    """Each lane takes the value of the lane after it; the last has zero."""
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
def from_previous(value):
    """Each lane takes the value of the lane before it; the first has zero."""
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
def put_back(value, shifted):
    """`value` after `next_lane` of it was changed to `shifted`; the first lane stays."""
    return ti.Matrix(
        [
            [shifted[c, max(k - 1, 0)] if ti.static(k > 0) else value[c, k] for k in ti.static(range(LANES))]
            for c in ti.static(range(COMPONENTS))
        ]
    )
