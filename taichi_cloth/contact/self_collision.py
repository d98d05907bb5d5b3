"""Keeps a cloth off itself: what is nearer than its thickness is moved apart, with friction.

A contact has up to four particles with weights: a pair of particles (1, −1), a particle and a point of a triangle, or
points of two edges. Σ weight·x is the gap, and Σ weight·x_prev what it was a substep ago: where the two point away from
each other, something went through, and is brought back to its own side. What was not farther apart on the flat sheet
is left alone.

All contacts look at the same places, each moves its particles by its share, and what that comes to is summed in whole
numbers: the result is the same in any order, on any number of threads. Of n contacts of one particle each may give an
n-th only (Macklin et al. 2014, *Unified particle physics*, section 4.2). Here n is the sum of their depths over the
largest, since contacts that hardly touch would weaken one that is deep (a fold sank to a sixth of the thickness), and
the larger of all sides, so that no momentum is gained.

What may come into contact soon is listed with some air (`contact/candidates.py`) and listed anew when something has
moved through half of it: that changes when a search is made, but never which contacts there are.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.controls import SELF_FRICTION, THICKNESS
from ..kernels.layout import at, inverse_mass_at, slot_of
from ..kernels.maths import TINY, friction_slide
from ..kernels.motion import put_right
from ..kernels.places import in_kind
from .candidates import (
    edge_weights,
    for_candidates,
    list_candidates,
    triangle_weights,
    visit_corners,
    visit_edges,
    visit_particles,
)
from .sticking import slid_since

# Whole numbers to a thickness: of moves, and of depths, of which thousands add up.
UNITS, DEPTH_UNITS = 1 << 20, 1 << 12
APART = 1.5  # [m/s] how fast what lies too near is moved apart: at 1.0 the ball of `stack` goes through sheets
NEIGHBOURS = 1.01  # thicknesses apart on the flat sheet: rounding must not make contacts of neighbours


@ti.func
def part(
    cloth: ti.template(),
    now: ti.template(),
    who: ti.template(),
    weight: ti.template(),
    count: ti.template(),
    move: int,
    row: int,
    sticks: ti.template(),
):
    """Counts a contact at each of its `count` particles, or adds to their moves; 0 where there is none.

    With `sticks` friction counts from the anchor that is kept beside a row of the list, where it is one (not −1).
    """
    thickness = now.controls[THICKNESS]
    gap, let_go = tm.vec3(0.0), 0
    for k in ti.static(range(count)):
        gap += weight[k] * at(cloth, cloth.x, who[k])
        let_go |= cloth.near.through[who[k]]
    distance, touching = gap.norm(), 0
    if distance < thickness and let_go == 0:
        gap_before, gap_flat, inverse, crowd = tm.vec3(0.0), tm.vec3(0.0), 0.0, 1.0
        for k in ti.static(range(count)):
            gap_before += weight[k] * at(cloth, cloth.x_prev, who[k])
            gap_flat += weight[k] * cloth.near.flat[who[k]]
            inverse += weight[k] * weight[k] * inverse_mass_at(cloth, who[k])
            crowd = ti.max(crowd, cloth.near.depths[who[k]] / ti.max(ti.cast(cloth.near.deepest[who[k]], ti.f32), 1.0))
        distance_flat = gap_flat.norm()
        if distance_flat > NEIGHBOURS * thickness and inverse > 0.0:
            touching = 1
            side = ti.select(gap.dot(gap_before) < 0.0, -1.0, 1.0)
            depth = thickness - side * distance
            if move == 0:
                for k in ti.static(range(count)):
                    ti.atomic_add(cloth.near.depths[who[k]], ti.cast(depth / thickness * DEPTH_UNITS, ti.i32))
                    ti.atomic_max(cloth.near.deepest[who[k]], ti.cast(depth / thickness * DEPTH_UNITS, ti.i32))
            else:
                apart = side * gap / ti.max(distance, TINY)
                if distance < 1e-4 * thickness:  # at one and the same point: the flat sheet says which way is apart
                    apart = gap_flat / distance_flat
                motion = gap - gap_before
                wanted = ti.max(APART * now.h * now.lasts - apart.dot(motion), 0.0)
                push = apart * ti.min(depth, wanted)
                slid = motion + push
                if ti.static(sticks):  # noqa: SIM102 (of the two only this one is known while compiling)
                    if row >= 0:
                        slid += slid_since(cloth.anchors, now, row, apart, gap_before, push)
                push += friction_slide(push, slid, now.controls[SELF_FRICTION])
                unit = UNITS / (thickness * inverse * crowd)
                for k in ti.static(range(count)):
                    share = weight[k] * inverse_mass_at(cloth, who[k]) * unit
                    ti.atomic_add(cloth.near.moves[who[k]], in_kind(ti.round(push * share), ti.i32))
    return touching


@ti.func
def part_particles(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int, row: int = -1):
    who = tm.ivec2(cloth.near.particle[n], cloth.near.particle[m])
    return part(cloth, now, who, tm.vec2(1.0, -1.0), 2, move, row, False)


@ti.func
def part_sticking(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int, row: int = -1):
    who = tm.ivec2(cloth.near.particle[n], cloth.near.particle[m])
    return part(cloth, now, who, tm.vec2(1.0, -1.0), 2, move, row, True)


@ti.func
def part_triangle(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int, row: int = -1):
    """Triangle n and particle m."""
    a, b, c = cloth.near.triangles[n]
    p = cloth.near.particle[m]
    return part(cloth, now, tm.ivec4(p, a, b, c), triangle_weights(cloth, n, m), 4, move, row, False)


@ti.func
def part_edges(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int, row: int = -1):
    a, b = cloth.near.edges[n]
    c, d = cloth.near.edges[m]
    return part(cloth, now, tm.ivec4(a, b, c, d), edge_weights(cloth, n, m), 4, move, row, False)


@ti.func
def part_all(cloth: ti.template(), stages: ti.template(), now: ti.template(), move: int):
    if ti.static(stages.self_triangles):
        for_candidates(cloth, now, cloth.near.corners, visit_corners, part_triangle, move)
        for_candidates(cloth, now, cloth.near.crossings, visit_edges, part_edges, move)
    elif ti.static(stages.sticks):
        for_candidates(cloth, now, cloth.near.pairs, visit_particles, part_sticking, move)
    else:
        for_candidates(cloth, now, cloth.near.pairs, visit_particles, part_particles, move)


@ti.func
def keep_apart(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Moves apart what touches, once, where the scene asks for it."""
    if ti.static(stages.self_collision):
        list_candidates(cloth, stages, now)
        for n in range(cloth.near.particle_count[None]):
            cloth.near.depths[cloth.near.particle[n]] = 0
            cloth.near.deepest[cloth.near.particle[n]] = 0
            cloth.near.moves[cloth.near.particle[n]] = tm.ivec3(0)
        if ti.static(cloth.gathers):  # its loops are parallel: they may not stand in another
            for move in ti.static(range(2)):
                part_all(cloth, stages, now, move)
        else:
            for move in range(2):
                part_all(cloth, stages, now, move)
        unit = now.controls[THICKNESS] / UNITS
        for i in range(cloth.slot_count[None]):
            put_right(cloth, stages, now, i, slot_of(cloth, cloth.near.moves, i) * unit)
