"""Data for the WebGL renderer `drawing.js`, shared by the web server and the HTML export.

The cloth, the colliders and the pole become vertex arrays. Camera, light and floor have the values of the window. HTML
templates have placeholders `{{name}}`, which are replaced by scripts and data.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..collision.colliders import PosedCollider, is_deforming
from ..collision.shapes import SPHERE
from ..geometry import closed_surface
from ..geometry.topology import Topology
from ..scene.collider_schema import Ground, Sphere
from ..scene.schema import Scene
from ..simulation.simulation import Simulation
from ..system.errors import one_line
from . import draw_list, shading, split_view
from .camera import WIDTH_MARGIN, OrbitCamera, camera_of
from .colors import round_down_125
from .draw_list import TriangleSoup, collider_mesh, pole_mesh, with_color

# -- HTML templates ----------------------------------------------------------------------------------------------------

RENDERER_SCRIPT = Path(__file__).with_name("drawing.js")


def fill_template(page: Path, title: str, parts: Mapping[str, str]) -> str:
    """Return an HTML template with its placeholders replaced: `title` escaped, `drawing.js`, and `parts` unchanged."""
    all_parts = {"title": escape(one_line(title)), "drawing": RENDERER_SCRIPT.read_text(encoding="utf-8"), **parts}
    return re.sub(r"\{\{(\w+)\}\}", lambda match: all_parts[match[1]], page.read_text(encoding="utf-8"))


def script_safe(value: object) -> str:
    """Return JSON that is safe inside a script element: "<" is escaped, so that none of it is parsed as HTML."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


# -- cloth -------------------------------------------------------------------------------------------------------------

STEPS = 2**16 - 1  # quantization steps along each side of a bounding box

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]


def quantize(x: Floats) -> tuple[Floats, Floats, NDArray[np.uint16]]:
    """Quantize positions, (…, 3) [m], to 16 bits within their bounding box.

    Return the lowest corner of the box (3,) [m], the step along each axis (3,) [m], and the positions in steps (…, 3).
    """
    axes = np.ascontiguousarray(x.reshape(-1, 3).T)  # NumPy reduces rows ten times as fast as columns
    low = axes.min(axis=1)
    step = (axes.max(axis=1) - low) / STEPS
    inverse = np.divide(1.0, step, out=np.zeros(3), where=step > 0)
    return low, step, ((x - low) * inverse + 0.5).astype(np.uint16)  # truncation is faster than rounding


def remaining_triangles(untorn: Topology, torn: Topology) -> NDArray[np.bool_]:
    """Return a mask of the triangles of an untorn topology, (T,): true for those that remain in the torn one."""
    left: NDArray[np.bool_] = np.isin(_keys(untorn), _keys(torn))
    return left


def _keys(topology: Topology) -> Ids:
    """Return a number for every triangle, (T,), that depends only on its particles: tearing does not change it."""
    a, b, c = topology.triangles.T.astype(np.int64)
    keys: Ids = (a * topology.particle_count + b) * topology.particle_count + c
    return keys


# -- solids, camera and light ------------------------------------------------------------------------------------------


class Solids:
    """Everything that is drawn except cloth and floor: the colliders and the pole."""

    def __init__(self, simulation: Simulation, more: Sequence[TriangleSoup] = ()) -> None:
        """`more`: meshes that are drawn too; the caller provides their poses."""
        self._simulation = simulation
        colliders = simulation.colliders()
        self._drawn = [k for k, posed in enumerate(colliders) if not isinstance(posed.collider, Ground)]
        self._sizes = [colliders[k].size[0] for k in self._drawn]
        self._meshes = [local_mesh(colliders[k]) for k in self._drawn]
        if simulation.scene.look.pole:
            self._meshes.append(pole_mesh(simulation.scene, simulation.topology.start))
        self._own = len(self._meshes)
        self._meshes += more
        self._merged = [merge_corners(mesh) for mesh in self._meshes]
        self._deforming = [k for k, number in enumerate(self._drawn) if is_deforming(colliders[number].collider)]
        first = np.cumsum([0, *(len(vertices) for vertices, _, _ in self._merged)])
        self.deforming = [(int(first[k]), len(self._merged[k][0])) for k in self._deforming]
        """First vertex and number of vertices of each solid that deforms, among those of `pack`."""

    def deformed(self) -> Floats:
        """Return the vertices of the solids that deform, as they are now, (D, 6): position [m] and normal."""
        colliders = self._simulation.colliders() if self._deforming else []
        parts = [np.zeros((0, 6))]
        for k in self._deforming:
            positions, normals, _ = local_mesh(colliders[self._drawn[k]])
            parts.append(np.hstack([positions, normals])[self._merged[k][2]].astype(np.float64))
        return np.concatenate(parts)

    def poses(self) -> Floats:
        """Return the current pose of every solid as a matrix, (K, 4, 4), without the meshes `more`."""
        colliders = self._simulation.colliders()
        poses = [pose_matrix(colliders[k], size) for k, size in zip(self._drawn, self._sizes, strict=True)]
        poses += [np.eye(4)] * (self._own - len(poses))
        return np.array(poses).reshape(-1, 4, 4)

    def pack(self) -> tuple[list[dict[str, object]], Floats, NDArray[np.int64]]:
        """Return a description of every solid, and the vertices (V, 6) and corners (3·T,) of all solids in this order.

        A vertex is a position [m] and a normal. A description has the color, the first corner and the number of
        corners.
        """
        descriptions: list[dict[str, object]] = []
        corners, vertices = [np.zeros(0, np.int64)], [np.zeros((0, 6))]
        vertex_count = first = 0
        for mesh, (unique, inverse, _) in zip(self._meshes, self._merged, strict=True):
            color = [round(float(factor), 3) for factor in mesh[2][0]]
            descriptions.append({"color": color, "first": first, "corners": len(mesh[0])})
            vertices.append(unique)
            corners.append(inverse + vertex_count)
            vertex_count, first = vertex_count + len(unique), first + len(mesh[0])
        return descriptions, np.concatenate(vertices), np.concatenate(corners)


