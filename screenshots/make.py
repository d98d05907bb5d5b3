"""Draw every image in this folder, and write docs/gallery.md: `make screenshots`.

The stills and the animation come from the rasterizer and need no display. `window.png` shows the real window on a
virtual display; without Xvfb it stays as it is.
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
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import taichi_cloth as tc
from taichi_cloth.render.camera import OrbitCamera
from taichi_cloth.render.draw_list import VIEWS, DrawList
from taichi_cloth.render.image import render_pixels
from taichi_cloth.render.image_files import contact_sheet, write_png
from taichi_cloth.render.rasterizer import Rasterizer
from taichi_cloth.scene import scene_names
from taichi_cloth.simulation.copies import FrameError, FrameErrorMeter
from taichi_cloth.viewer.window import STATISTICS_EVERY

HERE = Path(__file__).parent
STILL_FRAME = {  # frame that the still shows
    "banner": 250,
    "bias": 239,
    "skirt": 120,
    "trellis": 330,
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
    "towel": 330,
    "knot": 230,
    "walker": 100,
}
DEFAULT_STILL_FRAME = 85
IN_FRONT, SPHERE_PERIOD = 345, 360  # frames: when the sphere of the curtain is in front of it, and when again
GALLERY = HERE.parent / "docs" / "gallery.md"
THUMBNAIL = 3  # factor by which a thumbnail is smaller than a still
GRABS = ((90, 210), (330, 450))  # frames of the animation between which the cursor pulls a corner
APPROACH = 45  # frames in which the cursor comes, and goes
ARROW = ((0, 0), (0, 17), (4, 13), (7, 19), (10, 18), (7, 12), (12, 12))  # [pixels] outline of the cursor


def animation(name: str, size: tuple[int, int]) -> Iterator[np.ndarray]:
    """Yield an image of each frame of a scene, while the camera turns slowly and a cursor pulls a corner."""
    scene = tc.load_scene(name)
    camera, raster = OrbitCamera.from_scene(scene), Rasterizer(*size)
    grab = None
    with tc.Simulation(scene) as simulation:
        draw_list = DrawList(simulation)
        corner = simulation.topology.particle_count - scene.cloth.columns + 1  # next to the lower left corner
        while True:
            position, frame = simulation.positions()[corner], simulation.frame
            first, last = min(GRABS, key=lambda grab: abs(sum(grab) / 2 - frame))  # the nearest one
            away = max(first - frame, frame - last, 0) / APPROACH  # 0 while it pulls, 1 when the cursor is out
            image = render_pixels(raster, draw_list, camera, "shaded")
            yield with_cursor(image, camera.to_screen(position, size[0] / size[1])[0][0], away) if away < 1 else image
            if frame == first:
                grab = simulation.grab(corner, radius=0.2)
            if grab is not None and frame == last:
                grab.release()
                grab = None
            if grab is not None:
                grab.move_to(goal((frame - first) / (last - first), position))
            camera.orbit(-0.00018, 0.0)
            simulation.step()


def with_cursor(image: np.ndarray, point: np.ndarray, away: float) -> np.ndarray:
    """Return an image with an arrow at a screen point, or on its way from the lower left corner: `away` is 1 there."""
    height, width, _ = image.shape
    place = (1 - away) ** 2 * point * [width, -height] + [0, (1 - away) ** 2 * height + (1 - (1 - away) ** 2) * height]
    drawn = Image.fromarray(image)
    outline = [(float(x + place[0]), float(y + place[1])) for x, y in ARROW]
    ImageDraw.Draw(drawn).polygon(outline, fill=(255, 255, 255), outline=(20, 20, 20))
    return np.asarray(drawn)


def goal(share: float, position: np.ndarray) -> np.ndarray:
    """Return where the grab moves next [m], at most 6 cm from `position`: toward the camera, then quickly back.

    `share`: elapsed part of the grab's time.
    """
    swing = np.sin(np.pi * (share / 0.8) / 2) if share < 0.8 else 1 - 4 * (share - 0.8)
    step = np.array([-1.6, 1.1, 0.4]) + swing * np.array([0.4, 1.2, 1.9]) - position
    moved: np.ndarray = position + step * min(1.0, 0.06 / max(float(np.linalg.norm(step)), 1e-9))
    return moved


def still(name: str, view: str = "shaded", size: tuple[int, int] = (960, 540)) -> np.ndarray:
    """Return an image of a scene at its frame of `STILL_FRAME`."""
    with tc.Simulation(tc.load_scene(name)) as simulation:
        simulation.step(STILL_FRAME.get(name, DEFAULT_STILL_FRAME) - 1)
        with closing(DrawList(simulation)) as draw_list:
            draw_list.show_error(last_step(simulation, measured=view == "error"), is_of_this_frame=True)
            return render_pixels(Rasterizer(*size), draw_list, OrbitCamera.from_scene(simulation.scene), view)


def last_step(simulation: tc.Simulation, *, measured: bool) -> FrameError | None:
    """Run one frame. Return its error if it is measured."""
    if not measured:
        simulation.step()
        return None
    with closing(FrameErrorMeter(simulation.scene)) as meter:
        return meter.measure_frame(simulation)


def write_gallery(names: list[str]) -> None:
    """Write the page that shows every scene with its title and thumbnail."""
    rows = [f"| [![{n}](gallery/{n}.png)](../screenshots/{n}.png) | `{n}` | {tc.load_scene(n).title} |" for n in names]
    text = "All shipped scenes. Open one with `taichi-cloth run NAME`. This page is generated by `make screenshots`."
    lines = ["# Gallery", "", text, "", "| | scene | description |", "|---|---|---|", *rows, ""]
    GALLERY.write_text("\n".join(lines), encoding="utf-8")


def window() -> np.ndarray:
    """Return an image of the real window on a virtual display, with a measured error and the sphere in front."""
    sys.path.insert(0, str(HERE.parent / "tests" / "window"))
    from screen import Screen

    with tempfile.TemporaryDirectory() as folder:
        screen, log = Screen(Path(folder)), Path(folder) / "log"
        command = [sys.executable, "-m", "taichi_cloth", "run", "--size", "1280x720", "--log", str(log)]
        program = subprocess.Popen(command, env={**os.environ, "DISPLAY": screen.display})
        try:
            while program.poll() is None:
                lines = log.read_text().splitlines() if log.exists() else []
                last = json.loads(lines[-2]) if len(lines) > 1 else {"frame": 0}
                if (last["frame"] - IN_FRONT) % SPHERE_PERIOD < 20 and last.get("frame_error") is not None:
                    time.sleep(2 * STATISTICS_EVERY)
                    return screen.pixels()[40:760, 40:1320]  # position of the window: viewer/window.py
                time.sleep(0.1)
            raise RuntimeError(f"the window ended with exit code {program.returncode}")
        finally:
            program.terminate()
            program.wait()
            screen.close()


def main() -> None:
    tc.init()
    names = scene_names()
    GALLERY.with_suffix("").mkdir(exist_ok=True)
    for name in names:
        image = still(name)
        write_png(HERE / f"{name}.png", image)
        write_png(GALLERY.with_suffix("") / f"{name}.png", contact_sheet([image], 1, THUMBNAIL, gap=0))
        print(f"{name}.png")
    write_gallery(names)
    for view in VIEWS[1:]:
        write_png(HERE / f"view_{view}.png", still("curtain", view))
        print(f"view_{view}.png")
    if shutil.which("Xvfb"):
        write_png(HERE / "window.png", np.ascontiguousarray(window()))
        print("window.png")
    else:
        print("window.png was not drawn: Xvfb is not installed")
    # 10 s of the curtain at 20 images per second.
    frames = zip(range(600), animation("curtain", (640, 360)), strict=False)
    first, *rest = (Image.fromarray(image) for k, image in frames if k % 3 == 0)
    first.save(HERE / "hero.webp", save_all=True, append_images=rest, duration=50, loop=0, quality=60, method=4)
    print(f"hero.webp, {(HERE / 'hero.webp').stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
