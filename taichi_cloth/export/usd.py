"""USD files: the cloth as a mesh with time samples of its points, and the colliders. Needs the package usd-core.

Spheres, capsules and boxes are USD shapes; planes, the ground, the pole and meshes are USD meshes. Moving colliders
have time samples of their transform. All have the color in which they are drawn. A stage stays in memory until it is
complete, with 24 bytes per particle and sample.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from ..collision.colliders import PosedCollider, is_deforming, is_static, shape_of
from ..render.draw_list import collider_color
from ..scene.collider_schema import Ground
from ..system.errors import one_line
from ..system.files import atomic_path
from .mesh_files import ExportMesh, Floats, Solid, collider_name, floor_square, linear_rgb, rotate_to_up, vertex_normals


class ColliderPrims:
    """The colliders of a scene as prims of a stage. The first call of `write` defines them."""

    def __init__(self, stage: Usd.Stage, path: Sdf.Path, up: str) -> None:
        """`path`: of the parent prim. `up`: the axis that is up in the file."""
        self._stage, self._path, self._up = stage, UsdGeom.Scope.Define(stage, path).GetPath(), up
        self._transforms: list[UsdGeom.XformOp] = []
        self._prims: list[UsdGeom.Gprim] = []

    def write(self, colliders: list[PosedCollider], x: Floats, time: Usd.TimeCode) -> None:
        """Write the poses at a time. Static colliders are written once. `x`: positions of the cloth (N, 3) [m]."""
        first = not self._transforms
        if first:
            self._transforms = [self._define(number, posed, x) for number, posed in enumerate(colliders)]
        for transform, posed in zip(self._transforms, colliders, strict=True):
            if first or not is_static(posed.collider):
                time_code = Usd.TimeCode.Default() if is_static(posed.collider) else time
                transform.Set(_matrix(posed, self._up), time_code)
        for prim, posed in zip(self._prims, colliders, strict=True):
            if is_deforming(posed.collider):
                _set_points(prim, posed, time)

    def _define(self, number: int, posed: PosedCollider, x: Floats) -> UsdGeom.XformOp:
        """Define the prim of a collider, in its own frame of reference, and return its transform."""
        path = self._path.AppendChild(collider_name(number, posed.collider))
        shape = shape_of(posed.collider)
        if shape.usd is not None:
            prim = getattr(UsdGeom, shape.usd.name).Define(self._stage, path)
            for name, value in shape.usd.attributes(posed.size).items():
                getattr(prim, f"Create{name}Attr")(value)
        elif isinstance(posed.collider, Ground):
            prim = _mesh(self._stage, path, floor_square(x, posed.center), np.arange(4)[None])
        else:
            assert shape.polygons is not None, f"{shape.section} have neither a USD schema nor polygons"
            prim = _mesh(self._stage, path, *shape.polygons(posed.collider))
        _set_color(prim, np.array([collider_color(posed)]), UsdGeom.Tokens.constant)
        prim.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(prim, Usd.TimeCode.Default()))
        self._prims.append(prim)
        return prim.AddTransformOp()


def _mesh(stage: Usd.Stage, path: Sdf.Path, points: Floats, faces: NDArray[np.integer[Any]]) -> UsdGeom.Mesh:
    """Define a mesh of points (P, 3) [m] and polygons (F, corners)."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreatePointsAttr(_vectors(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([faces.shape[1]] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    return mesh


def _set_points(mesh: UsdGeom.Mesh, posed: PosedCollider, time: Usd.TimeCode) -> None:
    """Set the points of a collider that deforms at a time."""
    polygons = shape_of(posed.collider).polygons
    assert polygons is not None
    points = _vectors(polygons(posed.collider)[0])
    mesh.GetPointsAttr().Set(points, time)
    mesh.GetExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), time)


def _set_color(prim: UsdGeom.Gprim, colors: NDArray[Any], interpolation: str) -> None:
    """Set the color of a prim: sRGB factors 0…1, one for the prim, (1, 3), or for every corner of its faces."""
    prim.CreateDisplayColorPrimvar(interpolation).Set(_vectors(linear_rgb(colors)))


