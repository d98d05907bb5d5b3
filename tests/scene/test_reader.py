"""Scene files: what is read, and one line for everything that is wrong. No Taichi."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.scene import Scene, SceneError, key_table, load_scene, parse_override, scene_names, scene_to_toml
from taichi_cloth.scene.live import check_live, live_keys
from taichi_cloth.scene.model import SOLVER_NAMES, Box, Cloth, Ground, Key, Solver, Sphere, Vec3, Wind
from taichi_cloth.scene.reader import section_of
from taichi_cloth.solvers import SOLVERS


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "mine.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path: Path | str, **overrides: Any) -> SceneError:
    with pytest.raises(SceneError) as caught:
        load_scene(path, **overrides)
    assert "\n" not in str(caught.value)
    assert str(caught.value).isprintable()
    return caught.value


@pytest.mark.parametrize("name", ["curtain", "drape15", "table"])
def test_the_seed_scenes_are_shipped(name: str) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.title
    assert name in scene_names()


def test_the_curtain_is_the_demo() -> None:
    scene = load_scene("curtain")
    assert (scene.cloth.rows, scene.cloth.columns, scene.cloth.pins) == (24, 30, ("top",))
    assert (scene.solver.name, scene.solver.substeps, scene.solver.iterations) == ("verlet", 5, 12)
    assert scene.spheres[0].margin == 0.15
    assert scene.spheres[0].sway != (0, 0, 0)
    assert scene.wind is not None
    assert scene.wind.turbulence > 0


def test_drape15_has_225_particles_and_five_iterations_a_frame() -> None:
    scene = load_scene("drape15")
    assert scene.cloth.rows * scene.cloth.columns == 225
    assert scene.solver.substeps * scene.solver.iterations == 5


def test_an_empty_file_is_all_defaults(tmp_path: Path) -> None:
    assert load_scene(write(tmp_path, "")) == Scene(name="mine")


def test_a_file_states_what_differs(tmp_path: Path) -> None:
    scene = load_scene(
        write(
            tmp_path,
            """
            seed = 7
            [cloth]
            width = 2          # a whole number will do
            pins = ["top-left", 5]
            [wind]
            [[spheres]]
            radius = 0.25
            [[spheres]]
            center = [0, 1, 2]
            """,
        )
    )
    assert scene.seed == 7
    assert scene.cloth == Cloth(width=2.0, pins=("top-left", 5))
    assert isinstance(scene.cloth.width, float)
    assert scene.wind == Wind()
    assert scene.spheres == (Sphere(radius=0.25), Sphere(center=(0.0, 1.0, 2.0)))
    assert scene.ground is None


@pytest.mark.parametrize(
    ("text", "key", "reason", "hint"),
    [
        ("[solver]\nsubstep = 5", "solver.substep", "unknown key", "substeps"),
        ("[solvr]\nsubsteps = 5", "solvr", "unknown key", "solver"),
        ("[solver]\nzzz = 5", "solver.zzz", "known here: name, substeps", ""),
        ("name = 'x'", "name", "unknown key", ""),
        ("[cloth]\nrows = 'many'", "cloth.rows", "a whole number is needed, not 'many'", ""),
        ("[cloth]\nrows = 2.5", "cloth.rows", "a whole number is needed, not 2.5", ""),
        ("[cloth]\nrows = true", "cloth.rows", "a whole number is needed, not True", ""),
        ("[cloth]\nwidth = true", "cloth.width", "a number is needed, not True", ""),
        ("[look]\npole = 1", "look.pole", "true or false is needed, not 1", ""),
        ("title = 3", "title", "a text in quotes is needed, not 3", ""),
        ("[cloth]\nrows = 1", "cloth.rows", "1 is out of range: 2 to 2048", ""),
        ("[cloth]\nwidth = -1.0", "cloth.width", "-1.0 is out of range: 0.001 to 1000 m", ""),
        ("[[spheres]]\nradius = 0", "spheres[0].radius", "0 is out of range: above 0 to 1000 m", ""),
        ("[cloth]\nwidth = nan", "cloth.width", "a finite number is needed, not nan", ""),
        ("[wind]\nx = inf", "wind.x", "a finite number is needed, not inf", ""),
        (f"seed = {10**400}", "seed", "a finite number is needed", ""),
        ("[cloth]\ncenter = [1, 2]", "cloth.center", "three numbers are needed", ""),
        ("[cloth]\ncenter = 3", "cloth.center", "three numbers are needed", ""),
        ("[cloth]\ncenter = [0, 'a', 1]", "cloth.center[1]", "a number is needed, not 'a'", ""),
        ("[cloth]\npins = 'top'", "cloth.pins", "a list is needed", ""),
        ("[cloth]\npins = ['tp']", "cloth.pins[0]", "'tp' is no pin", "top"),
        ("[cloth]\npins = [true]", "cloth.pins[0]", "True is no pin", ""),
        ("[cloth]\nrows = 3\ncolumns = 3\npins = [9]", "cloth.pins", "indices run from 0 to 8", ""),
        ("[solver]\nname = 'varlet'", "solver.name", "unknown solver 'varlet'", "verlet"),
        ("[look]\ncloth = 'red'", "look.cloth", "a colour is written #rrggbb", ""),
        ("[camera]\neye = [0, 2, 0]\ntarget = [0, 1, 0]", "camera.eye", "straight above", ""),
        ("[camera]\neye = [0, 1, 0]\ntarget = [0, 1, 0]", "camera.eye", "is the target", ""),
        ("cloth = 3", "cloth", "a table [cloth] is needed", ""),
        ("[spheres]\nradius = 1", "spheres", "write [[spheres]]", ""),
        ("spheres = [3]", "spheres[0]", "a table", ""),
        ("[[boxes]]\n" * 17, "boxes", "17 are too many: at most 16", ""),
        ("[cloth\nrows = 3", "", "is not valid TOML", ""),
        (b"\xff\xfe\x00", "", "is not UTF-8 text", ""),
        ("#" * 1_000_001, "", "is larger than 1000000 bytes", ""),
        ('"a\\nb\\u0007" = 1', r"a\nb\x07", "unknown key", ""),
        ("a = " + "[" * 5000, "", "", ""),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str | bytes, key: str, reason: str, hint: str) -> None:
    path = write(tmp_path, text)
    error = refusal(path)
    assert str(error).startswith(str(path))
    assert key in str(error)
    assert reason in str(error)
    assert error.hint == hint
    assert not hint or f"did you mean '{hint}'?" in str(error)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert "No such file" in str(refusal(tmp_path / "none.toml"))
    assert "is a folder" in str(refusal(tmp_path))


def test_a_name_that_is_no_scene() -> None:
    error = refusal("curtian")
    assert error.hint == "curtain"
    assert "drape15" in str(error)


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
known_names = sorted({key for _, key, *_ in key_table()} | {f.name for f in fields(Scene)})


@given(st.binary(max_size=200))
def test_no_bytes_make_a_traceback(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = write(tmp_path_factory.mktemp("fuzz"), content)
    try:
        load_scene(path)
    except SceneError as error:
        assert str(error).isprintable()


@given(st.dictionaries(st.sampled_from(known_names), json_like, min_size=1, max_size=3))
def test_no_override_makes_a_traceback(overrides: dict[str, Any]) -> None:
    try:
        load_scene("curtain", **overrides)
    except SceneError as error:
        assert str(error).isprintable()


# -- overrides ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ({"wind_z": 6}, lambda s: s.wind.z == 6.0),
        ({"cloth_rows": 12}, lambda s: s.cloth.rows == 12),
        ({"substeps": 9}, lambda s: s.solver.substeps == 9),
        ({"solver_substeps": 9}, lambda s: s.solver.substeps == 9),
        ({"solver": "verlet"}, lambda s: s.solver.name == "verlet"),
        ({"seed": 3}, lambda s: s.seed == 3),
        ({"sphere_radius": 0.3}, lambda s: s.spheres[0].radius == 0.3),
        ({"gravity": 1}, lambda s: s.forces.gravity == 1.0),
        ({"pins": ("left",)}, lambda s: s.cloth.pins == ("left",)),
        ({"look_check": "#000000"}, lambda s: s.look.check == "#000000"),
    ],
)
def test_overrides(override: dict[str, Any], expected: Any) -> None:
    changed = load_scene("curtain", **override)
    assert expected(changed)
    assert changed != load_scene("curtain") or override in ({"solver": "verlet"},)


def test_an_override_adds_the_section_it_needs() -> None:
    assert load_scene("table").wind is None
    assert load_scene("table", wind_x=3).wind == Wind(x=3.0)


def test_only_the_first_ball_is_changed(tmp_path: Path) -> None:
    path = write(tmp_path, "[[spheres]]\nradius = 1\n[[spheres]]\nradius = 2")
    assert [s.radius for s in load_scene(path, sphere_radius=0.5).spheres] == [0.5, 2.0]


@pytest.mark.parametrize(
    ("override", "reason", "hint"),
    [
        ({"wind_zz": 1}, "unknown key", "wind_z"),
        ({"center": (0, 0, 0)}, "", ""),
        ({"box_size": (1, 1, 1)}, "the scene has no boxes", ""),
        ({"rows": 1}, "out of range", ""),
        ({"x": "fast"}, "a number is needed", ""),
        ({"name": 3}, "a text in quotes", ""),
    ],
)
def test_a_bad_override_says_so(override: dict[str, Any], reason: str, hint: str) -> None:
    if override == {"center": (0, 0, 0)}:  # only the cloth has one beside spheres and boxes
        assert load_scene("curtain", **override).cloth.center == (0.0, 0.0, 0.0)
        return
    error = refusal("curtain", **override)
    assert "override" in str(error)
    assert reason in str(error)
    assert error.hint == hint


@pytest.mark.parametrize(
    ("text", "pair"),
    [
        ("wind_z=6", ("wind_z", 6)),
        ("pins=['left', 3]", ("pins", ["left", 3])),
        ("solver=verlet", ("solver", "verlet")),
        ("title = a = b", ("title", "a = b")),
    ],
)
def test_parse_override(text: str, pair: tuple[str, Any]) -> None:
    assert parse_override(text) == pair


@pytest.mark.parametrize("text", ["wind_z", "=3", ""])
def test_an_override_without_a_key_or_value_is_refused(text: str) -> None:
    with pytest.raises(SceneError, match="KEY=VALUE"):
        parse_override(text)


# -- writing back --------------------------------------------------------------------------------------------


def values_of(hint: Any, key: Key) -> st.SearchStrategy[Any]:
    low = -1e5 if key.low is None else key.low
    # Taichi sets the processor to flush subnormal numbers to zero.
    numbers = st.floats(low, key.high, exclude_min=key.above_low, allow_nan=False, allow_subnormal=False)
    if hint is float:
        return numbers
    if hint == Vec3:
        return st.tuples(numbers, numbers, numbers)
    if hint is int:
        return st.integers(int(low), int(key.high or 0))
    return st.booleans() if hint is bool else st.nothing()


def sections(section: type) -> st.SearchStrategy[Any]:
    hints = get_type_hints(section)
    chosen = {
        f.name: values_of(hints[f.name], f.metadata["key"])
        for f in fields(section)
        if hints[f.name] in (int, float, bool, Vec3)
    }
    return st.builds(section, **chosen)


@given(
    sections(Sphere),
    sections(Box),
    sections(Wind) | st.none(),
    sections(Ground) | st.none(),
    sections(Solver),
    st.text(max_size=20),
)
def test_a_scene_survives_being_written(
    tmp_path_factory: pytest.TempPathFactory,
    sphere: Sphere,
    box: Box,
    wind: Wind | None,
    ground: Ground | None,
    solver: Solver,
    title: str,
) -> None:
    scene = Scene(
        title=title.encode(errors="ignore").decode(),
        solver=solver,
        wind=wind,
        ground=ground,
        spheres=(sphere,),
        boxes=(box, box),
        cloth=Cloth(pins=("top", 3)),
        name="mine",
    )
    assert load_scene(write(tmp_path_factory.mktemp("back"), scene_to_toml(scene))) == scene


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_survive_being_written(tmp_path: Path, name: str) -> None:
    scene = load_scene(name)
    assert replace(load_scene(write(tmp_path, scene_to_toml(scene))), name=name) == scene


# -- tables --------------------------------------------------------------------------------------------------


def test_every_key_has_help_and_every_number_a_range() -> None:
    for section, key, default, _, range_text, help in key_table():
        assert help, (section, key)
        if default.replace(".", "").replace("-", "").isdecimal():
            assert range_text, (section, key)


def test_the_scene_reader_knows_exactly_the_solvers_there_are() -> None:
    assert set(SOLVER_NAMES) == set(SOLVERS)


def test_sections_are_found_in_annotations() -> None:
    assert section_of(Wind | None) == (Wind, False)
    assert section_of(tuple[Box, ...]) == (Box, True)
    assert section_of(int) == (None, False)


def test_live_keys_in_the_panels_order() -> None:
    full = ["gravity", "wind_x", "wind_z", "stiffness", "damping", "sphere_radius", "iterations", "substeps"]
    assert list(live_keys(load_scene("curtain"))) == full
    assert list(live_keys(load_scene("drape15"))) == [n for n in full if n != "sphere_radius"]
    keys = live_keys(load_scene("curtain", gravity=3))
    assert keys["gravity"].value == 3
    assert keys["iterations"].is_int
    assert not keys["gravity"].is_int
    for key in keys.values():
        assert key.low < key.high
        assert key.low <= key.value <= key.high


@pytest.mark.parametrize("value", [True, "3", None, float("nan"), 1e99, [1], 2.5])
def test_a_live_value_is_checked_like_a_files(value: Any) -> None:
    with pytest.raises(ValueError, match="iterations"):
        check_live(live_keys(load_scene("curtain"))["iterations"], value)
