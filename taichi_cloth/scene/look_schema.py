"""The camera, and the colors and patterns of the cloth: sections of a scene that do not affect the motion."""

from __future__ import annotations

from dataclasses import dataclass

from .keys import Table, Vec3, key_field

PATTERN_NAMES = ("plain", "check", "stripe", "gingham", "twill", "ring")  # render/colors.py


@dataclass(frozen=True)
class Camera(Table):
    """The camera of the window and of images. Without this section it frames the cloth and the colliders near it."""

    eye: Vec3 = key_field((3.5, 2.6, 6.5), "position of the camera", "m", min=-1e5, max=1e5)
    target: Vec3 = key_field((0.0, 1.9, 0.0), "point that the camera looks at", "m", min=-1e5, max=1e5)
    fov: float = key_field(40.0, "vertical field of view", "degrees", min=1.0, max=120.0)


@dataclass(frozen=True)
class Look(Table):
    """Colors and patterns. They do not affect the motion. A fabric preset sets its own."""

    color: str = key_field("#b5303c", "first color of the pattern", color=True)
    second_color: str = key_field("#e9dcc3", "second color of the pattern", color=True)
    pattern_scale: int = key_field(
        3, "cells per check, per stripe or per half period of a twill; on a mesh file, edges per ring", min=1, max=2048
    )
    pattern: str = key_field("check", "pattern of the two colors", choices=PATTERN_NAMES)
    sheen: float = key_field(0.08, "brightness of the specular highlight", min=0.0, max=1.0)
    pole: bool = key_field(False, "draws a pole along the top edge")
