"""The program as its user meets it: a real window, a real mouse, real keys."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image

from taichi_cloth import cli
from taichi_cloth.mesh.obj import read_obj
from taichi_cloth.record.recorded import Recorded
from taichi_cloth.record.recording import Recording, read_recording
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import SOLVER_NAMES
from taichi_cloth.view.draw_list import VIEWS
from taichi_cloth.view.panel import HEIGHT, MARGIN, NAME, WIDTH
from taichi_cloth.view.panel_place import saved_place

Start = Callable[..., Any]

TITLE, ROW, PADDING = 19, 23, 8  # [pixels] of the toolkit's look
SLIDERS = ("gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "iterations", "substeps", "hand")
BUTTONS = ("freeze", "step", "reset", "page")  # above them, on every page


def red_cloth(picture: np.ndarray) -> np.ndarray:
    """Where a picture shows the red checks of the curtain."""
    red, green, blue = np.moveaxis(picture, 2, 0)
    return (red > 90) & (red > 2.2 * green) & (red > 2.2 * blue)


def somewhere_on_the_cloth(desk: Any) -> tuple[float, float]:
    """A screen point well inside a red check, as seen on the screen; the lowest of those right of the panel's."""
    red = red_cloth(desk.picture())
    whole = np.ones_like(red)
    for shift in (-6, 0, 6):
        for axis in (0, 1):
            whole &= np.roll(red, shift, axis)
    rows, columns = np.nonzero(whole)
    k = int(len(rows) * 0.8)
    return (columns[k] + 0.5) / desk.width, 1 - (rows[k] + 0.5) / desk.height


def panel_point(desk: Any, x: float, y: float) -> tuple[float, float]:
    """A point of the panel, in pixels from its corner, on the screen."""
    return (MARGIN + x) / desk.width, 1 - (MARGIN + y) / desk.height


def slider_point(desk: Any, name: str, share: float) -> tuple[float, float]:
    """A point of a slider; `share` of the way from its low end to its high end."""
    row = TITLE + PADDING + (len(BUTTONS) + SLIDERS.index(name)) * ROW + ROW / 2
    grab, length = 12, 0.65 * WIDTH  # the knob's middle stays half its width off the ends
    return panel_point(desk, PADDING + grab / 2 + share * (length - grab), row)


def press_button(desk: Any, name: str) -> None:
    """Clicks on a button that stands on every page."""
    desk.move(*panel_point(desk, PADDING + 20, TITLE + PADDING + BUTTONS.index(name) * ROW + ROW / 2))
    desk.press("left")
    desk.release("left")


def distance(a: list[float], b: list[float]) -> float:
    return float(np.linalg.norm(np.subtract(a, b)))


def test_the_window_shows_cloth_and_panel_and_leaves_nothing_behind(desk: Start) -> None:
    desk = desk("curtain")
    picture = desk.picture()
    panel = picture[MARGIN + TITLE : MARGIN + HEIGHT, MARGIN : MARGIN + WIDTH]
    assert red_cloth(picture).mean() > 0.03
    assert (panel.max(axis=2) < 60).mean() > 0.5, "the panel is not dark"
    assert not red_cloth(panel).any()
    # In the middle of what the panel leaves free, as a still picture has it in its middle.
    columns = np.nonzero(red_cloth(picture).any(axis=0))[0]
    assert abs(columns.mean() - (MARGIN + WIDTH + desk.width) / 2) < 0.1 * desk.width
    desk.key("Escape")
    assert desk.exit_code() == 0
    assert list(desk.folder.iterdir()) == []
    assert list(desk.temporary.iterdir()) == []


def test_it_ends_after_so_many_pictures(desk: Start) -> None:
    desk = desk("curtain", "--frames", "5")
    desk.until(lambda line: line["displayed"] == 4, "the last picture")
    assert desk.exit_code() == 0
    assert desk.lines() == []


