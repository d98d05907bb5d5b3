"""The parameters of a frame as one float32 row, and the collider table. A slider changes a number and nothing
recompiles.

An array argument costs 8 µs per launch; a struct or vectors as arguments cost 60–300 µs (Taichi 1.7.4, two x86 cores).
The constants below are columns.
"""

from typing import Any, NamedTuple

import taichi as ti

from ..scene.keys import MAX_POINTS

# Argument types of the row and the table.
param_array = ti.types.ndarray(dtype=ti.f32, ndim=1)
collider_array = ti.types.ndarray(dtype=ti.f32, ndim=2)

GRAVITY = 0  # [m/s²] downward
VELOCITY_FACTOR = 1  # velocity left after the damping of one substep
STIFFNESS_FACTOR = 2  # 0…1, `solver.stiffness`: multiplies the stiffness of every spring
WIND_X, WIND_Y, WIND_Z = 3, 4, 5  # [m/s] mean wind
GUST_SPEED = 6  # [m/s] amplitude of the gusts
DRAG, LIFT = 7, 8  # coefficients
HALF_AIR_DENSITY = 9  # [kg/m³] ½ρ
GUST_PHASE = 10  # 10…12: phase of each gust wave at the start of the frame [turns]
DAMPING_TIME = 13  # [s] damping of a spring over its stiffness
STRAIN_LIMIT = 14
TETHER_SLACK = 15  # max length of a tether over the distance on the flat sheet
THICKNESS, SELF_FRICTION = 16, 17  # [m] of the cloth, and its friction with itself
AREA_DENSITY = 18  # [kg/m²]
COMPRESSION = 19  # stiffness of a shortened spring over that of a stretched one
C11, C22, C12, C16, C26, C66 = 20, 21, 22, 23, 24, 25  # [N/m] tensor of the membrane
CELL_ROWS, CELL_COLUMNS, CELL_AREA = 26, 27, 28  # of a grid: cells per meter along both sides, area of a triangle [m²]
GRABS = 29  # six for each grab: how far it has moved since it began, at both ends of the frame [m]
MAX_GRABS = 8
WEAVE = GRABS + 6 * MAX_GRABS  # five curves: knots and changes of slope (`geometry/weave_model.py`)
CURVE_COLUMNS = 2 * MAX_POINTS
WARP_CURVE, WEFT_CURVE, SHEAR_CURVE, BENDING_CURVES = (WEAVE + k * CURVE_COLUMNS for k in range(4))  # bending has two
PARAM_COUNT = WEAVE + 5 * CURVE_COLUMNS

# Columns of the collider table, which has a row for each collider and then one for each attachment.
COLLIDER_START, COLLIDER_END = 0, 3  # [m] center at both ends of the frame
COLLIDER_ROTATION = 6  # rotation vector of the frame [rad]
COLLIDER_AXES = 9  # 9…17: 3×3 row by row, the collider's own axes at the start of the frame as columns
COLLIDER_SIZE = 18  # 18…20 [m]: see `collision.shapes`
COLLIDER_MARGIN, COLLIDER_FRICTION = 21, 22
COLLIDER_CONTINUOUS = 23  # 1: continuous collision detection
COLLIDER_TRIANGLES = 24  # 1: triangles collide, not only particles
COLLIDER_RESTITUTION = 25
COLLIDER_STIFFNESS = 26  # [N/m³] of a repelling collider
COLLIDER_MARGIN_CHANGE = 27  # [m] change of the margin in the frame
# Center [m] and rotation vector [rad] in the middle of the frame, less the means of those at its ends.
COLLIDER_BEND, COLLIDER_ROTATION_BEND = 28, 31
COLLIDER_COLUMNS = 34

# Three gust waves: frequencies [turns/s] in no simple ratio, so that gusts do not repeat soon (periods 1.3 to 3.1 s),
GUST_FREQUENCIES = (0.43, 0.77, 0.32)
# and wave vectors [turns/m] along x, y, z of plane waves of 2 to 3 m, one for each component of the gust.
GUST_WAVEVECTORS = ((0.31, 0.17, 0.11), (0.13, 0.37, 0.19), (0.23, -0.11, 0.29))


class StepContext(NamedTuple):
    """The arguments of one substep, bundled while compiling; nothing is copied.

    `lines` has two stages in a substep and counts stages instead: `s`, `substeps` and `h` are those of stages.
    """

    s: Any
    """Index of the substep in the frame; for `lines` of the stage."""
    substeps: Any
    """Number of substeps in the frame; for `lines` of stages, two a substep."""
    h: Any
    """Length of the substep [s]; for `lines` half of one."""
    grabbed_count: Any
    """Number of grabbed particles."""
    params: Any
    """The parameter row."""
    colliders: Any
    """The collider table."""
    dt_scale: object = 1.0
    """Time in units of `h` over which a projection moves a particle: a correction changes the velocity by
    move/(h·dt_scale). Other than 1 for `lines` only, whose steps are longer and shorter than a stage."""
    update_velocity: bool = True
    """Whether a projected position changes the velocity."""
