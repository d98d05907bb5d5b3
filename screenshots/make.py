"""Draws every picture in this folder anew: `make screenshots`.

The stills and the animation come from the rasteriser and need no screen. `window.png` is the real window,
opened on a virtual screen; it is left as it is where Xvfb or a Vulkan driver is missing.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.scene import scene_names
from taichi_cloth.view.contact_sheet import contact_sheet
from taichi_cloth.view.draw_list import VIEWS, DrawList
from taichi_cloth.view.png import write_png
from taichi_cloth.view.portrait import portrait
from taichi_cloth.view.raster import Raster

HERE = Path(__file__).parent
STILL_FRAME = {  # the moment shown, in frames of 1/60 s
    "banner": 250,
    "cape": 122,
    "drape15": 150,
    "flag": 62,
    "hammock": 240,
    "sail": 170,
    "sphere": 130,
    "table": 150,
    "slope": 185,
    "fast-ball": 57,
    "fold": 34,
    "stack": 140,
    "twist": 360,
    "veil": 60,
    "poles": 210,
    "responses": 240,
    "round": 120,
    "relief": 118,
    "tear": 105,
}
DEFAULT_STILL_FRAME = 85
GALLERY = HERE.parent / "docs" / "gallery.md"
THUMBNAIL = 3  # times smaller than a still
PULL = (330, 450)  # first and last frame of the pull in the animation


def pictures(name: str, size: tuple[int, int]) -> Iterator[np.ndarray]:
    """The scene frame after frame, while the camera drifts by and a hand pulls the cloth once."""
    scene = tc.load_scene(name)
    camera, raster = OrbitCamera.from_scene(scene.camera), Raster(*size)
    with tc.Simulation(scene) as simulation:
        draw_list = DrawList(simulation)
        while True:
            yield portrait(raster, draw_list, camera, "shaded")
            pull(simulation)
            camera.orbit(-0.00018, 0.0)
            simulation.advance_frame()


def pull(simulation: tc.Simulation) -> None:
    """Takes the lower left corner, lifts it towards the eye and throws it back."""
    corner = simulation.topology.particle_count - simulation.scene.cloth.columns + 1
    share = (simulation.frame - PULL[0]) / (PULL[1] - PULL[0])
    if 0 <= share < 1:
        here = simulation.positions()[corner]
        swing = np.sin(np.pi * min(share / 0.8, 1.0) / 2) if share < 0.8 else 1 - 4 * (share - 0.8)
        goal = np.array([-1.6, 1.1, 0.4]) + swing * np.array([0.4, 1.2, 1.9])
        step = goal - here
        simulation.grab(corner, here + step * min(1.0, 0.06 / max(float(np.linalg.norm(step)), 1e-9)))
    elif simulation.grabbed is not None:
        simulation.release()


def still(name: str, view: str = "shaded", size: tuple[int, int] = (960, 540)) -> np.ndarray:
    """The scene at its moment."""
    with tc.Simulation(tc.load_scene(name)) as simulation:
        for _ in range(STILL_FRAME.get(name, DEFAULT_STILL_FRAME)):
            simulation.advance_frame()
        return tc.picture(simulation, *size, view).pixels


def gallery(names: list[str]) -> None:
    """The page that shows every scene, from its title and its thumbnail."""
    rows = [f"| [![{n}](gallery/{n}.png)](../screenshots/{n}.png) | `{n}` | {tc.load_scene(n).title} |" for n in names]
    what = "Every shipped scene, each there for one idea: `taichi-cloth run NAME`. `make screenshots` wrote this."
    head = f"# Gallery\n\n{what}\n"
    GALLERY.write_text("\n".join([head, "| | scene | what it shows |", "|---|---|---|", *rows, ""]), encoding="utf-8")


def window(moment: int) -> np.ndarray:
    """The real window on a virtual screen, after that many frames of simulated time."""
    sys.path.insert(0, str(HERE.parent / "tests" / "window"))
    from screen import Screen

    with tempfile.TemporaryDirectory() as folder:
        screen, log = Screen(Path(folder)), Path(folder) / "log"
        command = [sys.executable, "-m", "taichi_cloth", "run", "--size", "1280x720", "--log", str(log)]
        program = subprocess.Popen(command, env={**os.environ, "DISPLAY": screen.display})
        try:
            while program.poll() is None:
                lines = log.read_text().splitlines() if log.exists() else []
                if len(lines) > 1 and json.loads(lines[-2])["frame"] >= moment:
                    return screen.pixels()[40:760, 40:1320]  # the window's place: view/window.py
                time.sleep(0.1)
            raise RuntimeError(f"the window ended with exit code {program.returncode}")
        finally:
            program.terminate()
            program.wait()
            screen.close()


def main() -> None:
    tc.start()
    names = scene_names()
    GALLERY.with_suffix("").mkdir(exist_ok=True)
    for name in names:
        picture = still(name)
        write_png(HERE / f"{name}.png", picture)
        write_png(GALLERY.with_suffix("") / f"{name}.png", contact_sheet([picture], 1, THUMBNAIL, gap=0))
        print(f"{name}.png")
    gallery(names)
    for view in VIEWS[1:]:
        write_png(HERE / f"view_{view}.png", still("curtain", view))
        print(f"view_{view}.png")
    if shutil.which("Xvfb"):
        write_png(HERE / "window.png", np.ascontiguousarray(window(DEFAULT_STILL_FRAME)))
        print("window.png")
    else:
        print("window.png is left as it is: Xvfb is not installed")
    # 10 s of the curtain at 20 pictures a second.
    frames = zip(range(600), pictures("curtain", (640, 360)), strict=False)
    hero = [picture for k, picture in frames if k % 3 == 0]
    first, *rest = (Image.fromarray(picture) for picture in hero)
    first.save(HERE / "hero.webp", save_all=True, append_images=rest, duration=50, loop=0, quality=60, method=4)
    print(f"hero.webp, {(HERE / 'hero.webp').stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
