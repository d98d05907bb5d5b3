"""Which parts of a cloth may touch soon: pairs of particles, or triangles with particles and edges with edges.

They are listed with some air beyond the thickness (Verlet 1967), and anew only when a particle has moved through half
of it, so that a search by hash serves many substeps. A list that is too short for a cloth that lies all in a heap is
not used: what is in the buckets is then looked at in every substep.
"""

import taichi as ti
import taichi.math as tm

from ..kernels.controls import THICKNESS
from ..kernels.hashing import bucket_of, cube_of, sort_into_buckets
from ..kernels.layout import at
from ..kernels.nearest import nearest_of_segments, nearest_on_triangle
from ..kernels.places import size_of
from .sticking import clear_anchors

AIR, AIR_OF_EDGES = 0.5, 0.2  # of the thickness, and of the longest edge where triangles are asked: the larger
STRETCHED = 1.5  # rest lengths up to which an edge is found
MOST_CUBES = 8  # along each axis in which one triangle looks: what a blow-up has torn is not worth a search without end


@ti.func
def triangle_weights(cloth: ti.template(), n: int, m: int):
    """Weights of particle m and of the corners of triangle n in the gap from its nearest point."""
    a, b, c = cloth.near.triangles[n]
    p = cloth.near.particle[m]
    w = nearest_on_triangle(at(cloth, cloth.x, p), at(cloth, cloth.x, a), at(cloth, cloth.x, b), at(cloth, cloth.x, c))
    return tm.vec4(1.0, -w.x, -w.y, -w.z)


@ti.func
def edge_weights(cloth: ti.template(), n: int, m: int):
    """Weights of the ends of edges n and m in the gap between their nearest points."""
    a, b = cloth.near.edges[n]
    c, d = cloth.near.edges[m]
    s, t = nearest_of_segments(
        at(cloth, cloth.x, a), at(cloth, cloth.x, b), at(cloth, cloth.x, c), at(cloth, cloth.x, d)
    )
    return tm.vec4(1.0 - s, s, t - 1.0, -t)


@ti.func
def are_corner(cloth: ti.template(), n: int, m: int) -> int:
    """Whether particle m is none of triangle n's own."""
    a, b, c = cloth.near.triangles[n]
    p = cloth.near.particle[m]
    return int(p != a and p != b and p != c)


@ti.func
def are_crossing(cloth: ti.template(), n: int, m: int) -> int:
    """Whether edges n and m share no particle, in this order and not in the other."""
    a, b = cloth.near.edges[n]
    c, d = cloth.near.edges[m]
    return int(n < m and a != c and a != d and b != c and b != d)


@ti.func
def particle_place(cloth: ti.template(), n: int):
    return at(cloth, cloth.x, cloth.near.particle[n])


@ti.func
def particle_box(cloth: ti.template(), n: int):
    return particle_place(cloth, n), tm.vec3(0.0)


@ti.func
def edge_box(cloth: ti.template(), n: int):
    i, j = cloth.near.edges[n]
    a, b = at(cloth, cloth.x, i), at(cloth, cloth.x, j)
    return 0.5 * (a + b), 0.5 * size_of(a - b)


@ti.func
def triangle_box(cloth: ti.template(), n: int):
    i, j, k = cloth.near.triangles[n]
    a, b, c = at(cloth, cloth.x, i), at(cloth, cloth.x, j), at(cloth, cloth.x, k)
    low, high = ti.min(a, b, c), ti.max(a, b, c)
    return 0.5 * (low + high), 0.5 * (high - low)


# -- a search ------------------------------------------------------------------------------------------------------


@ti.func
def visit(
    cloth: ti.template(),
    now: ti.template(),
    buckets: ti.template(),
    widest: float,
    fits: ti.template(),
    act: ti.template(),
    n: int,
    middle: tm.vec3,
    half: tm.vec3,
    move: int,
):
    """`act(cloth, now, n, m, move)` for every m whose box met this one when the buckets were filled, and `fits` n.

    `widest`: half the widest box in the buckets [m].
    """
    side = cloth.near.side[None]
    first, last = cube_of(middle - half - widest, side), cube_of(middle + half + widest, side)
    last = ti.min(last, first + MOST_CUBES)
    for cx in range(first.x, last.x + 1):
        for cy in range(first.y, last.y + 1):
            for cz in range(first.z, last.z + 1):
                b = bucket_of(buckets, tm.ivec3(cx, cy, cz))
                for k in range(buckets.first[b], buckets.first[b + 1]):
                    other = buckets.middle[k]
                    if (size_of(other - middle) - buckets.half[k] - half).max() <= 0.0:
                        cube = cube_of(other, side)
                        m = buckets.members[k]
                        # Other cubes have this bucket too.
                        if cube.x == cx and cube.y == cy and cube.z == cz and fits(cloth, n, m):
                            act(cloth, now, n, m, move)


@ti.func
def visit_particles(cloth: ti.template(), now: ti.template(), act: ti.template(), move: int, on: int):
    """Every pair of particles in reach. `on` is 1, or 0 for nothing: parallel loops may not stand under an `if`.

    A particle looks at those behind it in its own cube and into half of the cubes around, so that each pair is met
    once: five rows of cubes along x.
    """
    reach, side = cloth.near.reach[None], cloth.near.side[None]
    for k in range(on * cloth.near.particle_count[None]):  # neighbours in space, so that buckets stay in the cache
        place = cloth.near.points.middle[k]
        own = cube_of(place, side)
        for r in range(5):
            down = ti.select(r < 2, r, r - 3)
            for along in range(ti.select(r == 0, 0, -1), 2):
                cube = own + tm.ivec3(along, down, int(r >= 2))
                b = bucket_of(cloth.near.points, cube)
                start = cloth.near.points.first[b]
                if r == 0 and along == 0:
                    start = k + 1
                for other in range(start, cloth.near.points.first[b + 1]):
                    away = cloth.near.points.middle[other] - place
                    if away.dot(away) < reach * reach and all(cube_of(cloth.near.points.middle[other], side) == cube):
                        act(cloth, now, cloth.near.points.members[k], cloth.near.points.members[other], move)


