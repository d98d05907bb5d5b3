"""The panel's labels, sizes and answers, with a toolkit that only takes notes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.interact.keys import ARROWS, KEYS
from taichi_cloth.scene import live_keys, load_scene, scene_names
from taichi_cloth.view.curves import SPAN
from taichi_cloth.view.panel import COLUMN, HEIGHT, LETTERS, MARGIN, NAME, WIDTH, Panel, help_lines, numbers
from taichi_cloth.view.panel_place import TITLE_HEIGHT, Place, saved_place
from taichi_cloth.view.session import PAGES, Session
from taichi_cloth.view.stage_times import StageTimes

pytestmark = pytest.mark.usefixtures("on_lists")

SIZE = (1280, 720)
LETTER, PADDING, WIDGET_ROW, TEXT_ROW, SPACING = 7, 8, 23, 17, 4  # [pixels] Dear ImGui's look and font


class Notes:
    """Answers like the toolkit: with float32. `answers` replace what it would say by label."""

    def __init__(self, **answers: Any) -> None:
        self.answers = answers
        self.labels: list[str] = []
        self.boxes: list[str] = []  # labels of check boxes
        self.texts: list[str] = []

    @contextmanager
    def sub_window(self, name: str, *place: float) -> Iterator[None]:
        yield

    def slider_float(self, label: str, value: float, low: float, high: float) -> float:
        self.labels.append(label)
        return float(np.float32(self.answers.get(label.split()[0], value)))

    def slider_int(self, label: str, value: int, low: int, high: int) -> int:
        self.labels.append(label)
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


@pytest.fixture
def drawn(tmp_path: Path) -> Iterator[Callable[..., tuple[Session, Notes, bool]]]:
    """Draws a page of the panel of a scene once: `drawn("curtain", "Stages", Wind=True)`."""
    sessions = []

    def draw(scene: str, page: str = "Sliders", **answers: Any) -> tuple[Session, Notes, bool]:
        session, notes = Session(load_scene(scene)), Notes(**answers)
        sessions.append(session)
        session.page = page
        used = Panel(SIZE, tmp_path / "imgui.ini").draw(notes, session, numbers(session, 12.3, 59.9))
        session.do_asked()
        return session, notes, used

    yield draw
    for session in sessions:
        session.close()


Drawn = Callable[..., tuple[Session, Notes, bool]]


@pytest.mark.parametrize("scene", scene_names())
def test_labels_are_unique_and_everything_fits(scene: str, tmp_path: Path) -> None:
    """Every page, with curves on, with a long note and the longest help, and all stages timed."""
    session = Session(load_scene(scene))
    session.stage_times = StageTimes(123456, 1234.56, dict.fromkeys((*session.stages, "wind"), -123.45))
    session.curves = True
    session.note = "spring would take 200,001 substeps a frame, more than 200,000: " + "its springs are stiff " * 4
    panel = Panel(SIZE, tmp_path / "imgui.ini")
    for page in PAGES:
        assert session.page == page
        for slider in [*live_keys(session.simulation.scene), "hand"] if page == "Sliders" else [""]:
            panel._moved = slider
            notes = Notes()
            assert not panel.draw(notes, session, numbers(session, 12.3, 59.9)), "nobody touched a widget"
            assert len(set(notes.labels)) == len(notes.labels)
            room = (WIDTH - 0.65 * WIDTH - PADDING - SPACING) / LETTER  # beside a slider
            assert max(len(label) for label in notes.labels if label not in notes.boxes) <= room
            assert max(map(len, notes.boxes)) <= LETTERS - (WIDGET_ROW + SPACING) // LETTER
            assert max(map(len, notes.texts)) <= LETTERS
            height = TITLE_HEIGHT + 2 * PADDING + len(notes.labels) * WIDGET_ROW + len(notes.texts) * TEXT_ROW
            assert height <= HEIGHT
        session.act("page")
    assert SIZE[1] >= HEIGHT + 2 * MARGIN
    session.close()


def test_keys_stand_in_two_columns_that_do_not_touch() -> None:
    assert all(line[COLUMN - 1 : COLUMN + 1].strip() == "" for line in help_lines())
    text = "\n".join(help_lines())
    assert [key.label for key in KEYS if f"{key.label:5} {key.help}" not in text] == [
        key.label for key in KEYS if key.code in ARROWS
    ]
    assert "arrows: move the view" in text


def test_every_page_has_a_button_to_the_next(drawn: Drawn) -> None:
    session, notes, _ = drawn("curtain", "Numbers", **{"Numbers > Keys": True})
    assert "Numbers > Keys" in notes.labels
    assert session.page == "Keys"


@pytest.mark.parametrize(
    ("answer", "value"), [(3.5, 3.5), (1e9, 20.0), (-4, 0.0), (float("nan"), 9.81), (float("inf"), 9.81)]
)
def test_a_slider_sets_its_parameter_within_its_range(drawn: Drawn, answer: float, value: float) -> None:
    session, _, used = drawn("curtain", Gravity=answer)
    assert session.simulation.get("gravity") == pytest.approx(value)
    assert used is bool(np.isfinite(answer))


def test_a_slider_of_whole_numbers_keeps_to_them(drawn: Drawn) -> None:
    session, _, used = drawn("curtain", Substeps=7)
    assert used
    assert session.simulation.get("substeps") == 7
    assert isinstance(session.simulation.get("substeps"), int)


def test_switches_and_buttons_act(drawn: Drawn) -> None:
    session, _, used = drawn("curtain", "Stages", Freeze=True, Wind=True, Step=True, **{"Next view": True})
    assert used
    assert session.frozen
    assert session.simulation.get("wind") is False
    assert session.simulation.frame == 1
    assert session.view == "strain"


def test_a_scene_without_wind_has_no_widget_for_it(drawn: Drawn) -> None:
    for page in ("Sliders", "Stages"):
        session, notes, _ = drawn("net", page)
        assert session.simulation.scene.wind is None
        assert not [label for label in notes.labels if "Wind" in label]


def test_the_hand_has_a_slider_and_its_help(drawn: Drawn) -> None:
    session, notes, used = drawn("curtain", Hand=0.4)
    assert used
    assert session.radius == pytest.approx(0.4)
    assert any("on the sheet" in text for text in notes.texts)
    session, _, _ = drawn("curtain", Hand=1e9)
    assert session.radius == session.largest_radius == pytest.approx(4.35 / 4)


def test_the_first_page_tells_how_to_begin(drawn: Drawn) -> None:
    _, notes, _ = drawn("curtain")
    assert "drag the cloth; M opens the next scene" in " ".join(notes.texts)


def test_a_slider_that_is_moved_tells_what_it_is(drawn: Drawn) -> None:
    _, notes, _ = drawn("curtain", Gravity=3.0)
    assert "Gravity: downward acceleration; 0 to 20 m/s², of this" in notes.texts


def test_the_scenes_values_come_back(drawn: Drawn) -> None:
    session, _, _ = drawn("curtain", Gravity=3.0, Hand=0.4, **{"Scene's values": True})
    assert session.simulation.get("gravity") == 9.81
    assert session.radius == session.usual_radius


def test_a_stage_is_switched_off(drawn: Drawn) -> None:
    session, notes, used = drawn("net", "Stages", Limit=True)
    assert used
    assert {"Limit", "Spheres", "Ground"} <= set(notes.labels)
    assert "limit" not in session.simulation.stages
    assert session.stages == {"limit": False, "spheres": True, "ground": True}


def test_stages_have_their_times(drawn: Drawn, tmp_path: Path) -> None:
    session, notes, used = drawn("net", "Stages", **{"Time the stages": True})
    assert used
    assert "Limit" in notes.boxes
    times = session.stage_times
    assert times is not None
    again = Notes()
    Panel(SIZE, tmp_path / "imgui.ini").draw(again, session, "")
    assert {f"{name.capitalize()} {times.less[name]:+.2f} ms" for name in session.stages} <= set(again.boxes)
    assert f"from frame 0 on a frame took {times.ms:.2f} ms" in again.texts


def test_figures_tell_times_and_curves_have_their_legend(drawn: Drawn) -> None:
    session, notes, _ = drawn("drape15", "Numbers", Curves=True)
    assert session.curves
    assert any("physics 0.0 + drawing 12 + measuring" in text for text in notes.texts)
    assert any(text.startswith("225 particles, ") and text.endswith(" 2 pins") for text in notes.texts)
    assert f"curves of the last {SPAN:g} s:" in notes.texts
    assert any(text.startswith("kinetic energy: ") and text.endswith(" J") for text in notes.texts)


def test_no_error_is_told_finer_than_it_is_known(drawn: Drawn) -> None:
    _, notes, _ = drawn("net")
    assert any(text.endswith("error below 0.01 %") for text in notes.texts)
    _, notes, _ = drawn("drape15")
    assert any(text.endswith("error about 4.7 %") for text in notes.texts)


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
def test_the_place_is_read_from_the_toolkits_settings(tmp_path: Path, collapsed: int, height: int) -> None:
    file = tmp_path / "imgui.ini"
    assert saved_place(file, NAME) is None
    file.write_text(SETTINGS.format(name="something else", collapsed=collapsed))
    assert saved_place(file, NAME) is None
    file.write_text(SETTINGS.format(name=NAME, collapsed=collapsed))
    assert saved_place(file, NAME) == Place(410, -5, 392, height)


def test_a_place_knows_what_lies_in_it() -> None:
    place = Place(left=10, top=20, width=100, height=50)
    size = (200, 100)
    assert place.contains((0.3, 0.6), size)
    assert not place.contains((0.02, 0.6), size)
    assert not place.contains((0.3, 0.9), size)  # above it: v runs upwards
    assert not place.contains((0.3, 0.2), size)
