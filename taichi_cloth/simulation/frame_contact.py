"""Contact at the start of a frame: colliders are moved, and intersections of the cloth with itself are found.

Also what a running cloth reports of contact: how deep it is in colliders, and where it intersects itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..collision.colliders import (
    collider_table,
    colliders_of,
    displaced,
    is_deforming,
    max_penetration,
    pose,
    pose_colliders,
)
from ..collision.deforming_meshes import begin_frame, greatest_depth, upload_frame
from ..collision.self_collision import count_intersections
from ..collision.truncation import start_from
from ..geometry.intersections import find_intersections
from ..geometry.topology import Topology
from ..scene.collider_schema import Collider, Ground, Mesh
from ..scene.schema import COLLIDERS, FRAME_SECONDS
from ..solvers import Solver
from ..state.cloth_state import Layout
from ..state.contact_data import attach_self_contact
from ..state.field_pool import layout_index, upload, upload_all
from ..state.surface_data import DeformingSurfaces
from ..system.errors import short_repr

if TYPE_CHECKING:
    from .running_cloth import RunningCloth

Floats = NDArray[np.float64]
MAX_PLACES = 3  # that a message names


@dataclass(frozen=True)
class Displacement:
    """How far a collider is from the motion that its keys prescribe."""

    start: Floats
    """Before the next frame [m], (3,)."""
    end: Floats
    """After it [m], (3,)."""


def present_colliders(simulation: RunningCloth) -> list[Collider | Ground]:
    """Return the scene's colliders with the values of their runtime parameters, and displaced as in the next frame."""
    of_scene, values = colliders_of(simulation.scene), simulation.params.values_by_name
    colliders = of_scene.copy()
    for name, parameter in simulation.params.known().items():
        if parameter.section in COLLIDERS:
            changed = getattr(simulation.scene, parameter.section)[parameter.index]
            new: dict[str, Any] = {parameter.key_name: values[name]}
            if getattr(changed, parameter.key_name) != values[name]:  # else it stays the same object, which caches find
                row = [collider is changed for collider in of_scene].index(True)
                colliders[row] = replace(colliders[row], **new)
    now = simulation.seconds
    for row, by in simulation.displacements.items():
        moved = colliders[row]
        if isinstance(moved, Collider):
            colliders[row] = displaced(moved, now, now + FRAME_SECONDS, (by.start, by.end))
    return colliders


def displacement_array(displacements: Mapping[int, Displacement]) -> Floats:
    """Return displacements as an array for a checkpoint, (K, 7): row, start and end."""
    return np.array([(row, *one.start, *one.end) for row, one in displacements.items()], np.float64).reshape(-1, 7)


def displacements_from_array(array: Floats, collider_count: int) -> dict[int, Displacement]:
    """Return the displacements of a checkpoint. Raises ValueError for colliders that do not exist."""
    rows = array[:, 0]
    if not np.isin(rows, np.arange(collider_count)).all() or len(np.unique(rows)) != len(rows):
        raise ValueError(f"displacements of colliders {short_repr(rows.tolist())}, of {collider_count}")
    return {int(row): Displacement(values[:3], values[3:]) for row, values in zip(rows, array[:, 1:], strict=True)}


def check_movable(simulation: RunningCloth, row: int) -> None:
    """Raise ValueError unless there is such a collider, and it is not the ground."""
    colliders = colliders_of(simulation.scene)
    if type(row) is not int or not 0 <= row < len(colliders):
        have = f"{simulation.scene.name} has {len(colliders)}" if colliders else f"{simulation.scene.name} has none"
        raise ValueError(f"there is no collider {short_repr(row)}: {have}, numbered from 0 as in colliders()")
    if isinstance(colliders[row], Ground):
        raise ValueError(f"collider {row} is the ground, which cannot move: use a plane")


def displacement_to(simulation: RunningCloth, row: int, target: Floats) -> Displacement:
    """Return the displacement that moves the center of a collider to `target` [m], (3,), within the next frame."""
    prescribed = pose(colliders_of(simulation.scene)[row], simulation.seconds + FRAME_SECONDS)[0]
    before = simulation.displacements.get(row)
    return Displacement(np.zeros(3) if before is None else before.start, target - prescribed)


def move_colliders(simulation: RunningCloth, start: float, end: float) -> NDArray[np.float32]:
    """Return the table of rigid colliders and attachments of a frame [s], and set the surfaces that deform."""
    colliders, scene = simulation.scene_colliders(), simulation.scene

    def free_corners() -> Floats:
        triangles, pinned = simulation.topology.triangles, simulation.topology.pinned
        return simulation.positions()[triangles[~pinned[triangles].all(axis=1)]]

    before, after = simulation.depenetration.advance(colliders, simulation.free_positions, free_corners, start, end)
    deforms = np.array([is_deforming(collider) for collider in colliders], bool)
    _move_surfaces(simulation, start, end, (before[deforms], after[deforms]))
    moving = [*(collider for collider in colliders if not is_deforming(collider)), *scene.attachments]
    origin = tuple(simulation.origin)
    return collider_table(moving, start, end, (before[~deforms], after[~deforms]), origin)


