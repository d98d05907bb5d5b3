"""The static strain that a cloth must come back to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import reference
from ..accuracy.kept import kept
from ..reference.rest import rest_positions
from ..reference.springs import spring_model
from ..scene.model import Fabric, Forces, Maps, Scene

HUNG_BY = ("top-left", "top-right")
CODE = Path(reference.__file__).parent
ALMOST_NONE = 1e-3  # [m/s²] of gravity: forces at rest are judged beside a particle's weight, so there must be some


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
    return float(kept(f"rest strain {still}", CODE, lambda: np.array(reference.rest_strain(still))))


def taut_strain(scene: Scene, pull: float) -> float:
    """The same of a sheet without weight that is held by its left and right edges, `pull` [share] farther apart.

    More than `pull`: it grows narrower in its middle, and threads from the corners of what is held carry that.
    """
    still = Scene(cloth=scene.cloth, fabric=scene.fabric, forces=Forces(gravity=ALMOST_NONE))

    def strain() -> float:
        model = spring_model(still)
        drawn = replace(model.topology, start=model.topology.start * [1 + pull, 1.0, 1.0])
        model = replace(model, topology=drawn)
        return float(model.strains(rest_positions(model))[drawn.family("structural")].max())

    return float(kept(f"taut strain {pull} {still}", CODE, lambda: np.array(strain())))


def softened(fabric: Fabric, share: float) -> Fabric:
    """With so much of the constants of its springs."""
    constants = fabric.warp, fabric.weft, fabric.shear, fabric.bend
    warp, weft, shear, bend = (share * constant for constant in constants)
    return replace(fabric, warp=warp, weft=weft, shear=shear, bend=bend)
