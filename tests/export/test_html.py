"""Pages that play a clip: what is in them, by a reader of our own, and how they look and behave in a real browser."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import taichi_cloth
from taichi_cloth.contact.bodies import bodies_at, colliders_of
from taichi_cloth.export.clip import export
from taichi_cloth.export.html import page
from taichi_cloth.export.output import Output
from taichi_cloth.interact.camera import OrbitCamera
from taichi_cloth.page.sheet import quantised
from taichi_cloth.page.template import DRAWING
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import FRAME_SECONDS, Box, Capsule, Ground, Look, Mesh, Plane, Scene, Sphere
from taichi_cloth.simulation import Simulation
from taichi_cloth.view.draw_list import DrawList
from taichi_cloth.view.patterns import pattern_colours
from taichi_cloth.view.portrait import portrait
from taichi_cloth.view.raster import Raster

pytestmark = pytest.mark.usefixtures("on_lists")

FRAMES, SHOWN = 240, 120
EVIL = "</script><script>alert(1)</script> \"'>&amp; <!-- {{data}} \U0001f9f5"
TRIALS = Path(taichi_cloth.__file__).parents[1] / "docs" / "trials.md"


@dataclass(frozen=True)
class Read:
    """What a page holds; S samples, N particles, T triangles, V vertices."""

    head: dict[str, Any]
    x: np.ndarray  # (S, N, 3)
    triangles: np.ndarray  # (T, 3) particles
    tint: np.ndarray  # (T, 3, 3)
    solids: list[tuple[np.ndarray, np.ndarray]]  # of each: corners (3·T, 6), and poses (1 or S, 4, 4)


def read(path: Path) -> Read:
    page = path.read_text(encoding="utf-8")
    head = json.loads(re.search(r'id="head">(.*?)</script>', page, re.DOTALL)[1])
    rest = zlib.decompress(base64.b64decode(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1]))

    def take(kind: str, *shape: int) -> np.ndarray:
        nonlocal rest
        array = np.frombuffer(rest, kind, int(np.prod(shape))).reshape(shape)
        rest = rest[array.nbytes :]
        return array

    vertices = take("<f4", head["solidVertices"], 6)
    poses = take("<f4", head["poses"], 4, 4).transpose(0, 2, 1)
    corners = vertices[take("<u4", head["solidCorners"])]
    owner = take("<u4", head["vertices"])
    triangles = take("<u4", head["triangles"], 3)
    steps = take("<u2", head["samples"], head["particles"], 3)
    for _ in range(2):
        steps = np.cumsum(steps, axis=0, dtype=np.uint16)
    tint = take("u1", head["vertices"], 3)
    assert rest == b""
    solids = [
        (corners[s["first"] : s["first"] + s["corners"]], poses[s["pose"] : s["pose"] + s["poses"]])
        for s in head["solids"]
    ]
    x = np.array(head["low"]) + np.array(head["step"]) * steps
    return Read(head, x, owner[triangles], tint[triangles], solids)


def baked(path: Path, scene: Scene, frames: int, every: int = 1) -> tuple[Read, list[np.ndarray]]:
    """What a page of a scene holds, and where the cloth was at each of its samples."""
    clip = []
    with Simulation(scene, "list") as simulation:
        export(simulation, Output(path, "html", frames, clip=True, every=every), lambda k: None)
        simulation.reset()
        for k in range(frames):
            if k % every == 0:
                clip.append(simulation.positions())
            simulation.advance_frame()
    return read(path), clip


def small(**more: Any) -> Scene:
    scene = load_scene("drape15")
    return replace(scene, cloth=replace(scene.cloth, rows=6, columns=7), **more)


# -- what is in a page -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [1, 3])
def test_places_are_those_of_the_simulation_to_half_a_step(every: int, tmp_path: Path) -> None:
    page, clip = baked(tmp_path / "c.html", small(), 10, every)
    box = np.ptp(np.array(clip), axis=(0, 1))
    assert (np.abs(page.x - clip) <= 0.5 * box / 65535 + 1e-12).all()
    assert page.x.shape == (-(-10 // every), 42, 3)
    assert page.head["rate"] == pytest.approx(60 / every)


@given(arrays(np.float64, (3, 4, 3), elements=st.floats(-1e5, 1e5)))
def test_nothing_is_off_by_more_than_half_a_step(x: np.ndarray) -> None:
    low, step, steps = quantised(x)
    assert (np.abs(low + step * steps - x) <= 0.5 * step + 1e-10).all()
    level = x * [1, 0, 1]
    low, step, steps = quantised(level)
    assert (low + step * steps)[..., 1] == pytest.approx(0)


@pytest.mark.parametrize("pattern", ["plain", "check", "twill"])
def test_every_corner_has_its_particle_and_its_colour(pattern: str, tmp_path: Path) -> None:
    scene = small(look=Look(pattern=pattern, cloth="#102030", check="#f0e0d0"))
    page, _ = baked(tmp_path / "c.html", scene, 1)
    with Simulation(scene, "list") as simulation:
        assert (page.triangles == simulation.topology.triangles).all()
        wanted = 255 * pattern_colours(simulation.topology, scene.look).reshape(-1, 3, 3)
    assert page.tint == pytest.approx(wanted, abs=0.51)


def test_colliders_are_where_they_are_at_each_sample(tmp_path: Path) -> None:
    scene = small(
        spheres=(Sphere(center=(0.0, 9.0, 2.0), radius=0.3, sway=(1.0, 0.0, 0.0), period=(2.0, 2.0, 2.0)),),
        capsules=(Capsule(center=(1.0, 9.0, 3.0), rotation=(0.0, 0.0, 90.0), length=0.8, radius=0.1),),
        boxes=(Box(center=(1.0, 9.5, 0.0), size=(1.0, 2.0, 4.0), spin=(0.0, 90.0, 0.0)),),
        planes=(Plane(center=(0.0, -1.0, 0.0), drawn=3.0),),
        ground=Ground(height=-2.0),
        meshes=load_scene("veil").meshes,
        look=Look(pole=True),
    )
    page, _ = baked(tmp_path / "c.html", scene, 4)
    assert [len(poses) for _, poses in page.solids[:4]] == [4, 1, 4, 1]
    assert len(page.solids) == 6
    for k in range(4):
        bodies = [b for b in bodies_at(colliders_of(scene), k * FRAME_SECONDS) if not isinstance(b.collider, Ground)]
        for (corners, poses), body in zip(page.solids[:-1], bodies, strict=True):
            pose = poses[k if len(poses) > 1 else 0]
            assert pose == pytest.approx(
                np.block([[body.axes, body.center[:, None]], [np.zeros((1, 3)), 1.0]]), abs=1e-5
            )
            assert np.linalg.norm(corners[:, 3:], axis=1) == pytest.approx(1, abs=1e-5)
    (ball, _), (bar, _), (block, _), (_slope, _), (bust, _), (_pole, still) = page.solids
    assert np.linalg.norm(ball[:, :3], axis=1) == pytest.approx(0.3)
    assert np.ptp(bar[:, :3], axis=0) == pytest.approx([0.2, 1.0, 0.2], rel=0.02)
    assert np.ptp(block[:, :3], axis=0) == pytest.approx([1.0, 2.0, 4.0])
    assert isinstance(scene.meshes[0], Mesh)
    assert len(bust) % 3 == 0
    assert (still == np.eye(4)).all()
    assert page.head["ground"] == -2.0


def test_what_a_tear_took_is_gone_from_then_on(tmp_path: Path) -> None:
    left, path = [], tmp_path / "c.html"
    with Simulation(load_scene("tear", rows=8, columns=8, area_density=9.0), "list") as simulation:
        whole = simulation.topology.triangle_count
        export(simulation, Output(path, "html", 40, clip=True), lambda k: left.append(simulation.topology.triangles))
    page = read(path)
    assert page.head["left"][0] == whole
    for k in range(1, 40):  # sample k is the cloth after frame k - 1
        shown = page.triangles[: page.head["left"][k]]
        assert {*map(tuple, shown.tolist())} == {*map(tuple, left[k - 1].tolist())}
    assert page.head["left"][-1] < whole


class Tags(HTMLParser):
    """What a page is made of, as a browser reads it."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: dict[str, str] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text[self.tags[-1][0] if self.tags else ""] = data


