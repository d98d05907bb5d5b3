"""Colliders in USD: balls, capsules and blocks as such, slopes and meshes as meshes; moving ones by time samples."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Gf, Usd, UsdGeom, Vt

from ..contact.bodies import Body, is_still
from ..mesh.solid import surface_of
from ..scene.model import Box, Capsule, Ground, Mesh, Plane, Sphere
from .sheet import turned_up

GROUND = 20.0  # [m] side of the square that stands for a floor without end
SQUARE = np.array([[-0.5, 0.0, -0.5], [-0.5, 0.0, 0.5], [0.5, 0.0, 0.5], [0.5, 0.0, -0.5]])  # seen from above


class Bodies:
    """All colliders of a scene below one path of a stage; the first `write` makes them."""

    def __init__(self, stage: Any, path: Any, up: str) -> None:
        self._stage, self._path, self._up = stage, UsdGeom.Scope.Define(stage, path).GetPath(), up
        self._placed: list[Any] = []  # the transform of each

    def write(self, bodies: list[Body], time: Any) -> None:
        """Where they are at a time; those that never move are told once."""
        first = not self._placed
        if first:
            self._placed = [self._made(number, body) for number, body in enumerate(bodies)]
        for transform, body in zip(self._placed, bodies, strict=True):
            if first or not is_still(body.collider):
                still = Usd.TimeCode.Default() if is_still(body.collider) else time
                transform.Set(_matrix(body, self._up), still)

    def _made(self, number: int, body: Body) -> Any:
        """The prim of a body around its own middle, along its own axes."""
        path = self._path.AppendChild(f"{type(body.collider).__name__.lower()}_{number}")
        match body.collider:
            case Sphere():
                shape = UsdGeom.Sphere.Define(self._stage, path)
                shape.CreateRadiusAttr(float(body.size[0]))
            case Capsule():
                shape = UsdGeom.Capsule.Define(self._stage, path)
                shape.CreateAxisAttr(UsdGeom.Tokens.y)
                shape.CreateHeightAttr(2 * float(body.size[0]))
                shape.CreateRadiusAttr(float(body.size[1]))
            case Box():
                shape = UsdGeom.Cube.Define(self._stage, path)
                shape.CreateSizeAttr(1.0)
            case Mesh():
                surface = surface_of(body.collider)
                shape = self._mesh(path, surface.points, surface.faces)
            case Plane():
                shape = self._mesh(path, SQUARE * body.collider.drawn, np.arange(4)[None])
            case Ground():
                shape = self._mesh(path, SQUARE * GROUND, np.arange(4)[None])
        shape.CreateExtentAttr(UsdGeom.Boundable.ComputeExtentFromPlugins(shape, Usd.TimeCode.Default()))
        return shape.AddTransformOp()

    def _mesh(self, path: Any, points: Any, faces: Any) -> Any:
        mesh = UsdGeom.Mesh.Define(self._stage, path)
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray([faces.shape[1]] * len(faces)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
        return mesh


def _matrix(body: Body, up: str) -> Any:
    """Its axes and its middle as rows, as USD has them; a block's axes are as long as its sides."""
    sides = 2 * body.size if isinstance(body.collider, Box) else np.ones(3)
    rows = np.eye(4)
    rows[:3, :3] = turned_up((body.axes * sides).T, up)
    rows[3, :3] = turned_up(body.center, up)
    return Gf.Matrix4d(rows.tolist())
