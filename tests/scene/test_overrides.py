"""Overrides of scene keys from Python and from the command line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.scene_loader import check_scene, load_scene
from taichi_cloth.scene import Cloth, Scene, SceneError, Solver, Sphere, Wind, key_table, parse_override
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.overrides import override_targets, targets_of
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG, SolverInfo

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]


@pytest.mark.parametrize(
    ("override", "read", "value"),
    [
        ({"wind_z": 6}, lambda s: s.wind.z, 6.0),
        ({"cloth_rows": 12}, lambda s: s.cloth.rows, 12),
        ({"substeps": 9}, lambda s: s.solver.substeps, 9),
        ({"solver_substeps": 9}, lambda s: s.solver.substeps, 9),
        ({"seed": 3}, lambda s: s.seed, 3),
        ({"title": "mine"}, lambda s: s.title, "mine"),
        ({"sphere_radius": 0.3}, lambda s: s.spheres[0].radius, 0.3),
        ({"radius": 0.3}, lambda s: s.spheres[0].radius, 0.3),
        ({"sphere_center": (0, 1, 2)}, lambda s: s.spheres[0].center, (0.0, 1.0, 2.0)),
        ({"gravity": 1}, lambda s: s.forces.gravity, 1.0),
        ({"pins": ("left",)}, lambda s: s.cloth.pins, ("left",)),
        ({"look_second_color": "#000000"}, lambda s: s.look.second_color, "#000000"),
        ({"color": "#000000"}, lambda s: s.look.color, "#000000"),  # the only key of that name
        ({"wind.z": 6}, lambda s: s.wind.z, 6.0),
        ({"cloth.rows": 12}, lambda s: s.cloth.rows, 12),
        ({"sphere.radius": 0.3}, lambda s: s.spheres[0].radius, 0.3),
        ({"spheres.radius": 0.3}, lambda s: s.spheres[0].radius, 0.3),
        ({"spheres[0].radius": 0.3}, lambda s: s.spheres[0].radius, 0.3),
        ({"self_collision.thickness": 0.3}, lambda s: s.self_collision and s.self_collision.thickness, 0.3),
        ({"pins": "left"}, lambda s: s.cloth.pins, ("left",)),
        ({"cloth.pins": 17}, lambda s: s.cloth.pins, (17,)),
    ],
)
def test_an_override_changes_the_key_it_names(override: dict[str, Any], read: Any, value: Any) -> None:
    assert read(load_scene("curtain")) != value
    assert read(load_scene("curtain", **override)) == value


def test_an_object_sets_the_keys_that_were_given_as_a_dict_does() -> None:
    for name, given_object, table in (
        ("solver", Solver(name="xpbd"), {"name": "xpbd"}),
        ("solver", Solver("xpbd", 7), {"name": "xpbd", "substeps": 7}),
        ("fabric", Fabric(preset="silk"), {"preset": "silk"}),
        ("cloth", Cloth(file="round", pins=()), {"file": "round", "pins": []}),
        ("cloth", load_scene(Scene(cloth=Cloth(file="round"))).cloth, {"file": "round"}),  # with all keys
    ):
        by_object, by_table = (load_scene("sphere", **{name: section}) for section in (given_object, table))
        assert getattr(by_object, name) == getattr(by_table, name)
        assert by_object.cloth.area_density == by_table.cloth.area_density


def test_a_scene_is_loaded_with_overrides() -> None:
    scene = load_scene("hammock")
    assert load_scene(scene) == scene
    changed = load_scene(scene, fabric="silk", solver="xpbd", gravity=1.0)
    assert changed == load_scene("hammock", fabric="silk", solver="xpbd", gravity=1.0)
    own = Scene(cloth=Cloth(rows=7), name="own")
    assert load_scene(own, rows=5) == replace(own, cloth=replace(own.cloth, rows=5))


def test_a_single_table_of_an_array_is_refused() -> None:
    for table in ({"radius": 0.3}, Sphere(radius=0.3), None, 3):
        with pytest.raises(SceneError, match=r"sphere: is one of an array \(did you mean 'spheres=\[...\]'\?\)"):
            load_scene("curtain", sphere=table)


def test_a_name_in_place_of_a_table_is_refused_with_an_example() -> None:
    with pytest.raises(
        SceneError, match=r"solver: must be a table, as in \{name = 'xpbd'\}, in Python \{'name': 'xpbd'\}, got 'xpbd'"
    ):
        Scene(solver="xpbd")  # type: ignore[arg-type]
    with pytest.raises(
        SceneError,
        match=r"fabric: must be a table, as in \{preset = 'silk'\}, in Python \{'preset': 'silk'\}, got 'silk'",
    ):
        load_scene({"fabric": "silk"})


def test_a_path_is_accepted_as_text() -> None:
    assert load_scene({"cloth": {"file": Path("round")}}).cloth.file == "round"


def test_a_sheet_from_a_file_has_the_pins_that_were_given() -> None:
    assert Cloth(file="round").pins == ()
    assert Cloth(file="round", pins=("top",)).pins == ("top",)  # refused where it is used
    assert Cloth().pins == ("top",)
    with pytest.raises(SceneError, match="'top' needs a sheet"):
        check_scene(Scene(cloth=Cloth(file="round", pins=("top",))))
    with pytest.raises(SceneError, match=r"allowed: rows, .*, layer_rotation$"):  # without `folder`, which is derived
        Cloth(size=1)  # type: ignore[call-arg]


@pytest.mark.parametrize(("name", "info"), SOLVER_CATALOG.items())
def test_a_solver_made_in_python_has_its_defaults(name: str, info: SolverInfo) -> None:
    solver = Solver(name=name)
    assert (solver.substeps, solver.iterations) == info.defaults
    assert Solver(name, 3).substeps == 3
    assert Scene(solver={"name": name}).solver == solver  # type: ignore[arg-type]


def test_another_solver_uses_its_default_substeps_and_iterations() -> None:
    def numbers(**overrides: object) -> tuple[int, int]:
        solver = load_scene("drape15", **overrides).solver
        return solver.substeps, solver.iterations

    assert numbers() == numbers(solver="verlet") == (1, 5)  # as set in the file
    for name, info in SOLVER_CATALOG.items():
        assert numbers(solver=name) == ((1, 5) if name == "verlet" else info.defaults)
    assert numbers(substeps=7, solver="lines") == (7, 2)
    assert numbers(solver="xpbd", iterations=3) == (60, 3)


@pytest.mark.parametrize("key", ["solver", "solver_name", "name"])
def test_a_section_name_sets_its_name_key(refuse: Refuse, key: str) -> None:
    assert load_scene("drape15", **{key: "verlet"}) == load_scene("drape15")
    assert refuse("drape15", **{key: "varlet"}).key == "solver.name"


def test_an_override_adds_a_missing_section() -> None:
    assert load_scene("table").wind is None
    assert load_scene("table", wind_x=3).wind == Wind(x=3.0)


def test_an_override_changes_the_first_sphere_or_the_one_with_its_index(write: Write) -> None:
    path = write("[[spheres]]\nradius = 1\n[[spheres]]\nradius = 2")
    assert [s.radius for s in load_scene(path, sphere_radius=0.5).spheres] == [0.5, 2.0]
    assert [s.radius for s in load_scene(path, **{"spheres.radius": 0.5}).spheres] == [0.5, 2.0]
    assert [s.radius for s in load_scene(path, **{"spheres[1].radius": 0.5}).spheres] == [1.0, 0.5]


def test_an_override_changes_the_collider_of_that_name(write: Write) -> None:
    path = write('[[spheres]]\nradius = 1\n[[spheres]]\nname = "ball"\nradius = 2')
    for key in ("ball_radius", "ball.radius"):
        assert [s.radius for s in load_scene(path, **{key: 0.5}).spheres] == [1.0, 0.5]
    with pytest.raises(SceneError, match="ball_size: unknown key"):
        load_scene(path, ball_size=0.5)


def test_a_key_of_a_section_that_the_file_does_not_have_is_that_of_every_scene(write: Write) -> None:
    path = write("[cloth]\nrows = 8")
    assert load_scene(path, iterations=3) == load_scene(path, solver_iterations=3)  # strain_limit has iterations too
    assert load_scene(path, stiffness=0.5) == load_scene(path, solver_stiffness=0.5)


def test_names_with_dots_and_with_underscores_mean_the_same() -> None:
    for key in ("solver.name", "solver_name", "solver"):
        assert load_scene("drape15", **{key: "lines"}) == load_scene("drape15", solver="lines")
    for key in ("fabric.preset", "fabric_preset", "fabric"):
        assert load_scene("curtain", **{key: "denim"}) == load_scene("curtain", fabric="denim")
    assert load_scene("curtain", **{"wind.z": 1, "wind_z": 2}).wind.z == 2  # the last counts


@pytest.mark.parametrize(("title", "key"), [row[:2] for row in key_table()])
def test_every_key_can_be_named_as_files_write_it(title: str, key: str) -> None:
    section = title.strip("[]")
    [(part, found)] = targets_of(f"{section}.{key}" if section else key)
    assert ((part.name if part else ""), found) == (section, key)


def test_an_override_replaces_a_section_as_a_whole() -> None:
    curtain, wind = load_scene("curtain"), {"z": np.float32(6.0)}
    assert curtain.wind is not None
    assert curtain.wind.x != 0
    for section in (wind, Wind(z=6.0)):
        assert load_scene("curtain", wind=section).wind == Wind(z=6.0)
        assert load_scene("curtain", wind_x=2, wind=section).wind == Wind(x=2.0, z=6.0)
    assert wind == {"z": 6.0}  # not changed
    assert load_scene("curtain", **dict([parse_override("wind={z=6}")])).wind == Wind(z=6.0)
    assert load_scene("curtain", cloth={"pins": 17}) == load_scene("curtain", cloth={"pins": [17]})
    assert load_scene("curtain", wind=None) == replace(curtain, wind=None)
    assert load_scene("curtain", spheres=None).spheres == ()
    spheres = load_scene("curtain", spheres=[{"radius": 0.1}, Sphere()], sphere_radius=0.2).spheres
    assert spheres == (Sphere(radius=0.2), Sphere())
    assert load_scene("drape15", solver={"name": "lines"}) == load_scene("drape15", solver="lines", damping=1.5)
    assert load_scene("curtain", fabric={"preset": "silk"}) == load_scene("curtain", fabric="silk")
    assert load_scene("curtain", fabric={"preset": "silk", "warp": 5}).fabric.warp == 5.0


TWO_BRACKETS = "write [[spheres]] with two brackets: it is an array of tables; in Python, pass a list"


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ({"wind": {"zz": 1}}, "wind.zz: unknown key (did you mean 'z'?)"),
        (
            {"wind": "off"},
            "wind: is a section: set one of its keys, such as wind.x, or give it a table; --without wind leaves it out",
        ),
        ({"wind": "strong"}, "wind: is a section: set one of its keys, such as wind.x, or give it a table"),
        ({"cloth": None}, "cloth: must be a table, got None"),
        ({"sphers": []}, "sphers: unknown key (did you mean 'spheres'?)"),
        ({"spheres": [3]}, "spheres[0]: must be a table, got 3"),
        ({"spheres": [3], "sphere_radius": 1}, "spheres[0]: must be a table, got 3"),
        ({"spheres": {}, "spheres.radius": 1}, "spheres: " + TWO_BRACKETS),
        ({"wind": [{}], "wind.z": 1}, "wind: write [wind] with single brackets: a scene has only one"),
        ({"verlet": None, "fabric": "silk"}, "verlet: must be a table, got None"),
        ({"wind_zz": 1}, "wind_zz: unknown key (did you mean 'wind_z'?)"),
        ({"qqqq": 1}, "qqqq: unknown key; `taichi-cloth schema` lists them"),
        ({"wind_speed": 1}, "wind_speed: unknown key; [wind] has x, z, turbulence, drag, lift, air_density"),
        ({"name_or_path": 1}, "name_or_path: unknown key; `taichi-cloth schema` lists them"),
        ({"a\nb": 1}, "a\\nb: unknown key; `taichi-cloth schema` lists them"),
        ({"center": (0, 0, 0)}, "center: ambiguous: use cloth_center or sphere_center"),
        ({"height": 1}, "height: ambiguous: use cloth_height or ground_height"),
        ({"name": "verlet"}, "name: ambiguous: use solver_name or sphere_name"),
        ({"box_size": (1, 1, 1)}, "box_size: the scene has no boxes"),
        ({"rows": 1}, "cloth.rows: 1 is out of range: 2 to 2048"),
        ({"x": "fast"}, "wind.x: must be a number, got 'fast'"),
        ({"seed": None}, "seed: must be an integer, got None"),
        ({"wind.q": 1}, "wind.q: unknown key (did you mean 'wind.z'?)"),
        ({"wnd.z": 1}, "wnd.z: unknown key (did you mean 'wind.z'?)"),
        ({"cloth.row": 1}, "cloth.row: unknown key (did you mean 'cloth.rows'?)"),
        ({"wind[0].z": 1}, "wind[0].z: [wind] is a single table: leave out [0]"),
        ({"spheres[1].radius": 1}, "spheres[1].radius: the scene has no spheres[1]"),
        ({"boxes[0].size": 1}, "boxes[0].size: the scene has no boxes"),
        ({"spheres[0].center[1]": 1}, "spheres[0].center[1]: unknown key (did you mean 'spheres.center'?)"),
        ({"cloth": 3}, "cloth: is a section: set one of its keys, such as cloth.rows, or give it a table"),
        ({"density": 3}, "density: unknown key (did you mean 'area_density'?)"),
        ({"cloth.mass": 3}, "cloth.mass: unknown key (did you mean 'cloth.area_density'?)"),
        ({"stiffness_bending": 3}, "stiffness_bending: unknown key (did you mean 'bending_stiffness'?)"),
        ({"a.b.c": 1}, "a.b.c: unknown key; `taichi-cloth schema` lists them"),
        ({"tear.strain": 1}, "tear.strain: was renamed to tearing.strain"),
        ({"spheres.sway": 1}, "spheres.sway: was renamed to spheres.oscillation"),
        ({"cloth.rows": 1}, "cloth.rows: 1 is out of range: 2 to 2048"),
        ({"sphere_sway": (0, 1, 1)}, "sphere_sway: was renamed to sphere_oscillation"),
        ({"sphere_oscillation": (0, 1, True)}, "spheres[0].oscillation[2]: must be a number, got true"),
        ({"cloth_rows": 2, "pins": [900]}, "cloth.pins[0]: 900 is not a particle: indices run from 0 to 59"),
        ({"title": "\udcff"}, "title: must be one line of plain text, got '\\udcff'"),
    ],
)
def test_an_invalid_override_is_named_as_one(refuse: Refuse, override: dict[str, Any], line: str) -> None:
    assert str(refuse("curtain", **override)) == f"curtain (override): {line}"


def test_an_invalid_file_is_not_reported_as_an_override(write: Write, refuse: Refuse) -> None:
    path = write("[cloth]\nrows = 1")
    assert refuse(path, rows=5).file == str(path)


def test_every_name_of_an_override_is_an_identifier() -> None:
    targets = override_targets()
    assert all(name.isidentifier() for name in targets)
    full = [name for name, keys in targets.items() if len(keys) == 1]
    assert {"wind_x", "x", "solver", "look_second_color", "second_color", "box_size", "size", "seed"} <= set(full)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from(sorted(override_targets())) | st.text(), anything, min_size=1, max_size=3))
def test_every_invalid_override_raises_a_scene_error(overrides: dict[str, Any]) -> None:
    try:
        assert isinstance(load_scene("curtain", **overrides), Scene)
    except SceneError as error:
        assert str(error).isprintable()


@pytest.mark.parametrize(
    ("text", "pair"),
    [
        ("wind_z=6", ("wind_z", 6)),
        ("wind_z = -0.5", ("wind_z", -0.5)),
        ("spheres[1].radius = 2", ("spheres[1].radius", 2)),
        ("pins=['left', 3]", ("pins", ["left", 3])),
        ("pole=true", ("pole", True)),
        ("solver=verlet", ("solver", "verlet")),
        ("look_second_color=#000000", ("look_second_color", "#000000")),
        ("title = a = b", ("title", "a = b")),
        ("title=", ("title", "")),
        ("seed=1\nrows=2", ("seed", "1\nrows=2")),
        ("seed=" + "9" * 5000, ("seed", "9" * 5000)),
        ("seed=" + "[" * 5000, ("seed", "[" * 5000)),
        ("seed={a" + ".a" * 50_000 + "=1}", ("seed", "{a" + ".a" * 50_000 + "=1}")),
    ],
)
def test_parse_override(text: str, pair: tuple[str, Any]) -> None:
    assert parse_override(text) == pair


@pytest.mark.parametrize("text", ["wind_z", "=3", ""])
def test_an_override_without_a_key_or_value_is_refused(text: str) -> None:
    with pytest.raises(SceneError, match="--set: .*KEY=VALUE" if text else "--set: must be KEY=VALUE"):
        parse_override(text)
    with pytest.raises(SceneError, match="--a: "):
        parse_override(text, "--a")
