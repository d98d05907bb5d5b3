"""What was done to a cloth, written to a file, read again and repeated: the same to the last bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taichi_cloth.errors import WrongUse
from taichi_cloth.record.recorded import LONG, Recorded, Take
from taichi_cloth.record.recording import Recording, differences, hash_of, read_recording
from taichi_cloth.scene import Scene, SceneError, load_scene
from taichi_cloth.scene.model import Cloth, Fabric, Maps, Solver, Sphere, Tear, Wind
from taichi_cloth.simulation import Simulation
from taichi_cloth.view.rerun import Rerun

pytestmark = pytest.mark.usefixtures("on_lists")

SMALL = Scene(
    name="small",
    cloth=Cloth(rows=4, columns=5, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    solver=Solver(substeps=3, iterations=4),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.7, 0.2), radius=0.2),),
)
SIZE = (96, 54)
LAST = 19  # particle


@pytest.fixture
def simulation() -> Iterator[Recorded]:
    with Recorded(SMALL) as simulation:
        yield simulation


def run(simulation: Simulation, frames: int) -> None:
    for _ in range(frames):
        simulation.advance_frame()


def repeated(simulation: Recorded, path: Path) -> Rerun:
    """The recording up to now, written, read and repeated to equal positions; closed."""
    Recording.of(simulation, SIZE).write(path)
    rerun = replay(path)
    assert rerun.is_equal
    return rerun


def replay(path: Path) -> Rerun:
    with closing(Rerun(read_recording(path))) as rerun:
        while not rerun.over:
            rerun.forward()
    return rerun


def everything(simulation: Recorded, other: str) -> None:
    """All that a user can do, one after another."""
    run(simulation, 3)
    simulation.set("gravity", 4.1)
    place = simulation.positions()[LAST]
    for k in range(4):
        simulation.grab(LAST, place + [0.01 * k, 0.0, 0.03 * k])
        run(simulation, 1)
    simulation.set("wind", False)
    simulation.change_solver(other)
    run(simulation, 2)
    simulation.grab(7, (0.1, 1.9, 0.3))  # lets go of the first
    run(simulation, 1)
    simulation.set("substeps", 5)
    simulation.release()
    simulation.set("wind", True)
    simulation.set("sphere_radius", 0.4)
    run(simulation, 3)
    simulation.reset()
    run(simulation, 1)
    simulation.place(simulation.positions() + 0.1, (0.0, 1.0, 0.0))
    run(simulation, 2)


@pytest.mark.parametrize("other", ["xpbd", "lines"])
def test_everything_that_can_be_done_is_repeated_bit_for_bit(simulation: Recorded, tmp_path: Path, other: str) -> None:
    everything(simulation, other)
    repeated(simulation, tmp_path / "all.toml")
    simulation.begin_anew()  # and from its middle on, with the other method
    everything(simulation, "verlet")
    everything(simulation, other)
    repeated(simulation, tmp_path / "middle.toml")


def test_pins_fabrics_patches_and_stages_are_repeated_too(simulation: Recorded, tmp_path: Path) -> None:
    run(simulation, 2)
    simulation.pin(12)
    simulation.grab(LAST, (0.4, 1.7, 0.3), radius=0.3)
    simulation.grab(5, (0.0, 1.9, 0.3), hand=3)
    assert len(simulation.held) > 1
    run(simulation, 2)
    simulation.change_solver("xpbd")
    simulation.change_fabric("denim")
    simulation.change(replace(simulation.scene, wind=None))
    run(simulation, 1)
    simulation.grab(LAST, (0.4, 1.8, 0.3), radius=0.1)  # the patch is the one that was taken
    simulation.grab(5, (0.0, 1.9, 0.4), hand=3)
    simulation.pin(12, False)
    run(simulation, 2)
    repeated(simulation, tmp_path / "changes.toml")
    simulation.begin_anew()
    simulation.release()
    run(simulation, 1)
    simulation.release(3)
    run(simulation, 2)
    repeated(simulation, tmp_path / "after.toml")


def test_pins_that_a_reset_takes_back_are_not_drawn_any_more(simulation: Recorded, tmp_path: Path) -> None:
    run(simulation, 1)
    simulation.pin(12)
    run(simulation, 1)
    simulation.reset()
    Recording.of(simulation, SIZE).write(tmp_path / "pins.toml")
    with closing(Rerun(read_recording(tmp_path / "pins.toml"))) as rerun:
        drawn = []
        while not rerun.over:
            rerun.forward()
            drawn.append(rerun.draw_list._pins.tolist())
        assert drawn == [[12], []]


def test_tears_are_repeated_from_the_middle_too(tmp_path: Path) -> None:
    cloth = Cloth(rows=6, columns=7, width=0.8, height=0.7, pins=("left", "right"), area_density=6.0)
    fabric = Fabric(warp=300.0, weft=300.0, shear=100.0, bend=1.0)
    with Recorded(Scene(cloth=cloth, fabric=fabric, solver=Solver("xpbd", 10), tear=Tear(0.1))) as simulation:
        run(simulation, 30)
        simulation.begin_anew()
        assert simulation.torn.any()
        simulation.pin(16)
        run(simulation, 2)
        simulation.change_solver("verlet")
        run(simulation, 2)
        again = repeated(simulation, tmp_path / "torn.toml").simulation
        np.testing.assert_array_equal(again.torn, simulation.torn)
        simulation.reset()
        run(simulation, 2)
        repeated(simulation, tmp_path / "mended.toml")


def test_a_mesh_of_ones_own_is_found_from_where_the_recording_lies(tmp_path: Path) -> None:
    (tmp_path / "flap.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 4 3 2 1\n")
    (tmp_path / "half.csv").write_text("1\n1\n0\n0.2\n")
    (tmp_path / "flap.toml").write_text('[cloth]\nfile = "flap.obj"\npins = [0]\n[maps]\npin = "half.csv"\n')
    (tmp_path / "out").mkdir()
    with Recorded(load_scene(tmp_path / "flap.toml")) as simulation:
        run(simulation, 2)
        repeated(simulation, tmp_path / "out" / "flap.toml")
    np.save(tmp_path / "half.npy", np.linspace(0, 1, 20))
    with Recorded(replace(SMALL, maps=Maps(pin="half.npy", folder=str(tmp_path)))) as simulation:
        run(simulation, 2)
        repeated(simulation, tmp_path / "out" / "map.toml")


def test_a_recording_may_begin_in_the_middle_of_a_drag(simulation: Recorded, tmp_path: Path) -> None:
    simulation.set("gravity", 3.0)
    simulation.grab(LAST, (0.3, 1.5, 0.3))
    run(simulation, 2)
    simulation.set("sphere_radius", 0.45)  # grown around particles: they are let out slowly
    simulation.begin_anew()
    assert simulation.take.first_frame == 2
    simulation.grab(LAST, (0.3, 1.5, 0.35))
    run(simulation, 2)
    simulation.release()
    run(simulation, 2)
    rerun = repeated(simulation, tmp_path / "middle.toml")
    assert rerun.repeated == 4


def test_a_loaded_state_is_in_the_recording(simulation: Recorded, tmp_path: Path) -> None:
    run(simulation, 3)
    simulation.save(tmp_path / "save.npz")
    run(simulation, 2)
    simulation.load(tmp_path / "save.npz")
    (tmp_path / "save.npz").unlink()
    run(simulation, 1)
    repeated(simulation, tmp_path / "loaded.toml")


def test_a_change_of_the_last_bit_of_an_input_is_noticed(simulation: Recorded, tmp_path: Path) -> None:
    simulation.grab(LAST, (0.3, 1.5, 0.3))
    run(simulation, 2)
    good = Recording.of(simulation, SIZE)
    frame, call, (index, x, *rest) = good.rows[0]
    other = replace(good, rows=((frame, call, (index, float(np.nextafter(np.float32(x), np.float32(1))), *rest)),))
    for recording, is_equal in ((good, True), (other, False)):
        with closing(Rerun(recording)) as rerun:
            rerun.forward()
            assert not rerun.over
            rerun.forward()
            assert rerun.is_equal is is_equal
            assert ("NOT" in rerun.verdict) is not is_equal


def test_a_method_that_cannot_be_had_is_repeated_too(tmp_path: Path) -> None:
    """To be refused has taken the cloth out of its fields and put it back."""
    light = replace(
        SMALL,
        fabric=replace(SMALL.fabric, warp=1e9, weft=1e9),
        cloth=replace(SMALL.cloth, width=0.2, height=0.16, area_density=0.001),
    )
    with Recorded(light) as simulation:
        run(simulation, 2)
        with pytest.raises(WrongUse, match="spring would take"):
            simulation.change_solver("spring")
        run(simulation, 2)
        assert simulation.take.rows == [(2, "change_solver", ("spring",))]
        repeated(simulation, tmp_path / "refused.toml")


numbers = st.floats(-0.3, 0.3)
actions = st.one_of(
    st.just(("advance_frame",)),
    st.just(("reset",)),
    st.just(("release",)),
    st.tuples(st.just("set"), st.just("wind"), st.booleans()),
    st.tuples(st.just("set"), st.sampled_from(["gravity", "stiffness"]), st.floats(0.1, 1.0)),
    st.tuples(st.just("set"), st.just("sphere_radius"), st.floats(0.1, 0.4)),
    st.tuples(st.just("set"), st.sampled_from(["substeps", "iterations"]), st.integers(1, 6)),
    st.tuples(st.just("change_solver"), st.sampled_from(["verlet", "xpbd"])),
    st.tuples(st.just("grab"), st.integers(0, LAST), st.tuples(numbers, numbers.map(lambda y: 2 + y), numbers)),
    st.just(("begin_anew",)),
)


@given(st.lists(actions, max_size=25))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_is_done_is_repeated_bit_for_bit(tmp_path: Path, calls: list[tuple[object, ...]]) -> None:
    with Recorded(SMALL) as simulation:
        for name, *arguments in calls:
            getattr(simulation, str(name))(*arguments)
            if name == "grab":
                simulation.advance_frame()
        repeated(simulation, tmp_path / "drawn.toml")


# -- what is kept --------------------------------------------------------------------------------------------


def test_between_two_frames_only_the_hands_last_place_is_kept(simulation: Recorded) -> None:
    for target in ((0.0, 1.0, 0.0), (0.0, 1.0, 0.1), (0.0, 1.0, 0.2)):
        simulation.grab(3, target)
    simulation.grab(4, (0.0, 1.0, 0.2))
    simulation.advance_frame()
    simulation.grab(4, (0.0, 1.0, 0.3))
    assert [row for row in simulation.take.rows if row[1] == "grab"] == [
        (0, "grab", (3, 0.0, 1.0, 0.2, 0.0, 0)),
        (0, "grab", (4, 0.0, 1.0, 0.2, 0.0, 0)),
        (1, "grab", (4, 0.0, 1.0, 0.3, 0.0, 0)),
    ]


def test_what_was_refused_is_not_kept_nor_what_did_nothing(simulation: Recorded) -> None:
    for wrong in (lambda: simulation.set("gravity", 1e9), lambda: simulation.grab(99, (0, 0, 0))):
        with pytest.raises(ValueError, match=r"range|does not exist"):
            wrong()
    simulation.release()
    assert simulation.take.rows == []


def test_a_look_is_kept_once() -> None:
    take = Take(0)
    for view in ("shaded", "shaded", "strain", "strain"):
        take.look("view", view)
    assert [row[2] for row in take.rows] == [("shaded",), ("strain",)]


def test_a_take_knows_when_it_is_long() -> None:
    take = Take(0)
    take.frames = LONG
    assert not take.is_long
    take.add("reset")
    assert take.is_long


# -- the file ------------------------------------------------------------------------------------------------


def test_a_file_says_all_that_was_set(simulation: Recorded, tmp_path: Path) -> None:
    simulation.set("gravity", 1 / 3)
    run(simulation, 2)
    Recording.of(simulation, SIZE).write(tmp_path / "a.toml")
    again = read_recording(tmp_path / "a.toml")
    assert again == replace(Recording.of(simulation, SIZE), settings={})
    assert again.scene == SMALL
    assert again.positions == hash_of(simulation)
    assert "gravity = 0.3333333333333333\n" in (tmp_path / "a.toml").read_text()
    assert differences(again) == []
    other = replace(again, made_with={**again.made_with, "taichi": "1.0", "python": "2.7"})
    [line] = differences(other)
    assert line.startswith("recorded with taichi 1.0, repeated with ")


def test_a_users_own_mesh_is_found_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from taichi_cloth.scene import load_scene
    from taichi_cloth.scene.library import asset_folder

    monkeypatch.chdir(tmp_path)
    Path("here").mkdir()
    mesh = min((asset_folder() / "meshes").glob("*.obj"), key=lambda path: path.stat().st_size)
    Path("here/own.obj").write_bytes(mesh.read_bytes())
    Path("here/own.toml").write_text(
        '[cloth]\nrows = 4\ncolumns = 4\n[[meshes]]\nfile = "./own.obj"\ncenter = [0.0, 0.0, 0.0]\n'
    )
    scene = load_scene("here/own.toml")
    Recording(scene, None, SIZE, 0, 0, (), "", {}).write(tmp_path / "a.toml")
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    [found] = read_recording(tmp_path / "a.toml").scene.meshes
    assert Path(found.folder, found.file).samefile(tmp_path / "here" / "own.obj")


@pytest.fixture(scope="module")
def good(taichi: None, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A recording with every kind of row."""
    path = tmp_path_factory.mktemp("good") / "good.toml"
    with Recorded(SMALL) as simulation:
        run(simulation, 1)
        simulation.begin_anew()
        everything(simulation, "xpbd")
        simulation.take.look("view", "strain")
        simulation.take.look("camera", 0.1, 0.2, 3.0, 0.0, 1.0, 0.0)
        Recording.of(simulation, SIZE).write(path)
    return path.read_text()


