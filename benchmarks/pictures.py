"""Measure the images per second of the rasterizer on every shipped scene: `python benchmarks/pictures.py [SCENE ...]`.

An image is what `render` makes of a frame: the scene is converted to lit triangles, and these are drawn at 1920 × 1080
with 4 samples per pixel. Physics is not included. PNG files, which `render` writes in another thread, have their own
column. `CPU` is the time of all threads together: on a busy machine it says more than the elapsed time.
"""

from __future__ import annotations

import statistics
import sys
import time

import taichi_cloth as tc
from taichi_cloth.render.camera import OrbitCamera
from taichi_cloth.render.draw_list import DrawList
from taichi_cloth.render.image import render_pixels
from taichi_cloth.render.image_files import encode_png
from taichi_cloth.render.rasterizer import Rasterizer

WIDTH, HEIGHT = 1920, 1080
FRAMES = 40  # simulated before the first image, so that the cloth hangs or lies in folds
IMAGES = 20
HEADER = "| scene | triangles | image [ms] | images/s | CPU [ms] | PNG [ms] |\n|---|---|---|---|---|---|"


def measure(name: str) -> tuple[float, str]:
    """Return the images per second of a scene, and its row of the table. Times are medians."""
    with tc.Simulation(tc.load_scene(name)) as simulation:
        simulation.step(FRAMES)
        camera, raster = OrbitCamera.from_scene(simulation.scene.camera), Rasterizer(WIDTH, HEIGHT)
        draw_list = DrawList(simulation)
        try:
            image = render_pixels(raster, draw_list, camera, "shaded")  # compiles
            elapsed, cpu = [], []
            for _ in range(IMAGES):
                start, cpu_start = time.perf_counter(), time.process_time()
                render_pixels(raster, draw_list, camera, "shaded")
                elapsed.append(time.perf_counter() - start)
                cpu.append(time.process_time() - cpu_start)
            triangles = draw_list.mesh.corners // 3
        finally:
            draw_list.close()
    start = time.perf_counter()
    encode_png(image)
    png = time.perf_counter() - start
    seconds, cpu_seconds = statistics.median(elapsed), statistics.median(cpu)
    row = f"{1e3 * seconds:.1f} | {1 / seconds:.1f} | {1e3 * cpu_seconds:.1f} | {1e3 * png:.0f}"
    return 1 / seconds, f"| {name} | {triangles} | {row} |"


def main() -> None:
    tc.init()
    print(HEADER, flush=True)
    rates = {}
    for name in sys.argv[1:] or tc.list_scenes():
        rates[name], row = measure(name)
        print(row, flush=True)
    slowest = min(rates, key=lambda name: rates[name])
    print(f"\nThe slowest is {slowest} with {rates[slowest]:.1f} images/s.")


if __name__ == "__main__":
    main()
