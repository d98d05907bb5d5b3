"""Labels, sizes and actions of the panel, with a fake toolkit that records its calls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pointing import ReadyPipe

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import parameters_of, scene_names
from taichi_cloth.scene.presets import load_preset
from taichi_cloth.scene.schema import SOLVER_NAMES
from taichi_cloth.simulation.copies import FeatureTimes, FrameError
from taichi_cloth.viewer import panel as panel_module
from taichi_cloth.viewer.charts import CHART_SECONDS, SOLVER_USES, History, alert, blown_up_line, slow_line, statistics
from taichi_cloth.viewer.comparison import Comparison
from taichi_cloth.viewer.comparison_window import HEIGHT as COMPARISON_HEIGHT
from taichi_cloth.viewer.comparison_window import ComparisonPanel
from taichi_cloth.viewer.comparison_window import statistics as comparison_statistics
from taichi_cloth.viewer.error_process import Answer, error_lines, millimeters
from taichi_cloth.viewer.input import (
    ARROWS,
    HELP,
    MENU,
    PAGES,
    SHORTCUTS,
)
from taichi_cloth.viewer.panel import (
    GRAB_RADIUS,
    HELP_SIZE,
    HIDDEN_TITLE,
    KEY_COLUMN,
    LINE_LENGTH,
    LIST_PAGES,
    PANEL_HEIGHT,
    PANEL_MARGIN,
    PANEL_NAME,
    PANEL_WIDTH,
    Panel,
    acting_parameters,
    description,
    draw_caption,
    draw_gray_reason,
    help_for,
    help_lines,
    with_title,
)
from taichi_cloth.viewer.session import Session
from taichi_cloth.viewer.toolkit import TITLE_HEIGHT, PanelRect, Progress, Refusal, saved_panel_rect

pytestmark = pytest.mark.usefixtures("serial_layout")

SIZE = (1280, 720)
LETTER, PADDING, WIDGET_ROW, TEXT_ROW, SPACING = 7, 8, 23, 17, 4  # [pixels] style and font of Dear ImGui


class FakeGui:
    """A toolkit that records its calls. It returns float32 values like the real one, or those of `answers` by label."""

    def __init__(self, **answers: Any) -> None:
        self.answers = answers
        self.labels: list[str] = []
        self.boxes: list[str] = []  # labels of checkboxes
        self.texts: list[str] = []
        self.colors: dict[str, Any] = {}  # of texts
        self.values: dict[str, float] = {}  # shown by sliders
        self.bottoms: dict[str, int] = {}  # lower edges of texts [pixels]
        self.windows: list[tuple[str, tuple[float, ...]]] = []  # names, with left, top, width, height as fractions

    @contextmanager
    def sub_window(self, name: str, *rect: float) -> Iterator[None]:
        self.windows.append((name, rect))
        yield

    def slider_float(self, label: str, value: float, low: float, high: float) -> float:
        self.labels.append(label)
        self.values[label] = value
        return float(np.float32(self.answers.get(label.split()[0], value)))

    def slider_int(self, label: str, value: int, low: int, high: int) -> int:
        self.labels.append(label)
        self.values[label] = value
        return int(self.answers.get(label, value))

    def checkbox(self, label: str, value: bool) -> bool:
        self.labels.append(label)
        self.boxes.append(label)
        return value ^ (label in self.answers)

    def button(self, label: str) -> bool:
        self.labels.append(label)
        return label in self.answers

    def text(self, text: str, color: Any = None) -> None:
        self.texts.append(text)
        self.colors[text] = color
        self.bottoms[text] = TITLE_HEIGHT + PADDING + len(self.labels) * WIDGET_ROW + len(self.texts) * TEXT_ROW


@pytest.fixture
def drawn(tmp_path: Path) -> Iterator[Callable[..., tuple[Session, FakeGui, bool]]]:
    """Draw a page of the panel of a scene once: `drawn("curtain", "Features", Wind=True)`."""
    sessions = []

    def draw(scene: str, page: str = "Sliders", **answers: Any) -> tuple[Session, FakeGui, bool]:
        session, gui = Session(load_scene(scene)), FakeGui(**answers)
        sessions.append(session)
        session.page = page
        used = Panel(SIZE, tmp_path / "imgui.ini").draw(gui, session, statistics(session, {"drawing": 12.3}, 59.9))
        session.run_deferred()
        return session, gui, used

    yield draw
    for session in sessions:
        session.close()


Drawn = Callable[..., tuple[Session, FakeGui, bool]]


@pytest.mark.parametrize("scene", scene_names())
def test_labels_are_unique_and_every_page_fits_the_panel(scene: str, tmp_path: Path) -> None:
    """Every page, with charts, with a long note, with the longest help, and with times of all features."""
    session = Session(load_scene(scene))
    session.feature_times = FeatureTimes(123456, 1234.56, dict.fromkeys((*session.features, "wind"), -123.45))
    session.charts = True
    session.note = "explicit needs 200,001 substeps a frame, more than 200,000: " + "its springs are stiff " * 4
    panel = Panel(SIZE, tmp_path / "imgui.ini")
    for page in (*PAGES, MENU):
        session.page = page
        for slider in [*parameters_of(session.simulation.scene), GRAB_RADIUS] if page == "Sliders" else [""]:
            panel._moved = slider
            gui = FakeGui()
            assert not panel.draw(gui, session, statistics(session, {"drawing": 12.3}, 59.9)), "no widget was used"
            assert len(set(gui.labels)) == len(gui.labels)
            room = (PANEL_WIDTH - 0.65 * PANEL_WIDTH - PADDING - SPACING) / LETTER  # beside a slider
            room = LINE_LENGTH if page in LIST_PAGES else room
            assert max(len(label) for label in gui.labels if label not in gui.boxes) <= room
            assert max(map(len, gui.boxes), default=0) <= LINE_LENGTH - (WIDGET_ROW + SPACING) // LETTER
            assert max(map(len, gui.texts)) <= LINE_LENGTH
            height = TITLE_HEIGHT + 2 * PADDING + len(gui.labels) * WIDGET_ROW + len(gui.texts) * TEXT_ROW
            assert height <= PANEL_HEIGHT, page
    assert SIZE[1] >= PANEL_HEIGHT + 2 * PANEL_MARGIN
    session.close()


def test_the_key_help_has_two_separate_columns() -> None:
    text = "\n".join(help_lines())
    table = help_lines()[[line.startswith("Space") for line in help_lines()].index(True) :]
    assert len(table) > 10
    assert all(line[KEY_COLUMN - 1 : KEY_COLUMN + 1].strip() == "" for line in table)
    assert [key.label for key in SHORTCUTS if f"{key.label:5} {key.help}" not in text] == [
        key.label for key in SHORTCUTS if key.code in ARROWS
    ]
    assert "arrows: pan camera" in text


def test_every_page_has_a_button_for_the_menu_which_has_one_for_every_page(drawn: Drawn) -> None:
    for page in PAGES:
        session, _, used = drawn("drape15", page, **{f"Menu ({page})": True})
        assert used
        assert session.page == MENU
    session, gui, _ = drawn("drape15", MENU, Help=True)
    assert set(PAGES) <= set(gui.labels)
    assert session.page == HELP
    session.act("page")
    assert session.page == PAGES[0]


@pytest.mark.parametrize(
    ("page", "in_use", "press", "chosen_by"),
    [
        (
            "Scenes",
            "drape15: 225 particles hung by two corners, ...",
            "curtain: a curtain on a pole, in the wind, ...",
            lambda session: session.simulation.scene.name,
        ),
        (
            "Solvers",
            "verlet: games and demos, small grids",
            "xpbd: soft cloth",
            lambda session: session.simulation.solver.name,
        ),
        ("Fabrics", "own fabric", "silk: a light crêpe de chine", lambda session: session.fabric),
        ("Views", "shaded", "wireframe", lambda session: session.view),
        ("Speeds", "1", "1/4", lambda session: session.speed),
    ],
)
def test_a_list_marks_what_is_in_use_and_a_press_chooses(
    drawn: Drawn, page: str, in_use: str, press: str, chosen_by: Callable[[Session], str]
) -> None:
    session, gui, used = drawn("drape15", page, **{press: True})
    assert used
    assert f"> {in_use}" in gui.labels
    assert [label for label in gui.labels if label.startswith(">")] == [f"> {in_use}"]
    assert chosen_by(session) == press.partition(":")[0]


def test_the_menu_saves_the_scene(drawn: Drawn) -> None:
    session, _, used = drawn("drape15", MENU, **{"Save scene": True})
    assert used
    assert session.note == "no scenes are saved here"  # by a session without the function


def test_the_solvers_have_the_errors_that_were_measured_in_this_scene(drawn: Drawn, tmp_path: Path) -> None:
    session, gui, _ = drawn("drape15", "Solvers")
    where = ["errors and times of all solvers in this scene:", "  docs/scene_errors.md"]
    assert [text for text in gui.texts if text in where] == where
    session.measure_errors(True)
    assert session.meter is not None
    found = FrameError(7, 0.00123, 0.01, 1e-6, 0.0005, 0.0008, np.zeros(225), 0.01)
    for solver, error in (("verlet", found), ("rk4", replace(found, error=1e-6))):
        session.change_solver(solver)
        session.advance(1)  # the process starts after some frames only
        session.meter._sent_scene = session.simulation.scene
        session.meter._is_busy, session.meter._is_stale = True, False
        session.meter._pipe = ReadyPipe(Answer(error))  # type: ignore[assignment]
        session.advance(1)
    session.meter._pipe = None
    session.frozen = True
    gui = FakeGui()
    Panel(SIZE, tmp_path / "imgui.ini").draw(gui, session, "")
    assert {"verlet: 1.2 mm", "> rk4: < 0.002 mm", "xpbd: soft cloth"} <= set(gui.labels)
    lines = statistics(session, {}, 60.0).splitlines()
    at = lines.index("  against a fine run with explicit")
    assert lines[at - 1].startswith("error of frame ")
    session.open_scene("curtain")
    session.page = "Solvers"
    gui = FakeGui()
    Panel(SIZE, tmp_path / "imgui.ini").draw(gui, session, "")
    assert "> verlet: games and demos, small grids" in gui.labels


def test_every_solver_has_a_use_that_a_line_shows_whole(drawn: Drawn) -> None:
    _, gui, _ = drawn("curtain", "Solvers")
    assert tuple(SOLVER_USES) == SOLVER_NAMES
    assert {f"{name}: {use}" for name, use in SOLVER_USES.items()} <= {label.removeprefix("> ") for label in gui.labels}


def test_a_long_list_has_a_button_for_its_next_part(drawn: Drawn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(panel_module, "LIST_LENGTH", 10)
    session, _, _ = drawn("drape15", "Scenes")
    panel = Panel(SIZE, Path("imgui.ini"))
    seen = []
    for more in (False, True, True, True):
        gui = FakeGui(**{"More scenes": True} if more else {})
        assert not panel.draw(gui, session, ""), "it changes nothing"
        listed = [label.removeprefix("> ").partition(":")[0] for label in gui.labels]
        seen.append([name for name in listed if name in session.scenes])
    assert [len(part) for part in seen[:2]] == [10, 10]
    assert seen[3] == seen[0]
    assert [name for part in seen[:3] for name in part] == list(session.scenes)
    _, gui, _ = drawn("drape15", "Solvers")
    assert not [label for label in gui.labels if label.startswith("More")]


def test_the_own_fabric_of_a_scene_is_named_with_its_preset(drawn: Drawn) -> None:
    _, gui, _ = drawn("banner", "Fabrics")
    assert [label for label in gui.labels if label.startswith(">")] == ["> own (silk)"]


def test_sliders_do_not_make_penetration_free_cloth_thicker_than_half_a_cell() -> None:
    """With two cells a frame of `knot` takes eight seconds; a slider that ends there would seem to hang."""
    free = load_scene("knot")
    assert free.self_collision is not None
    for scene in (free, replace(free, self_collision=replace(free.self_collision, penetration_free=False))):
        with closing(Session(scene, "serial")) as session:
            simulation = session.simulation
            most = acting_parameters(simulation)["self_collision_thickness"].slider_max
            cell = simulation.topology.rest.mean()
            assert most == (pytest.approx(0.5 * cell) if scene is free else 0.2)
            assert most > scene.self_collision.thickness


@pytest.mark.parametrize(
    ("name", "title", "label"), [("banner", "Mine", "banner: Mine"), ("my", "Mine", "my: Mine"), ("my", "", "my")]
)
def test_the_list_has_the_title_of_the_scene_that_it_opens(name: str, title: str, label: str) -> None:
    """A scene of a user may have the name of a shipped one, and needs no title."""
    scene = replace(load_scene("drape15", rows=4, columns=4), name=name, title=title)
    with closing(Session(scene, "serial")) as session:
        assert with_title(session, "scene", name) == label
        assert with_title(session, "scene", "flag").startswith("flag: a ")


@pytest.mark.parametrize("size", [(1280, 720), (800, 600), (640, 480), (480, 320)])
def test_the_help_is_inside_the_window(size: tuple[int, int], tmp_path: Path) -> None:
    panel = Panel(size, tmp_path / "imgui.ini")
    place = panel.help_place
    assert place.left >= PANEL_MARGIN
    assert place.top >= PANEL_MARGIN
    assert place.left + place.width <= size[0] - PANEL_MARGIN
    assert place.top + place.height <= size[1] - PANEL_MARGIN
    gui = FakeGui()
    panel.draw_help(gui)
    scroll_bar = 14 if place.height < HELP_SIZE[1] else 0
    assert max(map(len, gui.texts)) * LETTER <= place.width - 2 * PADDING - scroll_bar


def test_slow_motion_is_shown_on_every_page(drawn: Drawn) -> None:
    session, _, _ = drawn("drape15")
    assert " speed" not in statistics(session, {"drawing": 1.0}, 60.0)
    session.speed = "1/8"
    assert statistics(session, {"drawing": 1.0}, 60.0).split("\n")[1] == "frame 0 · 60 fps · 1/8 speed"


def test_every_page_shows_what_runs(drawn: Drawn) -> None:
    for page in PAGES:
        _, gui, _ = drawn("drape15", page)
        assert "drape15 · verlet 1×5 · own fabric · shaded" in gui.texts


@pytest.mark.parametrize(
    ("page", "line"),
    [
        ("Scenes", "a ball shot into a curtain at 24 m/s, caught in one"),
        ("Solvers", "position-based dynamics with Verlet integration"),
        ("Fabrics", ""),
        ("Views", "what the picture shows"),
        ("Speeds", "simulated seconds per second"),
    ],
)
def test_lists_describe_what_is_in_use(drawn: Drawn, page: str, line: str) -> None:
    session, gui, _ = drawn("fast-ball", page)
    assert not line or line in gui.texts
    assert all(ord(letter) < 256 for text in gui.texts for letter in text)  # the letters of the window's font
    session.change_fabric("denim")
    assert description(session, "fabric") == load_preset("denim").title


def test_statistics_tell_that_iterations_end_too_early(drawn: Drawn) -> None:
    session, _, _ = drawn("curtain")
    for iterations, told in ((1, True), (500, False)):
        session.simulation.params["iterations"] = iterations
        assert ("\nnot converged: about " in statistics(session, {"drawing": 1.0}, 60.0)) is told


def test_a_solver_that_does_not_iterate_has_no_slider_for_it(drawn: Drawn) -> None:
    _, gui, _ = drawn("net")
    assert "Iterations" not in gui.labels
    assert "Substeps" in gui.labels


@pytest.mark.parametrize(("note", "green"), [("wrote a file", True), (Refusal("no"), False), (Progress("on"), False)])
def test_notes_of_success_are_green(drawn: Drawn, tmp_path: Path, note: str, green: bool) -> None:
    session, gui, _ = drawn("drape15")
    session.note = note
    Panel(SIZE, tmp_path / "imgui.ini").draw(gui, session, "")
    red, g, blue = gui.colors[note]
    assert (g > max(red, blue)) is green


@pytest.mark.parametrize(
    ("answer", "value"), [(3.5, 3.5), (1e9, 20.0), (-4, 0.0), (float("nan"), 9.81), (float("inf"), 9.81)]
)
def test_a_slider_sets_its_parameter_clamped_to_its_range(drawn: Drawn, answer: float, value: float) -> None:
    session, _, used = drawn("curtain", Gravity=answer)
    assert session.simulation.params["gravity"] == pytest.approx(value)
    assert used is bool(np.isfinite(answer))


def test_an_integer_slider_sets_integers(drawn: Drawn) -> None:
    session, _, used = drawn("curtain", Substeps=7)
    assert used
    assert session.simulation.params["substeps"] == 7
    assert isinstance(session.simulation.params["substeps"], int)


def test_switches_and_buttons_run_their_actions(drawn: Drawn) -> None:
    session, _, used = drawn("curtain", "Features", Freeze=True, Wind=True, Step=True)
    assert used
    assert session.frozen
    assert session.simulation.params["wind"] is False
    assert session.simulation.frame == 1


def test_a_scene_without_wind_has_no_wind_widgets(drawn: Drawn) -> None:
    for page in ("Sliders", "Features"):
        session, gui, _ = drawn("net", page)
        assert session.simulation.scene.wind is None
        assert not [label for label in gui.labels if "Wind" in label]


def test_wind_that_is_off_has_no_sliders_and_is_turned_on_by_restoring_defaults(drawn: Drawn) -> None:
    session, gui, _ = drawn("curtain")
    wind = [label for label in gui.labels if label.startswith("Wind ")]
    assert len(wind) == 2
    session.act("wind")
    assert session.note == "wind off: G turns it on"
    again = FakeGui()
    Panel(SIZE, Path("imgui.ini")).draw(again, session, "")
    assert [label for label in again.labels if label not in gui.labels or label in wind] == []
    session.act("restore_defaults")
    assert session.simulation.params["wind"] is True
    session, _, _ = drawn("net")
    session.act("wind")
    assert session.note == "this scene has no wind"
    assert isinstance(session.note, Refusal)


def test_the_zoom_has_a_help_once_it_moved(tmp_path: Path) -> None:
    session, panel = Session(load_scene("curtain")), Panel(SIZE, tmp_path / "imgui.ini")
    gui = FakeGui(Zoom=3.0)
    assert panel.draw(gui, session, "")
    assert "Zoom: each step moves the eye a tenth closer" in " ".join(gui.texts)
    session.close()


def test_the_slider_of_substeps_shows_how_many_run(drawn: Drawn) -> None:
    session, _, _ = drawn("curtain")
    session.change_solver("explicit")
    session.simulation.params["substeps"] = 3
    fewest = session.simulation.substeps
    keys = acting_parameters(session.simulation)
    assert keys["substeps"].slider_min == fewest > 3
    assert help_for("substeps", keys).endswith(f"; {fewest} to 60, scene default 10, which is raised")
    assert help_for("gravity", keys).endswith("; 0 to 20 m/s², scene default 9.81")
    gui = FakeGui()
    Panel(SIZE, Path("imgui.ini")).draw(gui, session, "")
    assert session.simulation.params["substeps"] == 3  # drawing changes nothing
    assert gui.values["Substeps"] == fewest
    session.simulation.params["substeps"] = fewest + 5
    assert session.simulation.substeps == fewest + 5


def test_a_value_beyond_its_slider_is_shown_as_it_is(drawn: Drawn) -> None:
    session, _, _ = drawn("curtain")
    session.simulation.params["gravity"] = -5.0
    gui = FakeGui()
    Panel(SIZE, Path("imgui.ini")).draw(gui, session, "")
    assert gui.values["Gravity [m/s²]"] == -5.0
    assert session.simulation.params["gravity"] == -5.0


def test_every_page_says_once_that_the_view_error_has_no_error_yet(drawn: Drawn) -> None:
    for page in ("Views", "Sliders", "Statistics"):
        session, _, _ = drawn("drape15", page)
        session.view = "error"
        gui = FakeGui()
        Panel(SIZE, Path("imgui.ini")).draw(gui, session, statistics(session, {"drawing": 1.0}, 60.0))
        assert gui.texts.count("error of a frame: not measured (U)") == 1


def test_a_gray_cloth_in_the_view_error_says_why(drawn: Drawn) -> None:
    session, _, _ = drawn("drape15")
    session.measure_errors(True)
    for view, size, shown in (("shaded", SIZE, False), ("error", SIZE, True), ("error", (640, 480), False)):
        session.view, gui = view, FakeGui()
        draw_gray_reason(gui, session, size)
        assert gui.texts == ["error of a frame: not measured yet"] * shown
    found = FrameError(7, 0.00123, 0.01, 1e-6, 0.0005, 0.0008, np.linspace(0.0, 0.0034, 225), 0.01)
    session.draw_list.show_error(found)
    gui = FakeGui()
    draw_gray_reason(gui, session, SIZE)
    assert gui.texts == []


def test_every_page_shows_rms_and_largest_error_in_the_view_error(drawn: Drawn) -> None:
    for page in PAGES:
        session, _, _ = drawn("drape15", page)
        session.measure_errors(True)
        assert session.meter is not None
        found = FrameError(7, 0.00123, 0.01, 1e-6, 0.0005, 0.0008, np.linspace(0.0, 0.0034, 225), 0.01)
        session.meter.answer, session.view = Answer(found, 0.02), "error"
        gui = FakeGui()
        Panel(SIZE, Path("imgui.ini")).draw(gui, session, statistics(session, {"drawing": 1.0}, 60.0))
        for line in ("error of frame 7: 1.2 mm RMS, 12 % of its motion", "  largest error of a particle: 3.4 mm"):
            assert gui.texts.count(line) == 1, page


@pytest.mark.parametrize("scene", ["curtain", "denim", "sphere"])
def test_notes_are_visible_in_a_small_window(drawn: Drawn, scene: str) -> None:
    """On every page whose lines do not fill the panel; `curtain` and `denim` have the most sliders."""
    size = (640, 480)
    session, _, _ = drawn(scene)
    session.frozen, session.view = True, "error"
    session.note = "nothing to undo: no grab or pin since the start or a change of scene"
    for page in (*PAGES, MENU):
        if page == "Statistics":
            continue
        session.page = page
        gui = FakeGui()
        panel = Panel(size, Path("imgui.ini"))
        panel.draw(gui, session, statistics(session, {"drawing": 1.0}, 60.0))
        last = panel_module.wrap(session.note)[-1]
        assert gui.bottoms[last] <= panel.place.height - PADDING, page
        assert gui.texts.index(last) < gui.texts.index(next(text for text in gui.texts if text.startswith(scene)))


def test_a_low_panel_lists_fewer_names(drawn: Drawn) -> None:
    session, _, _ = drawn("drape15")
    session.page = "Scenes"
    counts = []
    for height in (720, 600, 480, 100):
        gui = FakeGui()
        Panel((640, height), Path("imgui.ini")).draw(gui, session, "")
        counts.append(len({label.removeprefix("> ").partition(":")[0] for label in gui.labels} & set(session.scenes)))
    assert counts == [20, 16, 11, 1]


def test_the_caption_has_room_for_its_lines_and_a_title(drawn: Drawn) -> None:
    """The toolkit keeps the first size of a name, and does not show what follows ##."""
    names, heights = [], []
    for lines in (["wrote a file"], ["a long message " * 8]):
        gui = FakeGui()
        draw_caption(gui, SIZE, HIDDEN_TITLE, lines)
        ((name, rect),) = gui.windows
        names.append(name)
        heights.append(rect[3] * SIZE[1])
        assert heights[-1] >= max(gui.bottoms.values()) + PADDING
        assert rect[2] * SIZE[0] == pytest.approx(PANEL_WIDTH)
    assert [name.partition("##")[0] for name in names] == 2 * ["message (H shows the panel)"]
    assert names[0] != names[1]
    assert heights[0] < heights[1]


