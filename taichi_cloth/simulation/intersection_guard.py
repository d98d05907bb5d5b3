"""What penetration-free contact starts from: a state without intersections, or with some that may come apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..collision.truncation import start_from
from ..geometry.intersections import find_intersections
from ..geometry.topology import Topology
from ..solvers import Solver
from ..state.field_pool import layout_index, upload

Floats = NDArray[np.float64]
MAX_PLACES = 3  # that a message names


def describe_intersections(topology: Topology, positions: Floats) -> str:
    """Return how many edges pass through triangles, and where, or "" if none does. `positions` (N, 3) [m]."""
    edges = topology.edges
    found = find_intersections(positions - topology.origin, edges, topology.triangles)
    if not len(found):
        return ""
    middles = positions[edges[found[:, 0]]].mean(axis=1)
    places = list(dict.fromkeys("({:.3g}, {:.3g}, {:.3g})".format(*point) for point in middles))
    more = ", …" if len(places) > MAX_PLACES else ""
    return f"{len(found)} edges pass through triangles, near {', '.join(places[:MAX_PLACES])}{more} m"


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
        start_from(self._solver.cloth, self._solver.layout)

    def restart(self, frame: int) -> None:
        """Continue from the present positions, which were not reached by a step."""
        start_from(self._solver.cloth, self._solver.layout)
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
