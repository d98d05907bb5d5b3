"""Scene files: valid ones, and the one-line errors of invalid ones. No Taichi."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import Cloth, Scene, SceneError, Sphere, Wind, key_table, scene_names
from taichi_cloth.scene.presets import scene_path
from taichi_cloth.scene.schema import SOLVER_NAMES
from taichi_cloth.solvers import SOLVERS

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


def test_an_empty_file_gives_all_defaults(write: Write) -> None:
    assert load_scene(write("")) == Scene(name="mine")


def test_a_byte_order_mark_is_ignored(write: Write) -> None:
    assert load_scene(write(b"\xef\xbb\xbfseed = 3\r\n")).seed == 3


def test_keys_that_are_not_set_have_defaults(write: Write) -> None:
    scene = load_scene(
        write(
            """
            seed = 7
            [cloth]
            width = 2          # an integer is allowed
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
def test_the_ends_of_a_range_are_allowed(write: Write, text: str) -> None:
    assert load_scene(write(text)) != Scene(name="mine")


def test_an_error_names_file_key_reason_and_hint(write: Write, refuse: Refuse) -> None:
    path = write("[solver]\nsubstep = 5")
    error = refuse(path)
    assert str(error) == f"{path}: solver.substep: unknown key (did you mean 'substeps'?)"
    assert (error.file, error.key, error.reason, error.hint) == (str(path), "solver.substep", "unknown key", "substeps")