def test_the_grab_radius_has_a_slider_with_help(drawn: Drawn) -> None:
    session, gui, used = drawn("curtain", Grab=0.4)
    assert used
    assert session.grab_radius == pytest.approx(0.4)
    assert any("along the cloth" in text for text in gui.texts)
    session, _, _ = drawn("curtain", Grab=1e9)
    assert session.grab_radius == session.max_grab_radius == pytest.approx(4.35 / 4)


def test_the_first_page_says_how_to_begin(drawn: Drawn) -> None:
    _, gui, _ = drawn("curtain")
    assert "Drag cloth or a ball; drag beside it to orbit;" in " ".join(gui.texts)


def test_a_slider_that_is_moved_shows_its_help(drawn: Drawn) -> None:
    _, gui, _ = drawn("curtain", Gravity=3.0)
    assert "Gravity: downward acceleration; 0 to 20 m/s², scene" in gui.texts


def test_restore_defaults_restores_the_values_of_the_scene(drawn: Drawn) -> None:
    session, gui, _ = drawn("curtain", Gravity=3.0, Grab=0.4, **{"Restore defaults": True})
    assert session.simulation.params["gravity"] == 9.81
    assert session.grab_radius == session.default_grab_radius
    assert not any("along the cloth" in text for text in gui.texts), "the help of a slider that was moved before"


