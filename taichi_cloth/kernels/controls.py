"""The row of numbers that a frame is steered by. A slider moves one of them and nothing is compiled again.

One float32 row handed over as an array costs 8 µs of a launch; a struct or vectors as arguments cost
60–300 µs (measured, Taichi 1.7.4 on two x86 cores). The names below are its columns.
"""

from typing import Any, NamedTuple

import taichi as ti

# How a kernel takes the row, and a table of colliders.
row = ti.types.ndarray(dtype=ti.f32, ndim=1)
table = ti.types.ndarray(dtype=ti.f32, ndim=2)

GRAVITY = 0  # [m/s²] downwards
KEPT = 1  # share of velocity left after one substep
STIFFNESS = 2  # 0…1, multiplies the stiffness of every family
WIND_X, WIND_Y, WIND_Z = 3, 4, 5  # [m/s] mean wind
GUST = 6  # [m/s] height of the gusts
DRAG, LIFT = 7, 8  # coefficients
HALF_AIR_DENSITY = 9  # [kg/m³] ½ρ
GUST_TURNS = 10  # 10…12: phase of each gust wave at the start of the frame [turns]
DAMPING_TIME = 13  # [s] a spring's dashpot is this times its stiffness
MOST_STRAIN = 14  # of the strain limit
TETHER_SLACK = 15  # how long a tether may be, as a multiple of the flat sheet's distance
THICKNESS, SELF_FRICTION = 16, 17  # [m] of the cloth, and its friction on itself
AREA_DENSITY = 18  # [kg/m²]
COMPRESSION = 19  # share of its constant with which a spring resists being shortened
HANDS = 20  # six for each hand: how far it has gone since it took what it holds, at both ends of the frame [m]
MOST_HANDS = 8
COUNT = HANDS + 6 * MOST_HANDS

# Columns of a row of the table of colliders.
BODY_FROM, BODY_TO = 0, 3  # [m] its middle at both ends of the frame
BODY_TURN = 6  # about this vector, by its length [radians], it turns in the frame
BODY_AXES = 9  # 9…17: 3×3, row by row; its own axes at the start of the frame are the columns
BODY_SIZE = 18  # 18…20 [m]; of a mesh its number among them
BODY_MARGIN, BODY_FRICTION = 21, 22
BODY_SWEPT = 23  # whether the ways are tested too
BODY_TRIANGLES = 24  # whether triangles are
BODY_RESTITUTION = 25  # share of a velocity that is turned round
BODY_STIFFNESS = 26  # [N/m³] of a force that repels
BODY_GROWTH = 27  # [m] of its margin, from the start of the frame to its end
BODY_COLUMNS = 28

# Turns a second of the three gust waves: periods of 1.3 to 3.1 s in no simple ratio, so that no gust repeats soon.
GUST_RATES = (0.43, 0.77, 0.32)
# And turns a metre along x, y, z: plane waves of 2 to 3 m, one for each component of the gust.
GUST_WAVES = ((0.31, 0.17, 0.11), (0.13, 0.37, 0.19), (0.23, -0.11, 0.29))


class Substep(NamedTuple):
    """What steers one substep, bundled while compiling: none of it is copied."""

    s: Any  # its number in the frame
    substeps: Any
    h: Any  # [s] its length
    held: Any  # how many particles hands hold
    controls: Any  # the row above
    bodies: Any  # a row for each collider
    lasts: Any = 1.0  # how many of them contact and tethers act for, in a method of several stages
    pushes: bool = True  # whether velocities take up what they move
