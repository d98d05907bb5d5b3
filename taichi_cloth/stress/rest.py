"""The static strain that a cloth must come back to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import reference
from ..accuracy.kept import kept
from ..scene.model import Fabric, Maps, Scene

HUNG_BY = ("top-left", "top-right")


def static_strain(scene: Scene) -> float:
    """Largest strain of a thread of this cloth at rest, in float64 and from the constants of its fabric.

    A method's own artificial stretch is no part of it. For a sheet without pins, which comes to lie on something or
    floats, it is that of one such sheet hung by its two top corners: an upper bound, for what lies is carried in more
    places, and a shorter piece of it hangs from each. Where a map makes springs differ, it is that of a sheet all of
    whose springs are as soft as the softest: the reference takes a cloth to be soft or stiff as a whole.
    """
    cloth = scene.cloth if scene.cloth.pins else replace(scene.cloth, pins=HUNG_BY, sheets=1)
    fabric, maps = scene.fabric, scene.maps
    if maps is not None and maps.stiffness:
        fabric = softened(fabric, min(maps.stiffness_lo, maps.stiffness_hi))
        maps = replace(maps, stiffness=Maps().stiffness)
    still = Scene(cloth=cloth, regions=scene.regions, maps=maps, fabric=fabric, forces=scene.forces)
    code = Path(reference.__file__).parent
    return float(kept(f"rest strain {still}", code, lambda: np.array(reference.rest_strain(still))))


def softened(fabric: Fabric, share: float) -> Fabric:
    """With so much of the constants of its springs."""
    constants = fabric.warp, fabric.weft, fabric.shear, fabric.bend
    warp, weft, shear, bend = (share * constant for constant in constants)
    return replace(fabric, warp=warp, weft=weft, shear=shear, bend=bend)
