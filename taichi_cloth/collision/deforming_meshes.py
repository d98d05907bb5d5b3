"""Contact of particles with meshes that deform: bodies that walk.

A rigid mesh has a distance grid, a deforming one its triangles. In a frame every vertex moves straight. Each particle
has a ball in which it is expected to move, and a list of the triangles that may come within the margin of that ball;
it is listed anew when a frame begins, when it leaves the ball, and when it has moved far. At the start of a substep the
nearest of its triangles gives a plane, at the margin above the nearest point. The plane moves with that point, and all
projections of the substep use it.

A particle is inside where the angle-weighted normal of the nearest vertex, edge or face points away from it (Bærentzen
and Aanæs 2005).
"""

from collections.abc import Sequence

import numpy as np
import taichi as ti
import taichi.math as tm
from numpy.typing import NDArray

from ..geometry.signed_distance import collider_surface
from ..kernels.constraint_math import TINY, closest_on_triangle, friction_correction
from ..kernels.integration import project_position
from ..kernels.layout import packet, read
from ..kernels.vec import component, dot, scale
from ..scene.collider_schema import Mesh
from ..state.field_pool import upload_all
from ..state.surface_data import CANDIDATES, DeformingSurfaces
from ..system.taichi_runtime import on_cpu
from .colliders import SURFACE_TOLERANCE, PosedCollider, pose_colliders, teleports
from .pair_geometry import are_apart, box_around, pack_box, refit_inner_nodes
from .static_friction import add_friction

MIN_SLACK = 0.004  # [m] that a particle may deviate from its expected motion in a frame
SLACK = 0.25  # of its motion in the frame
LISTED_PATH = 0.1  # [m] of a fast particle, for which triangles are listed at once
ROUNDING = 1e-5  # of the frame

Floats = NDArray[np.float64]


def upload_frame(
    surfaces: DeformingSurfaces,
    meshes: Sequence[Mesh],
    span: tuple[float, float],
    margin_reduction: tuple[Floats, Floats],
    origin: Floats,
    *,
    is_parallel: bool,
) -> None:
    """Set the surfaces of a frame from the deforming meshes of the scene.

    `span`: start and end of the frame [s]. `margin_reduction`: of every mesh at both times [m] (`Depenetration`).
    `origin`: what positions in kernels are relative to [m].
    """
    before, after = (pose_colliders(meshes, seconds) for seconds in span)
    start = [
        _vertices(two if teleports(mesh, *span) else one, one, origin)
        for mesh, one, two in zip(meshes, before, after, strict=True)
    ]
    margins = np.array([mesh.margin for mesh in meshes])
    upload_all(
        (surfaces.start, np.concatenate(start)),
        (surfaces.end, np.concatenate([_vertices(posed, posed, origin) for posed in after])),
        (surfaces.margin_start, margins - margin_reduction[0]),
        (surfaces.margin_end, margins - margin_reduction[1]),
        (surfaces.friction, np.array([mesh.friction for mesh in meshes])),
    )
    # Particles that are let out are as deep as the margin is reduced.
    surfaces.reach[None] = float(np.maximum(margins, margin_reduction[0] - margins).max())
    begin_frame(surfaces, is_parallel)


def _vertices(posed: PosedCollider, shape: PosedCollider, origin: Floats) -> Floats:
    """Return the vertices of the shape of one posed mesh in the pose of another [m], (V, 3)."""
    return collider_surface(shape.collider).vertices @ posed.axes.T + (posed.center - origin)


@ti.func
def corners_at(surfaces: ti.template(), t: int, fraction: float):
    """Return the corners of a triangle after a fraction of the frame."""
    i = surfaces.triangles[t]
    start, end = ti.static(surfaces.start, surfaces.end)
    a = start[i[0]] + fraction * (end[i[0]] - start[i[0]])
    b = start[i[1]] + fraction * (end[i[1]] - start[i[1]])
    c = start[i[2]] + fraction * (end[i[2]] - start[i[2]])
    return a, b, c


@ti.func
def angle(at: tm.vec3, a: tm.vec3, b: tm.vec3) -> float:
    """Return the angle of a triangle at one of its corners [rad]."""
    u, v = a - at, b - at
    return ti.atan2(u.cross(v).norm(), u.dot(v))


