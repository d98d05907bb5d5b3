"""The draw list: one lit triangle mesh with everything that a view shows.

Window and rasterizer draw the same mesh. Meshes of the colliders and the pole are built once, in local coordinates.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from ..collision.colliders import PosedCollider, is_deforming, is_static, shape_of
from ..collision.shapes import SPHERE
from ..geometry import closed_surface
from ..geometry.closed_surface import cylinder
from ..geometry.cloth_builder import attachment_ids
from ..scene.collider_schema import Ground
from ..scene.schema import Scene
from ..simulation.copies import FrameError
from ..simulation.simulation import Simulation
from ..state.field_pool import Pool, upload
from . import shading
from .camera import camera_of
from .colors import (
    STRAIN_SCALE,
    Scale,
    distance_scale,
    family_colors,
    marker_radius,
    mean_spring_length,
    pattern_colors,
    rgb,
    round_down_125,
    rounded_up,
)

Floats = NDArray[np.float32]
TriangleSoup = tuple[Floats, Floats, Floats]  # positions, normals and colors of the corners, each (3·T, 3)

POLE_COLOR = (0.36, 0.24, 0.15)


def split_colliders(colliders: list[PosedCollider]) -> tuple[list[int], list[int]]:
    """Return the indices of the static colliders, and of the moving ones.

    Spheres and the ground are in neither list. They are drawn separately: the radius of a sphere can change.
    """
    drawn = [k for k, one in enumerate(colliders) if shape_of(one.collider) is not SPHERE and not is_ground(one)]
    static = [k for k in drawn if is_static(colliders[k].collider)]
    return static, [k for k in drawn if k not in static]


def is_ground(posed: PosedCollider) -> bool:
    return isinstance(posed.collider, Ground)


def collider_color(posed: PosedCollider) -> tuple[float, float, float]:
    """Return the color of a collider, sRGB factors 0…1."""
    return FLOOR_COLOR if is_ground(posed) else shape_of(posed.collider).color


def collider_mesh(posed: PosedCollider) -> TriangleSoup:
    """Return the mesh of a collider other than the ground, relative to its center and axes."""
    shape = shape_of(posed.collider)
    assert shape.triangles is not None
    return with_color(*shape.triangles(posed.collider), shape.color)


def pole_mesh(scene: Scene, start: NDArray[np.float64]) -> TriangleSoup:
    """Return a pole along the top edge of a grid cloth whose start positions are `start`, (N, 3) [m].

    It is 6 % longer than the edge at each end.
    """
    left, right = start[[0, scene.cloth.columns - 1]]
    overhang, radius = 0.06 * (right - left), 0.012 * scene.cloth.width
    return with_color(*cylinder(left - overhang, right + overhang, radius), POLE_COLOR)


def pose_mesh(posed: PosedCollider, local: TriangleSoup) -> TriangleSoup:
    """Transform a mesh from the local coordinates of a collider to world space."""
    positions, normals, colors = local
    rotation = posed.axes.T.astype(np.float32)
    return (positions @ rotation + posed.center).astype(np.float32), normals @ rotation, colors


def with_color(
    positions: NDArray[np.float64], normals: NDArray[np.float64], color: tuple[float, float, float]
) -> TriangleSoup:
    """Return a mesh in a single color."""
    colors = np.tile(np.array(color, np.float32), (len(positions), 1))
    return positions.astype(np.float32), normals.astype(np.float32), colors


@dataclass(eq=False)
class DrawMesh:
    """A triangle soup: corners 3t, 3t + 1 and 3t + 2 belong to triangle t. No triangle is ever culled.

    The fields have room for the largest frame; a frame uses their first `corners` elements: the floor, the solids from
    `solids_from` on, and the cloth from `cloth_from` on. The cloth is lit on the side that faces the eye. Renderers use
    `color` unchanged: it contains all light, so that the window and the rasterizer show the same image.
    """

    position: ti.MatrixField
    """Position in world space [m], float32 vec3 (capacity,)."""
    normal: ti.MatrixField
    """Unit normal, float32 vec3 (capacity,)."""
    albedo: ti.MatrixField
    """Color without light, factors 0…1, float32 vec3 (capacity,)."""
    color: ti.MatrixField
    """Color with light, factors 0…1, float32 vec3 (capacity,)."""
    corners: int = 0
    """Number of corners in use."""
    solids_from: int = 0
    """First corner of the solids."""
    cloth_from: int = 0
    """First corner of the cloth."""


VIEWS = ("shaded", "strain", "error", "wireframe", "particles")
COLORED_VIEWS = ("strain", "error")  # those that color the cloth by a value of each particle

FLOOR_COLOR, GRID_LINE_COLOR = (0.925, 0.92, 0.91), (0.845, 0.84, 0.83)  # colors of the floor and of its grid lines
# Lengths relative to the distance from the eye to the target of the scene's camera.
FLOOR_EXTENT, GRID_EXTENT = 2.4, 1.44  # half the side of the floor, and of the part with grid lines
GRID_SPACING, GRID_LINE_WIDTH = 1 / 8, 2e-3  # of the grid lines; the spacing is rounded down (`round_down_125`)
HORIZONTAL = np.array([1.0, 0.0, 1.0])
SHADOW_EXTENT = 0.95  # half the side of the shadow map
LIT_EDGE = 0.03  # longest edge of a solid: a shadow's soft edge is as wide
GLOSS = 0.35  # strength of the highlight on solids; the cloth has `look.sheen`
STRAIN_VIEW_CONTRAST = 0.45  # contrast of light and shade in the view `strain`, low so that the colors stay readable
PINNED_COLOR, GRABBED_COLOR = (0.85, 0.45, 0.10), (1.0, 0.80, 0.20)  # colors of pinned and of grabbed particles
IN_PLACE = 1e-4  # [longer sides of the cloth] distance of a pin from its place that is none


@dataclass(eq=False)
class ParticleData:
    """Per-particle data that the views need, (N,)."""

    normal: Any
    """Unit normal, vec3."""
    strain: Any
    """Strain that gives its color: in the view `strain` that of largest magnitude among its springs."""


def _allocate_mesh(corners: int) -> DrawMesh:
    return DrawMesh(*(ti.Vector.field(3, ti.f32, corners) for _ in range(4)))


def _allocate_look(particles: int) -> ParticleData:
    return ParticleData(ti.Vector.field(3, ti.f32, particles), ti.field(ti.f32, particles))


_meshes = Pool(_allocate_mesh)
_looks = Pool(_allocate_look)
_shadow_maps: Pool[Any] = Pool(lambda: ti.field(ti.i32, (shading.SHADOW_MAP_SIZE, shading.SHADOW_MAP_SIZE)))


class DrawList:
    """The draw mesh of one simulation; `update` writes the current frame into it. Close it before the simulation.

    Order of the corners: floor, static solids, moving solids, spheres and markers, cloth.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.errors: NDArray[np.float64] | None = None
        """Error of each particle [m], (N,), for the view `error`; None if it was not measured."""
        self.error_frame: int | None = None
        """Number of the frame that had these errors, for the caption of the scale; None if it is the present one."""
        self.other_error = 0.0
        """Largest error of a cloth that is shown beside this one [m]: both have one scale."""
        self._unresolved_error = 0.0  # [m] error that the reference cannot tell from 0, if that of the cloth is smaller
        scene, topology = simulation.scene, simulation.topology
        self._camera = camera_of(scene)
        self._distance = distance = float(np.linalg.norm(np.subtract(self._camera.eye, self._camera.target)))  # [m]
        self._away = np.zeros(3)  # [m] how far floor and shadow map have followed the cloth
        self._sphere, self._marker = (closed_surface.unit_sphere(rings).astype(np.float32) for rings in (24, 8))
        self.pins = marked_pins(simulation)
        """The pins with a marker."""
        self._spring_length = mean_spring_length(topology)
        self._marker_radius = marker_radius(topology)
        self._shadow_frame = ti.math.vec4(*self._camera.target, SHADOW_EXTENT * distance)
        self._floor_extent = FLOOR_EXTENT * distance  # [m] half the side of the floor

        colliders = simulation.colliders()
        self._static, self._moving = split_colliders(colliders)
        self._displaced = False  # whether a static collider was, when it was last drawn
        rigid = (k for k in (*self._static, *self._moving) if not is_deforming(colliders[k].collider))
        self._rigid = {k: shading.divided(collider_mesh(colliders[k]), LIT_EDGE * distance) for k in rigid}
        pole = [shading.divided(pole_mesh(scene, topology.start), LIT_EDGE * distance)] if scene.look.pole else []
        static_meshes = [*pole, *self._pose(colliders, self._static)]
        floor = self._floor()
        self._first_solid = sum(len(p) for p, _, _ in floor)
        self._first_static = self._first_solid + sum(len(p) for p, _, _ in pole)
        self._first_moving = self._first_solid + sum(len(p) for p, _, _ in static_meshes)
        self._first_sphere = self._first_moving + sum(len(p) for p, _, _ in self._pose(colliders, self._moving))
        sphere_corners = len(scene.spheres) * len(self._sphere) + (1 + len(self.pins)) * len(self._marker)
        self._first_cloth = self._first_sphere + sphere_corners
        self._rebuild_topology()
        self.mesh = _meshes.acquire(self._first_cloth + max(self._cloth_corners.values()))
        self.mesh.solids_from, self.mesh.cloth_from = self._first_solid, self._first_cloth
        self._look = _looks.acquire(topology.particle_count)
        self._shadow_map = _shadow_maps.acquire()
        self._fill_meshes(0, floor)
        self._fill_meshes(self._first_solid, static_meshes)

    def close(self) -> None:
        """Release the fields for the next draw list."""
        _meshes.release(self.mesh)
        _looks.release(self._look)
        _shadow_maps.release(self._shadow_map)

    def update(self, view: str, eye: tuple[float, float, float]) -> DrawMesh:
        """Write the current frame in one of `VIEWS`, seen from `eye` [m], and return the mesh."""
        simulation, mesh, cloth = self.simulation, self.mesh, self.simulation.cloth
        if simulation.topology is not self._topology:  # the cloth tore: it has fewer springs and triangles
            self._rebuild_topology()
        positions = simulation.positions()
        self._follow_cloth(positions)
        self._update_spheres(positions)
        displaced = any(row in simulation.displacements for row in self._static)
        colliders = simulation.colliders() if self._moving or displaced or self._displaced else []
        if displaced or self._displaced:
            self._fill_meshes(self._first_static, self._pose(colliders, self._static))
        self._displaced = displaced
        self._fill_meshes(self._first_moving, self._pose(colliders, self._moving))
        first = self._first_cloth
        mesh.corners = first + self._cloth_corners[view]
        shading.particle_normals(cloth, self._look.normal)
        if view == "shaded":
            shading.fill_shaded(cloth, mesh, self._look.normal, first, self._triangle_colors)
        elif view == "strain":
            springs = self._structural_count or simulation.topology.spring_count
            shading.particle_strains(cloth, self._look.strain, springs)
            shading.fill_strain(cloth, mesh, self._look.normal, self._look.strain, first)
        elif view == "error":
            self._fill_errors()
            shading.fill_strain(cloth, mesh, self._look.normal, self._look.strain, first)
        elif view == "wireframe":
            width = 0.06 * self._spring_length
            shading.fill_springs(
                cloth, mesh, first, ti.math.vec3(*eye), width, self._drawn_spring_count, self._spring_colors
            )
        else:
            free = ti.math.vec3(*rgb(simulation.scene.look.color))
            shading.fill_particles(cloth, mesh, first, 0.22 * self._spring_length, free, ti.math.vec3(*PINNED_COLOR))
        self._light(view, ti.math.vec3(*eye))
        return mesh

    def show_error(self, found: FrameError | None, *, is_of_this_frame: bool = False) -> None:
        """Color the cloth by the error of a frame in the view `error`. None: it was not measured.

        Errors that the reference cannot tell from 0 are drawn as 0, on a scale to the smallest one that it can tell.
        """
        self.errors, self.error_frame, self._unresolved_error = None, None, 0.0
        if found is None or not found.reference_has_converged:
            return
        self.errors, self.error_frame = found.by_particle, None if is_of_this_frame else found.frame
        if not found.is_resolved:
            self.errors, self._unresolved_error = np.zeros_like(found.by_particle), 2 * found.reference_error

    def scale(self, view: str) -> Scale | None:
        """Return the color scale of a view, or None if it has none, or if no error was measured."""
        if view == "strain":
            return STRAIN_SCALE
        caption = "" if self.error_frame is None else f"frame {self.error_frame}"
        return distance_scale(self._full_error, caption) if view == "error" and self._full_error else None

    @property
    def _full_error(self) -> float:
        """The error with the full color [m]; 0 if none was measured."""
        largest = max(self.largest_error, self.other_error if self.errors is not None else 0.0)
        return rounded_up(largest) if largest > 0 and np.isfinite(largest) else 0.0

    @property
    def largest_error(self) -> float:
        """The largest error of a particle, or that which the reference can tell from 0 [m]; 0 if none was measured."""
        return 0.0 if self.errors is None else float(self.errors.max(initial=self._unresolved_error))

    def _fill_errors(self) -> None:
        """Write the error of each particle as the strain that has its color, or that it was not measured."""
        strains = np.full(self.simulation.topology.particle_count, shading.UNKNOWN)
        if self.errors is not None:
            strains = shading.FULL_STRAIN * self.errors / (self._full_error or 1.0)
        upload(self._look.strain, strains)

    def _light(self, view: str, eye: object) -> None:
        """Render the shadow map, and light every corner."""
        mesh, shadow_map, frame = self.mesh, self._shadow_map, self._shadow_frame
        shading.clear_shadow_map(shadow_map)
        shading.cast_shadow(mesh, self._first_solid, mesh.corners, shadow_map, frame)
        center = ti.math.vec3(*(self._floor_center() + self._away * HORIZONTAL))
        shading.shade_floor(mesh, self._first_solid, shadow_map, frame, center, self._floor_extent)
        shading.shade_solids(mesh, self._first_solid, self._first_cloth, GLOSS, eye, shadow_map, frame)
        if view in ("shaded", *COLORED_VIEWS):
            gloss, contrast = (
                (self.simulation.scene.look.sheen, 1.0) if view == "shaded" else (0.0, STRAIN_VIEW_CONTRAST)
            )
            shading.shade_cloth(mesh, self._first_cloth, mesh.corners, gloss, contrast, eye, shadow_map, frame)
        else:
            shading.shade_solids(mesh, self._first_cloth, mesh.corners, 0.0, eye, shadow_map, frame)

    def _follow_cloth(self, positions: NDArray[np.float64]) -> None:
        """Move floor and shadow map to a cloth that has left them, by multiples of the spacing of the grid lines."""
        offset = positions.mean(axis=0) - self._camera.target
        if SHADOW_EXTENT * self._distance < np.abs(offset - self._away).max() < np.inf:
            spacing = round_down_125(GRID_SPACING * self._distance)
            self._away = spacing * np.round(offset / spacing)
            self._shadow_frame = ti.math.vec4(*(self._camera.target + self._away), SHADOW_EXTENT * self._distance)
            self._fill_meshes(0, [(x + self._away * HORIZONTAL, n, color) for x, n, color in self._floor()])

    def _update_spheres(self, positions: NDArray[np.float64]) -> None:
        """Write the spheres of the scene, and the markers of the first grabbed particle and of pins.

        The marker of the grabbed particle has radius 0 if nothing is grabbed: the mesh has a fixed number of corners.
        """
        simulation = self.simulation
        spheres = simulation.colliders()[: len(simulation.scene.spheres)]
        first = self._first_sphere
        if spheres:
            centers, radii = zip(*((posed.center, posed.size[0]) for posed in spheres), strict=True)
            first = self._fill_spheres(first, self._sphere, centers, radii, [SPHERE.color] * len(spheres))
        grabbed = simulation.grabbed[:1].tolist()
        markers = positions[[*(grabbed or [0]), *self.pins]]
        sizes = [self._marker_radius if grabbed else 0.0, *[self._marker_radius] * len(self.pins)]
        self._fill_spheres(first, self._marker, markers, sizes, [GRABBED_COLOR, *[PINNED_COLOR] * len(self.pins)])

    def _fill_spheres(self, first: int, unit: Floats, centers: object, radii: object, colors: object) -> int:
        """Write copies of a unit sphere from corner `first` on, and return the corner after the last."""
        centers32, radii32, colors32 = (np.array(values, np.float32) for values in (centers, radii, colors))
        shading.fill_spheres(self.mesh, first, unit, centers32, radii32, colors32)
        return first + len(centers32) * len(unit)

    def _fill_meshes(self, first: int, meshes: Iterable[TriangleSoup]) -> None:
        """Write meshes one after another, from corner `first` on."""
        for positions, normals, colors in meshes:
            shading.fill_mesh(self.mesh, first, positions, normals, colors)
            first += len(positions)

    def _pose(self, colliders: list[PosedCollider], rows: list[int]) -> list[TriangleSoup]:
        """Return the meshes of some colliders in world space."""
        return [pose_mesh(colliders[k], self._rigid.get(k) or collider_mesh(colliders[k])) for k in rows]

    # -- floor ---------------------------------------------------------------------------------------------------------

    def _floor(self) -> list[TriangleSoup]:
        """Return the floor and its grid lines below the camera's target; empty without ground."""
        if self.simulation.scene.ground is None:
            return []
        distance = self._distance
        center, lift = self._floor_center(), np.array([0.0, 3e-3 * distance, 0.0])
        spacing = round_down_125(GRID_SPACING * distance)
        parts = (
            (closed_surface.floor_triangles(center, self._floor_extent), FLOOR_COLOR),
            (
                closed_surface.floor_lines(center + lift, GRID_EXTENT * distance, spacing, GRID_LINE_WIDTH * distance),
                GRID_LINE_COLOR,
            ),
        )
        return [with_color(c, np.broadcast_to([0.0, 1.0, 0.0], c.shape), color) for c, color in parts]

    def _floor_center(self) -> NDArray[np.float64]:
        """Return the point of the floor below the camera's target [m], (3,)."""
        scene = self.simulation.scene
        x, _, z = self._camera.target
        return np.array([x, scene.ground.height if scene.ground else 0.0, z])

    # -- colors of the cloth -------------------------------------------------------------------------------------------

    def _rebuild_topology(self) -> None:
        """Update corner counts and colors for the current topology."""
        self._topology = topology = self.simulation.topology
        counts = topology.family_counts
        self._structural_count = counts.get("structural", 0)
        self._drawn_spring_count = self._structural_count + counts.get("shear", 0)
        self._triangle_colors = pattern_colors(topology, self.simulation.scene.look)
        self._spring_colors = family_colors(topology)
        self._cloth_corners = {
            "shaded": 3 * topology.triangle_count,
            **dict.fromkeys(COLORED_VIEWS, 3 * topology.triangle_count),
            "wireframe": 6 * self._drawn_spring_count,
            "particles": 24 * topology.particle_count,
        }


def marked_pins(simulation: Simulation) -> NDArray[np.int64]:
    """Return the pins that have a marker: those that were added, and those of the scene that are not in their place."""
    topology = simulation.topology
    away = np.abs(simulation.positions() - topology.start).max(axis=1) > IN_PLACE * topology.longest_side
    moved = topology.pinned & away & (attachment_ids(simulation.scene, topology) < 0)  # attached ones move as they must
    return np.union1d(simulation.added_pins, np.flatnonzero(moved))
