"""Pages that play a clip: their contents, read by a reader of this test, and their appearance in a browser."""

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
from taichi_cloth.collision.colliders import colliders_of, pose_colliders
from taichi_cloth.export.clip import export
from taichi_cloth.export.html import page
from taichi_cloth.export.output import Output
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.camera import OrbitCamera
from taichi_cloth.render.colors import pattern_colors
from taichi_cloth.render.draw_list import DrawList
from taichi_cloth.render.image import render_pixels
from taichi_cloth.render.rasterizer import Rasterizer
from taichi_cloth.render.webgl import RENDERER_SCRIPT, quantize
from taichi_cloth.scene.collider_schema import Attachment, Box, Capsule, Ground, Mesh, Plane, Sphere
from taichi_cloth.scene.fabric_schema import Look
from taichi_cloth.scene.schema import FRAME_SECONDS, Camera, Cloth, Scene
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.usefixtures("serial_layout")

FRAMES, SHOWN = 240, 120
EVIL = "</script><script>alert(1)</script> \"'>&amp; <!-- {{data}} \U0001f9f5"
TRIALS = Path(taichi_cloth.__file__).parents[1] / "docs" / "trials.md"


@dataclass(frozen=True)
class PageData:
    """The contents of a page; S samples, N particles, T triangles, V vertices."""

    head: dict[str, Any]
    x: np.ndarray  # (S, N, 3)
    triangles: np.ndarray  # (T, 3) particles
    colors: np.ndarray  # (T, 3, 3), 0…255
    solids: list[tuple[np.ndarray, np.ndarray]]  # corners (3·T, 6) and poses (1 or S, 4, 4) of each


def read(path: Path) -> PageData:
    page = path.read_text(encoding="utf-8")
    found = [re.search(rf'id="{name}">(.*?)</script>', page, re.DOTALL) for name in ("head", "data")]
    head_text, data_text = (match[1] for match in found if match)
    head = json.loads(head_text)
    rest = zlib.decompress(base64.b64decode(data_text))

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
    colors = take("u1", head["vertices"], 3)
    assert rest == b""
    solids = [
        (corners[s["first"] : s["first"] + s["corners"]], poses[s["pose"] : s["pose"] + s["poses"]])
        for s in head["solids"]
    ]
    x = np.array(head["low"]) + np.array(head["step"]) * steps
    return PageData(head, x, owner[triangles], colors[triangles], solids)


def baked(path: Path, scene: Scene, frames: int, every: int = 1) -> tuple[PageData, list[np.ndarray]]:
    """Return the contents of a page of a scene, and the positions at each of its samples."""
    clip = []
    with Simulation(scene, "serial") as simulation:
        export(simulation, Output(path, "html", frames, clip=True, every=every), lambda k: None)
        simulation.reset()
        for k in range(frames):
            if k % every == 0:
                clip.append(simulation.positions())
            simulation.step()
    return read(path), clip


def small(**more: Any) -> Scene:
    scene = load_scene("drape15")
    return replace(scene, cloth=replace(scene.cloth, rows=6, columns=7), **more)


