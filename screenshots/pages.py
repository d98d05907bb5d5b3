"""Draw compare.png, drape.png, web.png, walk and notebook in docs/pictures (`make screenshots`)."""

from __future__ import annotations

import base64
import io
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import nbclient
import nbformat
import numpy as np
from numpy.typing import NDArray
from parameters import write
from PIL import Image

import taichi_cloth as tc
from taichi_cloth.__main__ import main
from taichi_cloth.evaluation.validate.drape import PUBLISHED, drape_simulation, simulate_to_rest
from taichi_cloth.render.image_files import contact_sheet
from taichi_cloth.scene.schema import Camera

TOP = Path(__file__).parents[1]
PICTURES = TOP / "docs" / "pictures"
FRAMES = 100  # simulated before an image of docs/writing_a_scene.md
sys.path[:0] = [str(TOP / "tests" / folder) for folder in ("window", "web")]


def draw_walk() -> None:
    """Draw the scene with the first block of docs/writing_a_scene.md, with the first two, and so on."""
    blocks = re.findall(r"```toml\n(.*?)```", (TOP / "docs/writing_a_scene.md").read_text(encoding="utf-8"), re.DOTALL)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sheet.toml"
        for k in range(len(blocks)):
            file.write_text("\n".join(blocks[: k + 1]), encoding="utf-8")
            with tc.Simulation(tc.load_scene(file)) as simulation:
                simulation.step(FRAMES)
                write(PICTURES / "walk" / f"{k + 1}.png", tc.render_image(simulation, (480, 270)).pixels)


def draw_notebook() -> None:
    """Draw the images that examples/notebook.ipynb shows."""
    notebook = nbformat.read(TOP / "examples" / "notebook.ipynb", 4)
    nbclient.NotebookClient(notebook).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    images = [output["data"]["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    for k, data in enumerate(images):
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            write(PICTURES / "notebook" / f"{k + 1}.png", np.asarray(image))


def draw_compare() -> None:
    """Draw the comparison at the top of docs/compare.md after 150 frames."""
    with tempfile.TemporaryDirectory() as folder:
        variants = ["drape15", "--a", "iterations=2", "--b", "iterations=40"]
        main(["compare", *variants, "--frames", "151", "--every", "150", "--size", "960x360", "--out", folder])
        with Image.open(Path(folder) / "frame_00001.png") as image:
            write(PICTURES / "compare.png", np.asarray(image))


def draw_drape() -> None:
    """Draw the cloths of reference A4.6, from above, as in the test, and from the side."""
    above = Camera(eye=(0.0, 0.6, 1e-3), target=(0.0, 0.0, 0.0), fov=30.0)
    side = Camera(eye=(0.0, 0.14, 0.6), target=(0.0, -0.025, 0.0), fov=14.0)
    images: dict[Camera, list[NDArray[np.uint8]]] = {above: [], side: []}
    tc.init()
    for preset in PUBLISHED:
        with drape_simulation(preset, "explicit") as simulation:
            simulate_to_rest(simulation)
            for camera, panels in images.items():
                simulation.switch_scene(replace(simulation.scene, camera=camera))
                panels.append(tc.render_image(simulation, (270, 270 if camera is above else 125)).pixels)
    rows = [contact_sheet(panels, len(PUBLISHED), gap=4) for panels in images.values()]
    write(PICTURES / "drape.png", np.concatenate(rows))


def draw_web() -> None:
    """Draw the page of `taichi-cloth web` while the cloth is dragged."""
    from chromium import Browser, chromium
    from server import Server

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        server, pipe = Server(Path(folder), "curtain"), chromium(Path(folder))
        page = Browser(pipe, (1280, 720))
        page.open(server.address, ready="typeof update !== 'undefined' && update && sliders.gravity")
        page.value("send('action', 'errors')")  # the server of the tests does not measure them
        page.until("update.frame > 240 && find('.statistics').textContent.includes('error of frame')")
        page.mouse("Pressed", 640, 330, button="left", clickCount=1)
        page.until("drag?.state === 'grabbing'")
        for k in range(40):
            page.mouse("Moved", 640 - k, 330 + k // 2, button="left", buttons=1)
        page.until(f"update.frame > {page.value('update.frame')} + 30")
        write(PICTURES / "web.png", page.picture())
        pipe.close()
        server.stop()


if __name__ == "__main__":
    draw_web()
    draw_compare()
    draw_drape()
    draw_walk()
    draw_notebook()