@pytest.fixture
def evil(tmp_path: Path) -> Path:
    baked(tmp_path / "evil.html", small(title=EVIL), 1)
    return tmp_path / "evil.html"


def test_a_title_is_text_and_nothing_else(evil: Path, tmp_path: Path) -> None:
    baked(tmp_path / "good.html", small(title="good"), 1)
    pages = []
    for path in (evil, tmp_path / "good.html"):
        pages.append(Tags())
        pages[-1].feed(path.read_text(encoding="utf-8"))
    assert [tag for tag, _ in pages[0].tags] == [tag for tag, _ in pages[1].tags]
    labels = [attributes["aria-label"] for tag, attributes in pages[0].tags if tag == "canvas"]
    assert labels == [EVIL]
    page("name \udcff", {"name": EVIL}, b"").encode()  # of a file: not always text


def test_a_page_fetches_nothing() -> None:
    player = (Path(taichi_cloth.__file__).parent / "export" / "player.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in player
    assert not re.search(r"https?:|src=|href=|import\b|fetch\(", player + DRAWING.read_text(encoding="utf-8"))


def red(picture: np.ndarray) -> np.ndarray:
    """Where there is one of the curtain's two colours."""
    r, g, b = np.moveaxis(picture.astype(int), -1, 0)
    return (r > 90) & (g < 0.45 * r) & (b < 0.5 * r)


# -- in a browser ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Curtain:
    path: Path
    picture: np.ndarray  # of sample `SHOWN`, by the rasteriser


@pytest.fixture(scope="module")
def curtain(tmp_path_factory: pytest.TempPathFactory) -> Curtain:
    path = tmp_path_factory.mktemp("page") / "clip.html"
    scene = load_scene("curtain")
    with Simulation(scene) as simulation:
        export(simulation, Output(path, "html", FRAMES, clip=True), lambda k: None)
        simulation.reset()
        for _ in range(SHOWN):
            simulation.advance_frame()
        draw_list = DrawList(simulation)
        picture = portrait(Raster(640, 360), draw_list, OrbitCamera.from_scene(scene.camera), "shaded")
        draw_list.close()
    return Curtain(path, picture)


def test_a_clip_of_240_frames_is_as_small_as_the_document_says(curtain: Curtain) -> None:
    megabytes = curtain.path.stat().st_size / 1e6
    assert megabytes < 3
    assert f"a web page of 240 frames of the curtain is {megabytes:.1f} MB" in TRIALS.read_text(encoding="utf-8")


def test_the_page_shows_what_the_rasteriser_shows(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path, f"?plain#frame={SHOWN}")
    seen, wanted = browser.picture()[:300], curtain.picture[:300]  # above the controls
    assert browser.value("document.querySelector('output').value") == "2.00 s"
    off = np.abs(seen.astype(int) - wanted).max(axis=2)
    assert np.percentile(off, 95) < 12  # of 255; edges and shadows of folds are drawn otherwise
    assert red(wanted).sum() > 5000
    assert (red(seen) & red(wanted)).sum() > 0.95 * red(wanted).sum()
    browser.open(curtain.path, "?plain#frame=0")
    assert (np.abs(browser.picture()[:300].astype(int) - seen).max(axis=2) > 40).mean() > 0.05
    assert browser.errors == []
    assert browser.requests == [curtain.path.as_uri() + "?plain"]


def test_it_plays_stops_turns_and_zooms(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path)
    playing = "document.querySelector('figure').classList.contains('playing')"
    sample = "+document.querySelector('input').value"
    browser.until(f"{sample} > 3")
    browser.key("Space", " ")
    assert not browser.value(playing)
    shown = browser.value(sample)
    before = browser.picture()
    browser.drag((300, 150), (400, 170))
    assert browser.value("camera.azimuth") < browser.value("Math.atan2(3.4, 6.5)")
    assert browser.value("camera.elevation") > browser.value("Math.asin((2.6 - 2.05) / camera.first)")
    assert (browser.picture() != before).mean() > 0.2
    browser.mouse("Wheel", 300, 150, deltaX=0, deltaY=-240)
    browser.until("camera.far < 0.9 * camera.first")
    browser.mouse("Pressed", 300, 150, button="left", clickCount=2)
    browser.mouse("Released", 300, 150, button="left", clickCount=2)
    browser.until("camera.far === camera.first")
    assert browser.value(sample) == shown
    browser.drag((320, 334), (320, 334))  # the middle of the scrubber
    assert abs(browser.value(sample) - FRAMES / 2) < 12
    browser.drag((28, 334), (28, 334))  # the button, which then takes Space
    assert browser.value(playing)
    browser.key("Space", " ")
    assert not browser.value(playing)
    assert browser.errors == []


def test_a_clip_begins_again_when_it_is_over(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path, f"#frame={FRAMES - 3}")
    browser.key("Space", " ")
    browser.until("+document.querySelector('input').value < 100")


def test_a_title_stays_a_title_in_a_browser(browser: Any, evil: Path) -> None:
    browser.open(evil)
    assert browser.value("document.title") == EVIL
    assert browser.value("document.querySelector('figcaption').checkVisibility()")
    browser.open(evil, "?plain")
    assert not browser.value("document.querySelector('figcaption').checkVisibility()")
    assert browser.errors == []


def test_it_fits_a_frame_in_another_page(browser: Any, curtain: Curtain) -> None:
    page = curtain.path.with_name("blog.html")
    page.write_text('<iframe src="clip.html" style="width: 50%; aspect-ratio: 16/9; border: 0"></iframe>')
    browser.open(page, "", "window.innerWidth")
    width, height = (browser.value(f"document.querySelector('iframe').client{side}") for side in ("Width", "Height"))
    assert width < 320
    for _ in range(200):  # until it is drawn
        seen = red(browser.picture())
        if seen.sum() > 500:
            break
    assert not seen[height + 16 :].any()
    rows, columns = np.nonzero(seen)
    middle = np.array([rows.mean(), columns.mean()]) - 8  # [pixels] of a page's margin
    assert np.abs(middle / (height, width) - 0.5).max() < 0.2


def test_an_old_browser_is_told_so(browser: Any, evil: Path) -> None:
    old = browser.say("Page.addScriptToEvaluateOnNewDocument", source="delete window.DecompressionStream")
    browser.open(evil, "", "document.querySelector('.message')")
    browser.say("Page.removeScriptToEvaluateOnNewDocument", identifier=old["identifier"])
    assert "needs a browser of 2023 or later" in browser.value("document.querySelector('.message').textContent")