BESIDE_CLOTH = 1.04  # width to show, over that of the cloth at its start


def min_aspect(scene: Scene, start: Floats) -> float:
    """Return the aspect ratio (width / height) below which pages move the eye back, to show the same width.

    The width is that of the cloth at its start, (N, 3) [m], within the limits of the window: at least what the scene's
    camera is meant to show, and at most what `OrbitCamera.fit_width` shows.
    """
    uv, _ = OrbitCamera.from_scene(scene).to_screen(start, 1.0)  # NaN behind the eye
    width = BESIDE_CLOTH * 2 * float(np.nanmax(np.abs(uv[:, 0] - 0.5), initial=0.0))
    return min(max(width, split_view.MIN_ASPECT), WIDTH_MARGIN * split_view.MIN_ASPECT)


def air(scene: Scene, start: Floats) -> dict[str, object]:
    """Return camera, light and floor with the values of the window, for JSON; lengths in m, colors as factors 0…1.

    `start`: the cloth at its start, (N, 3) [m].
    """
    camera = camera_of(scene)
    distance = float(np.linalg.norm(np.subtract(camera.eye, camera.target)))
    light = {
        "lightDirection": shading.LIGHT_DIRECTION,
        "shadowU": shading.SHADOW_U,
        "shadowV": shading.SHADOW_V,
        "lightColor": shading.LIGHT_COLOR,
        "sky": shading.SKY,
        "floorLight": shading.FLOOR_LIGHT,
        "rimColor": shading.RIM_COLOR,
        "rimDirection": shading.RIM_DIRECTION,
        "background": shading.BACKGROUND,
        "transmission": shading.TRANSMISSION,
        "specularExponent": shading.SPECULAR_EXPONENT,
        "shadowExtent": draw_list.SHADOW_EXTENT * distance,
        "texel": 2 * draw_list.SHADOW_EXTENT * distance / shading.SHADOW_MAP_SIZE,
        "shadowBias": shading.SHADOW_BIAS,
        "sampleSpacing": shading.SAMPLE_SPACING,
        "target": camera.target,
        "floorExtent": draw_list.FLOOR_EXTENT * distance,
        "gridExtent": draw_list.GRID_EXTENT * distance,
        "gridSpacing": round_down_125(draw_list.GRID_SPACING * distance),
        "gridLineWidth": draw_list.GRID_LINE_WIDTH * distance,
        "gridLineColor": draw_list.GRID_LINE_COLOR,
    }
    return {
        "camera": {
            "eye": camera.eye,
            "target": camera.target,
            "fov": camera.fov,
            "minAspect": min_aspect(scene, start),
            "floor": None if scene.ground is None else scene.ground.height,
        },
        "light": {name: np.array(value, float).tolist() for name, value in light.items()},
        "gloss": draw_list.GLOSS,
        "sheen": scene.look.sheen,
        "strainViewContrast": draw_list.STRAIN_VIEW_CONTRAST,
        "floor": draw_list.FLOOR_COLOR,
        "ground": None if scene.ground is None else scene.ground.height,
    }


def merge_corners(mesh: TriangleSoup) -> tuple[Floats, Ids, Ids]:
    """Merge equal corners.

    Return the vertices, positions [m] and normals (V, 6), that of every corner, (3·T,), and a corner of each, (V,).
    """
    vertices, owner, corners = np.unique(np.hstack(mesh[:2]), axis=0, return_index=True, return_inverse=True)
    return vertices, corners.ravel(), owner


def local_mesh(posed: PosedCollider) -> TriangleSoup:
    """Return the mesh of a collider other than the ground, in its local coordinates."""
    if isinstance(posed.collider, Sphere):
        sphere = closed_surface.unit_sphere()
        return with_color(posed.size[0] * sphere, sphere, SPHERE.color)
    return collider_mesh(posed)


def pose_matrix(posed: PosedCollider, first_size: float) -> Floats:
    """Return the pose of a collider as a matrix, (4, 4). It scales a sphere that had the radius `first_size` [m]."""
    pose = np.eye(4)
    scale = posed.size[0] / first_size if isinstance(posed.collider, Sphere) else 1.0
    pose[:3, :3], pose[:3, 3] = scale * posed.axes, posed.center
    return pose
