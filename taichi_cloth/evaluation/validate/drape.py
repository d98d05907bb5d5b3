"""A4.6: Cusick's drape test. A round cloth of 30 cm hangs over a disc of 18 cm and is lit from above.

The drape coefficient is the share of the unsupported ring that is still in the shadow, 100 % for a rigid board. The
disc and a second one on top of it clamp the cloth (BS 5058, ISO 9073-9); here its middle is pinned.

The cloth is a triangle mesh with the weight and bending of a shipped fabric. Its membrane is isotropic. Woven cloth is
not: it can bend in two directions at once because it gives on the bias. The mesh is therefore as stiff in all
directions as the fabric is on the bias; the weight of the overhang is a thousandth of that or less. Leather is stiff in
all directions, and its mesh has at most the stiffness `STIFFEST`: triangles that do not stretch can bend only along
their edges, which stiffens a coarse mesh.

A9.7: one strip droops and swings by its bending on five meshes. The result must not depend on the mesh.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...geometry.spring_model import SpringModel, spring_model
from ...scene.fabric_schema import Fabric
from ...scene.presets import load_preset, with_fabric
from ...scene.schema import Cloth, Forces, Scene
from ...simulation.simulation import Simulation
from .check import (
    Check,
    Timed,
    advance,
    at_most,
    base,
    damped,
    default_solver,
    frequency,
    relative,
    rows_with_limit,
    swing_frames,
)
from .continuum import REST_SECONDS, irregular, mesh_cloth
from .exact import GRAVITY, Floats, cantilever


def rings(radii: Iterable[float]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the points (N, 3) of a level disc around the origin and its triangles (T, 3), counterclockwise from above.

    Ring k has the k-th radius and 6·k points, so that the triangles of evenly spaced rings are nearly equilateral.
    """
    points, faces = [[0.0, 0.0, 0.0]], []
    inner = [0]
    for k, radius in enumerate(radii, 1):
        angle = np.linspace(0, 2 * np.pi, 6 * k, endpoint=False)
        outer = list(range(len(points), len(points) + 6 * k))
        points += [[radius * np.cos(a), 0.0, -radius * np.sin(a)] for a in angle]
        for sector in range(6):
            outside = [outer[(sector * k + n) % len(outer)] for n in range(k + 1)]
            inside = [inner[(sector * (k - 1) + n) % len(inner)] for n in range(k)]
            faces += [[inside[n], outside[n], outside[n + 1]] for n in range(k)]
            faces += [[inside[n], outside[n + 1], inside[n + 1]] for n in range(k - 1)]
        inner = outer
    return np.array(points), np.array(faces)


# -- drape test --------------------------------------------------------------------------------------------------------

RADIUS, DISC = 0.15, 0.09  # [m]
# Published drape coefficients [%]: cotton 68.4 measured by Gan 1991; leather Memon et al., Materials 2021, 14, 4553.
PUBLISHED = {"silk": (20.0, 40.0), "cotton": (60.0, 76.0), "denim": (70.0, 90.0), "leather": (47.0, 70.0)}
INSIDE = (0.0, -1.0)  # passes within the published range; no bound is defined for excellent
AT_REST = (0.5, 0.1)  # [%] change of the coefficient in half a second
LINKS = 8  # rings from the disc to the edge
STIFFEST = 5000.0  # largest membrane stiffness, in weights of the overhang, which stretches it by 0.02 %
START_NOISE = 1e-4  # [m] standard deviation of the heights at the start: without it no fold is preferred
DAMPING = 6.0  # [1/s]
HALF = 0.5  # [s] between two measurements of the shadow
REST_CHANGE = 0.1  # [%] change of the coefficient in `HALF` below which the cloth is at rest
MAX_SECONDS = 6.0  # [s] after which the simulation ends, at rest or not
CELL = 5e-4  # [m] cell of the raster on which the shadow is counted


@dataclass(frozen=True, eq=False)
class DrapeResult:
    """The result of a drape test."""

    coefficient: float  # [%]
    change: float
    """Change of the coefficient in the last half second [%]."""
    seconds: float
    """Time until the cloth was at rest [s]."""
    folds: int
    strain: float  # largest strain of the cloth


