"""Loops over the springs of a grid in the SIMD layout (`geometry/simd_layout.py`), eight at a time."""

from operator import attrgetter
from typing import Any, NamedTuple

import taichi as ti
import taichi.math as tm

from ..geometry.simd_layout import (
    A_ROW,
    ALONG,
    B_ROW,
    BORDER_COUNT,
    COLOR,
    DIRECTION,
    DOWN,
    EDGE_ROW,
    FIRST,
    FORWARD_STEPS,
    INNER_COUNT,
    LINK_MASK,
    LINK_SHIFT,
    MAX_REACH,
    ROW_CLASSES,
    ROW_MASK,
    ROW_SHIFT,
    STRIDE,
)
from .vec import broadcast, insert_shifted, shift_left_clamped, shift_right


def moved_fields(features: object) -> tuple[str, ...]:
    """Return the fields that a correction of positions changes."""
    return ("x", "velocity") if features.stores_velocity else ("x",)


class PairConstraint(NamedTuple):
    """A constraint between the two ends of a spring, which it moves."""

    apply: Any
    """ti.func(cloth, features, a, b, e, stiffness, params, h)."""
    damping_inputs: tuple[str, ...] = ()
    """Fields that it also reads at both ends if springs are damped. The SIMD layout copies them to its halo."""

    def outputs(self, features: object) -> tuple[str, ...]:
        """Return the fields that it changes at both ends."""
        return moved_fields(features)

    def fields(self, features: object) -> tuple[str, ...]:
        """Return all fields that it uses at both ends."""
        return (*self.outputs(features), "inverse_mass", *(self.damping_inputs if features.spring_damping else ()))


class PairForce(NamedTuple):
    """A quantity that a spring adds to a sum at its end a and subtracts at its end b."""

    force: Any
    """ti.func(cloth, features, a, b, e, stiffness, params, h) that returns it."""
    inputs: tuple[str, ...]
    """Fields that it reads at both ends. The SIMD layout copies them to its halo."""
    target: str
    """Field of the sum."""
    damping_inputs: tuple[str, ...] = ()
    """Fields that it also reads if springs are damped."""

    def fields(self, features: object) -> tuple[str, ...]:
        """Return all fields that it reads at both ends."""
        return (*self.inputs, *(self.damping_inputs if features.spring_damping else ()))


@ti.func
def in_pass(p, y: int):
    """Return whether the springs of row y belong to color pass p."""
    return (y >> p[ROW_SHIFT]) & p[ROW_MASK] == p[COLOR]


@ti.func
def first_packet(p, n: int):
    """Return the packet, in its row, where spring n of a row begins."""
    return p[FIRST] + (n >> p[LINK_SHIFT]) * p[STRIDE] + (n & p[LINK_MASK])


@ti.func
def row_class(y: int, rows: int):
    """Return the class of a row: rows of one class have the same stiffness."""
    kind = y & 1  # EVEN_ROW or ODD_ROW
    if y == 0 or y == rows - 1:
        kind = EDGE_ROW
    return kind


@ti.func
def row_offsets(p, y: int, rows: int, row_stride: int):
    """Return where row y of a pass begins among the first ends, the springs and the stiffnesses."""
    k = (p[DIRECTION] * ROW_CLASSES + row_class(y, rows)) * row_stride
    return (y + p[A_ROW]) * row_stride, (p[DIRECTION] * rows + y) * row_stride, k


