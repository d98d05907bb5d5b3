"""Files of every format, read back by other libraries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from pxr import Usd, UsdGeom

from taichi_cloth.collision.colliders import colliders_of, pose_colliders
from taichi_cloth.collision.shapes import MESH, SPHERE
from taichi_cloth.collision.shapes.box import BOX
from taichi_cloth.collision.shapes.capsule import CAPSULE
from taichi_cloth.collision.shapes.plane import PLANE
from taichi_cloth.export.mesh_files import (
    ExportMesh,
    Solid,
    export_mesh_of,
    pc2_clip,
    rotate_to_up,
    vertex_normals,
    write_obj,
    write_ply,
)
from taichi_cloth.export.usd import usd_clip, write_usd
from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.mesh_reader import read_obj
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.geometry.signed_distance import collider_surface
from taichi_cloth.render.colors import pattern_colors
from taichi_cloth.render.draw_list import FLOOR_COLOR
from taichi_cloth.scene import scene_names
from taichi_cloth.scene.collider_schema import Box, Capsule, Ground, Mesh, Plane, Sphere
from taichi_cloth.scene.schema import Cloth, Scene

USD_SUFFIXES = (".usdc", ".usda", ".usd")


def mesh_of(name: str) -> tuple[ExportMesh, np.ndarray]:
    """Return the export mesh of a shipped scene, and its positions at the start."""
    scene = load_scene(name)
    topology = build_topology(scene, "verlet")
    return export_mesh_of(scene, topology), topology.start


def perturbed(name: str = "drape15", seed: int = 0) -> tuple[ExportMesh, np.ndarray]:
    sheet, x = mesh_of(name)
    return sheet, (x + np.random.default_rng(seed).normal(0, 0.02, x.shape)).astype(np.float32).astype(np.float64)


def read(path: Path) -> trimesh.Trimesh:
    mesh = trimesh.load(path, process=False, maintain_order=True)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def opened(path: Path) -> tuple[Usd.Stage, UsdGeom.Mesh]:
    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("cloth"))


# -- meshes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_as_obj_ply_and_usd(name: str, tmp_path: Path) -> None:
    sheet, x = perturbed(name)
    normals = vertex_normals(x, sheet.triangles)
    write_obj(tmp_path / "c.obj", sheet, x, normals)
    write_ply(tmp_path / "c.ply", sheet, x, normals)
    write_usd(tmp_path / "c.usdc", sheet, x, [], "y")
    for mesh in (read(tmp_path / "c.obj"), read(tmp_path / "c.ply")):
        assert mesh.vertices == pytest.approx(x, rel=1e-6, abs=0)
        assert (mesh.faces == sheet.triangles).all()
        assert isinstance(mesh.visual, trimesh.visual.TextureVisuals)
        assert mesh.visual.uv == pytest.approx(sheet.uv, abs=1e-6)
        assert mesh.vertex_normals == pytest.approx(normals, abs=1e-6)
    assert (read(tmp_path / "c.ply").vertices == x.astype(np.float32)).all()
    _stage, mesh = opened(tmp_path / "c.usdc")
    assert (np.array(mesh.GetPointsAttr().Get()) == x.astype(np.float32)).all()
    assert (np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3) == sheet.triangles).all()


def test_obj_has_nine_digits_and_is_read_back_equal(tmp_path: Path) -> None:
    sheet, x = perturbed()
    write_obj(tmp_path / "c.obj", sheet, x * 1024)
    points, faces = read_obj(tmp_path / "c.obj")
    assert (points.astype(np.float32) == (x * 1024).astype(np.float32)).all()
    assert points == pytest.approx(x * 1024, rel=5e-9)
    assert (faces == sheet.triangles).all()


@settings(max_examples=20)
@given(st.integers(2, 9), st.integers(2, 9), st.integers(1, 3))
def test_every_grid_with_any_number_of_layers(
    tmp_path_factory: pytest.TempPathFactory, rows: int, columns: int, layers: int
) -> None:
    path = tmp_path_factory.mktemp("grid") / "c.obj"
    scene = Scene(cloth=Cloth(rows=rows, columns=columns, layers=layers, pins=()))
    topology = build_topology(scene, "verlet")
    write_obj(path, export_mesh_of(scene, topology), topology.start)
    mesh = read(path)
    assert mesh.vertices == pytest.approx(topology.start, rel=1e-6, abs=1e-12)
    assert (mesh.faces == topology.triangles).all()
    assert mesh.body_count == layers


@pytest.mark.parametrize("name", ["line\nend f 1 2 3", "a \udcff b", "Vorhang ä"])
def test_special_characters_in_names_are_escaped(name: str, tmp_path: Path) -> None:
    sheet, x = perturbed()
    named = replace(sheet, name=name)
    write_obj(tmp_path / "c.obj", named, x)
    assert len(read(tmp_path / "c.obj").faces) == len(sheet.triangles)
    write_usd(tmp_path / "c.usda", named, x, [], "y")
    _stage, mesh = opened(tmp_path / "c.usda")
    assert len(mesh.GetPointsAttr().Get()) == len(x)


# -- colors ----------------------------------------------------------------------------------------------------


def linear(colors: Any) -> np.ndarray:
    """Return sRGB factors as linear ones (IEC 61966-2-1)."""
    return np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.ravel(colors)]).reshape(
        np.shape(colors)
    )


def corner_colors(name: str) -> np.ndarray:
    """Return the color of every corner of a shipped scene as the renderer draws it, (T, 3, 3)."""
    scene = load_scene(name)
    return pattern_colors(build_topology(scene, "verlet"), scene.look).reshape(-1, 3, 3)


PATTERNED = ["curtain", "denim", "round", "net", "banner"]  # check, twill, gingham on a mesh, ring, plain


@pytest.mark.parametrize("name", PATTERNED)
def test_a_particle_has_the_color_of_a_triangle_in_ply(name: str, tmp_path: Path) -> None:
    sheet, x = mesh_of(name)
    write_ply(tmp_path / "c.ply", sheet, x, vertex_normals(x, sheet.triangles))
    data = read(tmp_path / "c.ply").metadata["_ply_raw"]["vertex"]["data"]
    found = np.stack([data[channel] for channel in ("red", "green", "blue")], axis=1)
    assert found.dtype == np.uint8
    expected = np.rint(255 * corner_colors(name)).astype(int)
    for particle, color in enumerate(found[:: len(x) // 50]):
        own = expected[sheet.triangles == particle * (len(x) // 50)]
        assert color.tolist() in own.tolist()
    assert len(np.unique(found, axis=0)) == len(np.unique(expected.reshape(-1, 3), axis=0))


@pytest.mark.parametrize("name", PATTERNED)
def test_corners_have_the_colors_of_the_pattern_in_usd(name: str, tmp_path: Path) -> None:
    sheet, x = mesh_of(name)
    write_usd(tmp_path / "c.usdc", sheet, x, [], "y")
    _stage, mesh = opened(tmp_path / "c.usdc")
    primvar = mesh.GetDisplayColorPrimvar()
    assert primvar.GetInterpolation() == "faceVarying"
    assert np.array(primvar.Get()) == pytest.approx(linear(corner_colors(name)).reshape(-1, 3), abs=1e-6)


def test_colliders_and_the_pole_have_the_colors_in_which_they_are_drawn_in_usd(tmp_path: Path) -> None:
    sheet, x = perturbed()
    brown = np.array([0.36, 0.24, 0.02])
    triangle = np.array([[0.0, 2.0, 0.0], [1.0, 2.0, 0.0], [0.0, 2.0, 1.0]])
    pole = Solid("pole", brown, triangle, np.tile([0.0, 1.0, 0.0], (3, 1)), np.array([[0, 1, 2]]))
    write_usd(tmp_path / "c.usda", sheet, x, pose_colliders(colliders_of(COLLIDERS), 0.0), "z", [pole])
    stage, _ = opened(tmp_path / "c.usda")
    parts = [*stage.GetDefaultPrim().GetChild("colliders").GetChildren(), stage.GetPrimAtPath("/drape15/pole")]
    colors = [SPHERE.color, CAPSULE.color, BOX.color, PLANE.color, FLOOR_COLOR, MESH.color, tuple(brown)]
    for part, color in zip(parts, colors, strict=True):
        primvar = UsdGeom.Gprim(part).GetDisplayColorPrimvar()
        assert primvar.GetInterpolation() == "constant"
        assert np.array(primvar.Get()) == pytest.approx(linear([color]), abs=1e-6)
    mesh = UsdGeom.Mesh(parts[-1])
    assert np.array(mesh.GetPointsAttr().Get()) == pytest.approx(rotate_to_up(triangle, "z"))
    assert np.array(mesh.GetNormalsAttr().Get()) == pytest.approx(np.tile([0.0, 0.0, 1.0], (3, 1)))


# -- PC2 -------------------------------------------------------------------------------------------------------

# As specified by Autodesk, and as read by MOD_meshcache_pc2 of Blender.
PC2 = np.dtype(
    [("sign", "S12"), ("version", "<i4"), ("points", "<i4"), ("start", "<f4"), ("rate", "<f4"), ("samples", "<i4")]
)


def test_pc2_contains_every_sample(tmp_path: Path) -> None:
    path = tmp_path / "c.pc2"
    clip = [perturbed(seed=k)[1] for k in range(4)]
    with pc2_clip(path, len(clip[0]), 4) as add:
        for x in clip:
            add(x)
            assert not path.exists()
    content = path.read_bytes()
    head = np.frombuffer(content, PC2, 1)[0]
    assert head.item() == (b"POINTCACHE2", 1, len(clip[0]), 0.0, 1.0, 4)
    assert content[11] == 0
    assert len(content) == 32 + 4 * len(clip[0]) * 12
    assert (np.frombuffer(content, "<f4", offset=32).reshape(4, -1, 3) == np.array(clip, np.float32)).all()


def test_a_pc2_file_with_too_few_samples_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="wrote 32 bytes, expected 56"), pc2_clip(tmp_path / "c.pc2", 1, 2):
        pass
    assert list(tmp_path.iterdir()) == []


# -- USD -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
@pytest.mark.parametrize("up", ["y", "z"])
def test_usd_contains_every_sample(suffix: str, up: str, tmp_path: Path) -> None:
    clip = [perturbed(seed=k) for k in range(3)]
    sheet = clip[0][0]
    with usd_clip(tmp_path / f"c{suffix}", sheet, up, 30.0) as add:
        for _, x in clip:
            add(x, [])
    stage, mesh = opened(tmp_path / f"c{suffix}")
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 2)
    assert stage.GetFramesPerSecond() == stage.GetTimeCodesPerSecond() == 30
    assert UsdGeom.GetStageUpAxis(stage) == up.upper()
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetPointsAttr().GetTimeSamples() == [0, 1, 2]
    assert mesh.ValidateTopology(
        mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get(), len(sheet.uv)
    ) == (True, "")
    for k, (_, x) in enumerate(clip):
        positions = rotate_to_up(x, up)
        points = np.array(mesh.GetPointsAttr().Get(k))
        assert (points == positions.astype(np.float32)).all()
        assert (np.array(mesh.GetExtentAttr().Get(k)) == [points.min(axis=0), points.max(axis=0)]).all()
        normals = np.array(mesh.GetNormalsAttr().Get(k))
        assert normals == pytest.approx(vertex_normals(positions, sheet.triangles), abs=1e-6)
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert st.GetInterpolation() == mesh.GetNormalsInterpolation() == "vertex"
    assert np.array(st.Get()) == pytest.approx(sheet.uv, abs=1e-6)


COLLIDERS = Scene(
    spheres=(Sphere(center=(0.0, 1.0, 2.0), radius=0.3, oscillation=(1.0, 0.0, 0.0), period=(2.0, 2.0, 2.0)),),
    capsules=(Capsule(center=(1.0, 2.0, 3.0), rotation=(0.0, 0.0, 90.0), length=0.8, radius=0.1),),
    boxes=(Box(center=(1.0, 0.5, 0.0), size=(1.0, 2.0, 4.0), spin=(0.0, 90.0, 0.0)),),
    planes=(Plane(center=(0.0, -1.0, 0.0), display_size=3.0),),
    ground=Ground(height=-2.0),
    meshes=load_scene("veil").meshes,
)


def floor_below(x: np.ndarray, height: float) -> list[list[float]]:
    """Return the box of a floor whose middle is below that of the cloth `x` and which is twice as wide, (2, 3)."""
    middle, side = (x.min(axis=0) + x.max(axis=0)) / 2, np.ptp(x, axis=0).max()
    return [[middle[0] + sign * side, height, middle[2] + sign * side] for sign in (-1, 1)]


def bounds(prim: Usd.Prim, time: float) -> np.ndarray:
    """Return the bounding box of a prim in world space, (2, 3), as computed by USD."""
    box = UsdGeom.Imageable(prim).ComputeWorldBound(time, "default").ComputeAlignedRange()
    return np.array([box.GetMin(), box.GetMax()])


@pytest.mark.parametrize("up", ["y", "z"])
def test_usd_colliders_have_their_poses_at_each_time(up: str, tmp_path: Path) -> None:
    sheet, x = perturbed()
    times = (0.0, 0.5)
    with usd_clip(tmp_path / "c.usdc", sheet, up, 2.0) as add:
        for seconds in times:
            add(x, pose_colliders(colliders_of(COLLIDERS), seconds))
    stage, _ = opened(tmp_path / "c.usdc")
    prims = {prim.GetName(): prim for prim in stage.GetDefaultPrim().GetChild("colliders").GetChildren()}
    assert list(prims) == ["sphere_0", "capsule_1", "box_2", "plane_3", "ground_4", "mesh_5"]
    mesh = COLLIDERS.meshes[0]
    assert isinstance(mesh, Mesh)
    solid = pose_colliders([mesh], 0.0)[0]
    corners = collider_surface(mesh).vertices @ solid.axes.T + solid.center
    expected: dict[str, list[Any]] = {  # bounding boxes at both times, y up
        "sphere_0": [[[-0.3, 0.7, 1.7], [0.3, 1.3, 2.3]], [[0.7, 0.7, 1.7], [1.3, 1.3, 2.3]]],
        "capsule_1": [[[0.5, 1.9, 2.9], [1.5, 2.1, 3.1]]] * 2,
        "box_2": [[[0.5, -0.5, -2], [1.5, 1.5, 2]], None],
        "plane_3": [[[-1.5, -1, -1.5], [1.5, -1, 1.5]]] * 2,
        "ground_4": [floor_below(x, -2.0)] * 2,
        "mesh_5": [[corners.min(axis=0), corners.max(axis=0)], None],
    }
    for name, boxes in expected.items():
        for k, box in enumerate(boxes):
            if box is not None:
                rotated = np.sort(rotate_to_up(np.array(box, np.float64), up), axis=0)
                assert bounds(prims[name], k) == pytest.approx(rotated, abs=1e-5), name
    # The box is rotated by 45° about the vertical axis, so its bounding box is wider.
    low, high = rotate_to_up(bounds(prims["box_2"], 1), "y")
    assert sorted(high - low) == pytest.approx(sorted([5 / 2**0.5, 2.0, 5 / 2**0.5]), abs=1e-5)
    moving = {name for name, prim in prims.items() if UsdGeom.Xformable(prim).TransformMightBeTimeVarying()}
    assert {"sphere_0", "box_2"} <= moving
    assert not {"capsule_1", "plane_3", "ground_4"} & moving


def test_faces_of_the_ground_point_up(tmp_path: Path) -> None:
    sheet, x = perturbed()
    write_usd(tmp_path / "c.usda", sheet, x, pose_colliders(colliders_of(COLLIDERS), 0.0), "y")
    stage, _ = opened(tmp_path / "c.usda")
    floor = UsdGeom.Mesh(stage.GetPrimAtPath("/drape15/colliders/ground_4"))
    a, b, c, _ = np.array(floor.GetPointsAttr().Get())[np.array(floor.GetFaceVertexIndicesAttr().Get())]
    assert np.cross(b - a, c - a)[1] > 0


@pytest.mark.parametrize("suffix", USD_SUFFIXES)
def test_usd_overwrites_a_file_that_is_open_in_this_process(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"c{suffix}"
    (sheet, x), (_, y) = perturbed(seed=0), perturbed(seed=1)
    write_usd(path, sheet, x, [], "y")
    stage, mesh = opened(path)
    mesh.GetPointsAttr().Get()
    write_usd(path, sheet, y, [], "y")
    stage.Reload()
    assert (np.array(mesh.GetPointsAttr().Get()) == y.astype(np.float32)).all()