def test_a_feature_is_switched_off(drawn: Drawn) -> None:
    session, gui, used = drawn("net", "Features", **{"Strain-limit": True})
    assert used
    assert {"Strain-limit", "Spheres", "Ground"} <= set(gui.labels)
    assert "strain limit" not in session.simulation.features
    assert session.features == {"strain_limit": False, "spheres": True, "ground": True}


def test_features_show_their_times(drawn: Drawn, tmp_path: Path) -> None:
    session, gui, used = drawn("net", "Features", **{"Time features": True})
    assert used
    assert "Strain-limit" in gui.boxes
    times = session.feature_times
    assert times is not None
    again = FakeGui()
    Panel(SIZE, tmp_path / "imgui.ini").draw(again, session, "")
    assert {f"{name.replace('_', '-').capitalize()} {times.cost_ms[name]:+.2f} ms" for name in session.features} <= set(
        again.boxes
    )
    assert f"timed from frame 0: {times.ms:.2f} ms per frame" in again.texts


def test_statistics_have_times_and_charts_have_a_legend(drawn: Drawn) -> None:
    session, gui, _ = drawn("drape15", "Statistics", Charts=True)
    assert session.charts
    assert "physics - ms of 16.7 ms" in gui.texts
    assert any(text.startswith("drawing 12 ms, measuring ") for text in gui.texts)
    assert any(text.startswith("225 particles, ") and text.endswith(" 2 pins") for text in gui.texts)
    assert f"charts of the last {CHART_SECONDS:g} s:" in gui.texts
    assert any(text.startswith("kinetic energy: ") and " J (scale to " in text for text in gui.texts)