def drape(solver: str) -> Iterator[Check]:
    """Measure every fabric's drape coefficient. The error is its distance from the published range [%].

    If one fabric takes too long, all are too slow.
    """
    whats = [f"{name}: drape coefficient, published {low:g} to {high:g} [%]" for name, (low, high) in PUBLISHED.items()]
    change = "change of a coefficient in the last half second [%]"

    def measured() -> Iterator[Check]:
        results = [drape_test(name, solver) for name in PUBLISHED]
        for what, (low, high), result in zip(whats, PUBLISHED.values(), results, strict=True):
            nearest = min(max(result.coefficient, low), high)
            yield Check(what, nearest, result.coefficient, abs(result.coefficient - nearest), *INSIDE)
        yield at_most(change, max((one.change for one in results), key=abs), *AT_REST)

    yield from rows_with_limit([*whats, change], *INSIDE, measured)


def drape_test(preset: str, solver: str) -> DrapeResult:
    """Return the drape test of a shipped fabric."""
    with drape_simulation(preset, solver) as simulation:
        return simulate_to_rest(simulation)


@contextmanager
def drape_simulation(
    preset: str, solver: str, links: int = LINKS, membrane: float = 1.0, bending: float = 1.0, seed: int = 0
) -> Iterator[Simulation]:
    """Yield a simulation of a shipped fabric at the start, level but for a little noise.

    `membrane` and `bending` scale its stiffness; `links` is the number of rings outside the disc.
    """
    with tempfile.TemporaryDirectory() as folder:
        cloth = write_mesh(Path(folder, "cloth.obj"), links)
        plain = Scene(cloth=cloth, solver=replace(default_solver(solver), damping=DAMPING))
        scene = with_fabric(plain, preset, plain)
        fabric = isotropic(scene.fabric, membrane * membrane_stiffness(preset))
        fabric = replace(fabric, bending_stiffness=bending * fabric.bending_stiffness)
        with Timed(replace(scene, fabric=fabric)) as simulation:
            start = simulation.topology.start.copy()
            noise = np.random.default_rng(seed).normal(0.0, START_NOISE, len(start))
            start[:, 1] += np.where(simulation.topology.pinned, 0.0, noise)
            simulation.set_state(start)
            yield simulation


def write_mesh(path: Path, links: int) -> Cloth:
    """Write a round mesh with `links` rings of triangles outside the disc, and return its cloth, pinned on the disc."""
    cell = (RADIUS - DISC) / (links + 0.5)  # the cloth bends from half a cell inside the last pinned ring
    pinned_rings = round(DISC / cell + 0.5)
    clamp = DISC + cell / 2
    points, triangles = rings([*np.linspace(0, clamp, pinned_rings + 1)[1:], *(clamp + cell * np.arange(1, links + 1))])
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*point) for point in points]
    lines += ["f {} {} {}".format(*corners) for corners in triangles + 1]
    path.write_text("\n".join(lines), encoding="utf-8")
    pins = tuple(range(1 + 3 * pinned_rings * (pinned_rings + 1)))
    return Cloth(file=path.name, folder=str(path.parent), center=(0.0, 0.0, 0.0), pins=pins)


def membrane_stiffness(preset: str) -> float:
    """Return the membrane stiffness of a shipped fabric [N/m]."""
    fabric = load_preset(preset)
    return min(fabric.bias, STIFFEST * fabric.area_density * GRAVITY * (RADIUS - DISC))


def isotropic(fabric: Fabric, stiffness: float) -> Fabric:
    """Return the fabric with the same stiffness of a strip [N/m] in every direction, and without spring damping."""
    constants = replace(fabric, warp=0.75 * stiffness, weft=0.75 * stiffness, shear=0.375 * stiffness)
    return replace(constants, damping_time=0.0)


