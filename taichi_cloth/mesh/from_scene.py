"""The grid that a scene describes, and its springs as numbers. NumPy only.

`section` is where the scene's solver takes its spring constants from: `springs` (0…1) or `fabric` (SI).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.model import Scene
from .pile import pile, pinned
from .topology import Topology, sheet


def topology_of(scene: Scene, section: str) -> Topology:
    """The cloth at its start. A spring of no stiffness is left out."""
    cloth = scene.cloth
    pins = [*cloth.pins, *(pin for grip in scene.grips for pin in grip.pins)]
    one = sheet(
        rows=cloth.rows,
        columns=cloth.columns,
        width=cloth.width,
        height=cloth.height,
        center=cloth.center,
        rotation=cloth.rotation,
        area_density=cloth.area_density,
        pins=pins if cloth.sheets == 1 else (),
        directions=[k > 0 for k in _constants(scene, section)],
        diagonals=cloth.diagonals,
        lumping=cloth.lumping,
        weight=cloth.weight,
        bending=scene.fabric.bending if section == "fabric" else 0.0,
    )
    if cloth.sheets == 1:
        return one
    return pile(
        one,
        cloth.sheets,
        gap=cloth.gap,
        turn=cloth.turn,
        center=cloth.center,
        rotation=cloth.rotation,
        pins=pins,
    )


def holder_of(scene: Scene) -> NDArray[np.int64]:
    """Number of the grip that holds each particle, (N,), −1 for none; of two that would hold it, the last does."""
    cloth = scene.cloth
    holder = np.full(cloth.sheets * cloth.rows * cloth.columns, -1)
    for k, grip in enumerate(scene.grips):
        holder[pinned(cloth.rows, cloth.columns, cloth.sheets, grip.pins)] = k
    return holder


def stiffness_of(scene: Scene, section: str, topology: Topology) -> NDArray[np.float64]:
    """Of every spring, (E,), 0…1 or [N/m]: an SI constant is one of a whole cell's width, an edge has half of one."""
    each: NDArray[np.float64] = np.array(_constants(scene, section))[topology.direction]
    return each if section == "springs" else each * topology.width


def _constants(scene: Scene, section: str) -> tuple[float, ...]:
    """Spring constant in each of `grid.DIRECTIONS`."""
    if section == "springs":
        s = scene.springs
        return s.structural, s.structural, s.shear, s.shear, s.bend, s.bend
    f, cloth = scene.fabric, scene.cloth
    slim = (cloth.height / (cloth.rows - 1)) / (cloth.width / (cloth.columns - 1))  # a cell's height over its width
    return f.weft * slim, f.warp / slim, f.shear, f.shear, f.bend * slim, f.bend / slim
