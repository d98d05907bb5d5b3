"""Scene files: what is read, and one line for everything that is wrong. No Taichi."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from taichi_cloth.scene import Cloth, Scene, SceneError, Sphere, Wind, key_table, load_scene, scene_names
from taichi_cloth.scene.library import scene_path
from taichi_cloth.scene.model import SOLVER_NAMES
from taichi_cloth.solvers import SOLVERS

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


def test_an_empty_file_is_all_defaults(write: Write) -> None:
    assert load_scene(write("")) == Scene(name="mine")


def test_a_byte_order_mark_does_no_harm(write: Write) -> None:
    assert load_scene(write(b"\xef\xbb\xbfseed = 3\r\n")).seed == 3


def test_a_file_states_what_differs(write: Write) -> None:
    scene = load_scene(
        write(
            """
            seed = 7
            [cloth]
            width = 2          # a whole number will do
            pins = ["top-left", 5, 5]
            [wind]
            [[spheres]]
            radius = 0.25
            [[spheres]]
            center = [0, 1, 2]
            """
        )
    )
    assert scene.seed == 7
    assert scene.cloth == Cloth(width=2.0, pins=("top-left", 5, 5))
    assert isinstance(scene.cloth.width, float)
    assert scene.wind == Wind()
    assert scene.spheres == (Sphere(radius=0.25), Sphere(center=(0.0, 1.0, 2.0)))
    assert scene.ground is None


@pytest.mark.parametrize(
    "text", ["[cloth]\nrows = 2", "[cloth]\nrows = 2048", "[solver]\nstiffness = 0", "seed = 2147483647"]
)
def test_the_ends_of_a_range_belong_to_it(write: Write, text: str) -> None:
    assert load_scene(write(text)) != Scene(name="mine")


def test_the_whole_line(write: Write, refuse: Refuse) -> None:
    path = write("[solver]\nsubstep = 5")
    error = refuse(path)
    assert str(error) == f"{path}: solver.substep: unknown key (did you mean 'substeps'?)"
    assert (error.file, error.key, error.reason, error.hint) == (str(path), "solver.substep", "unknown key", "substeps")


@pytest.mark.parametrize(
    ("text", "key", "reason", "hint"),
    [
        ("[solver]\nsubstep = 5", "solver.substep", "unknown key", "substeps"),
        ("[solvr]\nsubsteps = 5", "solvr", "unknown key", "solver"),
        ("[solver]\nzzz = 5", "solver.zzz", "known here: name, substeps", ""),
        ("name = 'x'", "name", "unknown key", ""),
        ("[cloth]\nrows = 'many'", "cloth.rows", "a whole number is needed, not 'many'", ""),
        ("[cloth]\nrows = 2.5", "cloth.rows", "a whole number is needed, not 2.5", ""),
        ("[cloth]\nrows = true", "cloth.rows", "a whole number is needed, not true", ""),
        ("[cloth]\nwidth = true", "cloth.width", "a number is needed, not true", ""),
        ("seed = 1979-05-27", "seed", "a whole number is needed, not 1979-05-27", ""),
        ("[look]\npole = 1", "look.pole", "true or false is needed, not 1", ""),
        ("title = 3", "title", "a text in quotes is needed, not 3", ""),
        ("[cloth]\nrows = 1", "cloth.rows", "1 is out of range: 2 to 2048", ""),
        ("[cloth]\nwidth = -1.0", "cloth.width", "-1.0 is out of range: 0.001 to 1000 m", ""),
        ("[[spheres]]\nradius = 0", "spheres[0].radius", "0 is out of range: above 0 to 1000 m", ""),
        ("[cloth]\nwidth = nan", "cloth.width", "a finite number is needed, not nan", ""),
        ("[wind]\nx = inf", "wind.x", "a finite number is needed, not inf", ""),
        (f"seed = {10**400}", "seed", "is out of range: 0 to 2147483647", ""),
        (f"seed = {'9' * 5000}", "", "is not valid TOML", ""),
        (f"seed = 0x{'f' * 5000}", "seed", "out of range", ""),
        (f"title = 0x{'f' * 5000}", "title", "a text in quotes is needed", ""),
        ("[cloth]\ncenter = [1, 2]", "cloth.center", "three numbers are needed", ""),
        ("[cloth]\ncenter = 3", "cloth.center", "three numbers are needed", ""),
        ("[cloth]\ncenter = [0, 'a', 1]", "cloth.center[1]", "a number is needed, not 'a'", ""),
        ("[cloth]\npins = 'top'", "cloth.pins", "a list is needed", ""),
        ("[cloth]\npins = ['tp']", "cloth.pins[0]", "'tp' is no pin", "top"),
        ("[cloth]\npins = [true]", "cloth.pins[0]", "true is no pin", ""),
        (
            "[cloth]\nrows = 3\ncolumns = 3\npins = [9]",
            "cloth.pins[0]",
            "9 is no particle: indices run from 0 to 8",
            "",
        ),
        ("[cloth]\npins = [-1]", "cloth.pins[0]", "-1 is no particle", ""),
        ("[solver]\nname = 'varlet'", "solver.name", "'varlet' is not one of: verlet", "verlet"),
        ("[[boxes]]\npath = 3", "boxes[0].path", "rows are needed", ""),
        ("[[boxes]]\npath = [[0, 1]]", "boxes[0].path[0]", "seconds, x, y, z and perhaps three angles", ""),
        ("[[boxes]]\npath = [[0, 1, 'a', 1]]", "boxes[0].path[0][2]", "a number is needed, not 'a'", ""),
        (
            "[[planes]]\npath = [[1, 0, 0, 0], [1, 2, 0, 0]]",
            "planes[0].path[1]",
            "1 s, is not after the one before",
            "",
        ),
        ("[look]\ncloth = 'red'", "look.cloth", "a colour is written #rrggbb", ""),
        ("[look]\ncheck = '#12345g'", "look.check", "a colour is written #rrggbb", ""),
        ("title = 'a\\u0007b'".replace("'", '"'), "title", "one line of plain text", ""),
        ("[camera]\neye = [0, 2, 0]\ntarget = [0, 1, 0]", "camera.eye", "straight above", ""),
        ("[camera]\neye = [1e-9, -2, 0]\ntarget = [0, 1, 0]", "camera.eye", "or below", ""),
        ("[camera]\neye = [0, 1, 0]\ntarget = [0, 1, 0]", "camera.eye", "is the target", ""),
        ("cloth = 3", "cloth", "a table of keys is needed, not 3", ""),
        ("[spheres]\nradius = 1", "spheres", "write [[spheres]]", ""),
        ("[[wind]]", "wind", "a table of keys is needed, not [{}]", ""),
        ("spheres = [3]", "spheres[0]", "a table of keys is needed, not 3", ""),
        ("[boxes]", "boxes", "write [[boxes]]", ""),
        ("[[boxes]]\nsize = [1, 0, 1]", "boxes[0].size[1]", "0 is out of range: 0.001 to 1000 m", ""),
        ("[[boxes]]\n" * 17, "boxes", "17 are too many: at most 16", ""),
        ("[cloth\nrows = 3", "", "(at line 1, column 7)", ""),
        (b"\xff\xfe\x00", "", "is not UTF-8 text", ""),
        ("#" * 1_000_001, "", "is larger than 1000000 bytes", ""),
        ('"a\\nb\\u0007" = 1', r"a\nb\x07", "unknown key", ""),
        ("k" * 900 + " = 1", "k" * 99 + "…", "unknown key", ""),
        ("a = " + "[" * 5000, "", "nested too deeply", ""),
        ("title" + ".a" * 90 + " = 1", "title", "a text in quotes is needed", ""),
        ("title" + ".a" * 400_000 + " = 1", "", "more than 100 dots in one key", ""),
        ("[" + "a." * 400_000 + "a]", "", "more than 100 dots in one key", ""),
        ("title = {" + "a . " * 200_000 + "a = 1}", "", "more than 100 dots in one key", ""),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    write: Write, refuse: Refuse, text: str | bytes, key: str, reason: str, hint: str
) -> None:
    path = write(text)
    error = refuse(path)
    assert str(error).startswith(f"{path}: {key}")
    assert reason in str(error)
    assert error.hint == hint
    assert not hint or str(error).endswith(f" (did you mean '{hint}'?)")
    assert len(str(error)) < len(str(path)) + 600


def test_a_file_that_cannot_be_read(tmp_path: Path, refuse: Refuse) -> None:
    assert str(refuse(tmp_path / "none.toml")) == f"{tmp_path}/none.toml: cannot be read: No such file or directory"
    assert str(refuse(tmp_path)) == f"{tmp_path}: is a folder, not a scene file"
    assert "cannot be read" in str(refuse(tmp_path / "zero\0byte.toml"))


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs /dev/zero")
def test_a_file_without_end_is_not_read_to_its_end(refuse: Refuse) -> None:
    assert "is larger than 1000000 bytes" in str(refuse("/dev/zero"))


def test_a_file_name_with_a_line_end_stays_in_the_line(tmp_path: Path, refuse: Refuse) -> None:
    assert "two\\nlines.toml: cannot be read" in str(refuse(tmp_path / "two\nlines.toml"))


def test_the_scene_reader_knows_exactly_the_solvers_there_are() -> None:
    assert set(SOLVER_NAMES) == set(SOLVERS)


# -- nothing makes a traceback -----------------------------------------------------------------------------

values = st.recursive(
    st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.sampled_from(["top", "verlet", "#b5303c"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=2),
    max_leaves=6,
)
keys = st.sampled_from(sorted({key for _, key, *_ in key_table()})) | st.text(max_size=5)
tables = st.sampled_from(sorted({title for title, *_ in key_table()}))


def toml(value: Any) -> str:
    """Any nest of lists and dictionaries in TOML's inline form."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")


