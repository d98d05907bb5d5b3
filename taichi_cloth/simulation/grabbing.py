"""Grabs: patches of particles that are moved from outside, by a mouse for example.

A grabbed patch moves rigidly with the grab: every particle keeps its offset from where it was grabbed, and has no mass
meanwhile. Grabbing itself moves nothing, the grab is exactly at its target with every solver, and the pull
enters the cloth along the rim of the patch instead of at one point: 0.5 m out of a curtain of 96×96 particles, the
longest spring is 27 % longer around a patch of 0.1 m, and 50 % at a single particle. (Weights that fall to zero at the
rim would need a spring on each particle, of another stiffness for every solver. The cloth around the patch is that
spring already.)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels.step_params import MAX_GRABS
from ..scene.schema import FRAME_SECONDS
from ..system.errors import short_repr

RELEASE_FRAMES = 3  # released particles get the grab's mean velocity over this many frames

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]


class Grab:
    """Holds `particles` and moves the first of them from `start` to `target` [m] within the next frame."""

    def __init__(
        self,
        particles: Ids,
        rest_positions: Floats,
        start: Floats,
        target: Floats,
        history: Iterable[Floats] = (),
    ) -> None:
        """`rest_positions`: where the particles were grabbed [m], (M, 3). `history`: where the grab was at the end of
        its last frames; a new grab has only its start.
        """
        self.particles = particles
        self.rest_positions = rest_positions
        self.start = start
        self.target = target
        self.history = deque(history, maxlen=RELEASE_FRAMES + 1) or deque([start], maxlen=RELEASE_FRAMES + 1)

    def end_frame(self) -> None:
        """The grab has reached its target."""
        self.start = self.target
        self.history.append(self.target)

    def velocity(self) -> Floats:
        """Return the mean velocity over the last frames [m/s], zero before the first."""
        travel: Floats = self.history[-1] - self.history[0]
        return travel / (max(len(self.history) - 1, 1) * FRAME_SECONDS)

    def acceleration(self) -> Floats:
        """Return the acceleration over the last two frames [m/s²]; before the first frame it was at rest."""
        before, last, now = [self.history[0], self.history[0], *self.history][-3:]
        change: Floats = now - 2 * last + before
        return change / FRAME_SECONDS**2


def free_number(grabs: Mapping[int, Grab]) -> int:
    """Return the smallest number that no grab has. Raises ValueError if all are in use."""
    for number in range(MAX_GRABS):
        if number not in grabs:
            return number
    raise ValueError(f"all {MAX_GRABS} grabs are in use; attachments with keyframes move any number of pins")


def vertices_in_radius(flat: Floats, free: NDArray[np.bool_], index: int, radius: float) -> Ids:
    """Return a particle, followed by all that are `free` within `radius` [m] of it on the flat sheet (N, 3).

    Distances are on the sheet, not in space: a layer that lies behind is not grabbed too.
    """
    within = free & (np.linalg.norm(flat - flat[index], axis=1) <= radius)
    within[index] = False
    return np.concatenate([[index], np.flatnonzero(within)])


def restored_grab(grab: Grab, held: Grab | None) -> Grab:
    """Return the grab of a checkpoint. If `held` has the same particles, it gets that state: its handles stay valid."""
    if held is None or not np.array_equal(held.particles, grab.particles):
        return grab
    vars(held).update(vars(grab))
    return held


def all_grabbed(grabs: Mapping[int, Grab]) -> tuple[Ids, Floats, Ids]:
    """Return the grabbed particles, (M,), where they were grabbed [m], (M, 3), and the grab of each, (M,)."""
    particles = [grab.particles for grab in grabs.values()]
    positions = [grab.rest_positions for grab in grabs.values()]
    numbers = np.repeat(np.array(list(grabs), np.int64), [len(one) for one in particles])
    return np.concatenate([np.zeros(0, np.int64), *particles]), np.concatenate([np.zeros((0, 3)), *positions]), numbers


def grab_arrays(grabs: Mapping[int, Grab]) -> dict[str, NDArray[np.generic]]:
    """Return grabs as arrays for a checkpoint: `grabs` has number, particles and rows of `grab_paths` of each.

    A path is the grab's start, its target, and its history.
    """
    paths = [np.array([grab.start, grab.target, *grab.history]) for grab in grabs.values()]
    table = [(number, len(grab.particles), 2 + len(grab.history)) for number, grab in grabs.items()]
    particles, positions, _ = all_grabbed(grabs)
    return {
        "grabbed": particles,
        "grabbed_at": positions,
        "grabs": np.array(table, np.int64).reshape(-1, 3),
        "grab_paths": np.concatenate([np.zeros((0, 3)), *paths]),
    }


def grabs_from_arrays(arrays: Mapping[str, NDArray[Any]], particle_count: int) -> dict[int, Grab]:
    """Return the grabs of a checkpoint. Raises ValueError for arrays that do not fit together."""
    particles, positions, table, paths = (arrays[name] for name in ("grabbed", "grabbed_at", "grabs", "grab_paths"))
    numbers, counts, rows = table.T
    inside = np.unique(particles[(particles >= 0) & (particles < particle_count)])
    if not len(particles) == len(inside) == len(positions) == counts.sum() or (counts < 1).any():
        raise ValueError(f"grabs have {len(particles)} particles with {len(positions)} positions for {counts.tolist()}")
    if len(np.unique(numbers)) != len(numbers) or not ((numbers >= 0) & (numbers < MAX_GRABS)).all():
        raise ValueError(f"grab numbers must be unique and in 0..{MAX_GRABS - 1}, got {short_repr(numbers.tolist())}")
    if (rows < 3).any() or rows.sum() != len(paths):
        raise ValueError(f"grabs have {len(paths)} path positions for {short_repr(rows.tolist())}")
    cuts = np.cumsum(counts)[:-1], np.cumsum(rows)[:-1]
    parts = zip(np.split(particles, cuts[0]), np.split(positions, cuts[0]), np.split(paths, cuts[1]), strict=True)
    each = [Grab(own, rest, path[0], path[1], path[2:]) for own, rest, path in parts if len(path)]
    return dict(zip(numbers.tolist(), each, strict=True))
