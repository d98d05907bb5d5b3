"""Maps of a number for every particle: from pictures, lists and arrays, and what they do to a cloth."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from meshes import quads, write_obj
from PIL import Image

from taichi_cloth.mesh.from_scene import map_of, stiffness_of, topology_of
from taichi_cloth.mesh.maps import sampled
from taichi_cloth.scene import Scene, SceneError, check_scene, load_scene
from taichi_cloth.scene.model import Cloth, Maps

SHEET = Cloth(rows=3, columns=4, width=0.3, height=0.2, pins=())


def scene_of(folder: Path, cloth: Cloth = SHEET, **maps: object) -> Scene:
    return Scene(cloth=cloth, maps=Maps(folder=str(folder), **maps))


def test_a_name_is_that_of_a_shipped_map() -> None:
    scene = Scene(cloth=Cloth(rows=41, columns=61), maps=Maps(max_distance="rings"))
    assert map_of(scene, "max_distance").reshape(41, 61)[20, 30] == 1.0  # its middle
    with pytest.raises(SceneError, match=r"maps\.pin: 'ring' is no shipped map: rings, or the path"):
        check_scene(Scene(maps=Maps(pin="ring")))


def test_between_pixels_and_on_the_edges() -> None:
    grey = np.array([[0.0, 1.0], [0.5, 0.0]])
    spots = [[0, 1], [1, 1], [0, 0], [1, 0], [0.5, 1], [0.5, 0.5], [1.25, 1], [-0.5, 1]]
    assert sampled(grey, np.array(spots)).tolist() == [0, 1, 0.5, 0, 0.5, 0.375, 0.25, 0.5]
    assert sampled(np.array([[0.25]]), np.array(spots)).tolist() == [0.25] * 8


def test_a_picture_of_a_pixel_for_each_particle(tmp_path: Path) -> None:
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert map_of(scene_of(tmp_path, pin="a.png"), "pin") == pytest.approx(pixels.reshape(-1) / 255)
    Image.fromarray(pixels.astype(np.uint16) * 257).save(tmp_path / "b.png")
    assert map_of(scene_of(tmp_path, pin="b.png"), "pin") == pytest.approx(pixels.reshape(-1) / 255)


def test_a_picture_lies_on_a_mesh_as_its_texture_points_say(tmp_path: Path) -> None:
    points, faces = quads(3, 4)
    path = write_obj(tmp_path / "m.obj", points, faces)
    spots = "".join(f"vt {x + 0.5} {y + 0.5}\n" for x, y, _ in points)
    textured = path.read_text().replace("f ", spots + "f ", 1).splitlines()
    lines = [
        " ".join([w if w == "f" else f"{w}/{w}" for w in row.split()]) if row[0] == "f" else row for row in textured
    ]
    path.write_text("\n".join(lines))
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    Image.fromarray(pixels).save(tmp_path / "a.png")
    mesh = Cloth(file="m.obj", folder=str(tmp_path), pins=())
    assert map_of(scene_of(tmp_path, mesh, pin="a.png"), "pin") == pytest.approx(pixels.reshape(-1) / 255)


def test_pins_and_stiffness(tmp_path: Path) -> None:
    numbers = np.linspace(0, 1, 12)
    (tmp_path / "a.csv").write_text("\n".join(map(repr, numbers.tolist())))
    np.save(tmp_path / "b.npy", numbers)
    scene = scene_of(tmp_path, replace(SHEET, pins=(0,)), pin="a.csv", stiffness="b.npy", stiffness_lo=3.0)
    topology = topology_of(scene, "fabric")
    assert np.flatnonzero(topology.pinned).tolist() == [0, 6, 7, 8, 9, 10, 11]
    plain = replace(scene, maps=None)
    factor = 3 - 2 * numbers[topology.ends].mean(axis=1)
    assert stiffness_of(scene, "fabric", topology) == pytest.approx(stiffness_of(plain, "fabric", topology) * factor)
    assert stiffness_of(scene, "springs", topology).max() == 1.0  # a share of an error cannot be more


def header_of_png(width: int, height: int) -> bytes:
    """A picture of so many pixels, grey, that ends before the first of them."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", b""), (b"IEND", b"")]
    packed = [struct.pack(">I", len(c)) + kind + c + struct.pack(">I", zlib.crc32(kind + c)) for kind, c in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("none.png", None, "cannot be read"),
        ("a.png", b"no picture", "is no picture"),
        ("a.png", header_of_png(12_000, 12_000), "'it has more than 100000000 pixels'"),
        ("a.png", header_of_png(60_000, 60_000), "Image size (3600000000 pixels) exceeds limit"),
        ("a.csv", b"0.5\nhalf\n", "line 2: 'half' is no number"),
        ("a.csv", b"0.5\n0.25", "has numbers of shape (2,), not one for each of 12 particles"),
        ("a.csv", b"0.5\n" * 11 + b"1.5", "number 12 is 1.5, not 0 to 1"),
        ("a.csv", b"nan\n" * 12, "number 1 is nan, not 0 to 1"),
        ("a.npy", b"junk", "is no NumPy array"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, name: str, content: bytes | None, reason: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    scene = f"[cloth]\nrows = 3\ncolumns = 4\n[maps]\npin = '{name}'\n"
    (tmp_path / "s.toml").write_text(scene)
    with pytest.raises(SceneError) as caught:
        load_scene(tmp_path / "s.toml")
    assert caught.value.key == "maps.pin"
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_mesh_without_texture_takes_no_picture(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "s.toml").write_text("[cloth]\nfile = 'round'\n[maps]\nstiffness = 'a.png'\n")
    with pytest.raises(SceneError, match=r"maps.stiffness: round has no `vt` for some of its points"):
        load_scene(tmp_path / "s.toml")


def test_without_pillow_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "a.png")
    monkeypatch.setitem(__import__("sys").modules, "PIL", None)
    with pytest.raises(ValueError, match=r"need Pillow: pip install 'taichi-cloth\[maps\]'"):
        map_of(scene_of(tmp_path, pin="a.png"), "pin")
