"""Scenes: what they may say, and reading and writing them."""

from .errors import SceneError
from .library import scene_names
from .live import LiveKey, check_live, live_keys
from .model import Box, Camera, Cloth, Forces, Ground, Look, Scene, Solver, Sphere, Springs, Wind
from .overrides import parse_override
from .reader import check_scene, load_scene
from .table import key_table
from .writer import scene_to_toml

__all__ = [
    "Box",
    "Camera",
    "Cloth",
    "Forces",
    "Ground",
    "LiveKey",
    "Look",
    "Scene",
    "SceneError",
    "Solver",
    "Sphere",
    "Springs",
    "Wind",
    "check_live",
    "check_scene",
    "key_table",
    "live_keys",
    "load_scene",
    "parse_override",
    "scene_names",
    "scene_to_toml",
]