def _vectors(rows: NDArray[Any]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(rows.astype(np.float32))


def _matrix(posed: PosedCollider, up: str) -> Gf.Matrix4d:
    """Return the transform of a collider, with row vectors as in USD."""
    schema = shape_of(posed.collider).usd
    sides = np.ones(3) if schema is None else schema.scale(posed.size)
    rows = np.eye(4)
    rows[:3, :3] = rotate_to_up((posed.axes * sides).T, up)
    rows[3, :3] = rotate_to_up(posed.center, up)
    return Gf.Matrix4d(rows.tolist())


Add = Callable[[Floats, list[PosedCollider]], None]


@contextmanager
def usd_clip(path: Path, sheet: ExportMesh, up: str, rate: float, fixed: Sequence[Solid] = ()) -> Iterator[Add]:
    """Yield a function that adds the next sample: positions (N, 3) [m], y up, and the colliders.

    `up`: the axis that is up in the file. `rate`: samples per second. `fixed`: solids beside the colliders that do not
    move, y up. The file is written at the end of the block. Raises OSError; a partial file never remains.
    """
    stage, write = _stage(sheet, up, fixed)
    stage.SetFramesPerSecond(rate)
    stage.SetTimeCodesPerSecond(rate)
    count = 0

    def add(x: Floats, colliders: list[PosedCollider]) -> None:
        nonlocal count
        write(x, colliders, Usd.TimeCode(count))
        count += 1

    yield add
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(count - 1)
    _save(stage, path)


def write_usd(
    path: Path,
    sheet: ExportMesh,
    x: Floats,
    colliders: list[PosedCollider],
    up: str,
    fixed: Sequence[Solid] = (),
) -> None:
    """Write one frame: positions (N, 3) [m], y up, and the colliders. Raises OSError.

    `up` and `fixed`: as in `usd_clip`.
    """
    stage, write = _stage(sheet, up, fixed)
    write(x, colliders, Usd.TimeCode.Default())
    _save(stage, path)


Write = Callable[[Floats, list[PosedCollider], Usd.TimeCode], None]


def _stage(sheet: ExportMesh, up: str, fixed: Sequence[Solid]) -> tuple[Usd.Stage, Write]:
    """Return a stage with the mesh, and a function that writes positions and colliders at a time."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up.upper())
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, f"/{Tf.MakeValidIdentifier(one_line(sheet.name))}")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, root.GetPath().AppendChild("cloth"))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(sheet.triangles)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(sheet.triangles.ravel()))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    st.Set(Vt.Vec2fArray.FromNumpy(sheet.uv.astype(np.float32)))
    _set_color(mesh, sheet.colors, UsdGeom.Tokens.faceVarying)
    for solid in fixed:
        part = _mesh(stage, root.GetPath().AppendChild(solid.name), rotate_to_up(solid.positions, up), solid.triangles)
        part.CreateNormalsAttr(_vectors(rotate_to_up(solid.normals, up)))
        part.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        part.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(part.GetPointsAttr().Get()))
        _set_color(part, solid.color[None], UsdGeom.Tokens.constant)
    prims = ColliderPrims(stage, root.GetPath().AppendChild("colliders"), up)

    def write(x: Floats, colliders: list[PosedCollider], time: Usd.TimeCode) -> None:
        positions = rotate_to_up(x, up)
        points = _vectors(positions)
        mesh.GetPointsAttr().Set(points, time)
        mesh.GetNormalsAttr().Set(_vectors(vertex_normals(positions, sheet.triangles)), time)
        mesh.GetExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), time)
        prims.write(colliders, x, time)

    return stage, write


def _save(stage: Usd.Stage, path: Path) -> None:
    with atomic_path(path, f".part{path.suffix}") as part:  # the library chooses the format by the suffix
        try:
            stage.GetRootLayer().Export(str(part))
        except Tf.ErrorException as error:  # a long text: the first reason is between quotes
            reason = re.search(r": '(.*?)'", str(error))
            raise OSError(errno.EIO, reason[1] if reason else "USD cannot write the file") from None