@pytest.mark.parametrize("end", ["close", "interrupt"])
def test_it_ends_in_good_order_in_the_middle_of_a_drag(desk: Start, end: str) -> None:
    desk = desk("curtain")
    desk.key("space")
    desk.until(lambda line: line["frozen"], "freeze")
    desk.move(*somewhere_on_the_cloth(desk))
    assert desk.press("left")["grabbed"] is not None
    desk.key("space")
    desk.until(lambda line: not line["frozen"], "going on")
    desk.move(0.9, 0.5)  # and the button stays down
    if end == "close":
        desk.ask_to_close()
        assert desk.exit_code() == 0
        assert len(desk.said()) == 1
    else:
        desk.program.send_signal(signal.SIGINT)
        assert desk.exit_code() == 130
        assert desk.said()[1:] == ["taichi-cloth: interrupted; finished files are whole"]
    assert desk.said()[0].startswith("curtain · ")
    assert list(desk.temporary.iterdir()) == []


def test_the_mouse_pulls_the_cloth_it_is_on(desk: Start) -> None:
    desk = desk("curtain")
    desk.key("space")
    desk.until(lambda line: line["frozen"], "freeze")
    start = somewhere_on_the_cloth(desk)
    desk.move(*start)
    pressed = desk.press("left")
    held = pressed["grabbed"]
    assert pressed["mouse"] == "cloth"
    assert held is not None
    assert distance(pressed["particle"], start) < 0.05, "another particle than the one under the cursor"
    desk.key("space")
    desk.until(lambda line: not line["frozen"], "going on")

    offset = np.subtract(pressed["particle"], pressed["cursor"])
    for end in ((start[0] + 0.1, start[1] + 0.1), (0.05, 0.4)):
        desk.move(*end)  # the last place is on the panel, far off: the cloth is pulled taut
        line = desk.until(
            lambda line: distance(line["particle"], np.add(line["cursor"], offset)) < 0.02, "the cloth to follow"
        )
        assert (line["mouse"], line["grabbed"]) == ("cloth", held)
    assert line["live"] == pressed["live"], "the pull moved a slider"
    assert line["eye"] == pressed["eye"]

    stretched = desk.now()["max_strain"]
    assert desk.release("left")["grabbed"] is None
    desk.until(lambda line: line["max_strain"] < stretched / 2, "the cloth to go back")


def test_the_mouse_pulls_a_patch_of_a_fine_cloth_and_p_pins_it(desk: Start) -> None:
    desk = desk("curtain", "--set", "rows=96", "--set", "columns=96", "--without", "spheres")
    desk.key("space")
    desk.until(lambda line: line["frozen"], "freeze")
    start = somewhere_on_the_cloth(desk)
    desk.move(*start)
    assert not orange(desk.picture()).any()
    desk.key("p")
    desk.until(lambda line: len(line["added_pins"]) == 1, "a pin under the cursor")
    assert orange(desk.picture()).any(), "the new pin has no bead"
    desk.key("p")
    desk.until(lambda line: line["added_pins"] == [], "the pin to go")
    assert not orange(desk.picture()).any()

    desk.press("left")
    pressed = desk.now()
    assert pressed["held"] > 8
    assert pressed["radius"] == pytest.approx(0.02 * 4.35)
    desk.key("space")
    going = desk.until(lambda line: not line["frozen"], "going on")
    desk.until(lambda line: line["frame"] > going["frame"] + 3, "some frames")
    assert distance(desk.last["particle"], pressed["particle"]) < 1e-3, "what is held moved in a still hand"
    for k in range(1, 6):
        desk.move(start[0] - 0.02 * k, start[1] + 0.02 * k)
    pulled = desk.now()
    assert distance(pulled["particle"], start) > 0.1
    assert pulled["max_strain"] < 1.0

    desk.key("p")
    held = pulled["grabbed"]
    desk.until(lambda line: line["added_pins"] == [held], "the pin")
    assert desk.release("left")["held"] == 0
    assert desk.now()["added_pins"] == [held]


def orange(picture: np.ndarray) -> np.ndarray:
    """Where a picture shows a bead of a new pin, right of the panel."""
    red, green, blue = np.moveaxis(picture[:, MARGIN + WIDTH :], 2, 0)
    return (red > 120) & (green > 0.4 * red) & (green < 0.7 * red) & (blue < 0.35 * red)