# -- contents of a page -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [1, 3])
def test_positions_are_those_of_the_simulation_to_half_a_step(every: int, tmp_path: Path) -> None:
    page, clip = baked(tmp_path / "c.html", small(), 10, every)
    box = np.ptp(np.array(clip), axis=(0, 1))
    assert (np.abs(page.x - clip) <= 0.5 * box / 65535 + 1e-12).all()
    assert page.x.shape == (-(-10 // every), 42, 3)
    assert page.head["rate"] == pytest.approx(60 / every)


@given(arrays(np.float64, (3, 4, 3), elements=st.floats(-1e5, 1e5)))
def test_quantization_error_is_at_most_half_a_step(x: np.ndarray) -> None:
    low, step, steps = quantize(x)
    assert (np.abs(low + step * steps - x) <= 0.5 * step + 1e-10).all()
    flat = x * [1, 0, 1]
    low, step, steps = quantize(flat)
    assert (low + step * steps)[..., 1] == pytest.approx(0)


@pytest.mark.parametrize("pattern", ["plain", "check", "twill"])
def test_every_corner_has_its_particle_and_its_color(pattern: str, tmp_path: Path) -> None:
    scene = small(look=Look(pattern=pattern, color="#102030", second_color="#f0e0d0"))
    page, _ = baked(tmp_path / "c.html", scene, 1)
    with Simulation(scene, "serial") as simulation:
        assert (page.triangles == simulation.topology.triangles).all()
        expected = 255 * pattern_colors(simulation.topology, scene.look).reshape(-1, 3, 3)
    assert page.colors == pytest.approx(expected, abs=0.51)


def test_colliders_have_their_poses_at_each_sample(tmp_path: Path) -> None:
    scene = small(
        spheres=(Sphere(center=(0.0, 9.0, 2.0), radius=0.3, oscillation=(1.0, 0.0, 0.0), period=(2.0, 2.0, 2.0)),),
        capsules=(Capsule(center=(1.0, 9.0, 3.0), rotation=(0.0, 0.0, 90.0), length=0.8, radius=0.1),),
        boxes=(Box(center=(1.0, 9.5, 0.0), size=(1.0, 2.0, 4.0), spin=(0.0, 90.0, 0.0)),),
        planes=(Plane(center=(0.0, -1.0, 0.0), display_size=3.0),),
        ground=Ground(height=-2.0),
        meshes=load_scene("veil").meshes,
        look=Look(pole=True),
    )
    page, _ = baked(tmp_path / "c.html", scene, 4)
    assert [len(poses) for _, poses in page.solids[:4]] == [4, 1, 4, 1]
    assert len(page.solids) == 6
    for k in range(4):
        posed = pose_colliders(colliders_of(scene), k * FRAME_SECONDS)
        solids = [one for one in posed if not isinstance(one.collider, Ground)]
        for (corners, poses), solid in zip(page.solids[:-1], solids, strict=True):
            pose = poses[k if len(poses) > 1 else 0]
            assert pose == pytest.approx(
                np.block([[solid.axes, solid.center[:, None]], [np.zeros((1, 3)), 1.0]]), abs=1e-5
            )
            assert np.linalg.norm(corners[:, 3:], axis=1) == pytest.approx(1, abs=1e-5)
    (sphere, _), (capsule, _), (box, _), (_plane, _), (mesh, _), (_pole, pole_poses) = page.solids
    assert np.linalg.norm(sphere[:, :3], axis=1) == pytest.approx(0.3)
    assert np.ptp(capsule[:, :3], axis=0) == pytest.approx([0.2, 1.0, 0.2], rel=0.02)
    assert np.ptp(box[:, :3], axis=0) == pytest.approx([1.0, 2.0, 4.0])
    assert isinstance(scene.meshes[0], Mesh)
    assert len(mesh) % 3 == 0
    assert (pole_poses == np.eye(4)).all()
    assert page.head["ground"] == -2.0


def test_torn_triangles_are_hidden_from_then_on(tmp_path: Path) -> None:
    remaining: list[np.ndarray] = []
    path = tmp_path / "c.html"
    with Simulation(load_scene("tear", rows=8, columns=8, area_density=9.0), "serial") as simulation:
        untorn = simulation.topology.triangle_count
        output = Output(path, "html", 40, clip=True)
        export(simulation, output, lambda k: remaining.append(simulation.topology.triangles))
    page = read(path)
    assert page.head["remaining"][0] == untorn
    for k in range(1, 40):  # sample k is the cloth after frame k - 1
        shown = page.triangles[: page.head["remaining"][k]]
        assert {*map(tuple, shown.tolist())} == {*map(tuple, remaining[k - 1].tolist())}
    assert page.head["remaining"][-1] < untorn


class Tags(HTMLParser):
    """The tags and texts of a page."""

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


def test_a_title_is_escaped(evil: Path, tmp_path: Path) -> None:
    baked(tmp_path / "good.html", small(title="good"), 1)
    pages = []
    for path in (evil, tmp_path / "good.html"):
        pages.append(Tags())
        pages[-1].feed(path.read_text(encoding="utf-8"))
    assert [tag for tag, _ in pages[0].tags] == [tag for tag, _ in pages[1].tags]
    labels = [attributes["aria-label"] for tag, attributes in pages[0].tags if tag == "canvas"]
    assert labels == [EVIL]
    page("name \udcff", {"name": EVIL}, b"").encode()  # a file name may not be valid text


def test_a_page_loads_nothing() -> None:
    player = (Path(taichi_cloth.__file__).parent / "export" / "player.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in player
    assert not re.search(r"https?:|src=|href=|import\b|fetch\(", player + RENDERER_SCRIPT.read_text(encoding="utf-8"))


def red(image: np.ndarray) -> np.ndarray:
    """Return a mask of the pixels with the red of the curtain."""
    r, g, b = np.moveaxis(image.astype(int), -1, 0)
    return (r > 90) & (g < 0.45 * r) & (b < 0.5 * r)


def in_shadow(image: np.ndarray) -> np.ndarray:
    """Return a mask of the pixels with the gray of a shadow on the floor."""
    gray = image.astype(int)
    return (gray.max(axis=2) < 200) & (gray.max(axis=2) - gray.min(axis=2) < 30)


# -- in a browser ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Curtain:
    path: Path
    image: np.ndarray  # of sample `SHOWN`, by the rasterizer


@pytest.fixture(scope="module")
def curtain(tmp_path_factory: pytest.TempPathFactory) -> Curtain:
    path = tmp_path_factory.mktemp("page") / "clip.html"
    scene = load_scene("curtain")
    with Simulation(scene) as simulation:
        export(simulation, Output(path, "html", FRAMES, clip=True), lambda k: None)
        simulation.reset()
        for _ in range(SHOWN):
            simulation.step()
        draw_list = DrawList(simulation)
        image = render_pixels(Rasterizer(640, 360), draw_list, OrbitCamera.from_scene(scene), "shaded")
        draw_list.close()
    return Curtain(path, image)


def test_a_clip_of_240_frames_has_the_size_in_the_documentation(curtain: Curtain) -> None:
    megabytes = curtain.path.stat().st_size / 1e6
    assert megabytes < 3
    assert f"a web page with 240 frames of the curtain has {megabytes:.1f} MB" in TRIALS.read_text(encoding="utf-8")


def test_the_page_matches_the_rasterizer(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path, f"?plain#frame={SHOWN}")
    shown, expected = browser.picture()[:300], curtain.image[:300]  # above the controls
    assert browser.value("document.querySelector('output').value") == "2.00 s"
    difference = np.abs(shown.astype(int) - expected).max(axis=2)
    assert np.percentile(difference, 95) < 12  # of 255; edges and shadows of folds are drawn differently
    assert red(expected).sum() > 5000
    assert (red(shown) & red(expected)).sum() > 0.95 * red(expected).sum()
    browser.open(curtain.path, "?plain#frame=0")
    assert (np.abs(browser.picture()[:300].astype(int) - shown).max(axis=2) > 40).mean() > 0.05
    assert browser.errors == []
    assert browser.requests == [curtain.path.as_uri() + "?plain"]


def test_floor_and_shadow_follow_a_cloth_that_leaves_them(browser: Any, tmp_path: Path) -> None:
    """As in the images: a cloth that is carried away, until half a second later it is 4 m behind its start."""
    pins = ("top-left", "top-right")
    carried = Attachment(pins=pins, keyframes=((0.0, 0, 0, 0), (0.5, 0, 0, -4.0)))
    cloth = Cloth(rows=9, columns=9, width=1.0, height=1.0, center=(0.0, 0.8, 0.0), pins=pins)
    camera = Camera(eye=(0.0, 1.5, 3.0), target=(0.0, 0.5, 0.0))
    scene = Scene(cloth=cloth, attachments=(carried,), ground=Ground(), camera=camera, look=Look(pattern="plain"))
    frames, path = 30, tmp_path / "carried.html"
    with Simulation(scene) as simulation:
        export(simulation, Output(path, "html", frames, clip=True), lambda k: None)
        draw_list = DrawList(simulation)
        expected = render_pixels(Rasterizer(640, 360), draw_list, OrbitCamera.from_scene(scene), "shaded")[:300]
        draw_list.close()
    browser.open(path, f"?plain#frame={frames}")
    shown = browser.picture()[:300]
    assert np.percentile(np.abs(shown.astype(int) - expected).max(axis=2), 97) < 12  # of 255
    for dark in (red, in_shadow):  # without a floor and a shadow map that follow, there is no shadow
        assert dark(expected).sum() > 300
        assert (dark(shown) & dark(expected)).sum() > 0.6 * dark(expected).sum()
    assert browser.errors == []


def test_the_page_plays_pauses_rotates_and_zooms(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path)
    playing = "document.querySelector('figure').classList.contains('playing')"
    sample = "+document.querySelector('input').value"
    browser.until(f"{sample} > 3")
    browser.key("Space", " ")
    assert not browser.value(playing)
    current = browser.value(sample)
    before = browser.picture()
    browser.drag((300, 150), (400, 170))
    assert browser.value("camera.azimuth") < browser.value("Math.atan2(3.4, 6.5)")
    assert browser.value("camera.elevation") > browser.value("Math.asin((2.6 - 2.05) / camera.initialDistance)")
    assert (browser.picture() != before).mean() > 0.2
    browser.mouse("Wheel", 300, 150, deltaX=0, deltaY=-240)
    browser.until("camera.orbitDistance < 0.9 * camera.initialDistance")
    browser.mouse("Pressed", 300, 150, button="left", clickCount=2)
    browser.mouse("Released", 300, 150, button="left", clickCount=2)
    browser.until("camera.orbitDistance === camera.initialDistance")
    assert browser.value(sample) == current
    browser.drag((320, 334), (320, 334))  # the middle of the scrubber
    assert abs(browser.value(sample) - FRAMES / 2) < 12
    browser.drag((28, 334), (28, 334))  # the button, which then has the focus for Space
    assert browser.value(playing)
    browser.key("Space", " ")
    assert not browser.value(playing)
    assert browser.errors == []


def test_a_button_shows_the_edges_of_the_mesh(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path, f"#frame={SHOWN}")
    before = browser.picture().astype(int)
    browser.drag((612, 26), (612, 26))  # the button in the upper right corner
    assert browser.value("edges.ariaPressed") == "true"
    browser.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    darker = (browser.picture() - before).sum(axis=2)[60:300] < -60
    assert 0.01 < (darker & red(before.astype(np.uint8))[60:300]).mean() < 0.2
    assert browser.errors == []
    browser.open(curtain.path, f"?plain#frame={SHOWN}")
    assert not browser.value("edges.checkVisibility()")


def test_a_clip_restarts_at_its_end(browser: Any, curtain: Curtain) -> None:
    browser.open(curtain.path, f"#frame={FRAMES - 3}")
    browser.key("Space", " ")
    browser.until("+document.querySelector('input').value < 100")


def test_a_title_is_displayed_as_text_in_a_browser(browser: Any, evil: Path) -> None:
    browser.open(evil)
    assert browser.value("document.title") == EVIL
    assert browser.value("document.querySelector('figcaption').checkVisibility()")
    browser.open(evil, "?plain")
    assert not browser.value("document.querySelector('figcaption').checkVisibility()")
    assert browser.errors == []


def test_the_page_fits_into_a_frame_of_another_page(browser: Any, curtain: Curtain) -> None:
    page = curtain.path.with_name("blog.html")
    page.write_text('<iframe src="clip.html" style="width: 50%; aspect-ratio: 16/9; border: 0"></iframe>')
    browser.open(page, "", "window.innerWidth")
    width, height = (browser.value(f"document.querySelector('iframe').client{side}") for side in ("Width", "Height"))
    assert width < 320
    for _ in range(200):  # until it is drawn
        mask = red(browser.picture())
        if mask.sum() > 500:
            break
    assert not mask[height + 16 :].any()
    rows, columns = np.nonzero(mask)
    middle = np.array([rows.mean(), columns.mean()]) - 8  # margin of a page [pixels]
    assert np.abs(middle / (height, width) - 0.5).max() < 0.2


def test_an_old_browser_shows_a_message(browser: Any, evil: Path) -> None:
    old = browser.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.DecompressionStream")
    browser.open(evil, "", "document.querySelector('.message')")
    browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=old["identifier"])
    assert "needs a browser of 2023 or later" in browser.value("document.querySelector('.message').textContent")
