"""How many pictures a second the rasteriser draws of every shipped scene: `python benchmarks/pictures.py [SCENE ...]`.

A picture is what `render` makes of a frame: the scene made into lit triangles, and these drawn, at 1920 × 1080 with
4 samples a pixel. Physics and PNG files are not in it; a file, which `render` writes in a thread beside, has a column
of its own. `processor` is the time of all threads together: on a machine in use it tells more than the clock does.
"""

from __future__ import annotations

import statistics
import sys
import time

import taichi_cloth as tc
from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.scene import load_scene, scene_names
from taichi_cloth.simulation import Simulation
from taichi_cloth.view.draw_list import DrawList
from taichi_cloth.view.png import encode_png
from taichi_cloth.view.portrait import portrait
from taichi_cloth.view.raster import Raster

WIDTH, HEIGHT = 1920, 1080
FRAMES = 40  # simulated before the first picture: the cloth hangs or lies in folds
PICTURES = 20
HEADER = "| scene | triangles | picture [ms] | pictures/s | processor [ms] | PNG [ms] |\n|---|---|---|---|---|---|"


def timed(name: str) -> tuple[float, str]:
    """Pictures a second of a scene, and its row of the table. Times are medians."""
    with Simulation(load_scene(name)) as simulation:
        for _ in range(FRAMES):
            simulation.advance_frame()
        camera, raster = OrbitCamera.from_scene(simulation.scene.camera), Raster(WIDTH, HEIGHT)
        draw_list = DrawList(simulation)
        try:
            picture = portrait(raster, draw_list, camera, "shaded")  # compiles
            clock, processor = [], []
            for _ in range(PICTURES):
                began, busy = time.perf_counter(), time.process_time()
                portrait(raster, draw_list, camera, "shaded")
                clock.append(time.perf_counter() - began)
                processor.append(time.process_time() - busy)
            triangles = draw_list.mesh.corners // 3
        finally:
            draw_list.close()
    began = time.perf_counter()
    encode_png(picture)
    png = time.perf_counter() - began
    wall, busy = statistics.median(clock), statistics.median(processor)
    return 1 / wall, (
        f"| {name} | {triangles} | {1e3 * wall:.1f} | {1 / wall:.1f} | {1e3 * busy:.1f} | {1e3 * png:.0f} |"
    )


def main() -> None:
    tc.start()
    print(HEADER, flush=True)
    rates = {}
    for name in sys.argv[1:] or scene_names():
        rates[name], row = timed(name)
        print(row, flush=True)
    slowest = min(rates, key=lambda name: rates[name])
    print(f"\nThe slowest is {slowest} with {rates[slowest]:.1f} pictures/s.")


if __name__ == "__main__":
    main()