@pytest.mark.parametrize("scene", scene_names())
@pytest.mark.parametrize("view", ["shaded", "error"])
def test_the_panel_of_a_comparison_fits_with_errors_and_a_long_note(scene: str, view: str, tmp_path: Path) -> None:
    found = FrameError(123456, 1.0, 1.0, 1e-9, 2.0, 2.0, np.zeros(1), 0.01)  # its parts partly cancel
    with closing(Comparison(load_scene(scene), load_scene(scene, solver="xpbd"), 1.0, tmp_path)) as comparison:
        comparison.act("errors")
        for side, error in zip(comparison.sides, (1.0, 0.9), strict=True):
            assert side.meter is not None
            side.view, side.meter.answer = view, Answer(replace(found, error=error), abs(error - 0.95 + 0.01))
        comparison.left.note = "explicit needs 200,001 substeps a frame, more than 200,000: its springs are stiff"
        gui, size = FakeGui(), (1240, 720)  # the default of `compare`
        ComparisonPanel(size, tmp_path / "imgui.ini").draw(gui, comparison, comparison_statistics(comparison, 123.4))
        height = TITLE_HEIGHT + 2 * PADDING + len(gui.labels) * WIDGET_ROW + len(gui.texts) * TEXT_ROW
        assert height <= COMPARISON_HEIGHT <= size[1] - 2 * PANEL_MARGIN
        assert max(map(len, gui.texts)) <= LINE_LENGTH