@ti.kernel
def begin_frame(surfaces: ti.template(), is_parallel: ti.template()):
    """Find the normals in the middle of a frame, and the bounding tree of all of it."""
    ti.loop_config(serialize=ti.static(not is_parallel and on_cpu()))
    for t in range(surfaces.triangle_count[None]):
        a, b, c = corners_at(surfaces, t, 0.5)
        normal = (b - a).cross(c - a)
        surfaces.face_normal[t] = normal / ti.max(normal.norm(), TINY * TINY)
    ti.loop_config(serialize=ti.static(not is_parallel and on_cpu()))
    for v in range(surfaces.vertex_count[None]):
        total = tm.vec3(0.0)
        for k in range(surfaces.first_face[v], surfaces.first_face[v + 1]):
            t = surfaces.faces[k]
            a, b, c = corners_at(surfaces, t, 0.5)
            i = surfaces.triangles[t]
            weight = angle(a, b, c)
            if i[1] == v:
                weight = angle(b, c, a)
            elif i[2] == v:
                weight = angle(c, a, b)
            total += weight * surfaces.face_normal[t]
        surfaces.vertex_normal[v] = total
    ti.loop_config(serialize=ti.static(not is_parallel and on_cpu()))
    for leaf in range(surfaces.leaf_count[None]):
        first = surfaces.first_triangle[leaf]
        box = box_of(surfaces, first)
        for t in range(first + 1, surfaces.first_triangle[leaf + 1]):
            box = box_around(box, box_of(surfaces, t))
        surfaces.node_boxes[surfaces.node[leaf]] = box
    if ti.static(is_parallel or not on_cpu()):
        refit_inner_nodes(surfaces, True, 1)
    else:
        ti.loop_config(serialize=True)
        for _ in range(1):
            refit_inner_nodes(surfaces, False, 1)


@ti.func
def box_of(surfaces: ti.template(), t: int):
    """Return the moving box around a triangle."""
    a, b, c = corners_at(surfaces, t, 0.0)
    d, e, f = corners_at(surfaces, t, 1.0)
    return pack_box(ti.min(a, b, c), ti.max(a, b, c), ti.min(d, e, f), ti.max(d, e, f))


