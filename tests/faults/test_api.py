"""Calls of the Python API in any order: an invalid one changes nothing, and the cloth stays finite."""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from taichi_cloth.export.clip import replay
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.kernels.step_params import MAX_GRABS
from taichi_cloth.scene import Scene, SceneError, parameters_of, scene_to_toml
from taichi_cloth.scene.collider_schema import Box, Capsule, Ground, Mesh, Sphere
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Solver, Wind
from taichi_cloth.simulation.events import GrabHandle
from taichi_cloth.simulation.parameter_values import MAX_COORDINATE
from taichi_cloth.simulation.recording import Recorder
from taichi_cloth.simulation.rollback import DivergenceGuard
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

SCENE = Scene(
    cloth=Cloth(rows=5, columns=6, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.0, 1.0), radius=0.2, oscillation=(1.0, 0.0, 0.0), period=(4.0, 1.0, 1.0)),),
    ground=Ground(),
)
PARTICLES = SCENE.cloth.rows * SCENE.cloth.columns
KEYS = parameters_of(SCENE)
SOLVERS = ("verlet", "xpbd")  # two are enough: each has kernels to compile

junk = st.sampled_from([None, "3", "", [], {}, [1.0, 2.0], "nan", b"1", object(), 1j, [[1, 2], [3]]])
not_finite = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e39, 10**400])
numbers = st.floats(-1.0, 1.0)
points = st.tuples(numbers, numbers, numbers)
bad_points = (
    junk | st.tuples(numbers, not_finite, numbers) | st.tuples(numbers, numbers) | st.just((0, 0, 2 * MAX_COORDINATE))
)