@pytest.mark.parametrize(
    ("text", "key", "reason", "hint"),
    [
        ("[solver]\nsubstep = 5", "solver.substep", "unknown key", "substeps"),
        ("[solvr]\nsubsteps = 5", "solvr", "unknown key", "solver"),
        ("[solver]\nzzz = 5", "solver.zzz", "allowed: name, substeps", ""),
        ("name = 'x'", "name", "unknown key", ""),
        ("[fabric]\nstructural = 0.4", "fabric.structural", "unknown key", "verlet.structural"),
        ("[wind]\nspeed = 6", "wind.speed", "unknown key; allowed: x, z, turbulence", ""),
        ("[[spheres]]\nposition = [0, 1, 0]", "spheres[0].position", "unknown key", "center"),
        ("[[spheres]]\nmass = 3", "spheres[0].mass", "unknown key; allowed: margin", ""),
        ("width = 2.6", "width", "unknown key", "cloth.width"),
        ("pins = ['top']", "pins", "unknown key", "cloth.pins"),
        ("[cloth]\nsheets = 2", "cloth.sheets", "was renamed to layers", ""),
        ("[[spheres]]\nsway = [1, 0, 0]", "spheres[0].sway", "was renamed to oscillation", ""),
        ("[springs]\nbend = 1", "springs", "was renamed to verlet", ""),
        ("[solver]\nname = 'spring'", "solver.name", "spring was renamed to explicit", ""),
        ("[cloth]\nrows = 'many'", "cloth.rows", "must be an integer, got 'many'", ""),
        ("[cloth]\nrows = 2.5", "cloth.rows", "must be an integer, got 2.5", ""),
        ("[cloth]\nrows = true", "cloth.rows", "must be an integer, got true", ""),
        ("[cloth]\nwidth = true", "cloth.width", "must be a number, got true", ""),
        ("seed = 1979-05-27", "seed", "must be an integer, got 1979-05-27", ""),
        ("[look]\npole = 1", "look.pole", "must be true or false, got 1", ""),
        ("title = 3", "title", "must be a string, got 3", ""),
        ("[cloth]\nrows = 1", "cloth.rows", "1 is out of range: 2 to 2048", ""),
        ("[cloth]\nwidth = -1.0", "cloth.width", "-1.0 is out of range: 0.001 to 1000 m", ""),
        ("[[spheres]]\nradius = 0", "spheres[0].radius", "0 is out of range: above 0 to 1000 m", ""),
        ("[cloth]\nwidth = nan", "cloth.width", "must be a finite number, got nan", ""),
        ("[wind]\nx = inf", "wind.x", "must be a finite number, got inf", ""),
        (f"seed = {10**400}", "seed", "is out of range: 0 to 2147483647", ""),
        (f"seed = {'9' * 5000}", "", "is not valid TOML", ""),
        ("[cloth]\npins = top\n", "", '(at line 2, column 8); text needs quotes: "top"', ""),
        ("[cloth]\npins = [top]\n", "", "is not valid TOML: Invalid value (at line 2, column 9)", ""),
        ("[cloth]\nwidth = 2,6  # wide\n", "", "; write 2.6", ""),
        ("[cloth]\nwidth = 2.5 m\n", "", "; write 2.5, without a unit", ""),
        ("[tethers]\nenabled = True", "", "; write true", ""),
        ("[cloth]\nrows = 5\nrows = 6\n", "", "is not valid TOML: rows is set twice (line 3)", ""),
        ("[cloth]\nrows = 5\n[cloth]\n", "", "is not valid TOML: [cloth] is set twice (line 3)", ""),
        (f"seed = 0x{'f' * 5000}", "seed", "out of range", ""),
        (f"title = 0x{'f' * 5000}", "title", "must be a string", ""),
        ("[cloth]\ncenter = [1, 2]", "cloth.center", "must be three numbers", ""),
        ("[cloth]\ncenter = 3", "cloth.center", "must be three numbers", ""),
        ("[cloth]\ncenter = [0, 'a', 1]", "cloth.center[1]", "must be a number, got 'a'", ""),
        ("[cloth]\npins = 3.5", "cloth.pins", "must be a list", ""),
        ("[cloth]\npins = ['tp']", "cloth.pins[0]", "'tp' is not a pin", "top"),
        (
            "[cloth]\npins = ['top-left,top-right']",
            "cloth.pins[0]",
            '\'top-left,top-right\' is not a pin; write a list, as in ["top-left", "top-right"]',
            "",
        ),
        ("[cloth]\npins = ['left-top']", "cloth.pins[0]", "'left-top' is not a pin", "top-left"),
        ("[cloth]\npins = [true]", "cloth.pins[0]", "true is not a pin", ""),
        (
            "[cloth]\nrows = 3\ncolumns = 3\npins = [9]",
            "cloth.pins[0]",
            "9 is not a particle: indices run from 0 to 8",
            "",
        ),
        ("[cloth]\npins = [-1]", "cloth.pins[0]", "-1 is not a particle", ""),
        ("[solver]\nname = 'varlet'", "solver.name", "'varlet' is not one of: verlet", "verlet"),
        ("[[boxes]]\nkeyframes = 3", "boxes[0].keyframes", "must be rows", ""),
        (
            "[[boxes]]\nkeyframes = [[0, 1]]",
            "boxes[0].keyframes[0]",
            "must be seconds, x, y, z and optionally three angles",
            "",
        ),
        ("[[boxes]]\nkeyframes = [[0, 1, 'a', 1]]", "boxes[0].keyframes[0][2]", "must be a number, got 'a'", ""),
        (
            "[[planes]]\nkeyframes = [[1, 0, 0, 0], [1, 2, 0, 0]]",
            "planes[0].keyframes[1]",
            "times must increase, got 1 s after 1 s",
            "",
        ),
        ("[look]\ncolor = 'red'", "look.color", "must be a color #rrggbb", ""),
        ("[look]\nsecond_color = '#12345g'", "look.second_color", "must be a color #rrggbb", ""),
        ("title = 'a\\u0007b'".replace("'", '"'), "title", "one line of plain text", ""),
        ("[camera]\neye = [0, 2, 0]\ntarget = [0, 1, 0]", "camera.eye", "straight above", ""),
        ("[camera]\neye = [1e-9, -2, 0]\ntarget = [0, 1, 0]", "camera.eye", "or below", ""),
        ("[camera]\neye = [0, 1, 0]\ntarget = [0, 1, 0]", "camera.eye", "must differ from camera.target", ""),
        ("cloth = 3", "cloth", "must be a table, got 3", ""),
        ("[spheres]\nradius = 1", "spheres", "write [[spheres]]", ""),
        ("[[wind]]", "wind", "write [wind] with single brackets", ""),
        ("spheres = [3]", "spheres[0]", "must be a table, got 3", ""),
        ("[boxes]", "boxes", "write [[boxes]]", ""),
        ("[[boxes]]\nsize = [1, 0, 1]", "boxes[0].size[1]", "0 is out of range: 0.001 to 1000 m", ""),
        ("[[boxes]]\n" * 17, "boxes", "has 17 tables, at most 16 are allowed", ""),
        ("[cloth\nrows = 3", "", "(at line 1, column 7)", ""),
        (b"\xff\xfe\x00", "", "is not UTF-8 text", ""),
        ("#" * 3_000_001, "", "is larger than 3000000 bytes", ""),
        ('"a\\nb\\u0007" = 1', r"a\nb\x07", "unknown key", ""),
        ("k" * 900 + " = 1", "k" * 99 + "…", "unknown key", ""),
        ("a = " + "[" * 5000, "", "nested too deeply", ""),
        ("title" + ".a" * 90 + " = 1", "title", "must be a string", ""),
        ("title" + ".a" * 400_000 + " = 1", "", "more than 100 dots in one key", ""),
        ("[" + "a." * 400_000 + "a]", "", "more than 100 dots in one key", ""),
        ("title = {" + "a . " * 200_000 + "a = 1}", "", "more than 100 dots in one key", ""),
    ],
)
def test_an_invalid_file_is_refused_in_one_line(
    write: Write, refuse: Refuse, text: str | bytes, key: str, reason: str, hint: str
) -> None:
    path = write(text)
    error = refuse(path)
    assert str(error).startswith(f"{path}: {key}")
    assert reason in str(error)
    assert error.hint == hint
    assert not hint or str(error).endswith(f" (did you mean '{hint}'?)")
    assert len(str(error)) < len(str(path)) + 600


