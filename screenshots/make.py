"""Draws every picture in this folder anew: `make screenshots`.

The stills and the animation come from the rasteriser and need no screen. `window.png` is the real window,
opened on a virtual screen; it is left as it is where Xvfb or a Vulkan driver is missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.scene import scene_names
from taichi_cloth.view.draw_list import VIEWS, DrawList
from taichi_cloth.view.png import write_png
from taichi_cloth.view.raster import Raster

HERE = Path(__file__).parent
STILL_FRAME = {"drape15": 150, "table": 150}  # the moment shown, in frames of 1/60 s
DEFAULT_STILL_FRAME = 210


def pictures(name: str, size: tuple[int, int], view: str = "shaded", orbit: float = 0.0) -> Iterator[np.ndarray]:
    """The scene frame after frame; `orbit` turns the camera by that share of the picture's height a frame."""
    scene = tc.load_scene(name)
    camera = OrbitCamera.from_scene(scene.camera)
    raster = Raster(*size)
    with tc.Simulation(scene) as simulation:
        draw_list = DrawList(simulation)
        while True:
            mesh = draw_list.update(view, camera.eye)
            yield raster.draw(mesh, camera.view_projection(size[0] / size[1]), draw_list.lighting)
            simulation.advance_frame()
            camera.orbit(orbit, 0.0)


def still(name: str, view: str = "shaded") -> np.ndarray:
    moment = STILL_FRAME.get(name, DEFAULT_STILL_FRAME)
    return next(picture for k, picture in enumerate(pictures(name, (960, 540), view)) if k == moment)


def main() -> None:
    tc.start()
    for name in scene_names():
        write_png(HERE / f"{name}.png", still(name))
        print(f"{name}.png")
    for view in VIEWS[1:]:
        write_png(HERE / f"view_{view}.png", still("curtain", view))
        print(f"view_{view}.png")
    # 12 s of the curtain at 20 frames a second, the camera drifting by.
    hero = [p for k, p in zip(range(720), pictures("curtain", (640, 360), orbit=-0.0006), strict=False) if k % 3 == 0]
    first, *rest = (Image.fromarray(picture) for picture in hero)
    first.save(HERE / "hero.webp", save_all=True, append_images=rest, duration=50, loop=0, quality=60, method=4)
    print(f"hero.webp, {(HERE / 'hero.webp').stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
