"""Checkpoints continue in another process bit for bit; a damaged or crafted one is refused and changes nothing."""

from __future__ import annotations

import io
import re
import struct
import subprocess
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import taichi as ti
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from meshes import quads, write_obj

from taichi_cloth.geometry.scene_loader import load_scene, save_scene
from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.schema import Cloth, Maps, Scene, Solver, Wind
from taichi_cloth.simulation.checkpoint import MAX_BYTES
from taichi_cloth.simulation.events import GrabHandle
from taichi_cloth.simulation.parameter_values import MAX_COORDINATE
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system import taichi_runtime as runtime

Run = Callable[..., subprocess.CompletedProcess[str]]
Arrays = dict[str, Any]

SMALL = Scene(
    cloth=Cloth(rows=5, columns=6, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.7, 0.2), radius=0.2),),
)


def run(simulation: Simulation, frames: int) -> None:
    for _ in range(frames):
        simulation.step()


def run_into_a_drag(simulation: Simulation) -> GrabHandle:
    """Run ten frames, with changed parameters and a moving grab in the last of them. Return the grab."""
    run(simulation, 6)
    simulation.params["gravity"] = 4.0
    simulation.params["substeps"] = 7
    grab = simulation.grab(25, radius=0.6)
    for k in range(4):
        grab.move_to(simulation.positions()[25] + [0.0, 0.01 * k, 0.02])
        simulation.step()
    return grab


CONTINUE = """
from taichi_cloth import init, load_scene
init()
from taichi_cloth.simulation.events import GrabHandle
from taichi_cloth.simulation.simulation import Simulation
with Simulation(load_scene("curtain", rows=8, columns=10)) as simulation:
    simulation.load("save.npz")
    simulation.step()
    GrabHandle(simulation, 0).release()
    for _ in range(5):
        simulation.step()
    simulation.save("end.npz")
"""


def test_another_process_continues_bit_for_bit(program: Run, tmp_path: Path) -> None:
    with Simulation(load_scene("curtain", rows=8, columns=10)) as simulation:
        grab = run_into_a_drag(simulation)
        simulation.save(tmp_path / "save.npz")
        simulation.step()
        grab.release()
        run(simulation, 5)
        simulation.save(tmp_path / "mine.npz")
    done = program("-c", CONTINUE)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "end.npz").read_bytes() == (tmp_path / "mine.npz").read_bytes()


@pytest.mark.parametrize("on", [True, False])
def test_the_wind_switch_is_saved(tmp_path: Path, on: bool) -> None:
    with Simulation(SMALL) as simulation, Simulation(SMALL) as other:
        simulation.params["wind"] = on
        run(simulation, 3)
        simulation.save(tmp_path / "save.npz")
        other.params["wind"] = not on
        other.load(tmp_path / "save.npz")
        assert other.params["wind"] is on
        for one in (simulation, other):
            run(one, 3)
        assert (simulation.positions() == other.positions()).all()
        other.params["wind"] = not on
        other.load(tmp_path / "save.npz")
        other.params["wind"] = not on
        run(other, 3)
        assert (simulation.positions() != other.positions()).any()  # the wind has an effect here


@pytest.mark.parametrize("arch", ["cuda", "vulkan", "metal"])
def test_another_arch_continues_with_the_same_cloth(tmp_path: Path, arch: str) -> None:
    """From the CPU to that arch, and back."""
    if not ti.lang.misc.is_arch_supported(getattr(ti, arch)):
        pytest.skip(f"this machine has no {arch}")
    scene = load_scene("curtain", rows=8, columns=10, substeps=2, iterations=3)
    path = tmp_path / "save.npz"
    with Simulation(scene) as simulation:
        run(simulation, 5)
        simulation.grab(25).move_to(simulation.positions()[25] + [0.0, 0.0, 0.05])
        run(simulation, 1)
        simulation.save(path)
        run(simulation, 4)
        end = simulation.positions()
    for name in (arch, "cpu"):
        runtime.start(name)
        with Simulation(scene) as simulation:
            simulation.load(path)
            assert simulation.grabbed.tolist() == [25]
            run(simulation, 2)
            simulation.save(path)
            elsewhere = simulation.positions()
    assert simulation.frame == 10
    assert elsewhere == pytest.approx(end, abs=1e-4)


