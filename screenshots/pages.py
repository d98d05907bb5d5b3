"""Draws docs/pictures/compare.png, drape.png and web.png, docs/pictures/walk, the scene of docs/writing_a_scene.md as
it grows, and docs/pictures/notebook, what examples/notebook.ipynb shows. `make screenshots` runs it too.
"""

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
from taichi_cloth.cli import main
from taichi_cloth.scene.model import Camera
from taichi_cloth.validate.drape import PUBLISHED, hung, settled
from taichi_cloth.view.contact_sheet import contact_sheet

TOP = Path(__file__).parents[1]
PICTURES = TOP / "docs" / "pictures"
MOMENT = 100  # [frames] of the scene that grows
sys.path[:0] = [str(TOP / "tests" / folder) for folder in ("window", "web")]  # a real server in a real browser


def draw_walk() -> None:
    """The scene with the first block of the page, with the first two, and so on."""
    blocks = re.findall(r"```toml\n(.*?)```", (TOP / "docs/writing_a_scene.md").read_text(encoding="utf-8"), re.DOTALL)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sheet.toml"
        for k in range(len(blocks)):
            file.write_text("\n".join(blocks[: k + 1]), encoding="utf-8")
            with tc.Simulation(tc.load_scene(file)) as simulation:
                for _ in range(MOMENT):
                    simulation.advance_frame()
                write(PICTURES / "walk" / f"{k + 1}.png", tc.picture(simulation, 480, 270).pixels)


def draw_notebook() -> None:
    notebook = nbformat.read(TOP / "examples" / "notebook.ipynb", 4)
    nbclient.NotebookClient(notebook).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = [output["data"]["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    for k, picture in enumerate(shown):
        with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
            write(PICTURES / "notebook" / f"{k + 1}.png", np.asarray(image))


def draw_compare() -> None:
    """What the command at the top of docs/compare.md leaves on the screen after 150 frames."""
    with tempfile.TemporaryDirectory() as folder:
        what = ["drape15", "--a", "iterations=2", "--b", "iterations=40"]
        how = ["--frames", "151", "--every", "150", "--size", "960x360", "--out", folder]
        main(["compare", *what, *how])
        with Image.open(Path(folder) / "frame_00001.png") as image:
            write(PICTURES / "compare.png", np.asarray(image))


def draw_drape() -> None:
    """The cloths of reference A4.6: above as the lamp of that test sees them, below from the side."""
    above, beside = Camera(eye=(0.0, 0.6, 1e-3), target=(0.0, 0.0, 0.0), fov=30.0), Camera((0.0, 0.14, 0.6), fov=14.0)
    beside = replace(beside, target=(0.0, -0.025, 0.0))
    seen: dict[Camera, list[NDArray[np.uint8]]] = {above: [], beside: []}
    tc.start()
    for preset in PUBLISHED:
        with hung(preset, "spring") as simulation:
            settled(simulation)
            for camera, panels in seen.items():
                simulation.change(replace(simulation.scene, camera=camera))
                panels.append(tc.picture(simulation, 270, 270 if camera is above else 125).pixels)
    rows = [contact_sheet(panels, len(PUBLISHED), gap=4) for panels in seen.values()]
    write(PICTURES / "drape.png", np.concatenate(rows))


def draw_web() -> None:
    """The page of `taichi-cloth web`, with a hand on the cloth."""
    from chromium import Browser, chromium
    from server import Server

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        server, pipe = Server(Path(folder), "curtain"), chromium(Path(folder))
        page = Browser(pipe, (1280, 720))
        page.open(server.address, ready="typeof moment !== 'undefined' && moment && sliders.gravity")
        page.until("moment.frame > 240")
        page.mouse("Pressed", 640, 330, button="left", clickCount=1)
        page.until("pull?.state === 'holds'")
        for k in range(40):
            page.mouse("Moved", 640 - 2 * k, 330 + k, button="left", buttons=1)
        page.until(f"moment.frame > {page.value('moment.frame')} + 30")
        write(PICTURES / "web.png", page.picture())
        pipe.close()
        server.stop()


if __name__ == "__main__":
    draw_web()
    draw_compare()
    draw_drape()
    draw_walk()
    draw_notebook()
