"""The guarantee of penetration-free cloth: truncation of every substep's motion, last of all that moves a particle.

Each particle moves from its safe position to its target, or a fraction of the way. Between both parts of a near
pair stand two planes across its separating direction; each part is cut off at its own (Chen et al. 2026, *Divide and
Truncate*, planar bounds). Parts that move together need no cut, though, so planes are tried late: in the first passes a
pair is safe if its gap remains at the fractions found so far, and only what would close it is cut. The last pass, and
the only one that must hold, counts a pair as safe if its gap remains whatever else is cut.

A gap of less than the floor, 20 rounding errors, opens by more than a rounding error or its particles stay where they
are bit for bit: else it would creep shut under pressure.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import TINY
from ..kernels.layout import read, read_inverse_mass, write
from ..kernels.step_params import THICKNESS
from ..state.pair_data import MAX_REACH
from .layer_contact import FLOOR, find_pairs
from .moving_balls import MIN_RADIUS, ROUNDING, gather_wanted, is_in_ball, mark_leaves_of, want
from .pair_geometry import EDGE_EDGE, VERTEX_TRIANGLE, extremes, heights, nearest_weights
from .pair_list import list_marked_leaves, update_pairs

REACH_GROWTH = 1.5  # of the reach of balls in a substep
ROOM = 0.9  # of the gap above the floor that both parts may use
MIN_SHARE = 0.05  # of it for the part that moves less
MIN_GAP = 10.0  # rounding errors: the least distance of parts on their way
WEAK_PASSES = 6
ATTEMPTS = 3  # to list the pairs of particles that lag behind their balls
ADVANCES = 100  # steps of conservative advancement


@ti.func
def truncate_motion(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Let every particle move as far as no part of the cloth passes through another. Not for the parallel layout."""
    data = ti.static(cloth.pair_data)
    begin_truncation(cloth, features, ctx)
    lagging = 1
    for _ in range(ATTEMPTS):
        if lagging:
            activate_close_pairs(cloth, features, ctx)
            offenders = 1
            for k in range(WEAK_PASSES + 1):
                if offenders:
                    run_pass(cloth, k == WEAK_PASSES)
                    offenders = data.offenders[None]
            list_lagging(cloth, features, ctx)
            lagging = data.offenders[None]
    move_by_fractions(cloth, features, ctx)