def test_pages_turn_and_widgets_of_another_page_work(desk: Start) -> None:
    desk = desk("curtain")
    desk.key("k")
    desk.until(lambda line: line["curves"], "the curves")
    for page in ("Stages", "Numbers", "Keys"):
        press_button(desk, "page")
        desk.until(lambda line, page=page: line["page"] == page, f"the page {page}")
        if page == "Stages":
            box = TITLE + PADDING + (len(BUTTONS) + 2) * ROW + ROW / 2  # below those of the wind and the ball
            desk.move(*panel_point(desk, PADDING + 10, box))
            desk.press("left")
            desk.release("left")
            desk.until(lambda line: "ground" not in line["stages"], "the ground to go")
    desk.key("Tab")
    desk.until(lambda line: line["page"] == "Sliders", "the first page")
    desk.move(*slider_point(desk, "hand", 0.1))
    desk.press("left")
    desk.move(*slider_point(desk, "hand", 0.8))
    desk.until(lambda line: abs(line["radius"] - 0.8 * 4.35 / 4) < 0.04, "a hand of 0.87 m")
    desk.release("left")
    chart = desk.picture()[-100:-20, -280:-20]
    assert (chart.max(axis=2) < 40).mean() > 0.8, "the charts have no ground"
    assert (chart.max(axis=2) > 120).any(), "the charts have no curves"
    for key, name in (("y", "silk"), ("y", "cotton")):
        desk.key(key)
        desk.until(lambda line, name=name: line["fabric"] == name, f"the fabric {name}")
    assert desk.now()["frame"] > 0


def test_a_slider_moves_its_parameter_and_nothing_else_and_a_press_on_nothing_takes_nothing(desk: Start) -> None:
    desk = desk("curtain")
    desk.move(0.98, 0.02)
    assert desk.press("left")["mouse"] == "nothing"
    before = desk.last
    desk.move(0.8, 0.5)
    assert desk.now()["grabbed"] is None
    desk.release("left")
    assert desk.last["eye"] == before["eye"]
    for name, low, high in (("gravity", 0, 20), ("substeps", 1, 60)):
        move_a_slider(desk, name, low, high)


def move_a_slider(desk: Any, name: str, low: float, high: float) -> None:
    before = desk.now()
    desk.move(*slider_point(desk, name, 0.5))
    assert desk.press("left")["mouse"] == "panel"
    desk.move(*slider_point(desk, name, 0.8))
    wanted = low + 0.8 * (high - low)
    desk.until(lambda line: abs(line["live"][name] - wanted) < 0.03 * (high - low), f"{name} at {wanted}")
    desk.move(0.7, 0.4)  # on the cloth, with the slider still held
    line = desk.now()
    assert (line["mouse"], line["grabbed"]) == ("panel", None)
    assert line["live"][name] == high
    desk.release("left")
    assert line["eye"] == before["eye"]
    assert {k: v for k, v in line["live"].items() if k != name} == {
        k: v for k, v in before["live"].items() if k != name
    }


