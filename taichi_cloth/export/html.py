"""Pages that play a clip: one HTML file with the viewer (`player.html`), the cloth and what is around it.

Places are whole numbers of 16 bits within the clip's box, so that they are off by half a step at most: 1/131070 of the
box along each axis. A clip is held in memory until it is whole, 24 bytes for each particle and sample.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..files import whole_file
from ..page.sheet import left_of, quantised, vertices
from ..page.surroundings import Solids, air
from ..page.template import filled, script_safe
from ..simulation import Simulation
from ..view.patterns import pattern_colours
from .sheet import Floats

PLAYER = Path(__file__).with_name("player.html")


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
    packed = base64.b64encode(zlib.compress(data, 9)).decode()
    return filled(PLAYER, title, {"head": script_safe(head), "data": packed})


class Samples:
    """A clip as it grows. Its head is JSON; its data are arrays one after another, little-endian, the widest first."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._whole = self._seen = simulation.topology
        self._solids = Solids(simulation)
        self._x: list[Floats] = []
        self._poses: list[Floats] = []
        self._shown = np.zeros(self._whole.triangle_count, np.int64)  # samples that have a triangle
        self._there = np.ones(self._whole.triangle_count, bool)

    def add(self) -> None:
        """Takes a sample."""
        topology = self._simulation.topology
        if topology is not self._seen:  # it tore
            self._seen = topology
            self._there = left_of(self._whole, topology)
        self._shown += self._there
        self._x.append(self._simulation.positions())
        self._poses.append(self._solids.poses())

    def packed(self) -> tuple[dict[str, Any], bytes]:
        """Head and data. Places are told by their second differences in time, modulo 2¹⁶: numbers that deflate well.

        Triangles that last longest come first: `left` says how many a sample has.
        """
        x = np.array(self._x)
        low, step, steps = quantised(x)
        owner, tint, corners = vertices(self._whole, pattern_colours(self._whole, self._simulation.scene.look))
        last = np.argsort(-self._shown, kind="stable")
        solids, solid_vertices, solid_corners = self._solids.packed()
        poses = self._told_poses(solids)
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
            np.swapaxes(poses, 1, 2).astype("<f4"),
            solid_corners.astype("<u4"),
            owner.astype("<u4"),
            corners[last].astype("<u4"),
            change.astype("<u2"),
            tint.astype("u1"),
        ]
        return head, b"".join(array.tobytes() for array in arrays)

    def _told_poses(self, solids: list[dict[str, Any]]) -> Floats:
        """Of each solid those of all samples, or one if it never moves; where they stand is added to what it is."""
        poses, placed = np.array(self._poses), 0
        parts = [np.zeros((0, 4, 4))]
        for k, (one, moving) in enumerate(zip(solids, self._solids.moving, strict=True)):
            parts.append(poses[:, k] if moving else poses[:1, k])
            one |= {"pose": placed, "poses": len(parts[-1])}
            placed += len(parts[-1])
        return np.concatenate(parts)
