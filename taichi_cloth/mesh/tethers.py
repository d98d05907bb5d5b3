"""To which pins a cloth's particles are tied, and how far away those are on the flat sheet. NumPy only.

Kim, Chentanez and Müller 2012, *Long range attachments*: pins that are neighbours in the grid form a run, and a
particle is tied to the nearest pin of each run, of the nearest `MOST` runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .geodesic import distances_from, pieces_of
from .grid import particle_indices
from .topology import NO_GRID, Topology

MOST = 4  # tethers of a particle


def tethers(topology: Topology) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The pin at the end of each tether and its distance from the particle [m], both (tethers, N), nearest first.

    A sheet starts flat, so that distances at the start are those on the sheet; on a mesh they go along its triangles. A
    pin is tied to itself, and so is a particle of a piece without pins.
    """
    start, count = topology.start, topology.particle_count
    pins = np.zeros((0, count), np.int32)
    reach = np.zeros((0, count))
    is_grid = topology.shape != NO_GRID
    every = runs(topology.pinned.reshape(topology.shape)) if is_grid else pieces_of(topology.edges, topology.pinned)
    for run in every:
        if is_grid:
            nearest = nearest_pin(run, topology.shape, start)
            away = np.linalg.norm(start - start[nearest], axis=1)
        else:
            nearest, away = distances_from(run, topology.flat, topology.triangles)
        pins = np.concatenate([pins, nearest[None]])
        reach = np.concatenate([reach, away[None]])
        order = np.argsort(reach, axis=0, kind="stable")[:MOST]
        pins, reach = np.take_along_axis(pins, order, 0), np.take_along_axis(reach, order, 0)
    return pins, reach


def runs(pinned: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Particles of each connected group of pins, by the four neighbours of the grid; in order of their first."""
    index = particle_indices(*pinned.shape)
    beside = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])]
    edges = np.concatenate([np.stack(pair, axis=-1).reshape(-1, 2) for pair in beside])
    return pieces_of(edges, pinned.reshape(-1))


def nearest_pin(run: NDArray[np.int64], shape: tuple[int, int], start: NDArray[np.float64]) -> NDArray[np.int32]:
    """The pin of the run that is nearest to each particle on the flat sheet, (N,).

    In a line of the grid the nearest pin is the one next in the line. So each line with pins has one candidate for
    a particle, and lines are rows or columns, whichever are fewer.
    """
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    places = np.stack(np.unravel_index(run, shape))  # row and column of every pin
    cell = np.linalg.norm(start[[shape[1], 1]] - start[0], axis=1)  # height and width
    across = int(len(set(places[1].tolist())) < len(set(places[0].tolist())))  # 1: lines are columns
    along = 1 - across
    at = np.unravel_index(index.reshape(-1), shape)  # row and column of every particle
    best = np.full(index.size, np.inf)
    nearest = np.zeros(index.size, np.int32)
    for line in np.unique(places[across]):
        stops = np.sort(places[along][places[across] == line])
        there = np.arange(shape[along])
        after = np.minimum(np.searchsorted(stops, there), len(stops) - 1)
        before = np.maximum(after - 1, 0)
        stop = np.where(there - stops[before] <= np.abs(stops[after] - there), stops[before], stops[after])
        candidate = stop[at[along]]
        squared = ((candidate - at[along]) * cell[along]) ** 2 + ((line - at[across]) * cell[across]) ** 2
        closer = squared < best
        best[closer] = squared[closer]
        pin = index[line, candidate] if across == 0 else index[candidate, line]
        nearest[closer] = pin[closer]
    return nearest