def test_the_panel_of_a_comparison_has_sliders_for_the_solver_of_each_side(tmp_path: Path) -> None:
    with closing(Comparison(load_scene("drape15"), load_scene("drape15", solver="rk4"), 1.0, tmp_path)) as comparison:
        gui = FakeGui(**{"Sliders for each solver": True})
        panel = ComparisonPanel(SIZE, tmp_path / "imgui.ini")
        assert panel.draw(gui, comparison, [])
        assert not any(label.startswith(("left", "right")) for label in gui.labels)
        gui = FakeGui(**{"left: Iterations": 40, "right: Substeps": 30})
        assert panel.draw(gui, comparison, [])
        assert "Gravity [m/s²]" not in gui.labels
        assert [label for label in gui.labels if label.startswith(("left", "right"))] == [
            *("left: Iterations", "left: Substeps", "right: Substeps")  # rk4 does not iterate
        ]
        assert comparison.left.simulation.params["iterations"] == 40
        assert comparison.right.simulation.substeps == 30
        assert comparison.left.simulation.substeps == 1
        comparison.act("page")
        gui = FakeGui()
        assert not panel.draw(gui, comparison, [])
        assert "Gravity [m/s²]" in gui.labels


def test_the_error_of_a_frame_is_shown_with_its_parts(drawn: Drawn) -> None:
    session, gui, _ = drawn("drape15", "Statistics", **{"Measure errors": True})
    assert "error of a frame: not measured (U)" in gui.texts
    assert session.meter is not None
    assert error_lines(session.meter) == ["error of a frame: not measured yet"]
    found = FrameError(7, 0.00123, 0.01, 1e-6, 0.0005, 0.0008, np.linspace(0.0, 0.0034, 225), 0.01)
    assert [millimeters(value) for value in (0.00123, 0.0994, 0.137, 2.5)] == ["1.2 mm", "99 mm", "137 mm", "2500 mm"]
    session.meter.answer = Answer(found, 0.02)
    assert error_lines(session.meter) == [
        "error of frame 7: 1.2 mm RMS, 12 % of its motion",
        "  largest error of a particle: 3.4 mm",
        "  by iterations 0.5 mm, by substeps and model 0.8 mm",
        "  estimate for 1 s without input: 20 mm",
    ]
    session.meter.recent.extend([0.002, 0.0003])
    assert "median" not in error_lines(session.meter)[0]
    session.meter.recent.append(0.0004)
    assert error_lines(session.meter)[0].endswith("; median of 3 frames: 0.4 mm")
    explicit = replace(found, error=5e-5, motion=0.0, residual=None, step_error=5e-5)
    session.meter.answer = Answer(explicit)
    assert error_lines(session.meter)[2:] == ["  by substeps and model 0.05 mm"]
    session.meter.answer = Answer(replace(explicit, error=1.9e-6))
    assert error_lines(session.meter) == ["error of frame 7: below 0.002 mm, as exact as the reference"]
    session.meter.answer = Answer(replace(found, error=0.65, reference_error=0.4))  # of a motion of 10 mm
    assert error_lines(session.meter) == ["error of frame 7: not measured: the reference has not converged"]
    session.meter.answer = Answer(replace(found, residual=0.004, step_error=0.0045))
    assert error_lines(session.meter)[2] == "  by iterations 4 mm, by substeps and model 4.5 mm, which partly cancel"
    more, most, whole = "more than the cloth moved", "99 % of its motion", "100 % of its motion"
    for motion, share in ((0.00124, most), (0.001231, whole), (0.0012, more), (0.0, more)):
        session.meter.answer = Answer(replace(found, motion=motion))
        assert error_lines(session.meter)[0].startswith(f"error of frame 7: 1.2 mm RMS, {share}")
    session.meter.answer = Answer(found, None, "its reference takes 3.1 s")
    assert error_lines(session.meter) == ["error of a frame: not measured: its reference takes 3.1 s"]


