"""Interactive real-time cloth simulation with measured errors.

    import taichi_cloth as tc

    with tc.Simulation(tc.load_scene("curtain", wind_z=6.0)) as simulation:
        simulation.step(240)
        print(simulation.positions(), simulation.metrics())
        tc.render_image(simulation).save("curtain.png")

Importing the package imports neither Taichi nor NumPy. The first use of a name that needs Taichi starts it on the CPU
unless it is running; call `init` first for another backend.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .scene import SceneError
from .scene.collider_schema import Attachment, Box, Capsule, Ground, Mesh, Plane, Sphere
from .scene.fabric_schema import Fabric, Look, VerletSprings, Weave
from .scene.presets import preset_names as list_presets
from .scene.presets import scene_names as list_scenes
from .scene.schema import (
    Camera,
    Cloth,
    Forces,
    Maps,
    Region,
    Scene,
    SelfCollision,
    Solver,
    StrainLimit,
    Tearing,
    Tethers,
    Wind,
)
from .scene.solver_catalog import solver_names as list_solvers
from .system.errors import Diverged, UsageError, nearest_hint
from .system.taichi_runtime import start as init

if TYPE_CHECKING:
    from .collision.colliders import PosedCollider
    from .export.clip import Simulation, export_mesh, replay
    from .geometry.scene_loader import load_scene, save_scene
    from .geometry.topology import ClothMetrics
    from .render.image import Image, render_image, render_video
    from .simulation.copies import FrameError
    from .simulation.events import Event, GrabHandle
    from .simulation.recording import Recorder

__version__ = "0.1.0"

__all__ = [
    "Attachment",
    "Box",
    "Camera",
    "Capsule",
    "Cloth",
    "ClothMetrics",
    "Diverged",
    "Event",
    "Fabric",
    "Forces",
    "FrameError",
    "GrabHandle",
    "Ground",
    "Image",
    "Look",
    "Maps",
    "Mesh",
    "Plane",
    "PosedCollider",
    "Recorder",
    "Region",
    "Scene",
    "SceneError",
    "SelfCollision",
    "Simulation",
    "Solver",
    "Sphere",
    "StrainLimit",
    "Tearing",
    "Tethers",
    "UsageError",
    "VerletSprings",
    "Weave",
    "Wind",
    "__version__",
    "export_mesh",
    "init",
    "list_presets",
    "list_scenes",
    "list_solvers",
    "load_scene",
    "render_image",
    "render_video",
    "replay",
    "save_scene",
]

# Public names that are imported on first use: their modules need NumPy, or Taichi to run.
_NUMPY = {
    "ClothMetrics": "geometry.topology",
    "load_scene": "geometry.scene_loader",
    "save_scene": "geometry.scene_loader",
}
_TAICHI = {
    "Event": "simulation.events",
    "FrameError": "simulation.copies",
    "GrabHandle": "simulation.events",
    "Image": "render.image",
    "PosedCollider": "collision.colliders",
    "Recorder": "simulation.recording",
    "Simulation": "export.clip",
    "export_mesh": "export.clip",
    "render_image": "render.image",
    "render_video": "render.image",
    "replay": "export.clip",
}


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    if name in _TAICHI:
        from .system.taichi_runtime import start_if_needed

        start_if_needed()
    elif name not in _NUMPY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{nearest_hint(name, __all__)}")
    return getattr(import_module(f".{(_NUMPY | _TAICHI)[name]}", __name__), name)
