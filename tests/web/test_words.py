"""What pages may say: what ours says is understood, anything else is refused in a line."""

from __future__ import annotations

import json
from math import isfinite

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.interact.keys import KEYS
from taichi_cloth.web.words import ACTIONS, BARRED, LONGEST, OWN, READERS, Look, Malformed, heard

LOOK = [0.5, 0.25, 640, 360, 0.1, 0.2, 7.0, 0.0, 0.0, 2.0, 0.0]


def said(**words: object) -> str:
    return json.dumps({"of": 0, **words})


def test_what_pages_say_is_understood() -> None:
    assert heard(said(do="reset")).value == "reset"
    assert heard(said(set=["gravity", 3])).value == ("gravity", 3.0)
    assert heard(said(switch={"wind": False})).value == {"wind": False}
    assert heard(said(choose=["fabric", ""])).value == ("fabric", "")
    assert heard(said(lift=None)).what == "lift"
    assert heard(said(seen=12)).value == 12
    look = Look((0.5, 0.25), (640, 360), 0.1, 0.2, 7.0, (0.0, 2.0, 0.0), 0.0)
    for what in ("press", "move", "pin"):
        assert heard(said(**{what: LOOK})).value == look


def test_a_key_acts_here_or_there_or_not_at_all() -> None:
    assert {key.action for key in KEYS} == {*ACTIONS, *OWN, *BARRED} - {"time_stages"}
    assert not {*ACTIONS} & {"export", "screenshot", "clip", "quit"}


def test_places_are_clamped() -> None:
    look = heard(said(press=[9e9, -9e9, 0, 1e300, 1e9, 9, 0, 99, 1e300, -1e300, 0])).value
    assert look == Look((2, -1), (1, 16384), 1e3, 1.6, 0.1, (1e6, -1e6, 0), 10)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (b"{}", "a text is needed"),
        ("", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ('{"of": 0, "set": ["gravity", NaN]}', "not JSON"),
        ('{"of": 0, "set": ["gravity", -Infinity]}', "not JSON"),
        ('{"of": 0, "set": ["gravity", 1e999]}', "a number is needed"),
        ('{"of": 0, "set": ["gravity", ' + "9" * 400 + "]}", "a number is needed"),
        ("[]", "one thing and the scene"),
        ("{}", "one thing and the scene"),
        ('{"do": "reset"}', "one thing and the scene"),
        (said(), "one thing and the scene"),
        (said(do="reset", lift=None), "one thing and the scene"),
        ('{"of": "0", "do": "reset"}', "one thing and the scene"),
        ('{"of": true, "do": "reset"}', "one thing and the scene"),
        (said(load="/etc/passwd"), "'load' is none of do, set,"),
        (said(do="export"), "'export' is none of"),
        (said(do="quit"), "'quit' is none of"),
        (said(do=["reset"]), "['reset'] is none of"),
        (said(set=["gravity", True]), "a number is needed, not true"),
        (said(set=["gravity", "9"]), "a number is needed"),
        (said(set=["gravity"]), "a name and a number"),
        (said(set=["g" * (LONGEST + 1), 1]), "a name is needed"),
        (said(switch={"wind": 1}), "stages and whether they are on"),
        (said(choose=["file", "x"]), "one of scene, solver, fabric"),
        (said(choose=[[], "x"]), "one of scene, solver, fabric"),
        (said(press=LOOK[:-1]), "eleven numbers are needed"),
        (said(press=[None, *LOOK[1:]]), "a number is needed, not None"),
        (said(lift=1), "nothing is needed, not 1"),
        (said(seen=-1), "a whole number is needed"),
        (said(seen=1.5), "a whole number is needed"),
    ],
)
def test_anything_else_is_refused(message: str | bytes, why: str) -> None:
    with pytest.raises(Malformed) as refused:
        heard(message)
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda children: st.lists(children, max_size=12) | st.dictionaries(st.text(max_size=5), children, max_size=3),
    max_leaves=14,
)


@given(st.sampled_from([*READERS]), json_values)
def test_whatever_is_understood_is_of_its_kind(what: str, value: object) -> None:
    try:
        words = heard(said(**{what: value}))
    except Malformed:
        return
    assert words.what == what
    if isinstance(words.value, Look):
        assert all(map(isfinite, (*words.value.cursor, *words.value.target, words.value.distance)))
        assert min(words.value.size) >= 1


@given(st.text() | st.binary())
def test_noise_is_refused(message: str | bytes) -> None:
    with pytest.raises(Malformed):
        heard(message)
