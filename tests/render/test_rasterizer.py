"""The rasterizer against areas, planes and spheres known in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import taichi as ti

from taichi_cloth.render.draw_list import DrawMesh
from taichi_cloth.render.rasterizer import GRID, MAX_COORDINATE, NEAR, GridPoint, Rasterizer, crossing, edge
from taichi_cloth.scene.keys import Vec3

CAPACITY = 3 * 16_000
BLACK = (0.0, 0.0, 0.0)
WHITE = (1.0, 1.0, 1.0)

FillMesh = Callable[..., DrawMesh]


@pytest.fixture(scope="module")
def fill_mesh() -> FillMesh:
    """Fill the only mesh of the module with triangles of shape (T, 3, 3). Kernels compile once for each mesh."""
    mesh = DrawMesh(*(ti.Vector.field(3, ti.f32, CAPACITY) for _ in range(4)))

    def fill(position: Any, color: Any = WHITE) -> DrawMesh:
        corners = np.asarray(position, np.float32).reshape(-1, 3)
        for field, values in ((mesh.position, corners), (mesh.color, color)):
            all_values = np.full((CAPACITY, 3), 0.5, np.float32)
            rows = np.asarray(values, np.float32)
            all_values[: len(corners)] = rows.reshape(-1, 3) if rows.size > 3 else rows
            field.from_numpy(all_values)
        mesh.corners = len(corners)
        return mesh

    return fill


def pixel_camera(width: int, height: int) -> np.ndarray:
    """Return a matrix by which the point (x w, y w, w) is at pixel (x, y), w meters away."""
    return np.array([[2 / width, 0, -1, 0], [0, -2 / height, 1, 0], [0, 0, 0, 0], [0, 0, 1, 0]])


def at(x: Any, y: Any, w: Any = 1.0) -> np.ndarray:
    return np.stack(np.broadcast_arrays(np.multiply(x, w), np.multiply(y, w), w), axis=-1)


def render(mesh: DrawMesh, width: int, height: int, samples: int = 1, background: Vec3 = BLACK) -> np.ndarray:
    return Rasterizer(width, height, samples).draw(mesh, pixel_camera(width, height), background)


def samples_covered(mesh: DrawMesh, width: int, height: int, samples: int) -> np.ndarray:
    """Return the number of covered samples of each pixel, from the gray values of a white mesh on black."""
    return np.rint(render(mesh, width, height, samples)[:, :, 0] / 255 * samples).astype(int)


def pixel_centers(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return x, y


# -- coverage ------------------------------------------------------------------------------------------------


def test_the_pixels_of_a_small_triangle_are_exact(fill_mesh: FillMesh) -> None:
    # Pixel centers on the slanted edge, x + y = 7, belong to the other half of the square.
    covered = samples_covered(fill_mesh(at([1, 6, 1], [1, 1, 6])), 8, 7, samples=1)
    assert ["".join(".#"[n] for n in row) for row in covered] == [
        "........",
        ".####...",
        ".###....",
        ".##.....",
        ".#......",
        "........",
        "........",
    ]
    other_half = samples_covered(fill_mesh(at([6, 6, 1], [1, 6, 6])), 8, 7, samples=1)
    square = np.zeros((7, 8), int)
    square[1:6, 1:6] = 1
    np.testing.assert_array_equal(covered + other_half, square)


@pytest.mark.parametrize("samples", [1, 4])
def test_covered_samples_equal_the_area_of_triangles(fill_mesh: FillMesh, samples: int) -> None:
    rng = np.random.default_rng(0)
    errors = []
    for corners in rng.uniform((5, 5), (155, 115), (50, 3, 2)):
        (ux, uy), (vx, vy) = corners[1] - corners[0], corners[2] - corners[0]
        area = abs(ux * vy - uy * vx) / 2
        perimeter = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).sum()
        found = samples_covered(fill_mesh(at(*corners.T)), 160, 120, samples).sum() / samples
        errors.append(found - area)
        # A vertical edge between two columns of samples, 1/samples apart, has an error of half that along its length.
        assert abs(errors[-1]) < 0.5 / samples * perimeter
    assert abs(np.mean(errors)) < 0.5  # [pixels] of 1700 on average: errors have both signs


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("step", [1 / 8, 1e-4], ids=["edges through samples", "edges anywhere"])
def test_every_sample_of_a_surface_is_covered_by_exactly_one_triangle(
    fill_mesh: FillMesh, samples: int, step: float
) -> None:
    rng = np.random.default_rng(1)
    width, height, cell = 24, 18, 6.0
    x, y = np.meshgrid(np.arange(-cell, width + 2 * cell, cell), np.arange(-cell, height + 2 * cell, cell))
    x, y = (step * np.rint((v + rng.uniform(-0.4 * cell, 0.4 * cell, v.shape)) / step) for v in (x, y))
    points = at(x, y, rng.uniform(1, 3, x.shape))
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    triangles = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (d, a, c))])
    alone = sum(samples_covered(fill_mesh(t), width, height, samples) for t in triangles)
    together = samples_covered(fill_mesh(triangles), width, height, samples)
    np.testing.assert_array_equal(alone, samples)  # no sample twice
    np.testing.assert_array_equal(together, samples)  # no sample missing


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("vertical", [True, False], ids=["vertical", "horizontal"])
def test_a_pixel_at_an_edge_blends_by_coverage(fill_mesh: FillMesh, quarters: int, vertical: bool) -> None:
    end = 3 + quarters / 4
    x, y = [-9, end, end, -9, end, -9], [-9, -9, 20, -9, 20, 20]  # a rectangle that ends in pixel 3
    mesh = fill_mesh(at(x, y) if vertical else at(y, x), color=(0.8, 0.4, 0.2))
    image = render(mesh, 7, 7, samples=4, background=(0.0, 0.92, 0.2))
    line = image[2] if vertical else image[:, 2]
    mixed = np.array([0.0, 0.92, 0.2]) + quarters / 4 * np.array([0.8, -0.52, 0.0])
    np.testing.assert_array_equal(line[2], np.rint(255 * np.array([0.8, 0.4, 0.2])))
    np.testing.assert_array_equal(line[3], np.rint(255 * mixed))
    np.testing.assert_array_equal(line[4], [0, 235, 51])


@ti.kernel
def columns_crossed(
    ends: ti.types.ndarray(dtype=GridPoint, ndim=2), at: ti.types.ndarray(dtype=GridPoint, ndim=1), columns: ti.i32
):
    for k in range(at.shape[0]):
        at[k].x = crossing(edge(ends[k, 0], ends[k, 1]), at[k].x, at[k].y, columns)


def test_edge_crossings_equal_integer_arithmetic() -> None:
    rng, columns = np.random.default_rng(3), 1920
    ends = rng.integers(-300 * GRID, 2200 * GRID, (20_000, 2, 2))
    ends[:5000] = 2 * GRID * (ends[:5000] // (2 * GRID))  # their midpoints are at whole pixels, where samples may be
    ends = np.take_along_axis(ends, np.argsort(ends[:, :, 1:], axis=1), axis=1)
    ends = ends[ends[:, 0, 1] < ends[:, 1, 1]]
    (ax, ay), (bx, by) = ends[:, 0].T, ends[:, 1].T
    x, y = rng.choice([32, 96, 128, 160, 224], len(ends)), rng.integers(ay, by)
    x[:4900], y[:4900] = 0, (ay + by)[:4900] // 2
    above, below = (ax - x) * (by - ay) + (bx - ax) * (y - ay), GRID * (by - ay)
    assert (above % below == 0).sum() > 4000
    found = np.ascontiguousarray(np.stack([x, y], axis=1))
    columns_crossed(np.ascontiguousarray(ends), found, columns)
    np.testing.assert_array_equal(found[:, 0], np.clip(-(-above // below), 0, columns))


# -- depth ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("near_first", [True, False])
@pytest.mark.parametrize("samples", [1, 4])
def test_the_nearer_triangle_is_visible_in_any_order(fill_mesh: FillMesh, near_first: bool, samples: int) -> None:
    near, far = at([-9, 40, -9], [-9, -9, 40], 2.0), at([-9, 40, -9], [-9, -9, 40], 2.001)
    red, blue = np.array([1, 0, 0]), np.array([0, 0, 1])
    order = [0, 1] if near_first else [1, 0]
    colors = np.repeat(np.array([red, blue])[order], 3, axis=0)
    image = render(fill_mesh(np.array([near, far])[order], color=colors), 8, 8, samples)
    np.testing.assert_array_equal(image, np.broadcast_to(255 * red, (8, 8, 3)))


def test_the_depth_of_a_tilted_triangle_is_exact(fill_mesh: FillMesh) -> None:
    width, height = 60, 40
    x, y, w = np.array([3.0, 55.0, 20.0]), np.array([2.0, 10.0, 38.0]), np.array([1.0, 4.0, 2.0])
    raster = Rasterizer(width, height, samples=1)
    raster.draw(fill_mesh(at(x, y, w)), pixel_camera(width, height), BLACK)
    depth = raster.depth()
    # Inverse depth is linear on the screen: alpha x + beta y + gamma = 1/w.
    plane = np.linalg.solve(np.stack([x, y, np.ones(3)], axis=1), 1 / w)
    px, py = pixel_centers(width, height)
    expected = 1 / (plane[0] * px + plane[1] * py + plane[2])
    covered = np.isfinite(depth)
    assert covered.sum() > 700
    np.testing.assert_allclose(depth[covered], expected[covered], rtol=1e-5)
    assert depth.dtype == np.float32


def test_the_silhouette_and_the_depth_of_a_sphere_are_exact(fill_mesh: FillMesh) -> None:
    width, height, focal, distance, radius = 240, 200, 300.0, 5.0, 1.0
    u, v = np.meshgrid(np.linspace(0, np.pi, 61), np.linspace(0, 2 * np.pi, 121), indexing="ij")
    unit = np.stack([np.sin(u) * np.cos(v), np.cos(u), np.sin(u) * np.sin(v)], axis=-1)
    a, b, c, d = (s.reshape(-1, 3) for s in (unit[:-1, :-1], unit[:-1, 1:], unit[1:, 1:], unit[1:, :-1]))
    faces = np.concatenate([np.stack(t, axis=1) for t in ((a, b, c), (a, c, d))])
    eye_space = radius * faces + (0, 0, distance)
    camera = np.array([[focal / (width / 2), 0, 0, 0], [0, focal / (height / 2), 0, 0], [0, 0, 0, 0], [0, 0, 1, 0]])
    raster = Rasterizer(width, height, samples=4)
    image = raster.draw(fill_mesh(eye_space), camera, BLACK)

    silhouette = focal * radius / np.sqrt(distance**2 - radius**2)  # the tangent cone on the image plane
    assert image[:, :, 0].sum() / 255 == pytest.approx(np.pi * silhouette**2, rel=3e-3)

    raster = Rasterizer(width, height, samples=1)
    raster.draw(fill_mesh(eye_space), camera, BLACK)
    x, y = pixel_centers(width, height)
    ray = np.stack([(x - width / 2) / focal, (height / 2 - y) / focal, np.ones_like(x)], axis=-1)  # w = 1
    square, middle = (ray**2).sum(axis=-1), distance * ray[..., 2]
    inner = np.hypot(x - width / 2, y - height / 2) < 0.9 * silhouette
    expected = (middle - np.sqrt(np.where(inner, middle**2 - square * (distance**2 - radius**2), 0))) / square
    # Facets of 3 degrees are at most 0.0005 inside the sphere, more along a slanted ray.
    np.testing.assert_allclose(raster.depth()[inner], expected[inner], atol=2e-3)
    assert np.isinf(raster.depth()[0, 0])


# -- camera and attributes -----------------------------------------------------------------------------------


def test_row_0_is_the_top_and_y_points_up(fill_mesh: FillMesh) -> None:
    looking_down_minus_z = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, -1.0, -0.2], [0, 0, -1.0, 0]])
    upper_left = np.array([[-2, 2, -2], [0, 2, -2], [-2, 0, -2]])
    image = Rasterizer(10, 6, samples=1).draw(fill_mesh(upper_left), looking_down_minus_z, BLACK)
    assert image.shape == (6, 10, 3)
    assert image[0, 0, 0] == 255
    assert image[-1].max() == image[:, -1].max() == 0


def test_colors_are_interpolated_with_perspective(fill_mesh: FillMesh) -> None:
    width, height = 60, 40
    x, y, w = np.array([-5.0, 140.0, -5.0]), np.array([-5.0, -5.0, 120.0]), np.array([1.0, 6.0, 2.5])
    colors = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.4], [0.3, 0.1, 0.9]])
    image = render(fill_mesh(at(x, y, w), color=colors), width, height)
    px, py = pixel_centers(width, height)
    flat = np.linalg.solve(np.stack([x, y, np.ones(3)]), np.stack([px, py, np.ones_like(px)]).reshape(3, -1))
    weights = flat / w[:, None]
    expected = (colors.T @ (weights / weights.sum(axis=0))).T.reshape(height, width, 3)
    np.testing.assert_allclose(image / 255, expected, atol=1.0 / 255)


def test_colors_are_not_extrapolated_beyond_an_edge(fill_mesh: FillMesh) -> None:
    # The color falls from 1 at x = 2.2 to 0 at the right edge, x = 3.2, and would be below 0 in the middle of pixel 3.
    mesh = fill_mesh(at([2.2, 3.2, 3.2], [4, -96, 104]), color=[[1, 1, 1], [0, 0, 0], [0, 0, 0]])
    pixel = render(mesh, 8, 8, samples=4)[4, 3, 0]
    assert pixel == round(255 * (3.2 - 3.125) / 4) > 0  # the one sample covered is at x = 3.125


# -- invalid triangles and arguments --------------------------------------------------------------------------


def test_an_empty_mesh_gives_the_background(fill_mesh: FillMesh) -> None:
    raster = Rasterizer(5, 3)
    image = raster.draw(fill_mesh(np.zeros((0, 3, 3))), pixel_camera(5, 3), (0.2, 0.4, 0.6))
    np.testing.assert_array_equal(image, np.broadcast_to([51, 102, 153], (3, 5, 3)))
    assert np.isinf(raster.depth()).all()


def test_only_corners_in_use_are_drawn(fill_mesh: FillMesh) -> None:
    mesh = fill_mesh([at([0, 4, 0], [0, 0, 4]), at([-9, 40, -9], [-9, -9, 40])])
    mesh.corners = 3
    assert samples_covered(mesh, 8, 8, samples=1).sum() == 6


@pytest.mark.parametrize(
    "triangle",
    [
        at([-9, 40, -9], [-9, -9, 40], -1.0),
        at([-9, 40, -9], [-9, -9, 40], [1.0, 1.0, 0.9 * NEAR]),
        at([1, 7, 4], [1, 7, 4]),
        at([3, 3, 3], [3, 3, 3]),
        at([-9, np.nan, -9], [-9, -9, 40]),
        at([-9, 40, -9], [-9, -9, 40], [1.0, 1.0, np.nan]),
        at([-9, np.inf, -9], [-9, -9, 40]),
        at([-9, 40, -9], [-9, -9, 1e30]),
        at([-9, 3 * MAX_COORDINATE, -9], [-9, -9, 40]),
        np.full((3, 3), np.nan),
    ],
    ids=["behind", "corner too near", "line", "point", "NaN x", "NaN w", "infinite", "huge", "far out", "NaN"],
)
def test_invalid_triangles_leave_no_pixels(fill_mesh: FillMesh, triangle: np.ndarray) -> None:
    valid = at([2, 6, 2], [2, 2, 6])
    alone = render(fill_mesh(valid), 8, 8, samples=4)
    np.testing.assert_array_equal(render(fill_mesh([triangle, valid, triangle]), 8, 8, samples=4), alone)
    assert alone.any()


def test_the_same_mesh_gives_the_same_bytes(fill_mesh: FillMesh) -> None:
    rng = np.random.default_rng(2)
    centers = rng.uniform((0, 0, 1), (120, 90, 2), (5000, 1, 3))
    x, y, w = np.moveaxis(centers + rng.normal(0, (8, 8, 0.02), (5000, 3, 3)), -1, 0)
    mesh = fill_mesh(at(x, y, w), color=rng.uniform(0, 1, (15000, 3)))
    raster = Rasterizer(120, 90)
    first = raster.draw(mesh, pixel_camera(120, 90), BLACK)
    for again in (raster, raster, Rasterizer(120, 90)):
        assert again.draw(mesh, pixel_camera(120, 90), BLACK).tobytes() == first.tobytes()


def test_hundreds_of_rasterizers_can_be_created(fill_mesh: FillMesh) -> None:
    # If each allocated a field, the 513th would crash the process.
    mesh = fill_mesh(at([0, 4, 0], [0, 0, 4]))
    for k in range(600):
        assert render(mesh, 1 + k % 7, 1 + k % 5)[0, 0, 0] == 255


@pytest.mark.parametrize("arguments", [(0, 5), (5, 0), (-1, 5), (5, 5, 2), (5, 5, 0)])
def test_invalid_sizes_and_sample_counts_are_rejected(arguments: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="not"):
        Rasterizer(*arguments)


def test_a_matrix_of_another_shape_is_rejected(fill_mesh: FillMesh) -> None:
    with pytest.raises(ValueError, match=r"\(4, 4\), not \(3, 4\)"):
        Rasterizer(5, 5).draw(fill_mesh(at([0, 4, 0], [0, 0, 4])), np.zeros((3, 4)), BLACK)
