"""The solver of a scene, with the cloth that it moves, at the start."""

from __future__ import annotations

from dataclasses import replace
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import state
from .contact.bodies import colliders_of, pose, repulsion_frequency
from .errors import WrongUse
from .mesh.from_scene import holder_of, stiffness_of, topology_of
from .mesh.topology import Topology
from .scene import Scene
from .scene_stages import stages_of, unfit_for
from .solvers import SOLVERS, Solver, path_for
from .state import distances
from .state.grips import grip

MOST_SUBSTEPS = 200_000  # of a frame, which takes seconds then on a thousand particles


class Made(NamedTuple):
    """What a scene runs with. `give_back` wants the solver when it is done with."""

    topology: Topology
    solver: Solver
    repinned: NDArray[np.bool_]  # (N,)
    damping_time: float  # [s] of the springs' dashpots
    least_substeps: int  # with which it is stable


def made_for(scene: Scene, asked_path: str | None, repinned: NDArray[np.bool_] | None) -> Made:
    """`repinned`: particles that are pinned where the scene says they are not, or the other way round, (N,).

    Raises WrongUse for a path that the method does not have, and for springs that would take too many substeps.
    """
    kind = SOLVERS[scene.solver.name]
    topology = topology_of(scene, kind.springs)
    repinned = np.zeros(topology.particle_count, bool) if repinned is None else repinned
    topology = replace(topology, pinned=topology.pinned ^ repinned)
    path = path_for(kind, topology.shape, asked_path, unfit_for(scene, topology))
    stiffness = stiffness_of(scene, kind.springs, topology)
    cloth = state.take(topology)
    cloth.upload(topology, stiffness)
    solver = kind(cloth, topology, stiffness, stages_of(scene), path)
    if scene.grips:
        centers = np.array([pose(one, 0.0)[0] for one in scene.grips])
        grip(solver.work, topology, np.where(repinned, -1, holder_of(scene, topology)), centers)
    repelled = repulsion_frequency(colliders_of(scene), scene.cloth.area_density)
    solver.frequency = hypot(solver.frequency, repelled)
    damping_time = solver.damping_time(scene.fabric.damping_time)
    least = solver.least_substeps(damping_time)
    if least > MOST_SUBSTEPS:
        give_back(solver)
        raise WrongUse(
            f"{scene.name}: {kind.name} would take {least:,} substeps a frame, more than {MOST_SUBSTEPS:,}: its "
            "springs or its bending are too stiff for particles so light, or its cells too narrow"
        )
    return Made(topology, solver, repinned, damping_time, least)


def give_back(solver: Solver) -> None:
    """Keeps the fields of a solver and its cloth for the next scene."""
    solver.close()
    state.give_back(solver.cloth)
    distances.give_back(solver.stages.distances)
