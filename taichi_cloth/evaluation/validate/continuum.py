"""A9: cloth as a membrane. Sheets that are pulled and sheared in their plane, and strips with two bending stiffnesses.

Edges are pinned where they are moved to, without gravity, and the inside comes to rest. The flat sheet stays flat, also
in compression: nothing moves it out of its plane.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import acos, asin, cos, degrees, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene.fabric_schema import Fabric
from ...scene.schema import Cloth, Forces, Scene
from ...simulation.simulation import Simulation
from .check import Check, Timed, advance, at_most, base, damped, relative, rows_with_limit, run_with_limit, substep
from .elasticity import BENDING_CONSTANT, LINKS, WIDTH
from .exact import GRAVITY, Floats, cantilever

TENSOR = {"c11": 2000.0, "c22": 1500.0, "c12": 300.0, "c66": 400.0}  # [N/m] of cloth that none of its threads ties
PATCH = (1e-4, 1e-5)  # A9.1
OLD_GRADIENT = "corrections of a substep follow gradients that they change themselves: up to h²·S/m of a strain"
PULL = (2e-2, 5e-3)  # A9.2: 2 %, 0.5 %
FRAME = (3e-2, 1e-2)  # A9.3: 3 %, 1 %
EXTENSION = (2.0, 1.0)  # [°] A9.4
STRIP_DROOP = (2e-2, 5e-3)  # A9.5: 2 %, 0.5 %
CELLS = 8  # of a sheet, on each side
JITTER = 0.3  # of a cell: how far the vertices of an irregular mesh are from those of a grid
DISTURBED = 1e-3  # [m] standard deviation of the start of all particles that are free
REST_SECONDS = 8.0
MEAN_FRAMES = 60  # of a mean of forces
GRADIENTS = {
    "stretched by 1 %": ((1.01, 0.0), (0.0, 1.0)),
    "stretched by 10 %": ((1.1, 0.0), (0.0, 1.0)),
    "sheared by 1 %": ((1.0, 0.01), (0.0, 1.0)),
    "sheared by 10 %": ((1.0, 0.1), (0.0, 1.0)),
}
PULL_ANGLES = {"the warp": 0.0, "the weft": 90.0, "the bias": 45.0}  # [°] of the warp from the length of the strip
STRIP_ROWS, STRIP_COLUMNS, STRIP_WIDTH = 49, 9, 0.15
PULL_GRAVITY = 100.0  # [m/s²] stretches the strip by about one percent, far above float32
SOFT = 10.0  # [N/m] shear stiffness of cloth whose threads stay as long as they are
FRAME_THREADS, BIAS_THREADS = 1e3 * SOFT, 1e4 * SOFT  # [N/m]; a strip on the bias pulls its threads harder
FRAME_ANGLES = (10.0, 20.0, 30.0, 40.0)  # [°] of shear
EXTENSIONS = (0.05, 0.1, 0.2, 0.3)  # of the distance that its clamps move, over that of two corners of the middle zone
ZONES = ("in the middle", "beside the middle")  # where both threads of a crossing end at free edges, and where one does
ZONE_MARGIN = 0.05  # [m] of triangles from the border of their zone
EXTENSION_STEP, STEP_SECONDS = 0.0025, 0.25  # between two places of the clamps: at once, the threads would buckle
DIAMONDS = 8  # across the width of a strip that is cut on the bias
BENDING = {"warp": 0.05, "weft": 0.2}  # [N·m]


def sheet(solver: str, cloth: Cloth, **keys: float) -> Scene:
    """Return a membrane without gravity and bending that comes to rest. `keys` are keys of the fabric."""
    scene = base(solver)
    constants: dict[str, Any] = TENSOR | keys
    fabric = Fabric(model="membrane", bending_stiffness=0.0, bend_spring=0.0, **constants)
    return damped(replace(scene, cloth=cloth, fabric=fabric, forces=Forces(gravity=0.0)))


def at_rest(simulation: Simulation, start: Floats, deviation: float = DISTURBED) -> Floats:
    """Return the positions at rest (N, 3) [m], with the pinned particles where `start` has them.

    The others start with a random displacement in the plane of x and y, with this standard deviation [m].
    """
    free = ~simulation.topology.pinned
    disturbed = start.copy()
    disturbed[free, :2] += np.random.default_rng(0).normal(0.0, deviation, (int(free.sum()), 2))
    simulation.set_state(disturbed)
    advance(simulation, REST_SECONDS)
    positions: Floats = simulation.positions()
    return positions


def green_strains(points: Floats, triangles: NDArray[np.int64], x: Floats, angle: float = 0.0) -> Floats:
    """Return Green's strain of triangles (T, 3) along axes that are turned by an angle [°], (T, 2, 2).

    `points`: of the flat sheet (N, 2), `x`: of the deformed one (N, 3) [m].
    """
    flat = np.diff(points[triangles], axis=1).transpose(0, 2, 1)  # (T, 2, 2): two sides as columns
    gradient = np.diff(x[triangles], axis=1).transpose(0, 2, 1) @ np.linalg.inv(flat)
    axes = np.array([[cos(radians(angle)), -sin(radians(angle))], [sin(radians(angle)), cos(radians(angle))]])
    strains: Floats = axes.T @ (gradient.transpose(0, 2, 1) @ gradient - np.eye(2)) @ axes / 2
    return strains


def mean_reactions(simulation: Simulation) -> Floats:
    """Return the mean reaction forces of some frames at rest (N, 3) [N]: positions are rounded otherwise in each."""
    forces = []
    for _ in range(MEAN_FRAMES):
        simulation.step()
        forces.append(simulation.reaction_forces())
    mean: Floats = np.mean(forces, axis=0)
    return mean


def deformed(gradient: Floats, flat: Floats) -> Floats:
    """Return the positions (N, 3) [m] that a deformation gradient (2, 2) of the plane leads to."""
    positions: Floats = np.column_stack([flat[:, :2] @ gradient.T, flat[:, 2]])
    return positions


# -- A9.1 patch test ---------------------------------------------------------------------------------------------------


def patch(solver: str) -> Iterator[Check]:
    """Measure the strain of an irregular mesh whose edges are deformed evenly, and the force on one of them.

    The strain is the same in every triangle.
    """
    for name, gradient in GRADIENTS.items():
        whats = [f"{name}: largest error of a strain", f"{name}: force on an edge [N]"]
        yield from rows_with_limit(whats, *PATCH, partial(patched, whats, solver, np.array(gradient)))


def patched(whats: list[str], solver: str, gradient: Floats) -> Iterator[Check]:
    """Measure one deformation of the patch."""
    points, triangles = irregular(CELLS, CELLS, JITTER)
    edges = np.flatnonzero(np.isclose(np.abs(points).max(axis=1), 0.5))
    with mesh_cloth(points, triangles, edges) as cloth, Timed(sheet(solver, cloth)) as simulation:
        flat = simulation.topology.start
        found = green_strains(points, triangles, at_rest(simulation, deformed(gradient, flat)))
        strain, stress = green_strain(gradient), first_piola(gradient, TENSOR)
        moved = (solver == "xpbd") * largest_move(simulation, stress)
        row = at_most(whats[0], float(np.abs(found - strain).max()), *PATCH)
        yield row.by_law(OLD_GRADIENT, moved * largest_turn(strain))
        right = np.isclose(flat[:, 0], 0.5)
        force = mean_reactions(simulation)[right].sum(axis=0)[:2]
        traction = stress[:, 0]  # on an edge of one meter
        error = float(np.linalg.norm(force - traction) / np.linalg.norm(traction))
        row = Check(whats[1], float(np.linalg.norm(traction)), float(np.linalg.norm(force)), error, *PATCH)
        yield row.by_law(OLD_GRADIENT, moved)


def largest_move(simulation: Simulation, stress: Floats) -> float:
    """Return how far a triangle under a stress (2, 2) [N/m] moves a particle in a substep, over the triangle's side."""
    lightest = float(simulation.topology.mass[~simulation.topology.pinned].min())
    return substep(simulation) ** 2 * float(np.abs(stress).max()) / lightest


