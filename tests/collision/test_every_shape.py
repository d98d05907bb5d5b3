"""Every collider shape with all that uses shapes: a new shape that is incomplete fails here."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.collision.colliders import (
    collider_counts,
    pose_colliders,
    ray_cast,
    shape_of,
    signed_distance,
    triangle_distance,
)
from taichi_cloth.collision.shapes import SHAPES, Shape
from taichi_cloth.geometry.signed_distance import collider_sdf
from taichi_cloth.render.draw_list import collider_mesh
from taichi_cloth.scene.collider_schema import RESPONSES, Mesh
from taichi_cloth.scene.schema import COLLIDERS, Scene, sections
from taichi_cloth.solvers import Features
from taichi_cloth.state.contact_data import acquire_sdf, release_sdf

EVERY = pytest.mark.parametrize("shape", SHAPES, ids=[shape.section for shape in SHAPES])
POINTS = 400
vectors = ti.types.ndarray(dtype=ti.math.vec3, ndim=1)
scalars = ti.types.ndarray(dtype=ti.f32, ndim=1)


def example(shape: Shape):
    """Return a collider with the shape's defaults, at the origin."""
    one = shape.classes[0](center=(0.0, 0.0, 0.0))
    return replace(one, scale=1.0, resolution=32) if isinstance(one, Mesh) else one


def sdf_of(collider):
    return acquire_sdf([collider_sdf(collider)] if isinstance(collider, Mesh) else [])


@ti.kernel
def push_all(shape: ti.template(), features: ti.template(), size: tm.vec3, margin: float, x: vectors, out: vectors):
    axes = ti.Matrix.identity(ti.f32, 3)
    for i in range(x.shape[0]):
        out[i] = shape.push_out(features, axes, size, margin, x[i])


@ti.kernel
def impact_all(
    shape: ti.template(), features: ti.template(), size: tm.vec3, x: vectors, paths: vectors, times: scalars
):
    for i in range(x.shape[0]):
        time, _normal = shape.time_of_impact(features, size, 0.0, x[i], paths[i])
        times[i] = time


def test_scene_sections_match_the_shapes() -> None:
    assert tuple(shape.section for shape in SHAPES) == COLLIDERS
    for shape in SHAPES:
        assert sections()[shape.section].cls is shape.classes[0]
        assert all(shape_of(cls()) is shape for cls in shape.classes)


@EVERY
def test_what_collides_with_triangles_measures_their_distance(shape: Shape) -> None:
    """Else cloth that starts within its margin would be shot away."""
    needed = (shape.closest_on_triangle, shape.core, shape.triangle_distance)
    assert all(needed) or not any(needed)
    if shape.triangle_distance is None:
        return
    far = np.array([[[9.0, 9.0, 9.0], [10.0, 9.0, 9.0], [9.0, 10.0, 9.0]]])
    assert triangle_distance(*pose_colliders([example(shape)], 0.0), far)[0] > 1.0
    assert triangle_distance(*pose_colliders([example(shape)], 0.0), far - 9.0)[0] < 0.0  # through the center


@EVERY
def test_colliders_are_counted_by_response(shape: Shape) -> None:
    for number, response in enumerate(RESPONSES):
        counts = collider_counts([replace(example(shape), response=response)])
        assert sum(map(sum, counts)) == counts[number][SHAPES.index(shape)] == 1


@EVERY
def test_points_pushed_out_lie_on_the_margin(shape: Shape) -> None:
    collider, margin = example(shape), 0.05
    (posed,) = pose_colliders([collider], 0.0)
    x = np.random.default_rng(1).uniform(-0.6, 0.6, (POINTS, 3))
    out, sdf = np.zeros_like(x, np.float32), sdf_of(collider)
    push_all(shape, Features(sdf=sdf), ti.Vector([float(n) for n in posed.size]), margin, np.float32(x), out)
    release_sdf(sdf)
    before, after = signed_distance(posed, x), signed_distance(posed, x + out)
    inside = before < margin
    assert inside.any()
    assert (out[before > margin + 1e-3] == 0).all()
    tolerance = 2e-2 if isinstance(collider, Mesh) else 1e-5  # interpolated between grid nodes
    assert after[inside].min() >= margin - tolerance


@EVERY
def test_impacts_are_on_the_surface(shape: Shape) -> None:
    collider = example(shape)
    (posed,) = pose_colliders([collider], 0.0)
    random = np.random.default_rng(2)
    x = random.normal(size=(POINTS, 3))
    x = 3 * x / np.linalg.norm(x, axis=1)[:, None]
    x[:, 1] = np.abs(x[:, 1])  # above a plane
    paths = 2 * (random.uniform(-0.2, 0.2, x.shape) - x)  # past the middle of the shape
    times, sdf = np.zeros(POINTS, np.float32), sdf_of(collider)
    size = ti.Vector([float(n) for n in posed.size])
    impact_all(shape, Features(sdf=sdf), size, np.float32(x), np.float32(paths), times)
    release_sdf(sdf)
    hit = times <= 1.0
    assert hit.mean() > 0.5
    tolerance = 2e-2 if isinstance(collider, Mesh) else 1e-4
    nearest = np.min([signed_distance(posed, x + share * paths) for share in np.linspace(0.0, 1.0, 401)], axis=0)
    assert hit[nearest < -tolerance].all()
    assert not hit[nearest > tolerance + 0.01].any()  # two samples are at most 0.02 m apart
    assert np.abs(signed_distance(posed, x + times[:, None] * paths))[hit].max() < tolerance


@EVERY
def test_a_ray_hits_the_collider(shape: Shape) -> None:
    posed = pose_colliders([example(shape)], 0.0)
    assert 0.0 < ray_cast(posed, np.array([0.0, 4.0, 0.0]), np.array([0.0, -1.0, 0.0])) <= 4.0


@EVERY
def test_drawn_triangles_lie_on_the_surface(shape: Shape) -> None:
    (posed,) = pose_colliders([example(shape)], 0.0)
    positions, normals, colors = collider_mesh(posed)
    assert positions.shape == normals.shape == colors.shape
    assert len(positions) % 3 == 0
    distance = signed_distance(posed, positions.astype(float))
    assert np.abs(distance).min() < 1e-2
    assert distance.max() < 2e-2


@EVERY
def test_the_shape_is_exported_exactly_or_as_polygons(shape: Shape) -> None:
    collider = example(shape)
    if shape.usd is not None:
        assert shape.usd.scale(np.ones(3)).shape == (3,)
        return
    assert shape.polygons is not None
    points, faces = shape.polygons(collider)
    (posed,) = pose_colliders([collider], 0.0)
    assert np.abs(signed_distance(posed, points)).max() < 2e-2
    assert faces.max() < len(points)


def test_a_scene_with_every_shape_is_valid() -> None:
    colliders: dict[str, Any] = {shape.section: (example(shape),) for shape in SHAPES}
    Scene(**colliders)