def simulate_to_rest(simulation: Simulation) -> DrapeResult:
    """Simulate until the cloth is at rest, and return the result."""
    flat_area = area(simulation.topology.flat[:, [0, 2]], simulation.topology.triangles)
    disc_area = np.pi * DISC**2
    last, change = 100.0, np.inf
    while abs(change) > REST_CHANGE and simulation.seconds < MAX_SECONDS:
        advance(simulation, HALF)
        shadow = shadow_area(simulation.positions()[:, [0, 2]], simulation.topology.triangles, CELL)
        coefficient = 100 * (shadow - disc_area) / (flat_area - disc_area)
        last, change = coefficient, coefficient - last
    return DrapeResult(last, change, simulation.seconds, folds_of(simulation), simulation.metrics().max_strain)


def folds_of(simulation: Simulation) -> int:
    """Return the number of folds: how often the rim moves beyond its mean distance from the middle."""
    flat, x = simulation.topology.flat, simulation.positions()
    rim = np.hypot(flat[:, 0], flat[:, 2]) > RADIUS * (1 - 1e-6)  # in order around the rim
    distance = np.hypot(x[rim, 0], x[rim, 2])
    beyond = distance > distance.mean()
    return int((beyond & ~np.roll(beyond, 1)).sum())


def area(points: Floats, triangles: NDArray[np.integer]) -> float:
    """Return the area [m²] of triangles (T, 3) that do not overlap, from points (N, 2) [m]."""
    return float(np.abs(_twice(points[triangles])).sum() / 2)


def shadow_area(points: Floats, triangles: NDArray[np.integer], cell: float) -> float:
    """Return the area [m²] that triangles (T, 3) of points (N, 2) [m] cover, where overlaps count once.

    It counts the cells of a raster whose centers are covered. No triangle may be much larger than the others.
    """
    corners = points[triangles] / cell
    first = np.floor(corners.min(axis=1))
    size = np.arange(np.ceil(corners.max(axis=1) - first).max() + 1)
    cells = first[:, None, None] + np.stack(np.meshgrid(size, size, indexing="ij"), axis=-1)  # (T, S, S, 2)
    side = np.sign(_twice(corners))
    covered = np.broadcast_to((side != 0)[:, None, None], cells.shape[:-1]).copy()
    for k in range(3):
        edge = (corners[:, (k + 1) % 3] - corners[:, k])[:, None, None]
        offset = cells + 0.5 - corners[:, k][:, None, None]
        covered &= (edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0]) * side[:, None, None] >= 0
    return len(np.unique(cells[covered] @ [2.0**24, 1.0])) * cell**2  # a unique number for each cell


