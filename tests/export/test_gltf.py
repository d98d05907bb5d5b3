"""glTF files, read by a small reader that knows only the specification (Khronos Group, glTF 2.0), and by trimesh."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from taichi_cloth.collision.colliders import signed_distance
from taichi_cloth.collision.shapes import SPHERE
from taichi_cloth.collision.shapes.box import BOX
from taichi_cloth.collision.shapes.capsule import CAPSULE
from taichi_cloth.export import mesh_files
from taichi_cloth.export.clip import export
from taichi_cloth.export.mesh_files import ExportMesh, export_mesh_of, glb_clip, vertex_normals
from taichi_cloth.export.output import Output
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.render.colors import pattern_colors
from taichi_cloth.render.draw_list import FLOOR_COLOR, POLE_COLOR
from taichi_cloth.scene import scene_names
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

TYPES = {5126: np.dtype("<f4"), 5125: np.dtype("<u4")}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Glb:
    """A glTF binary file. Opening it checks the container, and every array against its description."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        magic, version, length, text_length, kind = struct.unpack_from("<4sIII4s", content)
        assert (magic, version, length, kind) == (b"glTF", 2, len(content), b"JSON")
        assert text_length % 4 == 0
        self.json: dict[str, Any] = json.loads(content[20 : 20 + text_length])
        data_length, kind = struct.unpack_from("<I4s", content, 20 + text_length)
        self.data = content[28 + text_length :]
        assert kind == b"BIN\0"
        assert self.json["asset"]["version"] == "2.0"
        assert [buffer["byteLength"] for buffer in self.json["buffers"]] == [data_length] == [len(self.data)]
        ends = [view["byteOffset"] + view["byteLength"] for view in self.json["bufferViews"]]
        assert [view["byteOffset"] for view in self.json["bufferViews"]] == [0, *ends[:-1]]
        assert ends[-1] == len(self.data)
        used = {accessor["bufferView"] for accessor in self.json["accessors"]}
        assert used == set(range(len(ends)))
        for k, accessor in enumerate(self.json["accessors"]):
            values = self.array(k)
            assert np.isfinite(values).all()
            assert (values.min(axis=0) == accessor["min"]).all()
            assert (values.max(axis=0) == accessor["max"]).all()

    def array(self, number: int) -> np.ndarray:
        """Return the array of an accessor, (count, components)."""
        accessor = self.json["accessors"][number]
        view = self.json["bufferViews"][accessor["bufferView"]]
        dtype, components = TYPES[accessor["componentType"]], COMPONENTS[accessor["type"]]
        assert view["byteLength"] == accessor["count"] * components * dtype.itemsize
        assert view["byteOffset"] % dtype.itemsize == 0
        part = self.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(part, dtype).reshape(-1, components)

    def primitive(self, name: str) -> dict[str, Any]:
        """Return the part of the mesh of a node, checked for equal numbers of vertices."""
        node = next(node for node in self.json["nodes"] if node["name"] == name)
        (part,) = self.json["meshes"][node["mesh"]]["primitives"]
        assert self.json["materials"][part["material"]]["name"] == name
        arrays = [part["attributes"], *part.get("targets", [])]
        assert len({len(self.array(k)) for attributes in arrays for k in attributes.values()}) == 1
        assert self.array(part["indices"]).max() < len(self.array(part["attributes"]["POSITION"]))
        return part

    def corners(self, name: str, attribute: str = "POSITION") -> np.ndarray:
        """Return an attribute of every corner of a node's triangles, (3·T, components)."""
        part = self.primitive(name)
        return self.array(part["attributes"][attribute])[self.array(part["indices"]).ravel()]

    def morphed(self, weights: np.ndarray, attribute: str = "POSITION") -> np.ndarray:
        """Return an attribute of every corner of the cloth with these weights of its morph targets."""
        part = self.primitive("cloth")
        targets = np.array([self.array(target[attribute]) for target in part["targets"]])
        values = self.array(part["attributes"][attribute]) + np.tensordot(weights, targets, 1)
        return values[self.array(part["indices"]).ravel()]

    def track(self, name: str, path: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the times of an animated property, (S,), and its values, one row per time; None if it is constant."""
        (animation,) = self.json["animations"]
        for channel in animation["channels"]:
            target = channel["target"]
            if (self.json["nodes"][target["node"]]["name"], target["path"]) == (name, path):
                sampler = animation["samplers"][channel["sampler"]]
                assert "interpolation" not in sampler  # linear
                times = self.array(sampler["input"]).ravel()
                return times, self.array(sampler["output"]).reshape(len(times), -1)
        return None


def mesh_of(name: str) -> tuple[ExportMesh, np.ndarray]:
    """Return the export mesh of a shipped scene, and its positions at the start."""
    scene = load_scene(name)
    topology = build_topology(scene, "verlet")
    return export_mesh_of(scene, topology), topology.start


def write(path: Path, sheet: ExportMesh, clip: list[np.ndarray], rate: float = 60.0) -> Glb:
    """Write a cloth without solids and open the file."""
    with glb_clip(path, sheet, [], len(clip), rate) as add:
        for x in clip:
            add(x, np.zeros((0, 4, 4)))
            assert not path.exists()
    return Glb(path)


def linear(colors: np.ndarray) -> np.ndarray:
    """Return sRGB factors as linear ones (IEC 61966-2-1)."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


# -- cloth -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_has_its_triangles_normals_and_colors(name: str, tmp_path: Path) -> None:
    sheet, x = mesh_of(name)
    file = write(tmp_path / "c.glb", sheet, [x])
    corners = sheet.triangles.ravel()
    scene = load_scene(name)
    drawn = pattern_colors(build_topology(scene, "verlet"), scene.look)
    expected = {
        "POSITION": x[corners],
        "NORMAL": vertex_normals(x, sheet.triangles)[corners],
        "TEXCOORD_0": [0, 1] + sheet.uv[corners] * [1, -1],
        "COLOR_0": linear(np.rint(255 * drawn) / 255),
    }
    for attribute, values in expected.items():
        assert np.abs(file.corners("cloth", attribute) - values).max() < 1e-6, attribute
    assert "animations" not in file.json
    mesh = trimesh.load(tmp_path / "c.glb", force="scene", process=False).geometry["cloth"]
    assert np.abs(np.asarray(mesh.vertices)[np.asarray(mesh.faces).ravel()] - x[corners]).max() < 1e-6


def test_the_animation_passes_through_every_sample(tmp_path: Path) -> None:
    sheet, start = mesh_of("drape15")
    clip = [start + np.random.default_rng(k).normal(0, 0.02, start.shape) for k in range(5)]
    file = write(tmp_path / "c.glb", sheet, clip, rate=30.0)
    times, weights = file.track("cloth", "weights") or pytest.fail("no animation")
    assert times == pytest.approx(np.arange(5) / 30)
    corners = sheet.triangles.ravel()
    for x, weight in zip(clip, weights, strict=True):
        assert file.morphed(weight) == pytest.approx(x[corners], abs=1e-6)
        normals = vertex_normals(x, sheet.triangles)[corners]
        assert file.morphed(weight, "NORMAL") == pytest.approx(normals, abs=1e-6)
    between = (weights[2] + weights[3]) / 2
    assert file.morphed(between) == pytest.approx((clip[2] + clip[3])[corners] / 2, abs=1e-6)


def test_special_characters_in_names_are_escaped(tmp_path: Path) -> None:
    sheet, x = mesh_of("drape15")
    odd = ExportMesh('a "b"\n\udcff ä', sheet.triangles, sheet.uv, sheet.colors)
    assert write(tmp_path / "c.glb", odd, [x]).json["scenes"][0]["name"] == 'a "b"\\n\\udcff ä'


def test_a_clip_that_is_too_long_for_the_format_is_refused_before_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet, x = mesh_of("drape15")
    length = len(write(tmp_path / "c.glb", sheet, [x] * 9).data)
    monkeypatch.setattr(mesh_files, "MAX_GLB", length // 2)
    with (
        pytest.raises(UsageError, match=r"d\.glb: a glTF file has at most .* GiB, and 9 samples need"),
        glb_clip(tmp_path / "d.glb", sheet, [], 9, 60.0),
    ):
        pytest.fail("the run began")
    assert [path.name for path in tmp_path.iterdir()] == ["c.glb"]


def test_a_cloth_without_triangles_is_refused(tmp_path: Path) -> None:
    sheet, _ = mesh_of("drape15")
    torn = ExportMesh("torn", sheet.triangles[:0], sheet.uv, sheet.colors[:0])
    with (
        pytest.raises(UsageError, match="a glTF file needs triangles, and all of this cloth are torn"),
        glb_clip(tmp_path / "c.glb", torn, [], 1, 60.0),
    ):
        pytest.fail("the run began")


# -- solids ------------------------------------------------------------------------------------------------------------

SCENE = """
[cloth]
rows = 6
columns = 7
[look]
pole = true
[ground]
height = -1.0
[[spheres]]
center = [0.0, 1.0, 2.0]
radius = 0.3
oscillation = [1.0, 0.0, 0.0]
[[capsules]]
center = [1.0, 2.0, 3.0]
rotation = [10.0, 20.0, 90.0]
length = 0.8
radius = 0.1
[[boxes]]
center = [1.0, 0.5, 3.0]
size = [1.0, 0.5, 0.7]
spin = [0.0, 2000.0, 1500.0] # half a turn every four or five frames
"""


@pytest.mark.usefixtures("running")
def test_colliders_and_the_pole_are_where_they_are_in_each_frame(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SCENE)
    path = tmp_path / "c.glb"
    with Simulation(load_scene(tmp_path / "small.toml"), "serial") as simulation:
        states = [(simulation.colliders(), simulation.positions())]
        output = Output(path, "glb", 24, clip=True, every=2)
        export(simulation, output, lambda k: states.append((simulation.colliders(), simulation.positions())))
        triangles, top = simulation.topology.triangles, simulation.topology.start[:7]
    file = Glb(path)
    names = [node["name"] for node in file.json["nodes"]]
    assert names == ["cloth", "sphere_0", "capsule_1", "box_2", "ground_3", "pole"]
    times, weights = file.track("cloth", "weights") or pytest.fail("no animation")
    assert times == pytest.approx(np.arange(12) / 30)
    nodes = {node["name"]: node for node in file.json["nodes"]}
    previous: dict[str, np.ndarray] = {}
    for k, (colliders, x) in enumerate(states[:24:2]):
        assert file.morphed(weights[k]) == pytest.approx(x[triangles.ravel()], abs=1e-6)
        for name, posed in zip(names[1:5], colliders, strict=True):
            translation, rotation = (file.track(name, path) for path in ("translation", "rotation"))
            assert (translation is None) == (rotation is None) == (name in ("capsule_1", "ground_3"))
            offset = nodes[name]["translation"] if translation is None else translation[1][k]
            quaternion = nodes[name]["rotation"] if rotation is None else rotation[1][k]
            points = Rotation.from_quat(quaternion).apply(file.corners(name)) + offset
            assert signed_distance(posed, points) == pytest.approx(0, abs=1e-5), name
            assert np.dot(quaternion, previous.get(name, quaternion)) >= 0  # the shorter way
            previous[name] = np.asarray(quaternion)
    for name in names[1:]:
        (a, b, c), normals = file.corners(name).reshape(-1, 3, 3).swapaxes(0, 1), file.corners(name, "NORMAL")
        assert (np.repeat(np.cross(b - a, c - a), 3, axis=0) * normals).sum(axis=1).min() > -1e-6, name  # outward
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1)
    pole = file.corners("pole")
    assert pole[:, 0].min() < top[:, 0].min() < top[:, 0].max() < pole[:, 0].max()
    assert pole[:, 1:].mean(axis=0) == pytest.approx(top[0, 1:], abs=0.01)
    first = states[0][1]
    floor, side = file.corners("ground_3") + nodes["ground_3"]["translation"], np.ptp(first, axis=0).max()
    assert np.ptp(floor, axis=0) == pytest.approx([2 * side, 0, 2 * side])
    middle = (first.min(axis=0) + first.max(axis=0)) / 2
    assert (floor.min(axis=0) + floor.max(axis=0)) / 2 == pytest.approx([middle[0], -1.0, middle[2]])
    looks = [material["pbrMetallicRoughness"]["baseColorFactor"] for material in file.json["materials"]]
    drawn = [(1.0, 1.0, 1.0), SPHERE.color, CAPSULE.color, BOX.color, FLOOR_COLOR, POLE_COLOR]
    assert np.array(looks) == pytest.approx(np.array([[*linear(np.array(color)), 1.0] for color in drawn]), abs=1e-6)
    assert [material.get("doubleSided", False) for material in file.json["materials"]] == [True] + [False] * 5


@pytest.mark.usefixtures("running")
def test_the_curtain_arrives_with_its_pole_in_usd_too(tmp_path: Path) -> None:
    with Simulation(load_scene("curtain", rows=4, columns=5), "serial") as simulation:
        export(simulation, Output(tmp_path / "c.usda", "usd", 1), lambda k: None)
        export(simulation, Output(tmp_path / "d.usda", "usd", 2, clip=True), lambda k: None)
        start = simulation.topology.start
    for name in ("c.usda", "d.usda"):
        stage = Usd.Stage.Open(str(tmp_path / name))
        pole = UsdGeom.Mesh(stage.GetPrimAtPath("/curtain/pole"))
        points = np.array(pole.GetPointsAttr().Get())
        assert points[:, 0].min() < start[:, 0].min() < start[:, 0].max() < points[:, 0].max()
        assert np.array(pole.GetDisplayColorAttr().Get()) == pytest.approx(linear(np.array([POLE_COLOR])), abs=1e-6)
        colliders = stage.GetPrimAtPath("/curtain/colliders").GetChildren()
        assert [prim.GetName() for prim in colliders] == ["sphere_0", "ground_1"]
