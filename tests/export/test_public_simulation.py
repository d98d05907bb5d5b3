"""`tc.Simulation`: the running cloth as a file, as arrays and as an image, also after a replay."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import taichi_cloth as tc
from taichi_cloth.scene.schema import SOLVER_NAMES
from taichi_cloth.simulation.simulation import Simulation as BaseSimulation

pytestmark = pytest.mark.usefixtures("serial_layout")


def small() -> tc.Scene:
    return tc.load_scene("drape15", rows=5, columns=6)


def rows_of(file: Path, keyword: str) -> np.ndarray:
    lines = [line.split() for line in file.read_text(encoding="utf-8").splitlines()]
    return np.array([[float(word.split("/")[0]) for word in words[1:]] for words in lines if words[:1] == [keyword]])


def test_the_running_cloth_is_exported(tmp_path: Path) -> None:
    with tc.Simulation(small()) as simulation:
        simulation.step(10)
        simulation.export(tmp_path / "c.obj")
        tc.export_mesh(simulation, str(tmp_path / "same.obj"))
        simulation.export(tmp_path / "z.obj", up="z")
        simulation.export(tmp_path / "c.PLY")
        assert rows_of(tmp_path / "c.obj", "v") == pytest.approx(simulation.positions(), abs=1e-8)
        assert (rows_of(tmp_path / "c.obj", "f") == simulation.triangles + 1).all()
        x, y, z = rows_of(tmp_path / "z.obj", "v").T
        assert pytest.approx(simulation.positions(), abs=1e-8) == np.array([x, z, -y]).T
    assert (tmp_path / "same.obj").read_bytes() == (tmp_path / "c.obj").read_bytes()
    assert (tmp_path / "c.PLY").read_bytes().startswith(b"ply\n")


def test_a_step_tells_that_the_cloth_has_blown_up() -> None:
    """The state stays as it is; a reset brings the cloth back, and its frames are those of an unchecked run."""
    with tc.Simulation(small()) as simulation, BaseSimulation(small()) as unchecked:
        simulation.step(13)
        unchecked.step(13)
        assert simulation.positions().tobytes() == unchecked.positions().tobytes()
        x = simulation.positions()
        simulation.set_state(x, (0.0, -1e6, 0.0))  # [m/s]
        for _ in range(9):
            simulation.step()
        simulation.set_state(x, (0.0, -1e6, 0.0))
        with pytest.raises(tc.Diverged, match=r"^the cloth blew up in frame 23: try 2 substeps instead of 1,"):
            simulation.step()
        assert (simulation.frame, simulation.closed) == (23, False)
        simulation.reset()
        simulation.step(16)
        unchecked.step(3)
        assert simulation.positions().tobytes() == unchecked.positions().tobytes()
        simulation.switch_solver("xpbd")  # which has another state
        simulation.step(10)


def test_the_error_of_blown_up_cloth_is_refused_with_the_same_words() -> None:
    with tc.Simulation(small()) as simulation:
        simulation.set_state(simulation.positions(), (0.0, -1e6, 0.0))  # [m/s]
        with pytest.raises(tc.Diverged, match=r"^the cloth blew up in frame 1: try 2 substeps instead of 1,"):
            simulation.step(2, measure_error=True)
        assert (simulation.frame, simulation.frame_error) == (1, None)
        simulation.reset()
        simulation.step(measure_error=True)
        assert simulation.frame_error is not None


def test_a_simulation_that_has_stepped_is_freed_with_its_last_reference() -> None:
    simulation = tc.Simulation(small())
    simulation.step()
    reference = weakref.ref(simulation)
    gc.disable()
    try:
        del simulation
        assert reference() is None
    finally:
        gc.enable()


def test_triangles_are_a_copy_in_the_order_of_the_particles() -> None:
    with tc.Simulation(small()) as simulation:
        triangles = simulation.triangles
        assert triangles.shape == (2 * 4 * 5, 3)
        assert np.issubdtype(triangles.dtype, np.integer)
        a, b, c = (simulation.positions()[corner] for corner in triangles.T)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        assert area == pytest.approx(simulation.scene.cloth.width * simulation.scene.cloth.height)
        triangles[:] = 0
        assert simulation.triangles.any()


@pytest.mark.parametrize(
    ("name", "up", "line"),
    [
        ("c.xyz", "y", "c.xyz: unknown suffix '.xyz'; use .obj, .ply, .usdc, .usda, .usd, .glb"),
        ("c", "y", "c: unknown suffix ''; use .obj, .ply, .usdc, .usda, .usd, .glb"),
        (
            "c.pc2",
            "y",
            "c.pc2: a PC2 file holds a clip, not one frame; use .obj, .ply, .usdc, .usda, .usd, .glb;"
            " export_clip writes clips",
        ),
        ("c.glb", "z", "the up axis z does not apply to glTF files, in which y is up"),
        ("c.obj", "x", "unknown up axis 'x': use y or z"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, up: str, line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with tc.Simulation(small()) as simulation:
        with pytest.raises(tc.UsageError) as caught:
            simulation.export(name, up)
        assert str(caught.value) == line
    assert list(tmp_path.iterdir()) == []


def test_whatever_is_saved_makes_its_folder_and_refuses_a_file_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with tc.Simulation(small()) as simulation:
        recorder = tc.Recorder(simulation)
        saves: dict[str, Callable[[Path], None]] = {
            "c.obj": simulation.export,
            "c.pc2": lambda path: simulation.export_clip(path, 1),
            "c.npz": simulation.save,
            "c.toml": recorder.save,
            "c.png": tc.render_image(simulation, (16, 9)).save,
            "c.webp": lambda path: tc.render_video(simulation, path, 1, (16, 9)),
        }
        for name, save in saves.items():
            save(tmp_path / name.replace(".", "") / "new" / name)
            assert (tmp_path / name.replace(".", "") / "new" / name).stat().st_size > 0
            with pytest.raises(OSError, match=r"file'"):
                save(tmp_path / "file" / name)
    assert (tmp_path / "file").read_bytes() == b""


def test_a_clip_has_what_a_program_does_with_the_cloth(tmp_path: Path) -> None:
    with tc.Simulation(small()) as simulation:
        grab = simulation.grab(29)
        samples = [simulation.positions()]

        def pull(k: int) -> None:
            if k == 2:
                simulation.pin(0)
            grab.move_to(simulation.positions()[29] + [0.0, 0.01, 0.0])
            if k % 2 == 1:
                samples.append(simulation.positions())

        simulation.export_clip(tmp_path / "new" / "c.pc2", 6, every=2, on_frame=pull)
        assert simulation.frame == 6
        cache = np.frombuffer((tmp_path / "new" / "c.pc2").read_bytes(), "<f4", offset=32).reshape(3, -1, 3)
        assert cache == pytest.approx(np.array(samples[:3]), abs=1e-6)
        assert rows_of(tmp_path / "new" / "c.obj", "v") == pytest.approx(samples[0], abs=1e-6)


@pytest.mark.parametrize(
    ("name", "format"),
    [("c.glb", None), ("c.html", None), ("c.usdc", None), ("c.usdc", "usd"), ("folder", None), ("folder", "ply")],
)
def test_a_clip_has_the_format_of_its_suffix_or_the_chosen_one(tmp_path: Path, name: str, format: str | None) -> None:
    if name == "c.usdc":
        pytest.importorskip("pxr")
    with tc.Simulation(small()) as simulation:
        for frames in (4, 2):  # the second replaces the first
            simulation.export_clip(tmp_path / name, frames, format=format)
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    suffix = format or "obj"
    assert found == ([f"folder/frame_0000{k}.{suffix}" for k in range(2)] if name == "folder" else [name])


@pytest.mark.parametrize(
    ("name", "frames", "format", "error", "line"),
    [
        ("c.obj", 2, None, tc.UsageError, "a clip of OBJ files is a folder; omit the suffix"),
        ("c.xyz", 2, None, tc.UsageError, "unknown suffix '.xyz'; use .pc2, .usdc, .usda, .usd, .glb, .html, or no"),
        ("folder", 2, "pyl", tc.UsageError, "unknown format 'pyl': obj, ply, pc2, usd, glb, html; did you mean 'ply'"),
        ("c.glb", 2, "ply", tc.UsageError, "has the suffix of GLB files, but the format is ply"),
        ("c.pc2", 0, None, ValueError, "frames must be an integer from 1, not 0"),
        ("c.pc2", 1.5, None, ValueError, "frames must be an integer from 1, not 1.5"),
    ],
)
def test_a_clip_that_cannot_be_written_is_refused_before_the_first_frame(
    tmp_path: Path, name: str, frames: int, format: str | None, error: type[Exception], line: str
) -> None:
    with tc.Simulation(small()) as simulation:
        with pytest.raises(error, match=line):
            simulation.export_clip(tmp_path / name, frames, format=format)
        assert simulation.frame == 0
    assert list(tmp_path.iterdir()) == []


def test_a_replayed_simulation_can_do_the_same(tmp_path: Path) -> None:
    with tc.Simulation(small()) as simulation:
        recorder = tc.Recorder(simulation)
        simulation.step(3)
        simulation.pin(20)
        simulation.step(3)
        recorder.save(tmp_path / "run.toml")
        positions = simulation.positions()
    with tc.replay(tmp_path / "run.toml") as replayed:
        assert isinstance(replayed, tc.Simulation)
        assert (replayed.positions() == positions).all()
        replayed.export(tmp_path / "c.obj")
        assert replayed._repr_png_() is not None


def test_what_needs_a_simulation_refuses_a_scene_in_one_line(taichi: None, tmp_path: Path) -> None:
    scene = tc.Scene(cloth=tc.Cloth(rows=3, columns=3))
    for needs_a_simulation in (
        tc.render_image,
        tc.Recorder,
        lambda one: tc.export_mesh(one, tmp_path / "a.obj"),
        lambda one: tc.render_video(one, tmp_path / "a.webp", 1),
    ):
        for wrong in (scene, "curtain"):
            with pytest.raises(TypeError, match=r"a simulation is needed, not a \w+: use tc\.Simulation\(scene\)"):
                needs_a_simulation(wrong)  # type: ignore[operator]
    with pytest.raises(TypeError, match=r"a simulation is needed, not a int$"):
        tc.render_image(3)  # type: ignore[arg-type]


def test_a_misspelled_parameter_cannot_be_set_as_an_attribute(taichi: None) -> None:
    with tc.Simulation({"cloth": {"rows": 3, "columns": 3}}) as simulation:
        with pytest.raises(AttributeError):
            simulation.params.gravity = 3.0  # type: ignore[attr-defined]
        assert repr(simulation.topology) == "<Topology: 9 particles, 26 springs, 8 triangles>"


def test_a_cloth_that_has_left_the_picture_is_framed_again(taichi: None) -> None:
    cloth = tc.Cloth(rows=5, columns=5, width=0.4, height=0.4)
    for camera, shown in ((tc.Camera(), True), (tc.Camera(eye=(0.0, 2.2, 2.0), target=(0.0, 2.2, 0.0)), False)):
        with tc.Simulation(tc.Scene(cloth=cloth, camera=camera)) as simulation:
            for height in (0.0, 3.0):
                simulation.set_state(simulation.topology.start + [0.0, height, 0.0])
                image = np.asarray(tc.render_image(simulation, size=(64, 36))).astype(int)
                red = (image[:, :, 0] > image[:, :, 2] + 60).sum()
                assert (red > 20) == (shown or height == 0.0)


def test_the_names_of_solvers_are_those_that_a_scene_may_have() -> None:
    assert tc.list_solvers() == list(SOLVER_NAMES)


def test_warnings_tell_cloth_that_has_blown_up_slower_than_divergence_is_seen(taichi: None) -> None:
    """A spring of three times its length: no speed needs to be large."""
    with tc.Simulation(tc.load_scene("curtain", columns=8, rows=8, solver="implicit")) as simulation:
        x = simulation.positions()
        simulation.set_state(x * [1.9, 1.9, 1.9])
        assert "times as long" not in simulation.warnings
        simulation.set_state(x * [3.0, 1.0, 1.0])
        assert "a spring is 3 times as long as at rest: the cloth may have blown up" in simulation.warnings


def test_warnings_tell_iterations_that_do_not_converge(taichi: None) -> None:
    with tc.Simulation(tc.load_scene("drape15", solver={"name": "xpbd", "substeps": 5, "iterations": 1})) as simulation:
        assert "not converged: " in simulation.warnings
        simulation.params["substeps"], simulation.params["iterations"] = 60, 40
        assert simulation.warnings == ""


def test_a_key_that_is_no_parameter_says_why(taichi: None) -> None:
    with tc.Simulation({"cloth": {"rows": 3, "columns": 3}}) as simulation:
        assert simulation.params["wind"] is False
        for name, reason in (
            ("wind_z", r"it has no \[wind\]; load_scene adds one, as in load_scene\(scene, wind=\{\.\.\.\}\)"),
            ("wind", r"it has no \[wind\]; load_scene adds one"),
            ("rows", "cloth.rows cannot change while the scene runs; load_scene sets it"),
            ("solver", "solver.name is changed by switch_solver, not by a parameter"),
            ("warp", "fabric.warp is changed by switch_fabric and switch_scene, not by a parameter"),
            ("fov", "camera.fov is changed by switch_scene, not by a parameter"),
            ("dampin", r"gravity, .*; did you mean 'damping'\?"),
        ):
            with pytest.raises(ValueError, match=f"'{name}' is not a parameter of this scene: {reason}"):
                simulation.params[name] = 3.0


def test_several_parameters_are_set_together_or_not_at_all(taichi: None) -> None:
    with tc.Simulation({"cloth": {"rows": 3, "columns": 3}}) as simulation:
        before = dict(simulation.params)
        for values, wrong in (({"gravity": 3.0, "gravty": 1.0}, "gravty"), ({"damping": 1.0, "gravity": "low"}, "low")):
            with pytest.raises(ValueError, match=wrong):
                simulation.params.update(values)
            assert dict(simulation.params) == before
        simulation.params.update([("gravity", 3.0)], damping=1.0)
        assert dict(simulation.params) == {**before, "gravity": 3.0, "damping": 1.0}


@pytest.mark.parametrize("name", ["curtain", "banner", "stack"])
def test_a_tuned_scene_has_the_values_of_the_parameters(taichi: None, name: str, tmp_path: Path) -> None:
    with tc.Simulation(name) as simulation:
        assert simulation.tuned_scene() == simulation.scene
        values = {key: 0.9 * value for key, value in simulation.params.items() if isinstance(value, float)}
        simulation.params.update(values)
        simulation.params["substeps"] = 7
        tc.save_scene(simulation.tuned_scene(), tmp_path / "tuned.toml")
    with tc.Simulation(tmp_path / "tuned.toml") as again:
        assert dict(again.params) == {**values, "substeps": 7, "iterations": again.params["iterations"]}


def test_a_tuned_scene_without_wind_has_air_at_rest(taichi: None) -> None:
    """Which slows the cloth: it moves with the same bits as the one whose wind was switched off."""
    with tc.Simulation("banner") as simulation:
        simulation.params["wind"] = False
        tuned = simulation.tuned_scene()
        assert tuned == tc.load_scene("banner", wind_x=0.0, wind_z=0.0)
        simulation.step(60)
        expected = simulation.positions()
    with tc.Simulation(tuned) as again:
        again.step(60)
        assert (again.positions() == expected).all()
