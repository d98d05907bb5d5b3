"""Calls of the Python API in any order, good and bad: a refused one changes nothing, and the cloth stays finite."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from taichi_cloth.errors import WrongUse
from taichi_cloth.given import FARTHEST
from taichi_cloth.guard import Guard
from taichi_cloth.scene import Scene, SceneError, live_keys
from taichi_cloth.scene.model import Box, Cloth, Ground, Sphere, Springs, Wind
from taichi_cloth.simulation import Simulation

SCENE = Scene(
    cloth=Cloth(rows=5, columns=6, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.0, 1.0), radius=0.2, sway=(1.0, 0.0, 0.0), period=(4.0, 1.0, 1.0)),),
    ground=Ground(),
)
PARTICLES = SCENE.cloth.rows * SCENE.cloth.columns
KEYS = live_keys(SCENE)
SOLVERS = ("verlet", "xpbd")  # two are enough: every one more has kernels to compile

junk = st.sampled_from([None, "3", "", [], {}, [1.0, 2.0], "nan", b"1", object(), 1j, [[1, 2], [3]]])
not_finite = st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e39, 10**400])
numbers = st.floats(-1.0, 1.0)
points = st.tuples(numbers, numbers, numbers)
bad_points = (
    junk | st.tuples(numbers, not_finite, numbers) | st.tuples(numbers, numbers) | st.just((0, 0, 2 * FARTHEST))
)


class Calls(RuleBasedStateMachine):
    """One simulation on two methods; a save is all that there is of its state."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.simulation = Simulation(SCENE)
        self.guard = Guard(self.simulation)
        self.own_pins = self.pins().tolist()
        self.saves: list[tuple[str, bytes]] = []

    def teardown(self) -> None:
        self.simulation.close()
        self.folder.cleanup()

    def path(self, name: str) -> Path:
        return Path(self.folder.name) / name

    def state(self) -> tuple[str, bytes]:
        """The method, and the bytes of a save."""
        self.simulation.save(self.path("now.npz"))
        scene = self.simulation.scene
        return f"{scene.solver.name} {scene.fabric.preset}", self.path("now.npz").read_bytes()

    def refused(self, call: Any, *arguments: Any) -> None:
        before = self.state()
        with pytest.raises(ValueError, match=r"\A.+\Z"):
            call(*arguments)
        assert self.state() == before

    # -- what is right ---------------------------------------------------------------------------------

    @rule(frames=st.integers(1, 3))
    def advance(self, frames: int) -> None:
        for _ in range(frames):
            self.simulation.advance_frame()
            assert self.guard.sound()

    @rule(name=st.sampled_from(sorted(KEYS)), share=st.floats(0.0, 1.0))
    def turn(self, name: str, share: float) -> None:
        key = KEYS[name]
        value = key.low + share * (key.high - key.low)
        self.simulation.set(name, round(value) if key.is_int else value)
        assert self.simulation.get(name) == pytest.approx(value, abs=0.5 if key.is_int else 1e-12)

    @rule(on=st.booleans())
    def switch(self, on: bool) -> None:
        self.simulation.set("wind", on)
        assert self.simulation.get("wind") is on

    @rule(index=st.integers(0, PARTICLES - 1), offset=points, radius=st.sampled_from([0.0, 0.3, 1e6]))
    def grab(self, index: int, offset: tuple[float, ...], radius: float) -> None:
        before = self.simulation.grabbed
        self.simulation.grab(index, self.simulation.topology.start[index] + 0.3 * np.array(offset), radius)
        assert self.simulation.grabbed == index
        assert radius < 1e6 or before == index or len(self.simulation.held) >= PARTICLES - len(self.pins())

    def pins(self) -> Any:
        return np.flatnonzero(self.simulation.topology.pinned)

    @rule(index=st.integers(0, PARTICLES - 1), on=st.booleans())
    def pin(self, index: int, on: bool) -> None:
        before = self.simulation.positions()
        self.simulation.pin(index, on)
        self.guard = Guard(self.simulation)
        assert (index in self.pins()) is on
        assert (self.simulation.positions() == before).all()

    @rule()
    def release(self) -> None:
        self.simulation.release()
        assert self.simulation.grabbed is None

    @rule(offset=points, velocity=points)
    def place(self, offset: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        self.simulation.place(self.simulation.topology.start + offset, velocity)

    @rule()
    def reset(self) -> None:
        self.simulation.reset()
        self.guard = Guard(self.simulation)
        assert self.simulation.frame == 0
        assert self.pins().tolist() == self.own_pins

    @rule(name=st.sampled_from(SOLVERS))
    def change_solver(self, name: str) -> None:
        before = self.simulation.positions()
        self.simulation.change_solver(name)
        self.guard = Guard(self.simulation)
        assert (self.simulation.positions() == before).all()

    @rule(name=st.sampled_from(["", "silk", "rubber"]))
    def change_fabric(self, name: str) -> None:
        before, held = self.simulation.positions(), self.simulation.held
        self.simulation.change_fabric(name)
        self.guard = Guard(self.simulation)
        assert (self.simulation.positions() == before).all()
        assert (self.simulation.held == held).all()

    @rule()
    def save(self) -> None:
        self.saves.append(self.state())

    @precondition(lambda self: self.saves)
    @rule(data=st.data())
    def load(self, data: st.DataObject) -> None:
        scene, content = data.draw(st.sampled_from(self.saves))
        self.path("then.npz").write_bytes(content)
        if scene == self.state()[0]:
            self.simulation.load(self.path("then.npz"))
            self.guard = Guard(self.simulation)
            assert self.state() == (scene, content)
        else:
            self.refused(self.simulation.load, self.path("then.npz"))

    # -- what is not -----------------------------------------------------------------------------------

    @rule(name=st.sampled_from(sorted(KEYS)), value=junk | not_finite | st.just(-1e6))
    def turn_wrongly(self, name: str, value: Any) -> None:
        self.refused(self.simulation.set, name, value)

    @rule(name=st.text(max_size=5) | st.sampled_from(["rows", "wind_y", None, 3]))
    def turn_what_is_not_there(self, name: Any) -> None:
        self.refused(self.simulation.set, name, 1.0)
        self.refused(self.simulation.get, name)

    @rule(value=junk | st.sampled_from([0, 1, 2.0]))
    def switch_wrongly(self, value: Any) -> None:
        self.refused(self.simulation.set, "wind", value)

    @rule(index=junk | st.sampled_from([-1, PARTICLES, 2**70, 1.5, np.nan]))
    def grab_nothing(self, index: Any) -> None:
        self.refused(self.simulation.grab, index, (0.0, 2.0, 0.0))
        self.refused(self.simulation.pin, index)

    @rule(index=st.integers(0, PARTICLES - 1), point=bad_points)
    def lead_nowhere(self, index: int, point: Any) -> None:
        self.refused(self.simulation.grab, index, point)

    @rule(index=st.integers(0, PARTICLES - 1), radius=junk | not_finite | st.just(-0.1))
    def grab_with_no_radius(self, index: int, radius: Any) -> None:
        self.refused(self.simulation.grab, index, (0.0, 2.0, 0.0), radius)

    @rule(positions=junk | bad_points)
    def place_nowhere(self, positions: Any) -> None:
        self.refused(self.simulation.place, positions)
        self.refused(self.simulation.place, self.simulation.topology.start, positions)

    @rule(name=st.text(max_size=8) | st.sampled_from(["varlet", None, 3]))
    def change_to_no_solver(self, name: Any) -> None:
        self.refused(self.simulation.change_solver, name)

    @rule(name=st.text(max_size=8).map(lambda text: text + "s") | st.sampled_from([None, 3]))
    def change_to_no_fabric(self, name: Any) -> None:
        self.refused(self.simulation.change_fabric, name)

    @rule(content=st.binary(max_size=300))
    def load_no_save(self, content: bytes) -> None:
        self.path("bad.npz").write_bytes(content)
        self.refused(self.simulation.load, self.path("bad.npz"))

    @rule()
    def save_nowhere(self) -> None:
        before = self.state()
        with pytest.raises(OSError, match="gone"):
            self.simulation.save(self.path("gone") / "save.npz")
        with pytest.raises(OSError, match="gone"):
            self.simulation.load(self.path("gone") / "save.npz")
        assert self.state() == before

    @invariant()
    def finite(self) -> None:
        assert self.simulation.measure().finite


@pytest.mark.usefixtures("taichi")
class TestCalls(Calls.TestCase):
    settings = settings(max_examples=30, stateful_step_count=25)


# -- scenes made in Python -------------------------------------------------------------------------------------


def test_lists_in_a_scene_are_as_good_as_tuples() -> None:
    scene = Scene(
        cloth=Cloth(rows=3, columns=3, center=[0, 2, 0], pins=["top"]),
        spheres=[Sphere(center=[0, 1, 0])],
        boxes=[Box(path=[[0, 0, 0, 0], [1, 0, 1, 0]])],
    )
    with Simulation(scene) as simulation:
        simulation.advance_frame()
        assert simulation.scene.spheres == (Sphere(center=(0.0, 1.0, 0.0)),)
        assert simulation.scene.boxes[0].path == ((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 1.0, 0.0))
        assert simulation.measure().finite


@pytest.mark.parametrize(
    ("scene", "line"),
    [
        (Scene(cloth=Cloth(rows=1)), "scene: cloth.rows: 1 is out of range: 2 to 2048"),
        (Scene(cloth=None), "scene: cloth: a table of keys is needed, not None"),
        (Scene(wind=3), "scene: wind: a table of keys is needed, not 3"),
        (Scene(springs=Springs(shear=np.nan)), "scene: springs.shear: a finite number is needed, not nan"),
        (Scene(spheres=Sphere()), "scene: spheres: write [[spheres]] with two brackets: a scene may have several"),
        (Scene(spheres=(Box(),)), "scene: spheres[0]: a table of keys is needed, not Box("),
        (Scene(boxes=(Box(center="here"),)), "scene: boxes[0].center: three numbers are needed"),
        (Scene(boxes=(Box(),) * 17), "scene: boxes: 17 are too many: at most 16"),
        (Scene(cloth=Cloth(pins=(720,))), "scene: cloth.pins[0]: 720 is no particle: indices run from 0 to 719"),
        (Scene(seed=-1, name="mine"), "mine: seed: -1 is out of range: 0 to 2147483647"),
    ],
)
def test_a_scene_that_no_file_may_hold_is_refused(scene: Scene, line: str) -> None:
    with pytest.raises(SceneError) as caught:
        Simulation(scene)
    assert str(caught.value).startswith(line)


def test_a_path_that_the_solver_does_not_have_is_refused() -> None:
    with pytest.raises(WrongUse, match="verlet has no path 'lane'"):
        Simulation(SCENE, path="lane")