@pytest.mark.parametrize(("scene", "solver"), [("drape15", "verlet"), ("round", "xpbd")])
def test_the_statistics_say_that_verlet_does_not_converge_to_the_fabric(drawn: Drawn, scene: str, solver: str) -> None:
    session, _, _ = drawn(scene)
    assert session.simulation.scene.solver.name == solver
    assert ("only the other solvers converge" in statistics(session, {}, 60.0)) is (solver == "verlet")


def test_the_error_of_the_setting_is_not_shown_as_one_of_now(drawn: Drawn) -> None:
    _, gui, _ = drawn("drape15")
    assert [text for text in gui.texts if "error" in text] == ["error of a frame: not measured (U)"]
    _, gui, _ = drawn("drape15", "Statistics")
    assert "swinging curtain" not in " ".join(gui.texts)


def slow(session: Session, ms: float) -> str:
    """Return the line after a second of frames that took `ms` [ms]."""
    for k in range(1, 61):
        session.history.add(session.history.rows[-1, 0] + k / 60, session.metrics, ms)
    return slow_line(session)


def test_a_scene_that_is_too_slow_names_a_faster_choice() -> None:
    session = Session(load_scene("drape15"))
    assert slow_line(session) == ""
    session.change_solver("xpbd")
    assert slow(session, 16.0) == ""
    assert slow(session, 123.4) == "too slow: a frame needs 123 ms of 16.7; try verlet"
    assert slow(session, 20.04) == "too slow: a frame needs 20 ms of 16.7; try lines"
    session.speed = "1/8"
    assert slow(session, 123.4) == ""
    session.speed = "1/2"
    assert slow(session, 50.0).startswith("too slow: a frame needs 50 ms of 33.3; try ")
    session.speed = "1"
    session.frozen = True
    assert slow(session, 123.4) == ""
    session.close()