class Calls(RuleBasedStateMachine):
    """One simulation with two solvers; a checkpoint is its complete state."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.simulation = Simulation(SCENE)
        self.guard = DivergenceGuard(self.simulation)
        self.own_pins = self.pins().tolist()
        self.checkpoints: list[tuple[str, bytes]] = []

    def teardown(self) -> None:
        self.simulation.close()
        self.folder.cleanup()

    def path(self, name: str) -> Path:
        return Path(self.folder.name) / name

    def state(self) -> tuple[str, bytes]:
        """Solver and fabric, and the bytes of a checkpoint."""
        self.simulation.save(self.path("now.npz"))
        scene = self.simulation.scene
        return f"{scene.solver.name} {scene.fabric.preset}", self.path("now.npz").read_bytes()

    def refused(self, call: Any, *arguments: Any) -> None:
        before = self.state()
        with pytest.raises(ValueError, match=r"\A.+\Z"):
            call(*arguments)
        assert self.state() == before

    # -- valid calls ---------------------------------------------------------------------------------

    @rule(frames=st.integers(1, 3))
    def advance(self, frames: int) -> None:
        for _ in range(frames):
            self.simulation.step()
            assert self.guard.check_and_snapshot()

    @rule(name=st.sampled_from(sorted(KEYS)), share=st.floats(0.0, 1.0))
    def set_parameter(self, name: str, share: float) -> None:
        key = KEYS[name]
        value = key.slider_min + share * (key.slider_max - key.slider_min)
        self.simulation.params[name] = round(value) if key.is_int else value
        assert self.simulation.params[name] == pytest.approx(value, abs=0.5 if key.is_int else 1e-12)

    @rule(on=st.booleans())
    def switch_wind(self, on: bool) -> None:
        self.simulation.params["wind"] = on
        assert self.simulation.params["wind"] is on

    @rule(index=st.integers(0, PARTICLES - 1), offset=points, radius=st.sampled_from([0.0, 0.3, 1e6]))
    def grab(self, index: int, offset: tuple[float, ...], radius: float) -> None:
        before = set(self.simulation.grabbed.tolist())
        if index in before or len(self.simulation.grabs) == MAX_GRABS:
            self.refused(self.simulation.grab, index, radius)
            return
        grab = self.simulation.grab(index, radius)
        grab.move_to(self.simulation.topology.start[index] + 0.3 * np.array(offset))
        assert grab.particles[0] == index
        assert set(self.simulation.grabbed.tolist()) == before | set(grab.particles.tolist())
        assert not before & set(grab.particles.tolist())
        assert radius < 1e6 or len(self.simulation.grabbed) >= PARTICLES - len(self.pins())

    @precondition(lambda self: self.simulation.grabs)
    @rule(data=st.data(), offset=points)
    def move(self, data: st.DataObject, offset: tuple[float, ...]) -> None:
        grab = self.one_grab(data)
        start = self.simulation.topology.start[grab.particles[0]]
        grab.move_to(start + 0.3 * np.array(offset))

    def one_grab(self, data: st.DataObject) -> GrabHandle:
        return GrabHandle(self.simulation, data.draw(st.sampled_from(sorted(self.simulation.grabs))))

    def pins(self) -> Any:
        return np.flatnonzero(self.simulation.topology.pinned)

    @rule(index=st.integers(0, PARTICLES - 1), on=st.booleans())
    def pin(self, index: int, on: bool) -> None:
        before = self.simulation.positions()
        (self.simulation.pin if on else self.simulation.unpin)(index)
        self.guard = DivergenceGuard(self.simulation)
        assert (index in self.pins()) is on
        assert (self.simulation.positions() == before).all()

    @precondition(lambda self: self.simulation.grabs)
    @rule(data=st.data())
    def release(self, data: st.DataObject) -> None:
        grab, before = self.one_grab(data), set(self.simulation.grabbed.tolist())
        particles = set(grab.particles.tolist())
        grab.release()
        assert not grab.active
        assert set(self.simulation.grabbed.tolist()) == before - particles

    @rule()
    def release_all(self) -> None:
        for number in list(self.simulation.grabs):
            GrabHandle(self.simulation, number).release()
        assert len(self.simulation.grabbed) == 0

    @rule(offset=points, velocity=points)
    def set_state(self, offset: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        self.simulation.set_state(self.simulation.topology.start + offset, velocity)

    @rule()
    def reset(self) -> None:
        self.simulation.reset()
        self.guard = DivergenceGuard(self.simulation)
        assert self.simulation.frame == 0
        assert self.pins().tolist() == self.own_pins

    @rule(name=st.sampled_from(SOLVERS))
    def switch_solver(self, name: str) -> None:
        before = self.simulation.positions()
        self.simulation.switch_solver(name)
        self.guard = DivergenceGuard(self.simulation)
        assert (self.simulation.positions() == before).all()

    @rule(name=st.sampled_from(["", "silk", "rubber"]))
    def switch_fabric(self, name: str) -> None:
        before, grabbed = self.simulation.positions(), self.simulation.grabbed
        self.simulation.switch_fabric(name)
        self.guard = DivergenceGuard(self.simulation)
        assert (self.simulation.positions() == before).all()
        assert (self.simulation.grabbed == grabbed).all()

    @rule()
    def save(self) -> None:
        self.checkpoints.append(self.state())

    @precondition(lambda self: self.checkpoints)
    @rule(data=st.data())
    def load(self, data: st.DataObject) -> None:
        scene, content = data.draw(st.sampled_from(self.checkpoints))
        self.path("then.npz").write_bytes(content)
        if scene == self.state()[0]:
            self.simulation.load(self.path("then.npz"))
            self.guard = DivergenceGuard(self.simulation)
            assert self.state() == (scene, content)
        else:
            self.refused(self.simulation.load, self.path("then.npz"))

    # -- invalid calls -----------------------------------------------------------------------------------

    @rule(name=st.sampled_from(sorted(KEYS)), value=junk | not_finite | st.just(-1e6))
    def set_an_invalid_value(self, name: str, value: Any) -> None:
        self.refused(self.simulation.params.__setitem__, name, value)

    @rule(name=st.text(max_size=5) | st.sampled_from(["rows", "wind_y", None, 3]))
    def set_an_unknown_parameter(self, name: Any) -> None:
        self.refused(self.simulation.params.__setitem__, name, 1.0)
        self.refused(self.simulation.params.__getitem__, name)

    @rule(value=junk | st.sampled_from([0, 1, 2.0]))
    def switch_wind_to_an_invalid_value(self, value: Any) -> None:
        self.refused(self.simulation.params.__setitem__, "wind", value)

    @rule(index=junk | st.sampled_from([-1, PARTICLES, 2**70, 1.5, np.nan]))
    def grab_an_invalid_particle(self, index: Any) -> None:
        self.refused(self.simulation.grab, index)
        self.refused(self.simulation.pin, index)
        self.refused(self.simulation.unpin, index)

    @precondition(lambda self: self.simulation.grabs)
    @rule(data=st.data(), point=bad_points)
    def move_to_an_invalid_target(self, data: st.DataObject, point: Any) -> None:
        self.refused(self.one_grab(data).move_to, point)

    @rule(index=st.integers(0, PARTICLES - 1), radius=junk | not_finite | st.just(-0.1))
    def grab_with_an_invalid_radius(self, index: int, radius: Any) -> None:
        self.refused(self.simulation.grab, index, radius)

    @rule(positions=junk | bad_points)
    def set_an_invalid_state(self, positions: Any) -> None:
        self.refused(self.simulation.set_state, positions)
        self.refused(self.simulation.set_state, self.simulation.topology.start, positions)

    @rule(name=st.text(max_size=8) | st.sampled_from(["varlet", None, 3]))
    def switch_to_an_unknown_solver(self, name: Any) -> None:
        self.refused(self.simulation.switch_solver, name)

    @rule(name=st.text(max_size=8).map(lambda text: text + "s") | st.sampled_from([None, 3]))
    def switch_to_an_unknown_fabric(self, name: Any) -> None:
        self.refused(self.simulation.switch_fabric, name)

    @rule(content=st.binary(max_size=300))
    def load_a_file_that_is_not_a_checkpoint(self, content: bytes) -> None:
        self.path("bad.npz").write_bytes(content)
        self.refused(self.simulation.load, self.path("bad.npz"))

    @rule()
    def save_and_load_in_a_missing_folder(self) -> None:
        before = self.state()
        with pytest.raises(OSError, match="gone"):
            self.simulation.save(self.path("gone") / "checkpoint.npz")
        with pytest.raises(OSError, match="gone"):
            self.simulation.load(self.path("gone") / "checkpoint.npz")
        assert self.state() == before

    @invariant()
    def finite(self) -> None:
        assert self.simulation.metrics().finite


@pytest.mark.usefixtures("taichi")
class TestCalls(Calls.TestCase):
    settings = settings(max_examples=30, stateful_step_count=25)


# -- scenes made in Python -------------------------------------------------------------------------------------


def test_lists_in_a_scene_become_tuples() -> None:
    scene = Scene(
        cloth=Cloth(rows=3, columns=3, center=[0, 2, 0], pins=["top"]),  # type: ignore[arg-type]
        spheres=[Sphere(center=[0, 1, 0])],  # type: ignore[arg-type]
        boxes=[Box(keyframes=[[0, 0, 0, 0], [1, 0, 1, 0]])],  # type: ignore[arg-type]
    )
    with Simulation(scene) as simulation:
        simulation.step()
        assert simulation.scene.spheres == (Sphere(center=(0.0, 1.0, 0.0)),)
        assert simulation.scene.boxes[0].keyframes == ((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0))
        assert simulation.metrics().finite


@pytest.mark.parametrize("name", ["wind_z", "wind", "sphere_radius", "stiffness"])
def test_a_parameter_is_no_attribute_also_in_a_scene_without_it(name: str) -> None:
    with (
        Simulation(Scene(cloth=Cloth(rows=3, columns=3))) as simulation,
        pytest.raises(AttributeError, match=rf"{name} is a runtime parameter: set params\['{name}'\]"),
    ):
        setattr(simulation, name, 3.0)


@pytest.mark.parametrize(
    ("name", "hint"), [("positions", "; set_state moves the cloth"), ("velocities", "; set_state"), ("metrics", "")]
)
def test_a_method_is_not_replaced_by_a_value(name: str, hint: str) -> None:
    with (
        Simulation(Scene(cloth=Cloth(rows=3, columns=3))) as simulation,
        pytest.raises(AttributeError, match=f"{name} is a method, not an attribute to set{hint}"),
    ):
        setattr(simulation, name, np.zeros((9, 3)))


def test_a_grab_has_no_target_to_set() -> None:
    with Simulation(Scene(cloth=Cloth(rows=3, columns=3))) as simulation:
        grab = simulation.grab(0)
        with pytest.raises(AttributeError, match="target"):
            grab.target = (1.0, 2.0, 3.0)  # type: ignore[attr-defined]


def test_damping_that_a_solver_leaves_out_is_a_warning() -> None:
    scene = Scene(cloth=Cloth(rows=3, columns=3), solver=Solver("implicit"), fabric=Fabric(damping_time=1e-3))
    with Simulation(scene) as simulation:
        assert simulation.warnings.startswith("implicit leaves out the damping of springs, fabric.damping_time")


def test_a_collider_without_a_name_is_moved_by_its_index() -> None:
    with (
        Simulation(Scene(cloth=Cloth(rows=3, columns=3), spheres=(Sphere(),))) as simulation,
        pytest.raises(ValueError, match="no collider is named 'ball': none has a name; move it by its index, from 0"),
    ):
        simulation.move_collider("ball", (0.0, 0.0, 0.0))


def test_keys_of_colliders_that_a_scene_lacks_are_no_hint() -> None:
    with pytest.raises(SceneError, match=r"ball_radius: unknown key \(did you mean 'radius'\?\)"):
        load_scene("curtain", ball_radius=0.3)


def test_a_fabric_that_the_solver_does_not_use_is_a_warning() -> None:
    with Simulation(Scene(cloth=Cloth(rows=3, columns=3), fabric=Fabric(warp=5e4))) as simulation:
        assert simulation.warnings == "verlet uses [verlet], not fabric.warp"


@pytest.mark.parametrize(("cls", "key"), [(Box, "center"), (Sphere, "center"), (Ground, "height")])
def test_a_collider_needs_the_names_of_its_keys(cls: Any, key: str) -> None:
    with pytest.raises(
        SceneError, match=rf"{cls.__name__}: values need the names of keys, as in {cls.__name__}\({key}="
    ):
        cls((0.0, 1.0, 0.0), 0.2)


@pytest.mark.parametrize(
    ("sections", "line"),
    [
        ({"cloth": Cloth(rows=1)}, "scene: cloth.rows: 1 is out of range: 2 to 2048"),
        ({"cloth": None}, "scene: cloth: must be a table, got None"),
        ({"cloth": {"row": 20}}, "scene: cloth.row: unknown key (did you mean 'rows'?)"),
        ({"cloth": {"colour": "red"}}, "scene: cloth.colour: unknown key (did you mean 'look.color'?)"),
        ({"cloth": {"frictin": 1}}, "scene: cloth.frictin: unknown key; allowed: rows, columns"),  # many have it
        ({"cloth": {"rows": 10.0}}, "scene: cloth.rows: must be an integer, got 10.0"),
        ({"cloth": {"rows": np.float64(10)}}, "scene: cloth.rows: must be an integer, got 10.0"),
        ({"cloth": {"rows": np.int64}}, "scene: cloth.rows: must be an integer, got <class 'numpy.int64'>"),
        ({"wind": 3}, "scene: wind: must be a table, got 3"),
        ({"verlet": VerletSprings(shear=np.nan)}, "scene: verlet.shear: must be a finite number, got nan"),
        ({"spheres": Sphere()}, "scene: spheres: write [[spheres]] with two brackets: it is an array of tables"),
        ({"spheres": (Box(),)}, "scene: spheres[0]: must be a Sphere or a dict, got Box("),
        ({"spheres": [{"sway": (1, 0, 0)}]}, "scene: spheres[0].sway: was renamed to oscillation"),
        ({"boxes": (Box(center="here"),)}, "scene: boxes[0].center: must be three numbers"),  # type: ignore[arg-type]
        ({"boxes": (Box(center=np.zeros(2)),)}, "scene: boxes[0].center: must be three numbers, as in [0.0, 1.0"),
        ({"boxes": (Box(),) * 17}, "scene: boxes: has 17 tables, at most 16 are allowed"),
        ({"cloth": Cloth(pins=(720,))}, "scene: cloth.pins[0]: 720 is not a particle: indices run from 0 to 719"),
        ({"ground": True}, "scene: ground: must be a table, as in {}, got true"),
        ({"seed": -1, "name": "mine"}, "mine: seed: -1 is out of range: 0 to 2147483647"),
        ({"sphere": [Sphere()]}, "Scene: sphere: unknown key (did you mean 'spheres'?)"),
    ],
)
def test_a_scene_that_would_be_invalid_in_a_file_is_refused(sections: dict[str, Any], line: str) -> None:
    with pytest.raises(SceneError) as caught:
        Simulation(Scene(**sections))
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize(
    ("section", "keyword", "line"),
    [
        (Cloth, "row", "Cloth: row: unknown key (did you mean 'rows'?)"),
        (Sphere, "raduis", "Sphere: raduis: unknown key (did you mean 'radius'?)"),
        (Sphere, "sway", "Sphere: sway: was renamed to oscillation"),
        (Cloth, "colour", "Cloth: colour: unknown key (did you mean 'look.color'?)"),
        (Cloth, "resolution", "Cloth: resolution: unknown key (did you mean 'rows'?)"),
        (Capsule, "height", "Capsule: height: unknown key (did you mean 'length'?)"),
        (Capsule, "start", "Capsule: start: unknown key; allowed: margin, friction, "),
        (Mesh, "path", "Mesh: path: unknown key (did you mean 'file'?)"),
        (Sphere, "path", "Sphere: path: was renamed to keyframes"),
        (Ground, "zzz", "Ground: zzz: unknown key; allowed: margin, friction, continuous, response, restitution, "),
    ],
)
def test_an_unknown_keyword_of_a_section_is_refused(section: type, keyword: str, line: str) -> None:
    with pytest.raises(SceneError) as caught:
        section(**{keyword: 1})
    assert str(caught.value).startswith(line)


def test_dicts_stand_for_sections_and_numpy_for_numbers() -> None:
    scene = Scene(
        cloth={"rows": np.int64(12), "pins": "top-left"},  # type: ignore[arg-type]
        spheres=[{"center": np.array([0.0, 1.0, 0.0]), "radius": np.float32(0.5)}, Sphere(margin=np.float64(0.1))],  # type: ignore[arg-type, list-item]
        boxes=[Box()],  # type: ignore[arg-type]
        wind=None,
        planes=None,  # type: ignore[arg-type]
        ground={"continuous": np.bool_(True)},  # type: ignore[arg-type]
        seed=np.uint8(3),  # type: ignore[arg-type]
    )
    plain = Scene(
        cloth=Cloth(rows=12, pins=("top-left",)),
        spheres=(Sphere(center=(0.0, 1.0, 0.0), radius=0.5), Sphere(margin=0.1)),
        boxes=(Box(),),
        ground=Ground(continuous=True),
        seed=3,
    )
    assert scene == plain
    assert hash(scene) == hash(plain)
    assert repr(scene) == repr(plain)  # so all values are Python's own
    assert scene_to_toml(scene) == scene_to_toml(plain)
    assert pickle.loads(pickle.dumps(scene)) == plain
    assert load_scene({"cloth": {"pins": np.array([0, 5])}}).cloth.pins == (0, 5)
    assert repr(load_scene({"cloth": {"pins": [np.int64(5), np.str_("left")]}}).cloth.pins) == "(5, 'left')"


def test_a_scene_is_loaded_from_a_dict_as_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("seed = 3\n[cloth]\nrows = 9\n[solver]\nname = 'lines'\n[fabric]\npreset = 'silk'\n[[boxes]]\n")
    tables = {"seed": 3, "cloth": {"rows": 9}, "solver": {"name": "lines"}, "fabric": {"preset": "silk"}, "boxes": [{}]}
    before = repr(tables)
    assert load_scene(tables) == load_scene(file)
    assert load_scene(tables, rows=12, box_size=(1, 2, 3)) == load_scene(file, rows=12, box_size=(1, 2, 3))
    assert repr(tables) == before
    assert load_scene({"wind": None, "boxes": [Box(), {}]}) == Scene(boxes=(Box(), Box()))


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ({"cloth": {"row": 20}}, "scene: cloth.row: unknown key (did you mean 'rows'?)"),
        ({"cloths": {}}, "scene: cloths: unknown key (did you mean 'cloth'?)"),
        ({3: 4}, "scene: 3: unknown key; allowed: title, seed, cloth, "),
        ({"cloth": None}, "scene: cloth: must be a table, got None"),
        ({"cloth": {"pins": ["tp"]}}, "scene: cloth.pins[0]: 'tp' is not a pin"),
        ("curtan", "curtan: no such scene; use "),
        (None, "scene: must be a scene, the name of a shipped one, the path of a TOML file, or a dict, got None"),
    ],
)
def test_what_is_no_scene_is_refused_by_one_line(source: Any, line: str) -> None:
    for use in (load_scene, Simulation):
        with pytest.raises(SceneError) as caught:
            use(source)
        assert str(caught.value).startswith(line)
        assert str(caught.value).isprintable()


def test_a_simulation_opens_a_scene_by_name_path_and_dict(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[cloth]\nrows = 9\ncolumns = 8\n")
    for source in (tmp_path / "mine.toml", str(tmp_path / "mine.toml"), {"cloth": {"rows": 9, "columns": 8}}):
        with Simulation(source) as simulation:
            assert simulation.topology.shape == (9, 8)
    with Simulation("drape15", layout="serial") as simulation:
        assert simulation.scene == load_scene("drape15")
        simulation.switch_scene("drape15")
        with pytest.raises(SceneError, match="did you mean 'drape15'"):
            simulation.switch_scene("drape")


def test_calls_take_numbers_of_numpy(tmp_path: Path) -> None:
    with Simulation(SCENE, "serial") as simulation:
        recorder = Recorder(simulation)
        simulation.params["wind_z"] = np.float32(2.5)
        simulation.params["iterations"] = np.int64(3)
        grab = simulation.grab(np.int32(20), radius=np.float32(0.1))  # type: ignore[arg-type]
        grab.move_to(np.float32([0.0, 2.0, 0.5]))
        simulation.step(np.int64(2))  # type: ignore[arg-type]
        assert (simulation.params["wind_z"], simulation.params["iterations"]) == (2.5, 3)
        assert [type(simulation.params[name]) for name in ("wind_z", "iterations")] == [float, int]
        recorder.save(tmp_path / "run.toml")
        positions = simulation.positions()
    with replay(tmp_path / "run.toml") as replayed:
        assert (replayed.positions() == positions).all()


def test_an_unknown_layout_is_refused() -> None:
    with pytest.raises(UsageError, match=r"unknown layout 'xpbd': .*; load_scene\(scene, solver='xpbd'\) chooses"):
        Simulation(SCENE, "xpbd")
    with pytest.raises(UsageError, match="unknown layout 'lane': simd, serial, parallel"):
        Simulation(SCENE, layout="lane")