def largest_turn(strain: Floats) -> float:
    """Return the largest of the components of a strain (2, 2) and the change of the angle between threads [rad]."""
    return max(2 * abs(float(strain[0, 1])), float(np.abs(strain).max()))


def green_strain(gradient: Floats) -> Floats:
    """Return Green's strain (2, 2) of a deformation gradient of the plane (2, 2)."""
    strain: Floats = (gradient.T @ gradient - np.eye(2)) / 2
    return strain


def first_piola(gradient: Floats, tensor: dict[str, float]) -> Floats:
    """Return the force per length of the flat sheet [N/m], (2, 2), with the warp along y."""
    strain = green_strain(gradient)
    along_weft = tensor["c12"] * strain[1, 1] + tensor["c22"] * strain[0, 0]
    along_warp = tensor["c11"] * strain[1, 1] + tensor["c12"] * strain[0, 0]
    shear = 2 * tensor["c66"] * strain[0, 1]
    force: Floats = gradient @ np.array([[along_weft, shear], [shear, along_warp]])
    return force


def irregular(rows: int, columns: int, jitter: float, seed: int = 0) -> tuple[Floats, NDArray[np.int64]]:
    """Return a square of 1 m around the origin: points (N, 2) and triangles (T, 3) of cells with random diagonals.

    The points are in rows from the top. Those inside are displaced by up to `jitter` cells.
    """
    random, side = np.random.default_rng(seed), columns + 1
    row, column = np.divmod(np.arange((rows + 1) * side), side)
    points = np.stack([column / columns - 0.5, 0.5 - row / rows], axis=1)
    inside = (row > 0) & (row < rows) & (column > 0) & (column < columns)
    points[inside] += random.uniform(-jitter, jitter, (int(inside.sum()), 2)) / (columns, rows)
    triangles = []
    for corner in (k * side + n for k in range(rows) for n in range(columns)):
        a, b, c, d = corner, corner + 1, corner + side, corner + side + 1
        triangles += [(a, c, d), (a, d, b)] if random.random() < 0.5 else [(a, c, b), (b, c, d)]
    return points, np.array(triangles)


