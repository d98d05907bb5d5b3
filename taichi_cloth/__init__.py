"""Cloth you can grab, in real time, that tells you how wrong it is.

    import taichi_cloth as tc

    with tc.Simulation(tc.load_scene("curtain", wind_z=6.0)) as simulation:
        for _ in range(240):
            simulation.advance_frame()
        print(simulation.positions(), simulation.measure())
        tc.picture(simulation).save("curtain.png")

Importing the package does not import Taichi; the first use of `Simulation` or `picture` starts it on the CPU unless
it runs already (`taichi_cloth.start` gives the choice).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .runtime import start
from .scene import Scene, SceneError, load_scene, scene_names

if TYPE_CHECKING:
    from .view.picture import Picture, picture
    from .view.shown import Simulation

__version__ = "0.1.0"

__all__ = [
    "Picture",
    "Scene",
    "SceneError",
    "Simulation",
    "__version__",
    "load_scene",
    "picture",
    "scene_names",
    "start",
]

# Public names whose modules need Taichi to run.
_LATE = {"Simulation": "view.shown", "Picture": "view.picture", "picture": "view.picture"}


def __getattr__(name: str) -> Any:
    if name in _LATE:
        from .runtime import start_if_needed

        start_if_needed()
        return getattr(import_module(f".{_LATE[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
