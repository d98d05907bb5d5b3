"""Dragging cloth or a sphere: pick what is under the cursor, move it, release it.

Distances along a ray are in meters from its origin, infinity for a miss. Ray directions are unit vectors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..collision.colliders import ray_cast
from ..render.camera import NEAR, OrbitCamera
from ..render.colors import mean_spring_length
from ..simulation.events import GrabHandle
from ..simulation.parameter_values import MAX_COORDINATE
from ..simulation.simulation import Simulation

OVERLAP = 1e-9  # in barycentric coordinates: neighboring triangles overlap, so that rounding opens no gap between them
# Default grab radius and upper end of its slider, as fractions of the cloth's longer side. The default grabs one
# particle of a coarse cloth and a patch of a fine one.
GRAB_RADII = 0.02, 0.25
ROWS_OF_TEARING_CLOTH = 2.0  # mean lengths of springs: a single particle would be torn out of the cloth

ROWS_FROM_A_PIN = 1.5  # mean lengths of springs from a pin of the scene within which a free particle is grabbed

Floats = NDArray[np.float64]


def grab_radii(simulation: Simulation) -> tuple[float, float]:
    """Return the default of the grab radius and the upper end of its slider [m]."""
    topology = simulation.topology
    default, largest = (share * topology.longest_side for share in GRAB_RADII)
    if simulation.scene.tearing is not None:
        default = min(max(default, ROWS_OF_TEARING_CLOTH * mean_spring_length(topology)), largest)
    return default, largest


# -- ray casting -------------------------------------------------------------------------------------------------------


def triangle_distances(origin: Floats, direction: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Return the distance [m] along a ray to each of T triangles with corners a, b, c, each (T, 3). Shape (T,).

    Both sides of a triangle count. Möller and Trumbore, "Fast, minimum storage ray-triangle intersection" (1997),
    vectorized over all triangles.
    """
    ab, ac, offset = b - a, c - a, origin - a
    p = np.cross(direction, ac)
    q = np.cross(offset, ab)
    determinant = _dot(ab, p)
    # For a triangle seen exactly edge-on the determinant is 0: the divisions give inf or NaN, which fail the tests.
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = _dot(offset, p) / determinant
        gamma = q @ direction / determinant
        distance = _dot(ac, q) / determinant
        inside = (np.minimum(beta, gamma) >= -OVERLAP) & (beta + gamma <= 1 + OVERLAP) & (distance > 0)
    return np.where(inside, distance, np.inf)


def nearest_eye(camera: OrbitCamera, simulation: Simulation) -> float:
    """Return the distance of the eye from the target [m] at which it is just in front of cloth between them.

    It is negative if there is none. Cloth closer to the eye than the near plane would not be drawn.
    """
    positions, triangles = simulation.positions(), simulation.topology.triangles
    path = camera.target - camera.eye  # distances along it are fractions of it
    fraction = triangle_distances(np.array(camera.eye), path, *(positions[triangles[:, k]] for k in range(3)))
    return camera.distance * (1 - float(fraction.min(initial=np.inf))) + NEAR


def _dot(a: Floats, b: Floats) -> Floats:
    products: Floats = np.einsum("ij,ij->i", a, b)
    return products


# -- picking -----------------------------------------------------------------------------------------------------------

TOLERANCE = 10.0  # [pixels] if the ray hits no triangle, a particle this near is picked: cloth seen edge-on

# From the origin and direction of a ray, the distance [m] along it to the first collider.
PickBlocked = Callable[[Floats, Floats], float]


@dataclass(frozen=True)
class Pick:
    """A particle under the cursor."""

    index: int
    point: tuple[float, float, float]
    """Where the ray hits the cloth, or the position of the particle if it hits none [m]."""
    depth: float
    """Distance of the particle along the view axis [m]."""


def pick_particle(
    camera: OrbitCamera,
    cursor: tuple[float, float],
    size: tuple[int, int],
    positions: Floats,
    triangles: NDArray[np.integer],
    blocked: PickBlocked = lambda origin, direction: np.inf,
) -> Pick | None:
    """Return the particle at a screen point of an image of `size` [pixels], or None. Colliders hide particles.

    The result is the corner of the first triangle on the ray that is nearest to the hit. If the ray hits no triangle,
    the result is the particle nearest on the screen, within `TOLERANCE`.
    """
    aspect = size[0] / size[1]
    origin, direction = camera.ray(*cursor, aspect)
    screen, depth = camera.to_screen(positions, aspect)
    limit = blocked(origin, direction)

    distances = triangle_distances(origin, direction, *(positions[triangles[:, k]] for k in range(3)))
    first = int(distances.argmin()) if len(distances) else -1
    if first >= 0 and np.isfinite(distances[first]):
        if distances[first] > limit:
            return None
        point = origin + distances[first] * direction
        corners = triangles[first]
        index = int(corners[np.linalg.norm(positions[corners] - point, axis=1).argmin()])
        return Pick(index, _vec3(point), float(depth[index]))

    gaps = np.linalg.norm((screen - cursor) * size, axis=1)  # [pixels] on the screen, NaN behind the eye
    for index in (int(i) for i in np.argsort(gaps) if gaps[i] <= TOLERANCE):
        offset = positions[index] - origin
        distance = float(np.linalg.norm(offset))
        if distance < min(limit, blocked(origin, offset / distance)):
            return Pick(index, _vec3(positions[index]), float(depth[index]))
    return None