def test_keys(desk: Start) -> None:
    desk = desk("curtain", "--path", "list")  # every method is compiled
    desk.move(0.7, 0.05)
    desk.key("space")
    frozen = desk.until(lambda line: line["frozen"], "freeze")
    assert desk.now()["frame"] == frozen["frame"], "frozen cloth went on"
    desk.key("n")
    desk.until(lambda line: line["frame"] == frozen["frame"] + 1, "one step")
    assert desk.now()["frame"] == frozen["frame"] + 1

    desk.key("e")
    mesh = desk.folder / "out" / "curtain_001.obj"
    desk.until(lambda line: mesh.exists(), "the mesh in a file")
    assert len(read_obj(mesh)[0]) == 720

    shaded = desk.picture()
    for view in (*VIEWS[1:], VIEWS[0]):
        desk.key("v")
        desk.until(lambda line, view=view: line["view"] == view, f"the view {view}")
        changed = np.abs(desk.picture() - shaded).max(axis=2)[:, MARGIN + WIDTH :] > 20
        assert bool(changed.mean() > 0.02) is (view != "shaded")

    desk.key("g")
    desk.until(lambda line: not line["wind"], "wind off")
    desk.key("h")
    desk.until(lambda line: not line["panel"], "the panel gone")
    corner = desk.picture()[MARGIN : MARGIN + 200, MARGIN : MARGIN + 50]
    assert corner.mean() > 150, "the panel is still to be seen"
    desk.key("h")
    desk.until(lambda line: line["panel"], "the panel back")

    desk.key("r")
    desk.until(lambda line: line["frame"] == 0, "reset")
    desk.key("m")
    other = desk.until(lambda line: line["scene"] != "curtain", "the next scene")
    assert other["frozen"]
    assert red_cloth(desk.picture()).any() or other["scene"] != "table"
    desk.key("b")
    desk.until(lambda line: line["scene"] == "curtain", "the scene before")
    desk.key("space")
    desk.until(lambda line: line["frame"] > 5, "going on")
    for name in (*SOLVER_NAMES[1:], SOLVER_NAMES[0]):
        desk.key("t")
        changed = desk.until(lambda line, name=name: line["solver"] == name, f"the solver {name}")
        desk.until(lambda line, since=changed: line["frame"] > since["frame"] + 5, f"going on with {name}")
        assert desk.now()["max_strain"] < 1.0


def test_the_camera_turns_and_the_window_may_be_resized(desk: Start) -> None:
    desk = desk("curtain")
    desk.key("space")
    desk.until(lambda line: line["frozen"], "freeze")
    first, first_picture = desk.now(), desk.picture()

    desk.move(0.6, 0.5)
    assert desk.press("right")["mouse"] == "camera"
    desk.move(0.7, 0.6)
    turned = desk.now()
    desk.release("right")
    assert turned["grabbed"] is None
    assert distance(turned["eye"], first["eye"]) > 0.5
    assert turned["target"] == first["target"]
    assert (np.abs(desk.picture() - first_picture).max(axis=2) > 20).mean() > 0.05

    def range_of(line: dict[str, Any]) -> float:
        return distance(line["eye"], line["target"])

    desk.press("middle")
    desk.move(0.7, 0.8)
    desk.until(lambda line: range_of(line) < 0.9 * range_of(turned), "zooming in with the mouse")
    near = desk.now()
    desk.release("middle")
    with desk.holding("o"):
        desk.until(lambda line: range_of(line) > 1.1 * range_of(near), "zooming out with a key")
    with desk.holding("Up"):
        desk.until(lambda line: line["target"][1] > first["target"][1] + 0.05, "moving up with a key")
    desk.key("f")
    desk.until(lambda line: line["eye"] == first["eye"], "the first view")

    desk.xdotool("windowsize", "--sync", desk.window, "1000", "700")
    desk.width, desk.height = 1000, 700
    start = somewhere_on_the_cloth(desk)
    desk.move(*start)
    pressed = desk.press("left")
    assert pressed["mouse"] == "cloth"
    assert distance(pressed["particle"], start) < 0.06
    desk.release("left")
    desk.move(*slider_point(desk, "stiffness", 0.2))  # the panel keeps its pixels
    assert desk.press("left")["mouse"] == "panel"
    desk.until(lambda line: abs(line["live"]["stiffness"] - 0.2) < 0.05, "stiffness at 0.2")


