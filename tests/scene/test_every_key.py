"""Invalid values for every key: the error is one line that names the key and what it allows."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene.keys import Key, Keyframes, Pins, Section, Vec3, keys_of, range_text, toml_value, types_of
from taichi_cloth.scene.schema import Scene, sections
from taichi_cloth.system.errors import SceneError

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


class Case(NamedTuple):
    table: str  # header of its table in a file; "" for keys of the scene itself
    where: str  # prefix of its name in messages
    name: str
    key: Key
    hint: Any


def cases() -> list[Case]:
    found = [Case("", "", name, key, types_of(Scene)[name]) for name, key in keys_of(Scene).items()]
    for part in sections().values():
        table, where = (
            (f"[[{part.name}]]", f"{part.name}[0].") if part.is_array else (f"[{part.name}]", f"{part.name}.")
        )
        hints = types_of(part.cls)
        found += [Case(table, where, name, key, hints[name]) for name, key in keys_of(part.cls).items()]
    return found


CASES = [pytest.param(case, id=case.where + case.name) for case in cases()]
NUMBERS = [pytest.param(case, id=case.where + case.name) for case in cases() if case.key.min is not None]
TYPE_MESSAGES = {bool: "must be true or false", int: "must be an integer", float: "must be a number"}


def text(case: Case, value: str) -> str:
    return f"{case.table}\n{case.name} = {value}\n"


def with_number(case: Case) -> Callable[[str], tuple[str, str]]:
    """Return a function from a number to a TOML value that contains it, and its index within the key in messages."""
    if case.hint == Vec3:
        return lambda number: (f"[0.5, {number}, 0.5]", "[1]")
    if case.hint == Keyframes:
        return lambda number: (f"[[0, 0, 0, {number}]]", "[0][3]")
    return lambda number: (number, "")


def test_keys_of_every_type_are_tested() -> None:
    assert len(NUMBERS) > 60
    assert {case.hint for case in cases()} >= {bool, int, float, str, Vec3, Keyframes}


@pytest.mark.parametrize("case", NUMBERS)
def test_a_number_out_of_range_is_refused(write: Write, refuse: Refuse, case: Case) -> None:
    low, high = case.key.min, case.key.max
    assert low is not None
    assert high is not None
    step = 1 if case.hint is int else max(abs(low), abs(high)) * 1e-9 + 1e-12
    wrong = [low - step, high + step, -(10**400), 10**400, *([low] if case.key.exclusive_min else [])]
    for number in map(repr, wrong):
        value, index = with_number(case)(number)
        error = refuse(write(text(case, value)))
        assert error.key == case.where + case.name + index
        assert error.reason.endswith(f"is out of range: {range_text(case.key)}")


@pytest.mark.parametrize("case", NUMBERS)
def test_a_number_that_is_not_finite_is_refused(write: Write, refuse: Refuse, case: Case) -> None:
    for number in ("nan", "inf", "-inf"):
        value, index = with_number(case)(number)
        error = refuse(write(text(case, value)))
        assert error.key == case.where + case.name + index
        expected = TYPE_MESSAGES[int] if case.hint is int else "must be a finite number"
        assert error.reason == f"{expected}, got {number}"


@pytest.mark.parametrize("case", NUMBERS)
def test_the_ends_of_the_range_are_allowed(write: Write, case: Case) -> None:
    for number in (case.key.min, case.key.max):
        if number == case.key.min and case.key.exclusive_min:
            continue
        value, _ = with_number(case)(toml_value(number))
        try:
            load_scene(write(text(case, value)))
        except SceneError as error:
            if case.name in ("c11", "c22", "c12", "c66"):  # a tensor has to be positive definite
                assert "membrane" in error.reason
            else:  # resolution and margin of a mesh have a common limit, too
                assert case.where == "meshes[0]."
                assert "nodes, more than" in error.reason


@pytest.mark.parametrize("case", CASES)
def test_a_value_of_another_type_is_refused(write: Write, refuse: Refuse, case: Case) -> None:
    wrong = ["1979-05-27", "{a = 1}", "[[true]]", "true", "7", "'seven'"]
    valid = {bool: "true", int: "7", float: "7", str: "'seven'", Pins: "7"}.get(case.hint)
    for value in wrong:
        if value == valid and not (case.key.choices or case.key.color):
            continue
        error = refuse(write(text(case, value)))
        assert error.key.startswith(case.where + case.name)
        assert error.reason


@pytest.mark.parametrize("case", CASES)
def test_a_mistyped_name_gets_a_hint(write: Write, refuse: Refuse, case: Case) -> None:
    error = refuse(write(f"{case.table}\n{case.name}q = 1\n"))
    assert (error.key, error.reason.split(";")[0]) == (f"{case.where}{case.name}q", "unknown key")
    assert case.name in (error.hint, *error.reason.replace(",", "").split())


@pytest.mark.parametrize("part", sections().values(), ids=lambda part: part.name)
def test_help_of_a_section_has_all_keys_with_meaning_and_range(part: Section) -> None:
    lines = (inspect.getdoc(part.cls) or "").splitlines()
    for name, key in keys_of(part.cls).items():
        assert f"{name}: {key.help}, {range_text(key)}".rstrip(", ") in lines