@ti.func
def find_surface_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Find the plane of each particle for this substep."""
    if ti.static(features.has_surfaces):
        contacts = ti.static(cloth.surface_contacts)
        for n in range(contacts.particle_count[None]):
            i = contacts.particle[n]
            ahead, move = expected_motion(cloth, features, ctx, i)
            end = (ctx.s + 1.0) / ctx.substeps
            deviation = (ahead - contacts.center[i] - end * contacts.travel[i]).norm()
            if ctx.s == 0 or deviation > contacts.radius[i] or end > contacts.until[i]:
                list_triangles(features.surfaces, contacts, i, ahead, move * ctx.substeps, end)
            set_plane(features.surfaces, contacts, i, ahead, end)


@ti.func
def expected_motion(cloth: ti.template(), features: ti.template(), ctx: ti.template(), i: int):
    """Return the position at a layout index at the end of the substep without any force, and the motion to it."""
    x = read(cloth, cloth.x, i)
    move = tm.vec3(0.0)
    if ti.static(features.stores_velocity):
        move = read(cloth, cloth.velocity, i) * ctx.h
    else:
        move = x - read(cloth, cloth.x_prev, i)
    return x + move, move


@ti.func
def list_triangles(
    surfaces: ti.template(), contacts: ti.template(), i: int, ahead: tm.vec3, travel: tm.vec3, end: float
):
    """List the triangles that a particle may touch from `end`, a fraction of the frame, on.

    `ahead`: its position then. `travel`: how far it would move in a whole frame [m]. The list is valid to the end of
    the frame, or as long as a fast particle moves by `LISTED_PATH`.
    """
    span = ti.min(1.0 - end, LISTED_PATH / ti.max(travel.norm(), TINY))
    radius = MIN_SLACK + SLACK * span * travel.norm()
    contacts.center[i], contacts.travel[i], contacts.radius[i] = ahead - end * travel, travel, radius
    contacts.until[i], contacts.count[i] = end + span + ROUNDING, 0
    reach, path = surfaces.reach[None] + radius, span * travel
    low, high = ti.min(ahead, ahead + path) - reach, ti.max(ahead, ahead + path) + reach
    box = pack_box(low, high, low, high)
    node, last = 0, surfaces.skip[0]
    while node < last:
        if are_apart(box, surfaces.node_boxes[node]):
            node = surfaces.skip[node]
        else:
            leaf = surfaces.leaf[node]
            if leaf >= 0:
                for t in range(surfaces.first_triangle[leaf], surfaces.first_triangle[leaf + 1]):
                    add_candidate(surfaces, contacts, i, t, ahead + 0.5 * path, end + 0.5 * span, 0.5 * span, reach)
            node += 1


@ti.func
def add_candidate(
    surfaces: ti.template(),
    contacts: ti.template(),
    i: int,
    t: int,
    point: tm.vec3,
    middle: float,
    half: float,
    reach: float,
):
    """List a triangle if it may come within `reach` [m] of a particle between `middle` − `half` and `middle` + `half`.

    `point`: where the particle is in the middle. Times are fractions of the frame.
    """
    a, b, c = corners_at(surfaces, t, middle)
    w = closest_on_triangle(point, a, b, c)
    distance = (w.x * a + w.y * b + w.z * c - point).norm()
    corners = surfaces.triangles[t]
    relative = 0.0  # how far a corner moves in the time `half`, as seen from the particle
    for k in ti.static(range(3)):
        move = surfaces.end[corners[k]] - surfaces.start[corners[k]]
        relative = ti.max(relative, half * (move - contacts.travel[i]).norm())
    if distance < reach + relative:
        first, count = CANDIDATES * i, contacts.count[i]
        place = count
        if count < CANDIDATES:
            contacts.count[i] = count + 1
        else:  # replace the farthest, if it is farther
            place = 0
            for k in range(1, CANDIDATES):
                if contacts.distance[first + k] > contacts.distance[first + place]:
                    place = k
        if count < CANDIDATES or distance < contacts.distance[first + place]:
            contacts.candidates[first + place], contacts.distance[first + place] = t, distance


@ti.func
def set_plane(surfaces: ti.template(), contacts: ti.template(), i: int, point: tm.vec3, fraction: float):
    """Set the plane of a particle from the triangle that is nearest to `point` after a fraction of the frame."""
    contacts.normal[i] = contacts.motion[i] = tm.vec3(0.0)
    contacts.level[i] = tm.vec3(0.0)
    nearest, best, weights, offset = -1, tm.inf, tm.vec3(0.0), tm.vec3(0.0)
    for k in range(CANDIDATES * i, CANDIDATES * i + contacts.count[i]):
        t = contacts.candidates[k]
        a, b, c = corners_at(surfaces, t, fraction)
        w = closest_on_triangle(point, a, b, c)
        away = point - (w.x * a + w.y * b + w.z * c)
        if away.norm_sqr() < best:
            nearest, best, weights, offset = t, away.norm_sqr(), w, away
    if nearest >= 0:
        normal = feature_normal(surfaces, nearest, weights)
        distance = ti.sqrt(best)
        if distance > 1e-7:
            normal = offset / distance * ti.select(offset.dot(normal) < 0.0, -1.0, 1.0)
        a0, b0, c0 = corners_at(surfaces, nearest, 0.0)
        a1, b1, c1 = corners_at(surfaces, nearest, 1.0)
        before = weights.x * a0 + weights.y * b0 + weights.z * c0
        motion = weights.x * a1 + weights.y * b1 + weights.z * c1 - before
        mesh = surfaces.mesh[nearest]
        margin, change = surfaces.margin_start[mesh], surfaces.margin_end[mesh] - surfaces.margin_start[mesh]
        contacts.normal[i], contacts.motion[i] = normal, motion
        level = tm.vec3(normal.dot(before) + margin, normal.dot(motion) + change, surfaces.friction[mesh])
        contacts.level[i] = level


@ti.func
def feature_normal(surfaces: ti.template(), t: int, weights: tm.vec3) -> tm.vec3:
    """Return the unit normal of the vertex, edge or face of a triangle in which a point lies, by its weights."""
    corners, normal = surfaces.triangles[t], surfaces.face_normal[t]
    for k in ti.static(range(3)):
        before, after = ti.static((k + 2) % 3, (k + 1) % 3)
        if weights[before] == 0.0 and weights[after] == 0.0:
            normal = surfaces.vertex_normal[corners[k]]
        elif weights[before] == 0.0 and weights[k] != 0.0 and weights[after] != 0.0:
            normal = surfaces.face_normal[t] + surfaces.face_normal[surfaces.neighbors[t][k]]
    return normal / ti.max(normal.norm(), TINY)


GUESSED_FROM = 16  # triangles, one of which gives the first guess of a distance


@ti.kernel
def greatest_depth(cloth: ti.template(), surfaces: ti.template(), is_parallel: ti.template()) -> ti.f32:
    """Return how deep a particle is below a surface at the end of the frame [m], at least 0."""
    deepest = 0.0
    ti.loop_config(serialize=ti.static(not is_parallel and on_cpu()))
    for i in range(cloth.packet_count[None]):
        ti.atomic_max(deepest, -distance_to_surfaces(surfaces, read(cloth, cloth.x, i)))
    return deepest


@ti.func
def distance_to_surfaces(surfaces: ti.template(), x: tm.vec3) -> float:
    """Return the signed distance from a point to the nearest surface at the end of the frame [m], negative inside."""
    best = tm.inf
    for k in range((surfaces.triangle_count[None] - 1) // GUESSED_FROM + 1):
        best = ti.min(best, (surfaces.end[surfaces.triangles[GUESSED_FROM * k][0]] - x).norm())
    best = 1.001 * best + ROUNDING
    box = pack_box(x - best, x + best, x - best, x + best)
    nearest, weights, away = -1, tm.vec3(0.0), tm.vec3(0.0)
    node, last = 0, surfaces.skip[0]
    while node < last:
        if are_apart(box, surfaces.node_boxes[node]):
            node = surfaces.skip[node]
        else:
            leaf = surfaces.leaf[node]
            if leaf >= 0:
                for t in range(surfaces.first_triangle[leaf], surfaces.first_triangle[leaf + 1]):
                    a, b, c = corners_at(surfaces, t, 1.0)
                    w = closest_on_triangle(x, a, b, c)
                    offset = x - (w.x * a + w.y * b + w.z * c)
                    if offset.norm() < best:
                        best, nearest, weights, away = offset.norm(), t, w, offset
                        box = pack_box(x - best, x + best, x - best, x + best)
            node += 1
    inside = 0
    if nearest >= 0:
        inside = int(away.dot(feature_normal(surfaces, nearest, weights)) < 0.0)
    return ti.select(inside == 1, -best, best)


@ti.func
def project_surface_contacts(cloth: ti.template(), features: ti.template(), ctx: ti.template()):
    """Move every particle to its plane, with Coulomb friction against the motion of the surface."""
    if ti.static(features.has_surfaces):
        contacts = ti.static(cloth.surface_contacts)
        end, fraction = (ctx.s + 1.0) / ctx.substeps, ctx.dt_scale / ctx.substeps
        for i in range(cloth.packet_count[None]):
            x, normal = cloth.x[i], packet(cloth, contacts.normal, i)
            level = packet(cloth, contacts.level, i)
            height = component(level, 0) + component(level, 1) * end
            push = scale(normal, ti.max(height - dot(normal, x), 0.0))
            move = push
            if ti.static(ctx.update_velocity):
                surface = packet(cloth, contacts.motion, i) * fraction
                slide = x + push - cloth.x_prev[i] - surface
                if ti.static(features.friction_sums):
                    gap = dot(normal, x + push) - height
                    touching = ti.select(gap < SURFACE_TOLERANCE, 1.0, 0.0)
                    push_sums, sums = ti.static(cloth.friction_sums.push, cloth.friction_sums.friction)
                    move += add_friction(push_sums, sums, i, push, normal, slide, component(level, 2), touching)
                else:
                    move += friction_correction(push, slide, component(level, 2))
            free = ti.select(cloth.inverse_mass[i] > 0.0, 1.0, 0.0)
            project_position(cloth, features, ctx, i, scale(move, free))