# -- dragging ----------------------------------------------------------------------------------------------------------


class DragPlane:
    """Maps the cursor to positions of a grabbed particle, on the plane through it parallel to the image.

    The particle keeps the offset from the cursor that it had when it was grabbed, so it does not jump.
    """

    def __init__(self, camera: OrbitCamera, cursor: tuple[float, float], aspect: float, particle: ArrayLike) -> None:
        """`particle`: its position [m], which must be in front of the eye. `aspect`: width over height of the image."""
        self.target = np.asarray(particle, np.float64)
        self._normal = camera.view()[2, :3]
        self._level = float(self._normal @ self.target)
        self._offset = np.zeros(3)
        self._offset = self.target - self.move(camera, cursor, aspect)

    def move(self, camera: OrbitCamera, cursor: tuple[float, float], aspect: float) -> Floats:
        """Return the particle's position for a cursor [m]. It does not change if the cursor's ray misses the plane."""
        origin, direction = camera.ray(*cursor, aspect)
        approach = float(self._normal @ direction)
        gap = self._level - float(self._normal @ origin)
        # The ray misses only if the camera turned away from the plane during the drag.
        if gap * approach > 0:
            self.target = origin + (gap / approach) * direction + self._offset
        return self.target


def _vec3(point: Floats) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])


Cursor = tuple[float, float]  # a screen point
Size = tuple[int, int]  # of the image [pixels]


class HeldSphere:
    """A sphere that is dragged, with the methods of a grab. It stays where it is released, or moves on from there."""

    particles = np.zeros(0, np.int64)  # no cloth is grabbed

    def __init__(self, simulation: Simulation, row: int) -> None:
        """`row`: of the sphere in `colliders()`."""
        self._simulation, self.row = simulation, row
        self._has_moved = False  # until then it has its own motion

    @property
    def center(self) -> Floats:
        """Where the sphere is [m], (3,)."""
        return self._simulation.colliders()[self.row].center

    @property
    def active(self) -> bool:
        """Whether it is still held. A reset releases it."""
        return not self._has_moved or self.row in self._simulation.displacements

    def move_to(self, target: Floats) -> None:
        """Move the sphere toward `target` [m], (3,), by at most its radius in a frame: farther, it jumps over cloth."""
        posed = self._simulation.colliders()[self.row]
        way = target - posed.center
        share = min(1.0, posed.size[0] / max(float(np.linalg.norm(way)), 1e-9))
        self._simulation.move_collider(self.row, posed.center + share * way)
        self._has_moved = True

    def release(self) -> None:
        """Let it go."""


@dataclass
class Drag:
    """A drag in progress."""

    grab: GrabHandle | HeldSphere
    plane: DragPlane
    position: NDArray[np.float64]
    """Position of the grab when the last displayed frame was simulated [m]."""
    moves_pin: bool = False
    """Whether the particle was pinned when the drag began."""