@ti.func
def begin_truncation(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    gather_wanted(cloth)
    update_pairs(cloth, ctx.params[THICKNESS], 0.0)
    stay_in_balls(cloth)


@ti.func
def run_weak_pass(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    run_pass(cloth, 0)


@ti.func
def run_strict_pass(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    run_pass(cloth, 1)


@ti.func
def list_lagging(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Renew the balls of particles that lag, and list their pairs."""
    renew_lagging_balls(cloth, ctx.params[THICKNESS])
    list_marked_leaves(cloth, ctx.params[THICKNESS])


@ti.func
def activate_close_pairs(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    data = ti.static(cloth.pair_data)
    find_pairs(cloth, data, data.pairs.close, FLOOR * data.rounding[None], ctx.params[THICKNESS])


@ti.func
def move_by_fractions(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    hold_all_if_lagging(cloth)
    apply_truncation(cloth, features, ctx)


# `truncate_motion` in the parallel layout, which cannot end a loop early: phases that are launched one after another.
# As one kernel with all these calls inlined it took 90 s to compile.
TRUNCATION_PHASES = (
    begin_truncation,
    *(activate_close_pairs, *(run_weak_pass,) * WEAK_PASSES, run_strict_pass, list_lagging) * ATTEMPTS,
    move_by_fractions,
)


@ti.kernel
def start_from(cloth: ti.template(), layout: ti.template()):
    """Take the positions of the serial state as safe. Balls and pairs are found anew, whatever was before."""
    data = ti.static(layout.pair_data)
    data.age[None], data.reach[None], data.pairs.overflowed[None] = 0, MAX_REACH, 0
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        data.x_safe[i], data.x_target[i], data.radius[i] = cloth.x[n], cloth.x[n], -1.0
        data.mean_move[i] = tm.vec3(0.0)


@ti.func
def stay_in_balls(cloth: ti.template()):
    """Set every fraction to 1, or for a particle that would leave its ball to where it does: what is not listed may not
    come near. If the list is full, nothing moves."""
    data = ti.static(cloth.pair_data)
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        fraction = 1.0
        if data.pairs.overflowed[None] > 0:
            fraction = 0.0
        elif not is_in_ball(data, i, 0.0):  # a small ball at rest
            start, move = data.x_safe[i] - data.center[i], data.x_target[i] - data.x_safe[i]
            bound = ROUNDING * data.radius[i]
            a, b, c = move.norm_sqr(), start.dot(move), start.norm_sqr() - bound * bound
            fraction = tm.clamp((ti.sqrt(ti.max(b * b - a * c, 0.0)) - b) / ti.max(a, 1e-30) * 0.999, 0.0, 1.0)
        data.fraction[i] = data.next_fraction[i] = fraction


@ti.func
def renew_lagging_balls(cloth: ti.template(), thickness: float):
    """Give a ball at rest to each particle that was held back and lags behind its ball by half the thickness.

    Pairs that are not listed are farther apart than the thickness while all particles are in their balls.
    """
    data = ti.static(cloth.pair_data)
    for _ in range(1):
        data.offenders[None] = 0
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        if data.fraction[i] < 1.0:
            path = data.fraction[i] * (data.x_target[i] - data.x_safe[i])
            end = data.x_safe[i] + path
            lag = (end - data.center[i] - data.travel[i] * (data.age[None] + 1)).norm() - data.radius[i]
            if lag > 0.5 * thickness - FLOOR * data.rounding[None]:
                data.offenders[None] = 1
                data.radius[i] = 0.5 * path.norm() + MIN_RADIUS * thickness
                data.center[i], data.travel[i] = data.x_safe[i] + 0.5 * path, tm.vec3(0.0)
                mark_leaves_of(data.tree, n)


@ti.func
def hold_all_if_lagging(cloth: ti.template()):
    """Hold back everything if a particle still lags after all attempts: its leaves are listed in the next substep."""
    data = ti.static(cloth.pair_data)
    hold = ti.max(data.offenders[None], data.pairs.overflowed[None])
    for n in range(hold * data.particle_count[None]):
        data.fraction[data.particle[n]] = 0.0


@ti.func
def run_pass(cloth: ti.template(), strict: int):
    """Cut the particles of all pairs that would close. `strict`: whatever else is cut."""
    data = ti.static(cloth.pair_data)
    for _ in range(1):
        data.offenders[None] = 0
    for a in range(data.pairs.active_length[None]):
        truncate_pair(data, data.pairs.active[a], strict)
    for n in range(data.particle_count[None]):
        data.fraction[data.particle[n]] = data.next_fraction[data.particle[n]]


@ti.func
def path_is_clear(data: ti.template(), corners: tm.ivec4, kind: int, opening: float) -> int:
    """Return whether the parts of a pair keep a gap on the way to their fractions of the motion.

    Conservative advancement: a distance cannot change faster than the fastest of the corners of one part, as seen from
    those of the other. Parts that tilt past each other keep their distance, but no direction that separates them.
    """
    base = data.x_safe[corners[0]]
    start, path = ti.Matrix.zero(ti.f32, 4, 3), ti.Matrix.zero(ti.f32, 4, 3)
    for c in ti.static(range(4)):
        x = data.x_safe[corners[c]]
        move = data.fraction[corners[c]] * (data.x_target[corners[c]] - x)
        for k in ti.static(range(3)):
            start[c, k], path[c, k] = x[k] - base[k], move[k]
    fastest = 0.0
    for a, b in ti.static(((0, 2), (0, 3), (1, 2), (1, 3), (0, 1))):
        relative = row(path, a) - row(path, b)
        if (
            ti.static(a != 1 and b != 1)
            or (kind == EDGE_EDGE and ti.static(b != 1))
            or (kind != EDGE_EDGE and ti.static(b == 1))
        ):
            fastest = ti.max(fastest, relative.norm_sqr())
    fastest = ti.max(ti.sqrt(fastest), 1e-12)
    min_gap = MIN_GAP * data.rounding[None]
    time, first, last, clear = 0.0, 0.0, 0.0, 1
    for step in range(ADVANCES):
        if time <= 1.0 and clear == 1:
            p = start + ti.min(time, 1.0) * path
            w = nearest_weights(kind, row(p, 0), row(p, 1), row(p, 2), row(p, 3))
            n = w[0] * row(p, 0) + w[1] * row(p, 1) + w[2] * row(p, 2) + w[3] * row(p, 3)
            n /= ti.max(n.norm(), TINY)
            lowest, highest = extremes(kind, tm.vec4([n.dot(row(p, c)) for c in ti.static(range(4))]))
            last = lowest - highest  # the nearest points of a sliver may be wrong: this gap is never too large
            if step == 0:
                first = last
            if last < min_gap:
                clear = 0
            elif time == 1.0:
                time = 2.0
            else:
                time = ti.min(time + 0.99 * ti.max(last - min_gap, 0.0) / fastest, 1.0)
    return int(clear == 1 and time > 1.0 and (first > 1.2 * min_gap or last > first + opening))


@ti.func
def row(matrix: ti.template(), r: ti.template()) -> tm.vec3:
    return tm.vec3(matrix[r, 0], matrix[r, 1], matrix[r, 2])


@ti.func
def truncate_pair(data: ti.template(), k: int, strict: int):
    pairs = ti.static(data.pairs)
    corners, kind, n = pairs.corners[k], pairs.kind[k], pairs.normal[k]
    base, floor = data.x_safe[corners[0]], FLOOR * data.rounding[None]
    start, end = heights(data.x_safe, corners, base, n), heights(data.x_target, corners, base, n)
    for c in ti.static(range(4)):
        end[c] = start[c] + data.fraction[corners[c]] * (end[c] - start[c])
    lowest_start, highest_start = extremes(kind, start)
    lowest_end, highest_end = extremes(kind, end)
    if strict:
        lowest_end, highest_end = ti.min(lowest_start, lowest_end), ti.max(highest_start, highest_end)
    gap = lowest_start - highest_start
    enough = ti.select(gap > floor, floor, gap + data.rounding[None])
    safe = gap > 0.0 and lowest_end - highest_end >= enough
    if not safe and strict == 0:
        safe = path_is_clear(data, corners, kind, data.rounding[None]) == 1
    if not safe:
        if gap <= floor:  # stays bit for bit
            for c in ti.static(range(4)):
                if data.fraction[corners[c]] > 0.0:
                    data.next_fraction[corners[c]] = 0.0
                    data.offenders[None] = 1
        else:
            room = ROOM * (gap - floor)
            moves_a, moves_b = ti.max(lowest_start - lowest_end, 0.0), ti.max(highest_end - highest_start, 0.0)
            share = tm.clamp(moves_a / ti.max(moves_a + moves_b, 1e-30), MIN_SHARE, 1.0 - MIN_SHARE)
            for c in ti.static(range(4)):
                sign = 1.0 if ti.static(c == 0) else -1.0
                limit = -(highest_start + room * (1.0 - share))
                if ti.static(c == 1):
                    sign = ti.select(kind == VERTEX_TRIANGLE, -1.0, 1.0)
                if sign > 0.0:
                    limit = lowest_start - room * share
                cut(data, corners[c], sign * start[c], sign * end[c], limit)
            data.offenders[None] = 1


@ti.func
def cut(data: ti.template(), i: int, start: float, end: float, limit: float):
    """Shorten the motion of a particle that goes from `start` to `end` at its present fraction, to end at `limit`."""
    if end < limit and end < start:
        fraction = data.fraction[i] * ti.max(0.0, (start - limit) / (start - end)) * 0.999999
        ti.atomic_min(data.next_fraction[i], fraction)


@ti.func
def apply_truncation(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Set positions, and velocities that would have led there."""
    data = ti.static(cloth.pair_data)
    longest = 0
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        fraction, end = data.fraction[i], read(cloth, cloth.x, i)
        if fraction < 1.0:
            start = data.x_safe[i]
            target, end = end, start + fraction * (data.x_target[i] - start)
            if fraction <= 0.0:
                end = start
            write(cloth, cloth.x, i, end)
            ti.atomic_max(longest, want(data, i, end))
            if ti.static(features.stores_velocity):
                velocity = read(cloth, cloth.velocity, i) + (end - target) / (ctx.h * ctx.dt_scale)
                if read_inverse_mass(cloth, i) == 0.0:  # a led one may lag far behind its target
                    velocity = (end - start) / (ctx.h * ctx.dt_scale)
                write(cloth, cloth.velocity, i, velocity)
        data.mean_move[i] = 0.5 * data.mean_move[i] + 0.5 * (end - data.x_safe[i])
        data.x_safe[i] = end
    for _ in range(1):
        data.longest_path[None] += longest
        data.age[None] += 1
        data.reach[None] = ti.min(REACH_GROWTH * data.reach[None], MAX_REACH)