@ti.func
def visit_corners(cloth: ti.template(), now: ti.template(), act: ti.template(), move: int, on: int):
    """Every triangle and every particle near it."""
    for n in range(on * cloth.near.triangle_count[None]):
        middle, half = triangle_box(cloth, n)
        visit(cloth, now, cloth.near.points, 0.0, are_corner, act, n, middle, half + cloth.near.reach[None], move)


@ti.func
def visit_edges(cloth: ti.template(), now: ti.template(), act: ti.template(), move: int, on: int):
    """Every pair of edges."""
    widest = 0.5 * STRETCHED * cloth.near.longest[None]
    for n in range(on * cloth.near.edge_count[None]):
        middle, half = edge_box(cloth, n)
        visit(cloth, now, cloth.near.sides, widest, are_crossing, act, n, middle, half + cloth.near.reach[None], move)


# -- the lists -----------------------------------------------------------------------------------------------------


@ti.func
def append(found: ti.template(), n: int, m: int):
    """Two numbers more; past the end they are only counted."""
    k = ti.atomic_add(found.count[None], 1)
    if k < ti.static(found.rows.shape[0]):
        found.rows[k] = tm.ivec2(n, m)


@ti.func
def list_pair(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int):
    append(cloth.near.pairs, n, m)


@ti.func
def list_corner(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int):
    a, b, c = cloth.near.triangles[n]
    p = cloth.near.particle[m]
    w = triangle_weights(cloth, n, m)
    foot = w.y * at(cloth, cloth.x, a) + w.z * at(cloth, cloth.x, b) + w.w * at(cloth, cloth.x, c)
    if (at(cloth, cloth.x, p) + foot).norm() < cloth.near.reach[None]:
        append(cloth.near.corners, n, m)


@ti.func
def list_crossing(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int):
    a, b = cloth.near.edges[n]
    c, d = cloth.near.edges[m]
    w = edge_weights(cloth, n, m)
    gap = w.x * at(cloth, cloth.x, a) + w.y * at(cloth, cloth.x, b)
    gap += w.z * at(cloth, cloth.x, c) + w.w * at(cloth, cloth.x, d)
    if gap.norm() < cloth.near.reach[None]:
        append(cloth.near.crossings, n, m)


@ti.func
def look_whether_stale(cloth: ti.template(), thickness: float):
    """Whether a list is of another thickness, or a particle has moved through half the air since it was made."""
    for _ in range(1):
        cloth.near.stale[None] = int(cloth.near.listed_for[None] != thickness)
    most = 0.5 * (cloth.near.reach[None] - thickness)
    for n in range(cloth.near.particle_count[None]):
        moved = particle_place(cloth, n) - cloth.near.listed_at[n]
        if not moved.dot(moved) <= most * most:
            cloth.near.stale[None] = 1


@ti.func
def list_candidates(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Lists them anew where that is needed."""
    thickness = now.controls[THICKNESS]
    look_whether_stale(cloth, thickness)
    on = cloth.near.stale[None]
    reach = (1.0 + AIR) * thickness
    side = reach
    if ti.static(stages.self_triangles):
        reach = ti.max(reach, thickness + AIR_OF_EDGES * cloth.near.longest[None])
        side = 2.0 * ti.max(reach, cloth.near.longest[None])
    for _ in range(on):
        cloth.near.reach[None] = reach
        cloth.near.listed_for[None] = thickness
        cloth.near.side[None] = side
        cloth.near.pairs.count[None] = 0
        cloth.near.corners.count[None] = 0
        cloth.near.crossings.count[None] = 0
    for n in range(on * cloth.near.particle_count[None]):
        cloth.near.listed_at[n] = particle_place(cloth, n)
    sort_into_buckets(cloth.near.points, cloth, particle_box, cloth.near.particle_count[None], side, on)
    if ti.static(stages.self_triangles):
        sort_into_buckets(cloth.near.sides, cloth, edge_box, cloth.near.edge_count[None], side, on)
        visit_corners(cloth, now, list_corner, 0, on)
        visit_edges(cloth, now, list_crossing, 0, on)
    else:
        visit_particles(cloth, now, list_pair, 0, on)
        if ti.static(stages.sticks):
            clear_anchors(cloth, on * cloth.near.pairs.count[None])


@ti.func
def for_candidates(
    cloth: ti.template(),
    now: ti.template(),
    found: ti.template(),
    visit_all: ti.template(),
    act: ti.template(),
    move: int,
):
    """`act(cloth, now, n, m, move)` for each of a list, or where it is too short for each that a search finds.

    `act` says whether there is a contact; with `move` only those are asked that were one without. For a row of the list
    it is also told which.
    """
    count = found.count[None]
    fits = int(count <= ti.static(found.rows.shape[0]))
    for k in range(fits * count):
        if move == 0:
            found.touching[k] = act(cloth, now, found.rows[k][0], found.rows[k][1], move, k)
        elif found.touching[k]:
            act(cloth, now, found.rows[k][0], found.rows[k][1], move, k)
    visit_all(cloth, now, act, move, 1 - fits)