class Dragger:
    """Drags the cloth or a sphere of one simulation with one cursor."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.is_pinned_there = False
        """Whether the last `begin` grabbed nothing because it found only pins of the scene."""
        self._drag: Drag | None = None

    @property
    def drag(self) -> Drag | None:
        """The drag in progress, or None. A reset of the simulation ends it."""
        if self._drag is not None and not self._drag.grab.active:
            self._drag = None
        return self._drag

    @property
    def particle(self) -> int | None:
        """Index of the dragged particle, or None."""
        return None if self.drag is None or not len(self.drag.grab.particles) else int(self.drag.grab.particles[0])

    def begin(self, camera: OrbitCamera, cursor: Cursor, size: Size, radius: float) -> bool:
        """Grab the particle at a screen point and all within a radius [m] of it, or else a sphere. Ends another drag.

        Return False if there is neither at the point, or if the particle is grabbed already. Of pins of the scene the
        nearest free particle is grabbed (`free_particle`); if there is none, `is_pinned_there` becomes true.
        """
        self.end()
        self.is_pinned_there = False
        aspect = size[0] / size[1]
        particle = pick_under_cursor(self.simulation, camera, cursor, size)
        if particle is None:
            row = sphere_under_cursor(self.simulation, camera, cursor, aspect)
            if row is not None:
                center = self.simulation.colliders()[row].center
                self._begin_sphere(row, DragPlane(camera, cursor, aspect, center))
            return row is not None
        if particle in self.simulation.grabbed:
            return False
        particle = free_particle(self.simulation, particle, radius)
        if particle is None:
            self.is_pinned_there = True
            return False
        position = self.simulation.positions()[particle]
        self._begin(particle, DragPlane(camera, cursor, aspect, position), radius)
        return True

    def _begin(self, particle: int, plane: DragPlane, radius: float) -> None:
        position, is_pin = self.simulation.positions()[particle], bool(self.simulation.topology.pinned[particle])
        self._drag = Drag(self.simulation.grab(particle, radius), plane, position, is_pin)

    def _begin_sphere(self, row: int, plane: DragPlane) -> None:
        held = HeldSphere(self.simulation, row)
        self._drag = Drag(held, plane, held.center)

    def follow(self, camera: OrbitCamera, cursor: Cursor, size: Size) -> None:
        """Aim the grab, if there is one, at the cursor. It moves in the next simulated frame (`interpolate`)."""
        if self.drag is not None:
            plane = self.drag.plane
            # A ray that is nearly parallel to the plane meets it at any distance.
            plane.target = np.clip(plane.move(camera, cursor, size[0] / size[1]), -MAX_COORDINATE, MAX_COORDINATE)

    def interpolate(self, fraction: float) -> None:
        """Move the grab by a fraction, 0…1, of the cursor's motion since the last displayed frame.

        A slow display shows one image for several simulated frames. The grab must not jump in one of them.
        """
        if self.drag is not None:
            start, end = self.drag.position, self.drag.plane.target
            self.drag.grab.move_to(start + fraction * (end - start))

    def arrive(self) -> None:
        """Store that the grab has reached the cursor: all simulated frames of this displayed frame are done."""
        if self.drag is not None:
            self.drag.position = self.drag.plane.target

    def mirror(self, other: Dragger, partner: NDArray[np.int64], radius: float) -> None:
        """Drag what another dragger drags, on the same plane. `partner`: our particle for each of the other's, (N,)."""
        if other.drag is None:
            self.end()
        elif self.drag is None or self.drag.plane is not other.drag.plane:
            self.end()
            held = other.drag.grab
            if not isinstance(held, HeldSphere):
                self._begin(int(partner[held.particles[0]]), other.drag.plane, radius)
            elif held.row < len(self.simulation.scene.spheres):
                self._begin_sphere(held.row, other.drag.plane)

    def end(self) -> bool:
        """Release the grab, if there is one. Return whether it has moved a pin."""
        drag, self._drag = self.drag, None
        if drag is None:
            return False
        particles = drag.grab.particles
        drag.grab.release()
        return drag.moves_pin and bool(self.simulation.topology.pinned[particles[0]])


def free_particle(simulation: Simulation, particle: int, radius: float) -> int | None:
    """Return the particle to grab instead of one: the same, unless it is a pin of the scene, which no drag may move.

    Then the nearest on the sheet that is neither pinned nor grabbed, within a radius [m] or to the next row; else None.
    """
    topology = simulation.topology
    if not topology.pinned[particle] or particle in simulation.added_pins:
        return particle
    distances = np.linalg.norm(topology.flat - topology.flat[particle], axis=1)
    distances[topology.pinned] = np.inf
    distances[simulation.grabbed] = np.inf
    nearest = int(distances.argmin())
    reach = max(radius, ROWS_FROM_A_PIN * mean_spring_length(topology))
    return nearest if distances[nearest] <= reach else None


def pick_under_cursor(simulation: Simulation, camera: OrbitCamera, cursor: Cursor, size: Size) -> int | None:
    """Return the particle at a screen point, or None if there is none or a collider is in front of it."""
    blocked = partial(ray_cast, simulation.colliders())
    picked = pick_particle(camera, cursor, size, simulation.positions(), simulation.topology.triangles, blocked)
    return None if picked is None else picked.index


def sphere_under_cursor(simulation: Simulation, camera: OrbitCamera, cursor: Cursor, aspect: float) -> int | None:
    """Return the index in `colliders()` of the sphere at a screen point, or None if another collider is in front."""
    colliders, (origin, direction) = simulation.colliders(), camera.ray(*cursor, aspect)
    spheres = colliders[: len(simulation.scene.spheres)]  # they come first
    distances = [ray_cast([one], origin, direction) for one in spheres]
    nearest = min(distances, default=np.inf)
    if not np.isfinite(nearest) or ray_cast(colliders[len(spheres) :], origin, direction) < nearest:
        return None
    return distances.index(nearest)