def test_a_cloth_that_blew_up_says_so_on_every_page(tmp_path: Path) -> None:
    """Not while a hand stretches it."""
    session = Session(load_scene("drape15"))
    assert blown_up_line(session) == ""
    for strain, shown in ((1.0, ""), (4.77, "strain 477 %: the cloth may have blown up; Reset (R), Undo (Z) or")):
        session.metrics = replace(session.metrics, max_strain=strain)
        assert blown_up_line(session).startswith(shown)
        assert alert(session) == blown_up_line(session)
    for page in (*PAGES, MENU):
        session.page, gui = page, FakeGui()
        Panel(SIZE, tmp_path / "imgui.ini").draw(gui, session, statistics(session, {"drawing": 12.3}, 59.9))
        assert [text for text in gui.texts if text.startswith("strain 477 %: the cloth may have blown up")]
    session.simulation.grab(7)
    assert blown_up_line(session) == ""
    session.close()


def test_the_cheapest_solver_needs_fewer_iterations_or_substeps() -> None:
    session = Session(load_scene("drape15"))  # verlet 1×5
    tries = []
    for setting in ({}, {"iterations": 1, "substeps": 2}, {"substeps": 1}):
        for name, value in setting.items():
            session.simulation.params[name] = value
        tries.append(slow(session, 40.0).partition("try ")[2])
    assert tries == ["fewer iterations", "fewer substeps", "a coarser cloth"]
    session.close()


