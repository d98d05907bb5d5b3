"""Every place where a name is typed: a wrong one is refused in one line, with the nearest valid name or all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import taichi_cloth as tc
from taichi_cloth.evaluation.stress.runner import select_units
from taichi_cloth.evaluation.validate.references import select_pairs
from taichi_cloth.scene.presets import load_preset
from taichi_cloth.simulation.events import Event
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import choose_from

SOLVERS = "verlet, xpbd, explicit, lines, rk4, implicit"
Refused = Callable[[list[str], str], None]
VIEWS = "shaded, strain, error, wireframe, particles"


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return tc.Simulation(tc.load_scene("drape15"))


Call = Callable[[Simulation], object]
TYPED: dict[str, tuple[Call, str]] = {
    "parameter": (lambda s: s.params["dampin"], "'dampin' is not a parameter of this scene: "),
    "parameter, nearest": (lambda s: s.params["dampin"], "; did you mean 'damping'?"),
    "parameter, set": (lambda s: s.params.update(gravty=1), "; did you mean 'gravity'?"),
    "parameter, info": (lambda s: s.params.info("zzz"), "'zzz' is not a parameter of this scene: gravity, "),
    "solver": (lambda s: s.switch_solver("xpdb"), f"unknown solver 'xpdb': {SOLVERS}; did you mean 'xpbd'?"),
    "solver, far": (lambda s: s.switch_solver("zzz"), f"unknown solver 'zzz': {SOLVERS}"),
    "solver, renamed": (lambda s: s.switch_solver("spring"), "unknown solver 'spring': it was renamed to 'explicit'"),
    "event": (lambda s: s.apply(Event("grabb")), "unknown event 'grabb'; did you mean 'grab'?"),
    "no event": (lambda s: s.apply("reset"), "an event must be a tc.Event, such as tc.Event('reset'), not 'reset'"),
    "fabric": (lambda s: s.switch_fabric("denin"), "unknown fabric 'denin'; did you mean 'denim'?"),
    "view": (lambda s: tc.render_image(s, view="shadde"), f"unknown view 'shadde': {VIEWS}; did you mean 'shaded'?"),
    "view, far": (lambda s: tc.render_image(s, view="normals"), f"unknown view 'normals': {VIEWS}"),
    "layout": (
        lambda s: Simulation(s.scene, "smid"),
        "'smid': simd, serial, parallel; did you mean 'simd'?",
    ),
    "layout, renamed": (lambda s: Simulation(s.scene, "lanes"), "unknown layout 'lanes': it was renamed to 'simd'"),
    "arch": (lambda s: tc.init("cpuu"), "unknown arch 'cpuu': cpu, cuda, vulkan, metal, gpu; did you mean 'cpu'?"),
    "scene": (lambda s: tc.load_scene("curtian"), "(did you mean 'curtain'?)"),
    "key": (lambda s: tc.load_scene("curtain", windz=1), "windz: unknown key (did you mean 'wind_z'?)"),
    "preset": (lambda s: load_preset("denin"), "(did you mean 'denim'?)"),
    "no scene": (lambda s: tc.Simulation(3), "the path of a TOML file, or a dict, got 3"),
    "no scene to switch to": (lambda s: s.switch_scene("curtian"), "(did you mean 'curtain'?)"),
    "name of the package": (lambda s: tc.Sphre, "has no attribute 'Sphre'; did you mean 'Sphere'?"),
    "particle": (lambda s: s.grab(225), "particle index must be in 0..224, not 225"),
    "particle of another type": (lambda s: s.grab(True), "a particle is an index or a position, not true"),
    "position of a particle": (
        lambda s: s.grab((0.0, 1.0)),
        "the position of a particle must be numbers of shape (3,)",
    ),
    "particle to pin": (lambda s: s.pin(-1), "particle index must be in 0..224, not -1"),
    "radius": (lambda s: s.grab(100, radius=-1), "radius must be a number from 0 to 1e+06 [m], not -1"),
    "size": (lambda s: tc.render_image(s, "big"), "size must be width and height, 1 to 8192 pixels each, not 'big'"),
    "size, too small": (lambda s: tc.render_image(s, (0, 5)), "1 to 8192 pixels each, not (0, 5)"),
    "camera": (lambda s: tc.render_image(s, eye=(1, 2)), "camera.eye: must be three numbers"),
    "camera, not finite": (
        lambda s: tc.render_image(s, target=(1, 2, float("nan"))),
        "camera.target[2]: must be",
    ),
    "camera, straight down": (lambda s: tc.render_image(s, eye=(0, 9, 0), target=(0, 1, 0)), "straight above or below"),
    "stress case": (lambda s: select_units("yankk"), "; did you mean 'yank'?"),
    "stress variant": (
        lambda s: select_units("yank", "10m"),
        "'10m'; allowed: 10 m; did you mean '10 m'?",
    ),
    "reference": (lambda s: select_pairs("a2.1", None), "; did you mean 'A2.1'?"),
}


@pytest.mark.parametrize("kind", TYPED)
def test_a_wrong_name_in_python_is_one_line(simulation: Simulation, kind: str) -> None:
    call, message = TYPED[kind]
    with pytest.raises((ValueError, AttributeError)) as caught:
        call(simulation)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not simulation.closed


COMMANDS = [
    ("rendr curtain", "taichi-cloth: unknown command 'rendr'; did you mean 'render'? (see taichi-cloth --help)"),
    ("tabel", "unknown command 'tabel'; did you mean 'table'?"),
    ("zzz", "unknown command 'zzz': run, web, render, "),
    ("bake curtain", "bake was renamed to export --frames A:B"),
    ("render curtain --sett a=1", "taichi-cloth render: unknown option --sett; did you mean '--set'?"),
    ("render curtain -x", "unknown option -x"),
    ("render curtain --clip", "--clip was renamed to --frames A:B"),
    ("render curtain table", "too many arguments: table"),
    ("render curtain --set wind.z = 6", "too many arguments: = 6; write KEY=VALUE without spaces"),
    ("check flag --set wind.z =6", "too many arguments: =6; write KEY=VALUE without spaces"),
    ("compare curtain --a solver=lines substeps=5", "substeps=5; join keys by commas: KEY=VALUE,KEY=VALUE"),
    ("render curtain --view strian", "did you mean 'strain'?"),
    ("render curtain --solver xpdb", "solver.name: 'xpdb' is not one of: verlet"),
    ("render curtain --without sphere", "did you mean 'spheres'?"),
    ("render curtain --set wind.y=1", "wind.y: unknown key (did you mean 'wind.z'?)"),
    ("render curtain --set wind_y=1", "wind_y: unknown key (did you mean 'wind_z'?)"),
    ("render curtain --set fabric=slik", "(did you mean 'silk'?)"),
    ("render curtain --set pins=tpo", "(did you mean 'top'?)"),
    ("render curtain --arch cpuu", "did you mean 'cpu'?"),
    ("compare curtain --a solver=foo", f"'foo' is not one of: {SOLVERS}"),
    ("compare curtain --b solver=xpdb", "(did you mean 'xpbd'?)"),
    ("compare curtain --a iterations:2", "--a: iterations:2: must be KEY=VALUE"),
    ("compare curtain --b iterations:2", "--b: iterations:2: must be KEY=VALUE"),
    ("compare curtain --set iterations:2", "--set: iterations:2: must be KEY=VALUE"),
    ("export curtain --format objj", "did you mean 'obj'?"),
    ("stress --filter yankk", "did you mean 'yank'?"),
    ("stress --filter yank --variant 10m", "did you mean '10 m'?"),
    ("stress --solver robst", "did you mean 'robust'?"),
    ("validate --filter a2.1", "did you mean 'A2.1'?"),
    ("validate --solver xpdb", "did you mean 'xpbd'?"),
    ("bench --filter xpdb", "did you mean 'xpbd'?"),
    ("bench --only xpbd", "--only was renamed to --filter"),
    ("bench --error --scene curtian", "(did you mean 'curtain'?)"),
    ("ablate curtian", "(did you mean 'curtain'?)"),
    ("web --prot 80", "did you mean '--port'?"),
]


@pytest.mark.parametrize(("line", "message"), COMMANDS, ids=[line for line, _ in COMMANDS])
def test_a_wrong_name_on_the_command_line_is_one_line(
    running: None, refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(line.split(), message)
    assert list(tmp_path.iterdir()) == []


def test_many_names_are_listed_only_if_none_is_near() -> None:
    names = [f"name{k}" for k in range(20)]
    assert choose_from("nam3", names) == "; did you mean 'name3'?"
    assert choose_from("zzz", names) == ": " + ", ".join(names)
    assert choose_from("nam3", names[:4]) == ": name0, name1, name2, name3; did you mean 'name3'?"
