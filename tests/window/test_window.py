"""The program in a real window, with real mouse and key events."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from numpy.typing import ArrayLike
from PIL import Image
from screen import Screen

from taichi_cloth.__main__ import main
from taichi_cloth.geometry.mesh_reader import read_obj
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.draw_list import VIEWS
from taichi_cloth.render.shading import BACKGROUND
from taichi_cloth.scene.schema import SOLVER_NAMES
from taichi_cloth.simulation.recording import Recorder, read_recording
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.viewer.input import HELP, MENU, PAGES
from taichi_cloth.viewer.panel import PANEL_HEIGHT, PANEL_MARGIN, PANEL_NAME, PANEL_WIDTH
from taichi_cloth.viewer.toolkit import saved_panel_rect
from taichi_cloth.viewer.window import WINDOW_POSITION, Idle

Start = Callable[..., Any]

TITLE, ROW, PADDING = 19, 23, 8  # [pixels] style of the toolkit
SLIDERS = (
    "gravity",
    "wind_x",
    "wind_z",
    "stiffness",
    "damping",
    "sphere_radius",
    "iterations",
    "substeps",
    "grab_radius",
)
BUTTONS = ("menu", "freeze", "reset", "undo")  # above the sliders while the cloth moves


def red_cloth(image: np.ndarray) -> np.ndarray:
    """Return where an image has the red cells of the curtain."""
    red, green, blue = np.moveaxis(image, 2, 0)
    return (red > 90) & (red > 2.2 * green) & (red > 2.2 * blue)


def point_on_cloth(app: Any) -> tuple[float, float]:
    """Return a screen point well inside a red cell of the cloth, in its lower part."""
    red = red_cloth(app.screenshot())
    whole = np.ones_like(red)
    for shift in (-6, 0, 6):
        for axis in (0, 1):
            whole &= np.roll(red, shift, axis)
    rows, columns = np.nonzero(whole)
    k = int(len(rows) * 0.8)
    return (columns[k] + 0.5) / app.width, 1 - (rows[k] + 0.5) / app.height


def panel_point(app: Any, x: float, y: float) -> tuple[float, float]:
    """Return the screen point of a point of the panel, in pixels from its top left corner."""
    return (PANEL_MARGIN + x) / app.width, 1 - (PANEL_MARGIN + y) / app.height


def slider_point(app: Any, name: str, share: float) -> tuple[float, float]:
    """Return a screen point on a slider; `share`, 0…1, from its lower to its upper end."""
    row = TITLE + PADDING + (len(BUTTONS) + SLIDERS.index(name)) * ROW + ROW / 2
    grab, length = 12, 0.65 * PANEL_WIDTH  # the center of the knob is at least half its width from the ends
    return panel_point(app, PADDING + grab / 2 + share * (length - grab), row)


def press_button(app: Any, name: str) -> None:
    """Click one of `BUTTONS`."""
    press_row(app, BUTTONS.index(name))


def press_row(app: Any, row: int) -> None:
    """Click the button in a row of the panel."""
    app.move_mouse(*panel_point(app, PADDING + 20, TITLE + PADDING + row * ROW + ROW / 2))
    app.press_mouse("left")
    app.release_mouse("left")


def distance(a: ArrayLike, b: ArrayLike) -> float:
    """Return the distance between two points."""
    return float(np.linalg.norm(np.subtract(a, b)))


def test_the_window_shows_cloth_and_panel_and_leaves_no_files(open_window: Start) -> None:
    app = open_window("curtain")
    image = app.screenshot()
    panel = image[PANEL_MARGIN + TITLE : PANEL_MARGIN + PANEL_HEIGHT, PANEL_MARGIN : PANEL_MARGIN + PANEL_WIDTH]
    assert red_cloth(image).mean() > 0.03
    assert (panel.max(axis=2) < 60).mean() > 0.5, "the panel is not dark"
    assert not red_cloth(panel).any()
    # The cloth is centered in the area beside the panel, as it is centered in an image.
    columns = np.nonzero(red_cloth(image).any(axis=0))[0]
    assert abs(columns.mean() - (PANEL_MARGIN + PANEL_WIDTH + app.width) / 2) < 0.1 * app.width
    app.press_key("Escape")
    assert app.exit_code() == 0
    assert list(app.working_folder.iterdir()) == []
    assert list(app.temporary_folder.iterdir()) == []


def test_escape_closes_the_help_and_a_page_before_it_quits(open_window: Start) -> None:
    app = open_window("drape15")
    for key, page in (("a", HELP), ("Escape", "Sliders"), ("Tab", PAGES[1]), ("Escape", "Sliders")):
        app.press_key(key)
        app.wait_until(lambda line, page=page: line["page"] == page, f"the page {page} after {key}")
    app.press_key("Escape")
    assert app.exit_code() == 0


def test_the_window_closes_after_the_given_number_of_frames(open_window: Start, tmp_path: Path) -> None:
    app = open_window("curtain", "--frames", "5")
    app.wait_until(lambda line: line["displayed"] == 4, "the last displayed frame")
    assert app.exit_code() == 0
    assert app.new_entries() == []
    entries = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    frames = [entry["frame"] for entry in entries[:3]]
    assert frames[:2] == [0, 0], "the panel is not shown before the first frame is compiled"
    assert frames[2] > 0


@pytest.mark.parametrize("end", ["close", "interrupt"])
def test_the_program_ends_cleanly_during_a_drag(open_window: Start, end: str) -> None:
    app = open_window("curtain")
    app.press_key("space")
    app.wait_until(lambda line: line["frozen"], "freeze")
    app.move_mouse(*point_on_cloth(app))
    assert app.press_mouse("left")["grabbed"] is not None
    app.press_key("space")
    app.wait_until(lambda line: not line["frozen"], "resuming")
    app.move_mouse(0.9, 0.5)  # with the button down
    if end == "close":
        app.request_close()
        assert app.exit_code() == 0
        assert len(app.output()) == 1
    else:
        app.process.send_signal(signal.SIGINT)
        assert app.exit_code() == 130
        assert app.output()[1:] == ["taichi-cloth: interrupted; files that were written are complete"]
    assert app.output()[0].startswith("curtain · ")
    assert list(app.temporary_folder.iterdir()) == []


def test_a_drag_moves_the_particle_under_the_cursor(open_window: Start) -> None:
    app = open_window("curtain")
    app.press_key("space")
    app.wait_until(lambda line: line["frozen"], "freeze")
    start = point_on_cloth(app)
    app.move_mouse(*start)
    pressed = app.press_mouse("left")
    particle = pressed["grabbed"]
    assert pressed["mouse"] == "cloth"
    assert particle is not None
    assert distance(pressed["particle"], start) < 0.05, "not the particle under the cursor"
    app.press_key("space")
    app.wait_until(lambda line: not line["frozen"], "resuming")

    offset = np.subtract(pressed["particle"], pressed["cursor"])
    for end in ((start[0] + 0.1, start[1] + 0.1), (0.05, 0.4)):
        app.move_mouse(*end)  # the last point is far away on the panel: the cloth is pulled taut
        line = app.wait_until(
            lambda line: distance(line["particle"], np.add(line["cursor"], offset)) < 0.02, "the particle at the cursor"
        )
        assert (line["mouse"], line["grabbed"]) == ("cloth", particle)
    assert line["parameters"] == pressed["parameters"], "the drag moved a slider"
    assert line["eye"] == pressed["eye"]

    stretched = app.latest_entry()["max_strain"]
    assert app.release_mouse("left")["grabbed"] is None
    app.wait_until(lambda line: line["max_strain"] < stretched / 2, "the relaxed cloth")


BALL_SCENE = """
[cloth]
rows = 3
columns = 3
width = 0.1
height = 0.1
center = [0.0, 3.2, 0.0]
pins = ["top"]

