"""The panel's labels, sizes and answers, with a toolkit that only takes notes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taichi_cloth.scene import load_scene, scene_names
from taichi_cloth.view.panel import HEIGHT, LETTERS, MARGIN, NAME, WIDTH, Panel, numbers
from taichi_cloth.view.panel_place import TITLE_HEIGHT, Place, saved_place
from taichi_cloth.view.session import Session

SIZE = (1280, 720)
LETTER, PADDING, WIDGET_ROW, TEXT_ROW, SPACING = 7, 8, 23, 17, 4  # [pixels] Dear ImGui's look and font


class Notes:
    """Answers like the toolkit: with float32. `answers` replace what it would say by label."""

    def __init__(self, **answers: Any) -> None:
        self.answers = answers
        self.labels: list[str] = []
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
        return value ^ (label in self.answers)

    def button(self, label: str) -> bool:
        self.labels.append(label)
        return label in self.answers

    def text(self, text: str, color: Any = None) -> None:
        self.texts.append(text)


@pytest.fixture
def drawn(tmp_path: Path) -> Iterator[Callable[..., tuple[Session, Notes, bool]]]:
    """Draws the panel of a scene once: `drawn("curtain", Wind=True)`."""
    sessions = []

    def draw(scene: str, **answers: Any) -> tuple[Session, Notes, bool]:
        session, notes = Session(load_scene(scene)), Notes(**answers)
        sessions.append(session)
        used = Panel(SIZE, tmp_path / "imgui.ini").draw(notes, session, numbers(session, 12.3, 59.9))
        return session, notes, used

    yield draw
    for session in sessions:
        session.close()


Drawn = Callable[..., tuple[Session, Notes, bool]]


@pytest.mark.parametrize("scene", scene_names())
def test_labels_are_unique_and_everything_fits(drawn: Drawn, scene: str) -> None:
    _, notes, used = drawn(scene)
    assert not used, "nobody touched a widget"
    assert len(set(notes.labels)) == len(notes.labels)
    room = (WIDTH - 0.65 * WIDTH - PADDING - SPACING) / LETTER  # beside a slider
    assert max(map(len, notes.labels)) <= room
    assert max(map(len, notes.texts)) <= LETTERS
    height = TITLE_HEIGHT + 2 * PADDING + len(notes.labels) * WIDGET_ROW + len(notes.texts) * TEXT_ROW
    assert height <= HEIGHT
    assert SIZE[1] >= HEIGHT + 2 * MARGIN


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
    session, _, used = drawn("curtain", Freeze=True, Wind=True, Step=True, **{"Next view": True})
    assert used
    assert session.frozen
    assert session.simulation.get("wind") is False
    assert session.simulation.frame == 1
    assert session.view == "strain"


def test_a_scene_without_wind_has_no_widget_for_it(drawn: Drawn) -> None:
    scene = next(name for name in scene_names() if load_scene(name).wind is None)
    _, notes, _ = drawn(scene)
    assert not [label for label in notes.labels if "Wind" in label]


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
