"""HTML pages that play a clip: one file with a viewer (`player.html`), the cloth, its colliders and the floor.

Positions are 16-bit integers within the bounding box of the clip. They are rounded by half a step at most: 1/131070 of
the box along each axis. A clip stays in memory until it is complete, with 24 bytes per particle and sample.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..render.colors import merge_vertices, pattern_colors
from ..render.webgl import Solids, air, fill_template, quantize, remaining_triangles, script_safe
from ..simulation.simulation import Simulation
from ..system.files import atomic_file
from .mesh_files import Floats

PLAYER = Path(__file__).with_name("player.html")


@contextmanager
def html_clip(path: Path, simulation: Simulation, rate: float) -> Iterator[Callable[[], None]]:
    """Yield a function that adds the next sample: the cloth and the colliders as they are now.

    `rate`: samples per second. The file is written at the end of the block. Raises OSError; a partial file never
    remains.
    """
    samples = Samples(simulation)
    yield samples.add
    head, data = samples.packed()
    with atomic_file(path) as file:
        file.write(page(simulation.scene.title or simulation.scene.name, {**head, "rate": rate}, data).encode())


def page(title: str, head: dict[str, object], data: bytes) -> str:
    """Return the HTML of the viewer with a clip. Title and clip are escaped."""
    packed = base64.b64encode(zlib.compress(data, 9)).decode()
    return fill_template(PLAYER, title, {"head": script_safe(head), "data": packed})


def second_differences(samples: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the second differences in time, modulo 2¹⁶."""
    change: NDArray[np.uint16] = np.diff(samples, 2, axis=0, prepend=np.zeros((2, *samples.shape[1:]), np.uint16))
    return change


class Samples:
    """The samples of a clip, packed as a JSON head and little-endian arrays, those with the largest elements first."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._whole = self._current = simulation.topology  # before any tear, and of the last sample
        self._solids = Solids(simulation)
        self._x: list[Floats] = []
        self._poses: list[Floats] = []
        self._deformed: list[Floats] = []
        self._lifetime = np.zeros(self._whole.triangle_count, np.int64)  # of each triangle [samples]
        self._present = np.ones(self._whole.triangle_count, bool)

    def add(self) -> None:
        """Add a sample."""
        topology = self._simulation.topology
        if topology is not self._current:  # it tore
            self._current = topology
            self._present = remaining_triangles(self._whole, topology)
        self._lifetime += self._present
        self._x.append(self._simulation.positions())
        self._poses.append(self._solids.poses())
        self._deformed.append(self._solids.deformed())

    def packed(self) -> tuple[dict[str, object], bytes]:
        """Return head and data. Positions are stored as second differences in time, modulo 2¹⁶, which compress well.

        Triangles are sorted by the time at which they tear, the last first. `remaining` has their number in each
        sample.
        """
        x = np.array(self._x)
        low, step, steps = quantize(x)
        whole = self._whole
        owner, colors, corners = merge_vertices(whole.triangles, pattern_colors(whole, self._simulation.scene.look))
        order = np.argsort(-self._lifetime, kind="stable")
        solids, solid_vertices, solid_corners = self._solids.pack()
        poses = self._pack_poses(solids)
        solid_low, solid_step, deformed = self._pack_deformed()
        head = {
            "samples": len(x),
            "particles": x.shape[1],
            "low": low.tolist(),
            "step": step.tolist(),
            "vertices": len(owner),
            "triangles": len(corners),
            "remaining": [int((self._lifetime > k).sum()) for k in range(len(x))],
            "solids": solids,
            "solidVertices": len(solid_vertices),
            "solidCorners": len(solid_corners),
            "poses": len(poses),
            "deforming": self._solids.deforming,
            "solidLow": solid_low.tolist(),
            "solidStep": solid_step.tolist(),
            **air(self._simulation.scene, self._simulation.topology.start),
        }
        arrays = [
            solid_vertices.astype("<f4"),
            np.swapaxes(poses, 1, 2).astype("<f4"),
            solid_corners.astype("<u4"),
            owner.astype("<u4"),
            corners[order].astype("<u4"),
            second_differences(steps).astype("<u2"),
            second_differences(deformed).astype("<u2"),
            colors.astype("u1"),
        ]
        return head, b"".join(array.tobytes() for array in arrays)

    def _pack_deformed(self) -> tuple[Floats, Floats, NDArray[np.uint16]]:
        """Return the vertices of solids that deform in every sample: the lowest corner of their box and the step [m],
        and positions in steps and normals in steps of 1/32767, modulo 2¹⁶, (samples, D, 6)."""
        deformed = np.array(self._deformed)
        if not deformed.size:
            return np.zeros(3), np.zeros(3), deformed.astype(np.uint16)
        low, step, steps = quantize(deformed[..., :3])
        normals = np.rint(32767 * deformed[..., 3:]).astype(np.int16).view(np.uint16)
        return low, step, np.concatenate([steps, normals], axis=2)

    def _pack_poses(self, solids: list[dict[str, object]]) -> Floats:
        """Return the poses of all solids, (P, 4, 4): one per sample, or a single one for a solid that never moves.

        Add to each entry of `solids` the index of its first pose and their number.
        """
        poses, first = np.array(self._poses), 0
        parts = [np.zeros((0, 4, 4))]
        for k, solid in enumerate(solids):
            moves = (poses[:, k] != poses[0, k]).any()
            parts.append(poses[:, k] if moves else poses[:1, k])
            solid |= {"pose": first, "poses": len(parts[-1])}
            first += len(parts[-1])
        return np.concatenate(parts)