def _twice(corners: Floats) -> Floats:
    """Return twice the signed areas of triangles (T, 3, 2), (T,)."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas: Floats = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return areas


# -- A9.7 a strip on five meshes ---------------------------------------------------------------------------------------

STRIP_LENGTH, STRIP_WIDTH = 0.2, 0.05  # [m]
STRIP_BENDING = 1e-3  # [N·m]
STRIP = Fabric(model="membrane", c11=500.0, c22=500.0, c66=200.0, bend_spring=0.0, bending_stiffness=STRIP_BENDING)
# Cells along and across the strip, displacement of the points between [cells], and seed.
STRIP_MESHES = {
    "8 cells": (8, 2, 0.0, 0),
    "16 cells": (16, 4, 0.0, 0),
    "32 cells": (32, 8, 0.0, 0),
    "16 irregular cells": (16, 4, 0.3, 1),
    "16 others": (16, 4, 0.3, 2),
}
STRIP_TOLERANCE = (2e-2, 1e-2)
BEAM_MODES = (1.8751040687, 4.6940911330)  # roots of cos β·cosh β = −1 (Rayleigh): ω = β²·√(B/σ)/L²
SWING = 0.01  # [lengths] deflection of the free end


def strip_on_meshes(solver: str) -> Iterator[Check]:
    """Measure the droop of a strip and its first two frequencies without gravity, on five meshes."""
    for mesh, shape in STRIP_MESHES.items():
        whats = [f"{mesh}: drop over length", *(f"{mesh}: ω{n} [rad/s]" for n in (1, 2))]
        yield from rows_with_limit(whats, *STRIP_TOLERANCE, partial(_strip_results, solver, whats, *shape))


def _strip_results(solver: str, whats: list[str], along: int, across: int, jitter: float, seed: int) -> Iterator[Check]:
    with strip_mesh(along, across, jitter, seed) as (cloth, share):
        scene = replace(base(solver), cloth=cloth, fabric=STRIP)
        with Timed(damped(scene)) as simulation:
            advance(simulation, REST_SECONDS)
            height = simulation.positions()[:, 1]
        density = scene.cloth.area_density
        drop, _ = cantilever(density * GRAVITY * STRIP_LENGTH**3 / STRIP_BENDING)
        end = share == share.max()
        yield relative(whats[0], drop, float(height[0] - height[end].mean()) / STRIP_LENGTH, *STRIP_TOLERANCE)
        with Timed(replace(scene, forces=Forces(gravity=0.0))) as simulation:
            flat = simulation.topology.start
            for what, mode in zip(whats[1:], BEAM_MODES, strict=True):
                omega = mode**2 * sqrt(STRIP_BENDING / density) / STRIP_LENGTH**2
                shape = SWING * STRIP_LENGTH * beam_shape(mode, share)
                simulation.set_state(flat + np.outer(shape, (0.0, 1.0, 0.0)))
                samples = []
                for _ in range(swing_frames(omega)):
                    simulation.step()
                    samples.append(float((simulation.positions() - flat)[:, 1] @ (simulation.topology.mass * shape)))
                row = relative(what, omega, frequency(samples, omega), *STRIP_TOLERANCE)
                yield row.by_law(COARSE, partial(mesh_error, simulation, shape, omega))


COARSE = "too few cells for a mode: the equations of this mesh have that frequency, in float64"


def mesh_error(simulation: Simulation, shape: Floats, omega: float) -> float:
    """Return the relative difference of `mesh_frequency` from that of the beam [rad/s]."""
    return abs(mesh_frequency(spring_model(simulation.scene, simulation.topology), shape) / omega - 1)


def mesh_frequency(model: SpringModel, shape: Floats) -> float:
    """Return the angular frequency [rad/s] with which a flat mesh without gravity vibrates most like `shape`, (N,).

    `shape` is the displacement of every particle out of the plane, where only bending links resist.
    """
    a, b = model.ends[:, len(model.rest) :]
    stiffness = np.zeros((len(shape), len(shape)))
    for row, column, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
        np.add.at(stiffness, (row, column), sign * model.bending)
    root = np.sqrt(model.mass[model.free])
    squares, modes = np.linalg.eigh(stiffness[model.free][:, model.free] / np.outer(root, root))
    return sqrt(squares[np.abs(modes.T @ (root * shape[model.free])).argmax()])


def beam_shape(mode: float, s: Floats) -> Floats:
    """Return the deflections of a beam that swings in a mode at shares `s` of its length, 1 at the free end."""
    at = mode * np.append(s, 1.0)
    ratio = (np.cosh(mode) + np.cos(mode)) / (np.sinh(mode) + np.sin(mode))
    shape = np.cosh(at) - np.cos(at) - ratio * (np.sinh(at) - np.sin(at))
    shares: Floats = shape[:-1] / shape[-1]
    return shares


@contextmanager
def strip_mesh(along: int, across: int, jitter: float, seed: int) -> Iterator[tuple[Cloth, Floats]]:
    """Yield a level strip whose first two rows are pinned, and how far along its length each point is, 0…1 (N,).

    The length begins half a cell before the second row, as the cloth bends from there.
    """
    points, triangles = irregular(along + 1, across, jitter, seed)
    pins = np.arange(2 * (across + 1))
    points[pins] = irregular(along + 1, across, 0.0, seed)[0][pins]
    cell = STRIP_LENGTH / (along + 0.5)
    points = np.stack([STRIP_WIDTH * points[:, 0], cell * ((along + 1) * (points[:, 1] - 0.5) + 0.5)], axis=1)
    with mesh_cloth(points, triangles, pins) as cloth:
        yield replace(cloth, rotation=(-90.0, 0.0, 0.0)), np.maximum(-points[:, 1] / STRIP_LENGTH, 0.0)
