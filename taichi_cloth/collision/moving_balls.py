"""Moving balls of penetration-free contact, one around each particle.

A ball moves at constant velocity for a period of `PERIOD` substeps. While every particle is in its ball, pairs that are
not listed (`pair_list.py`) are farther apart than the thickness. A particle that leaves its ball gets a new one. Since
balls move, relative motion decides what is listed: a sheet that falls or swings as a whole needs no new list.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY
from ..kernels.layout import read

EPSILON = 5e-7  # rounding error of a float32 position over its greatest coordinate, with a margin
MIN_ROUNDING = 1e-6  # [m]
PERIOD = 8  # substeps
MIN_RADIUS, MAX_RADIUS = 0.75, 1.3  # thicknesses
GROW, SHRINK = 1.6, 0.75  # of the radius of a particle that has left its ball, or stayed in it for a period
MIN_REACH = 0.5  # thicknesses
REDUCTION = 0.3  # of the reach of balls when the list is full
ROUNDING = 0.9999  # of a radius


@ti.func
def measure_rounding(data: ti.template()):
    """Set the rounding error of a position."""
    for _ in range(1):
        data.rounding[None] = MIN_ROUNDING
    for n in range(data.particle_count[None]):
        x = data.x_safe[data.particle[n]]
        ti.atomic_max(data.rounding[None], EPSILON * ti.max(ti.abs(x.x), ti.abs(x.y), ti.abs(x.z)))


@ti.func
def gather_wanted(cloth: ti.template()):
    """Copy the positions of the cloth to `x_target`, and add how far they have moved to their paths."""
    data = ti.static(cloth.pair_data)
    longest = 0
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        ti.atomic_max(longest, want(data, i, read(cloth, cloth.x, i)))
    for _ in range(1):
        data.longest_path[None] += longest


@ti.func
def want(data: ti.template(), i: int, x: tm.vec3) -> int:
    """Set the target of a particle, and return how far it has moved [µm]."""
    way = in_micrometers((x - data.x_target[i]).norm())
    data.x_target[i] = x
    data.path[i] += way
    return way


@ti.func
def in_micrometers(length: float) -> int:
    """Return a length [m] in micrometers, rounded up."""
    return ti.cast(ti.ceil(1e6 * ti.min(length, 100.0)), ti.i32)


@ti.func
def is_in_ball(data: ti.template(), i: int, slack: float) -> int:
    """Return whether a particle stays `slack` [m] within its ball from the start to the end of this substep."""
    now = data.center[i] + data.travel[i] * data.age[None]
    reach = ti.max(ROUNDING * data.radius[i] - slack, 0.0)
    inside = (data.x_safe[i] - now).norm_sqr() <= reach * reach
    inside = inside and (data.x_target[i] - now - data.travel[i]).norm_sqr() <= reach * reach
    return int(inside and data.radius[i] > 0.0)


@ti.func
def renew_balls(cloth: ti.template(), thickness: float, slack: float):
    """Give each particle that is not `slack` [m] within its ball a new one, and mark the leaves of its triangles."""
    data, tree = ti.static(cloth.pair_data, cloth.pair_data.tree)
    ended = int(data.age[None] >= PERIOD)
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        expired = ended == 1 and data.travel[i].norm_sqr() > 0.0
        if expired or not is_in_ball(data, i, slack):
            set_ball(data, i, thickness, slack, expired, ti.select(ended == 1, 0, data.age[None]))
            mark_leaves_of(tree, n)
    for _ in range(ended):
        data.age[None] = 0


@ti.func
def set_ball(data: ti.template(), i: int, thickness: float, slack: float, expired: int, age: int):
    """Give a particle a new ball that holds its motion in this substep, and in the rest of the period if it goes on."""
    start, move = data.x_safe[i], data.x_target[i] - data.x_safe[i]
    center, travel, radius = start, 0.5 * (move + data.mean_move[i]), MIN_RADIUS * thickness
    if data.radius[i] > 0.0:
        radius = tm.clamp(data.radius[i] * ti.select(expired, SHRINK, GROW), radius, MAX_RADIUS * thickness)
    radius = ti.max(radius, 1.3 * (move - travel).norm() + slack)
    way = travel.norm() * PERIOD
    if move.norm() > data.shortest_edge[None] or way + radius > data.reach[None]:  # too much is near a way so long
        radius = ti.min(0.5 * move.norm() + MIN_RADIUS * thickness + slack, data.reach[None])
        center = start + move * (0.5 * ti.min(1.0, radius / ti.max(move.norm(), TINY)))
        travel = tm.vec3(0.0)
    elif way < radius:
        travel = tm.vec3(0.0)
    data.radius[i], data.travel[i], data.center[i] = radius, travel, center - travel * age


@ti.func
def shorten_reach(cloth: ti.template(), thickness: float):
    """If the list is full, reduce the reach of all balls. What would leave its ball is held back."""
    data, tree = ti.static(cloth.pair_data, cloth.pair_data.tree)
    full = data.pairs.overflowed[None]
    for _ in range(full):
        data.farthest[None] = 0.0
    for n in range(full * data.particle_count[None]):
        i = data.particle[n]
        ti.atomic_max(data.farthest[None], data.radius[i] + data.travel[i].norm() * PERIOD)
    for _ in range(full):
        reach = ti.min(data.reach[None], data.farthest[None])
        data.reach[None] = ti.max(REDUCTION * reach, MIN_REACH * thickness)
    for n in range(full * data.particle_count[None]):
        set_ball(data, data.particle[n], thickness, 0.0, 0, data.age[None])
        mark_leaves_of(tree, n)


@ti.func
def mark_leaves_of(tree: ti.template(), n: int):
    """Mark the leaves of all triangles of a particle, given by its number."""
    for k in range(tree.first_leaf_of_particle[n], tree.first_leaf_of_particle[n + 1]):
        mark(tree, tree.leaves_of_particle[k])


@ti.func
def mark(tree: ti.template(), leaf: int):
    if ti.atomic_max(tree.marked[leaf], 1) == 0:
        tree.queue[ti.atomic_add(tree.queue_count[None], 1)] = leaf
