"""Where a cloth goes through itself already, which contact cannot put right: it lets go there, until springs have.

Contact keeps apart what lies apart, and so it holds on the wrong side what was squeezed through. Baraff, Witkin and
Kass 2003 (*Untangling cloth*) find such places by their crossings and do without contact there. Here there is none for
the particles of every edge that goes through a triangle, and of the triangle, from the beginning of a frame to its end.
"""

import taichi as ti

from ..kernels.hashing import sort_into_buckets
from ..kernels.layout import at
from .candidates import STRETCHED, edge_box, triangle_box, visit
from .crossings import are_strangers, crosses


@ti.func
def mark_crossing(cloth: ti.template(), now: ti.template(), n: int, m: int, move: int):
    x, through = ti.static(cloth.x, cloth.near.through)
    a, b, c = cloth.near.triangles[n]
    i, j = cloth.near.edges[m]
    if crosses(at(cloth, x, i), at(cloth, x, j), at(cloth, x, a), at(cloth, x, b), at(cloth, x, c)):
        through[a] = through[b] = through[c] = through[i] = through[j] = 1


@ti.func
def find_tangles(cloth: ti.template(), stages: ti.template(), now: ti.template()):
    """Marks what is through, at the beginning of a frame, where the scene asks for it."""
    if ti.static(stages.untangles):
        on = int(now.s == 0)
        side = 2.0 * cloth.near.longest[None]
        for _ in range(on):
            cloth.near.side[None] = side
            cloth.near.listed_for[None] = 0.0  # the buckets are used for this: what may touch is to be listed anew
        for n in range(on * cloth.near.particle_count[None]):
            cloth.near.through[cloth.near.particle[n]] = 0
        sort_into_buckets(cloth.near.sides, cloth, edge_box, cloth.near.edge_count[None], side, on)
        widest = 0.5 * STRETCHED * cloth.near.longest[None]
        for n in range(on * cloth.near.triangle_count[None]):
            middle, half = triangle_box(cloth, n)
            visit(cloth, now, cloth.near.sides, widest, are_strangers, mark_crossing, n, middle, half, 0)