[[spheres]]
center = [0.5, 1.2, 0.0]
radius = 0.3

[camera]
eye = [0.0, 1.5, 6.0]
target = [0.0, 1.5, 0.0]
"""


def ball_middle(app: Any) -> tuple[float, float]:
    """Return the screen point in the middle of the blue pixels."""
    red, _, blue = np.moveaxis(app.screenshot()[:, PANEL_MARGIN + PANEL_WIDTH :].astype(int), 2, 0)
    rows, columns = np.nonzero(blue > 1.8 * red + 20)
    return (columns.mean() + PANEL_MARGIN + PANEL_WIDTH + 0.5) / app.width, 1 - (rows.mean() + 0.5) / app.height


def test_a_drag_moves_a_ball(open_window: Start, tmp_path: Path) -> None:
    (tmp_path / "ball.toml").write_text(BALL_SCENE)
    app = open_window(str(tmp_path / "ball.toml"))
    start = ball_middle(app)
    app.move_mouse(*start)
    pressed = app.press_mouse("left")
    assert (pressed["mouse"], pressed["grabbed_count"]) == ("cloth", 0)
    end = (start[0] + 0.1, start[1] + 0.15)
    app.move_mouse(*end)
    frame = app.latest_entry()["frame"]
    app.wait_until(lambda line: line["frame"] > frame + 20, "the ball at the cursor")
    assert distance(ball_middle(app), end) < 0.03
    assert app.release_mouse("left")["eye"] == pressed["eye"]
    assert distance(ball_middle(app), end) < 0.03


def test_a_drag_moves_a_patch_of_a_fine_cloth_and_p_pins_it(open_window: Start) -> None:
    app = open_window("curtain", "--set", "rows=96", "--set", "columns=96", "--without", "spheres")
    app.press_key("space")
    app.wait_until(lambda line: line["frozen"], "freeze")
    start = point_on_cloth(app)
    app.move_mouse(*start)
    assert not pin_marker(app.screenshot()).any()
    app.press_key("p")
    app.wait_until(lambda line: len(line["added_pins"]) > 8, "pins within the grab radius")
    assert pin_marker(app.screenshot()).any(), "the new pin has no marker"
    app.press_key("p")
    app.wait_until(lambda line: line["added_pins"] == [], "unpinning")
    assert not pin_marker(app.screenshot()).any()

    app.press_mouse("left")
    pressed = app.latest_entry()
    assert pressed["grabbed_count"] > 8
    assert pressed["grab_radius"] == pytest.approx(0.02 * 4.35)
    app.press_key("space")
    resumed = app.wait_until(lambda line: not line["frozen"], "resuming")
    app.wait_until(lambda line: line["frame"] > resumed["frame"] + 3, "some frames")
    assert distance(app.last_entry["particle"], pressed["particle"]) < 1e-3, (
        "the grabbed patch moved without the cursor"
    )
    for k in range(1, 6):
        app.move_mouse(start[0] - 0.02 * k, start[1] + 0.02 * k)
    pulled = app.latest_entry()
    assert distance(pulled["particle"], start) > 0.1
    assert pulled["max_strain"] < 1.0

    app.press_key("p")
    particle = pulled["grabbed"]
    pinned = app.wait_until(lambda line: particle in line["added_pins"], "the pins")["added_pins"]
    assert len(pinned) > 8
    assert app.release_mouse("left")["grabbed_count"] == 0
    assert app.latest_entry()["added_pins"] == pinned


def pin_marker(image: np.ndarray) -> np.ndarray:
    """Return where an image has the marker of a new pin, right of the panel."""
    red, green, blue = np.moveaxis(image[:, PANEL_MARGIN + PANEL_WIDTH :], 2, 0)
    return (red > 120) & (green > 0.4 * red) & (green < 0.7 * red) & (blue < 0.35 * red)


def test_pages_change_and_widgets_of_other_pages_work(open_window: Start) -> None:
    app = open_window("curtain")
    app.press_key("k")
    app.wait_until(lambda line: line["charts"], "the charts")
    for page in ("Views", "Features", "Solvers", HELP):
        press_button(app, "menu")
        app.wait_until(lambda line: line["page"] == MENU, "the menu")
        press_row(app, len(BUTTONS) + PAGES.index(page))
        app.wait_until(lambda line, page=page: line["page"] == page, f"the page {page}")
        if page == "Views":
            press_row(app, 1 + VIEWS.index("strain"))  # below the button for the menu
            app.wait_until(lambda line: line["view"] == "strain", "the view strain")
        if page == "Solvers":
            press_row(app, 1 + SOLVER_NAMES.index("explicit"))
            app.wait_until(lambda line: line["solver"] == "explicit", "the solver explicit")
            press_row(app, 1 + SOLVER_NAMES.index("verlet"))
            app.wait_until(lambda line: line["solver"] == "verlet", "the solver verlet")
        if page == "Features":
            box = TITLE + PADDING + (len(BUTTONS) + 2) * ROW + ROW / 2  # below those of wind and spheres
            app.move_mouse(*panel_point(app, PADDING + 10, box))
            app.press_mouse("left")
            app.release_mouse("left")
            app.wait_until(lambda line: "ground" not in line["features"], "the ground switched off")
    app.press_key("Tab")
    app.wait_until(lambda line: line["page"] == "Sliders", "the first page")
    app.move_mouse(*slider_point(app, "grab_radius", 0.1))
    app.press_mouse("left")
    app.move_mouse(*slider_point(app, "grab_radius", 0.8))
    app.wait_until(lambda line: abs(line["grab_radius"] - 0.8 * 4.35 / 4) < 0.04, "a grab radius of 0.87 m")
    app.release_mouse("left")
    chart = app.screenshot()[-100:-20, -280:-20]
    assert (chart.max(axis=2) < 40).mean() > 0.8, "the charts have no background"
    assert (chart.max(axis=2) > 120).any(), "the charts have no curves"
    for key, name in (("y", "silk"), ("y", "cotton")):
        app.press_key(key)
        app.wait_until(lambda line, name=name: line["fabric"] == name, f"the fabric {name}")
    assert app.latest_entry()["frame"] > 0


def test_a_slider_changes_only_its_parameter_and_a_press_beside_the_cloth_grabs_nothing(open_window: Start) -> None:
    app = open_window("curtain")
    app.move_mouse(0.98, 0.02)
    before = app.latest_entry()
    assert app.press_mouse("left")["mouse"] == "camera"
    app.move_mouse(0.8, 0.1)
    assert app.latest_entry()["grabbed"] is None
    app.release_mouse("left")
    assert distance(app.last_entry["eye"], before["eye"]) > 0.5
    app.press_key("f")
    app.wait_until(lambda line: line["eye"] == before["eye"], "the first view")
    for name, low, high in (("gravity", 0, 20), ("substeps", 1, 60)):
        drag_slider(app, name, low, high)


def drag_slider(app: Any, name: str, low: float, high: float) -> None:
    """Drag a slider, which must change only its own parameter."""
    before = app.latest_entry()
    app.move_mouse(*slider_point(app, name, 0.5))
    assert app.press_mouse("left")["mouse"] == "panel"
    app.move_mouse(*slider_point(app, name, 0.8))
    value = low + 0.8 * (high - low)
    app.wait_until(lambda line: abs(line["parameters"][name] - value) < 0.03 * (high - low), f"{name} at {value}")
    app.move_mouse(0.7, 0.4)  # onto the cloth, with the button down
    line = app.latest_entry()
    assert (line["mouse"], line["grabbed"]) == ("panel", None)
    assert line["parameters"][name] == high
    app.release_mouse("left")
    assert line["eye"] == before["eye"]
    assert {k: v for k, v in line["parameters"].items() if k != name} == {
        k: v for k, v in before["parameters"].items() if k != name
    }


def test_keys_run_their_actions(open_window: Start) -> None:
    app = open_window("curtain", "--layout", "serial")  # every solver is compiled
    app.move_mouse(0.7, 0.05)
    app.press_key("space")
    frozen = app.wait_until(lambda line: line["frozen"], "freeze")
    assert app.latest_entry()["frame"] == frozen["frame"], "the frozen cloth moved"
    app.press_key("n")
    app.wait_until(lambda line: line["frame"] == frozen["frame"] + 1, "one step")
    assert app.latest_entry()["frame"] == frozen["frame"] + 1

    app.press_key("e")
    mesh = app.working_folder / "out" / "curtain" / "mesh_001.obj"
    app.wait_until(lambda line: mesh.exists(), "the mesh file")
    assert len(read_obj(mesh)[0]) == 720

    shaded = app.screenshot()
    for view in (*VIEWS[1:], VIEWS[0]):
        app.press_key("v")
        app.wait_until(lambda line, view=view: line["view"] == view, f"the view {view}")
        changed = np.abs(app.screenshot() - shaded).max(axis=2)[:, PANEL_MARGIN + PANEL_WIDTH :] > 20
        assert bool(changed.mean() > 0.02) is (view != "shaded")

    app.press_key("g")
    app.wait_until(lambda line: not line["wind"], "wind off")
    app.press_key("ctrl+h")
    assert app.latest_entry()["panel"], "Ctrl with a letter is for number fields"
    app.press_key("h")
    app.wait_until(lambda line: not line["panel"], "the panel hidden")
    corner = app.screenshot()[PANEL_MARGIN : PANEL_MARGIN + 200, PANEL_MARGIN : PANEL_MARGIN + 50]
    assert corner.mean() > 150, "the panel is still visible"
    app.press_key("h")
    app.wait_until(lambda line: line["panel"], "the panel shown")

    app.press_key("r")
    app.wait_until(lambda line: line["frame"] == 0, "reset")
    app.press_key("m")
    other = app.wait_until(lambda line: line["scene"] != "curtain", "the next scene")
    assert other["frozen"]
    assert red_cloth(app.screenshot()).any() or other["scene"] != "table"
    app.press_key("b")
    app.wait_until(lambda line: line["scene"] == "curtain", "the previous scene")
    app.press_key("space")
    app.wait_until(lambda line: line["frame"] > 5, "resuming")
    for name in (*SOLVER_NAMES[1:], SOLVER_NAMES[0]):
        app.press_key("t")
        changed = app.wait_until(lambda line, name=name: line["solver"] == name, f"the solver {name}")
        app.wait_until(lambda line, since=changed: line["frame"] > since["frame"] + 5, f"frames with {name}")
        assert app.latest_entry()["max_strain"] < 1.0


def test_a_frozen_window_is_seldom_drawn_and_awakes_at_a_key(open_window: Start) -> None:
    app = open_window("curtain")
    app.press_key("space")
    app.wait_until(lambda line: line["frozen"], "freeze")
    seen: list[float] = []

    def is_idle(line: dict[str, Any]) -> bool:
        seen.append(time.monotonic())
        return len(seen) > 3 and min(np.diff(seen[-4:])) > 0.8 * Idle.REDRAW_EVERY

    app.wait_until(is_idle, "an idle window")
    app.press_key("space")
    app.wait_until(lambda line: not line["frozen"], "resuming")
    frame = app.latest_entry()["frame"]
    app.wait_until(lambda line: line["frame"] > frame, "motion")


def test_the_camera_moves_and_the_window_can_be_resized(open_window: Start) -> None:
    app = open_window("curtain")
    app.press_key("space")
    app.wait_until(lambda line: line["frozen"], "freeze")
    first, first_image = app.latest_entry(), app.screenshot()

    app.move_mouse(0.6, 0.5)
    assert app.press_mouse("right")["mouse"] == "camera"
    app.move_mouse(0.7, 0.6)
    turned = app.latest_entry()
    app.release_mouse("right")
    assert turned["grabbed"] is None
    assert distance(turned["eye"], first["eye"]) > 0.5
    assert turned["target"] == first["target"]
    assert (np.abs(app.screenshot() - first_image).max(axis=2) > 20).mean() > 0.05

    def range_of(line: dict[str, Any]) -> float:
        return distance(line["eye"], line["target"])

    app.press_mouse("middle")
    app.move_mouse(0.7, 0.8)
    app.wait_until(lambda line: range_of(line) < 0.9 * range_of(turned), "zooming in with the mouse")
    near = app.latest_entry()
    app.release_mouse("middle")
    with app.hold_key("o"):
        app.wait_until(lambda line: range_of(line) > 1.1 * range_of(near), "zooming out with a key")
    with app.hold_key("Up"):
        app.wait_until(lambda line: line["target"][1] > first["target"][1] + 0.05, "moving up with a key")
    app.press_key("f")
    app.wait_until(lambda line: line["eye"] == first["eye"], "the first view")

    app.xdotool("windowsize", "--sync", app.window_id, "1000", "700")
    app.width, app.height = 1000, 700
    start = point_on_cloth(app)
    app.move_mouse(*start)
    pressed = app.press_mouse("left")
    assert pressed["mouse"] == "cloth"
    assert distance(pressed["particle"], start) < 0.06
    app.release_mouse("left")
    app.move_mouse(*slider_point(app, "stiffness", 0.2))  # the panel keeps its pixels
    assert app.press_mouse("left")["mouse"] == "panel"
    app.wait_until(lambda line: abs(line["parameters"]["stiffness"] - 0.2) < 0.05, "stiffness at 0.2")


def test_the_panel_can_be_moved(open_window: Start) -> None:
    app = open_window("curtain")
    app.move_mouse(*panel_point(app, PANEL_WIDTH / 2, TITLE / 2))
    app.press_mouse("left")
    right, down = 500, 40  # [pixels] onto the cloth
    app.move_mouse(*panel_point(app, PANEL_WIDTH / 2 + right, TITLE / 2 + down))
    app.latest_entry()
    app.release_mouse("left")

    # The program does not know the new rectangle yet, and releases the cloth when a widget changes.
    def moved(point: tuple[float, float]) -> tuple[float, float]:
        return point[0] + right / app.width, point[1] - down / app.height

    app.move_mouse(*moved(slider_point(app, "wind_x", 0.5)))
    before = app.press_mouse("left")["parameters"]
    app.move_mouse(*moved(slider_point(app, "wind_x", 0.9)))
    app.wait_until(lambda line: line["parameters"]["wind_x"] > before["wind_x"] + 1, "wind_x to move")
    app.wait_until(lambda line: line["grabbed"] is None and line["mouse"] in ("panel", "nothing"), "the release")
    app.release_mouse("left")

    # Some seconds later it knows it.
    def is_known(line: dict[str, Any]) -> bool:
        rects = [saved_panel_rect(path, PANEL_NAME) for path in app.temporary_folder.glob("*/imgui.ini")]
        return any(rect is not None and rect.left == PANEL_MARGIN + right for rect in rects)

    app.wait_until(is_known, "the saved rectangle of the panel")
    app.move_mouse(*moved(panel_point(app, PANEL_WIDTH / 2, PANEL_HEIGHT / 2)))
    assert app.press_mouse("left")["mouse"] == "panel"
    app.release_mouse("left")


def test_a_clip_and_a_screenshot_are_saved_and_can_be_replayed(
    open_window: Start, running: None, capsys: pytest.CaptureFixture[str]
) -> None:
    app = open_window("curtain", "--size", "640x480", "--layout", "serial")  # another solver is compiled
    eye, target = (np.array(app.latest_entry()[name]) for name in ("eye", "target"))
    assert np.linalg.norm(eye - target) > 8  # farther than in the scene: all of the cloth is beside the panel
    start = point_on_cloth(app)
    app.press_key("c")
    app.move_mouse(*start)
    assert app.press_mouse("left")["mouse"] == "cloth"
    app.move_mouse(start[0] + 0.1, start[1] + 0.1)
    app.press_key("t")
    solver = app.wait_until(lambda line: line["solver"] != "verlet", "another solver")["solver"]
    app.release_mouse("left")
    app.press_key("v")
    app.wait_until(lambda line: line["view"] != "shaded", "another view")
    before = app.latest_entry()["frame"]
    app.press_key("c")
    app.press_key("s")
    app.latest_entry()
    app.press_key("Escape")
    assert app.exit_code() == 0
    assert app.output()[-1] == "wrote out/curtain/clip_001.mp4"

    folder = app.working_folder / "out" / "curtain"
    assert sorted(path.name for path in folder.iterdir()) == [
        f"{name}_001.{kind}" for name, kind in (("clip", "mp4"), ("clip", "toml"), ("shot", "png"), ("shot", "toml"))
    ]
    clip, shot = (read_recording(folder / f"{name}_001.toml") for name in ("clip", "shot"))
    assert {event.name for _, event in clip.rows} >= {"load", "grab", "release", "switch_solver", "camera", "view"}
    assert clip.first_frame + clip.frames >= before
    assert count_frames_and_secs(str(folder / "clip_001.mp4"))[0] == clip.frames + 1
    with Image.open(folder / "shot_001.png") as image:
        assert image.size == shot.size == (640, 480)
    for name in ("clip", "shot"):
        assert main(["replay", str(folder / f"{name}_001.toml"), "--check"]) == 0
        printed = capsys.readouterr()
        assert printed.out.endswith("final positions are bit-identical\n")
        assert printed.err == ""
    assert f'method = "{solver} ' in (folder / "shot_001.toml").read_text()


def test_a_recording_is_replayed_in_the_window_and_then_the_user_controls_it(
    open_window: Start, tmp_path: Path
) -> None:
    with Simulation(load_scene("curtain")) as simulation:
        recorder = Recorder(simulation)
        recorder.record_view("view", "strain")  # the first image shows strain
        grab = simulation.grab(566)
        for k in range(20):
            grab.move_to((1.0, 0.6, 0.1 * k))
            simulation.step()
        recorder.save(tmp_path / "recorded.toml", (640, 480))
    app = open_window(str(tmp_path / "recorded.toml"), command="replay")
    assert (app.width, app.height) == (640, 480)
    app.wait_until(lambda line: line["grabbed"] == 566, "the recorded grab")
    caption = app.screenshot()[PANEL_MARGIN + TITLE : PANEL_MARGIN + TITLE + 20, PANEL_MARGIN + 4 : PANEL_MARGIN + 300]
    assert (caption.max(axis=2) < 60).mean() > 0.5, "nothing says that this is a replay"
    assert (caption.min(axis=2) > 150).mean() > 0.03
    end = app.wait_until(lambda line: line["frame"] == 20 and line["frozen"], "the end")
    assert (end["grabbed"], end["view"]) == (None, "strain")
    image = app.screenshot()[:, PANEL_MARGIN + PANEL_WIDTH : app.width - 100].astype(int)  # left of the color scale
    assert (image.max(axis=2) - image.min(axis=2) > 40).mean() > 0.1, "no cloth"
    app.press_key("r")
    app.wait_until(lambda line: line["frame"] < 20 and not line["frozen"], "the replay again")
    app.wait_until(lambda line: line["frame"] == 20 and line["frozen"], "its end")
    app.press_key("Escape")
    assert app.exit_code() == 0
    assert app.output() == [f"{tmp_path / 'recorded.toml'}: 20 frames replayed: final positions are bit-identical"]


def test_the_error_of_a_frame_is_measured_and_shown(open_window: Start) -> None:
    app = open_window("curtain", "--size", "640x480", "--layout", "serial", errors=True)
    measured = app.wait_until(lambda line: line["frame_error"], "a measured error")
    assert 1e-6 < measured["frame_error"] < 0.1  # [m]
    app.press_key("v")
    app.press_key("v")
    app.wait_until(lambda line: line["view"] == "error", "the view error")
    assert red_cloth(app.screenshot()).any()
    app.press_key("t")
    app.wait_until(lambda line: line["solver"] != "verlet" and line["frame_error"] is None, "another solver")
    app.wait_until(lambda line: line["frame_error"], "its error")
    app.press_key("u")
    app.wait_until(lambda line: line["frame_error"] is None, "no measurement")
    app.press_key("Escape")
    assert app.exit_code() == 0


def test_time_goes_back_while_a_key_is_held_and_a_pull_is_undone(open_window: Start) -> None:
    app = open_window("curtain", "--size", "640x480", "--layout", "serial")
    start = point_on_cloth(app)
    app.move_mouse(*start)
    assert app.press_mouse("left")["mouse"] == "cloth"
    grabbed_at = app.latest_entry()["frame"]
    app.move_mouse(start[0] + 0.1, start[1] + 0.1)
    app.wait_until(lambda line: line["frame"] > grabbed_at + 60, "a second of pulling")
    app.release_mouse("left")
    app.press_key("z")
    undone = app.wait_until(lambda line: line["frozen"], "the undone pull")
    assert undone["frame"] <= grabbed_at
    assert undone["grabbed"] is None
    with app.hold_key("q"):
        app.wait_until(lambda line: line["frame"] < undone["frame"] - 5, "an earlier frame")


def test_the_help_lies_over_the_picture(open_window: Start) -> None:
    app = open_window("curtain", "--size", "1280x720", "--layout", "serial")
    app.press_key("space")
    app.wait_until(lambda line: line["frozen"], "a frozen cloth")
    before = app.screenshot().astype(int)
    app.press_key("a")
    app.wait_until(lambda line: line["page"] == HELP, "the help")
    app.latest_entry()
    changed = (np.abs(app.screenshot() - before).max(axis=2) > 20)[:, PANEL_MARGIN + PANEL_WIDTH :]
    assert 0.2 < changed.mean() < 0.6
    app.press_key("a")
    app.wait_until(lambda line: line["page"] == PAGES[0], "the first page")


def test_the_cursor_may_be_anywhere_when_the_window_opens(open_window: Start, screen: Screen) -> None:
    """Taichi does not draw the scene in half of the starts if the grab ring is drawn over its first frame."""
    corner = [str(position - 20) for position in WINDOW_POSITION]
    subprocess.run(["xdotool", "mousemove", *corner], env=os.environ | {"DISPLAY": screen.display}, check=True)
    app = open_window("curtain", "--size", "640x480", "--layout", "serial")
    app.press_key("h")
    app.wait_until(lambda line: not line["panel"], "no panel")
    app.latest_entry()
    assert red_cloth(app.screenshot()).any()


@pytest.mark.parametrize("view", VIEWS)
def test_a_recording_that_begins_in_any_view_shows_the_cloth(open_window: Start, tmp_path: Path, view: str) -> None:
    with Simulation(load_scene("drape15", rows=9, columns=9), "serial") as simulation:
        recorder = Recorder(simulation)
        recorder.record_view("view", view)
        simulation.step(2)
        recorder.save(tmp_path / "recorded.toml", (640, 480))
    app = open_window(str(tmp_path / "recorded.toml"), command="replay")
    end = app.wait_until(lambda line: line["frame"] == 2 and line["frozen"], "the end")
    assert end["view"] == view
    app.press_key("h")
    app.wait_until(lambda line: not line["panel"], "no panel")
    app.latest_entry()
    image = app.screenshot()[:, :-100].astype(int)  # without the color scale
    sky = 255 * np.array(BACKGROUND)
    assert (np.abs(image - sky).max(axis=2) > 12).mean() > 0.1, "only sky"
