"""The messages of pages: valid ones are parsed, all others are rejected with one line."""

from __future__ import annotations

import json
import re
from math import isfinite
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.viewer import panel
from taichi_cloth.viewer.input import PAGES, SHORTCUTS
from taichi_cloth.web.protocol import (
    ACTIONS,
    FORBIDDEN_ACTIONS,
    MAX_NAME,
    PAGE_ACTIONS,
    READERS,
    PageView,
    ProtocolError,
    parse_message,
)
from taichi_cloth.web.server import PAGE_FILE

VIEW = [0.5, 0.25, 640, 360, 0.1, 0.2, 7.0, 0.0, 0.0, 2.0, 0.0]


def message(**command: object) -> str:
    """Return a message of a page about scene 0."""
    return json.dumps({"sceneId": 0, **command})


def test_valid_messages_are_parsed() -> None:
    assert parse_message(message(action="reset")).argument == "reset"
    assert parse_message(message(set=["gravity", 3])).argument == ("gravity", 3.0)
    assert parse_message(message(switch={"wind": False})).argument == {"wind": False}
    assert parse_message(message(choose=["fabric", ""])).argument == ("fabric", "")
    assert parse_message(message(choose=["speed", "1/4"])).argument == ("speed", "1/4")
    assert parse_message(message(release=None)).name == "release"
    assert parse_message(message(displayed=12)).argument == 12
    view = PageView((0.5, 0.25), (640, 360), 0.1, 0.2, 7.0, (0.0, 2.0, 0.0), 0.0)
    for name in ("press", "move", "pin"):
        assert parse_message(message(**{name: VIEW})).argument == view


def test_every_key_acts_on_the_server_or_on_the_page_or_is_forbidden() -> None:
    assert {key.action for key in SHORTCUTS} == {*ACTIONS, *PAGE_ACTIONS, *FORBIDDEN_ACTIONS} - {"time_features"}
    assert not {*ACTIONS} & {"export", "screenshot", "clip", "quit"}


def test_the_page_has_all_page_actions_and_only_valid_buttons() -> None:
    page = PAGE_FILE.read_text(encoding="utf-8")
    table = re.search(r"const PAGE_ACTIONS = \{\n(.*?)\n\};", page, re.DOTALL)
    assert table is not None
    assert {*re.findall(r"^  (\w+):", table[1], re.MULTILINE)} == {*PAGE_ACTIONS}
    assert {*re.findall(r'data-action="(\w+)"', page)} <= {*ACTIONS}


def test_the_page_has_the_words_of_the_window() -> None:
    page, window = PAGE_FILE.read_text(encoding="utf-8"), Path(panel.__file__).read_text(encoding="utf-8")
    assert {*re.findall(r"<summary>(.*?)</summary>", page)} <= {*PAGES}
    lists = {name + "s" for name in re.findall(r"<span>(\w+)</span><select", page)}
    assert lists == {*panel.LIST_PAGES}
    labels = re.findall(r"<button data-[^>]*>(.*?)</button>", page) + re.findall(r'type="checkbox"[^>]*>(.*?)<', page)
    assert len(labels) == 9
    assert [label for label in labels if f'"{label}"' not in window] == ["Mesh edges"]
    assert 'aria-label="show/hide panel"' in page


def test_views_are_clamped() -> None:
    view = parse_message(message(press=[9e9, -9e9, 0, 1e300, 1e9, 9, 0, 99, 1e300, -1e300, 0])).argument
    assert view == PageView((2, -1), (1, 16384), 1e3, 1.6, 0.1, (1e6, -1e6, 0), 10)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"{}", "expected text"),
        ("", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ('{"sceneId": 0, "set": ["gravity", NaN]}', "not JSON"),
        ('{"sceneId": 0, "set": ["gravity", -Infinity]}', "not JSON"),
        ('{"sceneId": 0, "set": ["gravity", 1e999]}', "expected a number"),
        ('{"sceneId": 0, "set": ["gravity", ' + "9" * 400 + "]}", "expected a number"),
        ("[]", "one command and 'sceneId'"),
        ("{}", "one command and 'sceneId'"),
        ('{"action": "reset"}', "one command and 'sceneId'"),
        (message(), "one command and 'sceneId'"),
        (message(action="reset", release=None), "one command and 'sceneId'"),
        ('{"sceneId": "0", "action": "reset"}', "one command and 'sceneId'"),
        ('{"sceneId": true, "action": "reset"}', "one command and 'sceneId'"),
        (message(load="/etc/passwd"), "unknown command 'load': action, set,"),
        (message(action="export"), "unknown action 'export'"),
        (message(action="quit"), "unknown action 'quit'"),
        (message(action=["reset"]), "unknown action ['reset']"),
        (message(set=["gravity", True]), "expected a number, got true"),
        (message(set=["gravity", "9"]), "expected a number"),
        (message(set=["gravity"]), "a name and a number"),
        (message(set=["g" * (MAX_NAME + 1), 1]), "expected a name"),
        (message(switch={"wind": 1}), "features with true or false"),
        (message(choose=["file", "x"]), "one of scene, solver, fabric, speed"),
        (message(choose=[[], "x"]), "one of scene, solver, fabric, speed"),
        (message(press=VIEW[:-1]), "expected eleven numbers"),
        (message(press=[None, *VIEW[1:]]), "expected a number, got None"),
        (message(release=1), "expected null, got 1"),
        (message(displayed=-1), "expected an integer"),
        (message(displayed=1.5), "expected an integer"),
    ],
)
def test_invalid_messages_are_rejected_with_one_line(text: str | bytes, reason: str) -> None:
    with pytest.raises(ProtocolError) as rejected:
        parse_message(text)
    assert reason in str(rejected.value)
    assert "\n" not in str(rejected.value)
    assert len(str(rejected.value)) < 300


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda children: st.lists(children, max_size=12) | st.dictionaries(st.text(max_size=5), children, max_size=3),
    max_leaves=14,
)


@given(st.sampled_from([*READERS]), json_values)
def test_parsed_commands_have_valid_arguments(name: str, value: object) -> None:
    try:
        command = parse_message(message(**{name: value}))
    except ProtocolError:
        return
    assert command.name == name
    if isinstance(command.argument, PageView):
        assert all(map(isfinite, (*command.argument.cursor, *command.argument.target, command.argument.distance)))
        assert min(command.argument.size) >= 1


@given(st.text() | st.binary())
def test_noise_is_rejected(text: str | bytes) -> None:
    with pytest.raises(ProtocolError):
        parse_message(text)
