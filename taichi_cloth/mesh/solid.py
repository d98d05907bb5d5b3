"""The solid of a mesh collider: its surface, and distances to it. Both are kept for the life of the process."""

from __future__ import annotations

from functools import lru_cache

from ..scene.library import mesh_path
from ..scene.model import Mesh
from .distances import DistanceGrid, check_size, distance_grid
from .obj import ObjError, read_obj
from .surface import Surface, closed_surface

KEPT = 64  # solids of some megabytes each


def check_solid(mesh: Mesh) -> None:
    """Raises ValueError, one line, for a mesh that cannot be used."""
    check_size(surface_of(mesh), mesh.resolution, mesh.margin)


def surface_of(mesh: Mesh) -> Surface:
    """Its surface around its middle. Raises ValueError, one line, for a file that is none or one that is not closed."""
    return _surface(mesh.file, mesh.folder).scaled(mesh.scale)


def distances_of(mesh: Mesh) -> DistanceGrid:
    """Distances to it as far as its margin. Raises ValueError as `check_solid` does."""
    return _distances(mesh.file, mesh.folder, mesh.scale, mesh.resolution, mesh.margin)


@lru_cache(maxsize=KEPT)
def _surface(file: str, folder: str) -> Surface:
    path = mesh_path(file, folder)
    points, faces = read_obj(path)
    try:
        return closed_surface(points, faces)
    except ValueError as error:
        raise ObjError(path, 0, str(error)) from None


@lru_cache(maxsize=KEPT)
def _distances(file: str, folder: str, scale: float, resolution: int, margin: float) -> DistanceGrid:
    return distance_grid(_surface(file, folder).scaled(scale), resolution, margin)
