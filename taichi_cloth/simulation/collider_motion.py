"""Motion of the colliders of a running cloth in a frame, and how deep the cloth is in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..collision.colliders import collider_table, is_deforming, max_penetration, pose_colliders
from ..collision.deforming_meshes import greatest_depth, upload_frame
from ..scene.collider_schema import Mesh

if TYPE_CHECKING:
    from .running_cloth import RunningCloth

Floats = NDArray[np.float64]


def move_colliders(simulation: RunningCloth, start: float, end: float) -> NDArray[np.float32]:
    """Return the table of rigid colliders and attachments of a frame [s], and set the surfaces that deform."""
    colliders, scene = simulation.scene_colliders(), simulation.scene
    before, after = simulation.depenetration.advance(colliders, simulation.free_positions, start, end)
    deforms = np.array([is_deforming(collider) for collider in colliders], bool)
    _move_surfaces(simulation, start, end, (before[deforms], after[deforms]))
    moving = [*(collider for collider in colliders if not is_deforming(collider)), *scene.attachments]
    origin = tuple(simulation.topology.origin)
    return collider_table(moving, start, end, (before[~deforms], after[~deforms]), origin)


def penetration(simulation: RunningCloth) -> float:
    """Return the largest depth of the cloth below the surface of a collider [m], at least 0."""
    posed = pose_colliders(simulation.scene_colliders(), simulation.seconds)
    rigid = [one for one in posed if not is_deforming(one.collider)]
    depth, surfaces = max_penetration(rigid, simulation.positions()), simulation.solver.features.surfaces
    if surfaces is not None:
        none = np.zeros(len(posed) - len(rigid))
        _move_surfaces(simulation, simulation.seconds, simulation.seconds, (none, none))
        depth = max(depth, greatest_depth(simulation.cloth, surfaces, simulation.solver.layout.is_parallel))
    return depth


def _move_surfaces(simulation: RunningCloth, start: float, end: float, margin_reduction: tuple[Floats, Floats]) -> None:
    """Set the surfaces that deform for the time from `start` to `end` [s]."""
    surfaces = simulation.solver.features.surfaces
    if surfaces is not None:
        meshes = [mesh for mesh in simulation.scene_colliders() if isinstance(mesh, Mesh) and is_deforming(mesh)]
        is_parallel = simulation.solver.layout.is_parallel
        span, origin = (start, end), simulation.topology.origin
        upload_frame(surfaces, meshes, span, margin_reduction, origin, is_parallel=is_parallel)
