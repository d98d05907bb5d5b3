"""The grid that a scene describes, and its springs as numbers. NumPy only.

`section` is where the scene's solver takes its spring constants from: `springs` (0…1) or `fabric` (SI).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.model import Scene
from .topology import Topology, sheet


def topology_of(scene: Scene, section: str) -> Topology:
    """The cloth at its start. A spring of no stiffness is left out."""
    return sheet(
        rows=scene.cloth.rows,
        columns=scene.cloth.columns,
        width=scene.cloth.width,
        height=scene.cloth.height,
        center=scene.cloth.center,
        rotation=scene.cloth.rotation,
        area_density=scene.cloth.area_density,
        pins=scene.cloth.pins,
        directions=[k > 0 for k in _constants(scene, section)],
        diagonals=scene.cloth.diagonals,
        lumping=scene.cloth.lumping,
        weight=scene.cloth.weight,
        bending=scene.fabric.bending if section == "fabric" else 0.0,
    )


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