@contextmanager
def mesh_cloth(points: Floats, triangles: NDArray[np.int64], pins: NDArray[np.int64]) -> Iterator[Cloth]:
    """Yield the cloth of a mesh: points (N, 2) in the plane of x and y [m], triangles (T, 3)."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [f"v {x!r} {y!r} 0" for x, y in points.tolist()]
        lines += ["f {} {} {}".format(*corners) for corners in (triangles + 1).tolist()]
        Path(folder, "mesh.obj").write_text("\n".join(lines), encoding="utf-8")
        yield Cloth(file="mesh.obj", folder=folder, center=(0.0, 0.0, 0.0), pins=tuple(pins.tolist()))


# -- A9.2 strips -------------------------------------------------------------------------------------------------------


def pull(solver: str) -> Iterator[Check]:
    """Measure Young's modulus of strips cut along the warp, the weft and the bias, which hang by their tops."""
    for name, angle in PULL_ANGLES.items():
        what = f"stiffness along {name} [N/m]"
        yield run_with_limit(what, *PULL, partial(pulled, what, solver, angle))


def pulled(what: str, solver: str, angle: float) -> Check:
    """Measure the stress over Green's strain in the middle third of a strip, away from its pins."""
    cloth = Cloth(rows=STRIP_ROWS, columns=STRIP_COLUMNS, width=STRIP_WIDTH, height=1.0, pins=("top",))
    scene = sheet(solver, replace(cloth, center=(0.0, 0.0, 0.0)), warp_angle=angle)
    with Timed(replace(scene, forces=Forces(gravity=PULL_GRAVITY))) as simulation:
        advance(simulation, REST_SECONDS)
        shape = STRIP_ROWS, STRIP_COLUMNS
        carried = simulation.topology.mass.reshape(shape).sum(axis=1)[::-1].cumsum()[::-1][1:]  # [kg] below each row
        middle = simulation.positions().reshape(*shape, 3)[:, STRIP_COLUMNS // 2]
        stretch = np.linalg.norm(np.diff(middle, axis=0), axis=1) * (STRIP_ROWS - 1)
        stress = carried * PULL_GRAVITY / STRIP_WIDTH / stretch  # second Piola-Kirchhoff
        rows = slice(STRIP_ROWS // 3, 2 * STRIP_ROWS // 3)
        measured = float((stress[rows] / (stretch[rows] ** 2 - 1) * 2).mean())
        return relative(what, strip_modulus(TENSOR, angle), measured, *PULL)


# -- A9.3 picture frame ------------------------------------------------------------------------------------------------


def picture_frame(solver: str) -> Iterator[Check]:
    """Measure the force that shears a sheet in a frame of four rods, at whose corners it is pulled."""
    for angle in FRAME_ANGLES:
        what = f"sheared by {angle:g}°: force over length and C66"
        yield run_with_limit(what, *FRAME, partial(framed, what, solver, radians(angle)))


def framed(what: str, solver: str, angle: float) -> Check:
    """Measure the force from the work of the reactions when the angle [rad] grows."""
    cloth = Cloth(rows=CELLS + 1, columns=CELLS + 1, width=1.0, height=1.0, center=(0.0, 0.0, 0.0))
    scene = sheet(solver, replace(cloth, pins=("top", "bottom", "left", "right")), **threads(FRAME_THREADS))
    half = angle / 2
    gradient = np.array([[cos(half), sin(half)], [sin(half), cos(half)]])
    growth = np.array([[-sin(half), cos(half)], [cos(half), -sin(half)]]) / 2  # per radian
    with Timed(scene) as simulation:
        flat = simulation.topology.start
        at_rest(simulation, deformed(gradient, flat))
        power = float((mean_reactions(simulation) * deformed(growth, flat)).sum())  # [N·m] per radian
    # The corners move apart by sin(π/4 − γ/2) for each meter of a rod and each radian.
    return relative(what, picture_frame_force(angle), power / sin(pi / 4 - half) / SOFT, *FRAME)


def threads(stiffness: float) -> dict[str, float]:
    """Return the constants of threads with a stiffness [N/m] that turn easily."""
    return {"c11": stiffness, "c22": stiffness, "c12": 0.0, "c66": SOFT}


# -- A9.4 bias extension -----------------------------------------------------------------------------------------------


def bias_extension(solver: str) -> Iterator[Check]:
    """Measure the angles by which threads turn in a strip on the bias, twice as long as it is wide.

    Threads that do not stretch leave three zones: none turn at the clamps, where both ends of a thread are held, all of
    them turn in the middle, and half as far between these zones.
    """
    whats = [f"pulled by {one:g} of the zone's height: shear {zone} [°]" for one in EXTENSIONS for zone in ZONES]
    yield from rows_with_limit(whats, *EXTENSION, partial(extended, whats, solver))


def extended(whats: list[str], solver: str) -> Iterator[Check]:
    """Measure all extensions of a strip of 0.5 m × 1 m, one after another."""
    points, triangles = diamonds(DIAMONDS, 2 * DIAMONDS, 0.5)
    clamped, names = np.flatnonzero(np.isclose(np.abs(points[:, 1]), 0.5)), iter(whats)
    with mesh_cloth(points, triangles, clamped) as cloth:
        scene = sheet(solver, cloth, warp_angle=45.0, **threads(BIAS_THREADS))
        with Timed(scene) as simulation:
            reached = 0.0
            for extension in EXTENSIONS:
                for one in np.arange(reached, extension, EXTENSION_STEP) + EXTENSION_STEP:
                    x = simulation.positions()
                    x[clamped, 1] = points[clamped, 1] * (1 + one / 2)  # the zone is half as high as the strip
                    simulation.set_state(x)
                    advance(simulation, STEP_SECONDS)
                reached = extension
                advance(simulation, REST_SECONDS)
                for share, zone in zip((1.0, 0.5), zones(points, triangles), strict=True):
                    exact = share * bias_shear(extension)
                    measured = thread_shear(points, triangles[zone], simulation.positions())
                    yield Check(next(names), exact, measured, abs(measured - exact), *EXTENSION)


def zones(points: Floats, triangles: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which triangles are in each of `ZONES`, of a strip twice as long as its width of 0.5 m.

    A thread along x − y = c or x + y = c ends at free edges if |c| < 0.25 m, and else at one clamp. At the clamps both
    threads of a crossing end at the same one: c has different signs.
    """
    x, y = points[triangles].mean(axis=1).T
    falling, rising, margin = np.abs(x + y) - 0.25, np.abs(x - y) - 0.25, ZONE_MARGIN
    free_falling, free_rising = falling < -margin, rising < -margin
    return free_falling & free_rising, (free_falling & (rising > margin)) | (free_rising & (falling > margin))


def thread_shear(points: Floats, triangles: NDArray[np.int64], positions: Floats) -> float:
    """Return the mean angle [°] by which threads at 45° have turned towards each other in triangles."""
    along, shear, _, across = green_strains(points, triangles, positions, 45.0).reshape(-1, 4).T
    sine = float((2 * shear / np.sqrt((1 + 2 * along) * (1 + 2 * across))).mean())
    return degrees(asin(min(max(sine, -1.0), 1.0)))


def diamonds(across: int, along: int, width: float) -> tuple[Floats, NDArray[np.int64]]:
    """Return points (N, 2) [m] around the origin and triangles (T, 3) of a strip whose cells stand on a corner.

    Each cell is two triangles, or one at the border. `across`, `along`: whole cells in its width [m] and its length.
    """
    scale = width / (2 * across)
    sites = [(i, j) for i in range(2 * across + 1) for j in range(2 * along + 1) if (i + j) % 2 == 0]
    number = {site: k for k, site in enumerate(sites)}
    triangles = []
    for i in range(2 * across + 1):
        for j in range(2 * along + 1):
            if (i + j) % 2 == 0:
                continue
            left, right, low, high = (i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)
            halves = [(left, low, high), (low, right, high)] if 0 < j < 2 * along else []
            halves = halves or ([(left, right, high)] if j == 0 else [(left, low, right)])
            triangles += [[number[site] for site in half] for half in halves if all(site in number for site in half)]
    points = (np.array(sites, np.float64) - (across, along)) * scale
    return points, np.array(triangles)


# -- A9.5 bending ------------------------------------------------------------------------------------------------------


def two_cantilevers(solver: str) -> Iterator[Check]:
    """Measure the droop of strips of one cloth, cut along the warp and along the weft."""
    for name, bending in BENDING.items():
        whats = [f"cut along the {name}: drop over length", f"cut along the {name}: reach"]
        yield from rows_with_limit(whats, *STRIP_DROOP, partial(drooped, whats, solver, name == "weft", bending))


def drooped(whats: list[str], solver: str, is_weft: bool, bending: float) -> Iterator[Check]:
    """Measure drop and reach of a strip of one meter, which is clamped level by its first two rows or columns."""
    rows, length = LINKS + 2, (LINKS + 1) / (LINKS + 0.5)  # half of the clamped link belongs to the length
    fabric = Fabric(
        model="membrane",
        c11=BENDING_CONSTANT,
        c22=BENDING_CONSTANT,
        c66=BENDING_CONSTANT,
        bend_spring=0.0,
        bending_stiffness=BENDING["warp"],
        bending_weft=BENDING["weft"],
    )
    shape = (3, rows) if is_weft else (rows, 3)
    width, height = (length, WIDTH) if is_weft else (WIDTH, length)
    indices = np.arange(3 * rows).reshape(shape)
    pins = tuple((indices[:, :2] if is_weft else indices[:2]).ravel().tolist())
    scene = base(solver, *shape, width=width, height=height, pins=pins, rotation=(-90.0, 0.0, 0.0))
    with Timed(damped(replace(scene, fabric=fabric))) as simulation:
        advance(simulation, 10.0)
        x = simulation.positions()[indices]
    middle = x[1] if is_weft else x[:, 1]
    along = np.abs(middle[:, 0 if is_weft else 2] - middle[0, 0 if is_weft else 2])
    drop, reach = cantilever(simulation.scene.cloth.area_density * GRAVITY / bending)
    yield relative(whats[0], drop, float(middle[1, 1] - middle[-1, 1]), *STRIP_DROOP)
    yield relative(whats[1], reach, float(along[-1] - along[1] / 2), *STRIP_DROOP)


# -- closed forms ------------------------------------------------------------------------------------------------------


def strip_modulus(tensor: dict[str, float], angle: float) -> float:
    """Return force per strain and width [N/m] of a strip at an angle [°] to the warp, free to contract sideways.

    1/E = S11·cos⁴ + S22·sin⁴ + (2·S12 + S66)·sin²·cos² with S = C⁻¹. Along the warp E = C11 − C12²/C22.
    """
    c, s = cos(radians(angle)) ** 2, sin(radians(angle)) ** 2
    determinant = tensor["c11"] * tensor["c22"] - tensor["c12"] ** 2
    s11, s22, s12 = tensor["c22"] / determinant, tensor["c11"] / determinant, -tensor["c12"] / determinant
    return 1 / (s11 * c * c + s22 * s * s + (2 * s12 + 1 / tensor["c66"]) * s * c)


def picture_frame_force(angle: float) -> float:
    """Return the force that shears a frame by an angle [rad], over the length of its rods and C66.

    The energy ½·C66·sin²γ of a square meter, with threads that do not stretch, grows by C66·sin γ·cos γ. The corners
    move apart by sin(π/4 − γ/2).
    """
    return sin(angle) * cos(angle) / sin(pi / 4 - angle / 2)


def bias_shear(extension: float) -> float:
    """Return the angle [°] by which the threads of the middle zone turn, for an extension over the zone's height."""
    return degrees(pi / 2 - 2 * acos((1 + extension) / sqrt(2)))
