"""USD files: the cloth as a mesh whose points are time samples, and the colliders. Needs usd-core.

A stage is held in memory until it is whole: 24 bytes a particle and sample.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from ..contact.bodies import Body
from ..errors import one_line
from ..files import whole_path
from .sheet import Floats, Sheet, turned_up, vertex_normals
from .usd_bodies import Bodies

Add = Callable[[Floats, list[Body]], None]


@contextmanager
def usd_clip(path: Path, sheet: Sheet, up: str, rate: float) -> Iterator[Add]:
    """A function that adds the next sample: places (N, 3) [m], y up, and the colliders; `rate` samples a second.

    The axis `up` is upwards in the file, which appears at the end of the block. Raises OSError.
    """
    stage, write = _stage(sheet, up)
    stage.SetFramesPerSecond(rate)
    stage.SetTimeCodesPerSecond(rate)
    count = 0

    def add(x: Floats, bodies: list[Body]) -> None:
        nonlocal count
        write(x, bodies, Usd.TimeCode(count))
        count += 1

    yield add
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(count - 1)
    _save(stage, path)


def write_usd(path: Path, sheet: Sheet, x: Floats, bodies: list[Body], up: str) -> None:
    """One moment: places (N, 3) [m], y up, and the colliders. Raises OSError."""
    stage, write = _stage(sheet, up)
    write(x, bodies, Usd.TimeCode.Default())
    _save(stage, path)


def _stage(sheet: Sheet, up: str) -> tuple[Any, Callable[[Floats, list[Body], Any], None]]:
    """A stage with the mesh in it, and what writes a moment of it."""
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
    colliders = Bodies(stage, root.GetPath().AppendChild("colliders"), up)

    def write(x: Floats, bodies: list[Body], time: Any) -> None:
        places = turned_up(x, up)
        points = Vt.Vec3fArray.FromNumpy(places.astype(np.float32))
        mesh.GetPointsAttr().Set(points, time)
        mesh.GetNormalsAttr().Set(
            Vt.Vec3fArray.FromNumpy(vertex_normals(places, sheet.triangles).astype(np.float32)), time
        )
        mesh.GetExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), time)
        colliders.write(bodies, time)

    return stage, write


def _save(stage: Any, path: Path) -> None:
    with whole_path(path, f".part{path.suffix}") as part:  # the suffix tells the library the kind of file
        try:
            stage.GetRootLayer().Export(str(part))
        except Tf.ErrorException as error:  # pages of it: the first reason is between quotes
            reason = re.search(r": '(.*?)'", str(error))
            raise OSError(errno.EIO, reason[1] if reason else "USD cannot write it") from None
