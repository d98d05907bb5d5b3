"""Which stages a scene names: what of the kernels is compiled for it."""

from __future__ import annotations

from typing import Any

from .contact.bodies import colliders_of, counts_of, meets_triangles
from .mesh.solid import distances_of
from .mesh.topology import Topology
from .scene import Scene
from .scene.model import COLLIDERS, PROJECTION, REFLECTION, REPULSION
from .solvers import Stages, Unfit
from .state import distances

MOST_COLOURS = 64  # of springs, each compiled by itself on the path gather; a grid has 12 at most
# Those that a run names besides spring families and colliders: the field of `Stages`, and the word for it.
WORDS = {
    "bending": "bending",
    "strain_limit": "limit",
    "tethers": "tethers",
    "leashes": "leashes",
    "grips": "grips",
    "wind": "wind",
    "self_collision": "self-collision",
    "swept": "swept",
    "triangles": "triangles",
}


def stages_of(scene: Scene) -> Stages:
    """The stages of a scene. `distances`, if it has meshes, are fields from a pool and want to be given back."""
    colliders = colliders_of(scene)
    projecting: dict[str, Any] = dict(zip(COLLIDERS, counts_of(colliders, PROJECTION), strict=True))
    return Stages(
        wind=scene.wind is not None,
        **projecting,
        reflecting=counts_of(colliders, REFLECTION),
        repelling=counts_of(colliders, REPULSION),
        distances=distances.take([distances_of(mesh) for mesh in scene.meshes]),
        triangles=any(meets_triangles(collider) for collider in colliders),
        swept=any(collider.swept for collider in colliders),
        slack=scene.fabric.compression < 1,
        spring_damping=scene.fabric.damping_time > 0,
        strain_limit=0 if scene.limit is None else scene.limit.sweeps,
        tethers=scene.tethers is not None,
        leashes=scene.maps is not None and bool(scene.maps.max_distance),
        grips=bool(scene.grips),
        self_collision=scene.self_collision is not None,
        untangles=scene.self_collision is not None and scene.self_collision.untangle,
        sticks=scene.self_collision is not None and scene.self_collision.stick,
        self_triangles=scene.self_collision is not None and scene.self_collision.contacts == "triangles",
    )


def words_for(stages: Stages) -> list[str]:
    """The words for those that are on."""
    return [word for stage, word in WORDS.items() if getattr(stages, stage)]


def unfit_for(scene: Scene, topology: Topology) -> Unfit:
    """What a cloth cannot be run with, and why."""
    rows = strips = threads = ""
    if len(topology.batches) > MOST_COLOURS:
        threads = f"its springs have {len(topology.batches)} colours, more than {MOST_COLOURS}: a point has many edges"
    if scene.tear is not None:
        rows = strips = "one that tears loses its rows"
    if scene.cloth.file:
        rows = strips = "cloth.file is a mesh without rows"
    if scene.cloth.sheets > 1:
        strips = f"cloth.sheets is {scene.cloth.sheets}"
    if scene.maps is not None and scene.maps.stiffness:
        strips = "maps.stiffness makes springs differ"
    if any(meets_triangles(collider) for collider in colliders_of(scene)):
        strips = "a body is kept from triangles"
        threads = "a body is kept from the triangles of a mesh" if scene.cloth.file else threads
    return Unfit(rows, strips, threads)
