"""Saves: they go on elsewhere bit for bit, and a damaged or crafted one is refused with nothing changed."""

from __future__ import annotations

import io
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

from taichi_cloth import runtime
from taichi_cloth.given import FARTHEST
from taichi_cloth.save_file import MOST_BYTES
from taichi_cloth.scene import load_scene
from taichi_cloth.scene.model import Cloth, Scene, Sphere, Wind
from taichi_cloth.simulation import Simulation

Run = Callable[..., subprocess.CompletedProcess[str]]
Arrays = dict[str, Any]

SMALL = Scene(
    cloth=Cloth(rows=5, columns=6, width=1.0, height=0.8, center=(0.0, 2.0, 0.0)),
    wind=Wind(z=2.0),
    spheres=(Sphere(center=(0.0, 1.7, 0.2), radius=0.2),),
)


def run(simulation: Simulation, frames: int) -> None:
    for _ in range(frames):
        simulation.advance_frame()


def in_the_middle_of_a_drag(simulation: Simulation) -> None:
    """Ten frames, the last of them with a moving hand, and with sliders that were moved."""
    run(simulation, 6)
    simulation.set("gravity", 4.0)
    simulation.set("substeps", 7)
    for k in range(4):
        simulation.grab(25, simulation.positions()[25] + [0.0, 0.01 * k, 0.02], radius=0.6)
        simulation.advance_frame()


ELSEWHERE = """
import sys
from taichi_cloth import load_scene, start
start()
from taichi_cloth.simulation import Simulation
with Simulation(load_scene("curtain", rows=8, columns=10)) as simulation:
    simulation.load("save.npz")
    simulation.advance_frame()
    simulation.release()
    for _ in range(5):
        simulation.advance_frame()
    simulation.save("end.npz")
"""


def test_another_process_goes_on_bit_for_bit(program: Run, tmp_path: Path) -> None:
    with Simulation(load_scene("curtain", rows=8, columns=10)) as simulation:
        in_the_middle_of_a_drag(simulation)
        simulation.save(tmp_path / "save.npz")
        simulation.advance_frame()
        simulation.release()
        run(simulation, 5)
        simulation.save(tmp_path / "mine.npz")
    done = program("-c", ELSEWHERE)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "end.npz").read_bytes() == (tmp_path / "mine.npz").read_bytes()


@pytest.mark.parametrize("on", [True, False])
def test_the_wind_switch_is_saved(tmp_path: Path, on: bool) -> None:
    with Simulation(SMALL) as simulation, Simulation(SMALL) as other:
        simulation.set("wind", on)
        run(simulation, 3)
        simulation.save(tmp_path / "save.npz")
        other.set("wind", not on)
        other.load(tmp_path / "save.npz")
        assert other.get("wind") is on
        for one in (simulation, other):
            run(one, 3)
        assert (simulation.positions() == other.positions()).all()
        other.set("wind", not on)
        other.load(tmp_path / "save.npz")
        other.set("wind", not on)
        run(other, 3)
        assert (simulation.positions() != other.positions()).any()  # the switch does something here


@pytest.mark.parametrize("arch", ["cuda", "vulkan", "metal"])
def test_another_arch_goes_on_with_the_same_cloth(tmp_path: Path, arch: str) -> None:
    """From the CPU to it, and back."""
    if not ti.lang.misc.is_arch_supported(getattr(ti, arch)):
        pytest.skip(f"this machine has no {arch}")
    scene = load_scene("curtain", rows=8, columns=10, substeps=2, iterations=3)
    path = tmp_path / "save.npz"
    with Simulation(scene) as simulation:
        run(simulation, 5)
        simulation.grab(25, simulation.positions()[25] + [0.0, 0.0, 0.05])
        run(simulation, 1)
        simulation.save(path)
        run(simulation, 4)
        end = simulation.positions()
    for name in (arch, "cpu"):
        runtime.start(name)
        with Simulation(scene) as simulation:
            simulation.load(path)
            assert simulation.grabbed == 25
            run(simulation, 2)
            simulation.save(path)
            elsewhere = simulation.positions()
    assert simulation.frame == 10
    assert elsewhere == pytest.approx(end, abs=1e-4)


# -- damaged saves ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulation(taichi: None) -> Iterator[Simulation]:
    with Simulation(SMALL) as simulation:
        run(simulation, 2)
        yield simulation


