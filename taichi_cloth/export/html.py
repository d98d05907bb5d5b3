"""Pages that play a clip: one HTML file with the viewer (`player.html`), the cloth and what is around it.

Places are whole numbers of 16 bits within the clip's box, so that they are off by half a step at most: 1/131070 of the
box along each axis. A clip is held in memory until it is whole, 24 bytes for each particle and sample.
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import one_line
from ..files import whole_file
from ..mesh.topology import Topology
from ..simulation import Simulation
from ..view.patterns import pattern_colours
from .html_scene import Solids, air
from .sheet import Floats

PLAYER = Path(__file__).with_name("player.html")
STEPS = 2**16 - 1  # from one side of the clip's box to the other

Ids = NDArray[np.int64]


@contextmanager
def html_clip(path: Path, simulation: Simulation, rate: float) -> Iterator[Callable[[], None]]:
    """A function that takes the next sample: the cloth and the colliders as they are; `rate` samples a second.

    The page appears at the end of the block, whole. Raises OSError.
    """
    samples = Samples(simulation)
    yield samples.add
    head, data = samples.packed()
    with whole_file(path) as file:
        file.write(page(simulation.scene.title or simulation.scene.name, {**head, "rate": rate}, data).encode())


def page(title: str, head: dict[str, Any], data: bytes) -> str:
    """The viewer with a clip in it; nothing that the title or the clip says is taken for HTML."""
    parts = {
        "title": escape(one_line(title)),
        "head": json.dumps(head, separators=(",", ":")).replace("<", "\\u003c"),
        "data": base64.b64encode(zlib.compress(data, 9)).decode(),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], PLAYER.read_text(encoding="utf-8"))


class Samples:
    """A clip as it grows. Its head is JSON; its data are arrays one after another, little-endian, the widest first."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._whole = self._seen = simulation.topology
        self._solids = Solids(simulation)
        self._x: list[Floats] = []
        self._shown = np.zeros(self._whole.triangle_count, np.int64)  # samples that have a triangle
        self._there = np.ones(self._whole.triangle_count, bool)

    def add(self) -> None:
        """Takes a sample."""
        topology = self._simulation.topology
        if topology is not self._seen:  # it tore
            self._seen = topology
            self._there = np.isin(_keys(self._whole, self._whole), _keys(topology, self._whole))
        self._shown += self._there
        self._x.append(self._simulation.positions())
        self._solids.add()

    def packed(self) -> tuple[dict[str, Any], bytes]:
        """Head and data. Places are told by their second differences in time, modulo 2¹⁶: numbers that deflate well.

        Triangles that last longest come first: `left` says how many a sample has.
        """
        x = np.array(self._x)
        low, step, steps = quantised(x)
        owner, tint, corners = vertices(self._whole, pattern_colours(self._whole, self._simulation.scene.look))
        last = np.argsort(-self._shown, kind="stable")
        solids, solid_vertices, poses, solid_corners = self._solids.packed()
        head = {
            "samples": len(x),
            "particles": x.shape[1],
            "low": low.tolist(),
            "step": step.tolist(),
            "vertices": len(owner),
            "triangles": len(corners),
            "left": [int((self._shown > k).sum()) for k in range(len(x))],
            "solids": solids,
            "solidVertices": len(solid_vertices),
            "solidCorners": len(solid_corners),
            "poses": len(poses),
            **air(self._simulation.scene),
        }
        change = np.diff(steps, 2, axis=0, prepend=np.zeros((2, *steps.shape[1:]), np.uint16))
        arrays = [
            solid_vertices.astype("<f4"),
            poses.astype("<f4"),
            solid_corners.astype("<u4"),
            owner.astype("<u4"),
            corners[last].astype("<u4"),
            change.astype("<u2"),
            tint.astype("u1"),
        ]
        return head, b"".join(array.tobytes() for array in arrays)


def quantised(x: Floats) -> tuple[Floats, Floats, NDArray[np.uint16]]:
    """Lowest corner of the box (3,) [m], its step along each axis (3,) [m], and places (…, 3) [m] in steps."""
    points = x.reshape(-1, 3)
    low = points.min(axis=0)
    step = np.ptp(points, axis=0) / STEPS
    return low, step, np.rint((x - low) / np.where(step > 0, step, 1.0)).astype(np.uint16)


def vertices(topology: Topology, colours: NDArray[np.float32]) -> tuple[Ids, NDArray[np.uint8], Ids]:
    """Particles (V,) and colours (V, 3) of what triangles (T, 3) share: corners of one particle and one colour."""
    rgb = np.rint(255 * colours).astype(np.int64)
    key = (topology.triangles.ravel().astype(np.int64) << 24) + (rgb << np.array([16, 8, 0])).sum(axis=1)
    one, corners = np.unique(key, return_inverse=True)
    tint = (one[:, None] >> np.array([16, 8, 0]) & 255).astype(np.uint8)
    return one >> 24, tint, corners.reshape(-1, 3)


def _keys(topology: Topology, whole: Topology) -> Ids:
    """A number for every triangle, by its particles."""
    a, b, c = topology.triangles.T.astype(np.int64)
    keys: Ids = (a * whole.particle_count + b) * whole.particle_count + c
    return keys
