"""Scenes: what they may say, and reading and writing them."""

from .errors import SceneError
from .library import scene_names
from .live import LiveKey, live_keys
from .model import Scene
from .reader import load_scene, parse_override
from .table import key_table
from .writer import scene_to_toml

__all__ = [
    "LiveKey",
    "Scene",
    "SceneError",
    "key_table",
    "live_keys",
    "load_scene",
    "parse_override",
    "scene_names",
    "scene_to_toml",
]
