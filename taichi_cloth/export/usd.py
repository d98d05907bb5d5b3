"""USD files: the cloth as a mesh with time samples of its points, and the colliders. Needs the package usd-core.

Spheres, capsules and boxes are USD shapes; planes, the ground and meshes are USD meshes. Moving colliders have time
samples of their transform. A stage stays in memory until it is complete, with 24 bytes per particle and sample.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from ..collision.colliders import PosedCollider, is_static, shape_of
from ..system.errors import one_line
from ..system.files import atomic_path
from .mesh_files import ExportMesh, Floats, rotate_to_up, vertex_normals


class ColliderPrims:
    """The colliders of a scene as prims of a stage. The first call of `write` defines them."""

    def __init__(self, stage: Usd.Stage, path: Sdf.Path, up: str) -> None:
        """`path`: of the parent prim. `up`: the axis that is up in the file."""
        self._stage, self._path, self._up = stage, UsdGeom.Scope.Define(stage, path).GetPath(), up
        self._transforms: list[UsdGeom.XformOp] = []

    def write(self, colliders: list[PosedCollider], time: Usd.TimeCode) -> None:
        """Write the poses at a time. Static colliders are written once."""
        first = not self._transforms
        if first:
            self._transforms = [self._define(number, posed) for number, posed in enumerate(colliders)]
        for transform, posed in zip(self._transforms, colliders, strict=True):
            if first or not is_static(posed.collider):
                time_code = Usd.TimeCode.Default() if is_static(posed.collider) else time
                transform.Set(_matrix(posed, self._up), time_code)

    def _define(self, number: int, posed: PosedCollider) -> UsdGeom.XformOp:
        """Define the prim of a collider, in its own frame of reference, and return its transform."""
        path = self._path.AppendChild(f"{type(posed.collider).__name__.lower()}_{number}")
        shape = shape_of(posed.collider)
        if shape.usd is not None:
            prim = getattr(UsdGeom, shape.usd.name).Define(self._stage, path)
            for name, value in shape.usd.attributes(posed.size).items():
                getattr(prim, f"Create{name}Attr")(value)
        else:
            assert shape.polygons is not None, f"{shape.section} have neither a USD schema nor polygons"
            prim = self._mesh(path, *shape.polygons(posed.collider))
        prim.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(prim, Usd.TimeCode.Default()))
        return prim.AddTransformOp()

    def _mesh(self, path: Sdf.Path, points: Floats, faces: NDArray[np.int64]) -> UsdGeom.Mesh:
        mesh = UsdGeom.Mesh.Define(self._stage, path)
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray([faces.shape[1]] * len(faces)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
        return mesh


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
def usd_clip(path: Path, sheet: ExportMesh, up: str, rate: float) -> Iterator[Add]:
    """Yield a function that adds the next sample: positions (N, 3) [m], y up, and the colliders.

    `up`: the axis that is up in the file. `rate`: samples per second. The file is written at the end of the block.
    Raises OSError; a partial file never remains.
    """
    stage, write = _stage(sheet, up)
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


def write_usd(path: Path, sheet: ExportMesh, x: Floats, colliders: list[PosedCollider], up: str) -> None:
    """Write one frame: positions (N, 3) [m], y up, and the colliders. `up`: as in `usd_clip`. Raises OSError."""
    stage, write = _stage(sheet, up)
    write(x, colliders, Usd.TimeCode.Default())
    _save(stage, path)


def _stage(sheet: ExportMesh, up: str) -> tuple[Usd.Stage, Callable[[Floats, list[PosedCollider], Usd.TimeCode], None]]:
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
    prims = ColliderPrims(stage, root.GetPath().AppendChild("colliders"), up)

    def write(x: Floats, colliders: list[PosedCollider], time: Usd.TimeCode) -> None:
        positions = rotate_to_up(x, up)
        points = Vt.Vec3fArray.FromNumpy(positions.astype(np.float32))
        mesh.GetPointsAttr().Set(points, time)
        mesh.GetNormalsAttr().Set(
            Vt.Vec3fArray.FromNumpy(vertex_normals(positions, sheet.triangles).astype(np.float32)), time
        )
        mesh.GetExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), time)
        prims.write(colliders, time)

    return stage, write


def _save(stage: Usd.Stage, path: Path) -> None:
    with atomic_path(path, f".part{path.suffix}") as part:  # the library chooses the format by the suffix
        try:
            stage.GetRootLayer().Export(str(part))
        except Tf.ErrorException as error:  # a long text: the first reason is between quotes
            reason = re.search(r": '(.*?)'", str(error))
            raise OSError(errno.EIO, reason[1] if reason else "USD cannot write the file") from None