def read_or_refuse(path: Path) -> None:
    try:
        load_scene(path)
    except SceneError as error:
        assert str(error).isprintable()


@given(st.binary(max_size=200))
def test_no_bytes_make_a_traceback(write: Write, content: bytes) -> None:
    read_or_refuse(write(content))


@given(st.text(st.characters(codec="utf-8") | st.sampled_from('[]={}".,#\n'), max_size=60))
def test_no_text_makes_a_traceback(write: Write, content: str) -> None:
    read_or_refuse(write(content))


shipped = {name: scene_path(name).read_bytes() for name in scene_names()}


@given(st.sampled_from(sorted(shipped)), st.integers(0, 2000), st.integers(0, 2000), st.binary(max_size=6))
def test_no_damage_to_a_shipped_scene_makes_a_traceback(
    write: Write, name: str, start: int, length: int, by: bytes
) -> None:
    content = shipped[name]
    read_or_refuse(write(content[:start] + by + content[start + length :]))
    read_or_refuse(write(content[:start] + by + content[start:]))


def test_rows_of_numbers_and_rulers_of_dots_are_no_keys(write: Write) -> None:
    rows = ", ".join(f"[{k}.5, 0.0, 1.0, 0.0]" for k in range(300))
    text = f'# {"." * 300}\ntitle = "{"." * 300}"\n[[boxes]]\npath = [{rows}]  # {". " * 90}\n'
    assert len(load_scene(write(text)).boxes[0].path) == 300


@given(st.dictionaries(tables, st.dictionaries(keys, values, max_size=3), max_size=3))
@example({"": {"title": "\ud800"}})
def test_no_dictionary_makes_a_traceback(write: Write, data: dict[str, dict[str, Any]]) -> None:
    lines = [
        line
        for title in sorted(data)
        for line in (title, *(f"{json.dumps(k)} = {toml(v)}" for k, v in data[title].items()))
    ]
    read_or_refuse(write("\n".join(lines)))