Change = tuple[str, str]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("[recording]", "[recordings]"), "not a recording: it has no [recording]"),
        (("format = 2", "format = 3"), "recording.format is 3, and this program reads 2"),
        (("format = 2\n", ""), "format must be int, not missing"),
        (("frames = 16", "frames = -1"), "recording.frames must be from 0"),
        (("frames = 16", "frames = 1" + "0" * 30), "recording.frames must be from 0"),
        (("frames = 16", "frames = 5"), "comes after 6 frames: 5 to 5 are left"),
        (("size = [96, 54]", "size = [96, 0]"), "recording.size must be two numbers"),
        (("[done]", "[undone]"), "done must be dict, not missing"),
        (('"release"', '"relase"'), "is not a frame, one of set, "),
        (('"release", 0]', '"release"]'), "not what release needs: []"),
        (('[3, "grab", 19,', '[3, "grab", 1.5,'), "not what grab needs"),
        (('[3, "grab", 19,', '[3, "grab", true,'), "not what grab needs"),
        (('"change_solver", "xpbd"', '"change_solver", "magic"'), "'magic' is not a solver: verlet"),
        (("0.1, 0.2, 3.0", "nan, 0.2, 3.0"), "not what camera needs"),
        (("0.1, 0.2, 3.0", "1e300, 0.2, 3.0"), "not what camera needs"),
        (("rows = 4", "rows = -4"), "scene: cloth.rows"),
        (("[scene.cloth]", "[scene.clothes]"), "did you mean 'cloth'"),
        (("[scene]", "[[["), "not a recording: "),
        # found when it is repeated
        (('[3, "grab", 19,', '[3, "grab", 20,'), "grab: particle 20 does not exist"),
        (('"gravity", 4.1', '"gravity", 1e8'), "set: gravity: 1"),
        (('"gravity", 4.1', '"gravitas", 4.1'), "set: 'gravitas' is not a live parameter"),
        (('"view", "strain"', '"view", "stain"'), "view: 'stain' is no view"),
        (("0.1, 0.2, 3.0", "0.1, 0.2, -3.0"), "camera: a distance is above 0 m"),
        (('"load", "UEs', '"load", "%'), "load: "),
        (('"load", "UEs', '"load", "AAAA'), "load: "),
        (('"place", [[', '"place", [[1.0], ['), "place: positions are 20 times three numbers"),
        (("seed = 0", "seed = 1"), "load: saved from another scene: it has 'seed = 0"),
        (('path = ""', 'path = "roundabout"'), "roundabout"),
    ],
)
def test_what_is_wrong_in_a_file_is_one_line(good: str, tmp_path: Path, change: Change, said: str) -> None:
    before, after = change
    assert before in good
    path = tmp_path / "bad.toml"
    path.write_text(good.replace(before, after, 1))
    with pytest.raises((WrongUse, SceneError)) as caught:
        replay(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_good_file_is_good(good: str, tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text(good)
    assert replay(tmp_path / "good.toml").is_equal


@pytest.mark.parametrize(
    "make",
    [
        lambda path: None,
        lambda path: path.mkdir(),
        lambda path: path.write_bytes(b"\xff\xfe\x00"),
        lambda path: path.write_text("a = " + "[" * 100_000),
        lambda path: path.write_text("cloth.rows = 3"),
        lambda path: path.write_text("recording = 7"),
    ],
)
def test_no_recording_at_all(tmp_path: Path, make: Callable[[Path], object]) -> None:
    path = tmp_path / "bad.toml"
    make(path)
    with pytest.raises(WrongUse, match=r"bad\.toml: (cannot be read|not a recording)"):
        read_recording(path)


@given(st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_files_are_read_or_refused_in_one_line(good: str, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(good.encode())
    places = st.integers(0, len(content) - 1)
    for place in data.draw(st.lists(places, max_size=3), "flipped"):
        content[place] ^= 1 << data.draw(st.integers(0, 7))
    start, end = sorted((data.draw(places, "from"), data.draw(places, "to")))
    match data.draw(st.sampled_from(["flipped", "cut", "doubled"])):
        case "cut":
            del content[start:end]
        case "doubled":
            content[start:start] = content[start:end]
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    try:
        read_recording(path)
    except (WrongUse, SceneError) as error:
        assert "bad.toml" in str(error)
