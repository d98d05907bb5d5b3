"""Several layers of a sheet as one cloth, one in front of the other. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from . import grid
from .bending import BendingLinks
from .topology import ColorBatch, Topology, float32_lengths, place_sheet


def stack_layers(
    layer: Topology,
    layers: int,
    *,
    spacing: float,
    layer_rotation: float,
    center: tuple[float, float, float],
    rotation: tuple[float, float, float],
    pins: Iterable[str | int],
) -> Topology:
    """Return `layers` copies of a sheet as one cloth.

    Layers are `spacing` [m] apart, normal to their plane, and each is rotated in its plane by `layer_rotation`
    [degrees] against the one before. Rows are numbered layer by layer; no spring or cell connects two layers. Pins that
    name edges or corners apply to every layer. Raises ValueError for a pin that is not an edge, a corner or a particle.
    """
    rows, columns = layer.shape
    rotated = [
        layer.flat @ grid.rotation_matrix((0.0, 0.0, k * layer_rotation)).T + [0.0, 0.0, k * spacing]
        for k in range(layers)
    ]
    positions = place_sheet(np.concatenate(rotated), np.subtract(center, layer.origin), rotation)
    flat_spacing = float(np.ptp(layer.flat, axis=0).max()) * 2  # [m] between layers in `flat`: no two of them overlap
    batches: list[ColorBatch] = []
    ends: list[NDArray[np.int32]] = []
    for batch in layer.batches:
        batches.append(replace(batch, first=layers * batch.first, count=layers * batch.count))
        ends.append(_repeat(layer.ends[batch.first : batch.first + batch.count], layer.particle_count, layers))
    factors = [
        np.tile(layer.stiffness_factors[:, batch.first : batch.first + batch.count], layers) for batch in layer.batches
    ]
    all_ends = np.concatenate([np.zeros((0, 2), np.int32), *ends])
    return replace(
        layer,
        start=positions + layer.origin,
        flat=np.concatenate([layer.flat + [0.0, 0.0, k * flat_spacing] for k in range(layers)]),
        mass=np.tile(layer.mass, layers),
        pinned=pinned_mask_of_layers(rows, columns, layers, pins),
        ends=all_ends,
        rest=float32_lengths(positions, all_ends),
        stiffness_factors=np.concatenate([layer.stiffness_factors[:, :0], *factors], axis=1),
        batches=tuple(batches),
        bending_links=BendingLinks(
            _repeat(layer.bending_links.ends, layer.particle_count, layers),
            np.tile(layer.bending_links.stiffness, layers),
            np.tile(layer.bending_links.direction, layers),
        ),
        triangles=_repeat(layer.triangles, layer.particle_count, layers),
        cells=np.concatenate([layer.cells + [k * rows, 0] for k in range(layers)]).astype(np.int32),
        shape=(layers * rows, columns),
        layers=layers,
    )


def pinned_mask_of_layers(rows: int, columns: int, layers: int, pins: Iterable[str | int]) -> NDArray[np.bool_]:
    """Return which particles are pinned, (layers·rows·columns,).

    Names of edges and corners apply to every layer; a particle index to one particle. Raises ValueError for an unknown
    name and for an index outside the cloth.
    """
    pins = list(pins)
    names, indices = [pin for pin in pins if isinstance(pin, str)], [pin for pin in pins if isinstance(pin, int)]
    pinned: NDArray[np.bool_] = np.tile(grid.pinned_mask(rows, columns, names), layers)
    return pinned | grid.pinned_mask(layers * rows, columns, indices)


def _repeat(corners: NDArray[np.int32], particles: int, layers: int) -> NDArray[np.int32]:
    """Return rows of particle indices of one layer, repeated for every layer."""
    repeated: NDArray[np.int32] = np.concatenate([corners + k * particles for k in range(layers)]).astype(np.int32)
    return repeated