def penetration(simulation: RunningCloth, positions: Floats) -> float:
    """Return the largest depth of the cloth below the surface of a collider [m], at least 0.

    `positions`: of the cloth as it is now [m], (N, 3).
    """
    posed = pose_colliders(simulation.scene_colliders(), simulation.seconds)
    rigid = [one for one in posed if not is_deforming(one.collider)]
    depth, surfaces = max_penetration(rigid, positions), simulation.solver.features.surfaces
    if surfaces is not None:
        is_parallel = simulation.solver.layout.is_parallel
        of_frame = []
        if simulation._is_within_frame:
            of_frame = [(field, field.to_numpy()) for field in _fields_of_frame(surfaces)]
        reach = surfaces.reach[None]
        none = np.zeros(len(posed) - len(rigid))
        _move_surfaces(simulation, simulation.seconds, simulation.seconds, (none, none))
        depth = max(depth, greatest_depth(simulation.cloth, surfaces, is_parallel))
        if of_frame:  # the remaining substeps need the surfaces of the frame
            upload_all(*of_frame)
            surfaces.reach[None] = reach
            begin_frame(surfaces, is_parallel)
    return depth


def _fields_of_frame(surfaces: DeformingSurfaces) -> list[Any]:
    """Return the fields that `upload_frame` sets."""
    return [surfaces.start, surfaces.end, surfaces.margin_start, surfaces.margin_end, surfaces.friction]


def _move_surfaces(simulation: RunningCloth, start: float, end: float, margin_reduction: tuple[Floats, Floats]) -> None:
    """Set the surfaces that deform for the time from `start` to `end` [s]."""
    surfaces = simulation.solver.features.surfaces
    if surfaces is not None:
        meshes = [mesh for mesh in simulation.scene_colliders() if isinstance(mesh, Mesh) and is_deforming(mesh)]
        is_parallel = simulation.solver.layout.is_parallel
        span, origin = (start, end), simulation.origin
        upload_frame(surfaces, meshes, span, margin_reduction, origin, is_parallel=is_parallel)


def intersection_count(simulation: RunningCloth) -> int:
    """Return how many times an edge of the cloth passes through one of its triangles."""
    if not simulation.has_self_contact:
        attach_self_contact(simulation.cloth, simulation.topology)
        simulation.has_self_contact = True
    return int(count_intersections(simulation.cloth))


def describe_intersections(topology: Topology, positions: Floats) -> str:
    """Return how many edges pass through triangles, and where, or "" if none does. `positions` (N, 3) [m]."""
    edges = topology.edges
    found = find_intersections(positions - topology.origin, edges, topology.triangles)
    if not len(found):
        return ""
    middles = positions[edges[found[:, 0]]].mean(axis=1)
    places = list(dict.fromkeys("({:.3g}, {:.3g}, {:.3g})".format(*point) for point in middles))
    more = ", …" if len(places) > MAX_PLACES else ""
    count = len(np.unique(found[:, 0]))
    return f"{count} edges pass through triangles, near {', '.join(places[:MAX_PLACES])}{more} m"


def expire_candidates(layout: Layout) -> None:
    """Let the next substep list the candidate pairs of self-collision anew, in the order of their places then."""
    if layout.self_contact is not None:
        layout.self_contact.list_thickness[None] = 0.0  # [m] a list of another thickness is not used


class IntersectionGuard:
    """Keeps a cloth free of intersections from its first state without any.

    Parts that intersect are released: nothing holds them apart until they no longer do. Each frame begins with a look
    at them, as long as there are any.
    """

    def __init__(self, solver: Solver, topology: Topology) -> None:
        self._solver, self._topology = solver, topology
        self.clean_since: int | None = None
        """First frame without intersections; None while there are any."""

    def change_topology(self, topology: Topology) -> None:
        """Continue with triangles that remain after tearing, at the same positions: none can intersect that did not."""
        self._topology = topology
        self.resume()

    def resume(self) -> None:
        """Find all pairs anew. The cloth has not moved, though the fields of positions may have changed."""
        start_from(self._solver.cloth, self._solver.layout)

    def restart(self, frame: int, *, moved: bool) -> None:
        """Continue from the present positions. `moved`: they were not reached by a step."""
        self.resume()
        if moved:
            self.clean_since = None
            self.begin_frame(frame)

    def begin_frame(self, frame: int) -> None:
        """Look for intersections, if there were any, and release the parts that intersect."""
        if self.clean_since is not None:
            return
        x = self._solver.cloth.to_numpy(self._solver.cloth.x)
        edges, triangles = self._topology.edges, self._topology.triangles
        found = find_intersections(x, edges, triangles)
        particles = np.unique(np.concatenate([edges[found[:, 0]].ravel(), triangles[found[:, 1]].ravel()]))
        data = self._solver.layout.pair_data
        assert data is not None
        released = np.zeros(data.released.shape[0], np.int32)
        released[layout_index(self._solver.layout, self._topology, particles)] = 1
        upload(data.released, released)
        if not len(found):
            self.clean_since = frame
