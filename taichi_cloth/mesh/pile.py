"""Several sheets of one kind as one cloth, one behind the other. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from . import grid
from .bending import Bonds
from .topology import Batch, Topology, laid, lengths


def pile(
    one: Topology,
    sheets: int,
    *,
    gap: float,
    turn: float,
    center: tuple[float, float, float],
    rotation: tuple[float, float, float],
    pins: Iterable[str | int],
) -> Topology:
    """`sheets` of them, `gap` [m] apart across their plane, each turned by `turn` [degrees] against the one before.

    The rows of one follow those of the other, in a grid without springs or cells between them. Edges and corners are
    pins of every sheet. Raises ValueError as `sheet` does.
    """
    rows, columns = one.shape
    turned = [one.flat @ grid.rotation_matrix((0.0, 0.0, k * turn)).T + [0.0, 0.0, k * gap] for k in range(sheets)]
    places = laid(np.concatenate(turned), np.subtract(center, one.origin), rotation)
    apart = float(np.ptp(one.flat, axis=0).max()) * 2  # [m] on the floor of the cutter
    batches: list[Batch] = []
    ends: list[NDArray[np.int32]] = []
    for batch in one.batches:
        batches.append(replace(batch, first=sheets * batch.first, count=sheets * batch.count))
        ends.append(_each(one.ends[batch.first : batch.first + batch.count], one.particle_count, sheets))
    shares = [np.tile(one.shares[:, batch.first : batch.first + batch.count], sheets) for batch in one.batches]
    springs = np.concatenate([np.zeros((0, 2), np.int32), *ends])
    return replace(
        one,
        start=places + one.origin,
        flat=np.concatenate([one.flat + [0.0, 0.0, k * apart] for k in range(sheets)]),
        mass=np.tile(one.mass, sheets),
        pinned=pinned(rows, columns, sheets, pins),
        ends=springs,
        rest=lengths(places, springs),
        shares=np.concatenate([one.shares[:, :0], *shares], axis=1),
        batches=tuple(batches),
        bonds=Bonds(
            _each(one.bonds.ends, one.particle_count, sheets),
            np.tile(one.bonds.constant, sheets),
            np.tile(one.bonds.direction, sheets),
        ),
        triangles=_each(one.triangles, one.particle_count, sheets),
        cells=np.concatenate([one.cells + [k * rows, 0] for k in range(sheets)]).astype(np.int32),
        shape=(sheets * rows, columns),
        sheets=sheets,
    )


def pinned(rows: int, columns: int, sheets: int, pins: Iterable[str | int]) -> NDArray[np.bool_]:
    """Which particles are held, (sheets·rows·columns,): edges and corners of each sheet, and particles by index.

    Raises ValueError as `grid.pinned` does.
    """
    pins = list(pins)
    names, numbers = [pin for pin in pins if isinstance(pin, str)], [pin for pin in pins if isinstance(pin, int)]
    held: NDArray[np.bool_] = np.tile(grid.pinned(rows, columns, names), sheets)
    return held | grid.pinned(sheets * rows, columns, numbers)


def _each(corners: NDArray[np.int32], particles: int, sheets: int) -> NDArray[np.int32]:
    """Rows of particles of one sheet, for each of them."""
    all_of_them: NDArray[np.int32] = np.concatenate([corners + k * particles for k in range(sheets)]).astype(np.int32)
    return all_of_them