def test_a_solver_that_the_cloth_does_not_support_is_not_named() -> None:
    session = Session(load_scene("tear", solver="xpbd", substeps=60, iterations=4))
    reason, _, solver = slow(session, 20.04).partition("; try ")
    assert reason == "too slow: a frame needs 20 ms of 16.7"
    assert solver in ("implicit", "verlet")  # by the times of the machine; `lines` would be as accurate
    session.close()
    session = Session(load_scene("bias", substeps=12))  # a membrane, which `verlet` would replace by other springs
    assert slow(session, 18.0) == "too slow: a frame needs 18 ms of 16.7; try fewer substeps"
    session.close()


SETTINGS = """[Window][Debug##Default]
Pos=60,60
Size=400,400
Collapsed=0

[Window][{name}]
Pos=410,-5
Size=392,640
Collapsed={collapsed}

"""


@pytest.mark.parametrize(("collapsed", "height"), [(0, 640), (1, TITLE_HEIGHT)])
def test_the_rectangle_is_read_from_the_settings_of_the_toolkit(tmp_path: Path, collapsed: int, height: int) -> None:
    file = tmp_path / "imgui.ini"
    assert saved_panel_rect(file, PANEL_NAME) is None
    file.write_text(SETTINGS.format(name="something else", collapsed=collapsed))
    assert saved_panel_rect(file, PANEL_NAME) is None
    file.write_text(SETTINGS.format(name=PANEL_NAME, collapsed=collapsed))
    assert saved_panel_rect(file, PANEL_NAME) == PanelRect(410, -5, 392, height)


def test_a_rectangle_contains_the_points_inside_it() -> None:
    rect = PanelRect(left=10, top=20, width=100, height=50)
    size = (200, 100)
    assert rect.contains((0.3, 0.6), size)
    assert not rect.contains((0.02, 0.6), size)
    assert not rect.contains((0.3, 0.9), size)  # above it: v points up
    assert not rect.contains((0.3, 0.2), size)


def test_a_choice_that_is_too_slow_is_named_on_every_page(drawn: Drawn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(History, "frame_ms", 250.0)
    for page in PAGES:
        _, gui, _ = drawn("drape15", page)
        assert any(text.startswith("too slow: a frame needs 250 ms of 16.7; try ") for text in gui.texts), page