@pytest.fixture(scope="module")
def good(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A save of another moment, with a hand in it."""
    path = tmp_path_factory.mktemp("good") / "good.npz"
    with Simulation(SMALL) as other:
        in_the_middle_of_a_drag(other)
        other.save(path)
    return path.read_bytes()


@pytest.fixture(scope="module")
def refused(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], str]:
    """refused(content): the line that says why; the simulation is as it was."""
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


def test_the_good_one_is_good_and_packs_to_itself(simulation: Simulation, good: bytes, tmp_path: Path) -> None:
    assert packed(arrays_of(good)) == good
    simulation.save(tmp_path / "now.npz")
    (tmp_path / "good.npz").write_bytes(good)
    simulation.load(tmp_path / "good.npz")
    simulation.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == good
    simulation.load(tmp_path / "now.npz")


def changed(name: str, value: Any) -> Callable[[Arrays], Arrays]:
    return lambda arrays: arrays | {name: np.asarray(value(arrays[name]) if callable(value) else value)}


def one_place(value: float) -> Callable[[Any], Any]:
    def put(array: Any) -> Any:
        array = array.copy()
        array.flat[4] = value
        return array

    return put


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (changed("x", lambda x: x[:-1]), "x is float32 of shape (29, 3), not float32 of shape (30, 3)"),
        (changed("x", lambda x: x.astype(np.float64)), "x is float64"),
        (changed("x", lambda x: x.astype("U9")), "x is <U"),
        (changed("x", lambda x: x.astype(np.complex64)), "x is complex64"),
        (changed("x", lambda x: x.astype(object)), "x is object"),
        (changed("x", one_place(np.nan)), "x is not finite"),
        (changed("x", one_place(1e30)), "x hold a number that is beyond ±1e+06, at particle 1"),
        (changed("velocity", one_place(-np.inf)), "velocity is not finite"),
        (changed("velocity", one_place(2 * FARTHEST)), "velocity hold a number that is beyond"),
        (changed("ways", one_place(1e300)), "ways hold a number that is beyond"),
        (changed("ways", lambda rows: rows[:2]), "the hands have no way: 2 places for [6]"),
        (changed("hands", [[0, 12, 2]]), "the hands have no way: 6 places for [2]"),
        (changed("ways", lambda rows: rows[:0]), "the hands have no way: 0 places for [6]"),
        (changed("hands", [[8, 12, 6]]), "hands have numbers from 0 to 7, each its own, not [8]"),
        (changed("hands", [[1, 6, 3], [1, 6, 3]]), "hands have numbers from 0 to 7, each its own, not [1, 1]"),
        (changed("hands", [[1, 0, 3], [2, 12, 3]]), "no hands hold particles [25,"),
        (changed("taken", lambda rows: rows[1:]), "no hands hold particles [25,"),
        (changed("taken", one_place(1e300)), "taken hold a number that is beyond"),
        (changed("ways", lambda rows: rows[:, :2]), "ways is float64 of shape (6, 2)"),
        (changed("ways", lambda rows: np.zeros((MOST_BYTES // 24 + 1, 3))), "ways is float64 of shape (699051, 3)"),
        (changed("held", 30), "held is int64 of shape ()"),
        (changed("held", lambda held: 0 * held + 25), "no hands hold particles [25, 25"),
        (changed("held", lambda held: held - 30), "no hands hold particles [-5,"),
        (changed("held", lambda held: held[:0]), "no hands hold particles []"),
        (changed("held", lambda held: 1.0 * held), "held is float64"),
        (changed("pinned", lambda pinned: pinned[1:]), "pinned is bool of shape (29,)"),
        (changed("frame", -1), "there is no frame -1"),
        (changed("frame", [1]), "frame is int64 of shape (1,)"),
        (changed("live", lambda live: live[:-1]), "live is float64 of shape (7,), not float64 of shape (8,)"),
        (changed("live", lambda live: 0 * live), "sphere_radius: 0.0 is out of range: above 0 to 1000 m"),
        (changed("live", lambda live: [*live[:-1], 1.5]), "substeps: a whole number is needed, not 1.5"),
        (changed("wind_on", 2), "wind_on is int64 of shape (), not bool of shape ()"),
        (changed("scene", "seed = 3"), "saved from another scene: it has 'seed = 3', this one 'title"),
        (changed("scene", lambda text: str(text) + "# more"), "saved from another scene"),
        (changed("scene", b"bytes"), "scene is |S5"),
        (lambda arrays: {k: v for k, v in arrays.items() if k != "x"}, "no item named 'x.npy'"),
    ],
)
def test_what_is_wrong_in_a_save_is_named(
    refused: Callable[[bytes], str], good: bytes, change: Callable[[Arrays], Arrays], said: str
) -> None:
    assert said in refused(packed(change(arrays_of(good))))


def with_header(good: bytes, name: str, header: str, method: int = zipfile.ZIP_STORED, data: bytes = b"") -> bytes:
    """The good save with another header on one of its arrays."""
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
        ("ways", "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3), }"),
        ("ways", "{'descr': '<f8', 'fortran_order': False, 'shape': (-5, 3), }"),
        ("scene", "{'descr': '<U500000000', 'fortran_order': False, 'shape': (), }"),
        ("x", "{'descr': '|O', 'fortran_order': False, 'shape': (30, 3), }"),
        ("x", "{'descr': " + "(" * 50 + ", 'fortran_order': False, 'shape': (30, 3), }"),
        ("x", "open('made by the header', 'w')"),
    ],
)
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_header_that_claims_too_much_takes_no_memory(
    refused: Callable[[bytes], str], good: bytes, name: str, header: str, method: int
) -> None:
    assert "not a save of this program" in refused(with_header(good, name, header, method, bytes(1_000_000)))


def test_no_save_at_all(refused: Callable[[bytes], str], good: bytes) -> None:
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    for content in (array.getvalue(), b"PK\x05\x06" + bytes(18), zlib.compress(good), bytes(10_000)):
        assert "not a save of this program" in refused(content)
    assert "it is larger than" in refused(bytes(3 * MOST_BYTES))


@given(st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_flipped_cut_or_doubled_bytes_change_the_simulation_unnoticed(
    simulation: Simulation, good: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(good)
    places = st.integers(0, len(good) - 1)
    for place in data.draw(st.lists(places, max_size=3), "flipped"):
        content[place] ^= 1 << data.draw(st.integers(0, 7))
    start, end = sorted((data.draw(places, "from"), data.draw(places, "to")))
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
    else:  # the bytes that changed say nothing, as the date of an entry
        simulation.save(after)
        assert after.read_bytes() == good
        simulation.load(now)


def test_a_save_on_a_full_disk_leaves_the_old_one(disk: Callable[..., Path], simulation: Simulation) -> None:
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