def test_an_unreadable_file_is_refused(tmp_path: Path, refuse: Refuse) -> None:
    assert str(refuse(tmp_path / "none.toml")) == f"{tmp_path}/none.toml: cannot be read: No such file or directory"
    assert str(refuse(tmp_path)) == f"{tmp_path}: is a folder, not a scene file"
    assert "cannot be read" in str(refuse(tmp_path / "zero\0byte.toml"))


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs /dev/zero")
def test_an_endless_file_is_refused(refuse: Refuse) -> None:
    assert "is larger than 3000000 bytes" in str(refuse("/dev/zero"))


def test_a_line_end_in_a_file_name_is_escaped(tmp_path: Path, refuse: Refuse) -> None:
    assert "two\\nlines.toml: cannot be read" in str(refuse(tmp_path / "two\nlines.toml"))


def test_the_schema_lists_exactly_the_existing_solvers() -> None:
    assert set(SOLVER_NAMES) == set(SOLVERS)


# -- every invalid file is a SceneError -----------------------------------------------------------------------------

values = st.recursive(
    st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.sampled_from(["top", "verlet", "#b5303c"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=2),
    max_leaves=6,
)
keys = st.sampled_from(sorted({key for _, key, *_ in key_table()})) | st.text(max_size=5)
tables = st.sampled_from(sorted({title for title, *_ in key_table()}))


def toml(value: Any) -> str:
    """Return nested lists and dictionaries in inline TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")


def load_or_scene_error(path: Path) -> None:
    try:
        load_scene(path)
    except SceneError as error:
        assert str(error).isprintable()


@given(st.binary(max_size=200))
def test_random_bytes_load_or_raise_a_scene_error(write: Write, content: bytes) -> None:
    load_or_scene_error(write(content))


@given(st.text(st.characters(codec="utf-8") | st.sampled_from('[]={}".,#\n'), max_size=60))
def test_random_text_loads_or_raises_a_scene_error(write: Write, content: str) -> None:
    load_or_scene_error(write(content))


shipped = {name: scene_path(name).read_bytes() for name in scene_names()}


@given(st.sampled_from(sorted(shipped)), st.integers(0, 2000), st.integers(0, 2000), st.binary(max_size=6))
def test_a_damaged_shipped_scene_loads_or_raises_a_scene_error(
    write: Write, name: str, start: int, length: int, by: bytes
) -> None:
    content = shipped[name]
    load_or_scene_error(write(content[:start] + by + content[start + length :]))
    load_or_scene_error(write(content[:start] + by + content[start:]))


def test_dots_outside_keys_are_not_counted(write: Write) -> None:
    rows = ", ".join(f"[{k}.5, 0.0, 1.0, 0.0]" for k in range(300))
    text = f'# {"." * 300}\ntitle = "{"." * 300}"\n[[boxes]]\nkeyframes = [{rows}]  # {". " * 90}\n'
    assert len(load_scene(write(text)).boxes[0].keyframes) == 300


@given(st.dictionaries(tables, st.dictionaries(keys, values, max_size=3), max_size=3))
@example({"": {"title": "\ud800"}})
def test_a_random_dictionary_loads_or_raises_a_scene_error(write: Write, data: dict[str, dict[str, Any]]) -> None:
    lines = [
        line
        for title in sorted(data)
        for line in (title, *(f"{json.dumps(k)} = {toml(v)}" for k, v in data[title].items()))
    ]
    load_or_scene_error(write("\n".join(lines)))
