"""Whether a thread of a cloth is about to give way (`mesh/tear.py` says which does)."""

import taichi as ti


@ti.kernel
def longer_than(cloth: ti.template(), threads: int, most: float) -> int:
    """1 where the strain of one of the first `threads` springs is above `most`, else 0."""
    found = 0
    for e in range(threads):
        i, j = cloth.ends[e]
        if (cloth.x[j] - cloth.x[i]).norm() > (1.0 + most) * cloth.rest[e]:
            ti.atomic_max(found, 1)
    return found
