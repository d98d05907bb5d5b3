"""Every key there is, given what it may not hold: one line that names the key and says what it may."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from taichi_cloth.scene import SceneError, load_scene
from taichi_cloth.scene.model import Key, Keyframes, Scene, Vec3, hints_of, keys_of, parts
from taichi_cloth.scene.values import range_text
from taichi_cloth.scene.writer import toml_value

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


class Case(NamedTuple):
    table: str  # as a file has it, "" above all tables
    where: str  # as a message names it
    name: str
    key: Key
    hint: Any


def cases() -> list[Case]:
    found = [Case("", "", name, key, hints_of(Scene)[name]) for name, key in keys_of(Scene).items()]
    for part in parts().values():
        table, where = (f"[[{part.name}]]", f"{part.name}[0].") if part.many else (f"[{part.name}]", f"{part.name}.")
        hints = hints_of(part.section)
        found += [Case(table, where, name, key, hints[name]) for name, key in keys_of(part.section).items()]
    return found


CASES = [pytest.param(case, id=case.where + case.name) for case in cases()]
NUMBERS = [case for case in CASES if case.values[0].key.low is not None]
WORDS = {bool: "true or false is needed", int: "a whole number is needed", float: "a number is needed"}


def text(case: Case, value: str) -> str:
    return f"{case.table}\n{case.name} = {value}\n"


def holder(case: Case) -> Callable[[str], tuple[str, str]]:
    """A value in TOML with this number in it, and what is added to the key's name where it is wrong."""
    if case.hint == Vec3:
        return lambda number: (f"[0.5, {number}, 0.5]", "[1]")
    if case.hint == Keyframes:
        return lambda number: (f"[[0, 0, 0, {number}]]", "[0][3]")
    return lambda number: (number, "")


def test_there_are_keys_of_every_kind() -> None:
    assert len(NUMBERS) > 60
    assert {case.hint for case in cases()} >= {bool, int, float, str, Vec3, Keyframes}


@pytest.mark.parametrize("case", NUMBERS)
def test_beyond_its_range(write: Write, refuse: Refuse, case: Case) -> None:
    low, high = case.key.low, case.key.high
    step = 1 if case.hint is int else max(abs(low), abs(high)) * 1e-9 + 1e-12
    wrong = [low - step, high + step, -(10**400), 10**400, *([low] if case.key.above_low else [])]
    for number in map(repr, wrong):
        value, place = holder(case)(number)
        error = refuse(write(text(case, value)))
        assert error.key == case.where + case.name + place
        assert error.reason.endswith(f"is out of range: {range_text(case.key)}")


@pytest.mark.parametrize("case", NUMBERS)
def test_no_finite_number(write: Write, refuse: Refuse, case: Case) -> None:
    for number in ("nan", "inf", "-inf"):
        value, place = holder(case)(number)
        error = refuse(write(text(case, value)))
        assert error.key == case.where + case.name + place
        said = WORDS[int] if case.hint is int else "a finite number is needed"
        assert error.reason == f"{said}, not {number}"


@pytest.mark.parametrize("case", NUMBERS)
def test_the_ends_of_its_range(write: Write, case: Case) -> None:
    for number in (case.key.low, case.key.high):
        if number == case.key.low and case.key.above_low:
            continue
        value, _ = holder(case)(toml_value(number))
        try:
            load_scene(write(text(case, value)))
        except SceneError as error:  # cells and margin of a mesh are bounded together, too
            assert case.where == "meshes[0]."
            assert "nodes, more than" in error.reason


@pytest.mark.parametrize("case", CASES)
def test_another_kind_of_value(write: Write, refuse: Refuse, case: Case) -> None:
    wrong = ["1979-05-27", "{a = 1}", "[[true]]", "true", "7", "'seven'"]
    fits = {bool: "true", int: "7", float: "7", str: "'seven'"}.get(case.hint)
    for value in wrong:
        if value == fits and not (case.key.choices or case.key.colour):
            continue
        error = refuse(write(text(case, value)))
        assert error.key.startswith(case.where + case.name)
        assert error.reason


@pytest.mark.parametrize("case", CASES)
def test_a_name_that_is_nearly_its_own(write: Write, refuse: Refuse, case: Case) -> None:
    error = refuse(write(f"{case.table}\n{case.name}q = 1\n"))
    assert (error.key, error.reason.split(";")[0]) == (f"{case.where}{case.name}q", "unknown key")
    assert case.name in (error.hint, *error.reason.replace(",", "").split())
