"""Scene files: their schema, how they are read, checked, overridden and written, and what is shipped."""

from ..system.errors import SceneError
from .collider_schema import Box, Ground, Sphere
from .fabric_schema import Look, VerletSprings
from .overrides import parse_override
from .parameters import Parameter, check_parameter, parameters_of
from .presets import scene_names
from .reader import key_table, scene_to_toml
from .schema import Camera, Cloth, Forces, Scene, Solver, Wind

__all__ = [
    "Box",
    "Camera",
    "Cloth",
    "Forces",
    "Ground",
    "Look",
    "Parameter",
    "Scene",
    "SceneError",
    "Solver",
    "Sphere",
    "VerletSprings",
    "Wind",
    "check_parameter",
    "key_table",
    "parameters_of",
    "parse_override",
    "scene_names",
    "scene_to_toml",
]