@ti.func
def for_each_spring_simd(
    cloth: ti.template(), features: ti.template(), start: int, constraint: ti.template(), params: ti.template(), h
):
    """Apply a constraint to every spring from color pass `start` on, pass by pass.

    There is one loop over the table of passes, because a copy of the body for each direction would take four times as
    long to compile.

    The second end of a spring that crosses the border of a strip is in the next lane. For each column of such springs
    three loops follow each other: shift the second ends into the halo behind the grid, apply the constraint there, and
    shift them back. In a single loop LLVM would process lane after lane.
    """
    rows, row_stride, halo = cloth.rows[None], cloth.row_stride[None], cloth.packet_count[None]
    for s in range(start, cloth.pass_count[None]):
        p = cloth.passes[s]
        for y in range(rows - p[DOWN]):
            if in_pass(p, y):
                a, e, k = row_offsets(p, y, rows, row_stride)
                b = (y + p[B_ROW]) * row_stride + p[ALONG]
                for n in range(p[INNER_COUNT]):
                    i = first_packet(p, n)
                    constraint.apply(cloth, features, a + i, b + i, e + i, cloth.stiffness[k + i], params, h)
        for n in range(p[INNER_COUNT], p[INNER_COUNT] + p[BORDER_COUNT]):
            i = first_packet(p, n)
            source = p[B_ROW] * row_stride + p[ALONG] + i - row_stride
            for y in range(rows - p[DOWN]):
                for name in ti.static(constraint.fields(features)):
                    field = ti.static(getattr(cloth, name))
                    field[halo + y] = shift_left_clamped(field[source + y * row_stride])
            for y in range(rows - p[DOWN]):
                if in_pass(p, y):
                    a, e, k = row_offsets(p, y, rows, row_stride)
                    constraint.apply(cloth, features, a + i, halo + y, e + i, cloth.stiffness[k + i], params, h)
            for y in range(rows - p[DOWN]):
                if in_pass(p, y):
                    for name in ti.static(constraint.outputs(features)):
                        field = ti.static(getattr(cloth, name))
                        at = source + y * row_stride
                        field[at] = insert_shifted(field[at], field[halo + y])


# -- sums: nothing moves, so springs need no colors ------------------------------------------------------------------


@ti.func
def load_halo(cloth: ti.template(), names: ti.template(), target: ti.template(), width: ti.template()):
    """Copy the first `width` columns of every strip, shifted by a lane, into the halo; `target` is zero there."""
    row_stride, halo = cloth.row_stride[None], cloth.packet_count[None]
    sums = ti.static(attrgetter(target)(cloth))
    for y in range(cloth.rows[None]):
        for j in range(width):
            here, there = y * row_stride + j, halo + y * width + j
            for name in ti.static(names):
                field = ti.static(attrgetter(name)(cloth))
                field[there] = shift_left_clamped(field[here])
            sums[there] = broadcast(tm.vec3(0.0), sums[there])


@ti.func
def add_halo(cloth: ti.template(), target: ti.template(), width: ti.template()):
    """Add the sums of the halo to the strips they belong to."""
    row_stride, halo = cloth.row_stride[None], cloth.packet_count[None]
    sums = ti.static(attrgetter(target)(cloth))
    for y in range(cloth.rows[None]):
        for j in range(width):
            here = y * row_stride + j
            sums[here] = sums[here] + shift_right(sums[halo + y * width + j])


@ti.func
def accumulate_simd(cloth: ti.template(), features: ti.template(), pair_force: ti.template(), params: ti.template(), h):
    """Add every spring's quantity to the sums of both ends, in one pass over the grid.

    What a particle gets from the springs that begin at it stays in registers.
    """
    rows, row_stride, halo = cloth.rows[None], cloth.row_stride[None], cloth.packet_count[None]
    load_halo(cloth, ti.static(pair_force.fields(features)), pair_force.target, MAX_REACH)
    sums = ti.static(attrgetter(pair_force.target)(cloth))
    for y in range(rows):
        for i in range(row_stride):
            a = y * row_stride + i
            total = sums[a]
            for d in ti.static(range(len(FORWARD_STEPS))):
                down, along = ti.static(FORWARD_STEPS[d])
                if cloth.used[d] and 0 <= y + down < rows:
                    top = y + ti.static(min(down, 0))
                    k = (d * ROW_CLASSES + row_class(top, rows)) * row_stride + i
                    b = a + down * row_stride + along
                    if i + along >= row_stride:
                        b = halo + (y + down) * MAX_REACH + i + along - row_stride
                    e = (d * rows + top) * row_stride + i
                    force = pair_force.force(cloth, features, a, b, e, cloth.stiffness[k], params, h)
                    total += force
                    sums[b] = sums[b] - force
            sums[a] = total
    add_halo(cloth, pair_force.target, MAX_REACH)
