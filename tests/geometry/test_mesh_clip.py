"""Clips of deforming meshes: the three kinds of files, interpolation, and what is refused."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taichi_cloth.geometry.mesh_reader import clip_of
from taichi_cloth.geometry.signed_distance import check_solid, collider_sdf, collider_surface, distances_to_surface
from taichi_cloth.scene.collider_schema import Mesh

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = [(1, 3, 2), (1, 2, 4), (1, 4, 3), (2, 3, 4)]
SAMPLES = np.stack([TETRAHEDRON + [0.0, 0.1 * k * k, 0.0] for k in range(4)])


def write_obj(path: Path, points: np.ndarray) -> None:
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*point) for point in points]
    path.write_text("\n".join(lines + ["f {} {} {}".format(*face) for face in FACES]), encoding="utf-8")


def pc2(points: np.ndarray, version: int = 1, samples: int | None = None) -> bytes:
    """Return a PC2 file; `version` and `samples` are those that its header claims."""
    count = len(points) if samples is None else samples
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", version, points.shape[1], 0.0, 1.0, count)
    return header + points.astype("<f4").tobytes()


def write_usd(path: Path, samples: np.ndarray, times: list[float]) -> None:
    from pxr import Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(24)
    mesh = UsdGeom.Mesh.Define(stage, "/body")
    mesh.CreateFaceVertexCountsAttr([3] * len(FACES))
    mesh.CreateFaceVertexIndicesAttr([corner - 1 for face in FACES for corner in face])
    points = mesh.CreatePointsAttr()
    for time, sample in zip(times, samples, strict=True):
        points.Set(Vt.Vec3fArray.FromNumpy(sample.astype(np.float32)), time)
    stage.GetRootLayer().Save()


@pytest.fixture
def mesh(tmp_path: Path) -> Mesh:
    """A tetrahedron with a PC2 clip of 4 samples, 2 a second."""
    write_obj(tmp_path / "body.obj", TETRAHEDRON)
    (tmp_path / "walk.pc2").write_bytes(pc2(SAMPLES))
    return Mesh(file="./body.obj", folder=str(tmp_path), clip="walk.pc2", clip_rate=2.0)


def test_positions_between_samples_are_interpolated(mesh: Mesh) -> None:
    clip = clip_of(mesh, 4)
    assert clip.at(0.5) == pytest.approx(SAMPLES[1])
    assert clip.at(0.625) == pytest.approx(0.75 * SAMPLES[1] + 0.25 * SAMPLES[2])


def test_a_loop_returns_to_the_first_sample_and_another_clip_ends(mesh: Mesh) -> None:
    loop, once = clip_of(mesh, 4), clip_of(replace(mesh, clip_loop=False), 4)
    assert loop.at(2.0) == pytest.approx(SAMPLES[0])
    assert loop.at(1.75) == pytest.approx(0.5 * (SAMPLES[3] + SAMPLES[0]))
    assert loop.at(1e6 + 0.5) == pytest.approx(SAMPLES[1])
    assert once.at(1.75) == pytest.approx(SAMPLES[3])
    assert once.at(100.0) == pytest.approx(SAMPLES[3])


def test_obj_files_and_usd_files_give_the_same_clip(mesh: Mesh, tmp_path: Path) -> None:
    for k, sample in enumerate(SAMPLES):
        write_obj(tmp_path / f"step_{k:02d}.obj", sample)
    write_usd(tmp_path / "walk.usda", SAMPLES, [0, 12, 24, 36])
    for name in ("step_*.obj", "walk.usda"):
        clip = clip_of(replace(mesh, clip=name), 4)
        assert clip.rate == 2.0
        assert clip.samples == pytest.approx(SAMPLES)


def test_the_surface_keeps_the_center_of_the_file_and_its_scale(mesh: Mesh) -> None:
    surface = collider_surface(replace(mesh, scale=2.0, clip_time=0.5))
    assert surface.vertices == pytest.approx(2.0 * (SAMPLES[1] - 0.5))


def later(path: Path) -> None:
    """Let a file be newer than it is, since the clock of a file system may be coarse."""
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 10**9))


def test_an_edited_mesh_is_read_again_when_a_scene_is_loaded(mesh: Mesh, tmp_path: Path) -> None:
    solid = replace(mesh, clip="")
    check_solid(solid)
    before = collider_surface(solid).vertices
    cells = collider_sdf(solid).values.shape
    write_obj(tmp_path / "body.obj", TETRAHEDRON * [1.0, 2.0, 1.0])  # a file of the same size
    later(tmp_path / "body.obj")
    assert collider_surface(solid).vertices == pytest.approx(before)  # a running simulation keeps what it has read
    check_solid(solid)
    assert collider_surface(solid).vertices == pytest.approx(before * [1.0, 2.0, 1.0])
    assert collider_sdf(solid).values.shape != cells
    (tmp_path / "body.obj").write_text("v 0 0 0\nf 1", encoding="utf-8")  # half written
    with pytest.raises(ValueError, match=r"body\.obj"):
        check_solid(solid)
    assert collider_surface(solid).vertices == pytest.approx(before * [1.0, 2.0, 1.0])


@pytest.mark.parametrize("name", ["walk.pc2", "step_*.obj"])
def test_an_edited_clip_is_read_again_when_a_scene_is_loaded(mesh: Mesh, tmp_path: Path, name: str) -> None:
    moving = replace(mesh, clip=name)
    for shift in (0.0, 1.0):
        (tmp_path / "walk.pc2").write_bytes(pc2(SAMPLES + shift))
        for k, sample in enumerate(SAMPLES):
            write_obj(tmp_path / f"step_{k}.obj", sample + shift)
        for path in tmp_path.glob("[ws]*"):
            if shift:
                assert clip_of(moving, 4).at(0.0) == pytest.approx(SAMPLES[0])
                later(path)
        check_solid(moving)
        assert clip_of(moving, 4).at(0.0) == pytest.approx(SAMPLES[0] + shift)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("no.pc2", None, "no.pc2: cannot be read: No such file or directory"),
        ("no.usda", None, "no.usda: cannot be read: No such file or directory"),
        ("no_*.obj", None, r"no_*.obj: no file matches"),
        ("a.abc", b"", "a.abc: is no clip: use a .pc2 file, a USD file"),
        ("a.pc2", b"POINTCACHE", "a.pc2: is no PC2 point cache"),
        ("a.pc2", pc2(SAMPLES, version=2), "is a PC2 point cache of version 2 with 4 points and 4 samples"),
        ("a.pc2", pc2(SAMPLES)[:-4], "has 220 bytes, but 4 samples of 4 points are 224"),
        ("a.pc2", pc2(SAMPLES, samples=0), "of version 1 with 4 points and 0 samples"),
        ("a.pc2", pc2(SAMPLES[:, :3]), "sample 0 has 3 points, but the mesh has 4"),
        ("a.pc2", pc2(np.where(SAMPLES > 1.85, np.nan, SAMPLES)), "point 2 of sample 3 is [0.0, nan, 0.0]"),
        ("a.pc2", pc2(1e7 * SAMPLES), "point 1 of sample 0 is [10000000.0, 0.0, 0.0]: not finite, or too far away"),
        ("a.usda", b"#usda 1.0\n(\n", "a.usda: cannot be read"),
        ("a.usda", b"#usda 1.0\n", "a.usda: has no mesh whose points have time samples"),
    ],
)
def test_what_is_wrong_is_one_line(mesh: Mesh, tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=r"^.+$") as caught:
        clip_of(replace(mesh, clip=name), 4)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_usd_samples_at_other_intervals_are_refused(mesh: Mesh, tmp_path: Path) -> None:
    write_usd(tmp_path / "jumps.usda", SAMPLES, [0, 12, 24, 37])
    with pytest.raises(ValueError, match="the samples of /body are not at equal intervals"):
        clip_of(replace(mesh, clip="jumps.usda"), 4)


def test_distances_to_a_surface_are_exact_and_signed(mesh: Mesh) -> None:
    """Of the tetrahedron, whose faces are three coordinate planes and x + y + z = 1."""
    surface = collider_surface(replace(mesh, clip_time=0.0))
    points = np.random.default_rng(5).uniform(-0.05, 1.05, (400, 3))
    planes = np.concatenate([points, (1 - points.sum(axis=1, keepdims=True)) / np.sqrt(3)], axis=1)
    found = distances_to_surface(surface, points - 0.5)
    inside = (planes > 0).all(axis=1)
    assert found[inside] == pytest.approx(-planes[inside].min(axis=1), abs=1e-9)
    assert (found[~inside] > 0).all()
    assert (found[~inside] >= -planes[~inside].min(axis=1) - 1e-9).all()
    below = points[(points[:, 1] < 0) & (points[:, [0, 2]] > 0).all(axis=1) & (points[:, 0] + points[:, 2] < 1)]
    assert distances_to_surface(surface, below - 0.5) == pytest.approx(-below[:, 1], abs=1e-9)


@pytest.fixture
def in_scene(mesh: Mesh, tmp_path: Path) -> Callable[[str], str]:
    """in_scene(text): the message of loading a scene with these keys of the mesh."""
    from taichi_cloth.geometry.scene_loader import load_scene
    from taichi_cloth.scene import SceneError

    def message(keys: str) -> str:
        path = tmp_path / "scene.toml"
        path.write_text(f'[cloth]\nrows = 3\ncolumns = 3\n[[meshes]]\nfile = "./body.obj"\n{keys}\n', encoding="utf-8")
        with pytest.raises(SceneError) as caught:
            load_scene(path)
        return str(caught.value)

    return message


def test_a_scene_names_the_mesh_whose_clip_is_wrong(in_scene: Callable[[str], str]) -> None:
    assert "meshes[0].clip: " in in_scene('clip = "gone.pc2"')
    assert "meshes[0].continuous" in in_scene('clip = "walk.pc2"\ncontinuous = true')
    assert "meshes[0].response" in in_scene('clip = "walk.pc2"\nresponse = "repulsion"')
