"""The light of every picture."""

from __future__ import annotations

from ..scene.model import Vec3
from .draw_mesh import Light, Lighting


def studio(target: Vec3, distance: float) -> Lighting:
    """A warm lamp high on the left, a cool one low on the right; `distance` [m] is the eye's from `target`."""

    def lamp(x: float, y: float, z: float, colour: Vec3) -> Light:
        # Far away against the size of the scene, so that the light falls nearly parallel.
        return Light((target[0] + x * distance, target[1] + y * distance, target[2] + z * distance), colour)

    return Lighting(
        ambient=(0.30, 0.31, 0.34),
        lights=(lamp(-2.4, 4.2, 3.0, (0.62, 0.58, 0.52)), lamp(4.0, 1.2, 1.5, (0.16, 0.19, 0.25))),
        background=(0.87, 0.89, 0.91),
    )
