"""Maps of a number for every particle: from images, lists and arrays, and their effect on a cloth."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import quads, write_obj
from PIL import Image

from taichi_cloth.geometry.cloth_builder import build_topology, sample_map, spring_stiffness, weight_map
from taichi_cloth.geometry.scene_loader import check_scene, load_scene, save_scene
from taichi_cloth.scene.keys import MAX_WEIGHTS
from taichi_cloth.scene.schema import Cloth, Maps, Scene
from taichi_cloth.system.errors import SceneError, install_command

SHEET = Cloth(rows=3, columns=4, width=0.3, height=0.2, pins=())


def scene_of(folder: Path, cloth: Cloth = SHEET, **maps: Any) -> Scene:
    return Scene(cloth=cloth, maps=Maps(folder=str(folder), **maps))


def test_a_name_refers_to_a_shipped_map() -> None:
    scene = Scene(cloth=Cloth(rows=41, columns=61), maps=Maps(max_distance="rings"))
    assert weight_map(scene, "max_distance").reshape(41, 61)[20, 30] == 1.0  # its center
    with pytest.raises(SceneError, match=r"maps\.pin: 'ring' is not a shipped map; use rings, or the path"):
        check_scene(Scene(maps=Maps(pin="ring")))


def test_images_are_interpolated_and_repeated() -> None:
    gray = np.array([[0.0, 1.0], [0.5, 0.0]])
    uv = [[0, 1], [1, 1], [0, 0], [1, 0], [0.5, 1], [0.5, 0.5], [1.25, 1], [-0.5, 1]]
    assert sample_map(gray, np.array(uv)).tolist() == [0, 1, 0.5, 0, 0.5, 0.375, 0.25, 0.5]
    assert sample_map(np.array([[0.25]]), np.array(uv)).tolist() == [0.25] * 8


def test_an_image_with_one_pixel_per_particle(tmp_path: Path) -> None:
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert weight_map(scene_of(tmp_path, pin="a.png"), "pin") == pytest.approx(pixels.reshape(-1) / 255)
    Image.fromarray(pixels.astype(np.uint16) * 257).save(tmp_path / "b.png")
    assert weight_map(scene_of(tmp_path, pin="b.png"), "pin") == pytest.approx(pixels.reshape(-1) / 255)


def test_an_image_follows_the_texture_coordinates_of_a_mesh(tmp_path: Path) -> None:
    points, faces = quads(3, 4)
    path = write_obj(tmp_path / "m.obj", points, faces)
    coordinates = "".join(f"vt {x + 0.5} {y + 0.5}\n" for x, y, _ in points)
    textured = path.read_text().replace("f ", coordinates + "f ", 1).splitlines()
    lines = [
        " ".join([w if w == "f" else f"{w}/{w}" for w in row.split()]) if row[0] == "f" else row for row in textured
    ]
    path.write_text("\n".join(lines))
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    Image.fromarray(pixels).save(tmp_path / "a.png")
    mesh = Cloth(file="m.obj", folder=str(tmp_path), pins=())
    assert weight_map(scene_of(tmp_path, mesh, pin="a.png"), "pin") == pytest.approx(pixels.reshape(-1) / 255)


def test_pin_and_stiffness_maps(tmp_path: Path) -> None:
    numbers = np.linspace(0, 1, 12)
    (tmp_path / "a.csv").write_text("\n".join(map(repr, numbers.tolist())))
    np.save(tmp_path / "b.npy", numbers)
    scene = scene_of(tmp_path, replace(SHEET, pins=(0,)), pin="a.csv", stiffness="b.npy", stiffness_min=3.0)
    topology = build_topology(scene, "fabric")
    assert np.flatnonzero(topology.pinned).tolist() == [0, 6, 7, 8, 9, 10, 11]
    plain = replace(scene, maps=None)
    factor = 3 - 2 * numbers[topology.ends].mean(axis=1)
    assert spring_stiffness(scene, "fabric", topology) == pytest.approx(
        spring_stiffness(plain, "fabric", topology) * factor
    )
    assert spring_stiffness(scene, "verlet", topology).max() == 1.0  # the largest share of an error


def header_of_png(width: int, height: int) -> bytes:
    """Return a grayscale PNG file of this size that ends before the first pixel."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", b""), (b"IEND", b"")]
    packed = [struct.pack(">I", len(c)) + kind + c + struct.pack(">I", zlib.crc32(kind + c)) for kind, c in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("none.png", None, "cannot be read"),
        ("a.png", b"no image", "is not a usable image"),
        ("a.png", header_of_png(12_000, 12_000), "'it has more than 100000000 pixels'"),
        ("a.png", header_of_png(60_000, 60_000), "Image size (3600000000 pixels) exceeds limit"),
        ("a.csv", b"0.5\nhalf\n", "line 2: 'half' is not a number"),
        ("a.csv", b"0.5\n0.25", "has values of shape (2,), not one for each of 12 particles"),
        ("a.csv", b"0.5\n" * 11 + b"1.5", "value 12 is 1.5, not 0 to 1"),
        ("a.csv", b"nan\n" * 12, "value 1 is nan, not 0 to 1"),
        ("a.npy", b"junk", "is not a NumPy array"),
    ],
)
def test_an_invalid_map_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes | None, reason: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    scene = f"[cloth]\nrows = 3\ncolumns = 4\n[maps]\npin = '{name}'\n"
    (tmp_path / "s.toml").write_text(scene)
    with pytest.raises(SceneError) as caught:
        load_scene(tmp_path / "s.toml")
    assert caught.value.key == "maps.pin"
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()


