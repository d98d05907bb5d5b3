"""The lamp's shadow: how near to the lamp the nearest surface is, on a grid of texels across its light.

A `frame` says where the grid lies: its middle in world space [m], and half its side [m].
"""

import taichi as ti
import taichi.math as tm

TO_LAMP = tm.vec3(-0.45991, 0.71986, 0.51990)  # of length 1; at the left, above and in front
ACROSS = tm.vec3(0.74900, 0.0, 0.66257)  # the other two axes of the grid
UP = tm.vec3(0.47696, 0.69412, -0.53917)
SIDE = 256  # texels
STEPS = 2.0**20  # of depth, from one end of the grid's cube to the other
SOFT = 1.25  # [texels] between two taps; four by four of them make the edge of a shadow
OFF = 1.6  # [texels] a place is taken off its surface towards the lamp, lest it shade itself


@ti.func
def on_map(p: tm.vec3, frame: tm.vec4) -> tm.vec3:
    """Column and row [texels] and depth [steps, more is nearer to the lamp] of a point."""
    q = (p - frame.xyz) / frame.w
    return tm.vec3((0.5 + 0.5 * q.dot(ACROSS)) * SIDE, (0.5 + 0.5 * q.dot(UP)) * SIDE, (1.0 + q.dot(TO_LAMP)) * STEPS)


@ti.kernel
def clear(shadow: ti.template()):
    for i, j in shadow:
        shadow[i, j] = 0


@ti.kernel
def cast(mesh: ti.template(), first: int, end: int, shadow: ti.template(), frame: tm.vec4):
    """Leaves in every texel the depth of the nearest of the triangles of corners first … end, 0 where there is none."""
    for t in range(first // 3, end // 3):
        a = on_map(mesh.position[3 * t], frame)
        b = on_map(mesh.position[3 * t + 1], frame)
        c = on_map(mesh.position[3 * t + 2], frame)
        # What is not finite becomes the lowest of integers, and an empty range.
        low, high = ti.cast(tm.min(a, b, c), ti.i32), ti.cast(tm.max(a, b, c), ti.i32)
        area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)
        if ti.abs(area) > 1e-6:
            for i in range(ti.max(low.x, 0), ti.min(high.x, SIDE - 1) + 1):
                for j in range(ti.max(low.y, 0), ti.min(high.y, SIDE - 1) + 1):
                    x, y = i + 0.5 - a.x, j + 0.5 - a.y
                    v = (x * (c.y - a.y) - y * (c.x - a.x)) / area
                    w = (y * (b.x - a.x) - x * (b.y - a.y)) / area
                    if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
                        ti.atomic_max(shadow[i, j], int(a.z + v * (b.z - a.z) + w * (c.z - a.z)))


@ti.func
def lamp_share(shadow: ti.template(), frame: tm.vec4, p: tm.vec3, normal: tm.vec3) -> float:
    """Share 0…1 of the lamp's light that gets to p: all of it outside the grid."""
    texel = 2.0 * frame.w / SIDE
    side = 1.0
    if normal.dot(TO_LAMP) < 0.0:
        side = -1.0
    q = on_map(p + OFF * texel * (side * normal + TO_LAMP), frame)
    share = 1.0
    if q.x > 4.0 and q.x < SIDE - 4.0 and q.y > 4.0 and q.y < SIDE - 4.0:
        for i in ti.static(range(4)):
            for j in ti.static(range(4)):
                column = ti.math.clamp(int(q.x + SOFT * (i - 1.5)), 0, SIDE - 1)
                row = ti.math.clamp(int(q.y + SOFT * (j - 1.5)), 0, SIDE - 1)
                if shadow[column, row] > ti.max(int(q.z), 0):
                    share -= 1.0 / 16.0
    return share
