"""Contact of penetration-free cloth at its thickness, with friction: before the truncation, which it seldom leaves
anything to do.

A contact keeps its direction and its weights through a substep, those at the safe positions, where nothing
intersects: no side has to be remembered. Along that direction the gap is brought to the thickness. Parts that were
nearer at the start separate at `SEPARATION_SPEED`, so that no energy is gained where cloth is pressed together.
Corrections are summed as in `self_collision.py`.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.constraint_math import friction_correction
from ..kernels.integration import project_position
from ..kernels.layout import packet, read_inverse_mass
from ..kernels.step_params import SELF_FRICTION, THICKNESS
from .moving_balls import gather_wanted, measure_rounding
from .pair_geometry import separating_direction, separation_of_any
from .pair_list import set_limits, sum_of_paths, update_pairs
from .self_collision import UNITS, depth_in_units, effective_count, in_units

FLOOR = 20.0  # rounding errors of a position: the least gap that truncation leaves
SEPARATION_SPEED = 0.5  # [m/s] at which parts separate that began a substep within the thickness
ROUNDS = 2  # of corrections in a substep, for solvers that do not iterate
SLACK = 0.25  # thicknesses that the response may move a particle before its ball is too small
MAX_COMPRESSION = 0.5  # of the distance on the flat sheet: the thickness of neighbors is not more


@ti.func
def find_pairs(cloth: ti.template(), data: ti.template(), limits: ti.template(), gap: float, thickness: float):
    """Activate all listed pairs that may come within `gap` [m] in this substep, which is that of `limits`."""
    pairs = ti.static(data.pairs)
    for _ in range(1):
        pairs.active_length[None] = 0
    for k in range(pairs.length[None]):
        if data.longest_path[None] - limits.longest_path[k] > 0:
            paths = sum_of_paths(data, pairs.corners[k])
            if paths - limits.paths[k] > 0:
                look_at_pair(cloth, data, k, gap, thickness, paths)


@ti.func
def look_at_pair(cloth: ti.template(), data: ti.template(), k: int, gap: float, thickness: float, paths: int):
    """Activate a pair that may come within `gap` [m], and note how far its particles may move before the next look."""
    pairs = ti.static(data.pairs)
    corners, kind, n = pairs.corners[k], pairs.kind[k], pairs.normal[k]
    found, weights, apart = 0.0, tm.vec4(0.0), tm.inf
    if is_released(data, corners):
        set_limits(data, pairs.near, k, paths, -1)
        set_limits(data, pairs.close, k, paths, -1)
    else:
        apart = separation_of_any(data, corners, kind, n)
        if not apart > gap:
            n, found, weights = separating_direction(data, corners, kind, n)
            pairs.normal[k] = n
            apart = separation_of_any(data, corners, kind, n)
        set_limits(data, pairs.near, k, paths, margin_of(apart - thickness))
        set_limits(data, pairs.close, k, paths, margin_of(apart - FLOOR * data.rounding[None]))
    if not apart > gap:
        flat, inverse_mass = tm.vec3(0.0), 0.0
        for c in ti.static(range(4)):
            flat += weights[c] * data.flat_position[corners[c]]
            inverse_mass += weights[c] * weights[c] * read_inverse_mass(cloth, corners[c])
        pairs.weights[k], pairs.gap[k], pairs.inverse_mass[k] = weights, found, inverse_mass
        pairs.thickness[k] = ti.min(thickness, MAX_COMPRESSION * flat.norm())
        pairs.active[ti.atomic_add(pairs.active_length[None], 1)] = k


@ti.func
def is_released(data: ti.template(), corners: tm.ivec4) -> int:
    marks = data.released[corners[0]] + data.released[corners[1]]
    return marks + data.released[corners[2]] + data.released[corners[3]]


@ti.func
def margin_of(length: float) -> int:
    """Return a length [m] in micrometers, rounded down; −1 if it is not positive."""
    return ti.select(length > 0.0, ti.cast(1e6 * ti.min(ti.max(length, 0.0), 1.0), ti.i32), -1)


@ti.func
def find_layer_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Update the list of pairs, and activate those that may come within the thickness."""
    thickness = ctx.params[THICKNESS]
    measure_rounding(cloth.pair_data)
    gather_wanted(cloth)
    update_pairs(cloth, thickness, SLACK * thickness)
    find_pairs(cloth, cloth.pair_data, cloth.pair_data.pairs.near, thickness, thickness)


@ti.func
def weighted_sum(field: ti.template(), corners: tm.ivec4, weights: tm.vec4) -> tm.vec3:
    total = tm.vec3(0.0)
    for c in ti.static(range(4)):
        total += weights[c] * field[corners[c]]
    return total


@ti.func
def sum_corrections(cloth: ti.template(), ctx: ti.template(), k: int, correct: int):
    """Add the depth of a contact to the sum of each of its particles; or with `correct` add their corrections."""
    data, pairs = ti.static(cloth.pair_data, cloth.pair_data.pairs)
    corners, weights, n = pairs.corners[k], pairs.weights[k], pairs.normal[k]
    gap = weighted_sum(data.x_target, corners, weights)
    goal = ti.max(pairs.gap[k], 0.0) + SEPARATION_SPEED * ctx.h * ctx.dt_scale
    depth = ti.min(goal, pairs.thickness[k]) - n.dot(gap)
    if depth > 0.0 and pairs.inverse_mass[k] > 0.0:
        thickness = ctx.params[THICKNESS]
        units = depth_in_units(depth, thickness)
        if correct == 0:
            for c in ti.static(range(4)):
                if weights[c] != 0.0:
                    ti.atomic_add(data.depth_sum[corners[c]], units)
                    ti.atomic_max(data.max_depth[corners[c]], units)
        else:
            contacts = 1.0
            for c in ti.static(range(4)):
                if weights[c] != 0.0:
                    contacts = ti.max(contacts, effective_count(data.depth_sum[corners[c]], data.max_depth[corners[c]]))
            push = n * depth
            motion = gap - weighted_sum(data.x_safe, corners, weights)
            push += friction_correction(push, motion, ctx.params[SELF_FRICTION])
            unit = UNITS / (thickness * pairs.inverse_mass[k] * contacts)
            for c in ti.static(range(4)):
                factor = weights[c] * read_inverse_mass(cloth, corners[c]) * unit
                ti.atomic_add(data.correction[corners[c]], in_units(push * factor))


@ti.func
def resolve_layer_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Move apart what is closer than the thickness, one Jacobi iteration."""
    data = ti.static(cloth.pair_data)
    gather_wanted(cloth)
    for n in range(data.particle_count[None]):
        i = data.particle[n]
        data.depth_sum[i] = data.max_depth[i] = 0
        data.correction[i] = tm.ivec3(0)
    if ti.static(cloth.is_parallel):
        for correct in ti.static(range(2)):
            for a in range(data.pairs.active_length[None]):
                sum_corrections(cloth, ctx, data.pairs.active[a], correct)
    else:
        for correct in range(2):
            for a in range(data.pairs.active_length[None]):
                sum_corrections(cloth, ctx, data.pairs.active[a], correct)
    unit = ctx.params[THICKNESS] / UNITS
    for i in range(cloth.packet_count[None]):
        project_position(cloth, features, ctx, i, packet(cloth, data.correction, i) * unit)