# -- damaged checkpoints ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulation(taichi: None) -> Iterator[Simulation]:
    with Simulation(SMALL) as simulation:
        run(simulation, 2)
        yield simulation


@pytest.fixture(scope="module")
def good(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A checkpoint of another frame, with a grab."""
    path = tmp_path_factory.mktemp("good") / "good.npz"
    with Simulation(SMALL) as other:
        run_into_a_drag(other)
        other.save(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def refused(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], str]:
    """refused(content): returns the error message, and checks that the simulation has not changed."""
    path, now = (tmp_path_factory.mktemp("saves") / name for name in ("bad.npz", "now.npz"))

    def line(content: bytes) -> str:
        path.write_bytes(content)
        simulation.save(now)
        before = now.read_bytes()
        with pytest.raises(ValueError, match=r"bad\.npz") as caught:
            simulation.load(path)
        simulation.save(now)
        assert now.read_bytes() == before
        assert "\n" not in str(caught.value)
        return str(caught.value)

    return line


def arrays_of(content: bytes) -> Arrays:
    with np.load(io.BytesIO(content)) as archive:
        return dict(archive)


def packed(arrays: Arrays) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def test_the_valid_checkpoint_loads_and_repacks_to_the_same_bytes(
    simulation: Simulation, good: bytes, tmp_path: Path
) -> None:
    assert packed(arrays_of(good)) == good
    simulation.save(tmp_path / "now.npz")
    (tmp_path / "good.npz").write_bytes(good)
    simulation.load(tmp_path / "good.npz")
    simulation.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == good
    simulation.load(tmp_path / "now.npz")


def changed(name: str, value: Any) -> Callable[[Arrays], Arrays]:
    return lambda arrays: arrays | {name: np.asarray(value(arrays[name]) if callable(value) else value)}


def one_element(value: float) -> Callable[[Any], Any]:
    def put(array: Any) -> Any:
        array = array.copy()
        array.flat[4] = value
        return array

    return put


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("x", lambda x: x[:-1]), "x is float32 of shape (29, 3), not float32 of shape (30, 3)"),
        (changed("x", lambda x: x.astype(np.float64)), "x is float64"),
        (changed("x", lambda x: x.astype("U9")), "x is <U"),
        (changed("x", lambda x: x.astype(np.complex64)), "x is complex64"),
        (changed("x", lambda x: x.astype(object)), "x is object"),
        (changed("x", one_element(np.nan)), "x is not finite"),
        (changed("x", one_element(1e30)), "invalid number in x: beyond ±1e+06 at particle 1"),
        (changed("velocity", one_element(-np.inf)), "velocity is not finite"),
        (changed("velocity", one_element(2 * MAX_COORDINATE)), "invalid number in velocity: beyond"),
        (changed("grab_paths", one_element(1e300)), "invalid number in grab_paths: beyond"),
        (changed("grab_paths", lambda rows: rows[:2]), "grabs have 2 path positions for [6]"),
        (changed("grabs", [[0, 12, 2]]), "grabs have 6 path positions for [2]"),
        (changed("grab_paths", lambda rows: rows[:0]), "grabs have 0 path positions for [6]"),
        (changed("grabs", [[8, 12, 6]]), "grab numbers must be unique and in 0..7, got [8]"),
        (changed("grabs", [[1, 6, 3], [1, 6, 3]]), "grab numbers must be unique and in 0..7, got [1, 1]"),
        (changed("grabs", [[1, 0, 3], [2, 12, 3]]), "grabs have 12 particles with 12 positions for [0, 12]"),
        (changed("grabbed_at", lambda rows: rows[1:]), "grabs have 12 particles with 11 positions for [12]"),
        (changed("grabbed_at", one_element(1e300)), "invalid number in grabbed_at: beyond"),
        (changed("grab_paths", lambda rows: rows[:, :2]), "grab_paths is float64 of shape (6, 2)"),
        (
            changed("grab_paths", lambda rows: np.zeros((MAX_BYTES // 24 + 1, 3))),
            "grab_paths is float64 of shape (699051, 3)",
        ),
        (changed("grabbed", 30), "grabbed is int64 of shape ()"),
        (changed("grabbed", lambda ids: 0 * ids + 25), "grabs have 12 particles with 12 positions for [12]"),
        (changed("grabbed", lambda ids: ids - 30), "grabs have 12 particles with 12 positions for [12]"),
        (changed("grabbed", lambda ids: ids[:0]), "grabs have 0 particles with 12 positions for [12]"),
        (changed("grabbed", lambda ids: 1.0 * ids), "grabbed is float64"),
        (changed("pinned", lambda pinned: pinned[1:]), "pinned is bool of shape (29,)"),
        (changed("frame", -1), "damaged: frame is -1"),
        (changed("frame", [1]), "frame is int64 of shape (1,)"),
        (changed("params", lambda params: params[:-1]), "params is float64 of shape (7,), not float64 of shape (8,)"),
        (changed("params", lambda params: 0 * params), "sphere_radius: 0.0 is out of range: above 0 to 1000 m"),
        (changed("params", lambda params: [*params[:-1], 1.5]), "substeps: must be an integer, got 1.5"),
        (changed("wind_on", 2), "wind_on is int64 of shape (), not bool of shape ()"),
        (changed("scene", "seed = 3"), "a checkpoint of another scene: it has 'seed = 3', this one 'seed = 0'; switch"),
        (changed("scene", lambda text: str(text) + "# more"), "a checkpoint of another scene"),
        (
            changed("scene", lambda text: str(text).replace("turbulence = ", "turbulence = 1")),
            "in [wind]; switch to its solver, fabric or scene",
        ),
        (
            changed("scene", lambda text: str(text).replace("[wind]", "[ground]")),
            "another scene: it has '[ground]', this one has not; switch to its",
        ),
        (
            changed("scene", lambda text: re.sub(r"\[wind\][^[]*", "", str(text))),
            "another scene: this one has '[wind]'; switch to its",
        ),
        (changed("scene", b"bytes"), "scene is |S5"),
        (lambda arrays: {k: v for k, v in arrays.items() if k != "x"}, "no item named 'x.npy'"),
    ],
)
def test_the_error_names_what_is_wrong_in_a_checkpoint(
    refused: Callable[[bytes], str], good: bytes, change: Callable[[Arrays], Arrays], message: str
) -> None:
    assert message in refused(packed(change(arrays_of(good))))


def with_header(good: bytes, name: str, header: str, method: int = zipfile.ZIP_STORED, data: bytes = b"") -> bytes:
    """The valid checkpoint with another header for one of its arrays."""
    text = header.encode().ljust(118) + b"\n"
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(good)) as old, zipfile.ZipFile(file, "w", method) as new:
        for entry in old.namelist():
            npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data
            new.writestr(entry, npy if entry == f"{name}.npy" else old.read(entry))
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "header"),
    [
        ("x", "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 3), }"),
        ("grab_paths", "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3), }"),
        ("grab_paths", "{'descr': '<f8', 'fortran_order': False, 'shape': (-5, 3), }"),
        ("scene", "{'descr': '<U500000000', 'fortran_order': False, 'shape': (), }"),
        ("x", "{'descr': '|O', 'fortran_order': False, 'shape': (30, 3), }"),
        ("x", "{'descr': " + "(" * 50 + ", 'fortran_order': False, 'shape': (30, 3), }"),
        ("x", "open('made by the header', 'w')"),
    ],
)
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_header_with_a_huge_shape_allocates_no_memory(
    refused: Callable[[bytes], str], good: bytes, name: str, header: str, method: int
) -> None:
    assert "not a checkpoint (" in refused(with_header(good, name, header, method, bytes(1_000_000)))


def test_files_that_are_not_checkpoints_are_refused(refused: Callable[[bytes], str], good: bytes) -> None:
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    for content in (array.getvalue(), b"PK\x05\x06" + bytes(18), zlib.compress(good), bytes(10_000)):
        assert "not a checkpoint (" in refused(content)
    assert "it is larger than" in refused(bytes(3 * MAX_BYTES))


@given(st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_cut_or_doubled_bytes_are_detected(
    simulation: Simulation, good: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(good)
    offsets = st.integers(0, len(good) - 1)
    for offset in data.draw(st.lists(offsets, max_size=3), "flipped"):
        content[offset] ^= 1 << data.draw(st.integers(0, 7))
    start, end = sorted((data.draw(offsets, "from"), data.draw(offsets, "to")))
    match data.draw(st.sampled_from(["flipped", "cut", "doubled", "zeroed"])):
        case "cut":
            del content[start:end]
        case "doubled":
            content[start:start] = content[start:end]
        case "zeroed":
            content[start:end] = bytes(end - start)
    folder = tmp_path_factory.getbasetemp()
    bad, now, after = (folder / name for name in ("bad.npz", "now.npz", "after.npz"))
    bad.write_bytes(content)
    simulation.save(now)
    try:
        simulation.load(bad)
    except ValueError:
        simulation.save(after)
        assert after.read_bytes() == now.read_bytes()
    else:  # the changed bytes have no meaning, such as the date of an entry
        simulation.save(after)
        assert after.read_bytes() == good
        simulation.load(now)


def test_a_checkpoint_on_a_full_disk_keeps_the_old_file(disk: Callable[..., Path], simulation: Simulation) -> None:
    folder = disk("small", "size=32k")
    simulation.save(folder / "save.npz")
    before = (folder / "save.npz").read_bytes()
    with (
        Simulation(replace(SMALL, cloth=Cloth(rows=30, columns=40))) as large,
        pytest.raises(OSError, match=r"No space left on device: '.*save\.npz'"),
    ):
        large.save(folder / "save.npz")
    assert (folder / "save.npz").read_bytes() == before
    assert [path.name for path in folder.iterdir()] == ["save.npz"]


def test_a_checkpoint_needs_the_name_of_a_file(simulation: Simulation) -> None:
    with pytest.raises(OSError, match=r"Is a directory: '\.'"):
        simulation.save("")


def test_a_checkpoint_loads_into_the_saved_scene_in_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of meshes and maps are compared by name; `save_scene` writes other paths to them."""
    monkeypatch.chdir(tmp_path)
    write_obj(tmp_path / "sheet.obj", *quads(4, 5))
    np.save(tmp_path / "map.npy", np.ones(20))
    scene = Scene(cloth=Cloth(file="sheet.obj", pins=(0,)), maps=Maps(stiffness="map.npy"), solver=Solver("explicit"))
    save_scene(scene, tmp_path / "results" / "run.toml")
    other = load_scene(scene, cloth_file=str(write_obj(tmp_path / "other.obj", *quads(4, 5))))
    with Simulation(scene) as simulation:
        simulation.step(3)
        simulation.save("results/run.npz")
        expected = simulation.positions()
    with Simulation(load_scene(tmp_path / "results" / "run.toml")) as simulation:
        simulation.load("results/run.npz")
        assert (simulation.positions() == expected).all()
    with (
        Simulation(other) as simulation,
        pytest.raises(ValueError, match=r"a checkpoint of another scene: it has 'file = \"sheet\.obj\"', this one "),
    ):
        simulation.load("results/run.npz")