def test_an_image_needs_texture_coordinates(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "s.toml").write_text("[cloth]\nfile = 'round'\n[maps]\nstiffness = 'a.png'\n")
    with pytest.raises(SceneError, match=r"maps.stiffness: round has vertices without texture coordinates"):
        load_scene(tmp_path / "s.toml")


def test_without_pillow_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "a.png")
    monkeypatch.setitem(__import__("sys").modules, "PIL", None)
    with pytest.raises(ValueError, match=re.escape(f"images as maps need Pillow: {install_command('maps')}")):
        weight_map(scene_of(tmp_path, pin="a.png"), "pin")


WEIGHTS = np.arange(12).reshape(3, 4) / 11
OTHER_SHAPE = "not one for each of 12 particles, nor rows and columns as the sheet, (3, 4)"


@pytest.mark.parametrize("given", [WEIGHTS, WEIGHTS.reshape(-1), WEIGHTS.tolist(), tuple(WEIGHTS.reshape(-1).tolist())])
def test_a_map_may_be_its_numbers(given: Any) -> None:
    scene = Scene(cloth=SHEET, maps=Maps(stiffness=given, stiffness_min=1.0, stiffness_max=3.0))
    assert weight_map(scene, "stiffness").tolist() == WEIGHTS.reshape(-1).tolist()
    assert check_scene(scene) == scene
    assert hash(scene) == hash(Scene(cloth=SHEET, maps=scene.maps))
    assert load_scene(Scene(cloth=SHEET), maps={"stiffness": given, "stiffness_min": 1, "stiffness_max": 3}) == scene


def test_a_file_may_have_the_rows_and_columns_of_the_sheet(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", WEIGHTS)
    assert weight_map(scene_of(tmp_path, pin="a.npy"), "pin").tolist() == WEIGHTS.reshape(-1).tolist()
    np.save(tmp_path / "a.npy", WEIGHTS.T)
    with pytest.raises(SceneError, match=rf"a\.npy has values of shape \(4, 3\), {re.escape(OTHER_SHAPE)}$"):
        check_scene(scene_of(tmp_path, pin="a.npy"))


def test_a_mask_pins_particles() -> None:
    mask = np.zeros((3, 4), bool)
    mask[0, 1] = mask[2, 3] = True
    topology = build_topology(check_scene(Scene(cloth=SHEET, maps=Maps(pin=mask))), "fabric")  # type: ignore[arg-type]
    assert np.flatnonzero(topology.pinned).tolist() == [1, 11]


def test_numbers_of_a_map_are_saved_in_the_scene(tmp_path: Path) -> None:
    scene = check_scene(Scene(cloth=SHEET, maps=Maps(max_distance=tuple(WEIGHTS.reshape(-1)))))
    save_scene(scene, tmp_path / "a.toml")
    assert load_scene(tmp_path / "a.toml") == replace(scene, name="a")


def test_the_most_numbers_that_maps_may_have_fit_into_a_file(tmp_path: Path) -> None:
    values = tuple(np.random.default_rng(1).random(MAX_WEIGHTS).tolist())
    cloth = Cloth(rows=200, columns=200)
    assert cloth.rows * cloth.columns == MAX_WEIGHTS
    scene = check_scene(Scene(cloth=cloth, maps=Maps(pin=values, stiffness=values, max_distance=values)))
    save_scene(scene, tmp_path / "a.toml")
    assert load_scene(tmp_path / "a.toml") == replace(scene, name="a")


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (0.5, "must be a file or one number per particle, got 0.5"),
        ([], 'must have one number per particle; for no map, write ""'),
        ([0.5, 2.0], "value 2 must be a number from 0 to 1, got 2.0"),
        ([0.5, float("nan")], "value 2 must be a number from 0 to 1, got nan"),
        ([0.5, "a"], "value 2 must be a number from 0 to 1, got 'a'"),
        ([[0.5], 1.0], "value 1 must be a number from 0 to 1, got [0.5]"),
        (np.zeros(11), f"has values of shape (11,), {OTHER_SHAPE}"),
        (np.zeros((4, 3)), f"has values of shape (4, 3), {OTHER_SHAPE}"),  # columns and rows
        (np.zeros((2, 6)), f"has values of shape (2, 6), {OTHER_SHAPE}"),
        ([[0, 1], [0]], "rows must be equally long, got 2 and 1 numbers"),
        (
            np.zeros(MAX_WEIGHTS + 1),
            "has 40001 numbers, at most 40000 are allowed; write more to a file, with numpy.save",
        ),
    ],
)
def test_wrong_numbers_of_a_map_are_refused_in_one_line(given: Any, reason: str) -> None:
    with pytest.raises(SceneError) as found:
        check_scene(Scene(cloth=SHEET, maps=Maps(pin=given)))
    assert (found.value.key, found.value.reason) == ("maps.pin", reason)