def test_the_panel_may_be_moved(desk: Start) -> None:
    desk = desk("curtain")
    desk.move(*panel_point(desk, WIDTH / 2, TITLE / 2))
    desk.press("left")
    right, down = 500, 40  # [pixels] onto the cloth
    desk.move(*panel_point(desk, WIDTH / 2 + right, TITLE / 2 + down))
    desk.now()
    desk.release("left")

    # At once the program does not know yet, and lets go as soon as a widget answers.
    def moved(point: tuple[float, float]) -> tuple[float, float]:
        return point[0] + right / desk.width, point[1] - down / desk.height

    desk.move(*moved(slider_point(desk, "wind_x", 0.5)))
    before = desk.press("left")["live"]
    desk.move(*moved(slider_point(desk, "wind_x", 0.9)))
    desk.until(lambda line: line["live"]["wind_x"] > before["wind_x"] + 1, "wind_x to move")
    desk.until(lambda line: line["grabbed"] is None and line["mouse"] in ("panel", "nothing"), "letting go")
    desk.release("left")

    # Some seconds later it does.
    def is_known(line: dict[str, Any]) -> bool:
        places = [saved_place(path, NAME) for path in desk.temporary.glob("*/imgui.ini")]
        return any(place is not None and place.left == MARGIN + right for place in places)

    desk.until(is_known, "the toolkit to save the panel's place")
    desk.move(*moved(panel_point(desk, WIDTH / 2, HEIGHT / 2)))
    assert desk.press("left")["mouse"] == "panel"
    desk.release("left")


def test_a_clip_and_a_screenshot_are_kept_and_can_be_repeated(
    desk: Start, running: None, capsys: pytest.CaptureFixture[str]
) -> None:
    desk = desk("curtain", "--size", "640x480", "--path", "list")  # another method is compiled
    start = somewhere_on_the_cloth(desk)
    desk.key("c")
    desk.move(*start)
    assert desk.press("left")["mouse"] == "cloth"
    desk.move(start[0] + 0.1, start[1] + 0.1)
    desk.key("t")
    solver = desk.until(lambda line: line["solver"] != "verlet", "another method")["solver"]
    desk.release("left")
    desk.key("v")
    desk.until(lambda line: line["view"] != "shaded", "another view")
    before = desk.now()["frame"]
    desk.key("c")
    desk.key("s")
    desk.now()
    desk.key("Escape")
    assert desk.exit_code() == 0
    assert desk.said()[-1] == "wrote out/curtain/clip_001.mp4"

    folder = desk.folder / "out" / "curtain"
    assert sorted(path.name for path in folder.iterdir()) == [
        f"{name}_001.{kind}" for name, kind in (("clip", "mp4"), ("clip", "toml"), ("shot", "png"), ("shot", "toml"))
    ]
    clip, shot = (read_recording(folder / f"{name}_001.toml") for name in ("clip", "shot"))
    assert {call for _, call, _ in clip.rows} >= {"load", "grab", "release", "change_solver", "camera", "view"}
    assert clip.first_frame + clip.frames >= before
    assert count_frames_and_secs(str(folder / "clip_001.mp4"))[0] == clip.frames + 1
    with Image.open(folder / "shot_001.png") as picture:
        assert picture.size == shot.size == (640, 480)
    for name in ("clip", "shot"):
        assert cli.main(["replay", str(folder / f"{name}_001.toml"), "--check"]) == 0
        said = capsys.readouterr()
        assert said.out.endswith("the same to the last bit\n")
        assert said.err == ""
    assert f'method = "{solver} ' in (folder / "shot_001.toml").read_text()


def test_a_recording_is_repeated_in_the_window_and_then_the_users(desk: Start, tmp_path: Path) -> None:
    with Recorded(load_scene("curtain")) as simulation:
        for k in range(20):
            simulation.grab(566, (1.0, 0.6, 0.1 * k))
            simulation.advance_frame()
        Recording.of(simulation, (640, 480)).write(tmp_path / "taken.toml")
    desk = desk(str(tmp_path / "taken.toml"), command="replay")
    assert (desk.width, desk.height) == (640, 480)
    end = desk.until(lambda line: line["frame"] == 20 and line["frozen"], "the end")
    assert end["grabbed"] == 566
    desk.key("r")
    desk.until(lambda line: line["frame"] == 0, "a reset")
    desk.key("Escape")
    assert desk.exit_code() == 0
    assert desk.said() == [f"{tmp_path / 'taken.toml'}: 20 frames repeated: the same to the last bit"]
